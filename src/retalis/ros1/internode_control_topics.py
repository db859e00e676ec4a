"""Topics between the nodes: their names, and the control data that they carry.

Events and outputs are exchanged as text on the topics `INPUT` and `OUTPUT` (see `text_topics`). Control data are JSON
on latched topics, so that an interface node that is restarted receives them:

* the argument positions that no rule, memory or goal reads (projection pushdown): the interface node omits the fields
  of messages that node ``retalis`` does not read (`ProjectionPublisher`, `ProjectionReceiver`);
* the topics to which goals subscribe with ``subscribe_to`` (`SubscriptionPublisher`, `SubscriptionReceiver`);
* the topics that the services of the interface node add and delete, and the value of ``~direct`` there
  (`InputTopicChanges`, `InputTopicChangesReceiver`).

Any node may publish on these topics, so a receiver validates what it reads.
"""

import json
import threading
from typing import Any, Callable, Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Set

import rospy
from std_msgs.msg import String

from ..engine.engine import Engine
from ..engine.event_input import MAX_INPUT_TOPICS, TopicRequest
from ..engine.runtime.problem_reports import Reports
from ..events.language.event_declarations import event_name_error
from ..events.program.topic_configuration import (
    DirectTopics,
    TopicType,
    read_direct,
    topic_type,
    uses_texts,
)
from ..foundation.displayed_text import printable, shorten
from ..foundation.errors import MessageError, RetalisError, UsageError
from ..node.subscribed_topics import SubscribedTopics
from ..node.text_exchange import resolve_subscribable_topic
from ..prolog.terms.types import Functor
from .rospy_transport import resolve

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
        self._dispatcher = engine.program.rules.dispatcher
        self._publisher = rospy.Publisher(UNREAD_ARGUMENTS_TOPIC, String, queue_size=10, latch=True)
        self._last_published: Optional[str] = None
        self._changed = threading.Event()
        self._changed.set()
        self._dispatcher.on_change.add(self._changed.set)
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
        # The receiver would reject a longer text; "{}" means that everything is read.
        if len(text) > MAX_CONTROL_CHARACTERS:
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

    def unread_positions(self, functor: Functor) -> FrozenSet[int]:
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


class SubscriptionPublisher:
    """Publisher of the list of subscriptions, for the interface node.

    If node ``retalis`` subscribes itself, the services of the interface node need the list for their answers.
    """

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
    """Receiver of the list of subscriptions in the interface node, which passes each one on once.

    Args:
        reports: receives a warning for each malformed list.
    """

    def __init__(self, subscribe: Callable[[TopicRequest], object], reports: Reports):
        self._subscribe = subscribe
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
                self._subscribe(request)


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


INPUT_CHANGES_TOPIC = "retalisInputTopics"
"""Topic of changes by the services of the interface node: JSON, an object with ``direct`` (the value of its
parameter), ``added`` (a list of [topic, type]) and ``deleted`` (a list of topics)."""


class InputChanges(NamedTuple):
    """Content of `INPUT_CHANGES_TOPIC`, with full names of topics.

    Attributes:
        direct: value of ``~direct`` of the interface node.
        added: types of the added topics.
    """

    direct: DirectTopics
    added: Dict[str, str]
    deleted: FrozenSet[str]


def _publish_changes(publisher: rospy.Publisher, changes: InputChanges) -> None:
    data = {
        "direct": changes.direct,
        "added": sorted(changes.added.items()),
        "deleted": sorted(changes.deleted),
    }
    publisher.publish(String(json.dumps(data)))


def announce_direct(direct: DirectTopics) -> rospy.Publisher:
    """Publish the value of ``~direct`` of an interface node that subscribes to topics itself."""
    publisher = rospy.Publisher(INPUT_CHANGES_TOPIC, String, queue_size=10, latch=True)
    _publish_changes(publisher, InputChanges(direct, {}, frozenset()))
    return publisher


class InputTopicChanges:
    """The input topics that services add and delete while node ``retalis`` itself subscribes to all topics.

    All changes are published together on a latched topic, so they apply whichever node starts first, and again if
    node ``retalis`` is restarted. If the interface node is restarted, there are no changes.

    Args:
        direct: value of ``~direct`` of the interface node.
        topics: further topics to which node ``retalis`` subscribes.
        reports: receives a warning for each malformed list of topics of goals.
    """

    def __init__(self, direct: DirectTopics, topics: Iterable[TopicType], reports: Reports):
        self._direct = direct
        self._lock = threading.Lock()
        self._types_by_topic = {rospy.resolve_name(topic): message_type for topic, message_type in topics}
        self._added: Dict[str, str] = {}
        self._deleted: Set[str] = set()
        self._publisher = rospy.Publisher(INPUT_CHANGES_TOPIC, String, queue_size=10, latch=True)
        self._publish()
        self._goal_topics = SubscriptionReceiver(self._record, reports)

    def subscribe(self, topic: str, message_type: str) -> None:
        """Have node ``retalis`` subscribe to a topic.

        Raises:
            UsageError: if the topic is subscribed already, a name is invalid, or there are too many topics.
        """
        topic, message_type = topic_type(topic, message_type)
        name = resolve_subscribable_topic(topic, resolve)
        with self._lock:
            known_type = self._added.get(name) or (
                None if name in self._deleted else self._types_by_topic.get(name)
            )
            if known_type is not None:
                raise UsageError(f"topic {topic} is already subscribed (as {known_type})")
            if len(self._added) >= MAX_INPUT_TOPICS:
                raise UsageError(f"topic {topic}: expected at most {MAX_INPUT_TOPICS} topics of services")
            self._added[name] = message_type
            self._publish()

    def unsubscribe(self, topic: str) -> None:
        """Have node ``retalis`` unsubscribe from a topic.

        Raises:
            UsageError: if it is not subscribed.
        """
        name = resolve(topic)
        with self._lock:
            if self._added.pop(name, None) is None:
                if name in self._deleted or name not in self._types_by_topic:
                    raise UsageError(f"topic {topic} is not subscribed")
                self._deleted.add(name)
            self._publish()

    def _record(self, request: TopicRequest) -> None:
        """Record a topic to which a goal has subscribed in node ``retalis``."""
        with self._lock:
            self._types_by_topic.setdefault(rospy.resolve_name(request.topic), request.message_type)

    def _publish(self) -> None:
        _publish_changes(self._publisher, InputChanges(self._direct, self._added, frozenset(self._deleted)))


class InputTopicChangesReceiver:
    """Receiver of the changes in node ``retalis``, which subscribes and unsubscribes accordingly.

    Args:
        subscribed: the topics of this node; None if it subscribes none of them, and only the value of ``~direct`` is
            checked.
        direct: value of ``~direct`` of this node.
        reports: receives a warning for each malformed message.
    """

    def __init__(self, subscribed: Optional[SubscribedTopics], direct: DirectTopics, reports: Reports):
        self._subscribed = subscribed
        self._direct = direct
        self._reports = reports
        self._lock = threading.Lock()
        self._added: Dict[str, str] = {}
        self._deleted: Dict[str, TopicRequest] = {}
        self._subscriber = rospy.Subscriber(INPUT_CHANGES_TOPIC, String, self._receive, queue_size=10)

    def _receive(self, message: Any) -> None:
        try:
            changes = read_input_changes(message.data)
        except MessageError as error:
            self._reports.warning(f"{INPUT_CHANGES_TOPIC}: {error}", INPUT_CHANGES_TOPIC)
            return
        if changes.direct != self._direct and (uses_texts(changes.direct) or uses_texts(self._direct)):
            header = message._connection_header  # noqa: SLF001 - rospy has no other name for it
            rospy.logerr(
                "parameter ~direct: it is %s here and %s in node %s: messages may be processed twice or not at all: "
                "start both nodes with the same value",
                json.dumps(self._direct),
                json.dumps(changes.direct),
                printable(shorten(header.get("callerid", "unknown"))),
            )
        if self._subscribed is not None:
            # An interface node that ends and its successor have two connections for a moment.
            with self._lock:
                self._apply(self._subscribed, changes)

    def _apply(self, subscribed: SubscribedTopics, changes: InputChanges) -> None:
        for topic, message_type in list(self._added.items()):
            if changes.added.get(topic) != message_type:
                del self._added[topic]
                _unsubscribe(subscribed, topic)
        # A topic that was deleted and added again is not the one that was deleted.
        for topic in changes.deleted.difference(self._deleted, self._added):
            request = _unsubscribe(subscribed, topic)
            if request is not None:
                self._deleted[topic] = request
        for topic in set(self._deleted).difference(changes.deleted):
            subscribed.try_to_subscribe(self._deleted.pop(topic), INPUT_CHANGES_TOPIC)
        for topic, message_type in changes.added.items():
            if topic not in self._added and subscribed.try_to_subscribe(
                TopicRequest(topic, message_type), "add_input_subscription"
            ):
                self._added[topic] = message_type


def _unsubscribe(subscribed: SubscribedTopics, topic: str) -> Optional[TopicRequest]:
    """Unsubscribe from a topic; return its subscription, or None if there is none."""
    try:
        return subscribed.unsubscribe(topic)
    except RetalisError as error:
        rospy.logdebug("%s: %s", INPUT_CHANGES_TOPIC, error)
        return None


def read_input_changes(text: str) -> InputChanges:
    """Return the changes in a text.

    Raises:
        MessageError: if the text does not have the expected form.
    """
    malformed = MessageError(f"expected direct, added and deleted topics, found {shorten(text)}")
    data = read_control_json(text, malformed)
    try:
        added = [topic_type(topic, message_type) for topic, message_type in data["added"]]
        return InputChanges(
            read_direct(data["direct"]),
            {
                resolve_subscribable_topic(topic, resolve): message_type
                for topic, message_type in added[:MAX_INPUT_TOPICS]
            },
            frozenset(map(resolve, data["deleted"])),
        )
    except (AttributeError, KeyError, TypeError, ValueError, UsageError):
        raise malformed from None
