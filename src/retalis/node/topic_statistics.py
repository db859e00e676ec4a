"""Counters of subscribed and published topics, and warnings about topics without publishers after the start."""

import logging
import threading
import time
from struct import Struct
from typing import Callable, Collection, Iterable, Iterator, List, Mapping, NamedTuple, Optional

from ..foundation.displayed_text import format_count, printable
from ..foundation.errors import MessageError
from ..foundation.similar_names import did_you_mean
from .transport import TopicPublication, Transport

log = logging.getLogger("retalis")


class InputCounts:
    """Counters of a subscribed topic, updated once for all messages that are read together.

    Args:
        now: returns the present time in ns; 0 if it is unknown.

    Attributes:
        messages: number of received messages.
        dropped: number of messages that could not be decoded.
        refused: number of messages from publishers of another type, or with a refused stamp.
        missing: number of messages that publishers dropped because this node read too slowly; see `LossMonitor`.
        last: receipt time of the last messages in seconds of the monotonic clock; None before the first.
        lag: time in nanoseconds from a message's stamp to its receipt; None if it has no stamp.
        needs_lag: whether to measure the lag of the next message. Decoding a stamp is expensive, so only one message
            per status report is measured.
    """

    __slots__ = ("_now", "dropped", "lag", "last", "messages", "missing", "refused", "needs_lag")

    def __init__(self, now: Callable[[], int]) -> None:
        self._now = now
        self.messages = self.dropped = self.refused = self.missing = 0
        self.last: Optional[float] = None
        self.lag: Optional[int] = None
        self.needs_lag = True

    def count(self, messages: int) -> None:
        """Count received messages."""
        self.messages += messages
        self.last = time.monotonic()

    def measure_lag(
        self, stamp: Callable[[bytes], Optional[int]], data: bytes, received: Optional[int] = None
    ) -> None:
        """Measure the lag of a message, which was received at an instant in ns; None means now."""
        self.needs_lag = False
        try:
            instant = stamp(data)
        except MessageError:
            # Reported by the handler of the message.
            return
        now = received or self._now()
        self.lag = None if not instant or not now else now - instant


MIN_BEHIND_SECONDS = 0.2
"""Seconds for which a node must have been behind a publisher for the end of the connection to be a probable loss; and
longest idle time before that end."""

_read_uint32 = Struct("<I").unpack_from


class LossMonitor:
    """Detection of messages that the publisher of one connection dropped because this node read too slowly.

    TCP loses nothing, but a publisher whose subscriber is slow drops messages from its own queue. Two traces of this
    reach the subscriber:

    * ROS numbers the messages of a publisher in ``header.seq``. A gap counts if this node was busy with earlier
      messages for longer than it waited for this one. Otherwise another node has left the messages out on purpose, as
      the nodes of ``topic_tools`` do. If a number does not increase, several publishers or a bag have numbered the
      messages, and the gaps of the connection count no more.
    * A publisher that ends with a full queue closes the connection, often within a message.

    Args:
        counts: counters of the topic.
        has_header: whether messages begin with a header.
        report: called with the description of a loss.
        now: clock in seconds.
    """

    def __init__(
        self,
        counts: InputCounts,
        has_header: bool,
        report: Callable[[str], None],
        now: Callable[[], float] = time.monotonic,
    ):
        self._counts = counts
        self._has_sequence = has_header
        self._report = report
        self._now = now
        self._last_number: Optional[int] = None
        self._missing = 0
        self._begin = self._end = now()
        self._behind_since: Optional[float] = None

    def begin(self, messages: List[bytes]) -> None:
        """Record that messages were read, before they are processed."""
        now = self._now()
        if now - self._end >= self._end - self._begin:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = self._begin
        self._begin = now
        if self._has_sequence:
            self._check_sequence(messages)

    def end(self) -> None:
        """Record that the messages have been processed."""
        self._end = self._now()

    def record_lost(self, count: int) -> None:
        """Record messages that the transport knows to be lost."""
        self._counts.missing += count
        self._report(f"{format_count(count, 'message')} lost")

    def close(self, is_incomplete: bool) -> None:
        """Record that the publisher has closed the connection, possibly within a message."""
        if is_incomplete:
            self._counts.missing += 1
            self._report("it closed the connection within a message: those in its queue are lost, too")
        # Shorter: a publisher that sends some messages and ends has probably sent all of them.
        # After an idle time, the publisher's queue was empty.
        elif (
            self._behind_since is not None
            and self._end - self._behind_since > MIN_BEHIND_SECONDS
            and self._now() - self._end < MIN_BEHIND_SECONDS
        ):
            self._report("it closed the connection: messages that were still in its queue are lost")

    def _check_sequence(self, messages: List[bytes]) -> None:
        for data in messages:
            if len(data) < 4:
                return
            number, last_number = _read_uint32(data)[0], self._last_number
            self._last_number = number
            if last_number is None or number == last_number + 1:
                continue
            if number <= last_number:
                self._counts.missing -= self._missing
                self._has_sequence = False
                return
            if self._behind_since is not None:
                missing = number - last_number - 1
                self._missing += missing
                self._counts.missing += missing
                self._report(
                    f"{format_count(missing, 'message')} missing between header.seq {last_number} and {number}"
                )


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
        missing: number of messages that publishers dropped because this node read too slowly; see `LossMonitor`.
        age: seconds since the last message; None before the first.
        lag: time in nanoseconds from a recent message's stamp to its receipt; None if messages have no stamps.
    """

    topic: str
    type: str
    publishers: int
    messages: int
    dropped: int
    refused: int
    missing: int
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


def describe_publication(topic: str, message_type: str, publication: TopicPublication) -> OutputStatus:
    """Return the counters of an advertised topic."""
    return OutputStatus(
        topic, message_type, publication.subscriber_count(), publication.sent, publication.dropped
    )


PUBLISHER_WAIT_SECONDS = 10.0
"""Seconds after the start until topics without publishers are reported."""

_MIN_NAME_SIMILARITY = 0.7

_SERVICES = ("add_memory", "add_input_subscription")
"""Services that identify the two nodes of a program; each offers one."""


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
        hint = did_you_mean(status.topic, foreign_topics, _MIN_NAME_SIMILARITY)
        name = f"{status.topic} ({status.type})"
        yield f"nobody publishes topic {name} {PUBLISHER_WAIT_SECONDS:g} s after the start{hint}"


class StartupWarnings:
    """Warnings some seconds after the start: topics without publishers.

    The delay is wall time, because simulated time may stand still.

    Args:
        transport: the middleware.
        inputs: returns the counters of each topic.
        topics: topics of the program or its parameters; others are not checked.
    """

    def __init__(self, transport: Transport, inputs: Callable[[], List[InputStatus]], topics: Iterable[str]):
        self._transport = transport
        self._inputs = inputs
        self._topics = {transport.resolve_topic(topic) for topic in topics}
        timer = threading.Timer(PUBLISHER_WAIT_SECONDS, self.log_missing)
        timer.daemon = True
        timer.start()
        transport.on_shutdown(timer.cancel)

    def log_missing(self) -> None:
        """Log the warnings."""
        transport = self._transport
        if transport.is_shut_down():
            return
        # A transport logs, once, that simulated time is unknown.
        transport.now()
        unpublished = [
            status for status in self._inputs() if not status.publishers and status.topic in self._topics
        ]
        if not unpublished:
            return
        graph = transport.graph()
        # Without an answer nothing is known of publishers.
        if graph is None:
            return
        servers = {transport.resolve_topic(name) for name in _SERVICES}
        own_nodes = {transport.node_name}.union(*(graph.servers.get(name, ()) for name in servers))
        for text in unpublished_topic_warnings(unpublished, graph.publishers, own_nodes):
            log.warning("%s", printable(text))
