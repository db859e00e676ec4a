"""Table of event operators: syntax, semantics, explanations and documentation."""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List

import pytest
from events import operator_table
from fuzz.kinds import rules as fuzzed
from python_path import python_path

import retalis
from retalis.events.language.event_operators import EVENT_OPERATORS, PAIR_OPERATORS, OperatorKind
from retalis.events.streams.aggregates import sequence_aggregates

SOURCE = Path(retalis.__file__).parent
PAGES = Path(__file__).resolve().parents[3] / "docs" / "reference" / "language"
PAGE = (PAGES / "index.md").read_text(encoding="utf-8")
NO_OPERATORS = {"`E`", "`P seq prolog(G)`, `prolog(G) seq P`"}
"""Rows of the table of patterns that belong to no operator."""
LINK = re.compile(r"\[(.*)\]\([\w-]+\.md\)")


def table_rows(title: str) -> List[List[Any]]:
    """Return the rows of the table of this title, each a list of its cells."""
    lines = PAGE[PAGE.index(f"\n{title}\n") :].split("\n\n")[0].strip().split("\n")[2:]
    return [[LINK.sub(r"\1", cell) for cell in row[2:-2].split(" | ")] for row in lines]


def test_page_has_rows_of_all_patterns() -> None:
    assert sorted(map(tuple, table_rows("| pattern | is matched when | interval |"))) == sorted(
        [
            *(row for operator in EVENT_OPERATORS for row in operator.table_rows),
            *(
                tuple(row)
                for row in table_rows("| pattern | is matched when | interval |")
                if row[0] in NO_OPERATORS
            ),
        ]
    )


def test_each_operator_has_a_table_row() -> None:
    forms = " ".join(row.notation for operator in EVENT_OPERATORS for row in operator.table_rows)
    for operator in EVENT_OPERATORS:
        if operator.kind not in (OperatorKind.RULE, OperatorKind.UNSUPPORTED):
            assert re.search(rf"\b{operator.spellings[0]}\b", forms), operator.name


def test_page_has_priorities() -> None:
    expected: Dict[Any, Any] = {}
    for operator in EVENT_OPERATORS:
        if operator.priority and operator.kind is not OperatorKind.UNSUPPORTED:
            expected.setdefault(str(operator.priority), set()).update((operator.name, *operator.signs))
    priorities = {
        priority: re.findall(r"`([^`]+)`", names)
        for priority, names in table_rows("| priority | operators |")
    }
    priorities["1200"].remove(":")
    assert {
        priority: {name.strip("'") for name in names} for priority, names in priorities.items()
    } == expected


def test_page_names_aggregates() -> None:
    page = (PAGES / "repetition.md").read_text(encoding="utf-8")
    (aggregates,) = re.findall(r"The kinds of aggregate are (.*)\. `", page)
    assert re.findall(r"`([^`]+)`", aggregates) == [
        aggregate.notation for aggregate in sequence_aggregates().values()
    ]


def test_tests_cover_all_operators() -> None:
    """The tests have their own table of operators, as an independent definition."""
    names = {
        operator.spellings[0]
        for operator in EVENT_OPERATORS
        if operator.kind not in (OperatorKind.RULE, OperatorKind.UNSUPPORTED)
    }
    assert set(PAIR_OPERATORS) == set(operator_table.PAIRS)
    assert set(sequence_aggregates()) == set(operator_table.AGGREGATES)
    assert names <= {re.sub(r"\W.*", "", row) for row in operator_table.ROWS} | {
        "do",
        "aggregate",
        "with",
        "absent",
    }
    written = " ".join((*fuzzed.SIDES, *fuzzed.GOALS, *fuzzed.STREAMS, "do"))
    assert all(re.search(rf"\b{name}\b", written) for name in names)


NEW_OPERATOR = """    EventOperator(
        "straddles",
        OperatorKind.PAIR,
        1025,
        comparisons=("s1 < s2", "s2 < e1", "e1 < e2"),
        start="s1",
        end="e2",
        no_match_text="none of the first overlaps one of the second",
    ),
"""
FOLLOWING_OPERATOR = """    EventOperator("fnot","""
PROGRAM = """
import logging
import sys

from retalis import Engine, ProgramErrors
from retalis.explanation.event_explanations import explain, record_origins
from retalis.events.clock.clock import StreamClock
from retalis.prolog.terms.timestamps import SECOND; from retalis.prolog.terms.types import functor

EVENTS = (("a(1)", 1, 4), ("a(2)", 2, 5), ("b(3)", 3, 6), ("b(4)", 5, 6), ("a(5)", 0, 4), ("b(6)", 1, 5))
for policy in ("recent", "recent_2", "chronological", "chronological_2", "unrestricted"):
    engine = Engine(clock=StreamClock(1000 * SECOND))
    seen = []
    engine.on_event(lambda term, start, end: seen.append((engine.show(term), start // SECOND, end // SECOND)))
    goals = "set_etalis_flag(event_consumption_policy, %s)" % policy
    engine.load(goals=goals, rules="o(X, Y) <- a(X) 'STRADDLES' b(Y) where X > 0. p(X) <- a(X) straddles b(X).")
    for event in EVENTS:
        engine.event(*event)
    print(policy, *("%s@%d-%d" % one for one in seen if one[0][0] == "o"))

engine = Engine(clock=StreamClock(1000 * SECOND))
record_origins(engine)
engine.load(rules="p(X) <- a(X) straddles b(X).")
engine.event("a(7)", 1, 2)
engine.event("b(7)", 3, 4)
lines = explain(engine, (functor("p", 1), 7)).lines
print(*(line.strip() for one in lines for line in one.indented() if "straddles:" in line))

logging.basicConfig(stream=sys.stdout, format="%(message)s")
for rule in ("p <- a stradles b.", "p <- a besides b.", "straddles(X, Y) <- a(X, Y)."):
    try:
        engine.load(rules=rule)
    except ProgramErrors as errors:
        print(errors.errors[0].message)
"""
EXPECTED_OUTPUT = """\
recent o(2,3)@2-6 o(5,6)@0-5
recent_2 o(2,3)@2-6 o(5,6)@0-5
chronological o(1,3)@1-6 o(5,6)@0-5
chronological_2 o(1,3)@1-6 o(5,6)@0-5
unrestricted o(1,3)@1-6 o(2,3)@2-6 o(5,3)@0-6 o(5,6)@0-5
- straddles: none of the first overlaps one of the second
expected an operator or a full stop before "stradles"; did you mean "straddles"?
expected an operator or a full stop before "besides"; "besides" is not an operator; two patterns are joined with \
"or", "par", "and", "straddles", "seq", "forall_seq", "equals", "meets", "during", "starts" or "finishes"
text:1:1: no pattern can match this event: in patterns straddles is an operator, and is written after the \
arrow: Head <- Pattern where Goal
straddles(X, Y) <- a(X, Y).
^
"""


@pytest.mark.slow
def test_pair_operator_is_one_entry(tmp_path: Path) -> None:
    """An entry in the table suffices to parse, join, limit and explain the operator, under every policy."""
    package_copy = tmp_path / "retalis"
    shutil.copytree(str(SOURCE), str(package_copy), ignore=shutil.ignore_patterns("__pycache__"))
    path = package_copy / "events" / "language" / "event_operators.py"
    text = path.read_text(encoding="utf-8")
    assert text.count(FOLLOWING_OPERATOR) == 1
    path.write_text(text.replace(FOLLOWING_OPERATOR, NEW_OPERATOR + FOLLOWING_OPERATOR), encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={"PYTHONPATH": python_path(tmp_path), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.stderr == ""
    assert result.stdout == EXPECTED_OUTPUT


def test_prolog_reader_has_no_event_operators() -> None:
    program = (
        "from retalis.prolog.syntax.operators import Operators\n"
        "print('seq' in Operators.prolog(), 'mod' in Operators.prolog())\n"
        "import retalis\n"
        "print('seq' in retalis.Operators.prolog())\n"
    )
    env = {"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin"}
    result = subprocess.run(
        [sys.executable, "-c", program], env=env, capture_output=True, text=True, timeout=60, check=False
    )
    assert result.stderr == ""
    assert result.stdout == "False True\nTrue\n"
