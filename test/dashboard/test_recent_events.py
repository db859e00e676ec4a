"""Recent events of the dashboard, limited in number, size and work."""

from typing import Any

import pytest

from retalis import Engine, Term, atom, explain, functor, make_list, record_origins
from retalis.dashboard.view_model import (
    MAX_EVENT_CHARACTERS,
    MAX_FUNCTORS,
    MAX_SHOWN_EVENTS,
    MAX_WRITTEN_PER_SNAPSHOT,
    RecentEvents,
    format_event_beginning,
)
from retalis.events.dispatch.argument_projection import NOT_READ
from retalis.prolog.terms.types import CONS, Lazy


@pytest.fixture
def engine() -> Any:
    engine = Engine()
    record_origins(engine)
    engine.load(rules="alarm(X) <- smoke(X) seq heat(X).")
    return engine


@pytest.fixture
def recent(engine: Any) -> Any:
    recent = RecentEvents(engine)
    recent.set_observing(True)
    return recent


def test_events_are_stored_while_observed(engine: Engine, recent: Any) -> None:
    engine.event("smoke(hall)", 1, 2)
    recent.set_observing(False)
    engine.event("heat(hall)", 3)
    (event,) = recent.take_latest()
    assert (event.text, event.whole, event.start, event.end) == ("smoke(hall)", True, 10**9, 2 * 10**9)
    assert recent.get_counts() == {"smoke/1": (1, 2 * 10**9)}


def test_rare_event_is_not_evicted_by_many(engine: Engine, recent: Any) -> None:
    engine.event("smoke(hall)", 1)
    for second in range(2, 1000):
        engine.event("tick", second)
    events = recent.take_latest()
    assert len(events) == 1 + MAX_WRITTEN_PER_SNAPSHOT
    assert events[-1].text == "smoke(hall)"
    assert recent.get_counts()["tick/0"].number_of_events == 998


def test_numbers_of_events_are_limited(engine: Engine, recent: Any) -> None:
    for number in range(3 * MAX_FUNCTORS):
        engine.event(f"e{number}(1)", number + 1)
    assert len(recent.take_latest()) == MAX_SHOWN_EVENTS
    assert len(recent.get_counts()) == MAX_FUNCTORS + 1
    assert recent.get_counts()["others"].number_of_events == 2 * MAX_FUNCTORS


@pytest.mark.parametrize(
    "term",
    [
        functor("f", 1)(make_list(range(100_000))),
        functor("f", 1)(atom("x" * 100_000)),
        functor("f", 1)(1 << 1_000_000),
        functor("f", 1_000)(*range(1_000)),
        functor("f", 1)(NOT_READ),
        functor("f", 1)(Lazy(CONS, lambda source: pytest.fail("it is made"), b"")),
    ],
)
def test_large_event_is_cut_without_decoding(engine: Any, term: Any) -> None:
    text, whole = format_event_beginning(engine.show, term)
    assert "..." in text
    assert len(text) <= MAX_EVENT_CHARACTERS + 3
    assert not whole


def test_deep_event_is_cut(engine: Any) -> None:
    term: Term = atom("deep")
    for _ in range(100_000):
        term = functor("f", 1)(term)
    text, whole = format_event_beginning(engine.show, term)
    assert text.endswith("..." + ")" * text.count("f("))
    assert not whole


@pytest.mark.parametrize("text", ["f(A,_,A)", "f([],[a|B])", "f('A b',\"text\",-1.5)", "atom", "1 + 2"])
def test_short_event_is_whole(engine: Engine, recent: Any, text: str) -> None:
    engine.event(text, 1)
    (event,) = recent.take_latest()
    assert event.whole
    assert engine.logic.once((functor("=@=", 2), engine.query(f"X = ({text})")[0]["X"], recent_term(recent)))


def recent_term(recent: Any) -> Any:
    return recent.find(recent.take_latest()[0].serial)[1]


def test_stored_event_can_be_explained(engine: Engine, recent: Any) -> None:
    engine.event("smoke(hall)", 1.000000001)
    engine.event("heat(hall)", 2)
    alarm = recent.take_latest()[0]
    assert explain(engine, recent.find(alarm.serial)).happened
    assert recent.find(alarm.serial + 1) is None
