"""Messages as bytes: subscribing to any type, publishing any type, without generated classes.

Writing messages to the subscribers of a topic, from the thread that has them.

rospy hands each message to a thread of its connection: two more wake-ups on the way, and the interpreter's lock
goes to and fro. Here what a connection takes at once is written at once; a thread writes the rest only for one
that does not keep up.
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
from .topic_statistics import OutputCounts, OutputStatus


def raw_class(definition: Definition) -> Type[rospy.AnyMsg]:
    """Return the class with which rospy publishes ready bytes as messages of a type."""
    members = {
        "_type": definition.name,
        "_md5sum": definition.md5sum,
        "_full_text": definition.full_text,
        # rospy overwrites the sequence number of a message with a header; ours are whole as they are.
        "_has_header": False,
        "__slots__": ["_buff"],
        "_slot_types": [],
    }
    return type(definition.functor_name, (rospy.AnyMsg,), members)


def raw_bytes(message: Any) -> bytes:
    """Return the bytes of a message that rospy received.

    It is no `rospy.AnyMsg` where the node had subscribed the topic by its class before (``/clock``, by rospy itself).
    """
    if isinstance(message, rospy.AnyMsg):
        data: bytes = message._buff
        return data
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


RECEIVER_WAIT_SECONDS = 5.0
"""Seconds to wait for a receiver that takes nothing, where that is wanted.

The system tells of what is read from a large buffer only once a part of it is free again: on a busy machine, a second
later than it was read, or more.
"""

PAUSE = 0.002
"""Seconds between two looks at it."""

MAX_COMBINED_WRITES = 64
"""Writes that the thread of a slow connection puts together."""

COMBINED_WRITE_BYTES = 1 << 15
"""Bytes after which it puts no more together: there is room again once they are written, so a wait for room that is
in vain shows a receiver that takes less in that time."""

Patient = Callable[[Any], bool]
"""Tells whether those who send are held up for a receiver, by its connection."""


def never(link: Any) -> bool:
    """Hold up those who send for nobody."""
    return False


class Outlet:
    """A published topic.

    Args:
        topic: its name.
        kind: the class of its messages.
        queue: how many messages may wait for one receiver; past that the oldest are dropped for it alone.
        reports: takes a warning of each message that is dropped.
        patient: tells for whom those who send are held up before anything is dropped, so that a burst loses nothing:
            as long as it goes on taking what is sent.
        latched: whether the last message goes to each receiver that comes later.
        listener: is told of receivers that come, where the topic is not latched.
    """

    def __init__(
        self,
        topic: str,
        kind: Any,
        queue: int,
        reports: Reports,
        patient: Patient = never,
        latched: bool = False,
        listener: Optional[rospy.SubscribeListener] = None,
    ):
        self._queue = queue
        self._reports = reports
        self._patient = patient
        self._lines: Dict[Any, _Receiver] = {}
        self.counts = OutputCounts()
        self._latch = _Latch(self) if latched else None
        # rospy says by the header that the topic is latched; what it would send itself, it has not got
        self.publisher = rospy.Publisher(
            topic, kind, self._latch or listener, latch=latched, queue_size=queue
        )

    def links(self) -> Any:
        """Return rospy's connections to those who listen."""
        # rospy's topic is None once the publisher is taken away, and its connections once it has ended.
        topic = self.publisher.impl
        return getattr(topic, "connections", None) or ()

    def send(self, frames: bytes, number: int = 1) -> None:
        """Write messages, framed as on the wire, to all connections; one at a time where the topic is latched."""
        self.counts.sent += number
        if self._latch is not None:
            self._latch.send(frames)
            return
        self.write(self.links(), frames, number)

    def write(self, links: Any, frames: bytes, number: int = 1) -> None:
        """Write messages to some of the connections."""
        self._forget()
        for link in links:
            line = self._lines.get(link)
            if line is None:
                made = _Receiver(
                    link,
                    self._end,
                    self.publisher.name,
                    self._queue,
                    self._reports,
                    self._patient,
                    self.counts,
                )
                line = self._lines.setdefault(link, made)
            try:
                line.write(frames, number)
            except (TransportException, OSError) as error:
                self._end(link, error)

    def _end(self, link: Any, error: Exception) -> None:
        """Close a connection that has ended."""
        rospy.logdebug("a connection of %s has ended: %s", self.publisher.name, error)
        try:
            link.close()
        except (AttributeError, TypeError):
            if not getattr(self.publisher.impl, "closed", True):
                raise
            # else rospy is just taking the topic down, piece by piece, and closes the connection itself

    def _forget(self) -> None:
        """Forget the connections that are gone."""
        links = self.links()
        if len(self._lines) > len(links):
            self._lines = {link: line for link, line in self._lines.items() if link in links}

    def status(self, kind: str) -> OutputStatus:
        """Return what has gone out so far, as messages of a type."""
        counts = self.counts
        return OutputStatus(
            self.publisher.resolved_name, kind, len(self.links()), counts.sent, counts.dropped
        )

    def unserved(self) -> List[Any]:
        """Return the connections to which nothing has been written."""
        return [link for link in self.links() if link not in self._lines]


class _Latch(rospy.SubscribeListener):  # type: ignore[misc]
    """Keeps the last message of a topic for those who come later.

    rospy tells of a connection when that stands among the topic's already, so a message may go to it just before:
    that one is the last message then, and is not sent again.
    """

    def __init__(self, outlet: Outlet):
        super().__init__()
        self._outlet = outlet
        self._last = b""
        self._lock = threading.Lock()

    def send(self, frame: bytes) -> None:
        """Write a message to all connections, and keep it."""
        with self._lock:
            self._last = frame
            self._outlet.write(self._outlet.links(), frame)

    def peer_subscribe(self, topic: str, publish: object, publish_to_peer: object) -> None:
        """Write the last message to those who have nothing yet."""
        with self._lock:
            if self._last:
                self._outlet.write(self._outlet.unserved(), self._last)


class _Receiver:
    """What goes to one receiver."""

    def __init__(
        self,
        link: Any,
        end: Callable[[Any, Exception], None],
        topic: str,
        queue: int,
        reports: Reports,
        patient: Patient,
        counts: OutputCounts,
    ):
        self._counts = counts
        self._outer = link
        self._end = end
        self._link = getattr(
            link, "_connection", link
        )  # of rospy's QueuedConnection, whose thread stays asleep
        self._topic = topic
        self._queue = queue
        self._reports = reports
        self._patient = patient
        self._lock = threading.Lock()
        self._waiting: Deque[Tuple[bytes, int]] = deque()
        self._held = 0
        self._slow = False
        self._busy = False
        """Whether a thread is writing; nobody else writes then."""

    def write(self, frames: bytes, number: int) -> None:
        """Write messages, or keep them for later."""
        sock = getattr(self._link, "socket", None)
        if sock is None:  # closed; or something else than expected, which knows how
            self._outer.write_data(frames)
            return
        if self._held >= self._queue:
            self._make_room()
        with self._lock:
            if self._busy:
                self._waiting.append((frames, number))
                self._held += number
                return
            rest = self._write_now(sock, frames, number)
            if rest:
                self._busy = True
                work = threading.Thread(target=self._run, args=(sock, rest, number), daemon=True)
                work.name = f"to {self._topic}"
                work.start()
            else:
                self._slow = False

    def _write_now(self, sock: socket.socket, frames: bytes, number: int) -> bytes:
        """Write what goes without waiting; return the rest."""
        try:
            sent: int = sock.send(frames, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return frames
        self._count(sent, number if sent == len(frames) else 0)
        return frames[sent:]

    def _count(self, size: int, number: int) -> None:
        self._link.stat_bytes += size
        self._link.stat_num_msg += number

    def _make_room(self) -> None:
        """Wait for the receiver where that is wanted, but not again for one that is slow; then drop the oldest."""
        if not self._slow and self._patient(self._outer):
            self._wait_for_room()
            self._slow = self._held >= self._queue
        dropped = 0
        with self._lock:
            while self._held >= self._queue and self._waiting:
                number = self._waiting.popleft()[1]
                self._held -= number
                dropped += number
        self._counts.dropped += dropped
        for _ in range(dropped):
            self._reports.warning(
                f"{self._link.endpoint_id} does not keep up with topic {self._topic}: a message is dropped for it"
            )

    def _wait_for_room(self) -> None:
        """Wait until there is room, or the receiver has taken nothing for too long."""
        unread, deadline = self._unread(), time.monotonic() + RECEIVER_WAIT_SECONDS
        while self._held >= self._queue and time.monotonic() < deadline and not rospy.is_shutdown():
            if self._link.socket is None:  # it has ended
                return
            wallsleep(PAUSE)
            before, unread = unread, self._unread()
            if unread != before:
                deadline = time.monotonic() + RECEIVER_WAIT_SECONDS

    def _unread(self) -> object:
        """Return what changes when the receiver takes something: what was written, and what it has left."""
        unread = bytearray(4)
        try:
            ioctl(self._link.socket, TIOCOUTQ, unread)
        except (OSError, TypeError, ValueError):  # closed meanwhile, or a system that does not tell
            pass
        return self._link.stat_bytes, bytes(unread)

    def _run(self, sock: socket.socket, frames: bytes, number: int) -> None:
        """Write, and then what waits, until nothing does."""
        try:
            while frames:
                sock.sendall(frames)
                self._count(len(frames), number)
                frames, number = self._next()
        except OSError as error:
            self._end(self._outer, error)

    def _next(self) -> Tuple[bytes, int]:
        """Take what waits, and how many messages that is."""
        with self._lock:
            taken: List[Tuple[bytes, int]] = []
            size = 0
            while self._waiting and len(taken) < MAX_COMBINED_WRITES and size < COMBINED_WRITE_BYTES:
                taken.append(self._waiting.popleft())
                size += len(taken[-1][0])
            number = sum(one[1] for one in taken)
            self._held -= number
            self._busy = bool(taken)
        return b"".join([one[0] for one in taken]), number
