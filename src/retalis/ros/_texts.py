"""Events as text on the String topics between the nodes."""

import threading
from collections import deque
from struct import Struct
from typing import Any, Callable, Deque

from std_msgs.msg import String

from ..errors import MessageError
from ._sending import Outlet

MOST = 64
"""Texts that are written at once at most."""

_SIZE = Struct("<I")
_SIZES = Struct("<II")


def text_frame(text: str) -> bytes:
    """Return a text as a ``std_msgs/String`` message, framed as on the wire."""
    data = text.encode("utf-8", "surrogateescape")
    size = len(data)
    return _SIZES.pack(size + 4, size) + data


class TextPublisher:
    """Publishes texts on a topic: those that are made together with one write.

    Args:
        topic: its name.
        queue: how many texts may wait.
    """

    def __init__(self, topic: str, queue: int):
        self._outlet = Outlet(topic, String, queue, patient=True)
        self._waiting: Deque[bytes] = deque()
        self._lock = threading.Lock()  # so that texts go out in the order in which they came

    def add(self, text: str) -> None:
        """Add a text to those that go out next."""
        self._waiting.append(text_frame(text))
        if len(self._waiting) >= MOST:
            self.flush()

    def flush(self) -> None:
        """Write the texts that were added."""
        with self._lock:
            waiting = self._waiting
            while waiting:
                frames = [waiting.popleft() for _ in range(min(MOST, len(waiting)))]
                self._outlet.send(b"".join(frames), len(frames))


def text_taker(take: Callable[[str], Any]) -> Callable[[Any], Callable[[bytes], None]]:
    """Return what `Input` needs to hand the texts of ``std_msgs/String`` messages to ``take``."""

    def receive(data: bytes) -> None:
        if len(data) < 4 or _SIZE.unpack_from(data)[0] != len(data) - 4:
            raise MessageError("expected a std_msgs/String, found other bytes")
        take(str(data[4:], "utf-8", "replace"))

    return lambda decoder: receive
