"""Properties of the formatter: the same reading, the same comments, and the same text when it is applied again."""

import re
from pathlib import Path
from typing import List, Tuple

import pytest
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st
from parsed_sources import ROOT

from retalis import Operators, ProgramErrors, SyntaxFault
from retalis.editing.formatter import format_goals, format_rules
from retalis.events.program.goal_file import read_goals
from retalis.prolog.syntax.term_reader import OF_FILES, ReadTerm, read_program
from retalis.prolog.terms.term_traversal import variant_key

FILES = [
    path
    for folder in ("examples", "application_source", "test/data", "src/retalis/prolog/library")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.name in ("eventRules.txt", "rules.txt", "goalPredicates.txt", "goals.txt") or path.suffix == ".pl"
    if path.parent.name != "conformity"
]
WIDTHS = st.integers(20, 120)


def readings(text: str) -> List[Tuple[object, ...]]:
    """Return the terms and names of variables of a rule file, as the loader reads it."""
    clauses = list(read_program(text, Operators.prolog(), "rules", OF_FILES))
    assert not [clause for clause in clauses if isinstance(clause, SyntaxFault)], text
    return [(variant_key(clause.term), *clause.names) for clause in clauses if isinstance(clause, ReadTerm)]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_of_repository_keep_their_reading(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    format_text = format_goals if "goal" in path.name else format_rules
    for width in (30, 60, 120):
        # The formatter itself compares the readings; those of named slots need the definitions of messages.
        result = format_text(text, path.name, width)
        assert format_text(result, path.name, width) == result
        assert re.findall(r"(?m)^\s*(%.*\S)", text) == re.findall(r"(?m)^\s*(%.*\S)", result)
    if "goal" in path.name:
        goals = [list(read_goals(content, Operators.prolog(), "goals")) for content in (text, result)]
        assert [variant_key(goal.term) for goal in goals[0] if isinstance(goal, ReadTerm)] == [
            variant_key(goal.term) for goal in goals[1] if isinstance(goal, ReadTerm)
        ]


NAMES = [
    "a",
    "foo",
    "'it''s'",
    "seq",
    "where",
    "[]",
    "-",
    "+",
    "\\+",
    "<-",
    "dynamic",
    "'<-'",
    "!",
    "{}",
    ";",
]
OPERATORS = [
    *("seq", "and", "or", "par", "cnot", "where", "within", "do", "with", "*", "#", "/\\", "\\/"),
    *(":-", "-->", "<-", ";", "->", ",", "=", "is", "+", "-", "/", "^", ":", "=..", "mod", "|", "@<", "iff"),
]
PREFIXES = ["-", "\\+", ":-", "dynamic", "?-"]
GAPS = [
    "",
    " ",
    "  ",
    "\n",
    "\n\n\n",
    "\n   ",
    " % note\n",
    " /* c */ ",
    "\n% own line\n",
    "\n /* a\n b */\n",
    "\t",
]

atoms = st.sampled_from([*NAMES, "X", "_", "Y1", "0", "12", "1.5", "0'a", '"text"', "`codes`", "'a\\\n b'"])


def bracketed(inner: st.SearchStrategy[List[str]]) -> st.SearchStrategy[List[str]]:
    """Return tokens of lists, compound terms, messages, and terms in brackets; a NUL character stands for no gap."""
    items = st.lists(inner, min_size=1, max_size=4).map(
        lambda parts: [token for part in parts for token in [",", *part]][1:]
    )
    slots = st.lists(inner, min_size=1, max_size=3).map(
        lambda parts: [token for part in parts for token in [",", "slot", ":", *part]][1:]
    )
    return st.one_of(
        items.map(lambda tokens: ["(", *tokens, ")"]),
        items.map(lambda tokens: ["[", *tokens, "]"]),
        items.map(lambda tokens: ["foo", "\0", "(", *tokens, ")"]),
        slots.map(lambda tokens: ["message", "\0", "{", *tokens, "}"]),
        st.tuples(inner, inner).map(lambda pair: ["[", *pair[0], "|", *pair[1], "]"]),
        st.tuples(inner, st.sampled_from(OPERATORS), inner).map(
            lambda parts: ["(", *parts[0], parts[1], *parts[2], ")"]
        ),
        st.tuples(inner, st.sampled_from(OPERATORS), inner).map(
            lambda parts: [*parts[0], parts[1], *parts[2]]
        ),
        st.tuples(st.sampled_from(["-", "\\+", ":-", "dynamic", "?-"]), inner).map(
            lambda parts: [parts[0], *parts[1]]
        ),
    )


terms = st.recursive(atoms.map(lambda token: [token]), bracketed, max_leaves=12)


@st.composite
def texts(draw: st.DrawFn) -> str:
    """Return a text of clauses in an arbitrary layout; some are syntax errors."""
    text = draw(st.sampled_from(["", "\n", "% first\n"]))
    for tokens in draw(st.lists(terms, min_size=1, max_size=3)):
        for token, following in zip([*tokens, "."], [*tokens[1:], ".", ""]):
            has_gap = "\0" not in (token, following)
            text += token + (draw(st.sampled_from(GAPS if following else GAPS[1:])) if has_gap else "")
    return text.replace("\0", "")


def is_valid(text: str) -> bool:
    clauses = read_program(text, Operators.prolog(), "rules", OF_FILES)
    return not any(isinstance(clause, SyntaxFault) for clause in clauses)


def comments(text: str) -> List[str]:
    return re.findall(r"% \w+ ?\w*|/\* c \*/|/\* a\n b\*/", text)


@settings(max_examples=100, deadline=None)
@given(texts(), WIDTHS)
def test_layout_changes_neither_reading_nor_itself(text: str, width: int) -> None:
    check_layout(text, width)


@pytest.mark.nightly
@settings(max_examples=10_000, deadline=None)
@given(texts(), WIDTHS)
def test_layout_of_many_texts(text: str, width: int) -> None:
    check_layout(text, width)


def check_layout(text: str, width: int) -> None:
    if "message" not in text:
        assume(is_valid(text))
    try:
        result = format_rules(text, "rules", width)
    except ProgramErrors:
        assert "message" in text
        reject()
    assert format_rules(result, "rules", width) == result
    assert comments(result) == comments(text)
    if "message" not in text:
        assert readings(result) == readings(text)


@settings(max_examples=100, deadline=None)
@given(st.lists(terms, min_size=1, max_size=4), st.booleans(), WIDTHS)
def test_goals_keep_their_reading(goals: List[List[str]], has_stop: bool, width: int) -> None:
    lines = [" ".join(tokens).replace(" \0 ", "").replace("\\\n ", "") for tokens in goals]
    text = "".join(f"{line}{' .' if has_stop else ''} % note\n\n" for line in lines)
    try:
        result = format_goals(text, "goals", width)
    except ProgramErrors:
        reject()
    assert format_goals(result, "goals", width) == result
    assert comments(result) == comments(text)


@settings(max_examples=100, deadline=None)
@given(st.text(alphabet="aX(){}[]|,.:-<>% \n/*'\"0\\"))
def test_any_text_is_formatted_or_has_syntax_error(text: str) -> None:
    try:
        result = format_rules(text, "rules", 40)
    except ProgramErrors:
        return
    assert format_rules(result, "rules", 40) == result
