"""Batched reading of messages from the connections of a topic.

A wake-up of a thread, with its cold caches, costs more than the processing of a message, and rospy's path from the
socket to the callback adds to it. `read_in_batches` therefore replaces `receive_once` of a subscriber's connections
by a `ConnectionReader`: a loop that reads from the socket, splits the data into messages, and passes all complete
messages of a read to the handler together. Fast topics are batched further: the socket option ``SO_RCVLOWAT`` lets
the kernel wake the thread only when several messages have arrived (`LowWaterMark`).

Everything else remains rospy's: connecting, the header, reconnecting, closing, statistics. If the internals of this
rospy are not the expected ones, its connections are left unchanged, and rospy calls back for each message.
"""

import socket
import sys
import time
from struct import Struct, pack
from typing import Any, Callable, Dict, List

import rospy
from rospy.core import is_shutdown
from rospy.exceptions import TransportException, TransportTerminated

MAX_READ_BYTES = 65536
"""Limit in bytes for one read. A larger buffer would be a new memory mapping each time, with its page faults."""

WINDOW_WAKE_UPS = 128
"""Wake-ups in a window, at whose end the low-water mark is adjusted."""

MAX_WINDOW_TIMEOUTS = WINDOW_WAKE_UPS // 32
"""Limit for the waits of a window that may time out before batching is given up."""

MIN_FURTHER_MESSAGES = 2
"""Further messages that must arrive within the hold time, on average, before the reader waits for them.

With a single one, a message would be delayed by a whole interval of its topic to save every second wake-up.
"""

RECEIVE_TIMEOUT = pack("ll", 0, 4000)
"""Longest wait of the kernel for further messages: a ``timeval``, rounded up to its ticks (mostly 4 ms)."""

NO_TIMEOUT = pack("ll", 0, 0)

MAX_SINGLE_MESSAGE_WINDOWS = 64
"""Limit for the windows without batching, after which it is tried again."""

BatchHandlerFactory = Callable[[Dict[str, str]], Callable[[List[bytes]], object]]
"""Returns the handler of a connection's messages, by the connection's header."""

EndHandler = Callable[[Dict[str, str], bool], object]
"""Called when a publisher closes a connection, with its header, and whether its last message is incomplete."""

_REQUIRED_ATTRIBUTES = (
    "socket",
    "header",
    "read_buff",
    "done",
    "stat_bytes",
    "stat_num_msg",
    "is_latched",
    "latch",
    "receive_once",
)

_unpack_length = Struct("<I").unpack_from


class LowWaterMark:
    """Controls the number of bytes that must have arrived at a connection before its thread continues.

    If messages arrive one by one, and at least `MIN_FURTHER_MESSAGES` more while the first is held, the kernel waits
    for several (``SO_RCVLOWAT``). This needs no timer, unlike a sleep between two reads, which costs more than it
    saves. If the further messages fail to arrive more than `MAX_WINDOW_TIMEOUTS` times in a window (a burst has
    ended), each message is read at once again, for a number of windows that doubles with each failure.

    Args:
        max_delay: seconds for which a message may wait for the next ones, on average.
        now: clock in seconds.
    """

    def __init__(self, sock: socket.socket, max_delay: float, now: Callable[[], float] = time.monotonic):
        self._socket = sock
        self._max_delay = max_delay
        self._now = now
        self.min_bytes = 1
        self._single_message_windows = 1
        self._start_window(1)

    def _start_window(self, windows: int) -> None:
        self._remaining_wake_ups = self._window_wake_ups = windows * WINDOW_WAKE_UPS
        self._bytes = self._messages = self._timeouts = 0
        self._window_start = self._now()

    def record_wake_up(self, size: int, messages: int) -> None:
        """Record the bytes and messages of a wake-up; both are 0 if the wait timed out."""
        self._bytes += size
        self._messages += messages
        self._remaining_wake_ups -= 1
        if size < self.min_bytes:
            self._timeouts += 1
            if self._timeouts > MAX_WINDOW_TIMEOUTS:
                self._single_message_windows = min(
                    2 * self._single_message_windows, MAX_SINGLE_MESSAGE_WINDOWS
                )
                self.set_min_bytes(1)
                self._start_window(self._single_message_windows)
        if not self._remaining_wake_ups:
            self._adjust()

    def _adjust(self) -> None:
        """Choose the number of bytes to wait for, from the rate of the last window."""
        rate = self._messages / max(self._now() - self._window_start, 1e-9)
        further_messages = int(rate * self._max_delay)
        # If a wake-up delivers as many messages as the wait would, they arrive in groups already: waiting gains
        # nothing.
        if further_messages < MIN_FURTHER_MESSAGES or (
            self.min_bytes == 1 and self._messages >= (further_messages + 1) * self._window_wake_ups
        ):
            self.set_min_bytes(1)
        else:
            message_bytes = self._bytes // max(1, self._messages)
            # One byte of the last message is enough: its rest arrives with the same segment in most cases, and
            # otherwise the next read completes it.
            self.set_min_bytes(min(further_messages * message_bytes + 1, MAX_READ_BYTES // 4))
        self._start_window(1)

    def set_min_bytes(self, min_bytes: int) -> None:
        """Set the number of bytes that the next read waits for; other systems than Linux do not support it."""
        if min_bytes == self.min_bytes or not sys.platform.startswith("linux"):
            return
        try:
            # The timeout first: a socket with a low-water mark and no timeout would hold the last message of a
            # burst forever.
            self._socket.setsockopt(
                socket.SOL_SOCKET, socket.SO_RCVTIMEO, RECEIVE_TIMEOUT if min_bytes > 1 else NO_TIMEOUT
            )
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, min_bytes)
            self.min_bytes = min_bytes
        except OSError as error:
            # The socket was closed, which the next read reports.
            rospy.logdebug("the receive rate of a connection stays as it was: %s", error)


class ConnectionReader:
    """Replacement of `receive_once` of one connection.

    Args:
        connection: rospy's connection.
        subscriber: owner of the connection. If this process has further subscribers of the topic, rospy calls all
            of them.
        handler_factory: returns the handler of a wake-up's messages, a list of bytes, by the connection's header.
        max_delay: see `LowWaterMark`.
        on_end: called when the publisher closes the connection.
    """

    def __init__(
        self,
        connection: Any,
        subscriber: Any,
        handler_factory: BatchHandlerFactory,
        max_delay: float,
        on_end: EndHandler,
    ):
        self._on_end = on_end
        self._connection = connection
        self._topic = subscriber.impl
        self._callback = subscriber.callback
        self._handler_factory = handler_factory
        self._max_delay = max_delay
        self._socket: Any = None

    def __call__(self) -> List[Any]:
        """Read and process messages until the connection ends; return messages only for rospy's own callbacks."""
        connection = self._connection
        if connection.socket is None:
            raise TransportException("connection not initialized")
        if connection.socket is not self._socket:
            self._attach_socket()
        handler = self._handler_factory(connection.header)
        while not (connection.done or is_shutdown()):
            messages = self._read()
            if not messages:
                continue
            if connection.is_latched:
                connection.latch = self._to_rospy_message(messages[-1])
            # Another subscriber in this process has the same topic: rospy has to call all of them for this batch.
            if [callback for callback, _ in self._topic.callbacks or ()] != [self._callback]:
                return [self._to_rospy_message(data) for data in messages]
            handler(messages)
        return []

    def _attach_socket(self) -> None:
        """Start to read a socket, with the bytes that rospy has read after the header."""
        connection = self._connection
        self._socket = connection.socket
        # SO_RCVLOWAT and SO_RCVTIMEO apply to blocking sockets only.
        self._socket.setblocking(True)
        self._low_water_mark = LowWaterMark(self._socket, self._max_delay)
        # The pieces of an incomplete message, and the bytes that are missing until its length or its end is known.
        self._parts = [connection.read_buff.getvalue()]
        self._missing_bytes = 4 - len(self._parts[0])
        connection.read_buff.seek(0)
        connection.read_buff.truncate(0)

    def _read(self) -> List[bytes]:
        """Wait for data and return the complete messages, which may be none.

        Raises:
            TransportTerminated: if the connection has ended.
        """
        connection, parts = self._connection, self._parts
        data = b""
        if self._missing_bytes > 0:
            try:
                data = self._socket.recv(MAX_READ_BYTES)
            except BlockingIOError:
                self._low_water_mark.record_wake_up(0, 0)
                return []
            except OSError as error:
                self._handle_end()
                raise TransportTerminated(f"cannot receive: {error}") from error
            if not data:
                self._handle_end()
                raise TransportTerminated("the sender closed the connection")
        received_bytes = len(data)
        connection.stat_bytes += received_bytes
        if parts:
            parts.append(data)
            self._missing_bytes -= received_bytes
            if self._missing_bytes > 0:
                return []
            data = b"".join(parts)
            parts.clear()
        messages = self._split(data)
        connection.stat_num_msg += len(messages)
        self._low_water_mark.record_wake_up(received_bytes, len(messages))
        return messages

    def _handle_end(self) -> None:
        """Report the end of the connection, unless this node has closed it."""
        if not (self._connection.done or is_shutdown()):
            self._on_end(self._connection.header, any(self._parts))

    def _split(self, data: bytes) -> List[bytes]:
        """Return the complete messages in received data, and store the rest."""
        messages = []
        position, end = 0, len(data)
        # Position up to which data are needed: first the end of a message's length of 4 bytes, then its own end.
        needed_end = 4
        while needed_end <= end:
            needed_end += _unpack_length(data, position)[0]
            if needed_end > end:
                break
            messages.append(data[position + 4 : needed_end])
            position = needed_end
            needed_end += 4
        self._missing_bytes = needed_end - end
        if position < end:
            self._parts.append(data[position:])
        return messages

    def _to_rospy_message(self, data: bytes) -> Any:
        """Return a message in the form that rospy creates."""
        # As in rospy's own receive path; subscribers read the header of the connection from the message.
        message = rospy.AnyMsg()
        message._buff = data
        message._connection_header = self._connection.header
        return message


def _are_callbacks(callbacks: object) -> bool:
    """Return whether a topic stores its callbacks in the expected form: pairs of a function and its arguments."""
    return isinstance(callbacks, list) and all(
        isinstance(callback, tuple) and len(callback) == 2 for callback in callbacks
    )


def refuse_own_connection(subscriber: Any) -> None:
    """Keep a subscriber from connecting to a publisher of the same topic in its own process.

    rospy would connect them, and each message that this node publishes for others would return to it.
    """
    topic = subscriber.impl
    rospy_add_connection = topic.add_connection
    own_address = rospy.get_node_uri()

    def add_connection(connection: Any) -> Any:
        # rospy closes a connection that is not added.
        return connection.endpoint_id != own_address and rospy_add_connection(connection)

    topic.add_connection = add_connection
    # Connections that were made before `add_connection` was replaced.
    for connection in topic.connections:
        if connection.endpoint_id == own_address:
            connection.close()


def _ignore_end(header: Dict[str, str], is_incomplete: bool) -> None:
    """Do nothing at the end of a connection."""


def read_in_batches(
    subscriber: Any,
    handler_factory: BatchHandlerFactory,
    max_delay: float,
    on_end: EndHandler = _ignore_end,
) -> None:
    """Read the connections of a subscriber with a `ConnectionReader`, if rospy's internals are the expected ones."""
    topic = getattr(subscriber, "impl", None)
    rospy_add_connection = getattr(topic, "add_connection", None)
    if (
        topic is None
        or rospy_add_connection is None
        or getattr(topic, "data_class", None) is not rospy.AnyMsg
    ):
        # This process subscribed to the topic by its class before (rospy itself uses ``/clock``).
        return
    if not _are_callbacks(getattr(topic, "callbacks", None)):
        return
    if getattr(topic, "statistics_logger", None) is not None:
        # The logger has to be called for each message.
        return

    def prepare(connection: Any) -> None:
        is_prepared = getattr(connection, "receive_once", None).__class__ is ConnectionReader
        if not is_prepared and all(hasattr(connection, name) for name in _REQUIRED_ATTRIBUTES):
            connection.receive_once = ConnectionReader(
                connection, subscriber, handler_factory, max_delay, on_end
            )

    def add_connection(connection: Any) -> Any:
        prepare(connection)
        return rospy_add_connection(connection)

    topic.add_connection = add_connection
    # Connections that were made before `add_connection` was replaced: their threads call the reader after their
    # present call of rospy's `receive_once` has returned.
    for connection in topic.connections:
        prepare(connection)
