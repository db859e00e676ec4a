"""Watchdog: warnings about long entries, and time limits."""

import gc
import threading
from pathlib import Path
from typing import Any, List, Optional, Tuple

import pytest
from asserting_accessors import fail

from retalis import Engine, Limits, Settings, atom, functor
from retalis.engine.runtime import watchdog as watchdog_module
from retalis.engine.runtime.serial_executor import SerialExecutor
from retalis.engine.runtime.watchdog import RunningWork, Watchdog, describe_work
from retalis.prolog.machine.resource_limits import Budget, LimitError


class Executor(SerialExecutor):
    """An executor whose entries a test begins and ends, and which runs no work."""

    def __init__(self) -> None:
        super().__init__(10, fail, fail)

    def begin(self, *entry: Any) -> None:
        self._working_thread, self.entry = threading.get_ident(), entry

    def end(self) -> None:
        self._working_thread = None

    def call_next(self, work: Any) -> None:
        pass


class RecordingWatchdog(Watchdog):
    """A watchdog that warns after 1 s and ends entries after 10 s, with its warnings."""

    def __init__(self, executor: Executor) -> None:
        self.budget = Budget(Limits(seconds=10.0), executor)
        self.warned: List[Any] = []
        super().__init__(executor, self.budget, 1.0, lambda *warning: self.warned.append(warning))


@pytest.fixture
def executor() -> Executor:
    return Executor()


@pytest.fixture
def watched(executor: Executor) -> RecordingWatchdog:
    return RecordingWatchdog(executor)


def test_warnings_of_long_entry_double_in_interval(executor: Executor, watched: RecordingWatchdog) -> None:
    executor.begin("a")
    for instant in (0.0, 0.5, 1.1, 1.3, 1.9, 2.2, 3.0, 4.5, 5.0):
        watched.sample(instant)
    assert watched.warned == [(1.1, ("a",)), (2.2, ("a",)), (4.5, ("a",))]


def test_equal_entries_are_timed_separately(executor: Executor, watched: RecordingWatchdog) -> None:
    for instant in range(20):
        executor.begin("a")
        watched.sample(float(instant))
        if instant % 3 == 0:
            executor.end()
            watched.sample(instant + 0.5)
    assert watched.warned == []
    assert not watched.budget.needs_check


def test_entry_over_time_limit_may_clean_up(executor: Executor, watched: RecordingWatchdog) -> None:
    executor.begin("a")
    watched.sample(0.0)
    watched.sample(9.9)
    assert not watched.budget.needs_check
    watched.sample(10.0)
    with pytest.raises(LimitError, match="seconds") as caught:
        watched.budget.check_entry()
    assert not caught.value.is_final
    watched.sample(15.0)
    watched.budget.check_entry()
    watched.sample(20.0)
    with pytest.raises(LimitError, match="seconds") as caught:
        watched.budget.check_entry()
    assert caught.value.is_final


def test_late_time_limit_does_not_affect_next_entry(executor: Executor, watched: RecordingWatchdog) -> None:
    executor.begin("a")
    watched.sample(0.0)
    watched.sample(10.1)
    executor.begin("b")
    watched.budget.check_entry()
    assert not watched.budget.needs_check


def test_running_entry_is_found_between_samples(executor: Executor, watched: RecordingWatchdog) -> None:
    assert watched.find_running_entry(0.0) is None
    for first, name in ((1.0, "a"), (10.0, "b")):
        executor.begin(name)
        assert watched.find_running_entry(first) == ((name,), 0.0)
        assert watched.find_running_entry(first + 0.5) == ((name,), 0.5)
        for passed in (0.9, 1.0, 1.5, 2.0):
            watched.sample(first + passed)
        assert watched.find_running_entry(first + 3.0) == ((name,), 3.0)
        assert watched.warned == [(1.0, (name,)), (2.0, (name,))]
        watched.warned.clear()
    executor.end()
    assert watched.find_running_entry(14.0) is None


@pytest.mark.parametrize(
    ("patience", "seconds", "pause"),
    [
        (1.0, None, 0.2),
        (None, 1.0, 0.2),
        (2.0, 1.0, 0.2),
        (100.0, None, 0.5),
        (0.0, 9.0, 0.005),
    ],
)
def test_sample_interval_is_fifth_of_shortest_time(
    executor: Executor, patience: Optional[float], seconds: Optional[float], pause: float
) -> None:
    budget = Budget()
    budget.set_limits(Limits(seconds=seconds))
    assert Watchdog(
        executor, budget, patience, lambda ran, entry: None
    ).compute_sample_interval() == pytest.approx(pause)


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        (("a text of an event",), "a text of an event"),
        ((atom("stop"),), "stop"),
        ((functor("moved", 2)(1, 2), 5), "moved/2"),
        ((functor(",", 2)(functor(",", 2)(atom("first"), 1), 2),), "first"),
        ((17,), "a request"),
        ((), "a request"),
        (None, "a request"),
    ],
)
def test_description_names_functor_of_entry(entry: Optional[Tuple[Any, ...]], named: str) -> None:
    engine = Engine()
    assert describe_work(engine.logic, engine.dispatcher, entry) == RunningWork(named, "", "", None)


def test_watchdog_without_limits_ignores_long_entries(executor: Executor) -> None:
    budget = Budget(executor=executor)
    watchdog = Watchdog(executor, budget, None, lambda seconds, entry: fail("warned"))
    executor.begin("a")
    for instant in (0.0, 1e3, 1e6):
        watchdog.sample(instant)
    assert not budget.needs_check


def test_time_limit_covers_sum_of_short_goals(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine(settings=Settings(limits=Limits(seconds=10.0)))
    engine.load_rules("".join(f"out({number}) <- in where slow({number}).\n" for number in range(10)))
    watchdog, now = engine.watchdog, [0.0]

    def slow(machine: Any, number: Any) -> bool:
        now[0] += 3.0
        watchdog.sample(now[0])
        return True

    engine.logic.define("slow", 1, slow)
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("in", 1)
    assert events == ["in", "out(0)", "out(1)", "out(2)", "out(3)", "out(4)"]
    assert caplog.text.count("Not enough resources: seconds") == 1
    assert "in has exceeded its limit of seconds; goals refused: 4" in caplog.text


@pytest.mark.parametrize(
    ("rules", "goals", "named"),
    [
        ("out(X) <- in(X) where (X > 0, hold).", "", "rule out(X)"),
        ("null_event do hold_(X) <- in(X).\nhold_(_) :- hold.", "", "rule do hold_(X)"),
        ("", "subscribe(in(_), [hold], _, out, a)", "subscription a: goal hold"),
        ("", "memorize(in(_), [hold], _, m, 10)", "memory m: goal hold"),
        ("synchronized(x(X), hold, []) <- in(X).", "", "synchronized query: goal hold"),
    ],
)
def test_warning_names_rule_goal_and_event(
    rules: str, goals: str, named: str, caplog: pytest.LogCaptureFixture
) -> None:
    engine = Engine(settings=Settings(watchdog=1.0))
    watchdog = engine.watchdog

    def hold(machine: Any) -> bool:
        watchdog.sample(0.0)
        watchdog.sample(1.5)
        return True

    engine.logic.define("hold", 0, hold)
    engine.load_rules(rules, "rules.txt")
    engine.load(goals=goals)
    engine.event("in(1)", 1)
    assert named in caplog.text
    assert "hold" in caplog.text
    assert "in/1 has taken 1.5 s" in caplog.text
    assert ("rules.txt:1" in caplog.text) == bool(rules)


def test_warning_names_loading_goals_and_queries(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    engine = Engine(settings=Settings(watchdog=1.0, limits=Limits(seconds=1.0), limit_start=False))
    watchdog, now = engine.watchdog, [0.0]

    def hold(machine: Any, number: Any) -> bool:
        for _ in range(5):
            watchdog.sample(now[0])
            now[0] += 1.5
        return True

    engine.logic.define("hold", 1, hold)
    (tmp_path / "goalPredicates.txt").write_text("hold(1)\n")
    engine.load_program(tmp_path)
    assert "goalPredicates.txt:1:1: goal hold/1 is running" in caplog.text
    caplog.clear()
    engine.settings = engine.settings._replace(limit_start=True)
    assert engine.call("hold(2)")
    assert "hold/1 has taken" in caplog.text
    caplog.clear()
    assert engine.call("(hold(3), true), true")
    assert "goal hold/1 is running; hold/1 has taken" in caplog.text
    assert ",/2" not in caplog.text


def test_limit_holds_if_warning_fails(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    engine = Engine(settings=Settings(watchdog=1.0, limits=Limits(seconds=1.0)))
    watchdog, budget = engine.watchdog, engine.logic.machine.budget

    def changed_meanwhile(*_: Any) -> None:
        assert budget.needs_check
        raise RuntimeError("changed size during iteration")

    monkeypatch.setattr(watchdog_module, "_make_slow_work_warning", changed_meanwhile)

    def hold(machine: Any) -> bool:
        watchdog.sample(0.0)
        watchdog.sample(1.5)
        return budget.needs_check

    engine.logic.define("hold", 0, hold)
    assert engine.call("hold")
    assert "changed size during iteration" in caplog.text


def test_warning_of_exceeded_limit_is_short(caplog: pytest.LogCaptureFixture) -> None:
    engine = Engine(settings=Settings(limits=Limits(inferences=10_000)))
    engine.load_rules("loop :- loop.")
    engine.load(goals="subscribe(E, [loop], _, out, a)\nsubscribe(E, [loop], _, out, b)")
    engine.event("x" * 5_000, 1)
    messages = [record.getMessage() for record in caplog.records if "goals refused" in record.getMessage()]
    assert len(messages) == 1
    assert len(messages[0]) < 400


def test_watchdog_thread_ends_with_engine() -> None:
    def dogs() -> List[Any]:
        return [thread for thread in threading.enumerate() if thread.name == "retalis watchdog"]

    before = set(dogs())
    Engine()
    assert set(dogs()) <= before  # those of other engines end in the meantime
    engine = Engine(settings=Settings(limits=Limits(seconds=0.05)))
    (mine,) = set(dogs()) - before
    del engine
    gc.collect()
    mine.join(10)
    assert not mine.is_alive()


def test_watchdog_thread_interrupts_waiting_predicate() -> None:
    engine = Engine(settings=Settings(limits=Limits(seconds=0.05)))
    going = threading.Event()
    budget = engine.logic.machine.budget

    def wait(machine: Any) -> bool:
        while not budget.needs_check:
            going.wait(0.01)
        return True

    engine.logic.define("wait", 0, wait)
    engine.load_rules("a <- in where wait.\nb <- in where true(1).\ntrue(1).")
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(term))
    engine.event("in", 1)
    assert events == [atom("in"), atom("a")]
    engine.event("in2", 2)
    assert events[-1] is atom("in2")
