"""A bag as transport of a running program: topics from the connections of a bag, and time from its messages.

The messages of a bag come in one order, that of their receipt, and the clock is moved before each of them. The
transport therefore does not call `MessageReceiver.receive`. It connects each subscription with the connections of the
bag that is played, and whoever plays the bag calls `MessageReceiver.convert` for the receivers of each message.
"""

from typing import Dict, Iterable, List, NamedTuple, Set, Tuple

from ..events.clock.clock import StreamClock
from ..events.program.topic_configuration import ANY_QUALITY, QualityOfService
from ..foundation.ros_name_checks import strip_slashes
from ..messages.type_definition import Definition, SerializationFormat
from ..node.transport import Connect, MessageReceiver, MessageSource
from .bag_locations import Bag
from .rosbag1 import Topic


class BagSubscription:
    """A subscription; see `TopicSubscription`.

    Args:
        topic: full name of the topic.
        connect: returns the receiver of a connection's messages.
    """

    def __init__(self, topic: str, connect: Connect):
        self.topic = topic
        self.connect = connect
        self.publisher_names: List[str] = []

    def publisher_count(self) -> int:
        """Return the number of connections of the bag."""
        return len(self.publisher_names)

    def publishers(self) -> List[str]:
        """Return the nodes that published the messages of the bag, as far as they are known."""
        return [name for name in self.publisher_names if name]

    def close(self) -> None:
        """Receive nothing from the next bag on."""
        self.topic = ""


class BagPublication:
    """An advertised topic; see `TopicPublication`.

    Attributes:
        definition: see above.
        sent: number of published messages.
        dropped: number of dropped messages, which is 0.
    """

    def __init__(self, definition: Definition):
        self.definition = definition
        self.sent = self.dropped = 0
        self._messages: List[bytes] = []

    def subscriber_count(self) -> int:
        """Return the number of subscribers: the caller of `take`."""
        return 1

    def send(self, message: bytes) -> None:
        """Store a serialized message."""
        self.sent += 1
        self._messages.append(message)

    def take(self) -> List[bytes]:
        """Return the messages that were sent since the last call."""
        messages, self._messages = self._messages, []
        return messages


class RefusedConnection(NamedTuple):
    """A connection of a bag whose messages are dropped, and the reason."""

    topic: Topic
    error: str


class BagTransport:
    """A bag, or several one after the other, as `MessageTransport`.

    Args:
        output_format: value of ``format``.

    Attributes:
        format: serialization of outputs.
        received_formats: those of all bags.
        clock: time of the bag, moved by whoever plays it.
        publications: advertised topics by full name.
        receivers: receivers of the messages of each connection, by the identity of its `Topic`: hashing a topic would
            hash all its fields for every message.
    """

    def __init__(self, output_format: SerializationFormat = SerializationFormat.ROS1) -> None:
        self.format = output_format
        self.received_formats: Tuple[SerializationFormat, ...] = (
            SerializationFormat.ROS1,
            SerializationFormat.CDR,
        )
        self.clock = StreamClock(0)
        self.publications: Dict[str, BagPublication] = {}
        self.receivers: Dict[int, Tuple[MessageReceiver, ...]] = {}
        self._subscriptions: List[BagSubscription] = []
        self._new_subscriptions: List[BagSubscription] = []
        self._names_being_read: Set[str] = set()

    def now(self) -> int:
        """Return the time of the bag in nanoseconds; 0 before its first message."""
        return self.clock.now()

    def resolve_topic(self, topic: str) -> str:
        """Return the full name of a topic; bags may contain names without a leading slash."""
        return f"/{strip_slashes(topic)}"

    def subscribe(
        self,
        topic: str,
        message_type: str,
        connect: Connect,
        queue_size: int,
        max_delay: float = 0.0,
        ignores_own: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> BagSubscription:
        """Subscribe to a topic of the present bag and of later ones; see `MessageTransport.subscribe`."""
        subscription = BagSubscription(topic, connect)
        self._subscriptions.append(subscription)
        self._new_subscriptions.append(subscription)
        return subscription

    def advertise(
        self,
        topic: str,
        definition: Definition,
        queue_size: int,
        is_latched: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> BagPublication:
        """Publish a topic; see `MessageTransport.advertise`."""
        publication = self.publications[topic] = BagPublication(definition)
        return publication

    def is_shut_down(self) -> bool:
        """Return False: the program may process a further bag."""
        return False

    def has_new_subscriptions(self) -> bool:
        """Return whether there are subscriptions that `connect` has not connected."""
        return bool(self._new_subscriptions)

    def start(self, bag: Bag) -> Tuple[Set[str], List[RefusedConnection]]:
        """Connect all subscriptions with a bag, in place of the former one; see `connect`."""
        self.receivers = {id(topic): () for topic in bag.topics}
        self._names_being_read = set()
        self._new_subscriptions = list(self._subscriptions)
        return self.connect(bag)

    def connect(self, bag: Bag) -> Tuple[Set[str], List[RefusedConnection]]:
        """Connect the new subscriptions with a bag.

        Returns:
            Names of the bag's topics that must be read from now on, and the connections whose messages are dropped.
        """
        subscriptions, self._new_subscriptions = self._new_subscriptions, []
        refused: List[RefusedConnection] = []
        for topic in bag.topics:
            name = self.resolve_topic(topic.name)
            for subscription in subscriptions:
                if subscription.topic == name:
                    refused += self._connect_topic(topic, subscription)
        subscribed_names = {subscription.topic for subscription in subscriptions}
        names = {name for name in list_topic_names(bag) if self.resolve_topic(name) in subscribed_names}
        # A topic may be read already: for its transforms, or for its events.
        joining_names = names - self._names_being_read
        self._names_being_read |= names
        return joining_names, refused

    def _connect_topic(self, topic: Topic, subscription: BagSubscription) -> Iterable[RefusedConnection]:
        source = MessageSource(
            topic.caller, topic.type, topic.definition, topic.md5sum, topic.latched, format=topic.format
        )
        receiver = subscription.connect(source)
        if receiver.error:
            # Transforms are only a part of what the program reads, and a bag may have none.
            return [] if receiver.reads_transforms else [RefusedConnection(topic, receiver.error)]
        subscription.publisher_names.append(topic.caller)
        receivers = (*self.receivers[id(topic)], receiver)
        # Transforms must be stored before the event of their message is processed.
        self.receivers[id(topic)] = tuple(sorted(receivers, key=lambda each: not each.reads_transforms))
        return []

    def has_transforms(self) -> bool:
        """Return whether the present bag has transforms that the program reads."""
        return any(
            receiver.reads_transforms for receivers in self.receivers.values() for receiver in receivers
        )


def list_topic_names(bag: Bag) -> List[str]:
    """Return the names of a bag's topics, including those that it cannot read, about which it warns itself."""
    return [topic.name for topic in bag.topics] + [topic.name for topic in bag.unreadable]
