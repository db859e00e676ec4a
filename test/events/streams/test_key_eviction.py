"""Eviction of key states: idle keys, excess keys, row pattern matches over their time bound."""

from typing import Any, List, Tuple

import pytest
from asserting_accessors import required
from recording_reports import RecordingReports

from retalis import Engine

STEPS = "aggregate(list(V), q(K, V), L, steps([up where V == up, down where V == down]))"
LAST = "aggregate(list(V), q(K, V), L, last(3, events))"
EVERY = "aggregate(list(V), q(K, V), L, every(3, events))"
RUNNING = "aggregate(list(V), q(K, V), L, running(every(3, events)))"
HELD = "aggregate(last(V), q(K, V), L, held(last(5)))"
CHANGE = "(q(K, L) with change(L, K))"
UNTIMED = {"steps": STEPS, "last": LAST, "every": EVERY, "running": RUNNING, "change": CHANGE, "held": HELD}
TIMED = {
    "sliding": "aggregate(list(V), q(K, V), L, last(5))",
    "tumbling": "aggregate(list(V), q(K, V), L, every(5))",
    "first": "aggregate(list(V), q(K, V), L, every(5, first))",
    "hopping": "aggregate(list(V), q(K, V), L, last(10, every(5)))",
    "present": "aggregate(list(V), q(K, V), L, running(every(5)))",
    "session": "aggregate(list(V), q(K, V), L, session(5))",
    "held every": "aggregate(last(V), q(K, V), L, held(every(5), max(5)))",
    "held at most": "aggregate(last(V), q(K, V), L, held(last(5), max(5)))",
    "throttle": "(q(K, L) with throttle(5, K))",
    "burst": "(q(K, L) with burst(5, K))",
    "debounce": "(q(K, L) with debounce(5, K))",
    "absent": "(q(K, L) seq absent(q(K, _), 5))",
}


class RuleRunner:
    """An engine with one rule, and the outputs of the rule."""

    def __init__(self, pattern: Any, *flags: Any, label: str = "r") -> None:
        self.reports = RecordingReports()
        self.engine = Engine(reports=self.reports)
        self.outputs: List[Any] = []
        for name, value in flags:
            assert self.engine.call(f"set_etalis_flag({name}, {value})")
        self.engine.load(rules=f"{label} : match(K, L) <- {pattern}.")
        self._record_outputs()

    def _record_outputs(self) -> None:
        def record(term: Any, start: Any, end: Any) -> None:
            if self.engine.show(term).startswith("match"):
                self.outputs.append(self.engine.show(term)[len("match(") : -1])

        self.engine.on_event(record)

    def feed(self, text: str) -> str:
        """Process events, each as ``key-value@end``; return the outputs."""
        del self.outputs[:]
        for item in text.split():
            event, end = item.split("@")
            self.engine.event(f"q({event.replace('-', ',')})", float(end), float(end))
        return " ".join(self.outputs)

    def restore(self) -> None:
        """Replace the engine by one that is restored from its snapshot."""
        self.engine = Engine.restore(self.engine.snapshot())
        self._record_outputs()

    @property
    def rule(self) -> Any:
        return self.engine.status().rules[0]


def test_within_ends_old_row_pattern_matches() -> None:
    runner = RuleRunner(f"{STEPS} within 5")
    assert runner.feed("a-up@1 a-down@2") == "a,[up,down]"
    assert runner.feed("a-up@3 b-up@10 a-down@11") == ""
    assert runner.feed("b-down@12") == "b,[up,down]"


def test_element_after_expired_start_begins_match() -> None:
    later = STEPS.replace("down where", "later(down) where")
    assert RuleRunner(f"{later} within 5").feed("a-up@1 a-up@10 a-down@11") == "a,[up,down]"
    assert RuleRunner(later).feed("a-up@1 a-up@10 a-down@11") == "a,[up,down]"


@pytest.mark.parametrize("bound", ["within", "window", "ttl", "flag", "garbage"])
@pytest.mark.parametrize("operator", UNTIMED)
def test_bound_evicts_idle_keys(operator: str, bound: str) -> None:
    pattern, label = UNTIMED[operator], "r"
    flags: List[Tuple[str, Any]] = []
    if bound == "within":
        pattern = f"{pattern} within 5"
    elif bound == "flag":
        flags = [("state_ttl", 5)]
    elif bound == "garbage":
        flags = [("garbage_window", 5), ("garbage_control", "general")]
    else:
        label = f"r([property({bound}, 5)])"
    runner = RuleRunner(pattern, *flags, label=label)
    for second in range(1000):
        runner.feed(f"{second}-up@{second}")
    assert 4 <= runner.rule.keys <= 6, runner.rule


@pytest.mark.parametrize("operator", UNTIMED)
def test_keys_without_bound_are_kept(operator: str) -> None:
    runner = RuleRunner(UNTIMED[operator])
    for second in range(100):
        runner.feed(f"{second}-up@{second}")
    assert runner.rule.keys == 100


@pytest.mark.parametrize("operator", TIMED)
def test_times_of_windows_and_rates_evict_keys(operator: str) -> None:
    runner = RuleRunner(TIMED[operator], ("max_keys", 50))
    for second in range(300):
        runner.feed(f"{second}-up@{second}")
    assert runner.rule.keys <= 16
    assert runner.rule.dropped == 0


@pytest.mark.parametrize(
    ("operator", "events", "outputs_if_kept", "outputs_if_evicted"),
    [
        ("steps", "a-up@1 b-x@{0} a-down@{0}", "a,[up,down]", ""),
        ("last", "a-1@1 a-2@{0}", "a,[1] a,[1,2]", "a,[1] a,[2]"),
        ("every", "a-1@1 a-2@2 b-0@{0} a-3@{0}", "a,[1,2,3]", ""),
        ("running", "a-1@1 a-2@{0}", "a,[1] a,[1,2]", "a,[1] a,[2]"),
        ("change", "a-1@1 a-1@{0}", "a,1", "a,1 a,1"),
    ],
)
@pytest.mark.parametrize("restored", [False, True])
def test_key_idle_beyond_time_to_live_restarts(
    operator: str, events: str, outputs_if_kept: str, outputs_if_evicted: str, restored: bool
) -> None:
    for last, expected in ((6, outputs_if_kept), (8, outputs_if_evicted)):
        runner = RuleRunner(UNTIMED[operator], label="r([property(ttl, 5)])")
        first, rest = events.format(last).split(" ", 1)
        outputs = runner.feed(first)
        if restored:
            runner.restore()
        assert " ".join(text for text in (outputs, runner.feed(rest)) if text) == expected


@pytest.mark.parametrize("operator", UNTIMED)
def test_key_in_use_is_kept(operator: str) -> None:
    runner = RuleRunner(UNTIMED[operator], label="r([property(ttl, 5)])")
    runner.feed(" ".join(f"a-up@{4 * step} {step}-up@{4 * step}" for step in range(20)))
    assert 1 <= runner.rule.keys <= 4


def test_time_to_live_ends_partial_matches() -> None:
    for pattern in ("(q(K, up) seq q(K, L))", "(q(K, up) seq aggregate(list(V), q(K, V), L))"):
        runner = RuleRunner(pattern, ("state_ttl", 5))
        runner.feed(" ".join(f"{second}-up@{second}" for second in range(100)))
        assert runner.rule.keys <= 7
        assert runner.rule.waiting <= 14


def test_time_to_live_of_label_overrides_flag() -> None:
    runner = RuleRunner(LAST, ("state_ttl", 5), label="r([property(ttl, 100)])")
    runner.feed(" ".join(f"{second}-up@{second}" for second in range(50)))
    assert runner.rule.keys == 50


@pytest.mark.parametrize(
    "operator",
    [
        *UNTIMED,
        "sliding",
        "tumbling",
        "first",
        "hopping",
        "present",
        "session",
        "held every",
        "throttle",
        "burst",
    ],
)
def test_least_recently_used_keys_are_evicted(operator: str) -> None:
    runner = RuleRunner(
        {**UNTIMED, **TIMED}[operator].replace("5", "1000").replace("10,", "1000,"), ("max_keys", 10)
    )
    runner.feed(" ".join(f"{number}-up@{number / 100}" for number in range(30)) + " z-up@2000")
    assert runner.rule.keys <= 10
    assert runner.rule.dropped in (20, 21)
    assert (
        "has more than 10 keys; 1 of the least recently used have been dropped so far"
        in runner.reports.messages[0]
    )
    assert "max_keys" in runner.reports.messages[0]
    assert len(runner.reports.messages) == 5  # at 1, 2, 4, 8, 16


def test_key_in_use_outlives_newer_keys() -> None:
    runner = RuleRunner(LAST, ("max_keys", 3))
    assert runner.feed("a-1@1 b-1@1 c-1@1 a-2@1 d-1@1 e-1@1 a-3@1").endswith("a,[1,2,3]")


def test_evicted_key_drops_partial_matches() -> None:
    runner = RuleRunner(STEPS, ("max_keys", 2))
    assert runner.feed("a-up@1 b-up@2 c-up@3 a-down@4 c-down@5") == "c,[up,down]"
    assert (runner.rule.keys, runner.rule.waiting) == (1, 1)


def test_flag_applies_immediately() -> None:
    runner = RuleRunner(CHANGE)
    runner.feed(" ".join(f"{second}-up@{second}" for second in range(50)))
    assert runner.engine.call("set_etalis_flag(state_ttl, 5)")
    runner.feed("a-up@50")
    assert runner.rule.keys == 6


@pytest.mark.slow
@pytest.mark.parametrize("value", ["0", "-1", "2.5", "many"])
def test_invalid_max_keys_is_refused(value: str) -> None:
    with pytest.raises(Exception, match="max_keys takes a number of keys from 1"):
        Engine().call(f"set_etalis_flag(max_keys, {value})")


def test_time_to_live_of_zero_overrides_flag() -> None:
    runner = RuleRunner(LAST, ("state_ttl", 5), label="r([property(ttl, 0)])")
    runner.feed(" ".join(f"{second}-up@{second}" for second in range(50)))
    assert runner.rule.keys == 50
    with pytest.raises(Exception, match="property ttl needs a number of seconds"):
        RuleRunner(LAST, label="r([property(ttl, -1)])")


def test_size_of_state_is_estimated() -> None:
    small, large = RuleRunner(LAST), RuleRunner(LAST)
    small.feed("a-1@1")
    large.feed(" ".join(f"{second}-up@{second}" for second in range(100)))
    assert large.rule.bytes == 100 * small.rule.bytes > 0


def test_flags_bound_rates_of_subscriptions() -> None:
    engine = Engine()
    engine.load(goals="set_etalis_flag(state_ttl, 5), subscribe(q(K, V) with change(V, K), [], _, out, s)")
    for number in range(100):
        engine.event(f"q({number}, 1)", number, number)
    ((_, subscription),) = engine.knowledge.subscriptions.items()
    assert len(required(subscription.rate_limiter)) <= 6
    assert engine.call("set_etalis_flag(state_ttl, -1)")
    assert engine.call("set_etalis_flag(max_keys, 3)")
    for number in range(100):
        engine.event(f"q({number}, 1)", 100, 100)
    assert len(required(subscription.rate_limiter)) == 3
