"""Counters of subscribed and published topics, and warnings about topics without publishers after the start."""

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
    """Counters of a subscribed topic, updated once for all messages that are read together.

    Attributes:
        messages: number of received messages.
        dropped: number of messages that could not be decoded.
        refused: number of messages from publishers of another type, or with a refused stamp.
        last: receipt time of the last messages in seconds of the monotonic clock; None before the first.
        lag: time in nanoseconds from a message's stamp to its receipt; None if it has no stamp.
        needs_lag: whether to measure the lag of the next message. Decoding a stamp is expensive, so only one message
            per status report is measured.
    """

    __slots__ = ("dropped", "lag", "last", "messages", "refused", "needs_lag")

    def __init__(self) -> None:
        self.messages = self.dropped = self.refused = 0
        self.last: Optional[float] = None
        self.lag: Optional[int] = None
        self.needs_lag = True

    def count(self, messages: int) -> None:
        """Count received messages."""
        self.messages += messages
        self.last = time.monotonic()

    def measure_lag(self, stamp: Callable[[bytes], Optional[int]], data: bytes) -> None:
        """Measure the lag of a message."""
        self.needs_lag = False
        try:
            instant = stamp(data)
        except MessageError:
            # Reported by the handler of the message.
            return
        now = ros_now()
        self.lag = None if not instant or not now else now - instant


class OutputCounts:
    """Counters of a published topic.

    Attributes:
        sent: number of published messages, with or without subscribers.
        dropped: number of messages that were dropped for a slow subscriber; counted for each subscriber.
    """

    __slots__ = ("dropped", "sent")

    def __init__(self) -> None:
        self.sent = self.dropped = 0


class InputStatus(NamedTuple):
    """A subscribed topic.

    Attributes:
        topic: full name of the topic.
        type: message type of the subscription.
        publishers: number of connected publishers.
        messages: number of received messages.
        dropped: number of messages that could not be decoded.
        refused: number of messages from publishers of another type, or with a refused stamp.
        age: seconds since the last message; None before the first.
        lag: time in nanoseconds from a recent message's stamp to its receipt; None if messages have no stamps.
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
        topic: full name of the topic.
        type: message type of the topic.
        subscribers: number of connected subscribers.
        sent: number of published messages.
        dropped: number of messages that were dropped for a slow subscriber.
    """

    topic: str
    type: str
    subscribers: int
    sent: int
    dropped: int


PUBLISHER_WAIT_SECONDS = 10.0
"""Seconds after the start until topics without publishers are reported."""

_MIN_NAME_SIMILARITY = 0.7

_SERVICES = ("add_memory", "add_input_subscription")
"""Services that identify the two nodes of a program; each offers one."""

_MASTER_ERRORS = (OSError, Error, HTTPException, rosgraph.MasterException)


def unpublished_topic_warnings(
    inputs: Iterable[InputStatus], publishers: Mapping[str, Collection[str]], own_nodes: Collection[str]
) -> Iterator[str]:
    """Yield a warning for each subscribed topic without a publisher.

    Args:
        inputs: counters of each topic.
        publishers: publishers of each topic.
        own_nodes: nodes of this program; topics that only they publish are not suggested as intended inputs.
    """
    foreign_topics = [
        topic for topic, nodes in publishers.items() if any(node not in own_nodes for node in nodes)
    ]
    for status in inputs:
        if status.publishers or status.messages or publishers.get(status.topic):
            continue
        matches = get_close_matches(status.topic, foreign_topics, 1, _MIN_NAME_SIMILARITY)
        hint = f"; did you mean {matches[0]}?" if matches else ""
        name = f"{status.topic} ({status.type})"
        yield f"nobody publishes topic {name} {PUBLISHER_WAIT_SECONDS:g} s after the start{hint}"


def published_types() -> Dict[str, str]:
    """Return the types of all published topics; none if the master does not answer."""
    try:
        return dict(rosgraph.Master(rospy.get_name()).getPublishedTopics(""))
    except _MASTER_ERRORS:
        # Reported by `MasterWatch`.
        return {}


class StartupWarnings:
    """Warnings some seconds after the start: topics without publishers, and missing messages on ``/clock``.

    The delay is wall time, because simulated time may stand still.

    Args:
        inputs: returns the counters of each topic.
        topics: topics of the program or its parameters; others are not checked.
        check_clock: whether to check ``/clock``, too.
    """

    def __init__(
        self, inputs: Callable[[], List[InputStatus]], topics: Iterable[str], check_clock: bool = False
    ):
        self._inputs = inputs
        self._topics = {rospy.resolve_name(topic) for topic in topics}
        self._check_clock = check_clock
        timer = threading.Timer(PUBLISHER_WAIT_SECONDS, self.log_missing)
        timer.daemon = True
        timer.start()
        rospy.on_shutdown(timer.cancel)

    def log_missing(self) -> None:
        """Log the warnings."""
        if rospy.is_shutdown():
            return
        if self._check_clock:
            # Logs the warning, once.
            ros_now()
        unpublished = [
            status for status in self._inputs() if not status.publishers and status.topic in self._topics
        ]
        if not unpublished:
            return
        try:
            published, _, services = rosgraph.Master(rospy.get_name()).getSystemState()
        except _MASTER_ERRORS:
            # Reported by `MasterWatch`.
            return
        servers = {rospy.resolve_name(name) for name in _SERVICES}
        own_nodes = {
            rospy.get_name(),
            *(node for name, nodes in services if name in servers for node in nodes),
        }
        for text in unpublished_topic_warnings(unpublished, dict(published), own_nodes):
            rospy.logwarn("%s", printable(text))
