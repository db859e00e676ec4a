"""Declarations of states."""

from typing import Optional

import pytest
from parsing import parse_term

from retalis import UsageError
from retalis.events.language.state_parser import declares_state, parse_state_declaration, queried_state
from retalis.prolog.terms.timestamps import SECOND


def test_declaration_names_begin_and_end() -> None:
    form = parse_state_declaration(parse_term("state(at(R, P), from(arrive(R, P)), until(leave(R)))"))
    assert (form.max_duration, form.max_past, form.max_open) == (None, 1000, 10_000)
    assert str(form.functor) == "at/2"
    same = parse_state_declaration(parse_term("state(at(X, Y), from(come(X, Y, _)), until(all_out))"))
    assert same.key == form.key
    form = parse_state_declaration(
        parse_term("state(on, from(go), until(stop), [open(1), within(2.5), past(0)])")
    )
    assert (form.max_duration, form.max_past, form.max_open) == (int(2.5 * SECOND), 0, 1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("state(s, b, c)", "expected state(S, from(Event), until(Event))"),
        ("state(s, from(b), till(c))", "expected state(S, from(Event), until(Event))"),
        ("state(s, from(b, c), until(d))", "expected state(S, from(Event), until(Event))"),
        ("state(S, from(b), until(c))", "a state is an event: an atom or a compound term"),
        ("state(3, from(b), until(c))", "a state is an event"),
        ("state(s, from(X), until(c))", "the argument of from(...) is an event"),
        ("state(s, from(b), until((c, d)))", "the argument of until(...) is a single event"),
        ("state(s, from(seq(a, b)), until(c))", "the argument of from(...) is a single event"),
        ("state(s(X), from(b(_)), until(c(X)))", "each variable of the state must occur in from(...)"),
        ("state(s(X), from(s(X)), until(c))", "cannot begin or end with events of its own name"),
        ("state(s, from(b), until(c), all)", "expected a list of options"),
        ("state(s, from(b), until(c), [wihin(3)])", "the options are within(Seconds), past(Number)"),
        ("state(s, from(b), until(c), [within(0)])", "within(Seconds) needs a number of seconds above 0"),
        ("state(s, from(b), until(c), [within(X)])", "within(Seconds) needs a number"),
        ("state(s, from(b), until(c), [past(-1)])", "past(Number) needs an integer from 0 to"),
        ("state(s, from(b), until(c), [open(1.0)])", "open(Number) needs an integer from 1 to"),
    ],
)
def test_error_of_declaration_names_expected_form(text: str, message: str) -> None:
    with pytest.raises(UsageError) as raised:
        parse_state_declaration(parse_term(text))
    assert message in raised.value.message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("state(a, from(b), c)", True),
        ("state(a, b, c)", False),
        ("state(a, X, Y, Z)", False),
        ("state", False),
    ],
)
def test_declarations_are_distinguished_from_facts(text: str, expected: bool) -> None:
    assert declares_state(parse_term(text)) is expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [("holds(a)", "a/0"), ("holds_at(a(X), 1)", "a/1"), ("holds(X, T)", None), ("held(a)", None)],
)
def test_query_goals_name_state(text: str, expected: Optional[str]) -> None:
    state = queried_state(parse_term(text))
    assert (state and str(state)) == expected
