"""Identities of matches, equal for the same event terms only, and their arrival numbers."""

import sys
from typing import Any, List

import pytest

from retalis import Engine, Var, atom, functor, make_list
from retalis.events.dispatch.matcher_compiler import unify_pattern
from retalis.events.matches.match_types import (
    EventMatch,
    Identity,
    OrderedEventMatch,
    PartialMatch,
    arrival_number_of,
    identity,
    unify_values,
)
from retalis.foundation.limit_checks import set_limit_check
from retalis.prolog.terms.types import deref


@pytest.mark.parametrize(
    "other",
    [
        Identity((1, Identity((2, "b")))),
        Identity((1, Identity((2, "a", 3)))),
        Identity((1, 2)),
        Identity((1,)),
        1,
    ],
)
def test_identities_of_different_parts_differ(other: Any) -> None:
    nested = Identity((1, Identity((2, "a"))))
    assert nested != other
    assert Identity((other, 1)) != Identity((nested, 1))


def test_identities_of_equal_parts_are_equal() -> None:
    first, second = (Identity((1, Identity((2, "a")))) for _ in range(2))
    assert first == second
    assert hash(first) == hash(second)


def nested_match(depth: int, name: str) -> PartialMatch:
    """Return a match whose first part has a first part, and so on, ``depth`` levels deep."""
    match = PartialMatch((), 0, 0, 1, atom(name), None)
    for level in range(1, depth):
        match = PartialMatch(
            (), 0, level, None, None, (match, PartialMatch((), level, level, 1, atom("b"), None))
        )
    return match


def test_identity_of_deep_match_needs_no_recursion() -> None:
    depth = 2 * sys.getrecursionlimit()
    assert identity(nested_match(depth, "a")) == identity(nested_match(depth, "a"))
    assert identity(nested_match(depth, "a")) != identity(nested_match(depth, "c"))


def test_match_without_parts_has_identity() -> None:
    assert identity(PartialMatch((), 0, 0, None, None, ())) == Identity(())


def test_untracked_match_has_arrival_number_zero() -> None:
    assert arrival_number_of(nested_match(3, "a")) == 0


@pytest.mark.parametrize(("short_class", "saved_slots"), [(EventMatch, 7), (OrderedEventMatch, 5)])
def test_match_of_event_takes_less_memory(short_class: Any, saved_slots: int) -> None:
    event, full = short_class(), PartialMatch((1,), 5, 5, None, ("a", 1), None)
    event.start = event.end = event.order = 5
    event.term = ("a", 1)
    assert (event.values, event.event, event.parts, event.consumed_by) == (full.values, None, None, None)
    assert identity(event) == event.identity == identity(full)
    assert sys.getsizeof(full) - sys.getsizeof(event) == 8 * saved_slots


def test_tracking_starts_with_stored_matches() -> None:
    engine = Engine()
    engine.load(
        goals="set_etalis_flag(event_consumption_policy, chronological)", rules="c(X, Y) <- a(X, Y) seq b(X)."
    )
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    rule = engine.rules.rules[0]
    # The second one has the time of the first, the third one the key of both.
    for event, instant in (("a(1,1)", 1), ("a(2,1)", 1), ("a(1,2)", 2)):
        engine.event(event, instant)
    assert [match.__class__ for match in rule.arrivals] == [EventMatch, OrderedEventMatch, EventMatch]
    orders = [match.order for match in rule.arrivals]
    assert orders == [10**9, 10**9 + 1, 2 * 10**9]
    engine.call("set_etalis_flag(revision_flag, on)")
    assert {match.__class__ for match in rule.arrivals} == {PartialMatch}
    assert [match.order for match in rule.arrivals] == orders
    for event, instant in (("b(1)", 3), ("b(1)", 4), ("b(2)", 5)):
        engine.event(event, instant)
    assert [event for event in events if event[0] == "c"] == ["c(1,1)", "c(1,2)", "c(2,1)"]
    assert not rule.stored_match_count


def test_match_of_instant_is_short() -> None:
    engine = Engine()
    engine.load(rules="c(X, Y) <- a(X, Y) seq b(X).")
    instant = 2 * 10**9
    engine.event_at(functor("a", 2)(1, 2), instant, instant)
    [match] = engine.rules.rules[0].arrivals
    assert match.__class__ is EventMatch
    assert match.start is match.end


@pytest.mark.parametrize(
    "unify_terms",
    [
        lambda event, pattern: unify_values((event,), (pattern,)),
        lambda event, pattern: unify_pattern(pattern, [], event),
    ],
    ids=["values", "pattern"],
)
def test_variables_of_event_are_unbound_after_limit(unify_terms: Any) -> None:
    class LimitExceeded(Exception):
        pass

    def raise_after_binding(work: int, size: int) -> None:
        if deref(event_variable) is not event_variable:
            raise LimitExceeded

    event_variable = Var()
    numbers = list(range(10_000))
    event, pattern = (
        functor("a", 2)(event_variable, make_list(numbers)),
        functor("a", 2)(1, make_list(numbers)),
    )
    previous = set_limit_check(raise_after_binding)
    try:
        with pytest.raises(LimitExceeded):
            unify_terms(event, pattern)
    finally:
        set_limit_check(previous)
    assert deref(event_variable) is event_variable
