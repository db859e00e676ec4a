"""Epochs of a simulated clock: assignment of messages to the time before or after a clock reset.

A clock epoch is the time between two resets of ``/clock``, for example one run of a bag that is played again.
Messages and ``/clock`` use different connections, so messages of the next epoch can arrive before the reset, and
messages of the previous epoch after it. The assignment follows these rules:

1. A node enters a new epoch when its own ``/clock`` has gone back by more than `JUMP` and every node that sends
   events as text has reported the same reset within its stream. A sender that does not report within
   `CLOCK_WAIT_SECONDS` is ignored. Messages that arrive in between are buffered; messages that arrived before
   belong to the previous epoch.
2. A frame of a topic follows the clock if its timestamps advance like the clock, with any constant offset. Only such
   frames are evidence of an epoch (`ClockSkewMonitor`); delayed messages are no evidence.
3. A message is early if its frame goes back further behind the clock than ever before. All messages of its
   publisher are then buffered until the epoch begins. If the clock does not go back within `CLOCK_WAIT_SECONDS`,
   the messages were not early and are processed in order.
4. A message is left over from the previous epoch, and dropped, if its frame continues where that epoch ended, ahead
   of the current one.
5. Messages without a timestamp belong to the time of their receipt. Other timestamps are accepted unchanged: those
   that do not advance (static transforms, latched messages), those that follow no clock, and all if time is not
   simulated.
"""

import threading
import time
from collections import deque
from contextlib import ExitStack
from typing import (
    Any,
    Callable,
    ContextManager,
    Deque,
    Dict,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from ...events.clock.clock import JUMP
from ...foundation.displayed_text import format_count
from .problem_reports import Reports

CLOCK_WAIT_SECONDS = 1.0
"""Time limit for a reset of the clock after an early message, and for reports of other senders."""

PAUSE_AFTER_TIMEOUT_SECONDS = 10.0
"""Duration in seconds after a timeout in which no message counts as early."""

MAX_BUFFERED_MESSAGES = 20_000
MAX_BUFFERED_BYTES = 64_000_000
"""Limits of the buffer; above them the oldest messages are dropped."""

MAX_SENDERS = 100
"""Maximum number of senders of event texts whose epochs are stored."""

EpochCallback = Callable[[int], object]
"""Callback at the start of an epoch; its argument is the end of the previous epoch, in ns."""


class _BufferedBatch(NamedTuple):
    """Messages that wait for the next epoch.

    Attributes:
        process: processes them.
        messages: messages that arrived together.
        size: their size in bytes.
    """

    process: Callable[[List[Any]], object]
    messages: List[Any]
    size: int


class _ClockTime(NamedTuple):
    """Times of the clock, which are replaced together, so that reads by other threads are consistent.

    Attributes:
        reset_count: number of resets.
        now: current time in ns; 0 before the first message of the clock.
        previous_end: last time of the current epoch if a reset is pending, otherwise of the epoch before, in ns.
    """

    reset_count: int
    now: int
    previous_end: int


class ClockEpochs:
    """The current epoch of a simulated clock, and a buffer of messages that belong to the next one.

    `update_clock` and `report_epoch` only store values and may be called by any thread. `update` runs in its own
    thread and changes the epoch while it holds the locks of message processing, so each message is processed entirely
    in one epoch.

    Args:
        reports: takes warnings.
        read_clock: returns the time, in ns, before the first message of the clock.
        wake: called when `update` has work.
        monotonic: monotonic clock, in seconds.

    Attributes:
        epoch: number of the current epoch.
        epoch_start: time of its start by ``monotonic``, in seconds.
        is_buffering: whether messages may have to wait; see `must_buffer` and `must_buffer_texts`.
        dropped: number of messages that did not fit into the buffer.
    """

    def __init__(
        self,
        reports: Reports,
        read_clock: Callable[[], int],
        wake: Callable[[], object],
        monotonic: Callable[[], float] = time.monotonic,
    ):
        self._reports = reports
        self._read_clock = read_clock
        self._wake = wake
        self._monotonic = monotonic
        self._newest_time = read_clock()
        self._time = _ClockTime(0, self._newest_time, 0)
        self._lock = threading.Lock()
        self._senders: Dict[object, Tuple[int, int]] = {}
        """For each sender of texts: its epoch, and the offset between its count of epochs and ours."""
        self._early_publishers: Set[str] = set()
        self._buffer: Deque[_BufferedBatch] = deque()
        self._message_count = self._byte_count = 0
        self._deadline = self._early_allowed_from = 0.0
        self._locks: Sequence[ContextManager[object]] = ()
        self._callbacks: Sequence[EpochCallback] = ()
        self.epoch = 0
        self.epoch_start = monotonic()
        self.is_buffering = False
        self.dropped = 0

    def register_callbacks(self, locks: Sequence[ContextManager[object]], *callbacks: EpochCallback) -> None:
        """Set the locks of message processing, and the callbacks at the start of an epoch, which run under them."""
        self._locks = locks
        self._callbacks = callbacks

    def now(self, epoch: Optional[int] = None) -> int:
        """Return the time of an epoch (the current one by default), in ns; its last time if it is over."""
        reset_count, instant, end = self._time
        if reset_count != (self.epoch if epoch is None else epoch):
            return end
        return instant or self._read_clock()

    def update_clock(self, instant: int) -> None:
        """Store the time of the clock, in ns; detect a reset."""
        reset_count, _, end = self._time
        if instant >= self._newest_time - JUMP:
            self._newest_time = max(instant, self._newest_time)
            self._time = _ClockTime(reset_count, instant, end)
            return
        # A second reset before the next epoch begins does not change the end of the current one.
        if reset_count == self.epoch:
            end = self._newest_time
        self._newest_time = instant
        with self._lock:
            self._deadline = self._monotonic() + CLOCK_WAIT_SECONDS
            self.is_buffering = True
            self._time = _ClockTime(reset_count + 1, instant, end)
        self._wake()

    def report_epoch(self, sender: object, sender_epoch: int) -> None:
        """Store that all further texts of a sender belong to an epoch, which is given by the sender's own count."""
        with self._lock:
            reset_count = self._time.reset_count
            # The first report of a sender defines the offset between the two counts.
            _, offset = self._senders.get(sender, (0, reset_count - sender_epoch))
            if sender not in self._senders and len(self._senders) >= MAX_SENDERS:
                del self._senders[next(iter(self._senders))]
            self._senders[sender] = sender_epoch + offset, offset
            if sender_epoch + offset > self.epoch:
                self._start_buffering()
        self._wake()

    def buffers_early_messages(self) -> bool:
        """Return whether early messages are buffered at present."""
        return self._monotonic() >= self._early_allowed_from

    def must_buffer(self, publisher: str) -> bool:
        """Return whether messages of a publisher must be buffered."""
        return self._time.reset_count != self.epoch or publisher in self._early_publishers

    def must_buffer_texts(self, sender: object) -> bool:
        """Return whether texts of a sender must be buffered.

        They must be if it has reported a later epoch, or has never reported one while a reset is pending.
        """
        sender_state = self._senders.get(sender)
        if sender_state is None:
            return self._time.reset_count != self.epoch
        sender_epoch, _ = sender_state
        return sender_epoch > self.epoch

    def buffer_early(
        self, publisher: str, process: Callable[[List[bytes]], object], messages: List[bytes]
    ) -> None:
        """Buffer messages that begin with an early one, and all further messages of their publisher."""
        self._early_publishers.add(publisher)
        self.buffer(process, messages)

    def buffer(self, process: Callable[[List[Any]], object], messages: List[Any]) -> None:
        """Buffer messages or texts until the next epoch begins or the wait times out, then `process` them."""
        with self._lock:
            starts_buffering = not self.is_buffering
            self._start_buffering()
            size = sum(map(len, messages))
            self._buffer.append(_BufferedBatch(process, messages, size))
            self._message_count += len(messages)
            self._byte_count += size
            while self._buffer and (
                self._message_count > MAX_BUFFERED_MESSAGES or self._byte_count > MAX_BUFFERED_BYTES
            ):
                oldest = self._buffer.popleft()
                self._message_count -= len(oldest.messages)
                self._byte_count -= oldest.size
                self.dropped += len(oldest.messages)
                self._reports.warning(
                    f"{format_count(self.dropped, 'message')} dropped: too many arrived before the clock went back",
                    "early",
                )
        if starts_buffering:
            self._wake()

    def update(self) -> Optional[float]:
        """Begin the next epoch, or stop buffering, if the condition for it is fulfilled.

        Returns:
            Seconds until the next call is needed; None if nothing is pending.
        """
        with ExitStack() as stack:
            # All locks of message processing are held: no message is split between two epochs.
            for lock in self._locks:
                stack.enter_context(lock)
            now = self._monotonic()
            reset_count, _, end = self._time
            if reset_count == self.epoch:
                if self.is_buffering and now >= self._deadline:
                    # The clock did not go back within the time limit, so the buffered messages were not early.
                    if self._buffer:
                        self._early_allowed_from = now + PAUSE_AFTER_TIMEOUT_SECONDS
                    self._release_buffer()
            # The clock went back. Senders that have not reported within the time limit are removed.
            elif self._check_senders(reset_count, is_timed_out=now >= self._deadline):
                self.epoch = reset_count
                self.epoch_start = self._monotonic()
                self._early_allowed_from = 0.0
                self._call_callbacks(end)
                self._release_buffer()
            return max(0.0, self._deadline - now) if self.is_buffering else None

    def _call_callbacks(self, end: int) -> None:
        """Call the callbacks of a new epoch; an error in a callback affects neither the others nor messages."""
        for callback in self._callbacks:
            try:
                callback(end)
            except Exception as error:
                # A callback may raise any exception.
                self._reports.error(error)

    def _check_senders(self, reset_count: int, is_timed_out: bool) -> bool:
        """Return whether an epoch can begin: each sender of texts has reported it, or the wait has timed out.

        After a timeout, the senders that have not reported the epoch are removed.
        """
        # Searched and removed under one lock: a sender that reports in between must not be removed.
        with self._lock:
            late_senders = [sender for sender, (epoch, _) in self._senders.items() if epoch < reset_count]
            if late_senders and not is_timed_out:
                return False
            for sender in late_senders:
                del self._senders[sender]
        return True

    def _start_buffering(self) -> None:
        if not self.is_buffering:
            self._deadline = self._monotonic() + CLOCK_WAIT_SECONDS
            self.is_buffering = True

    def _release_buffer(self) -> None:
        """Process the buffered messages, and stop buffering unless another reset is pending."""
        with self._lock:
            batches, self._buffer = self._buffer, deque()
            self._message_count = self._byte_count = 0
            self._early_publishers.clear()
            # True if the clock went back again in the meantime.
            self.is_buffering = self._time.reset_count != self.epoch
            if self.is_buffering:
                self._deadline = self._monotonic() + CLOCK_WAIT_SECONDS
        # Outside of the lock: the consumers may buffer messages again.
        for batch in batches:
            batch.process(batch.messages)
