"""Events as text on the String topics between the nodes."""

from struct import Struct
from typing import Any, Callable, List

from std_msgs.msg import String

from ..engine.runtime import Reports
from ..foundation import MessageError
from .counting import OutputStatus
from .sending import Outlet

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
    """Publishes texts on a topic: those that are made together with one write. Not for use by two threads at once.

    Args:
        topic: its name.
        queue: how many texts may wait.
        reports: takes a warning of each text that is dropped.
    """

    def __init__(self, topic: str, queue: int, reports: Reports):
        self._outlet = Outlet(topic, String, queue, reports, patient=True)
        self._waiting: List[bytes] = []

    def add(self, text: str) -> None:
        """Add a text to those that go out next."""
        self._waiting.append(text_frame(text))
        if len(self._waiting) >= MOST:
            self.flush()

    def links(self) -> Any:
        """Return the connections to those who listen."""
        return self._outlet.links()

    def status(self) -> OutputStatus:
        """Return what has gone out so far."""
        return self._outlet.status("std_msgs/String")

    def flush(self) -> None:
        """Write the texts that were added."""
        waiting = self._waiting
        if waiting:
            self._outlet.send(b"".join(waiting), len(waiting))
            waiting.clear()


def text_taker(take: Callable[[str], object]) -> Callable[[object], Callable[[bytes], None]]:
    """Return what `InputTopic` needs to hand the texts of ``std_msgs/String`` messages to ``take``."""

    def receive(data: bytes) -> None:
        if len(data) < 4 or _SIZE.unpack_from(data)[0] != len(data) - 4:
            raise MessageError("expected a std_msgs/String, found other bytes")
        take(str(data[4:], "utf-8", "replace"))

    return lambda decoder: receive
