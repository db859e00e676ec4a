"""Limits of an event: they include derived work; goals beyond them are refused, counted and reported once."""

from pathlib import Path
from typing import Any, List, Optional

import pytest
from asserting_accessors import stream_clock

from retalis import Engine, Limits, PrologError, Settings, functor
from retalis.foundation.interrupts import Interrupt, postpone
from retalis.prolog.machine import resource_limits

RULES = """
loop :- loop.
count(0).
count(N) :- N > 0, M is N - 1, count(M).
"""
SUBSCRIPTION_COUNT = 200


class RecordingEngine(Engine):
    """An engine that records its events and outputs as text."""

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings=settings)
        self.events: List[str] = []
        self.outputs: List[str] = []
        self.on_event(lambda term, start, end: self.events.append(self.show(term)))
        self.on_output(lambda term, topic, name: self.outputs.append(self.show(term)))


def make(
    rules: str = "", goals: str = "", settings: Optional[Settings] = None, **limits: Any
) -> RecordingEngine:
    engine = RecordingEngine(settings or Settings(limits=Limits(**limits)))
    engine.load_rules(RULES + rules)
    engine.load(goals=goals)
    return engine


def inferences_of(engine: Any, work: Any) -> Any:
    """Return the number of inferences of a function."""
    before = engine.logic.machine.budget.inferences
    work()
    return engine.logic.machine.budget.inferences - before


def subscriptions(conditions: str, count: Any = SUBSCRIPTION_COUNT) -> str:
    return "\n".join(f"subscribe(in(_), [{conditions}], _, out, s{index})" for index in range(count))


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> List[float]:
    """Replace the clock by one that advances by a millisecond with each call; return its time in a list."""
    now = [0.0]

    def tick() -> float:
        now[0] += 0.001
        return now[0]

    monkeypatch.setattr(resource_limits, "monotonic", tick)
    return now


def test_endless_conditions_share_inferences(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(goals=subscriptions("loop"), inferences=100_000)
    assert inferences_of(engine, lambda: engine.event("in(1)", 1)) < 2 * 100_000
    assert caplog.text.count("Not enough resources: inferences") == 1
    assert "subscription s0" in caplog.text
    assert (
        f"in/1 has exceeded its limit of inferences; goals refused: {SUBSCRIPTION_COUNT - 1}" in caplog.text
    )


def test_endless_conditions_share_seconds(ticking: List[float], caplog: pytest.LogCaptureFixture) -> None:
    engine = make(goals=subscriptions("loop"), seconds=0.5)
    engine.event("in(1)", 1)
    assert ticking[0] < 4 * 0.5  # other threads may read this clock, too
    assert f"in/1 has exceeded its limit of seconds; goals refused: {SUBSCRIPTION_COUNT - 1}" in caplog.text


@pytest.mark.parametrize("condition", ["catch(loop, _, true)", "\\+ catch(loop, _, fail)", "ignore(loop)"])
def test_conditions_that_catch_limit_share_it(condition: str, caplog: pytest.LogCaptureFixture) -> None:
    engine = make(goals=subscriptions(condition), inferences=100_000)
    assert inferences_of(engine, lambda: engine.event("in(1)", 1)) < 2 * 100_000
    assert "in/1 has exceeded its limit of inferences; goals refused: " in caplog.text


def test_short_goals_share_inferences_of_event(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(goals=subscriptions("count(300)"), inferences=20_000)
    assert inferences_of(engine, lambda: engine.event("in(1)", 1)) < 2 * 20_000
    assert 10 < len(engine.outputs) < 100
    assert "in/1 has exceeded its limit of inferences; goals refused: " in caplog.text


def test_next_event_has_own_limits(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(goals=subscriptions("(loop ; true)", 3), inferences=50_000)
    for _ in range(2):
        caplog.clear()
        engine.event("in(1)", 1)
        assert "goals refused: 2" in caplog.text
    caplog.clear()
    engine.event("other", 2)
    assert engine.call("count(10000)")
    assert caplog.text == ""


def test_each_posted_event_has_own_limits() -> None:
    engine = make(goals=subscriptions("count(10000)", 1), inferences=30_000)
    for number in range(5):
        engine.post(functor("in", 1)(number), number)
    assert len(engine.outputs) == 5


def test_derived_work_shares_limits_of_event(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(
        rules="""
        a(X) <- in(X) where count(30000).
        b(X) <- a(X) where count(30000).
        null_event do count(30000) <- b(X).
        synchronized(c(X), count(30000), []) <- b(X).
        synchronized(d(X), count(30000), []) <- b(X).
        """,
        inferences=100_000,
    )
    engine.event("in(1)", 1)
    assert "a(1)" in engine.events
    assert "b(1)" in engine.events
    assert "d(1)" not in engine.events
    assert caplog.text.count("Not enough resources: inferences") == 1


def test_goals_of_long_chain_are_refused(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(
        rules="tick(N) <- tick(M) where (N is M + 1, M < 20).\n" + "x(M) <- tick(M) where loop.\n" * 3,
        inferences=50_000,
    )
    assert inferences_of(engine, lambda: engine.event("tick(0)", 1)) < 2 * 50_000
    assert caplog.text.count("Not enough resources") == 1
    assert "tick/1 has exceeded its limit of inferences; goals refused" in caplog.text


@pytest.mark.slow
def test_endless_branching_without_goals_ends(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(rules="tick <- tick.\ntick <- tick.", inferences=50_000)
    engine.event("tick", 1)
    assert "tick has exceeded its limit of inferences while patterns were matched" in caplog.text
    engine.event("other", 2)
    assert engine.events[-1] == "other"


def test_patterns_match_after_goals_are_refused(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(
        rules="bad(X) <- in(X) where loop.\nworse(X) <- in(X) where loop.\npair(X, Y) <- in(X) seq in(Y).",
        goals="memorize(in(X), [], in(X), m, 10)",
        inferences=50_000,
    )
    for number in (1, 2):
        engine.event(f"in({number})", number)
    assert "pair(1,2)" in engine.events
    assert engine.call("memory_counter(m, 2)")
    assert caplog.text.count("goals refused: 1") == 2


def test_limit_set_by_goal_does_not_affect_others(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(
        goals="subscribe(in(_), [call_with_inference_limit(loop, 5000, _)], _, out, a)\n"
        "subscribe(in(_), [catch(call_with_time_limit(0.01, loop), _, true)], _, out, b)\n"
        "subscribe(in(_), [count(1000)], _, out, c)",
        inferences=100_000_000,
    )
    engine.event("in(1)", 1)
    assert engine.outputs == ["in(1)"] * 3
    assert caplog.text == ""


def test_alarm_has_own_limits(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(
        rules="exceptionAlarm(late(X), 5) <- start(X).\nout(X) <- late(X) where count(15000).\n"
        "out(X) <- in(X) where count(15000).",
        inferences=20_000,
    )
    engine.event("start(1)", 1)
    stream_clock(engine).move_to(10 * 10**9)
    engine.event("in(2)", 10)
    assert [event for event in engine.events if event.startswith("out")] == ["out(1)", "out(2)"]
    assert caplog.text == ""


def test_alarm_within_goal_does_not_use_its_limit(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(
        rules="exceptionAlarm(late(X), 5) <- start(X).\nout(X) <- late(X) where loop.",
        inferences=20_000,
    )
    engine.event("start(1)", 1)
    stream_clock(engine).move_to(10 * 10**9)

    def ring(machine: Any) -> bool:
        engine.event("tick", 10)
        return True

    engine.logic.define("ring", 0, ring)
    assert engine.call("count(10000), ring, count(5000)")
    assert caplog.text.count("Not enough resources: inferences") == 1


def test_initial_goals_may_have_no_limit(tmp_path: Path) -> None:
    (tmp_path / "rules.txt").write_text(RULES)
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\ncount(50000)\n")
    limits = Limits(inferences=20_000)
    engine = Engine(settings=Settings(limits=limits, limit_start=False))
    engine.load_program(tmp_path)
    assert engine.logic.limits == limits
    with pytest.raises(PrologError, match="inferences"):
        engine.call("count(50000)")


def test_repeated_exceptions_are_limited() -> None:
    engine = make(rules="again :- catch(throw(x), _, true), again.", inferences=50_000)
    with pytest.raises(PrologError, match="inferences"):
        engine.call("again")


def test_interrupt_does_not_use_limit_of_next_event() -> None:
    engine = make(goals=subscriptions("count(10000)", 1), inferences=30_000)

    def interrupt(machine: Any) -> bool:
        postpone(Interrupt())
        return True

    engine.logic.define("interrupt", 0, interrupt)
    for number in range(3):
        with pytest.raises(Interrupt):
            engine.call("count(20000), interrupt, repeat, fail")
        engine.event(f"in({number})", number)
    assert len(engine.outputs) == 3
    assert engine.logic.machine.budget.goal is None


NESTED = """
tidy_in_vain :- repeat, once(call_cleanup(member(_, [1,2]), loop)), fail.
deep(0) :- loop.
deep(N) :- N > 0, M is N - 1, call_cleanup(deep(M), loop).
twice(0).
twice(N) :- N > 0, M is N - 1, tidied(M), tidied(M).
tidied(N) :- once(call_cleanup(member(_, [1,2]), twice(N))).
portray(N) :- integer(N), N > 0, M is N - 1, print(M), print(M).
written(0).
written(N) :- N > 0, M is N - 1, format("~@~@", [written(M), written(M)]).
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "goal", ["tidy_in_vain", "deep(100)", "catch(deep(100), _, true), loop", "print(30)", "written(30)"]
)
def test_nested_goal_cannot_extend_limit(goal: str) -> None:
    engine = make(NESTED, inferences=20_000)
    engine.logic.output = engine.logic.error_output = lambda text: None
    with pytest.raises(PrologError, match="resources: inferences"):
        engine.call(goal)
    assert engine.logic.machine.budget.inferences < 10 * 20_000


def test_nested_short_cleanups_are_limited() -> None:
    engine = make(NESTED, inferences=20_000)
    warnings: List[Any] = []
    engine.logic.error_output = warnings.append
    engine.call("twice(30)")
    assert "".join(warnings) == "Warning: cleanup: Not enough resources: inferences\n"


def test_short_cleanups_run_after_final_limit() -> None:
    engine = make(
        ":- dynamic(tidied/1). in(0) :- loop. in(N) :- M is N - 1, call_cleanup(in(M), assertz(tidied(N))).",
        inferences=20_000,
    )
    with pytest.raises(PrologError, match="resources: inferences"):
        engine.call("catch(loop, _, true), in(20)")
    assert len(engine.query("tidied(_)")) == 20


def test_captured_output_of_nested_goal_is_limited() -> None:
    engine = make()
    with pytest.raises(PrologError, match="resources: memory"):
        engine.call("format(atom(A), '~*c', [1000000, 0'a]), format('~@', [(repeat, write(A), fail)])")
