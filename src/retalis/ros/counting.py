"""What comes in on topics and goes out of them, counted by those who take and send it."""

import time
from typing import Callable, NamedTuple, Optional

from ..foundation import MessageError
from .rostime import ros_now


class InputCounts:
    """What has come on a subscribed topic; noted for all messages of a wake-up together.

    Attributes:
        messages: how many have come.
        dropped: how many of them could not be read.
        refused: how many came from publishers of another type.
        last: when the last ones came, by the monotonic clock; None before the first.
        lag: by how many nanoseconds a message came after its stamp; None where it has none.
        wanted: whether the lag of the next message is wanted: reading a stamp costs, so once in a while is enough.
    """

    __slots__ = ("dropped", "lag", "last", "messages", "refused", "wanted")

    def __init__(self) -> None:
        self.messages = self.dropped = self.refused = 0
        self.last: Optional[float] = None
        self.lag: Optional[int] = None
        self.wanted = True

    def note(self, number: int) -> None:
        """Note messages that have come."""
        self.messages += number
        self.last = time.monotonic()

    def look(self, stamp: Callable[[bytes], Optional[int]], data: bytes) -> None:
        """Note the lag of a message."""
        self.wanted = False
        try:
            instant = stamp(data)
        except MessageError:  # said by who takes it
            return
        now = ros_now()
        self.lag = None if not instant or not now else now - instant


class OutputCounts:
    """What has gone out on a topic.

    Attributes:
        sent: how many messages, whether or not anybody listened.
        dropped: how many were dropped for a subscriber that did not keep up; one for two of them counts twice.
    """

    __slots__ = ("dropped", "sent")

    def __init__(self) -> None:
        self.sent = self.dropped = 0


class InputStatus(NamedTuple):
    """A subscribed topic.

    Attributes:
        topic: its full name.
        type: the message type that it was subscribed as.
        publishers: how many are connected.
        messages: how many have come.
        dropped: how many of them could not be read.
        refused: how many came from publishers of another type.
        age: how many seconds ago the last ones came; None where none has.
        lag: by how many nanoseconds a message came after its stamp, lately; None where messages have none.
    """

    topic: str
    type: str
    publishers: int
    messages: int
    dropped: int
    refused: int
    age: Optional[float]
    lag: Optional[int]


class OutputStatus(NamedTuple):
    """A published topic.

    Attributes:
        topic: its full name.
        type: its message type.
        subscribers: how many are connected.
        sent: how many messages have gone out.
        dropped: how many were dropped for a subscriber that did not keep up.
    """

    topic: str
    type: str
    subscribers: int
    sent: int
    dropped: int
