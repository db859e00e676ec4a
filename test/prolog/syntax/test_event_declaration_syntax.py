"""The prefix ``event`` of declarations, which is an ordinary name elsewhere."""

from typing import Any

import pytest
from asserting_accessors import compound
from parsing import read_clauses

from retalis import Operators, SyntaxFault
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import writeq
from retalis.prolog.syntax.tokenizer import ReadFlags

OPERATORS = Operators.prolog()


def read(text: str, flags: Any = None) -> str:
    return writeq(read_term(text, OPERATORS, flags=flags or ReadFlags()).term, OPERATORS)


@pytest.mark.parametrize(
    ("text", "term"),
    [
        (":- event t(a:atom).", ":-declare_event(t(a:atom))"),
        ("?- event t.", "?-declare_event(t)"),
        ("event t(a:atom)", "declare_event(t(a:atom))"),
        (":- event t(a:list(number)), b.", ":-declare_event((t(a:list(number)),b))"),
        (":- event 'T one'.", ":-declare_event('T one')"),
    ],
)
def test_declaration_is_read_as_goal(text: str, term: str) -> None:
    assert read(text) == term


@pytest.mark.parametrize(
    "text",
    [
        "event(t(a:atom))",
        ":-event(t)",
        "event-x",
        "[event,x]",
        "event:t",
        ":-event",
        "event",
        "a:-event,b",
        "a<-event seq b",
    ],
)
def test_event_stays_an_ordinary_name_elsewhere(text: str) -> None:
    assert read(text) == text


@pytest.mark.parametrize(
    "text", ["a :- event t.", "X = (event t)", ":- a, event t.", ":- event T.", "event t <- b."]
)
def test_declaration_inside_term_is_refused(text: str) -> None:
    with pytest.raises(SyntaxFault, match="expected an operator"):
        read(text)


def test_constructed_event_is_no_declaration() -> None:
    with pytest.raises(SyntaxFault, match="expected an operator"):
        read("event t", ReadFlags(is_constructed=True))


def test_operator_of_program_has_precedence() -> None:
    operators = OPERATORS.copy()
    operators.add(700, "xfx", "near")
    assert writeq(read_term("event near a", operators).term, operators) == "event near a"


def test_parts_of_declaration_have_places() -> None:
    _, clause = read_clauses("x.\n  :- event t(a:atom, b:nubmer).", OPERATORS)
    declared = compound(clause.term)[1][1]
    assert [clause.place_of(declared, argument).column for argument in (0, 1, 2)] == [12, 14, 22]
