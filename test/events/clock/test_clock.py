"""Clocks: timestamps, alarms, and jumps of time."""

from typing import Any, List

import pytest
from asserting_accessors import required

from retalis import Clock, Engine, StreamClock, atom
from retalis.prolog.terms.timestamps import SECOND


def test_stamps_increase_strictly() -> None:
    times = iter([5, 5, 4, 100])
    clock = Clock(lambda: next(times))
    assert [clock.stamp() for _ in range(4)] == [5, 6, 7, 100]


def test_due_alarms_are_returned_in_order() -> None:
    clock = StreamClock()
    called: List[Any] = []
    clock.call_at(20, lambda instant: called.append(("b", instant)))
    clock.call_at(10, lambda instant: called.append(("a", instant)))
    assert clock.next_alarm() == 10
    assert clock.due() is None
    clock.move_to(15)
    instant, alarm = required(clock.due())
    alarm(instant)
    assert clock.due() is None
    clock.move_to(20)
    instant, alarm = required(clock.due())
    alarm(instant)
    assert called == [("a", 10), ("b", 20)]
    assert clock.next_alarm() is None


def test_stream_clock_moves_back_on_request_only() -> None:
    clock = StreamClock(100)
    clock.move_to(50)
    assert clock.now() == 100
    clock.move_to(50, back=True)
    assert clock.now() == 50
    clock.pin(7)
    clock.move_to(1000)
    assert clock.now() == 7


def test_jump_back_of_over_a_second_is_detected_once() -> None:
    clock = StreamClock(10 * SECOND)
    assert not clock.went_back()
    clock.stamp()
    clock.call_at(12 * SECOND, lambda instant: None)
    clock.move_to(9 * SECOND, back=True)
    assert not clock.went_back()
    clock.move_to(8 * SECOND, back=True)
    assert clock.went_back()
    assert not clock.went_back()
    assert clock.next_alarm() is None
    assert clock.stamp() == 8 * SECOND


def test_first_stamp_is_present_time() -> None:
    clock = StreamClock()
    assert [clock.stamp(), clock.stamp()] == [0, 1]
    clock.move_to(5 * SECOND)
    assert not clock.went_back()
    clock.move_to(0, back=True)
    assert clock.went_back()
    assert clock.stamp() == 0


def test_stamp_at_once_is_next_stamp_if_nothing_is_due() -> None:
    clock = StreamClock(0)
    assert [clock.stamp_at_once(), clock.stamp(), clock.stamp_at_once()] == [0, 1, 2]
    clock.move_to(50)
    assert clock.stamp_at_once() == 50
    clock.call_at(60, lambda instant: None)
    assert clock.stamp_at_once() == 51, "the alarm is not due"
    clock.move_to(60)
    assert clock.stamp_at_once() is None, "the alarm is due"
    clock.due(60)
    assert clock.stamp_at_once() == 60
    clock.move_to(40, back=True)
    assert clock.stamp_at_once() is None, "time went back"
    assert clock.stamp() == 61


def confirmed_clock(instant: int) -> StreamClock:
    """Return a clock whose first timestamps, 11 s before, were confirmed by later ones."""
    clock = StreamClock()
    for second in (-11, -5, 0):
        clock.follow_checked(instant + second * SECOND, "a")
    assert clock.now() == instant
    assert not clock.jumps.is_on_trial
    return clock


@pytest.mark.parametrize("is_quiet", [lambda clock: clock.is_quiet(), lambda clock: clock.follow(0)])
def test_clock_is_quiet_if_nothing_is_due(is_quiet: Any) -> None:
    clock = confirmed_clock(50)
    assert is_quiet(clock)
    clock.call_at(60, lambda instant: None)
    assert is_quiet(clock)
    clock.move_to(60)
    assert not is_quiet(clock)
    clock.due(60)
    assert is_quiet(clock)
    clock.move_to(40, back=True)
    assert not is_quiet(clock), "time went back"
    assert clock.now() == 40


@pytest.mark.parametrize(
    "is_quiet", [lambda clock: clock.is_quiet(), lambda clock: clock.stamp_at_once() is not None]
)
def test_alarms_of_pinned_clock_follow_stream_time(is_quiet: Any) -> None:
    clock = StreamClock()
    clock.pin(10)
    clock.call_at(60, lambda instant: None)
    assert is_quiet(clock)
    clock.move_to(60)
    assert not is_quiet(clock)


def test_pinned_clock_emits_alarms_by_stream_time() -> None:
    clock = StreamClock()
    clock.pin(SECOND)
    engine = Engine(clock)
    engine.load(rules="exceptionAlarm(late, 5) <- start.")
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append((engine.show(term), end)))
    engine.post(atom("start"), SECOND)
    clock.move_to(10 * SECOND)
    engine.post(atom("x"), 10 * SECOND)
    assert events == [("start", SECOND), ("late", 6 * SECOND), ("x", 10 * SECOND)]


def test_clock_follows_events_until_alarm_is_due() -> None:
    clock = confirmed_clock(0)
    assert clock.follow(50)
    assert clock.now() == 50
    # A late event does not move the clock.
    assert clock.follow(40)
    assert clock.now() == 50
    clock.call_at(60, lambda instant: None)
    # The due alarm comes first.
    assert not clock.follow(60)
    assert clock.now() == 50
    clock.due(60)
    clock.pin(70)
    assert not clock.follow(80), "a pinned clock does not show the time of the stream"


def test_reset_of_followed_clock_is_detected() -> None:
    clock = confirmed_clock(0)
    assert clock.follow(5 * SECOND)
    clock.move_to(0, back=True)
    assert not clock.follow(6 * SECOND)
    assert clock.now() == 0
    assert clock.went_back()


def test_pending_alarm_adds_no_reads_of_time_source() -> None:
    reads: List[int] = []

    def read() -> int:
        reads.append(1)
        return 5 * SECOND

    clock = Clock(read)
    clock.call_at(9 * SECOND, print)
    assert clock.is_quiet()
    assert len(reads) == 1
