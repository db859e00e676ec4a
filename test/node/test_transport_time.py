"""Time of a host: epochs, alarms and receipt stamps."""

import threading
from typing import Any, Iterator, List

import pytest
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import Engine, Reports, functor
from retalis.node import transport_time
from retalis.node.transport_time import HostClock, Receipts, ReceiptStamps, SimulatedTime
from retalis.prolog.terms.timestamps import SECOND


def test_receipt_stamps_are_distinct_in_each_epoch() -> None:
    times = [5, 5, 5, 4.5, 5.5, 2, 2, 9]
    receipts = Receipts(lambda: int(times[0] * SECOND))
    stamps: List[Any] = []
    while times:
        stamps.append(receipts.stamp())
        times.pop(0)
    assert stamps == [
        *(5 * SECOND + offset for offset in range(4)),
        5 * SECOND + SECOND // 2,
        2 * SECOND,
        2 * SECOND + 1,
        9 * SECOND,
    ]


def test_stamp_of_reception_increases() -> None:
    now = 100 * SECOND
    stamp = ReceiptStamps(lambda: now).stamp
    received = [90 * SECOND, 91 * SECOND, 91 * SECOND, 90 * SECOND, 92 * SECOND]
    assert [stamp(instant) for instant in received] == [
        90 * SECOND,
        91 * SECOND,
        91 * SECOND + 1,
        91 * SECOND + 2,
        92 * SECOND,
    ]


@pytest.mark.parametrize("received", [0, 40 * SECOND, 101 * SECOND])
def test_instant_of_other_clock_is_no_stamp(received: int) -> None:
    assert ReceiptStamps(lambda: 100 * SECOND).stamp(received) is None


def test_stamps_follow_clock_that_was_set_back() -> None:
    times = iter([100 * SECOND, 50 * SECOND])
    stamp = ReceiptStamps(lambda: next(times)).stamp
    assert [stamp(99 * SECOND), stamp(49 * SECOND)] == [99 * SECOND, 49 * SECOND]


def test_wall_time_has_no_epochs() -> None:
    network = MemoryNetwork()
    time = SimulatedTime(MemoryTransport(network), Reports())
    time.start([], lambda end: None)
    assert (time.epochs, time.epoch(), time.buffers_early_messages()) == (None, 0, False)
    assert time.now() == network.now


class SimulatedClock:
    """Simulated time of a host, whose epochs begin at once.

    Attributes:
        ends: ends of the epochs in ns.
    """

    def __init__(self) -> None:
        self._network = MemoryNetwork(now=0)
        self.transport = MemoryTransport(self._network, is_time_simulated=True)
        self.ends: List[Any] = []
        self._begun = threading.Semaphore(0)
        self.time = SimulatedTime(self.transport, Reports())
        self.time.start([threading.Lock()], self._record)

    def _record(self, end: Any) -> None:
        self.ends.append(end)
        self._begun.release()

    def move(self, seconds: int, back: bool = False) -> None:
        self._network.now = seconds * SECOND
        for callback in self.transport.clock_callbacks:
            callback(self._network.now)
        assert not back or self._begun.acquire(timeout=60)


@pytest.fixture
def clock() -> Iterator[SimulatedClock]:
    clock = SimulatedClock()
    yield clock
    clock.transport.shut_down()
    # A clock that moves backwards wakes the thread, which ends.
    for seconds in (1000, 0):
        clock.move(seconds)
    for thread in threading.enumerate():
        if thread.name == "epochs of the clock":
            thread.join(60)


def test_backward_clock_begins_epoch(clock: SimulatedClock) -> None:
    for seconds in (8, 9):
        clock.move(seconds)
    clock.move(2, back=True)
    assert clock.ends == [9 * SECOND]
    assert clock.time.now() == 2 * SECOND


def test_engine_time_follows_begun_epoch(clock: SimulatedClock, monkeypatch: pytest.MonkeyPatch) -> None:
    host_clock = HostClock(clock.transport, clock.time.epochs)
    clock.move(9)
    clock.move(2, back=True)
    assert host_clock.now() == 9 * SECOND
    host_clock.begin_epoch(clock.time.epoch())
    assert (host_clock.now(), host_clock.went_back()) == (2 * SECOND, True)
    clock.move(0, back=True)
    assert host_clock.now() == 2 * SECOND
    # The wait for the begin of the epoch times out.
    monkeypatch.setattr(transport_time, "MAX_EPOCH_WAIT_SECONDS", -1.0)
    assert host_clock.now() == 0


def test_resumed_clock_waits_for_first_time(clock: SimulatedClock) -> None:
    host_clock = HostClock(clock.transport, clock.time.epochs)
    host_clock.restore({**host_clock.snapshot(), "newest": 5 * SECOND})
    host_clock.start(lambda: None, is_resumed=True)
    assert (host_clock.now(), host_clock.went_back()) == (5 * SECOND, False)
    clock.move(9)
    assert (host_clock.now(), host_clock.went_back()) == (9 * SECOND, False)


def make_engine(network: MemoryNetwork) -> Engine:
    clock = HostClock(MemoryTransport(network))
    engine = Engine(clock)
    clock.start(engine.advance)
    return engine


def test_started_clock_sets_timer_of_restored_engine(network: MemoryNetwork) -> None:
    engine = make_engine(network)
    engine.load(rules="exceptionAlarm(late(X), 5) <- a(X).")
    engine.post(functor("a", 1)(1))
    state = engine.snapshot()
    network.timers.clear()
    start, network.now = network.now, 0
    clock = HostClock(MemoryTransport(network))
    restored = Engine.restore(state, clock)
    assert network.timers == []
    clock.start(restored.advance)
    network.now = start + SECOND
    restored.advance()
    (timer,) = network.timers
    assert timer.instant - network.now == 4 * SECOND


@pytest.mark.parametrize("is_stamped", [True, False])
def test_absence_is_detected_by_a_timer(network: MemoryNetwork, is_stamped: bool) -> None:
    engine = make_engine(network)
    engine.load(rules="gone(K) <- a(K) seq absent(b(K), 5).")
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append((engine.show(term), end // SECOND)))
    engine.post(functor("a", 1)(1), network.now if is_stamped else None)
    (timer,) = network.timers
    assert timer.instant - network.now == 5 * SECOND
    network.move_time(20)
    assert events == [("a(1)", 1000), ("gone(1)", 1005)]
