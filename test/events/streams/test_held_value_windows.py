"""Windows over values that last until the next one; `oracle.stream_operators` defines them for random programs."""

from typing import Any, List

import pytest
from asserting_accessors import place_of
from events.streams.operator_driver import Arrival, element_of
from recording_reports import RecordingReports

from retalis import Engine, ProgramErrors, StreamClock
from retalis.events.streams import held_value_windows
from retalis.events.streams.held_value_windows import HELD_AGGREGATES, HeldHoppingWindow, HeldSlidingWindow
from retalis.events.streams.stream_operators import KeyBounds
from retalis.prolog.terms.timestamps import SECOND


class RuleRunner:
    """An engine with one rule, whose clock follows the events."""

    def __init__(self, rule: str):
        self.reports = RecordingReports()
        self.engine = Engine(reports=self.reports)
        self.engine.load(rules=rule)
        self.outputs: List[str] = []
        self.engine.on_event(self._record)

    def _record(self, term: Any, start: int, end: int) -> None:
        text = self.engine.show(term)
        if text.startswith("o("):
            self.outputs.append(f"{text}@{start / SECOND:g}-{end / SECOND:g}")

    def feed(self, events: str) -> str:
        """Process events, each as ``event@end``; return the outputs."""
        for item in events.split():
            event, _, end = item.partition("@")
            self.engine.event(event, float(end), float(end))
        return " ".join(self.outputs)


def rule(kind: str, window: str) -> str:
    return f"o(K, R) <- aggregate({kind}, q(K, X), R, {window})."


LEVELS = "q(a,4)@2 q(a,8)@6 q(a,0)@24 tick@30"


@pytest.mark.parametrize(
    ("kind", "window", "outputs"),
    [
        ("avg(X)", "held(every(10))", "o(a,6)@0-10 o(a,8)@10-20 o(a,3.2)@20-30"),
        ("min(X)", "held(every(10))", "o(a,4)@0-10 o(a,8)@10-20 o(a,0)@20-30"),
        ("max(X)", "held(every(10))", "o(a,8)@0-10 o(a,8)@10-20 o(a,8)@20-30"),
        ("first(X)", "held(every(10))", "o(a,4)@0-10 o(a,8)@10-20 o(a,8)@20-30"),
        ("last(X)", "held(every(10))", "o(a,8)@0-10 o(a,8)@10-20 o(a,0)@20-30"),
        ("duration(X > 5)", "held(every(10))", "o(a,4.0)@0-10 o(a,10.0)@10-20 o(a,4.0)@20-30"),
        ("duration(true)", "held(every(10), max(5))", "o(a,8.0)@0-10 o(a,1.0)@10-20 o(a,5.0)@20-30"),
        ("avg(X)", "held(last(10))", "o(a,4)@2-6 o(a,8)@14-24"),
        ("[min(X), max(X)]", "held(last(20))", "o(a,[4,4])@2-2 o(a,[4,8])@2-6 o(a,[0,8])@4-24"),
        ("max(X)", "held(last(20), max(15))", "o(a,4)@2-2 o(a,8)@2-6 o(a,8)@4-24"),
        ("last(X)", "held(last(4, every(10)))", "o(a,8)@6-10 o(a,8)@16-20 o(a,0)@26-30"),
    ],
)
def test_value_lasts_until_next_one(kind: str, window: str, outputs: str) -> None:
    assert RuleRunner(rule(kind, window)).feed(LEVELS) == outputs


def test_keys_have_own_values() -> None:
    runner = RuleRunner(rule("avg(X)", "held(every(10))"))
    assert runner.feed("q(b,1)@1 q(a,5)@2 q(b,3)@5 tick@20") == (
        "o(b,2.111111111111111)@0-10 o(a,5)@0-10 o(a,5)@10-20 o(b,3)@10-20"
    )


def test_result_at_begin_of_value_is_before_it() -> None:
    runner = RuleRunner(rule("[first(X), last(X)]", "held(every(10))"))
    assert runner.feed("q(a,1)@0 q(a,2)@10 tick@20") == "o(a,[1,1])@0-10 o(a,[2,2])@10-20"


def test_last_of_equal_ends_counts() -> None:
    runner = RuleRunner(rule("[min(X), max(X), avg(X)]", "held(every(10))"))
    assert runner.feed("q(a,1)@2 q(a,9)@2 tick@10") == "o(a,[9,9,9])@0-10"


def test_large_and_small_values_leave_no_rounding_error() -> None:
    runner = RuleRunner(rule("avg(X)", "held(last(2))"))
    runner.feed("q(a,1.0e15)@1 q(a,0.1)@2 q(a,0.1)@9")
    assert runner.outputs[-1] == "o(a,0.1)@7-9"


def test_goal_of_duration_may_call_predicates() -> None:
    runner = RuleRunner(
        rule("duration((bound(K, L), X > L))", "held(every(10))") + "\nbound(a, 3).\nbound(b, 9)."
    )
    assert runner.feed("q(a,4)@2 q(b,4)@2 tick@10") == "o(a,8.0)@0-10 o(b,0.0)@0-10"


def test_goal_that_raises_error_is_reported_and_value_ignored() -> None:
    runner = RuleRunner(rule("duration(X > 3)", "held(every(10))"))
    assert runner.feed("q(a,4)@2 q(a,x)@5 tick@10") == "o(a,8.0)@0-10"
    assert "at event q(a,x): the goal of duration" in runner.reports.messages[0]


def test_late_value_counts_in_windows_that_have_not_ended() -> None:
    runner = RuleRunner(rule("avg(X)", "held(every(10))"))
    assert runner.feed("q(a,4)@2 q(a,8)@8 q(a,0)@6 tick@10") == "o(a,4)@0-10"


def test_value_later_than_its_window_is_reported_and_lasts_in_next_one() -> None:
    runner = RuleRunner(rule("avg(X)", "held(every(10))"))
    assert runner.feed("q(a,4)@2 tick@12 q(a,8)@9 tick@20") == "o(a,4)@0-10 o(a,8)@10-20"
    assert runner.engine.rules.rules[0].late_count == 1
    assert "its value counts if it lasts longer" in runner.reports.messages[0]


def test_value_replaced_before_sliding_window_is_too_late() -> None:
    runner = RuleRunner(rule("max(X)", "held(last(5))"))
    assert runner.feed("q(a,1)@1 q(a,2)@4 q(a,3)@10 q(a,9)@3") == "o(a,1)@1-1 o(a,2)@1-4 o(a,3)@5-10"
    assert runner.engine.rules.rules[0].late_count == 1


@pytest.mark.parametrize(
    ("kind", "window", "output"),
    [
        ("avg(X)", "held(last(5))", "o(a,3)@5-10"),
        ("avg(X)", "held(last(8))", "o(a,2.875)@2-10"),
        ("avg(X)", "held(last(6), max(4))", "o(a,3)@4-10"),
        ("min(X)", "held(last(5), max(1))", "o(a,9)@10-10"),
    ],
)
def test_values_that_end_together_are_removed(kind: str, window: str, output: str) -> None:
    runner = RuleRunner(rule(kind, window))
    runner.feed("q(a,1)@1 q(a,2)@2 q(a,3)@3 q(a,9)@10")
    assert runner.outputs[-1] == output


def test_value_ends_after_jump_of_clock() -> None:
    runner = RuleRunner(rule("last(X)", "held(every(1), max(2))"))
    assert runner.feed("q(a,1)@0 tick@1000000") == "o(a,1)@0-1 o(a,1)@1-2"


def create_measures() -> List[Any]:
    return [HELD_AGGREGATES["max"].measure(0, "max", None)]


def process(window: Any, key: str, end: int, value: int) -> List[Any]:
    outputs: List[Any] = window.process(element_of(Arrival(end, key, end, end, value, 0, end)), end, 0)
    return outputs


def test_number_of_results_without_new_value_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held_value_windows, "MAX_HELD_STEPS", 50)
    window = HeldHoppingWindow(create_measures, 2, 2, None)
    process(window, "a", 0, 1)
    assert len(window.advance_to(1 << 60)) == 50
    assert (len(window), window.keys, window.next_deadline) == (0, 0, None)


def test_least_recently_used_keys_are_dropped_and_counted() -> None:
    window = HeldSlidingWindow(create_measures, 10, None)
    window.set_bounds(KeyBounds(max_keys=2))
    for end, key in enumerate("abac"):
        process(window, key, end, end)
    assert (list(window.states), len(window), window.evicted_count) == (["a", "c"], 3, 1)


def test_keys_whose_values_have_ended_are_dropped() -> None:
    window = HeldSlidingWindow(create_measures, 10, 5)
    process(window, "a", 0, 1)
    process(window, "b", 16, 1)
    assert list(window.states) == ["b"]


def test_dropped_value_is_not_measured() -> None:
    window = HeldHoppingWindow(create_measures, 10, 10, None)
    for end, value in ((1, 9), (2, 3), (12, 4)):
        process(window, "a", end, value)
    window.advance_to(10)
    assert len(window) == 2
    window.drop_oldest()
    assert [output.results for output in window.advance_to(20)] == [(4,)]
    window.drop_oldest()
    assert (len(window), window.keys) == (0, 0)


def create_averages() -> List[Any]:
    return [HELD_AGGREGATES["avg"].measure(0, "avg", None)]


def test_later_value_is_not_measured_after_clock_returns() -> None:
    window = HeldHoppingWindow(create_averages, 5, 5, None)
    window.limit_time(lambda: 13)
    process(window, "a", 1, 4)
    process(window, "a", 9, 8)
    window.advance_to(100)
    window.return_to(3)
    outputs = [(output.start, output.end, output.results) for output in window.advance_to(15)]
    assert outputs == [(5, 10, (8,)), (10, 15, (8,))]


def test_sliding_window_ends_at_newest_value_after_clock_returns() -> None:
    window = HeldSlidingWindow(create_averages, 20, None)
    window.limit_time(lambda: 13)
    process(window, "a", 1, 4)
    process(window, "a", 9, 8)
    window.return_to(3)
    (output,) = process(window, "a", 4, 2)
    assert (output.start, output.end, output.results) == (1, 9, (2.75,))


def test_state_without_element_of_next_window_is_restored() -> None:
    engine = Engine(StreamClock(0))
    engine.load(rules=rule("avg(X)", "held(every(10))"))
    engine.rules.network.limit_stored(1)
    engine.event("q(a,1)", 1)
    engine.event("q(a,2)", 25)
    clock = StreamClock()
    restored = Engine.restore(engine.snapshot(), clock=clock)
    outputs: List[str] = []
    restored.on_event(lambda term, start, end: outputs.append(f"{restored.show(term)}@{end / SECOND:g}"))
    clock.move_to(30 * SECOND)
    restored.advance()
    assert outputs == ["o(a,2)@30"]


def test_retraction_restores_value_before() -> None:
    runner = RuleRunner(":- set_etalis_flag(revision_flag, on).\n" + rule("avg(X)", "held(every(10))"))
    assert runner.feed("q(a,4)@2 q(a,8)@6 rev(q(a,8))@7 tick@10") == "o(a,4)@0-10"


def test_open_windows_include_values_that_last() -> None:
    runner = RuleRunner(rule("avg(X)", "held(every(10))"))
    runner.feed("q(a,4)@2 tick@25")
    ((_, _, window),) = runner.engine.rules.rules[0].open_windows()
    assert (window.element_count, window.start, window.end) == (1, 20 * SECOND, 30 * SECOND)


HELD_NOTATION = "held needs last(Seconds), every(Seconds) or last(Seconds, every(Seconds))"
KINDS = "the aggregates of held values are avg(X), duration(Goal), min(X), max(X), first(X), last(X)"
ERRORS = [
    ("count", "held(every(2))", "count", KINDS),
    ("avrg(X)", "held(every(2))", "avrg", f"{KINDS}; did you mean avg?"),
    (
        "duration(X > 1)",
        "every(2)",
        "duration",
        "duration(Goal) needs a window of held values, as held(every(10)); the length of another window is "
        "E - S in check (t1(S), t2(E), ...) after the aggregate",
    ),
    ("duration(3)", "held(every(2))", "3", "duration needs a goal"),
    ("duration(X)", "held(every(2))", "X", "duration needs a goal"),
    ("avg(X)", "held(session(2))", "session", HELD_NOTATION),
    ("avg(X)", "held(every(2, first))", "every", HELD_NOTATION),
    ("avg(X)", "held(last(2, events))", "last", HELD_NOTATION),
    ("avg(X)", "held(every(0))", "0", "every needs a positive number of seconds"),
    ("avg(X)", "held(every(1), 3)", "3", "held takes a window and max(Seconds)"),
    ("avg(X)", "held(every(1), max(0))", "0", "max needs a positive number of seconds"),
    (
        "avg(X)",
        "held(every(1), max(100001))",
        "100001",
        "max needs no more than 100000 times the seconds of its every",
    ),
]


@pytest.mark.parametrize(("kind", "window", "part", "message"), ERRORS)
def test_malformed_window_is_reported_at_its_place(kind: str, window: str, part: str, message: str) -> None:
    text = rule(kind, window)
    with pytest.raises(ProgramErrors) as errors:
        RuleRunner(text)
    (error,) = errors.value.errors
    assert (error.message, place_of(error).column) == (message, text.index(part, text.index("te(")) + 1)


def test_goal_of_duration_cannot_use_pattern_to_left() -> None:
    with pytest.raises(ProgramErrors) as errors:
        RuleRunner("o(R) <- p(Z) and aggregate(duration(X > Z), q(_, X), R, held(every(1))).")
    assert "duration uses a pattern to the left of what is measured" in str(errors.value)
