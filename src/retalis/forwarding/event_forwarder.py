"""Forwarding of events: a buffer in memory, a queue on the disk, and a thread that sends to the broker.

The engine passes events to the buffer, and does not wait for the disk. A thread stores what has accumulated in one
transaction, so that under load many events share one synchronization with the disk.
"""

import threading
import time
from collections import deque
from typing import Deque, List, NamedTuple

from ..engine.runtime.problem_reports import Reports
from ..foundation.displayed_text import format_count, shorten
from .disk_queue import DiskQueue, ForwardedEvent, QueueFailed
from .forwarding_options import ForwardingOptions
from .mqtt_sender import MqttSender

MAX_EVENT_CHARACTERS = 100_000
"""Limit for the length of an event: brokers may end the connection if a message exceeds their own limit."""

MAX_BUFFERED_EVENTS = 10_000
"""Limit for the number of events that wait to be stored."""

MAX_BUFFERED_CHARACTERS = 10_000_000
"""Limit for the length of these events."""

MAX_SHUTDOWN_SECONDS = 1.0
"""Seconds in which queued events are sent when the node ends."""

_MAX_BATCH_EVENTS = 500
_MAX_BATCH_CHARACTERS = 250_000
"""Limits for the events that are stored in one transaction."""

_REPORTED = "forwarding"
"""Kind of the warnings of lost events."""


class ForwardingStatus(NamedTuple):
    """State and counters of a forwarder; the counters begin with the process.

    Attributes:
        broker: address of the broker.
        is_connected: whether there is a connection.
        state_seconds: time in seconds since there is one, or none.
        problem: reason why there is none, or why the last one ended; may be empty.
        storage_problem: reason why events cannot be stored now; "" if they can.
        queued: number of events that the broker has not acknowledged.
        used_bytes: size of the queue.
        max_bytes: limit for this size.
        confirmed: number of events that the broker has acknowledged.
        repeated: number of times that an event was sent again.
        dropped: number of events that were dropped because the queue was full.
        unstored: number of events that could not be stored: the disk was full or too slow.
        oversized: number of events that were longer than `MAX_EVENT_CHARACTERS`.
        connections: number of connections.
        damaged_files: number of queue files that were damaged.
    """

    broker: str
    is_connected: bool
    state_seconds: float
    problem: str
    storage_problem: str
    queued: int
    used_bytes: int
    max_bytes: int
    confirmed: int
    repeated: int
    dropped: int
    unstored: int
    oversized: int
    connections: int
    damaged_files: int

    @property
    def lost(self) -> int:
        """Number of events that are known not to be forwarded."""
        return self.dropped + self.unstored + self.oversized


class EventForwarder:
    """Forwards events to a broker; `put` may be called by any thread, and does not wait.

    Args:
        options: destination and queue.
        reports: receives a warning for lost events.

    Raises:
        UsageError: if the queue cannot be used, or paho is not installed.
    """

    def __init__(self, options: ForwardingOptions, reports: Reports):
        self._options = options
        self._reports = reports
        self._changed = threading.Condition()
        """Guards the following attributes."""
        self._buffer: Deque[ForwardedEvent] = deque()
        self._buffered_characters = 0
        self._skipped_count = 0
        """Number of lost events whose ids have to be left out."""
        self._is_stopping = False
        self._dropped_count = self._unstored_count = self._oversized_count = 0
        self._storage_problem = ""
        self._queue = DiskQueue(options.queue, options.max_bytes, on_damage=reports.error)
        try:
            self._sender = MqttSender(options.broker, options.robot, self._queue)
        except BaseException:
            # Otherwise the file stays locked, and a node of ROS 2 could not be configured again.
            self._queue.close()
            raise
        self._thread = threading.Thread(target=self._store, name="retalis forwarding queue", daemon=True)
        self._sender.start()
        self._thread.start()

    def put(self, event: ForwardedEvent) -> None:
        """Forward an event, unless it is too long."""
        length = len(event.text)
        is_oversized = length > MAX_EVENT_CHARACTERS
        with self._changed:
            if is_oversized:
                self._oversized_count += 1
                self._skipped_count += 1
            else:
                self._buffer.append(event)
                self._buffered_characters += length
                self._limit_buffer()
                self._changed.notify()
        if is_oversized:
            self._reports.warning(
                f"forwarding: {shorten(event.text)} is dropped: it has {length:,} characters: expected at most "
                f"{MAX_EVENT_CHARACTERS:,}",
                (_REPORTED, "oversized"),
            )

    def _limit_buffer(self) -> None:
        """Drop the oldest events if the buffer exceeds its limits; called with the lock."""
        while len(self._buffer) > MAX_BUFFERED_EVENTS or self._buffered_characters > MAX_BUFFERED_CHARACTERS:
            self._buffered_characters -= len(self._buffer.popleft().text)
            self._skipped_count += 1
            self._unstored_count += 1
            self._storage_problem = "the disk is too slow"

    def status(self) -> ForwardingStatus:
        """Return the present state."""
        sender, queue = self._sender, self._queue
        return ForwardingStatus(
            broker=str(self._options.broker),
            is_connected=sender.is_connected,
            state_seconds=time.monotonic() - sender.changed_at,
            problem=sender.problem,
            storage_problem=self._storage_problem,
            queued=queue.count + len(self._buffer),
            used_bytes=queue.used_bytes,
            max_bytes=self._options.max_bytes,
            confirmed=sender.confirmed_count,
            repeated=sender.repeated_count,
            dropped=self._dropped_count,
            unstored=self._unstored_count,
            oversized=self._oversized_count,
            connections=sender.connection_count,
            damaged_files=queue.set_aside_count,
        )

    def stop(self) -> None:
        """Store the buffered events, send what can be sent within `MAX_SHUTDOWN_SECONDS`, and close the queue."""
        with self._changed:
            self._is_stopping = True
            self._changed.notify()
        self._thread.join(MAX_SHUTDOWN_SECONDS)
        self._sender.stop(MAX_SHUTDOWN_SECONDS)
        self._queue.close()

    def _store(self) -> None:
        """Store buffered events until the forwarder is stopped."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._buffer or self._is_stopping)
                events = self._take_batch()
                skipped_count, self._skipped_count = self._skipped_count, 0
            if not events:
                return
            self._queue.skip_ids(skipped_count)
            try:
                dropped_count = self._queue.append(events)
            # Whatever the reason is, the thread has to continue with later events.
            except Exception as error:
                problem = error.message if isinstance(error, QueueFailed) else repr(error)
                with self._changed:
                    self._unstored_count += len(events)
                    self._storage_problem = problem
                self._reports.warning(
                    f"forwarding: {format_count(len(events), 'event')} cannot be stored: {problem}",
                    (_REPORTED, "storage"),
                )
                continue
            self._storage_problem = ""
            self._sender.wake()
            if dropped_count:
                self._dropped_count += dropped_count
                self._reports.warning(
                    f"forwarding: the oldest events are dropped, because the queue {self._options.queue} is full; "
                    f"{self._dropped_count} so far",
                    (_REPORTED, "full"),
                )

    def _take_batch(self) -> List[ForwardedEvent]:
        """Remove and return the events of one transaction; called with the lock."""
        batch: List[ForwardedEvent] = []
        batch_characters = 0
        while self._buffer and len(batch) < _MAX_BATCH_EVENTS and batch_characters < _MAX_BATCH_CHARACTERS:
            batch.append(self._buffer.popleft())
            batch_characters += len(batch[-1].text)
        self._buffered_characters -= batch_characters
        return batch
