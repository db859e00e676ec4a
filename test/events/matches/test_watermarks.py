"""Watermarks: alarms wait for events that are received later than their stamps say."""

from typing import Any, List, Tuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from retalis import Engine, Settings, StreamClock, explain, record_origins
from retalis.events.matches.watermarks import LAG_WINDOW, MAX_TOPICS, TopicLag
from retalis.prolog.terms.timestamps import SECOND

MILLISECOND = SECOND // 1000
MAX_LAG = 300 * MILLISECOND
END = 100 * SECOND


class EngineDriver:
    """An engine with a receipt clock; its alarms run at their own instants, as on a robot and in a bag."""

    def __init__(self, rules: Any, goals: str = "", **engine_settings: Any) -> None:
        self.clock = StreamClock()
        self.engine = Engine(self.clock, Settings(**engine_settings))
        self.derived: List[Any] = []
        self.engine.on_event(self.record)
        self.engine.load(rules=rules, goals=goals)

    def record(self, term: Any, start: Any, end: Any) -> None:
        text = self.engine.show(term)
        if not text.startswith(("in", "memory_")):
            self.derived.append((text, int(start), int(end)))

    def advance(self, instant: Any) -> None:
        alarm = self.clock.next_alarm()
        while alarm is not None and alarm <= instant:
            self.clock.move_to(alarm)
            self.engine.advance()
            alarm = self.clock.next_alarm()
        self.clock.move_to(instant)
        self.engine.advance()

    def receive(self, text: str, stamp: Any, lag: int = 0) -> None:
        self.advance(stamp + lag)
        self.engine.event_at(self.engine.query(f"X = {text}")[0]["X"], stamp, stamp)

    def receive_all(self, arrivals: Any) -> Any:
        for receipt, text, stamp in arrivals:
            self.receive(text, stamp, receipt - stamp)
        self.advance(END)
        return self.derived


ALARM = "alarm <- in(no) seq absent(in(yes), 0.5)."


@pytest.mark.parametrize(("answer", "alarms"), [("in(yes)", []), ("in(maybe)", ["alarm"])])
def test_event_received_after_deadline_cancels_alarm(answer: str, alarms: List[str]) -> None:
    driver = EngineDriver(ALARM)
    driver.clock.move_to(1000 * SECOND)
    driver.engine.event("in(no)", 1000)
    # The message is received after the deadline, before the alarm has run.
    driver.clock.move_to(1000 * SECOND + 505 * MILLISECOND)
    driver.engine.event(answer, 1000.49)
    driver.advance(1010 * SECOND)
    assert [text for text, _, _ in driver.derived] == alarms


def test_known_lag_delays_alarm_but_not_its_interval() -> None:
    driver = EngineDriver(ALARM)
    driver.receive("in(no)", 10 * SECOND, 30 * MILLISECOND)
    driver.advance(10 * SECOND + 529 * MILLISECOND)
    assert driver.derived == []
    driver.advance(10 * SECOND + 530 * MILLISECOND)
    assert driver.derived == [("alarm", 10 * SECOND, 10 * SECOND + 500 * MILLISECOND)]


def test_delay_of_zero_ignores_lag() -> None:
    driver = EngineDriver(ALARM, watermark_delay=0)
    driver.receive("in(no)", 10 * SECOND, 30 * MILLISECOND)
    driver.advance(10 * SECOND + 500 * MILLISECOND)
    assert len(driver.derived) == 1


def test_property_of_label_replaces_flag() -> None:
    driver = EngineDriver(f"slow([property(watermark_delay, 2)]) : {ALARM}", watermark_delay=0)
    driver.receive("in(no)", 10 * SECOND)
    driver.advance(12 * SECOND)
    assert driver.derived == []
    driver.advance(12 * SECOND + 500 * MILLISECOND)
    assert len(driver.derived) == 1


def test_delay_is_bounded() -> None:
    driver = EngineDriver(ALARM, max_watermark_delay=0.2)
    driver.receive("in(no)", 10 * SECOND, 400 * MILLISECOND)
    driver.advance(10 * SECOND + 699 * MILLISECOND)
    assert driver.derived == []
    driver.advance(10 * SECOND + 700 * MILLISECOND)
    assert len(driver.derived) == 1


@pytest.mark.parametrize(
    "rules",
    [
        "turn(X) <- in(X). alarm <- turn(no) seq absent(turn(yes), 0.5).",
        "null do event(turn(X), [T, T]) <- in(X) timestamp t2(T). alarm <- turn(no) seq absent(turn(yes), 0.5).",
    ],
    ids=["by a rule", "by a goal"],
)
def test_lag_of_topic_delays_derived_patterns(rules: str) -> None:
    driver = EngineDriver(rules)
    driver.receive("in(no)", 10 * SECOND, 30 * MILLISECOND)
    driver.receive("in(yes)", 10 * SECOND + 490 * MILLISECOND, 25 * MILLISECOND)
    driver.advance(20 * SECOND)
    assert [event for event, *_ in driver.derived if event.startswith(("turn", "alarm"))] == [
        "turn(no)",
        "turn(yes)",
    ]
    driver.receive("in(no)", 20 * SECOND)
    driver.advance(END)
    assert [event for event, *_ in driver.derived if event == "alarm"] == ["alarm"]


def test_lag_of_another_topic_does_not_delay_pattern() -> None:
    driver = EngineDriver(
        "alarm <- in(no) seq absent(in(yes), 0.5). other <- in_camera(1) seq absent(in_camera(2), 5)."
    )
    driver.receive("in_camera(0)", 9 * SECOND, 300 * MILLISECOND)
    driver.receive("in(no)", 10 * SECOND)
    driver.advance(10 * SECOND + 500 * MILLISECOND)
    assert len(driver.derived) == 1


def test_clock_that_follows_events_measures_no_lag() -> None:
    engine = Engine()
    engine.load(rules=ALARM)
    outputs: List[Any] = []
    engine.on_event(lambda term, start, end: outputs.append(engine.show(term)))
    for event, second in (("in(no)", 10), ("in(other)", 1), ("in(other)", 10.5)):
        engine.event(event, second)
    assert outputs == ["in(no)", "in(other)", "alarm", "in(other)"]


def test_restored_engine_keeps_lags_and_alarm() -> None:
    driver = EngineDriver(ALARM)
    driver.receive("in(no)", 10 * SECOND, 30 * MILLISECOND)
    driver.advance(10 * SECOND + 510 * MILLISECOND)
    data = driver.engine.snapshot()
    other = EngineDriver("")
    other.engine = Engine.restore(data, other.clock)
    other.engine.on_event(other.record)
    for current in (driver, other):
        current.advance(10 * SECOND + 529 * MILLISECOND)
        assert current.derived == []
        current.advance(10 * SECOND + 530 * MILLISECOND)
        assert current.derived == [("alarm", 10 * SECOND, 10 * SECOND + 500 * MILLISECOND)]
    assert other.engine.snapshot() == driver.engine.snapshot()


def test_query_timeout_waits_for_late_records() -> None:
    driver = EngineDriver(
        "synchronized(answer, true, [[records, 10]], [timeout(0.2)]) <- in_go.",
        "memorize(in(X), [], X, records, 9).",
    )
    driver.receive("in(1)", 9 * SECOND, 300 * MILLISECOND)
    driver.receive("in_go", 10 * SECOND)
    driver.receive("in(2)", 10 * SECOND + MILLISECOND, 299 * MILLISECOND)
    driver.advance(END)
    assert ("answer", 10 * SECOND, 10 * SECOND) in driver.derived


def test_timeout_without_lag_is_as_written() -> None:
    driver = EngineDriver(
        "synchronized(answer, true, [[records, 10]], [timeout(0.2)]) <- in_go.",
        "memorize(in(X), [], X, records, 9).",
    )
    driver.receive("in_go", 10 * SECOND)
    driver.advance(10 * SECOND + 200 * MILLISECOND)
    assert [(text[:14], end) for text, _, end in driver.derived if text.startswith("query")] == [
        ("query_given_up", 10 * SECOND + 200 * MILLISECOND)
    ]


STATE = "state(open(X), from(in(X, on)), until(in(X, off)), [within(1)])."


def test_late_event_does_not_extend_ended_state() -> None:
    driver = EngineDriver("closed(X) <- open(X).", STATE)
    driver.receive("in(a, on)", 10 * SECOND, 300 * MILLISECOND)
    # Received while the end of the state waits for late events.
    driver.receive("in(a, off)", 11 * SECOND + 50 * MILLISECOND, 10 * MILLISECOND)
    assert ("open(a)", 10 * SECOND, 11 * SECOND) in driver.derived


def test_state_begins_again_while_its_end_waits() -> None:
    driver = EngineDriver("closed(X) <- open(X).", STATE)
    driver.receive("in(a, on)", 10 * SECOND, 300 * MILLISECOND)
    driver.receive("in(a, on)", 11 * SECOND + 50 * MILLISECOND, 10 * MILLISECOND)
    assert not driver.engine.call("holds_at(open(a), 11.02)")
    driver.advance(END)
    intervals = [(start, end) for text, start, end in driver.derived if text == "open(a)"]
    assert intervals == [
        (10 * SECOND, 11 * SECOND),
        (11 * SECOND + 50 * MILLISECOND, 12 * SECOND + 50 * MILLISECOND),
    ]


def test_lag_is_forgotten_after_one_to_two_periods() -> None:
    lag = TopicLag()
    lag.observe(5, 0)
    lag.observe(1, LAG_WINDOW)
    assert lag.lag == 5
    lag.observe(2, 2 * LAG_WINDOW)
    assert lag.lag == 2


# ---- equal results with and without lags ---------------------------------------------------------------

NUMBERS_OF_EXAMPLES = [15, pytest.param(100, marks=pytest.mark.nightly)]

stamped_events = st.lists(
    st.tuples(
        st.integers(20_000, 50_000),
        st.sampled_from(["in(a, on)", "in(a, off)", "in(b, on)", "in(b, off)"]),
        st.integers(0, 300),
    ),
    max_size=12,
    unique_by=lambda event: event[0],
)
"""Stamp in ms, event, and lag in ms."""


def with_beacons(events: Any) -> List[Tuple[Any, ...]]:
    """Return (stamp, text, lag) in ns, with an event of the longest lag every 4 s, by which the delay is known."""
    beacons = [(stamp, "in(none, none)", 300) for stamp in range(10_000, 60_000, 4000)]
    return [
        (stamp * MILLISECOND, text, lag * MILLISECOND) for stamp, text, lag in sorted([*beacons, *events])
    ]


def receive_at_stamps(driver: EngineDriver, events: Any) -> Any:
    return driver.receive_all([(stamp, text, stamp) for stamp, text, _ in events])


def receive_with_lags(driver: EngineDriver, events: Any, in_order: bool) -> Any:
    arrivals: List[Any] = []
    receipt = 0
    for stamp, text, lag in events:
        receipt = max(receipt, stamp + lag) if in_order else stamp + lag
        arrivals.append((receipt, text, stamp))
    return driver.receive_all(sorted(arrivals, key=lambda arrival: arrival[0]))


OUT_OF_ORDER_PROGRAMS = {
    "absent": "alarm(X) <- in(X, on) seq absent(in(X, off), 0.5).",
    "absent after a rule": "t(X, S) <- in(X, S). alarm(X) <- t(X, on) seq absent(t(X, off), 0.5).",
    "debounce": "settled(X, S) <- in(X, S) with debounce(0.5, X).",
    "hopping": "n(X, N) <- aggregate(count, in(X, _), N, last(2, every(1))).",
    "every": "n(X, N) <- aggregate(count, in(X, _), N, every(1)).",
    "session": "n(X, N) <- aggregate(count, in(X, _), N, session(1)).",
    "bounded session": "n(X, N) <- aggregate(count, in(X, _), N, session(0.5, max(2))).",
}


@pytest.mark.parametrize("examples", NUMBERS_OF_EXAMPLES)
@pytest.mark.parametrize("rules", OUT_OF_ORDER_PROGRAMS.values(), ids=list(OUT_OF_ORDER_PROGRAMS))
@pytest.mark.slow
def test_results_with_lags_equal_those_at_stamps(rules: str, examples: int) -> None:
    @settings(max_examples=examples)
    @given(stamped_events)
    @example([(20_000, "in(a, on)", 0), (20_490, "in(a, off)", 15)])
    @example([(30_254, "in(a, on)", 300), (30_549, "in(a, on)", 4)])
    def check_outputs(events: Any) -> None:
        all_events = with_beacons(events)
        expected = sorted(receive_at_stamps(EngineDriver(rules, watermark_delay=0), all_events))
        for delay in (None, 0.3):
            driver = EngineDriver(rules, watermark_delay=delay)
            assert sorted(receive_with_lags(driver, all_events, in_order=False)) == expected

    check_outputs()


IN_ORDER_PROGRAMS = {
    "first": ("n(X, N) <- aggregate(count, in(X, _), N, every(1, first)).", ""),
    "state": ("ended(X) <- open(X).", STATE),
}


@pytest.mark.parametrize("examples", NUMBERS_OF_EXAMPLES)
@pytest.mark.parametrize("program", IN_ORDER_PROGRAMS.values(), ids=list(IN_ORDER_PROGRAMS))
@pytest.mark.slow
def test_ordered_results_with_lags_are_equal(program: Any, examples: int) -> None:
    @settings(max_examples=examples)
    @given(stamped_events)
    def check_outputs(events: Any) -> None:
        all_events = with_beacons(events)
        expected = sorted(receive_at_stamps(EngineDriver(*program, watermark_delay=0), all_events))
        outputs = receive_with_lags(EngineDriver(*program), all_events, in_order=True)
        assert sorted(outputs) == expected

    check_outputs()


@pytest.mark.slow
@settings(max_examples=15)
@given(stamped_events, st.integers(20_000, 51_000))
def test_restored_run_equals_continued_run(events: Any, instant: int) -> None:
    rules = "\n".join(OUT_OF_ORDER_PROGRAMS[name] for name in ("absent", "debounce", "every", "session"))
    arrivals = sorted((stamp + lag, text, stamp) for stamp, text, lag in with_beacons(events))
    restored = EngineDriver(rules, STATE)
    earlier = [arrival for arrival in arrivals if arrival[0] < instant * MILLISECOND]
    for receipt, text, stamp in earlier:
        restored.receive(text, stamp, receipt - stamp)
    restored.advance(instant * MILLISECOND)
    data = restored.engine.snapshot()
    restored.clock = StreamClock()
    restored.engine = Engine.restore(data, restored.clock)
    restored.engine.on_event(restored.record)
    restored.receive_all(arrivals[len(earlier) :])
    continued = EngineDriver(rules, STATE)
    assert restored.derived == continued.receive_all(arrivals)


def test_event_after_deadline_replaces_nothing() -> None:
    driver = EngineDriver(ALARM, watermark_delay=1)
    driver.receive("in(no)", 10 * SECOND)
    driver.receive("in(no)", 10 * SECOND + 600 * MILLISECOND)
    driver.advance(END)
    assert [start for _, start, _ in driver.derived] == [10 * SECOND, 10 * SECOND + 600 * MILLISECOND]


@pytest.mark.parametrize(
    ("arrivals", "starts"),
    [
        # Timestamps in ms, in order of receipt.
        ([400, 0], [400]),
        ([0, 400], [400]),
        ([500, 0], [0, 500]),
        ([0, 550, 300], [550]),
        ([550, 0, 300], [550]),
        ([0, 999, 500], [0, 999]),
    ],
)
def test_later_event_replaces_earlier_received_one(arrivals: List[int], starts: List[int]) -> None:
    driver = EngineDriver(ALARM, watermark_delay=2)
    for stamp in arrivals:
        driver.receive("in(no)", 10 * SECOND + stamp * MILLISECOND, (1000 - stamp) * MILLISECOND)
    driver.advance(END)
    assert [start for _, start, _ in driver.derived] == [
        10 * SECOND + stamp * MILLISECOND for stamp in starts
    ]


def test_explanation_names_waiting_alarm() -> None:
    driver = EngineDriver("", watermark_delay=1)
    record_origins(driver.engine)
    driver.engine.load(rules=ALARM)
    driver.receive("in(no)", 10 * SECOND)
    driver.advance(11 * SECOND)
    text = str(explain(driver.engine, "alarm"))
    assert "the time after it is over, and the alarm waits 1 s for late events" in text


def test_lags_of_oldest_names_are_dropped() -> None:
    driver = EngineDriver("lost <- beat seq absent(beat, 2).")
    driver.receive("beat", SECOND, MAX_LAG)
    for number in range(MAX_TOPICS):
        driver.engine.event(f"name{number}(1)")
    names = {lag.event for lag in driver.engine.status(2 * MAX_TOPICS).lags}
    assert len(names) == MAX_TOPICS
    assert "beat/0" not in names
    driver.receive("beat", 2 * SECOND, MAX_LAG)
    assert driver.engine.status().rules[0].delay == MAX_LAG
