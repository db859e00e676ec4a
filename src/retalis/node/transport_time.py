"""Time of a running program: its clock with alarms, the epochs of simulated time, and receipt stamps."""

import logging
import threading
import time
from typing import Callable, ContextManager, Optional, Sequence, Tuple

from ..engine.runtime.clock_epochs import ClockEpochs
from ..engine.runtime.problem_reports import Reports
from ..events.clock.clock import Alarm, Clock
from ..prolog.terms.timestamps import SECOND
from .transport import Transport

log = logging.getLogger("retalis")

MAX_EPOCH_WAIT_SECONDS = 10.0
"""Longest delay in seconds until the engine enters a new clock epoch.

A full queue may have dropped the announcement of the epoch.
"""

MIN_TIMER_NANOSECONDS = 1_000_000
"""Shortest delay of a timer; the alarm may be due by now."""


class SimulatedTime:
    """Time of a transport, with clock epochs if it is simulated.

    When simulated time jumps back, all parts of the node enter the new epoch at the same moment; see `ClockEpochs`.

    Args:
        transport: the middleware.
        reports: receives errors.

    Attributes:
        epochs: the epochs; None for wall time.
    """

    def __init__(self, transport: Transport, reports: Reports):
        self._transport = transport
        self._reports = reports
        self._wake_up = threading.Event()
        self.epochs = (
            ClockEpochs(reports, transport.now, self._wake_up.set) if transport.is_time_simulated else None
        )

    def now(self) -> int:
        """Return the time of the present epoch in nanoseconds."""
        return self._transport.now() if self.epochs is None else self.epochs.now()

    def epoch(self) -> int:
        """Return the number of the present epoch; 0 for wall time."""
        return 0 if self.epochs is None else self.epochs.epoch

    def buffers_early_messages(self) -> bool:
        """Return whether messages may be queued for an epoch that has not begun."""
        return self.epochs is not None and self.epochs.buffers_early_messages()

    def start(self, locks: Sequence[ContextManager[object]], *callbacks: Callable[[int], object]) -> None:
        """Start to follow the simulated clock; see `ClockEpochs.register_callbacks`."""
        epochs = self.epochs
        if epochs is None:
            return
        epochs.register_callbacks(locks, *callbacks)

        def update_epochs() -> None:
            timeout: Optional[float] = None
            while not self._transport.is_shut_down():
                self._wake_up.wait(timeout)
                self._wake_up.clear()
                try:
                    timeout = epochs.update()
                except Exception as error:
                    # The next step continues the work of this one.
                    self._reports.error(error)

        # A thread that waits would keep the program alive; a node of ROS 2 may start and end any number of programs.
        self._transport.on_shutdown(self._wake_up.set)
        threading.Thread(target=update_epochs, daemon=True, name="epochs of the clock").start()
        self._transport.on_clock(epochs.update_clock)


class HostClock(Clock):
    """Time of a transport, simulated or not, with alarms that wake the engine.

    Args:
        transport: the middleware.
        epochs: epochs of simulated time; None for wall time.
    """

    def __init__(self, transport: Transport, epochs: Optional[ClockEpochs] = None) -> None:
        super().__init__(transport.now if epochs is None else lambda: self._time_of_epoch(epochs))
        self._transport = transport
        self._epoch = 0
        self._is_resumed = False
        self._wake_engine: Optional[Callable[[], object]] = None
        self._cancel_timer: Optional[Callable[[], object]] = None
        self._timer_instant: Optional[int] = None

    def start(self, wake_engine: Callable[[], object], is_resumed: bool = False) -> None:
        """Start to wake the engine for alarms.

        Args:
            wake_engine: has the engine run the alarms that are due.
            is_resumed: whether the engine continues from a checkpoint, and simulated time is still unknown.
        """
        self._wake_engine = wake_engine
        self._is_resumed = is_resumed

    def _time_of_epoch(self, epochs: ClockEpochs) -> int:
        """Return the time of the engine's epoch; messages of an older epoch may still be queued."""
        if self._epoch != epochs.epoch and time.monotonic() - epochs.epoch_start > MAX_EPOCH_WAIT_SECONDS:
            self._epoch = epochs.epoch
        now = epochs.now(self._epoch)
        if self._is_resumed and not now:
            # Without a message of the clock, time is 0, which is not a jump back.
            return self._newest
        self._is_resumed = False
        return now

    def begin_epoch(self, epoch: int) -> None:
        """Set the engine's clock epoch."""
        self._epoch = epoch

    def call_at(self, instant: int, alarm: Alarm) -> None:
        """Schedule ``alarm`` for an instant in nanoseconds."""
        super().call_at(instant, alarm)
        self._set_timer()

    def put_back(self, instant: int, order: int, alarm: Alarm) -> None:
        """Schedule ``alarm`` with the order that it had in another clock; see `call_at`."""
        super().put_back(instant, order, alarm)
        self._set_timer()

    def due(self, until: Optional[int] = None) -> Optional[Tuple[int, Alarm]]:
        """Remove and return the next due alarm; if there is none, start the timer for the next one.

        The timer is started here, in the engine's thread, and not when it fires: a busy engine would be called again
        and again for the same alarm.
        """
        due_alarm = super().due(until)
        if due_alarm is None:
            self._set_timer()
        return due_alarm

    def _set_timer(self) -> None:
        """Start a timer for the earliest alarm, in place of a later one.

        Before `start`, nothing is started: an engine that continues from a checkpoint schedules its alarms when
        simulated time may be unknown.
        """
        if self._wake_engine is None:
            return
        instant = self.next_alarm()
        # `_wake` may reset both in another thread.
        cancel_timer, timer_instant = self._cancel_timer, self._timer_instant
        if instant is None or (timer_instant is not None and timer_instant <= instant):
            return
        if cancel_timer is not None:
            cancel_timer()
        self._timer_instant = instant
        delay = max(MIN_TIMER_NANOSECONDS, instant - self.now())
        self._cancel_timer = self._transport.call_later(delay, self._wake)

    def _wake(self) -> None:
        self._cancel_timer = self._timer_instant = None
        if self._wake_engine is not None:
            self._wake_engine()


MAX_RECEIPT_AGE = 60 * SECOND
"""Age in ns from which the instant of a reception is not used: middlewares may have another clock."""


class ReceiptStamps:
    """Receipt stamps for messages without a stamp, by the instants at which the middleware has received them.

    A message may wait for the engine. Its event has the time of its reception nevertheless, as in a bag, and not that
    of its processing. Stamps increase strictly in the order of processing, as those of the engine do.

    Args:
        now: clock of the machine in nanoseconds.
    """

    def __init__(self, now: Callable[[], int]) -> None:
        self._now = now
        self._last = 0

    def stamp(self, received: int) -> Optional[int]:
        """Return the stamp of a message; None if the instant of its reception cannot be one."""
        now = self._now()
        if not now - MAX_RECEIPT_AGE < received <= now:
            return None
        # Messages of several topics are not always read in order. If the clock was set back, stamps follow it.
        if received <= self._last <= now:
            received = self._last + 1
        self._last = received
        return received


class Receipts:
    """Receipt stamps for messages without a stamp: strictly increasing within a clock epoch, as in the engine.

    Two messages that are received while simulated time stands still get different stamps, whichever node stamps them.

    Args:
        now: clock in nanoseconds.
    """

    def __init__(self, now: Callable[[], int]) -> None:
        self._clock = Clock(now)
        self._epoch = 0

    def stamp(self) -> int:
        """Return the stamp of a message that is received now, in nanoseconds."""
        instant = self._clock.stamp_at_once()
        if instant is None:
            # Time has jumped back.
            self.epoch()
            instant = self._clock.stamp()
        return instant

    def epoch(self) -> int:
        """Return the number of times that time has jumped back until now."""
        if self._clock.went_back():
            self._epoch += 1
        return self._epoch
