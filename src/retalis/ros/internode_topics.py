"""Topics between the nodes: their names, and the control data that they carry.

Events and outputs are exchanged as text on the topics `INPUT` and `OUTPUT` (see `text_topics`). Control data are JSON
on latched topics, so that an interface node that is restarted receives them:

* the argument positions that no rule, memory or goal reads (projection pushdown): the interface node omits the fields
  of messages that node ``retalis`` does not read (`ProjectionPublisher`, `ProjectionReceiver`);
* the topics to which goals subscribe with ``subscribe_to`` (`DynamicSubscriptions`, `SubscriptionReceiver`).

Any node may publish on these topics, so a receiver validates what it reads.
"""

import json
import threading
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional, Set

import rospy
from std_msgs.msg import String

from ..engine.engine import Engine
from ..engine.event_input import MAX_INPUT_TOPICS, TopicRequest
from ..engine.runtime.problem_reports import Reports
from ..events.language.event_declarations import event_name_error
from ..foundation.errors import MessageError, RetalisError, UsageError, shorten
from ..foundation.ros_names import topic_fault
from ..prolog.terms.types import Functor

if TYPE_CHECKING:
    from .ros_interface import RosInterface

INPUT = "retalisInputEvents"
OUTPUT = "retalisOutputEvents"
"""Topics of event texts: input from the interface to node retalis, and output in the other direction."""

WATCH = "retalis_watch_"
"""Beginning of the names of topics whose outputs exist only as text, for ``retalis watch``."""


def resolve(topic: str) -> str:
    """Return the full name of a topic, after remapping and in its namespace.

    Raises:
        UsageError: if the name is invalid.
    """
    # rospy accepts names that the master or other clients reject, so the package's own check comes first.
    fault = topic_fault(topic.strip())
    if fault is not None or not topic.strip(" /"):
        raise UsageError(fault or f'"{topic}" is not a topic name')
    try:
        return str(rospy.resolve_name(topic.strip()))
    except (ValueError, rospy.ROSException) as error:
        raise UsageError(f'"{topic}" is not a topic name: {error}') from error


def resolve_subscribable_topic(topic: str) -> str:
    """Return the full name of a topic that a goal may subscribe to.

    Raises:
        UsageError: if the name is invalid, or the topic belongs to the protocol between the nodes.
    """
    name = resolve(topic)
    if name in map(rospy.resolve_name, (INPUT, OUTPUT)):
        raise UsageError(f"topic {topic} is for events as text, between the nodes")
    return name


MAX_CONTROL_CHARACTERS = 1_000_000
"""Limit for the characters of control data."""


def read_control_json(text: str, malformed: MessageError) -> Any:
    """Return the data of a JSON text; None if it is too long.

    Raises:
        MessageError: the error ``malformed``, if the text is not JSON.
    """
    try:
        return json.loads(text) if len(text) <= MAX_CONTROL_CHARACTERS else None
    except (ValueError, RecursionError):
        raise malformed from None


UNREAD_ARGUMENTS_TOPIC = "retalisUnread"
"""Topic of the unread arguments: JSON, lists of argument positions by functor (name and arity)."""

NO_POSITIONS: FrozenSet[int] = frozenset()


class ProjectionPublisher:
    """Publishes the unread arguments of an engine after each change, in a thread."""

    def __init__(self, engine: Engine):
        self._dispatcher = engine.dispatcher
        self._publisher = rospy.Publisher(UNREAD_ARGUMENTS_TOPIC, String, queue_size=10, latch=True)
        self._last_published: Optional[str] = None
        self._changed = threading.Event()
        self._changed.set()
        self._dispatcher.on_change = self._changed.set
        threading.Thread(target=self._run, name=UNREAD_ARGUMENTS_TOPIC, daemon=True).start()

    def _run(self) -> None:
        while not rospy.is_shutdown():
            # Several changes during the loading of a program are combined into one message.
            self._changed.wait()
            self._changed.clear()
            try:
                self._publish_changes()
            except rospy.ROSException as error:
                # The node is being shut down.
                rospy.logdebug("%s: %s", UNREAD_ARGUMENTS_TOPIC, error)

    def _publish_changes(self) -> None:
        unread_positions = self._dispatcher.projection.announce()
        text = json.dumps(
            {str(functor): sorted(positions) for functor, positions in unread_positions.items()}
        )
        if (
            len(text) > MAX_CONTROL_CHARACTERS
        ):  # the receiver would reject it; "{}" means that everything is read
            text = "{}"
        if text != self._last_published:
            self._publisher.publish(String(text))
            self._last_published = text


class _ReceivedPositions(NamedTuple):
    """The last received positions, and the header of the connection on which they were received."""

    header: Dict[str, str]
    positions: Dict[str, FrozenSet[int]]


class ProjectionReceiver:
    """Receiver of the unread arguments in the interface node.

    Args:
        connections: returns the connections of the subscribers of the texts.
        reports: receives a warning for each malformed message.
    """

    def __init__(self, connections: Callable[[], List[Any]], reports: Reports):
        self._connections = connections
        self._reports = reports
        self._received: Optional[_ReceivedPositions] = None
        self._subscriber = rospy.Subscriber(UNREAD_ARGUMENTS_TOPIC, String, self._receive, queue_size=10)

    def of(self, functor: Functor) -> FrozenSet[int]:
        """Return the argument positions of events that may be omitted now.

        This is valid only for a text that is sent at once. A text that is stored for later subscribers has to be
        complete.
        """
        received = self._received
        positions = NO_POSITIONS if received is None else received.positions.get(str(functor), NO_POSITIONS)
        return positions if positions and received is not None and self._is_valid(received) else NO_POSITIONS

    def _is_valid(self, received: _ReceivedPositions) -> bool:
        """Return whether the positions' publisher is still connected, and the only subscriber of the texts."""
        subscribers = self._connections()
        if len(subscribers) != 1 or getattr(subscribers[0], "endpoint_id", None) != received.header.get(
            "callerid"
        ):
            return False
        publisher_connections = getattr(self._subscriber.impl, "connections", ())
        # A restarted node has the same name, but another connection, and its rules may read other arguments.
        return any(
            connection.header is received.header and not connection.done
            for connection in publisher_connections
        )

    def _receive(self, message: Any) -> None:
        header = message._connection_header  # noqa: SLF001 - rospy has no other name for it
        try:
            self._received = _ReceivedPositions(header, _parse_positions(message.data))
        except MessageError as error:
            self._received = None
            self._reports.warning(
                f"{UNREAD_ARGUMENTS_TOPIC} from {header.get('callerid', 'somebody')}: {error}",
                UNREAD_ARGUMENTS_TOPIC,
            )


def _parse_positions(text: str) -> Dict[str, FrozenSet[int]]:
    """Return the argument positions by functor in a text.

    Raises:
        MessageError: if the text does not have the expected form.
    """
    malformed = MessageError(f"expected numbers of arguments by name, found {shorten(text)}")
    data = read_control_json(text, malformed)
    if not isinstance(data, dict):
        raise malformed
    for positions in data.values():
        if not isinstance(positions, list) or not all(position.__class__ is int for position in positions):
            raise malformed
    return {name: frozenset(positions) for name, positions in data.items()}


SUBSCRIPTIONS_TOPIC = "retalisSubscribe"
"""Topic with the list of subscriptions: JSON, a list of [topic, type, event name]."""


class DynamicSubscriptions:
    """Queue of subscriptions that goals request, executed by a thread as soon as there is an interface.

    A thread is necessary because subscribing calls the master, which would block the engine. The length of the queue
    is bounded by `MAX_INPUT_TOPICS`.
    """

    def __init__(self) -> None:
        self._requests: SimpleQueue[TopicRequest] = SimpleQueue()
        self.request: Callable[[TopicRequest], None] = self._requests.put

    def start(self, interface: Optional["RosInterface"]) -> None:
        """Execute the queued requests, and start the thread for later ones.

        Args:
            interface: the ROS interface of this node; None if the interface runs in another node.
        """
        execute = (
            _SubscriptionPublisher().publish_added
            if interface is None
            else lambda request: _subscribe(interface, request)
        )

        def run() -> None:
            while not rospy.is_shutdown():
                execute(self._requests.get())

        # Requests of the program's loading are executed before this returns, as for the topics of `pub_sub.xml`.
        try:
            while True:
                execute(self._requests.get_nowait())
        except Empty:
            pass
        threading.Thread(target=run, daemon=True, name="topics of goals").start()


class _SubscriptionPublisher:
    """Publisher of the list of subscriptions, for the interface node."""

    def __init__(self) -> None:
        self._subscriptions: List[TopicRequest] = []
        self._publisher = rospy.Publisher(SUBSCRIPTIONS_TOPIC, String, queue_size=10, latch=True)

    def publish_added(self, request: TopicRequest) -> None:
        """Add a topic to the list, and publish it."""
        self._subscriptions.append(request)
        try:
            self._publisher.publish(String(json.dumps(self._subscriptions)))
        except rospy.ROSException as error:
            # The node is being shut down.
            rospy.logdebug("%s: %s", SUBSCRIPTIONS_TOPIC, error)


class SubscriptionReceiver:
    """Receiver of the list of subscriptions in the interface node; it subscribes to each topic once.

    Args:
        interface: the ROS interface.
        reports: receives a warning for each malformed list.
    """

    def __init__(self, interface: "RosInterface", reports: Reports):
        self._interface = interface
        self._reports = reports
        self._subscribed: Set[TopicRequest] = set()
        self._subscriber = rospy.Subscriber(SUBSCRIPTIONS_TOPIC, String, self._receive, queue_size=10)

    def _receive(self, message: Any) -> None:
        try:
            topics = read_subscriptions(message.data)
        except MessageError as error:
            self._reports.warning(f"{SUBSCRIPTIONS_TOPIC}: {error}", SUBSCRIPTIONS_TOPIC)
            return
        for request in topics:
            if request not in self._subscribed and len(self._subscribed) < MAX_INPUT_TOPICS:
                self._subscribed.add(request)
                _subscribe(self._interface, request)


def read_subscriptions(text: str) -> List[TopicRequest]:
    """Return the subscriptions of a list.

    Raises:
        MessageError: if the text does not have the expected form.
    """
    malformed = MessageError(f"expected topics, types and names of events, found {shorten(text)}")
    items = read_control_json(text, malformed)
    if not isinstance(items, list):
        raise malformed
    for item in items:
        if not isinstance(item, list) or len(item) != 3 or not all(part.__class__ is str for part in item):
            raise malformed
        if item[2] and event_name_error(item[2]):
            raise malformed
    return [TopicRequest(*item) for item in items]


def _subscribe(interface: "RosInterface", request: TopicRequest) -> None:
    try:
        interface.subscribe(*request)
    except RetalisError as error:
        rospy.logerr("subscribe_to: %s", error)
    except rospy.ROSException as error:
        # The node is being shut down.
        rospy.logdebug("subscribe_to: topic %s: %s", shorten(request.topic), error)
