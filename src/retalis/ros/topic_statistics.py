"""What comes in on topics and goes out of them, counted by those who take and send it.

What is said once, some seconds after the start: topics that nobody publishes, and a clock that does not come.
"""

import threading
import time
from difflib import get_close_matches
from http.client import HTTPException
from typing import Callable, Collection, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional
from xmlrpc.client import Error

import rosgraph
import rospy

from ..foundation.errors import MessageError, printable
from .ros_time import ros_now


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


PUBLISHER_WAIT_SECONDS = 10.0
"""Seconds that publishers have to come."""

_ALIKE = 0.7

_SERVICES = ("add_memory", "add_input_subscription")
"""Services by which the two nodes of a program are found; they have one each."""

_NO_MASTER = (OSError, Error, HTTPException, rosgraph.MasterException)


def unpublished(
    inputs: Iterable[InputStatus], publishers: Mapping[str, Collection[str]], own: Collection[str]
) -> Iterator[str]:
    """Yield a warning for each subscribed topic that nobody publishes.

    Args:
        inputs: what has come on each topic.
        publishers: the nodes that publish each topic.
        own: the nodes that run this program: a topic that nobody else publishes is no input that was meant.
    """
    foreign = [topic for topic, nodes in publishers.items() if any(node not in own for node in nodes)]
    for one in inputs:
        if one.publishers or one.messages or publishers.get(one.topic):
            continue
        near = get_close_matches(one.topic, foreign, 1, _ALIKE)
        hint = f"; did you mean {near[0]}?" if near else ""
        yield f"nobody publishes topic {one.topic} ({one.type}) {PUBLISHER_WAIT_SECONDS:g} s after the start{hint}"


def published_types() -> Dict[str, str]:
    """Return the types of all topics that somebody publishes; none if the master does not answer."""
    try:
        return dict(rosgraph.Master(rospy.get_name()).getPublishedTopics(""))
    except _NO_MASTER:  # which is said elsewhere
        return {}


class StartupWarnings:
    """Looks once, by the clock on the wall: that of ROS may stand still.

    Args:
        inputs: tells what has come on each topic.
        named: the topics that somebody has named, which are looked at.
        clock: whether to say, too, that ``/clock`` is expected and does not come.
    """

    def __init__(self, inputs: Callable[[], List[InputStatus]], named: Iterable[str], clock: bool = False):
        self._inputs = inputs
        self._named = {rospy.resolve_name(topic) for topic in named}
        self._clock = clock
        timer = threading.Timer(PUBLISHER_WAIT_SECONDS, self.look)
        timer.daemon = True
        timer.start()
        rospy.on_shutdown(timer.cancel)

    def look(self) -> None:
        """Say what is missing."""
        if rospy.is_shutdown():
            return
        if self._clock:
            ros_now()  # which says it, once
        waiting = [one for one in self._inputs() if not one.publishers and one.topic in self._named]
        if not waiting:
            return
        try:
            published, _, services = rosgraph.Master(rospy.get_name()).getSystemState()
        except _NO_MASTER:  # which is said elsewhere
            return
        servers = {rospy.resolve_name(name) for name in _SERVICES}
        own = {rospy.get_name(), *(node for name, nodes in services if name in servers for node in nodes)}
        for text in unpublished(waiting, dict(published), own):
            rospy.logwarn("%s", printable(text))
