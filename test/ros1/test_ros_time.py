"""ROS time, its epochs, and receipt stamps. Needs rospy, no master."""

import threading
import time

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Engine, Reports, functor  # noqa: E402
from retalis.prolog.terms.timestamps import SECOND  # noqa: E402
from retalis.ros1 import retalis_node, ros_time  # noqa: E402


@pytest.fixture
def warnings(monkeypatch):
    found = []
    monkeypatch.setattr(rospy, "logwarn_once", found.append)
    monkeypatch.setattr(ros_time, "is_wallclock", lambda: False)
    return found


def test_a_clock_that_stands_still_is_warned_of_after_a_while(warnings, monkeypatch):
    monkeypatch.setattr(rospy, "get_rostime", rospy.Time)
    monkeypatch.setattr(ros_time, "_began", time.monotonic())
    assert ros_time.ros_now() == 0
    assert warnings == []
    monkeypatch.setattr(ros_time, "_began", time.monotonic() - 2 * ros_time.UNSET_CLOCK_WARNING_SECONDS)
    assert ros_time.ros_now() == 0
    assert len(warnings) == 1
    assert "nothing publishes /clock" in warnings[0]


def test_a_clock_that_runs_is_not_warned_of(warnings, monkeypatch):
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(3, 4))
    monkeypatch.setattr(ros_time, "_began", time.monotonic() - 2 * ros_time.UNSET_CLOCK_WARNING_SECONDS)
    assert ros_time.ros_now() == 3_000_000_004
    assert warnings == []


def test_receipts_are_all_different_and_start_anew_where_time_goes_back(monkeypatch):
    times = [5, 5, 5, 4.5, 5.5, 2, 2, 9]
    monkeypatch.setattr(ros_time, "is_wallclock", lambda: False)
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time.from_sec(times[0]))
    receipts = ros_time.Receipts()
    found = []
    while times:
        found.append(receipts.stamp())
        times.pop(0)
    second = 10**9
    assert found == [
        *(5 * second + more for more in (0, 1, 2, 3)),
        5 * second + second // 2,
        *(2 * second + more for more in (0, 1)),
        9 * second,
    ]


def test_time_that_is_not_simulated_has_no_runs(monkeypatch):
    monkeypatch.setattr(ros_time, "is_wallclock", lambda: True)
    simulated = ros_time.SimulatedTime(Reports())
    simulated.start([], lambda end: None)
    assert (simulated.epochs, simulated.buffers_early_messages()) == (None, False)
    assert abs(simulated.now() - time.time_ns()) < 10**9


@pytest.fixture
def clock(warnings, monkeypatch):
    """Return simulated time, of which each run begins at once, with what sets it and notes where runs ended."""
    ended, callbacks, begun, shutdown = [], [], threading.Semaphore(0), threading.Event()
    monkeypatch.setattr(rospy, "get_rostime", rospy.Time)
    monkeypatch.setattr(rospy, "is_shutdown", shutdown.is_set)
    monkeypatch.setattr(rospy, "Subscriber", lambda topic, kind, callback: callbacks.append(callback))
    simulated = ros_time.SimulatedTime(Reports())

    def note(end):
        ended.append(end)
        begun.release()

    def move(seconds, back=False):
        callbacks[0](ros_time.ClockMessage(rospy.Time(seconds)))
        assert not back or begun.acquire(timeout=60)

    simulated.start([threading.Lock()], note)
    simulated.move, simulated.ended = move, ended
    yield simulated
    shutdown.set()
    for seconds in (1000, 0):  # a clock that goes back wakes the thread, which ends
        move(seconds)
    for thread in threading.enumerate():
        if thread.name == "runs of /clock":
            thread.join(60)


def test_a_run_begins_when_the_clock_goes_back(clock):
    for seconds in (8, 9):
        clock.move(seconds)
    clock.move(2, back=True)
    assert clock.ended == [9 * 10**9]
    assert clock.now() == 2 * 10**9


def test_the_time_of_an_engine_goes_back_when_it_is_told(clock, monkeypatch):
    its = retalis_node.RosClock(clock.epochs)
    clock.move(9)
    clock.move(2, back=True)
    assert its.now() == 9 * 10**9
    its.begin_epoch(clock.epochs.epoch)
    assert (its.now(), its.went_back()) == (2 * 10**9, True)
    clock.move(0, back=True)
    assert its.now() == 2 * 10**9
    monkeypatch.setattr(retalis_node, "MAX_EPOCH_WAIT_SECONDS", -1.0)  # nobody tells it
    assert its.now() == 0


def test_a_clock_that_goes_on_waits_for_the_first_time(clock):
    its = retalis_node.RosClock(clock.epochs)
    its.restore([-1, 5 * 10**9, 0, 0])
    its.resumed = True
    assert (its.now(), its.went_back()) == (5 * 10**9, False)
    clock.move(9)
    assert (its.now(), its.went_back()) == (9 * 10**9, False)


@pytest.fixture
def timers(monkeypatch):
    """The timers that are set, in place of rospy's."""
    timers = []

    class Timer:
        def __init__(self, wait, callback, **options):
            self.seconds, self.callback = wait.to_sec(), callback
            timers.append(self)

        def shutdown(self):
            timers.remove(self)

    monkeypatch.setattr(rospy, "Timer", Timer)
    return timers


def test_an_engine_that_goes_on_sets_its_timer_when_it_is_there_and_knows_the_time(monkeypatch, timers):
    now = [1000 * SECOND]
    monkeypatch.setattr(retalis_node, "ros_now", lambda: now[0])
    clock = retalis_node.RosClock()
    clock.engine = engine = Engine(clock)
    engine.load(rules="exceptionAlarm(late(X), 5) <- a(X).")
    engine.post(functor("a", 1)(1))
    data = engine.snapshot()
    timers.clear()
    now[0] = 0  # /clock has said nothing yet
    other = Engine.restore(data, retalis_node.RosClock())
    assert timers == []
    other.clock.engine = other
    now[0] = 1001 * SECOND
    other.advance()
    [timer] = timers
    assert timer.seconds == 4


@pytest.mark.parametrize("stamped", [True, False], ids=["stamped", "unstamped"])
def test_what_waits_for_nothing_to_happen_rings_by_itself(monkeypatch, timers, stamped):
    now = [1000 * SECOND]
    monkeypatch.setattr(retalis_node, "ros_now", lambda: now[0])
    clock = retalis_node.RosClock()
    clock.engine = engine = Engine(clock)
    engine.load(rules="gone(K) <- a(K) seq absent(b(K), 5).")
    found = []
    engine.on_event(lambda term, start, end: found.append((engine.show(term), end // SECOND)))
    engine.post(functor("a", 1)(1), now[0] if stamped else None)
    [timer] = timers
    assert timer.seconds == 5
    now[0] += 20 * SECOND
    timer.callback(None)
    assert found == [("a(1)", 1000), ("gone(1)", 1005)]
