"""Limits of pattern matching: derived events remain, and omitted ones are reported once."""

import resource
import time
from typing import Any, List

import pytest

from retalis import Engine, Limits, PrologError, Reports, Settings

UNRESTRICTED = ":- set_etalis_flag(event_consumption_policy, unrestricted).\n"
CHAIN = UNRESTRICTED + "".join(
    f"e{number + 1}(X) <- e{number}(X) and e{number}(Y).\n" for number in range(30)
)
GROWING = UNRESTRICTED + "a(f(X)) <- a(X) seq a(Y).\n"
FIVE = UNRESTRICTED + "b <- a(A) and a(B) and a(C) and a(D) and a(E).\n"
PAIRS = UNRESTRICTED + "p(X) <- a(X) seq b(_).\n"
REPORT = "while patterns were matched"
MAX_INFERENCES = 2000


class StopReports(Reports):
    """Reports that count the stops of pattern matching."""

    def __init__(self) -> None:
        super().__init__()
        self._stop_count = 0

    def warning(self, problem: object, *more: Any) -> None:
        self._stop_count += REPORT in str(problem)
        super().warning(problem, *more)

    def take_stop_count(self) -> int:
        """Return the number of stops of pattern matching since the last call."""
        count, self._stop_count = self._stop_count, 0
        return count


class RecordingEngine(Engine):
    """An engine that records its events and counts the stops of pattern matching."""

    def __init__(self, settings: Settings) -> None:
        reports = StopReports()
        super().__init__(settings=settings, reports=reports)
        self.take_stop_count = reports.take_stop_count
        self.events: List[str] = []
        self.on_event(lambda term, start, end: self.events.append(self.brief(term)))
        self.instant = 0


def make(rules: str, inferences: Any = MAX_INFERENCES, **settings: Any) -> RecordingEngine:
    limits = settings.pop("limits", Limits(inferences=inferences))
    engine = RecordingEngine(Settings(limits=limits, limit_start=False, **settings))
    engine.load(rules=rules + "alive(X) <- ping(X).\n")
    return engine


def send(engine: RecordingEngine, *events: Any) -> List[Any]:
    """Send one event per second; return the events that are dispatched for the last one."""
    for event in events:
        engine.events.clear()
        engine.instant += 1
        engine.event(event, engine.instant)
    return list(engine.events)


def is_alive(engine: RecordingEngine) -> bool:
    engine.events.clear()
    return send(engine, "ping(1)") == ["ping(1)", "alive(1)"] and engine.query("X = 1") == [{"X": 1}]


@pytest.mark.parametrize(
    ("rules", "events", "name"),
    [
        (CHAIN, ["e0(1)", "e0(2)", "e0(3)"], "rule e"),
        (GROWING, [f"a({number})" for number in range(14)], "rule a(f(X))"),
        (FIVE, [f"a({number})" for number in range(14)], "rule b"),
        ("t <- t.\n" * 2, ["t"], "rule t"),
    ],
)
def test_explosion_of_matches_stops_at_limit(
    rules: str, events: List[str], name: str, caplog: pytest.LogCaptureFixture
) -> None:
    engine = make(rules)
    for event in events:
        dispatched = send(engine, event)
        assert len(dispatched) <= MAX_INFERENCES
        stop_count = engine.take_stop_count()
        assert stop_count <= 1
    assert stop_count
    assert name in caplog.text
    assert len(dispatched) > 100  # derived events remain
    assert is_alive(engine)
    assert engine.status().warnings


def test_report_names_rule_position_and_limit(caplog: pytest.LogCaptureFixture) -> None:
    engine = make("")
    engine.load_rules(CHAIN, "rules.txt")
    send(engine, "e0(1)", "e0(2)")
    assert REPORT not in caplog.text
    send(engine, "e0(3)")
    (report,) = [record.getMessage() for record in caplog.records if REPORT in record.getMessage()]
    assert report.startswith("rules.txt:")
    assert "rule e" in report
    assert "e0/1 has exceeded its limit of inferences" in report
    assert "derived events were omitted" in report


def test_events_below_limit_equal_those_without() -> None:
    engines = make(CHAIN, 1_000_000), make(CHAIN, limits=Limits())
    for event in ("e0(1)", "e0(2)"):
        limited, unlimited = (send(engine, event) for engine in engines)
        assert limited == unlimited
    assert len(limited) > 30


@pytest.mark.parametrize(
    "rule",
    [
        "q(X, Y) <- p(X) seq p(Y).",
        "q(X, Y) <- p(X) and p(Y).",
        "q(X, Y) <- p(X) cnot n(X) and p(Y).",
        "q(X) <- p(X) ntimes 2.",
        "q(X) <- p(X) ntimes 20.",
        "q(S) <- a(1) seq aggregate(sum(X), p(X), S).",
        "q <- a(_) seq p(_) star_times.",
        "q(L) <- aggregate(list(X), p(X), L, last(1000)).",
        "q(L) <- aggregate(list(X), p(X), L, last(1000, events)).",
        "q(X, N) <- aggregate(count, p(X), N, every(2, events)).",
        "q(L) <- aggregate(list(X), p(X), L, steps([a(0, many) where X > -1, b where X < 0])).",
        "q(X) <- p(X) seq absent(p(-1), 100).",
        "q(X) <- p(X) with change(X).",
        "q(X) <- p(X) event_multiply member(_, [1, 2, 3]).",
        "l([property(after_match, skip_past_last)]) : q(X, Y) <- p(X) seq p(Y).",
    ],
)
@pytest.mark.parametrize(
    "flag", ["true", "set_etalis_flag(out_of_order, on)", "set_etalis_flag(revision_flag, on)"]
)
def test_work_of_each_operator_is_limited(rule: str, flag: str) -> None:
    limit = 200
    engine = make(f":- {flag}.\n" + PAIRS + rule + "\n", 1_000_000)
    send(engine, *[f"a({number})" for number in range(300)])
    engine.logic.limits = Limits(inferences=limit)
    budget = engine.logic.machine.budget
    before = budget.inferences
    for _ in range(3):
        assert len(send(engine, "b(1)")) <= limit
        assert engine.take_stop_count() == 1
    assert budget.inferences - before < 3 * 2 * limit
    assert is_alive(engine)


def test_work_of_repetitions_is_limited() -> None:
    engine = make(UNRESTRICTED + "q <- p(_) ntimes 5.\n")
    for number in range(30):
        send(engine, f"p({number})")
    assert engine.take_stop_count()
    assert is_alive(engine)


def test_work_of_steps_is_limited() -> None:
    steps = "steps([x(0, many) where X > 0, later(y(1, 2, reluctant)) where X > 1, z where X < 0])"
    engine = make(f"q(N) <- aggregate(count, p(X), N, {steps}).\nr <- q(_).\n{PAIRS}", 1_000_000)
    send(engine, *[f"a({number})" for number in range(1, 100)])
    engine.logic.limits = Limits(inferences=MAX_INFERENCES // 10)
    send(engine, "b(1)")
    assert engine.take_stop_count() == 1
    assert is_alive(engine)


def test_results_of_many_keys_are_limited() -> None:
    engine = make("q(X, N) <- aggregate(count, p(X), N, every(10)).\n", 1_000_000)
    for number in range(3000):
        engine.event(f"p({number})", 1 + number / 1000)
    engine.logic.limits = Limits(inferences=MAX_INFERENCES)
    engine.instant = 20
    send(engine, "ping(1)")
    assert engine.take_stop_count() == 1
    assert is_alive(engine)


REVISED = ":- set_etalis_flag(revision_flag, on).\n" + PAIRS + "q(X, Y) <- p(X) seq c(Y).\n"


def test_retraction_is_limited_and_consistent(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(REVISED, 1_000_000)
    send(engine, *[f"a({number})" for number in range(1000)], "b(1)")
    engine.logic.limits = Limits(inferences=2500)  # enough to remove 1000 buffered events once
    events = send(engine, "rev(b(1))")
    assert 10 < len(events) < 600
    assert engine.take_stop_count() == 1
    assert "rule p(X): rev/1 has exceeded its limit of inferences" in caplog.text
    assert send(engine, "c(1)") == ["c(1)"]
    assert is_alive(engine)


@pytest.mark.slow
def test_event_with_many_results_is_not_retracted(caplog: pytest.LogCaptureFixture) -> None:
    engine = make(REVISED, 1_000_000)
    send(engine, *[f"a({number})" for number in range(1000)], "b(1)")
    engine.logic.limits = Limits(inferences=500)
    assert send(engine, "rev(b(1))") == ["rev(b(1))"]
    assert engine.take_stop_count() == 1
    assert "rule p(X): rev/1 has exceeded its limit of inferences" in caplog.text
    engine.logic.limits = Limits()
    assert len(send(engine, "c(1)")) == 1 + 1000
    assert len(send(engine, "rev(b(1))")) == 1 + 2 * 1000
    assert send(engine, "c(2)") == ["c(2)"]


@pytest.mark.parametrize(
    ("rule", "limit", "total"),
    [
        ("s(S) <- aggregate(sum(X), d(X), S, last(5, events)).", 500, 11),
        ("s(S) <- k seq aggregate(sum(X), d(X), S).", 2500, 1007),
    ],
)
def test_recomputation_of_window_or_run_is_limited(
    rule: str, limit: int, total: int, caplog: pytest.LogCaptureFixture
) -> None:
    engine = make(":- set_etalis_flag(revision_flag, on).\n" + rule + "\n", 1_000_000)
    send(engine, "k", "d(5)", *["d(1)"] * 1000)
    engine.logic.limits = Limits(inferences=limit)
    send(engine, "rev(d(5))")
    assert engine.take_stop_count() == 1
    assert "rule s(S): rev/1 has exceeded its limit of inferences" in caplog.text
    engine.logic.limits = Limits()
    (result,) = [event for event in send(engine, "d(7)") if event.startswith("s(")]
    assert 7 <= int(result[2:-1]) < total  # the window is empty; the run has the first repetitions
    assert is_alive(engine)


def test_retraction_of_repetitions_is_limited() -> None:
    rules = UNRESTRICTED + ":- set_etalis_flag(revision_flag, on).\n"
    rules += "s(S) <- k seq aggregate(sum(X), d(X), S).\nrev(d(X)) <- d(X) seq stop.\n"
    engine = make(rules, 1_000_000)
    send(engine, "k", *[f"d({number})" for number in range(300)])
    engine.logic.limits = Limits(inferences=5000)
    assert len(send(engine, "stop")) < 5000  # there would be 300 times 300 / 2 results
    assert engine.take_stop_count() == 1
    assert is_alive(engine)


def test_many_events_are_retracted_from_long_history() -> None:
    engine = make(REVISED + "s(S) <- aggregate(sum(X), p(X), S, last(5000, events)).\n", limits=Limits())
    send(engine, *[f"a({number})" for number in range(300)], "b(1)")
    events = send(engine, "rev(b(1))")
    assert sum(event.startswith("rev(p(") for event in events) == 300
    assert send(engine, "c(1)") == ["c(1)"]


def test_goal_shares_limit_with_its_events() -> None:
    engine = make(CHAIN)
    send(engine, "e0(1)", "e0(2)")
    with pytest.raises(PrologError, match="inferences"):
        engine.query("event(e0(3)), between(1, 1000000, X), fail")
    assert is_alive(engine)


def test_memories_and_outputs_have_derived_events() -> None:
    engine = make(CHAIN)
    engine.load(goals="memorize(e30(X), [], e30(X), m, 100000)\nsubscribe(e30(X), [], _, out, s)")
    outputs: List[Any] = []
    engine.on_output(lambda term, topic, name: outputs.append(term))
    send(engine, "e0(1)", "e0(2)")
    outputs.clear()
    engine.call("delete_memory(m)")
    engine.load(goals="memorize(e30(X), [], e30(X), m, 100000)")
    events = send(engine, "e0(3)")
    count = sum(event.startswith("e30(") for event in events)
    assert count == len(outputs) > 10
    assert engine.query("memory_counter(m, N)") == [{"N": count}]


@pytest.mark.slow
def test_limit_of_seconds_stops_patterns() -> None:
    engine = make(CHAIN, limits=Limits(seconds=2.0), watchdog=1.0)
    send(engine, "e0(1)", "e0(2)")
    began = time.monotonic()
    send(engine, "e0(3)")
    assert time.monotonic() - began < 20
    assert is_alive(engine)


@pytest.mark.slow
def test_limit_of_memory_stops_patterns(caplog: pytest.LogCaptureFixture) -> None:
    def used() -> float:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    growing = "q(L) <- aggregate(list(X), p(X), L, last(5000, events)).\n"
    engine = make(PAIRS + growing, limits=Limits(megabytes=20))
    engine.load(goals="memorize(q(L), [], q(L), m, 10000)")
    for number in range(3000):
        engine.event(f"a({number})", 1 + number / 1000)
    before = used()
    engine.instant = 10
    send(engine, "b(1)")
    assert "limit of memory" in caplog.text
    assert used() - before < 150
    assert is_alive(engine)
