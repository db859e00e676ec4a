"""The interface between a running program and a middleware.

A `ProgramHost` runs a program on any object that implements `Transport`: rospy, rclpy, or the memory of a test. The
interface consists of what these have in common: serialized messages with the type of their publisher, names, time,
parameters, services, discovery and shutdown. The page ``docs/explanation/transports.md`` describes what rospy and
rclpy offer for each method. `MessageTransport` is the part of it that a
`RunningProgram` needs, and that a bag implements too.

All methods may be called from any thread. A transport calls back in threads of its own, also before the method that
registers the function has returned, but never while it holds a lock that its methods need. Calls for different
sources, timers and requests may overlap; the calls for one source may not. Topics are named by their full names, as
`Transport.resolve_topic` returns them.
"""

from typing import (
    AbstractSet,
    Any,
    Callable,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Set,
    Tuple,
)

from ..engine.redelivered_messages import MessageIdentity
from ..engine.service_calls import ServiceCall
from ..events.knowledge.transform_buffer import TransformBuffer
from ..events.program.topic_configuration import ANY_QUALITY, QualityOfService
from ..messages.type_definition import Definition, SerializationFormat
from ..messages.type_registry import InstalledTypes


class MessageSource(NamedTuple):
    """A publisher of a subscribed topic, or all of them if the middleware does not tell them apart.

    Without text and checksum, the messages have the type as it is known on this machine; ``MessageSource("/camera")``
    suffices. A source with a text names the type, too.

    Attributes:
        node: full name of the publishing node; "" if unknown.
        message_type: type of its messages, ``package/Type``; ``*`` if unknown.
        definition: text of the definition with its nested types; "" if unknown.
        md5sum: checksum of the type in ROS 1; "" if unknown.
        is_latched: whether it sends its last message to each new subscriber.
        address: identifies the process of the node; "" if unknown.
    """

    node: str
    message_type: str = "*"
    definition: str = ""
    md5sum: str = ""
    is_latched: bool = False
    address: str = ""
    format: SerializationFormat = SerializationFormat.ROS1


class MessageReceiver(Protocol):
    """Receiver of the messages of one source.

    A transport calls `receive`, or `convert` if it passes the messages of all sources to the engine itself, in its
    own order.

    Attributes:
        error: the reason why all messages are dropped, for example their type; "" if they are not.
        reads_transforms: whether messages are converted to transforms, which the engine must store before it
            processes the events of the same messages.
    """

    error: str
    reads_transforms: bool

    def convert(self, message: bytes) -> Any:
        """Return the event of a message with its instant, or a list of them; None if it is dropped.

        Errors are reported here.
        """

    def receive(
        self,
        messages: List[bytes],
        received: Sequence[int] = (),
        identities: Sequence[MessageIdentity] = (),
    ) -> None:
        """Process serialized messages that were read together. Errors are reported here and not raised.

        The time between two calls shows whether the source waits for this node, which is a sign of lost messages.

        Args:
            messages: the messages, in the order of their reception.
            received: instants of the machine's clock at which the middleware has received them, in nanoseconds since
                the epoch, 0 if unknown; empty if the middleware does not tell.
            identities: what tells the messages apart from others of the topic, if the middleware may deliver them
                again after a restart of this node; a message that a checkpoint contains is ignored.
        """

    def record_lost(self, count: int) -> None:
        """Record that the transport has lost messages of the source, if it knows. They are counted and reported."""

    def close(self, is_incomplete: bool) -> None:
        """Record that the source has ended its connection, within a message if it is incomplete.

        This follows the last call of `receive`. It is not needed when the node ends or the subscription is closed.
        """


Connect = Callable[[MessageSource], MessageReceiver]
"""Called for each new source of a topic; returns the receiver of its messages.

It raises no errors. The receiver of a source that is refused drops, counts and reports its messages.
"""


class TopicSubscription(Protocol):
    """A subscribed topic."""

    def publisher_count(self) -> int:
        """Return the number of connected publishers."""

    def publishers(self) -> List[str]:
        """Return the names of the connected publishers, as far as they are known."""

    def close(self) -> None:
        """End the subscription. A message that is being processed may still arrive; the receivers are not closed."""


class TopicPublication(Protocol):
    """An advertised topic, which lasts until the node ends."""

    @property
    def sent(self) -> int:
        """Number of published messages, with or without subscribers."""

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped for a slow subscriber, counted for each subscriber."""

    def subscriber_count(self) -> int:
        """Return the number of connected subscribers, or 1 if it is unknown: with 0 no texts are written for them."""

    def send(self, message: bytes) -> None:
        """Publish a serialized message, without waiting for subscribers. After the end of the node it is ignored."""


class Mismatch(NamedTuple):
    """A publisher and a subscriber of one topic that cannot connect.

    Attributes:
        topic: full name of the topic.
        publisher: full name of the publishing node.
        subscriber: full name of the subscribing node.
        reason: the publisher and the reason, as text.
    """

    topic: str
    publisher: str
    subscriber: str
    reason: str


class GraphChange(NamedTuple):
    """A change of the graph; the slots of ``msg/GraphChange.msg``.

    Attributes:
        kind: what has changed; see the message.
        node: full name of the node; "" if the change is not one of a single node.
        name: full name of the topic, name of the parameter, or state of the life cycle; "" if the change is one of a
            node.
        detail: further facts, as text.
    """

    kind: str
    node: str = ""
    name: str = ""
    detail: str = ""


class NodeGraph(NamedTuple):
    """Nodes with their topics and services.

    Attributes:
        types: message type of each published topic, ``package/Type``.
        publishers: names of the nodes that publish each topic, this node included.
        servers: names of the nodes that offer each service, this node included.
        subscribers: names of the nodes that subscribe to each topic, this node included.
        nodes: names of nodes that may have neither topics nor services.
        mismatches: publishers and subscribers that cannot connect.
    """

    types: Mapping[str, str]
    publishers: Mapping[str, Set[str]]
    servers: Mapping[str, Set[str]]
    subscribers: Mapping[str, Set[str]] = {}
    nodes: AbstractSet[str] = frozenset()
    mismatches: Sequence[Mismatch] = ()


class MessageTransport(Protocol):
    """Topics as a running program sees them.

    Attributes:
        format: serialization of the messages that are published; sources state that of theirs.
        received_formats: serializations that sources may have. ROS 1 and ROS 2 have different topics for actions.
    """

    format: SerializationFormat
    received_formats: Tuple[SerializationFormat, ...]

    def now(self) -> int:
        """Return the time in nanoseconds since the epoch; 0 while simulated time is unknown."""

    def resolve_topic(self, topic: str) -> str:
        """Return the full name of a topic, after remapping and in the node's namespace.

        Raises:
            UsageError: if the name is invalid.
        """

    def subscribe(
        self,
        topic: str,
        message_type: str,
        connect: Connect,
        queue_size: int,
        max_delay: float = 0.0,
        ignores_own: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> TopicSubscription:
        """Subscribe to a topic.

        Args:
            topic: full name of the topic.
            message_type: expected type. Sources with other types are connected too, and it is ``connect`` that
                accepts or refuses them.
            connect: returns the receiver of each source's messages.
            queue_size: number of messages to queue, if the transport has a queue; beyond it, the oldest are dropped.
            max_delay: seconds for which a message of a fast topic may wait for the next ones; may be ignored.
            ignores_own: whether messages of this node are not received.
            quality: what the program demands; ignored by middlewares that have no quality of service.
        """

    def advertise(
        self,
        topic: str,
        definition: Definition,
        queue_size: int,
        is_latched: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> TopicPublication:
        """Publish a topic.

        If subscribers that exist already connect only some time after this call, the transport stores the first
        messages for some seconds until then.

        Args:
            topic: full name of the topic.
            definition: type of its messages.
            queue_size: number of messages to queue for one subscriber; beyond it, the oldest are dropped.
            is_latched: whether each new subscriber receives the last message.
            quality: what the program demands; see `subscribe`.
        """

    def is_shut_down(self) -> bool:
        """Return whether the node has ended or is ending."""


class Transport(MessageTransport, Protocol):
    """A middleware as a node sees it.

    Attributes:
        node_name: full name of this node.
        is_time_simulated: whether time comes from messages, and may stand still or go back; read at the start.
        create_transform_buffer: creates the buffer of transforms, given the length of its history in seconds;
            `TransformBuffer` itself needs no other package.
    """

    node_name: str
    is_time_simulated: bool
    create_transform_buffer: Callable[[float], TransformBuffer]

    def on_clock(self, callback: Callable[[int], object]) -> None:
        """Call a function with each new instant of simulated time in ns, after `now` returns it.

        The calls do not overlap. Nothing is to be done for time that is not simulated.
        """

    def call_later(self, delay: int, callback: Callable[[], object]) -> Callable[[], object]:
        """Call a function once, after ``delay`` nanoseconds of the transport's time.

        A delay that is not positive means as soon as possible. If simulated time goes back, the function may be
        called early or late: it reads the time itself.

        Returns:
            A function that cancels the call, if it has not begun.
        """

    def parameters(self) -> Dict[str, Any]:
        """Return the node's own parameters by name, without ``~``, as plain values, lists and dictionaries."""

    def refresh_ros_parameters(self) -> None:
        """Read the parameters that `ros_parameter` returns from now on; may wait for other processes.

        Called before the program is loaded and before each reload. Later changes of these parameters are followed
        where the middleware reports them.

        Raises:
            RetalisError: if they cannot be read; the previous ones stay.
        """

    def ros_parameter(self, name: str) -> Any:
        """Return the last known value of a parameter for a goal, without waiting.

        Args:
            name: name as written in the goal; ``~name`` belongs to the node.

        Raises:
            KeyError: if there is no such parameter.
        """

    def installed_types(self, include_rosbags: bool = True) -> InstalledTypes:
        """Return the message types of this machine: ``InstalledTypes(include_rosbags=include_rosbags)`` in general.

        Args:
            include_rosbags: whether types that only the package ``rosbags`` has are included.
        """

    def offer_service(
        self, name: str, service_type: str, handler: Callable[[Any], Mapping[str, Any]]
    ) -> None:
        """Offer a service of package ``retalis``.

        Args:
            name: name of the service, to be resolved as the middleware does; ``~name`` is in the namespace of the
                node.
            service_type: name of its type, such as ``List`` for ``srv/List.srv``.
            handler: returns the fields of the response to a request, and may wait for seconds. A request is an object
                with all fields of its type in ``__dict__``, also those that the caller has left out. In the response,
                missing fields are zero or empty, and nested messages are dictionaries. Times and durations are
                integers in nanoseconds in both. Errors of the caller are in the field ``result``; an exception is a
                bug of the handler.
        """

    def resolve_service(self, name: str) -> str:
        """Return the full name of a service, after remapping and in the node's namespace.

        Raises:
            UsageError: if the name is invalid.
        """

    def call_service(self, name: str, call: ServiceCall) -> None:
        """Call a service of another node. This does not wait, because it runs in the engine's turn.

        The transport ends the call by its method ``reply`` with the serialized response, or by ``fail`` if no node
        offers the service, its type differs, or its node reports an error. If the call ends otherwise, because its
        time is over, the transport releases what it holds for it (``on_end``).

        Args:
            name: full name of the service.
            call: the call, with the types and the serialized request.

        Raises:
            RetalisError: if it cannot be called now.
        """

    def graph(self) -> Optional[NodeGraph]:
        """Return the nodes with their topics and services; None if they cannot be found out now.

        Topics without publishers may be missing.
        """

    def watch_nodes(self, report: Callable[[GraphChange], object]) -> None:
        """Report changes of the parameters and life cycles of nodes from now on, if the middleware has these."""

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """Call a function when the node ends, after `is_shut_down` is true; timers may no longer fire then.

        The functions are called one after the other, in the order of their registration.
        """
