import pytest

from retalis import Clock, Engine, StreamClock, atom
from retalis.prolog.terms.timestamps import SECOND


def test_stamps_never_repeat_and_never_go_back():
    times = iter([5, 5, 4, 100])
    clock = Clock(lambda: next(times))
    assert [clock.stamp() for _ in range(4)] == [5, 6, 7, 100]


def test_alarms_come_in_order_and_only_when_due():
    clock = StreamClock()
    rung = []
    clock.call_at(20, lambda instant: rung.append(("b", instant)))
    clock.call_at(10, lambda instant: rung.append(("a", instant)))
    assert clock.next_alarm() == 10
    assert clock.due() is None
    clock.move_to(15)
    instant, alarm = clock.due()
    alarm(instant)
    assert clock.due() is None
    clock.move_to(20)
    instant, alarm = clock.due()
    alarm(instant)
    assert rung == [("a", 10), ("b", 20)]
    assert clock.next_alarm() is None


def test_a_stream_clock_goes_back_only_when_told_and_stands_still_when_pinned():
    clock = StreamClock(100)
    clock.move_to(50)
    assert clock.now() == 100
    clock.move_to(50, back=True)
    assert clock.now() == 50
    clock.pin(7)
    clock.move_to(1000)
    assert clock.now() == 7


def test_a_jump_back_of_more_than_a_second_is_noticed_once():
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


def test_the_first_stamp_is_the_present_and_not_later():
    clock = StreamClock()
    assert [clock.stamp(), clock.stamp()] == [0, 1]
    clock.move_to(5 * SECOND)
    assert not clock.went_back()
    clock.move_to(0, back=True)
    assert clock.went_back()
    assert clock.stamp() == 0


def test_a_stamp_at_once_is_the_next_stamp_where_nothing_else_is_due():
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


def confirmed_clock(instant):
    """Return a clock whose first timestamps, 11 s before, were confirmed by later ones."""
    clock = StreamClock()
    for second in (-11, -5, 0):
        clock.follow_checked(instant + second * SECOND, "a")
    assert clock.now() == instant and not clock.jumps.is_on_trial
    return clock


@pytest.mark.parametrize("look", [lambda clock: clock.is_quiet(), lambda clock: clock.follow(0)])
def test_a_clock_is_quiet_while_nothing_is_due_and_time_goes_on(look):
    clock = confirmed_clock(50)
    assert look(clock)
    clock.call_at(60, lambda instant: None)
    assert look(clock)
    clock.move_to(60)
    assert not look(clock)
    clock.due(60)
    assert look(clock)
    clock.move_to(40, back=True)
    assert not look(clock), "time went back"
    assert clock.now() == 40


@pytest.mark.parametrize(
    "look", [lambda clock: clock.is_quiet(), lambda clock: clock.stamp_at_once() is not None]
)
def test_alarms_of_a_pinned_clock_are_due_by_the_time_of_the_stream(look):
    clock = StreamClock()
    clock.pin(10)
    clock.call_at(60, lambda instant: None)
    assert look(clock)
    clock.move_to(60)
    assert not look(clock)


def test_alarms_ring_by_the_time_of_a_stream_whose_clock_is_pinned():
    clock = StreamClock()
    clock.pin(SECOND)
    engine = Engine(clock)
    engine.load(rules="exceptionAlarm(late, 5) <- start.")
    found = []
    engine.on_event(lambda term, start, end: found.append((engine.show(term), end)))
    engine.post(atom("start"), SECOND)
    clock.move_to(10 * SECOND)
    engine.post(atom("x"), 10 * SECOND)
    assert found == [("start", SECOND), ("late", 6 * SECOND), ("x", 10 * SECOND)]


def test_a_clock_follows_events_as_far_as_nothing_is_due():
    clock = confirmed_clock(0)
    assert clock.follow(50) and clock.now() == 50
    assert clock.follow(40) and clock.now() == 50, "an event that is late moves nothing"
    clock.call_at(60, lambda instant: None)
    assert not clock.follow(60) and clock.now() == 50, "the alarm is looked at first"
    clock.due(60)
    clock.pin(70)
    assert not clock.follow(80), "a pinned clock does not show the time of the stream"


def test_it_is_seen_that_somebody_has_put_a_followed_clock_back():
    clock = confirmed_clock(0)
    assert clock.follow(5 * SECOND)
    clock.move_to(0, back=True)
    assert not clock.follow(6 * SECOND)
    assert clock.now() == 0 and clock.went_back()


def test_an_alarm_that_is_not_due_has_the_source_asked_no_more_often():
    asked = []
    clock = Clock(lambda: asked.append(1) or 5 * SECOND)
    clock.call_at(9 * SECOND, print)
    assert clock.is_quiet()
    assert len(asked) == 1
