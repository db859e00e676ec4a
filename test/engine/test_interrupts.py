"""Interrupts of a working engine: at safe points, and at any point."""

import signal
from typing import Any, List

import pytest
from recording_engine import RecordingEngine

from retalis import Engine, Limits, PrologError, UsageError, foreign, functor
from retalis.foundation.interrupts import Interrupt, deferred_interrupts, postpone

JOIN = "pair(X) <- a(X) seq b(X). out(X) <- pair(X). c <- a(_) seq b(_) where (stop, repeat, fail)."
PREDICATES = """
long(G) :- stop, repeat, G, fail.
deep(N) :- M is N + 1, deep(M).
"""


def make(rules: str = "", **limits: Any) -> RecordingEngine:
    """Return an engine with the goal ``stop``: an interrupt comes when it runs first, and later it fails."""
    engine = RecordingEngine(limits=Limits(**limits))
    interrupts = [Interrupt()]

    def stop(machine: Any) -> bool:
        if not interrupts:
            return False
        postpone(interrupts.pop())
        return True

    engine.logic.define("stop", 0, stop)
    engine.load(rules=PREDICATES + rules)
    return engine


@pytest.fixture(params=[{}, {"seconds": 60.0}], ids=["unlimited", "limited"])
def limits(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.mark.parametrize(
    "goal",
    [
        "stop, repeat, fail",
        "long(true)",
        "stop, deep(0)",
        "stop, between(1, inf, X), X < 0",
        "stop, findall(X, between(1, inf, X), _)",
        "stop, forall(repeat, true)",
        "stop, numlist(1, 1000000, L), sort(0, @>=, L, _), repeat, fail",
        "catch(long(true), _, true), repeat, fail",
        "stop, catch((repeat, fail), _, true), repeat, fail",
        "stop, setup_call_cleanup(true, (repeat, fail), (repeat, fail))",
        "stop, with_output_to(string(_), (repeat, fail))",
        "stop, new_event(never, 1, 1), aggregate_all(count, repeat, _)",
    ],
)
def test_goal_is_interrupted(goal: str, limits: Any, caplog: pytest.LogCaptureFixture) -> None:
    engine = make(**limits)
    with pytest.raises(Interrupt):
        engine.call(goal)
    assert caplog.text == ""
    assert engine.query("X = 1, \\+ fail") == [{"X": 1}]
    assert not engine.logic.machine.trail
    assert not engine.logic.machine.choices


@pytest.mark.parametrize("way", ["event", "post", "post_each"])
def test_event_is_interrupted_and_later_ones_are_not(
    way: str, limits: Any, caplog: pytest.LogCaptureFixture
) -> None:
    engine = make(JOIN, **limits)
    term = functor("b", 1)(1)
    ways = {
        "event": lambda: engine.event("b(1)", 2),
        "post": lambda: engine.post(term, 2_000_000_000),
        "post_each": lambda: engine.post_each([(term, 2_000_000_000)]),
    }
    engine.event("a(1)", 1)
    engine.event("a(2)", 1)
    with deferred_interrupts(), pytest.raises(Interrupt):
        ways[way]()
    assert caplog.text == ""
    del engine.events[:]
    engine.event("b(2)", 3)
    assert engine.event_texts == ["b(2)", "pair(2)", "out(2)"]


def test_chain_of_derived_events_is_interrupted() -> None:
    with deferred_interrupts():
        engine = make("n(Y) <- n(X) where (Y is X + 1, (X =:= 50 -> stop, repeat, fail ; true)).")
        with pytest.raises(Interrupt):
            engine.event("n(0)", 1)
    del engine.events[:]
    engine.event("n(40)", 2)
    assert engine.event_texts == [f"n({number})" for number in range(40, 51)]


def test_interrupted_alarm_leaves_later_alarms_due(caplog: pytest.LogCaptureFixture) -> None:
    engine = make("exceptionAlarm(late(X), 5) <- a(X). b <- late(1) where (stop, repeat, fail).")
    engine.event("a(1)", 1)
    engine.event("a(2)", 2)
    with pytest.raises(Interrupt):
        engine.event("tick", 10)
    del engine.events[:]
    engine.event("tick", 11)
    assert engine.event_texts == ["late(2)", "tick"]
    assert caplog.text == ""


def test_load_is_interrupted_and_undone() -> None:
    engine = make("old <- a.")
    rules = "new <- a.\n:- stop.\n:- repeat, fail.\n"
    with pytest.raises(Interrupt):
        engine.load(rules=rules)
    assert [rule.name for rule in engine.rules.rules] == ["old"]
    with pytest.raises(PrologError):
        engine.call("new")
    engine.load(rules="new <- a.")
    engine.event("a", 1)
    assert engine.event_texts == ["a", "old", "new"]


@pytest.mark.parametrize("exception", [KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("kind", ["on_event", "on_output", "foreign"])
def test_exception_of_callback_ends_event(
    kind: str, exception: Any, caplog: pytest.LogCaptureFixture
) -> None:
    engine = RecordingEngine()
    calls: List[Any] = []

    def fail(*arguments: Any) -> None:
        calls.append(arguments)
        if len(calls) == 1:
            raise exception

    if kind == "on_event":
        engine.on_event(fail)
    elif kind == "on_output":
        engine.on_output(fail)
    else:
        engine.add_foreign(foreign(name="failing", outputs=0)(lambda: fail()))
    engine.load(
        rules="b <- a where failing. c <- a." if kind == "foreign" else "c <- a.",
        goals="subscribe(a, [], _, out, s)",
    )
    with pytest.raises(exception):
        engine.event("a", 1)
    assert caplog.text == ""
    del engine.events[:]
    engine.event("a", 2)
    assert engine.event_texts[0] == "a"
    assert "c" in engine.event_texts


def test_callback_of_nested_call_ends_outer_event() -> None:
    engine = make()
    engine.on_output(lambda term, topic, name: engine.call("long(true)"))
    engine.load(goals="subscribe(a, [], _, out, s)")
    with pytest.raises(Interrupt):
        engine.event("a", 1)
    assert engine.dispatcher.current is None
    del engine.events[:]
    engine.event("b", 2)
    assert engine.event_texts == ["b"]


def test_exception_at_any_point_makes_engine_unusable() -> None:
    engine = Engine()
    engine.load(rules="b <- a.")
    state = engine.snapshot()

    def interrupt(machine: Any) -> bool:
        signal.default_int_handler(signal.SIGINT, None)

    engine.logic.define("interrupt", 0, interrupt)
    with pytest.raises(KeyboardInterrupt):
        engine.call("interrupt")
    for use in (
        lambda: engine.event("a", 1),
        lambda: engine.call("true"),
        engine.snapshot,
        lambda: engine.load(rules="c <- a."),
    ):
        with pytest.raises(UsageError, match="continue with a new engine"):
            use()
    events: List[Any] = []
    restored = Engine.restore(state)
    restored.on_event(lambda term, start, end: events.append(restored.show(term)))
    restored.event("a", 1)
    assert events == ["a", "b"]
