"""Publishing of serialized messages to the connections of a topic, without generated message classes.

rospy passes each message to a thread per connection: two more wake-ups, and two more changes of the interpreter lock.
A `TopicWriter` writes to the sockets in the caller's thread instead. Bytes that a socket does not accept at once are
written by a thread, which exists only while its subscriber is slower than the publisher. Messages that arrive
meanwhile are queued; if the queue is full, the oldest are dropped for this subscriber alone.

Connecting, the header, latching as seen by subscribers, and closing remain rospy's.
"""

import socket
import threading
import time
from collections import deque
from fcntl import ioctl
from io import BytesIO
from termios import TIOCOUTQ
from typing import Any, Callable, Deque, Dict, List, Optional, Tuple, Type

import rospy
from rospy.exceptions import TransportException
from rospy.rostime import wallsleep

from ..engine.runtime.problem_reports import Reports
from ..messages.type_definition import Definition
from ..node.topic_statistics import OutputCounts, OutputStatus


def serialized_class(definition: Definition) -> Type[rospy.AnyMsg]:
    """Return a message class with which rospy publishes serialized messages of a type."""
    members = {
        "_type": definition.name,
        "_md5sum": definition.md5sum,
        "_full_text": definition.full_text,
        # rospy would overwrite the sequence number of a message with a header.
        "_has_header": False,
        "__slots__": ["_buff"],
        "_slot_types": [],
    }
    return type(definition.functor_name, (rospy.AnyMsg,), members)


def serialized_bytes(message: Any) -> bytes:
    """Return the serialized form of a message that rospy received.

    The message is not a `rospy.AnyMsg` if this process subscribed to the topic by its class before (rospy itself
    subscribes to ``/clock``).
    """
    if isinstance(message, rospy.AnyMsg):
        data: bytes = message._buff
        return data
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


RECEIVER_WAIT_SECONDS = 5.0
"""Seconds that a publisher waits for a receiver that reads nothing.

TCP announces free buffer space only after a part of a large buffer is free again: on a busy machine, a second or more
after the data were read.
"""

PROGRESS_CHECK_SECONDS = 0.002
"""Seconds between two checks of the receiver's progress."""

MAX_COMBINED_WRITES = 64
"""Limit for the queued writes that the thread of a slow connection combines."""

COMBINED_WRITE_BYTES = 1 << 15
"""Bytes after which no further writes are combined.

The queue has room again when they are written. A larger value would let a wait for room time out although the
receiver reads steadily.
"""

WaitRule = Callable[[Any], bool]
"""Returns whether the publisher waits for the receiver of a connection before messages are dropped for it."""


def never_wait(connection: Any) -> bool:
    """Return False: the publisher waits for no receiver."""
    return False


class TopicWriter:
    """Writer of messages to the connections of a published topic.

    Args:
        topic: name of the topic.
        queue_size: number of messages to queue for one receiver; beyond it the oldest are dropped for this receiver.
        reports: receives a warning for every dropped message.
        must_wait_for: returns whether the publisher waits for a receiver before messages are dropped for it, so that
            a burst loses nothing. It waits as long as the receiver reads.
        latched: whether each new receiver gets the last message.
        listener: rospy listener for new receivers; ignored if the topic is latched.
        wait_hint: how to avoid waits, for the warning that the publisher waits; no warning if it is "".
    """

    def __init__(
        self,
        topic: str,
        message_class: Any,
        queue_size: int,
        reports: Reports,
        must_wait_for: WaitRule = never_wait,
        latched: bool = False,
        listener: Optional[rospy.SubscribeListener] = None,
        wait_hint: str = "",
    ):
        self._wait_hint = wait_hint
        self._max_queued = queue_size
        self._reports = reports
        self._must_wait_for = must_wait_for
        self._receivers: Dict[Any, _Receiver] = {}
        self.counts = OutputCounts()
        self._latch = _Latch(self) if latched else None
        # rospy announces in the connection header that the topic is latched. It has no message to send itself,
        # because messages do not pass through its `publish`.
        self.publisher = rospy.Publisher(
            topic, message_class, self._latch or listener, latch=latched, queue_size=queue_size
        )

    def connections(self) -> Any:
        """Return rospy's connections to the subscribers."""
        # `impl` is None after the publisher was unregistered, and `connections` is None after the topic was closed.
        topic = self.publisher.impl
        return getattr(topic, "connections", None) or ()

    def send(self, messages: bytes, count: int = 1) -> None:
        """Write serialized messages to all connections; only one message if the topic is latched."""
        self.counts.sent += count
        if self._latch is not None:
            self._latch.send(messages)
            return
        self.write(self.connections(), messages, count)

    def write(self, connections: Any, messages: bytes, count: int = 1) -> None:
        """Write messages to some of the connections."""
        self._remove_ended()
        for connection in connections:
            receiver = self._receivers.get(connection)
            if receiver is None:
                new_receiver = _Receiver(
                    connection=connection,
                    close_connection=self._close_connection,
                    topic=self.publisher.name,
                    queue_size=self._max_queued,
                    reports=self._reports,
                    must_wait_for=self._must_wait_for,
                    counts=self.counts,
                    wait_hint=self._wait_hint,
                )
                receiver = self._receivers.setdefault(connection, new_receiver)
            try:
                receiver.write(messages, count)
            except (TransportException, OSError) as error:
                self._close_connection(connection, error)

    def _close_connection(self, connection: Any, error: Exception) -> None:
        rospy.logdebug("a connection of %s has ended: %s", self.publisher.name, error)
        try:
            connection.close()
        except (AttributeError, TypeError):
            if not getattr(self.publisher.impl, "closed", True):
                raise
            # Otherwise rospy is closing the topic in another thread, and closes this connection itself.

    def _remove_ended(self) -> None:
        """Remove the state of connections that have ended."""
        connections = self.connections()
        if len(self._receivers) > len(connections):
            self._receivers = {
                connection: receiver
                for connection, receiver in self._receivers.items()
                if connection in connections
            }

    def status(self, message_type: str) -> OutputStatus:
        """Return the counters of the topic, with ``message_type`` as its message type."""
        counts = self.counts
        return OutputStatus(
            self.publisher.resolved_name, message_type, len(self.connections()), counts.sent, counts.dropped
        )

    def new_connections(self) -> List[Any]:
        """Return the connections to which nothing has been written yet."""
        return [connection for connection in self.connections() if connection not in self._receivers]


class _Latch(rospy.SubscribeListener):  # type: ignore[misc]
    """The last message of a latched topic, for subscribers that connect later.

    rospy calls `peer_subscribe` after it has added the connection to the topic. A message may be written to the
    connection in between; it is the last message then, and must not be sent twice. Hence the lock and
    `new_connections`.
    """

    def __init__(self, topic_writer: TopicWriter):
        super().__init__()
        self._topic_writer = topic_writer
        self._last = b""
        self._lock = threading.Lock()

    def send(self, message: bytes) -> None:
        """Write a message to all connections, and store it."""
        with self._lock:
            self._last = message
            self._topic_writer.write(self._topic_writer.connections(), message)

    def peer_subscribe(self, topic: str, publish: object, publish_to_peer: object) -> None:
        """Write the last message to new connections; rospy calls this."""
        with self._lock:
            if self._last:
                self._topic_writer.write(self._topic_writer.new_connections(), self._last)


class _Receiver:
    """Connection to one receiver, with a queue that is used while the receiver is slow."""

    def __init__(
        self,
        connection: Any,
        close_connection: Callable[[Any, Exception], None],
        topic: str,
        queue_size: int,
        reports: Reports,
        must_wait_for: WaitRule,
        counts: OutputCounts,
        wait_hint: str,
    ):
        self._wait_hint = wait_hint
        self._is_wait_reported = False
        self._counts = counts
        self._rospy_connection = connection
        self._close_connection = close_connection
        # The connection inside rospy's QueuedConnection, whose thread remains idle.
        self._connection = getattr(connection, "_connection", connection)
        self._topic = topic
        self._max_queued = queue_size
        self._reports = reports
        self._must_wait_for = must_wait_for
        self._lock = threading.Lock()
        self._queue: Deque[Tuple[bytes, int]] = deque()
        self._queued_messages = 0
        self._is_slow = False
        self._is_writing = False
        """True while a thread is writing to the socket; other threads append to the queue meanwhile."""

    def write(self, messages: bytes, count: int) -> None:
        """Write messages, or queue them while a thread is writing."""
        sock = getattr(self._connection, "socket", None)
        if sock is None:
            # The connection is closed, or of an unexpected type, whose own method is used.
            self._rospy_connection.write_data(messages)
            return
        if self._queued_messages >= self._max_queued:
            self._make_room()
        with self._lock:
            if self._is_writing:
                self._queue.append((messages, count))
                self._queued_messages += count
                return
            unsent = self._write_without_blocking(sock, messages, count)
            if unsent:
                self._is_writing = True
                thread = threading.Thread(target=self._write_all, args=(sock, unsent, count), daemon=True)
                thread.name = f"to {self._topic}"
                thread.start()
            else:
                self._is_slow = self._is_wait_reported = False

    def _write_without_blocking(self, sock: socket.socket, messages: bytes, count: int) -> bytes:
        """Write as many bytes as the socket accepts without blocking; return the other bytes."""
        try:
            sent: int = sock.send(messages, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return messages
        self._add_statistics(sent, count if sent == len(messages) else 0)
        return messages[sent:]

    def _add_statistics(self, size: int, count: int) -> None:
        self._connection.stat_bytes += size
        self._connection.stat_num_msg += count

    def _make_room(self) -> None:
        """Wait for the receiver if the rule requires it; then drop the oldest messages if the queue is still full."""
        if not self._is_slow and self._must_wait_for(self._rospy_connection):
            # A receiver that used up the wait once stays `_is_slow` until its queue has drained: otherwise each
            # further message would delay the publisher, and all other receivers, by the whole wait.
            if self._wait_hint and not self._is_wait_reported:
                self._is_wait_reported = True
                self._reports.warning(
                    f"{self._connection.endpoint_id} does not keep up with topic {self._topic}: messages wait; "
                    f"{self._wait_hint}"
                )
            self._wait_for_room()
            self._is_slow = self._queued_messages >= self._max_queued
        dropped = 0
        with self._lock:
            while self._queued_messages >= self._max_queued and self._queue:
                _, count = self._queue.popleft()
                self._queued_messages -= count
                dropped += count
        self._counts.dropped += dropped
        for _ in range(dropped):
            self._reports.warning(
                f"{self._connection.endpoint_id} does not keep up with topic {self._topic}: "
                "a message is dropped for it"
            )

    def _wait_for_room(self) -> None:
        """Wait until the queue has room, or the receiver has read nothing for `RECEIVER_WAIT_SECONDS`."""
        progress, deadline = self._read_progress(), time.monotonic() + RECEIVER_WAIT_SECONDS
        while (
            self._queued_messages >= self._max_queued
            and time.monotonic() < deadline
            and not rospy.is_shutdown()
        ):
            if self._connection.socket is None:
                # The connection has ended.
                return
            # Wall time: simulated time may stand still.
            wallsleep(PROGRESS_CHECK_SECONDS)
            previous, progress = progress, self._read_progress()
            if progress != previous:
                deadline = time.monotonic() + RECEIVER_WAIT_SECONDS

    def _read_progress(self) -> object:
        """Return a value that changes whenever the receiver reads: bytes written, and bytes not acknowledged."""
        unacknowledged = bytearray(4)
        try:
            ioctl(self._connection.socket, TIOCOUTQ, unacknowledged)
        except (OSError, TypeError, ValueError):
            # Closed meanwhile, or a system without TIOCOUTQ.
            pass
        return self._connection.stat_bytes, bytes(unacknowledged)

    def _write_all(self, sock: socket.socket, messages: bytes, count: int) -> None:
        """Write the unsent bytes and then the queue until it is empty; run by a thread."""
        try:
            while messages:
                sock.sendall(messages)
                self._add_statistics(len(messages), count)
                messages, count = self._dequeue()
        except OSError as error:
            self._close_connection(self._rospy_connection, error)

    def _dequeue(self) -> Tuple[bytes, int]:
        """Return the next queued writes as one, and their number of messages; mark the thread as ended if none."""
        with self._lock:
            writes: List[Tuple[bytes, int]] = []
            size = 0
            while self._queue and len(writes) < MAX_COMBINED_WRITES and size < COMBINED_WRITE_BYTES:
                writes.append(self._queue.popleft())
                size += len(writes[-1][0])
            count = sum(message_count for _, message_count in writes)
            self._queued_messages -= count
            # Under the same lock as the test of the queue: a message that `write` appends is written by this
            # thread, or `write` finds `_is_writing` cleared and writes itself.
            self._is_writing = bool(writes)
        return b"".join([messages for messages, _ in writes]), count
