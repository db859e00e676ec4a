"""The word ``event`` before a declaration, which is no operator anywhere else."""

import pytest

from retalis import Operators, SyntaxFault
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import writeq
from retalis.prolog.syntax.tokenizer import ReadFlags

OPERATORS = Operators.prolog()


def read(text, flags=None):
    return writeq(read_term(text, OPERATORS, flags=flags or ReadFlags()).term, OPERATORS)


@pytest.mark.parametrize(
    "text, term",
    [
        (":- event t(a:atom).", ":-declare_event(t(a:atom))"),
        ("?- event t.", "?-declare_event(t)"),
        ("event t(a:atom)", "declare_event(t(a:atom))"),
        (":- event t(a:list(number)), b.", ":-declare_event((t(a:list(number)),b))"),
        (":- event 'T one'.", ":-declare_event('T one')"),
    ],
)
def test_it_is_read_as_a_goal(text, term):
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
def test_what_was_read_before_reads_as_before(text):
    assert read(text) == text


@pytest.mark.parametrize(
    "text", ["a :- event t.", "X = (event t)", ":- a, event t.", ":- event T.", "event t <- b."]
)
def test_elsewhere_an_operator_is_missing(text):
    with pytest.raises(SyntaxFault, match="expected an operator"):
        read(text)


def test_no_event_is_a_declaration():
    with pytest.raises(SyntaxFault, match="expected an operator"):
        read("event t", ReadFlags(is_constructed=True))


def test_an_operator_of_the_program_goes_first():
    operators = OPERATORS.copy()
    operators.add(700, "xfx", "near")
    assert writeq(read_term("event near a", operators).term, operators) == "event near a"


def test_parts_have_places():
    _, found = read_program("x.\n  :- event t(a:atom, b:nubmer).", OPERATORS)
    declared = found.term[1][1]
    assert [found.place_of(declared, at).column for at in (0, 1, 2)] == [12, 14, 22]
