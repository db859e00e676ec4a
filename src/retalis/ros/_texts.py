"""Events as text on the String topics between the nodes."""

import struct
import threading
import time
from collections import deque
from typing import Any, Callable, Deque, Set

import rospy
from rospy.exceptions import TransportException
from rospy.rostime import wallsleep
from std_msgs.msg import String

from ..errors import MessageError

GAP = 0.002
"""Seconds between two writes to the same topic: what is sent meanwhile goes out together."""

PATIENCE = 1.0
"""Seconds to wait for a receiver that does not keep up."""

BACKLOG = 4
"""Writes that may wait at a connection before that."""

PERIOD = 5.0
"""Seconds between two warnings."""

MOST = 64
"""Texts that are written at once at most."""

_SIZE = struct.Struct("<I")
_SIZES = struct.Struct("<II")


class TextPublisher:
    """Publishes texts on a topic; where many come, several with one write.

    A text is sent at once where none was sent just before. rospy's own `Publisher.publish` wakes a thread
    and does a system call for each message, here and at the receiver, which is more than all the rest of the
    work.

    Where a receiver does not keep up, those who send are held up for a moment, so that a burst loses
    nothing; one that does not keep up for longer is left to rospy, which drops the oldest for it alone.

    Args:
        topic: its name.
        queue: how many texts may wait.
    """

    def __init__(self, topic: str, queue: int):
        self._publisher = rospy.Publisher(topic, String, queue_size=max(2 * BACKLOG, queue // MOST))
        self._queue = queue
        self._waiting: Deque[bytes] = deque(maxlen=queue)
        self._wake = threading.Event()
        self._slow: Set[Any] = set()
        self.dropped = 0
        rospy.on_shutdown(self._wake.set)
        threading.Thread(target=self._run, name=f"texts to {topic}", daemon=True).start()

    def send(self, text: str) -> None:
        """Have a text published."""
        data = text.encode("utf-8", "surrogateescape")
        size = len(data)
        if len(self._waiting) >= self._queue and not wait_until(lambda: len(self._waiting) < self._queue):
            self.dropped += 1
            rospy.logwarn_throttle(
                PERIOD,
                f"texts come faster than {self._publisher.name} takes them: {self.dropped} dropped so far",
            )
        self._waiting.append(_SIZES.pack(size + 4, size) + data)
        if not self._wake.is_set():
            self._wake.set()

    def _run(self) -> None:
        while not rospy.is_shutdown():
            self._wake.wait()
            self._wake.clear()
            waiting = self._waiting
            while waiting:
                self._write(b"".join([waiting.popleft() for _ in range(min(MOST, len(waiting)))]))
            wallsleep(GAP)

    def _write(self, frames: bytes) -> None:
        """Write messages, framed as on the wire, to all connections."""
        topic = self._publisher.impl
        links = () if topic is None else topic.connections
        self._slow.intersection_update(links)
        for link in links:
            try:
                self._wait_for(link)
                link.write_data(frames)
            except (TransportException, OSError) as error:
                rospy.logdebug("a connection of %s has ended: %s", self._publisher.name, error)
                link.close()

    def _wait_for(self, link: Any) -> None:
        """Wait until a connection has written most of what it was given, but not again for one that is slow."""
        if backlog(link) < BACKLOG:
            self._slow.discard(link)
        elif link not in self._slow and not wait_until(lambda: backlog(link) < BACKLOG):
            self._slow.add(link)
            rospy.logwarn("%s does not keep up with topic %s", link.endpoint_id, self._publisher.name)


def backlog(link: Any) -> int:
    """Return how much a connection was given that its thread has not taken yet."""
    return len(getattr(link, "_queue", ()))  # of rospy's QueuedConnection, which has no name for it


def wait_until(condition: Callable[[], bool]) -> bool:
    """Wait for a condition, not for long; tell whether it holds."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline or rospy.is_shutdown():
            return False
        wallsleep(GAP)
    return True


def text_taker(take: Callable[[str], Any]) -> Callable[[Any], Callable[[bytes], None]]:
    """Return what `Input` needs to hand the texts of ``std_msgs/String`` messages to ``take``."""

    def receive(data: bytes) -> None:
        if len(data) < 4 or _SIZE.unpack_from(data)[0] != len(data) - 4:
            raise MessageError("expected a std_msgs/String, found other bytes")
        take(str(data[4:], "utf-8", "replace"))

    return lambda decoder: receive
