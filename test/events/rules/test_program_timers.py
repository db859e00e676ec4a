"""Timers: events at instants that the clock reaches."""

import logging
from typing import Any, List

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_calls import recording

from retalis import Engine, ProgramErrors, PrologError, RetalisError, StreamClock
from retalis.events.rules import program_timers
from retalis.prolog.terms.timestamps import SECOND
from retalis.prolog.terms.unification import may_unify


class TimerEngine(Engine):
    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.events: List[Any] = []
        self.on_event(self._record_event)

    def _record_event(self, term: Any, start: Any, end: Any) -> None:
        assert start == end or self.show(term) not in ("tick", "a", "b")
        self.events.append((self.show(term), end / SECOND))

    def feed(self, *instants: Any) -> List[Any]:
        """Process an event at each instant; return all events."""
        self.events.clear()
        for instant in instants:
            self.event("e", instant)
        return list(self.events)

    def timers(self) -> str:
        (answer,) = self.query("timers(L)")
        return self.show(answer["L"])


def load_engine(goals: str = "", rules: str = "", clock: Any = None) -> TimerEngine:
    engine = TimerEngine(clock)
    engine.load(rules=rules, goals=goals)
    return engine


@pytest.mark.parametrize(
    ("schedule", "expected_instants"),
    [
        ("every(2)", [2, 4, 6]),
        ("every(2, from_now)", [3, 5]),
        ("after(2.5)", [3.5]),
        ("at(4)", [4]),
        ("at(datime(1970,1,1,0,0,4,0))", [4]),
        ("at(0, 0, 3)", [3]),
        ("at(0, 0, 1)", []),
    ],
)
def test_timer_emits_events_at_its_instants(schedule: str, expected_instants: Any) -> None:
    engine = load_engine(f"timer(tick, {schedule})")
    assert ", waits)" in engine.timers().replace(",waits", ", waits")
    assert engine.feed(1, 6.5) == [
        ("e", 1),
        *(("tick", instant) for instant in expected_instants),
        ("e", 6.5),
    ]


def test_timer_precedes_event_of_same_instant() -> None:
    engine = load_engine("timer(tick, every(5))", "exceptionAlarm(late, 5) <- a.\nboth <- tick equals e.")
    engine.feed(1)
    engine.event("a", 5)
    assert engine.events[1:] == [("tick", 5), ("a", 5)]
    assert engine.feed(10) == [("tick", 10), ("late", 10), ("e", 10), ("both", 10)]


def test_patterns_match_events_of_timers() -> None:
    engine = load_engine("timer(tick, every(10))", "quiet <- (tick seq tick) cnot e.")
    assert engine.feed(1, 29) == [
        ("e", 1),
        ("tick", 10),
        ("tick", 20),
        ("quiet", 20),
        ("e", 29),
    ]


def test_rules_and_directives_set_and_cancel_timers() -> None:
    rules = """
    :- timer(tick, every(4)).
    null do timer(gone(X), after(3)) <- seen(X).
    null do cancel_timer(tick, N), event(cancelled(N)) <- gone(b).
    """
    engine = load_engine(rules=rules)
    engine.event("seen(a)", 1)
    engine.event("seen(b)", 2)
    engine.event("seen(a)", 3)
    timer_events = [event for event in engine.feed(20) if not event[0].startswith(("null", "seen"))]
    assert timer_events == [
        ("tick", 4),
        ("gone(b)", 5),
        ("cancelled(1)", timer_events[2][1]),
        ("gone(a)", 6),
        ("e", 20),
    ]


def test_cancel_removes_unifying_timers() -> None:
    engine = load_engine(
        "timer(a(1), every(2))\ntimer(a(2), every(2))\ntimer(a(2), every(3))\ntimer(b, every(5))"
    )
    assert engine.query("cancel_timer(a(2), N)") == [{"N": 2}]
    assert engine.call("cancel_timer(nothing)")
    assert engine.query("cancel_timer(a(_), N)") == [{"N": 1}]
    assert engine.timers() == "[timer(b,every(5),waits)]"
    assert engine.feed(1, 9) == [("e", 1), ("b", 5), ("e", 9)]
    assert engine.timers() == "[timer(b,every(5),datime(1970,1,1,0,0,10,0))]"
    engine.call("reset_etalis")
    assert engine.timers() == "[]"
    assert engine.feed(30) == [("e", 30)]


def test_cancel_compares_candidates_only(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: List[Any] = []
    monkeypatch.setattr(program_timers, "may_unify", recording(compared, may_unify))
    engine = load_engine("\n".join(f"timer(a({number}, b), after(9))" for number in range(50)))
    engine.load(goals="timer(a(_, c), after(9))\ntimer(a(_, b), after(9))")
    assert engine.query("cancel_timer(a(7, b), N)") == [{"N": 2}]
    assert len(compared) == 2, "the timers with variables"
    assert engine.query("cancel_timer(a(7, b), N)") == [{"N": 0}]
    assert engine.query("cancel_timer(a(8, X), N)")[0]["N"] == 2
    assert engine.query("cancel_timer(_, N)")[0]["N"] == 48


def test_cancel_by_pattern_compares_events_of_first_argument(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: List[Any] = []
    monkeypatch.setattr(program_timers, "may_unify", recording(compared, may_unify))
    engine = load_engine("\n".join(f"timer(a({number}, f(b)), after(9))" for number in range(50)))
    engine.load(goals="timer(a(_, f(c)), after(9))\ntimer(a, after(9))\ntimer(b(7, f(b)), after(9))")
    assert engine.query("cancel_timer(a(7, f(X)), N)")[0]["N"] == 2
    assert len(compared) == 2
    assert engine.query("cancel_timer(a(X, f(b)), N)")[0]["N"] == 49
    assert engine.query("cancel_timer(a, N)") == [{"N": 1}]
    assert engine.query("cancel_timer(c(_), N)")[0]["N"] == 0
    assert engine.query("cancel_timer(_, N)")[0]["N"] == 1


@pytest.mark.parametrize(
    "goal", ["timer(3, every(1))", "timer(a, evry(1))", "timer(_, every(1))", "timer(a, _)"]
)
def test_invalid_timer_is_refused(goal: str) -> None:
    with pytest.raises(PrologError):
        load_engine().call(goal)
    with pytest.raises(ProgramErrors):
        load_engine(goal)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.integers(1, 40), min_size=1, max_size=10),
    st.sampled_from(["every(3)", "every(7, from_now)", "after(4)", "at(0, 0, 20)"]),
)
def test_instants_are_independent_of_clock_steps(steps: List[Any], schedule: Any) -> None:
    instants = [sum(steps[: number + 1]) for number in range(len(steps))]
    first, last = instants[0], instants[-1]
    expected = {
        "every(3)": [instant for instant in range(first + 1, last + 1) if instant % 3 == 0],
        "every(7, from_now)": list(range(first + 7, last + 1, 7)),
        "after(4)": [first + 4] if first + 4 <= last else [],
        "at(0, 0, 20)": [20] if first < 20 <= last else [],
    }
    events = load_engine(f"timer(tick, {schedule})").feed(*instants)
    assert [instant for event, instant in events if event == "tick"] == expected[schedule]
    assert [instant for _, instant in events] == sorted(instant for _, instant in events), (
        "events are in order"
    )


@pytest.mark.parametrize(
    ("rule", "instant"),
    [
        ("exceptionAlarm(rung, 5) <- a.", 6),
        ("rung <- aggregate(count, a, _, every(10)).", 10),
        ("rung <- a with debounce(7).", 8),
        (":- timer(rung, after(6)).", 7),
        (":- state(rung, from(a), until(b), [within(9)]).", 10),
    ],
)
def test_timers_set_by_deadline_count_from_its_instant(rule: str, instant: int) -> None:
    rules = (
        rule + "\nnull do timer(later, after(3)) <- rung.\nnull do timer(tick, every(4, from_now)) <- rung."
    )
    engine = load_engine(rules=rules)
    engine.event("a", 1)
    events = [event for event in engine.feed(instant + 10) if event[0] in ("later", "tick")]
    assert events == [("later", instant + 3), ("tick", instant + 4), ("tick", instant + 8)]


def test_recursive_timer_fires_boundedly_after_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program_timers, "MAX_FIRINGS_PER_JUMP", 100)
    engine = load_engine(rules=":- timer(t, after(1)).\nnull do timer(t, after(1)) <- t.")
    engine.feed(0.5)
    assert [instant for term, instant in engine.feed(50) if term == "t"] == [
        number + 0.5 for number in range(1, 50)
    ]
    instants = [instant for term, instant in engine.feed(1000, 1001.5) if term == "t"]
    assert len(instants) < 110
    assert instants[-1] == 1001


def test_timer_in_the_past_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    engine = load_engine("timer(a, at(2))")
    engine.feed(5)
    assert engine.call("timer(b, at(3))")
    assert engine.timers() == "[]"
    messages = [record.getMessage() for record in caplog.records]
    assert messages == ["timer a, at(2): that instant has passed", "timer b, at(3): that instant has passed"]


def test_periodic_timer_fires_boundedly_after_jump(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(program_timers, "MAX_FIRINGS_PER_JUMP", 100)
    engine = load_engine("timer(t, every(1))")
    engine.feed(0.5)
    assert len(engine.feed(100.5)) == 101
    assert not caplog.records
    assert engine.feed(1000) == [("t", 1000), ("e", 1000)]
    (record,) = caplog.records
    assert "899 events of timer t, every(1) left out; 899 of all timers so far" in record.getMessage()
    assert engine.feed(1001.5) == [("t", 1001), ("e", 1001.5)]


def test_event_of_timer_has_fresh_variables() -> None:
    engine = load_engine("timer(a(X, X), every(1))", "pair(Y, Z) <- a(1, Y) seq a(2, Z).")
    engine.feed(0.5, 3)
    assert [event for event, _ in engine.events if event.startswith("pair")] == ["pair(1,2)"] * 2


def test_periodic_timers_follow_clock_back() -> None:
    clock = StreamClock()
    engine = load_engine(
        "timer(a, every(3))\ntimer(b, every(3, from_now))\ntimer(c, after(50))\ntimer(d, at(33))", clock=clock
    )

    def move(second: int) -> Any:
        engine.events.clear()
        clock.move_to(second * SECOND, back=True)
        engine.advance()
        return engine.events

    assert move(20) == []
    assert move(25) == [("a", 21), ("b", 23), ("a", 24)]
    assert move(2) == []
    assert move(8) == [("a", 3), ("b", 5), ("a", 6), ("b", 8)]
    assert [event for event in move(80) if event[0] in "cd"] == [("d", 33)]


def test_cancelled_timers_leave_clock() -> None:
    engine = load_engine("timer(keep, every(1000))")
    engine.feed(1)
    for number in range(500):
        engine.call(f"timer(a({number}), after(5000))")
        engine.call(f"cancel_timer(a({number}))")
        engine.call("timer(b, after(2000))")
    assert len(engine.clock.alarms) < 50
    assert engine.feed(2500)[:2] == [("keep", 1000), ("keep", 2000)]
    assert engine.events[2] == ("b", 2001)


def test_number_of_timers_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program_timers, "MAX_TIMERS", 100)
    engine = load_engine()
    assert engine.call("forall(between(1, 100, N), timer(a(N), after(N)))")
    with pytest.raises(RetalisError, match="timers"):
        engine.call("timer(b, after(1))")
    assert engine.call("timer(a(1), after(1))"), "the timer exists already"


def test_timers_are_restored() -> None:
    engine = load_engine("timer(a, every(2))\ntimer(b, after(7))\ntimer(c, every(3, from_now))")
    restored = TimerEngine.restore(engine.snapshot())
    assert engine.feed(1, 5) == restored.feed(1, 5)
    restored_later = TimerEngine.restore(engine.snapshot())
    assert restored_later.status().alarms == 3
    events = engine.feed(9, 30)
    assert [event for event, _ in events].count("b") == 1
    assert restored_later.feed(9, 30) == events


def test_status_counts_timers_with_alarms() -> None:
    engine = load_engine("timer(a, every(2))")
    assert (engine.status().alarms, engine.status().next_alarm) == (1, None)
    engine.feed(1)
    assert (engine.status().alarms, engine.status().next_alarm) == (1, 2 * SECOND)


@pytest.mark.parametrize("timer", ["timer(tick(left), every(1))", "timer(tick, every(1))"])
def test_event_of_timer_is_checked_against_declaration(timer: str) -> None:
    declared = ":- event tick(count:number).\n"
    engine = TimerEngine()
    with pytest.raises(ProgramErrors, match="tick"):
        engine.load(rules=f"{declared}:- {timer}.")
    assert engine.timers() == "[]"
    engine.load(rules=declared)
    with pytest.raises(ProgramErrors, match="tick"):
        engine.load(goals=timer)
    assert engine.timers() == "[]"


class TestNames:
    """Uses of the names of timer predicates by programs."""

    def test_facts_of_program_replace_predicate(self) -> None:
        engine = load_engine(rules="timer(kitchen, 5).\ntimers(many).\nout(X) <- e where timer(kitchen, X).")
        assert engine.feed(1) == [("e", 1), ("out(5)", 1)]

    def test_goal_without_arrow_is_refused(self) -> None:
        with pytest.raises(ProgramErrors, match="write :- before a goal"):
            load_engine(rules="timer(tick, every(5)).")

    def test_event_may_be_named_timer(self, caplog: pytest.LogCaptureFixture) -> None:
        with caplog.at_level(logging.WARNING):
            engine = load_engine(rules="out(X) <- timer(X, 5).")
        engine.event("timer(a, 5)", 1)
        assert engine.events[1] == ("out(a)", 1)
        assert not caplog.records
