"""Timers that a thread calls, by wall time or by a clock that is set from messages.

A timer of rclpy would cost a round of the executor, and a change of what the executor waits for.
"""

import heapq
import itertools
import threading
from typing import Callable, List, Optional, Tuple

_MAX_WAIT_SECONDS = 1.0
"""Longest wait of the thread: the clock of the machine may be set."""

_MIN_SCHEDULED = 1000
"""Number of calls from which on canceled ones are searched."""


class ScheduledCall:
    """A function that will be called once.

    Attributes:
        callback: the function; None after it was called or canceled.
    """

    __slots__ = ("callback",)

    def __init__(self, callback: Callable[[], object]):
        self.callback: Optional[Callable[[], object]] = callback

    def cancel(self) -> None:
        """Do not call it, if it has not been called."""
        self.callback = None


class TransportTimers:
    """Calls functions at instants of a clock, in a thread of its own.

    Args:
        now: the clock in nanoseconds.
        is_simulated: whether the clock is set from messages; then `notify` has to be called after each change.
        on_error: receives exceptions of the functions.
    """

    def __init__(
        self, now: Callable[[], int], is_simulated: bool, on_error: Callable[[Exception], object]
    ) -> None:
        self._now = now
        self._is_simulated = is_simulated
        self._on_error = on_error
        self._condition = threading.Condition()
        self._order = itertools.count()
        self._scheduled: List[Tuple[int, int, ScheduledCall]] = []
        self._max_scheduled = _MIN_SCHEDULED
        self._is_stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True, name="timers")
        self._thread.start()

    def call_later(self, delay: int, callback: Callable[[], object]) -> ScheduledCall:
        """Call a function once, after ``delay`` nanoseconds."""
        call = ScheduledCall(callback)
        instant = self._now() + max(0, delay)
        with self._condition:
            heapq.heappush(self._scheduled, (instant, next(self._order), call))
            self._remove_canceled()
            if self._scheduled[0][2] is call:
                self._condition.notify()
        return call

    def count(self) -> int:
        """Return the number of calls that are stored, canceled ones included."""
        return len(self._scheduled)

    def _remove_canceled(self) -> None:
        """Remove the canceled calls from a list that has doubled since the last time."""
        if len(self._scheduled) > self._max_scheduled:
            self._scheduled = [entry for entry in self._scheduled if entry[2].callback is not None]
            heapq.heapify(self._scheduled)
            self._max_scheduled = max(_MIN_SCHEDULED, 2 * len(self._scheduled))

    def notify(self) -> None:
        """Compare the timers with a clock that has been set."""
        with self._condition:
            self._condition.notify()

    def stop(self) -> None:
        """Call no further functions."""
        with self._condition:
            self._is_stopped = True
            self._condition.notify()

    def join(self, timeout: Optional[float] = None) -> None:
        """Wait until no function is running, after `stop`, at most for some seconds."""
        if self._thread is not threading.current_thread():
            self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._condition:
                if self._is_stopped:
                    return
                callback = self._take_due()
            if callback is not None:
                try:
                    callback()
                except Exception as error:
                    # While the node ends, what the function uses may be gone.
                    if not self._is_stopped:
                        self._on_error(error)

    def _take_due(self) -> Optional[Callable[[], object]]:
        """Remove and return the function that is due first; if none is due, wait once and return None."""
        scheduled = self._scheduled
        while scheduled and scheduled[0][2].callback is None:
            heapq.heappop(scheduled)
        remaining = scheduled[0][0] - self._now() if scheduled else 1
        if remaining <= 0:
            call = heapq.heappop(scheduled)[2]
            callback = call.callback
            call.cancel()
            return callback
        has_timeout = scheduled and not self._is_simulated
        self._condition.wait(min(remaining / 1e9, _MAX_WAIT_SECONDS) if has_timeout else None)
        return None
