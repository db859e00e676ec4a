"""Timers by wall time and by a clock that a test sets."""

import threading
import time
from typing import Any, Callable, Iterator, List

import pytest

from retalis.ros2.timer_thread import TransportTimers

SECOND = 10**9


class TestClock:
    """A clock that a test sets.

    Attributes:
        instant: its time in ns.
    """

    __test__ = False

    def __init__(self) -> None:
        self.instant = 0

    def now(self) -> int:
        return self.instant


@pytest.fixture
def make_timers() -> Iterator[Callable[..., TransportTimers]]:
    created: List[TransportTimers] = []

    def make(now: Callable[[], int], is_simulated: bool = False, on_error: Any = print) -> TransportTimers:
        created.append(TransportTimers(now, is_simulated, on_error))
        return created[-1]

    yield make
    for timers in created:
        timers.stop()


def test_timer_calls_function_once(make_timers: Any) -> None:
    timers = make_timers(time.time_ns)
    is_called, calls = threading.Event(), []

    def call() -> None:
        calls.append(1)
        is_called.set()

    timers.call_later(0, call)
    assert is_called.wait(60)
    is_next_called = threading.Event()
    timers.call_later(1_000_000, is_next_called.set)
    assert is_next_called.wait(60)
    assert calls == [1]


def test_earlier_timer_is_called_first(make_timers: Any) -> None:
    clock = TestClock()
    timers = make_timers(clock.now, is_simulated=True)
    calls: List[str] = []
    is_done = threading.Event()
    timers.call_later(3 * SECOND, is_done.set)
    timers.call_later(2 * SECOND, lambda: calls.append("late"))
    timers.call_later(1 * SECOND, lambda: calls.append("early"))
    clock.instant = 3 * SECOND
    timers.notify()
    assert is_done.wait(60)
    assert calls == ["early", "late"]


def test_canceled_timer_is_not_called(make_timers: Any) -> None:
    clock = TestClock()
    timers = make_timers(clock.now, is_simulated=True)
    calls: List[str] = []
    is_done = threading.Event()
    timers.call_later(1 * SECOND, lambda: calls.append("canceled")).cancel()
    timers.call_later(2 * SECOND, is_done.set)
    clock.instant = 2 * SECOND
    timers.notify()
    assert is_done.wait(60)
    assert calls == []


def test_timer_waits_for_simulated_time(make_timers: Any) -> None:
    clock = TestClock()
    timers = make_timers(clock.now, is_simulated=True)
    is_called = threading.Event()
    timers.call_later(5 * SECOND, is_called.set)
    clock.instant = 4 * SECOND
    timers.notify()
    is_earlier_called = threading.Event()
    timers.call_later(0, is_earlier_called.set)
    assert is_earlier_called.wait(60)
    assert not is_called.is_set()


def test_error_of_function_does_not_end_timers(make_timers: Any) -> None:
    errors: List[Exception] = []
    timers = make_timers(time.time_ns, on_error=errors.append)
    is_called = threading.Event()
    timers.call_later(0, lambda: 1 // 0)
    timers.call_later(1, is_called.set)
    assert is_called.wait(60)
    assert [type(error) for error in errors] == [ZeroDivisionError]


def test_canceled_timers_are_removed(make_timers: Any) -> None:
    clock = TestClock()
    timers = make_timers(clock.now, is_simulated=True)
    for _ in range(10_000):
        timers.call_later(3600 * SECOND, print).cancel()
    assert timers.count() <= 1_001


def test_stopped_timers_call_nothing(make_timers: Any) -> None:
    clock = TestClock()
    timers = make_timers(clock.now, is_simulated=True)
    calls: List[str] = []
    timers.call_later(SECOND, lambda: calls.append("late"))
    timers.stop()
    clock.instant = 2 * SECOND
    timers.notify()
    timers.join()
    assert calls == []
