"""Reading messages from the connections of a topic: in one loop, and several at a time where they come fast.

A wake-up of a thread, with its cold caches, costs more than the work on a message, and rospy's way from the
socket to the callback comes on top. So a subscriber's connections get another `receive_once`, which reads,
takes apart and hands on until the connection ends. Everything else stays rospy's: connecting, the header,
connecting again, closing, statistics. Where its connections are made of something else than expected, they are
left as they are, and rospy calls back for each message.
"""

import socket
import sys
import time
from struct import Struct, pack
from typing import Any, Callable, Dict, List

import rospy
from rospy.core import is_shutdown
from rospy.exceptions import TransportException, TransportTerminated

BUFFER = 65536
"""Bytes that are read at most at once. More would be a memory mapping of its own each time, and its page faults."""

WINDOW = 128
"""Wake-ups from one look at the pace to the next."""

LATE = WINDOW // 32
"""Waits of a window that may have been in vain."""

MIN_FURTHER = 2
"""Further messages that must arrive within the hold time, on average, before the reader waits for them.

With a single one, a message would be delayed by a whole interval of its topic to save every second wake-up.
"""

TIMEOUT = pack("ll", 0, 4000)
"""How long the system waits for further messages: a ``timeval``, rounded up to its ticks (4 milliseconds mostly)."""

NEVER = pack("ll", 0, 0)

MAX_SINGLE_MESSAGE_WINDOWS = 64
"""Windows at most without another try to wait for several messages."""

ConnectionTaker = Callable[[Dict[str, str]], Callable[[List[bytes]], object]]
"""Gives what takes messages, by the header of their connection."""

_NEEDED = (
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

_size = Struct("<I").unpack_from


class Pace:
    """How many bytes there have to be at a connection before its thread is woken.

    If messages arrive one by one, and at least `MIN_FURTHER` more while the first is held, the system waits for
    several (``SO_RCVLOWAT``). That needs no timer, unlike a sleep between two reads, which costs more than it saves.
    If the further ones then stay away again and again (a burst has ended), each is read at once as before.

    Args:
        sock: the connection's socket.
        hold: seconds for which a message may wait for the next ones, on average.
        now: a clock.
    """

    def __init__(self, sock: socket.socket, hold: float, now: Callable[[], float] = time.monotonic):
        self._socket = sock
        self._hold = hold
        self._now = now
        self.least = 1
        self._pause = 1
        self._begin(1)

    def _begin(self, windows: int) -> None:
        self._left = self._wakes = windows * WINDOW
        self._bytes = self._messages = self._late = 0
        self._since = self._now()

    def note(self, size: int, messages: int) -> None:
        """Note what a wake-up has brought; nothing where the wait was in vain."""
        self._bytes += size
        self._messages += messages
        self._left -= 1
        if size < self.least:
            self._late += 1
            if self._late > LATE:
                self._pause = min(2 * self._pause, MAX_SINGLE_MESSAGE_WINDOWS)
                self.wait_for(1)
                self._begin(self._pause)
        if not self._left:
            self._look()

    def _look(self) -> None:
        """Choose how many messages to wait for, from what came in the last window."""
        rate = self._messages / max(self._now() - self._since, 1e-9)
        further = int(rate * self._hold)
        if further < MIN_FURTHER or (self.least == 1 and self._messages >= (further + 1) * self._wakes):
            self.wait_for(1)
        else:
            each = self._bytes // max(1, self._messages)
            self.wait_for(min(further * each + 1, BUFFER // 4))
        self._begin(1)

    def wait_for(self, least: int) -> None:
        """Have the next read wait for so many bytes, where the system can."""
        if least == self.least or not sys.platform.startswith("linux"):
            return
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, TIMEOUT if least > 1 else NEVER)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, least)
            self.least = least
        except OSError as error:  # it has been closed, which the next read tells
            rospy.logdebug("the receive rate of a connection stays as it was: %s", error)


class ConnectionReader:
    """The `receive_once` of one connection.

    Args:
        link: rospy's connection.
        subscriber: whose it is; where others have subscribed the topic in this process too, rospy calls all of them.
        taker: gives what takes the messages of a wake-up, as a list of bytes, by the connection's header.
        hold: see `Pace`.
    """

    def __init__(self, link: Any, subscriber: Any, taker: ConnectionTaker, hold: float):
        self._link = link
        self._topic = subscriber.impl
        self._callback = subscriber.callback
        self._taker = taker
        self._hold = hold
        self._socket: Any = None

    def __call__(self) -> List[Any]:
        """Read and hand on until the connection ends; return messages only where others have called for them."""
        link = self._link
        if link.socket is None:
            raise TransportException("connection not initialized")
        if link.socket is not self._socket:
            self._open()
        take = self._taker(link.header)
        while not (link.done or is_shutdown()):
            found = self._read()
            if not found:
                continue
            if link.is_latched:
                link.latch = self._message(found[-1])
            if [one for one, _ in self._topic.callbacks or ()] != [self._callback]:
                return [self._message(one) for one in found]
            take(found)
        return []

    def _open(self) -> None:
        """Begin with a connection, with what has been read of it together with its header."""
        link = self._link
        self._socket = link.socket
        self._socket.setblocking(True)
        self._pace = Pace(self._socket, self._hold)
        self._parts = [link.read_buff.getvalue()]
        self._lacking = 4 - len(self._parts[0])
        link.read_buff.seek(0)
        link.read_buff.truncate(0)

    def _read(self) -> List[bytes]:
        """Wait for messages and return what has come, which may be none.

        Raises:
            TransportTerminated: when the connection has ended.
        """
        link, parts = self._link, self._parts
        data = b""
        if self._lacking > 0:
            try:
                data = self._socket.recv(BUFFER)
            except BlockingIOError:
                self._pace.note(0, 0)
                return []
            except OSError as error:
                raise TransportTerminated(f"cannot receive: {error}") from error
            if not data:
                raise TransportTerminated("the sender closed the connection")
        received = len(data)
        link.stat_bytes += received
        if parts:
            parts.append(data)
            self._lacking -= received
            if self._lacking > 0:
                return []
            data = b"".join(parts)
            parts.clear()
        found = self._split(data)
        link.stat_num_msg += len(found)
        self._pace.note(received, len(found))
        return found

    def _split(self, data: bytes) -> List[bytes]:
        """Return the whole messages in what was received, and keep what is left."""
        found = []
        at, end = 0, len(data)
        stop = 4
        while stop <= end:
            stop += _size(data, at)[0]
            if stop > end:
                break
            found.append(data[at + 4 : stop])
            at = stop
            stop += 4
        self._lacking = stop - end
        if at < end:
            self._parts.append(data[at:])
        return found

    def _message(self, data: bytes) -> Any:
        """Return a message as rospy makes it."""
        message = rospy.AnyMsg()
        message._buff = data
        message._connection_header = self._link.header
        return message


def _are_callbacks(found: object) -> bool:
    """Tell whether a topic keeps its callbacks as a reader expects them: pairs of a function and its arguments."""
    return isinstance(found, list) and all(isinstance(one, tuple) and len(one) == 2 for one in found)


def read_by(subscriber: Any, taker: ConnectionTaker, hold: float) -> None:
    """Have the connections of a subscriber read by a `ConnectionReader`, if they are what is expected of rospy."""
    topic = getattr(subscriber, "impl", None)
    add = getattr(topic, "add_connection", None)
    if topic is None or add is None or getattr(topic, "data_class", None) is not rospy.AnyMsg:
        return  # subscribed before, by its class (``/clock``, by rospy itself)
    if not _are_callbacks(getattr(topic, "callbacks", None)):
        return
    if getattr(topic, "statistics_logger", None) is not None:
        return  # it wants to see each message

    def prepare(link: Any) -> None:
        known = getattr(link, "receive_once", None).__class__ is ConnectionReader
        if not known and all(hasattr(link, name) for name in _NEEDED):
            link.receive_once = ConnectionReader(link, subscriber, taker, hold)

    def add_connection(link: Any) -> Any:
        prepare(link)
        return add(link)

    topic.add_connection = add_connection
    for link in topic.connections:  # made meanwhile: its thread comes to this after what it reads next
        prepare(link)
