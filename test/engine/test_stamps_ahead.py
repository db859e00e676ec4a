"""Events whose time is far ahead of the clock: errors do not move the clock, and jumps of all events do."""

from collections import Counter
from random import Random
from typing import Any, Dict, List

import pytest
from asserting_accessors import stream_clock
from nightly_round_numbers import round_numbers
from recording_reports import RecordingReports

from retalis import Engine, StreamClock
from retalis.prolog.terms.timestamps import SECOND, from_seconds

YEAR = 365 * 86_400
START = 1_700_000_000

TIMED_RULES = """
last_10(N) <- aggregate(count, tick, N, last(10)).
hopping(N) <- aggregate(count, tick, N, every(5)).
from_first(N) <- aggregate(count, tick, N, every(5, first)).
running(N) <- aggregate(count, tick, N, running(every(5))).
session(N) <- aggregate(count, tick, N, session(2, max(5))).
held(S) <- aggregate(duration(true), tick, S, held(every(5), max(1))).
held_last(S) <- aggregate(duration(true), tick, S, held(last(10))).
pair <- (left seq right) within 3.
silent <- left seq absent(never, 0.5).
"""


class FarStamps:
    """An engine with its default clock, its warnings, and counts of its events."""

    def __init__(self, rules: Any = TIMED_RULES) -> None:
        self.reports = RecordingReports()
        self.engine = Engine(reports=self.reports)
        self.engine.load(rules=rules, goals="timer(beat, every(10)).")
        self.counts: Counter[Any] = Counter()
        self.engine.on_event(lambda term, start, end: self.counts.update([functor_name(self.engine, term)]))

    def run(self, seconds: Any, wrong: Any = ()) -> Any:
        """Feed three events for each second; ``wrong`` maps seconds to the distance of the first one's time."""
        for second in seconds:
            self.engine.event("tick", START + second + dict(wrong).get(second, 0))
            self.engine.event("left", START + second + 0.1)
            self.engine.event("right", START + second + 0.2)
        return self.counts


def functor_name(engine: Any, term: Any) -> Any:
    return engine.show(term).partition("(")[0]


def test_single_stamp_far_ahead_does_not_move_time() -> None:
    expected = FarStamps().run(range(100))
    run = FarStamps()
    counts = run.run(range(100), {25: YEAR})
    assert (counts["last_10"], counts["running"], counts["held_last"]) == (99, 99, 99)
    for name in ("pair", "silent", "hopping", "from_first", "session", "held", "beat"):
        assert counts[name] == expected[name], name
    (warning,) = run.reports.messages
    assert warning.startswith(
        "event tick: its time is 365.0 days ahead of the clock, which does not follow it"
    )
    assert run.engine.status().ahead == 1


@pytest.mark.parametrize("distance", [60, 3600, 86_400, 29 * 86_400])
def test_clock_returns_from_single_stamp_ahead(distance: int) -> None:
    expected = FarStamps().run(range(200))
    run = FarStamps()
    counts = run.run(range(200), {50: distance})
    # Three events show the error; what they belong to is lost, and alarms between the two times ring once more.
    for name in ("last_10", "running", "held_last", "pair", "silent"):
        assert expected[name] - 3 <= counts[name] <= expected[name], name
    for name in ("hopping", "held"):
        assert counts[name] >= expected[name] - 1
    assert counts["beat"] >= expected["beat"]
    assert run.engine.clock.now() == from_seconds(START + 199.2)
    # One line names the event; the other one is that of a rule with a late event.
    (warning,) = [text for text in run.reports.messages if text.startswith("event ")]
    assert "event tick/0: its time was " in warning
    assert "ahead of the other events" in warning
    assert run.engine.status().ahead == 1


def test_windows_are_right_after_clock_returned() -> None:
    values: List[Any] = []
    run = FarStamps("last_10(N) <- aggregate(count, tick, N, last(10)).")
    run.engine.on_event(lambda term, start, end: values.append((end, run.engine.show(term))))
    run.run(range(100), {50: 3600})
    later = [text for end, text in values if 62 <= end / SECOND - START < 100 and "last" in text]
    assert later == ["last_10(10)"] * 38


@pytest.mark.parametrize("wrong", [{25: 3600, 26: 3601}, {25: 3600, 26: 86_400}, {25: YEAR, 26: YEAR}])
def test_wrong_stamps_of_event_are_one_source(wrong: Dict[Any, Any]) -> None:
    expected = FarStamps().run(range(100))
    run = FarStamps()
    counts = run.run(range(100), wrong)
    assert run.engine.clock.now() == from_seconds(START + 99.2)
    for name in ("last_10", "running", "pair", "silent"):
        assert expected[name] - 4 <= counts[name] <= expected[name], name


def test_burst_of_wrong_stamps_before_other_events() -> None:
    run = FarStamps()
    run.run(range(20))
    for hundredth in range(30):
        run.engine.event("tick", START + 3600 + 20 + hundredth / 100)
    run.run(range(21, 60))
    assert run.engine.clock.now() == from_seconds(START + 59.2)
    assert run.counts["pair"] >= 57


@pytest.mark.parametrize("offset", [3600, YEAR])
def test_single_source_of_other_date_moves_no_clock(offset: int) -> None:
    expected = FarStamps().run(range(100))
    run = FarStamps()
    counts = run.run(range(100), dict.fromkeys(range(10, 100), offset))
    assert run.engine.clock.now() == from_seconds(START + 99.2)
    assert expected["pair"] - 3 <= counts["pair"] <= expected["pair"]
    assert run.engine.status().ahead >= 88
    assert len(run.reports.messages) < 30, "reports are throttled"


@pytest.mark.parametrize("distance", [3600, YEAR])
def test_clock_returns_from_first_stamp_ahead(distance: int) -> None:
    expected = FarStamps().run(range(100))
    counts = FarStamps().run(range(100), {0: distance})
    assert counts["last_10"] >= 99
    for name in ("pair", "silent", "beat"):
        assert counts[name] >= expected[name] - 1, name


@pytest.mark.parametrize("offset", [3600, 40 * 86_400, 20 * YEAR])
def test_stream_with_other_date_is_processed(offset: int) -> None:
    run = FarStamps()
    shifted = FarStamps()
    shifted_engine = shifted.engine
    for second in range(50):
        for event, fraction in (("tick", 0), ("left", 0.1), ("right", 0.2)):
            run.engine.event(event, START + second + fraction)
            shifted_engine.event(event, START + offset + second + fraction)
    assert {**shifted.counts, "beat": 0} == {**run.counts, "beat": 0}
    assert shifted.reports.messages == []


@pytest.mark.parametrize("pause", [11, 3600, 20 * 86_400])
def test_pause_is_no_error(pause: int) -> None:
    expected, run = FarStamps(), FarStamps()
    expected.run(range(50))
    run.run(range(50))
    expected.run(range(60, 110))
    # Nothing is refused, and alarms before the first event after the pause ring before it.
    for second in range(50):
        for event, fraction in (("tick", 0), ("left", 0.1), ("right", 0.2)):
            run.engine.event(event, START + 50 + pause // 10 * 10 + second + fraction)
    for name in ("last_10", "running", "pair", "silent", "hopping", "from_first"):
        assert run.counts[name] == expected.counts[name], name
    assert [text for text in run.reports.messages if not text.startswith("time has jumped")] == []
    assert run.engine.status().ahead == 0


def test_stream_with_rare_events_moves_clock_at_each() -> None:
    run = FarStamps("late(X) <- in(X) seq absent(never, 5).")
    for hour in range(30):
        run.engine.event(f"in({hour})", START + 3600 * hour)
    assert run.counts["late"] == 29
    assert run.reports.messages == []


def test_other_date_of_all_events_moves_clock() -> None:
    run = FarStamps("late <- left seq absent(never, 1).")
    run.run(range(5))
    run.run(range(YEAR + 5, YEAR + 15))
    assert run.engine.clock.now() < (START + 6) * SECOND
    run.run(range(YEAR + 15, YEAR + 20))
    assert run.engine.clock.now() == from_seconds(START + YEAR + 19.2)
    assert run.counts["late"] == 19


def test_late_events_after_pause_move_clock_back_once() -> None:
    run = FarStamps()
    run.run(range(20))
    run.engine.event("tick", START + 3600)
    for _ in range(3):
        run.engine.event("slow", START + 19)
    run.run(range(3601, 3620))
    assert run.engine.clock.now() == from_seconds(START + 3619.2)
    assert run.counts["pair"] == 39


@pytest.mark.parametrize(
    "rule",
    [
        "out(N) <- aggregate(count, tick, N, last(10)).",
        "out(N) <- aggregate(count, left, N, last(3)).",
        "out(N) <- aggregate(count, tick, N, every(5)).",
        "out(N) <- aggregate(count, tick, N, running(every(5))).",
        "out(N) <- aggregate(count, tick, N, last(10, every(5))).",
        "out <- tick with debounce(0.5).",
        "out <- left seq absent(never, 0.5).",
        "out <- (tick seq right) within 3.",
        "out <- (tick and right) within 0.5.",
        "out <- (left seq right seq left) within 5.",
    ],
)
def test_rule_is_right_after_clock_returned(rule: str) -> None:
    results: List[Any] = []
    for wrong in ({}, {50: 3600}):
        run = FarStamps(rule)
        outputs: List[Any] = []
        # The longest window, of 10 s, has only events after the return.
        run.run(range(63), wrong)
        run.engine.on_event(
            lambda term, start, end, run=run, outputs=outputs: outputs.append(
                (run.engine.show(term), start, end)
            )
        )
        run.run(range(63, 120))
        results.append(outputs)
    assert results[0] == results[1]
    assert any(text.startswith("out") for text, _, _ in results[0])


@pytest.mark.parametrize(
    "rule",
    [
        "out(N) <- aggregate(count, tick, N, every(5, first)).",
        "out(N) <- aggregate(count, tick, N, running(every(5, first))).",
        "out <- tick with throttle(5).",
        "out <- tick with burst(0.5).",
    ],
)
def test_operator_continues_after_clock_returned(rule: str) -> None:
    """The wrong event may have begun another window, so only the numbers of outputs agree."""
    counts: List[Any] = []
    for wrong in ({}, {50: 3600}):
        run = FarStamps(rule)
        run.run(range(56), wrong)
        run.counts.clear()
        counts.append(run.run(range(56, 120))["out"])
    assert counts[0] > 10
    assert abs(counts[0] - counts[1]) <= 1


def test_subscription_continues_after_clock_returned() -> None:
    counts: List[Any] = []
    for wrong in ({}, {50: 3600}):
        run = FarStamps("pair <- left seq right.")
        sent: List[Any] = []
        run.engine.load(goals="subscribe(tick with throttle(5), [], tick, ticks, a)")
        run.run(range(56), wrong)
        run.engine.on_output(lambda term, topic, name, sent=sent: sent.append(term))
        run.run(range(56, 120))
        counts.append(len(sent))
    assert counts == [12, 13]


def test_memory_and_state_do_not_stay_in_future() -> None:
    engine = Engine()
    engine.load(goals="memorize(at(_), [], _, place, 1)")
    for second, ahead in ((0, 0), (1, 3600), (2, 0), (3, 0), (4, 0), (5, 0)):
        engine.event(f"at({second})", START + second + ahead)
    assert engine.query("prev(place, at(Place), _, _, 1700000005)") == [{"Place": 5}]


def test_state_that_begins_ahead_is_removed() -> None:
    engine, states = Engine(), []
    engine.load(rules=":- state(open, from(opened), until(closed)).")
    engine.on_event(lambda term, start, end: states.append((engine.show(term), start, end)))
    for second in range(20):
        engine.event("tick", START + second)
    engine.event("opened", START + 3600)
    for second in range(21, 25):
        engine.event("tick", START + second)
    assert not engine.call("holds(open)")
    engine.event("opened", START + 26)
    engine.event("closed", START + 28)
    assert states[-1] == ("open", (START + 26) * SECOND, (START + 28) * SECOND)


def random_stream(random: Any) -> Any:
    """Return events of four names with times in order, except some that are wrong by a minute to a year."""
    time, events = START, []
    for _ in range(150):
        time += random.choice((0.1, 0.5, 1, 1, 3, 15))
        name = random.choice(("tick", "left", "right", "never"))
        wrong = random.choice((60, 3600, 86_400, YEAR)) if random.random() < 0.05 else 0
        events.append((name, time + wrong + random.choice((0, 0, -0.3))))
    return events


def outputs_of(engine: Engine) -> Any:
    outputs: List[Any] = []
    engine.on_event(lambda term, start, end: outputs.append((engine.show(term), start, end)))
    return outputs


OTHER_RULES = """
slow <- tick with throttle(5).
settled <- tick with debounce(2).
of_five(N) <- aggregate(count, left, N, last(5)).
changed(N) <- aggregate(count, tick, N, every(3)) with throttle(2).
"""


@pytest.mark.parametrize("has_receipt_clock", [False, True])
@pytest.mark.parametrize("seed", round_numbers(3, 60))
def test_restored_engine_has_same_outputs(seed: int, has_receipt_clock: bool) -> None:
    random = Random(seed)
    clock, restored_clock = (StreamClock(1), StreamClock(1)) if has_receipt_clock else (None, None)
    engine, restored = Engine(clock), Engine(restored_clock)
    for program in (engine, restored):
        program.load(
            rules=TIMED_RULES + OTHER_RULES,
            goals="timer(beat, every(10)).\nsubscribe(tick with debounce(2), [], tick, ticks, a).",
        )
    outputs, restored_outputs = outputs_of(engine), outputs_of(restored)
    receipt = 0
    for name, time in random_stream(random):
        # The receipt clock has the time of the stream without its errors.
        receipt = max(receipt, from_seconds(min(time, receipt / SECOND + 3 if receipt else time)))
        for program in (engine, restored):
            if has_receipt_clock:
                stream_clock(program).move_to(receipt)
            program.event(name, time)
        if random.random() < 0.1:
            restored = Engine.restore(restored.snapshot())
            outputs_before, restored_outputs = restored_outputs, outputs_of(restored)
            restored_outputs += outputs_before
    assert restored_outputs == outputs
    assert restored.clock.now() == engine.clock.now()
    status, restored_status = engine.status(), restored.status()
    assert restored_status.ahead == status.ahead
    assert [rule.ahead for rule in restored_status.rules] == [rule.ahead for rule in status.rules]
    assert restored_status.subscriptions[0].ahead == status.subscriptions[0].ahead


def test_window_on_receipt_clock_reports_stamp_ahead() -> None:
    reports = RecordingReports()
    engine = Engine(StreamClock(START * SECOND), reports=reports)
    engine.load(rules="n(N) <- aggregate(count, tick, N, every(5, first)).")
    engine.event("tick", START)
    engine.event("tick", START + 60)
    (warning,) = reports.messages
    assert "event tick is 60.0 s ahead of the clock" in warning
