"""The transport of ROS 1: rospy, with its own reading and writing of connections."""

import time
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple, Type

import rosgraph
import rospkg
import rospy
from rosgraph_msgs.msg import Clock as ClockMessage
from rospy.exceptions import TransportException
from rospy.impl.paramserver import get_param_server_cache
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.tcpros_service import TCPROSServiceClient
from rospy.rostime import is_wallclock

from ..engine.runtime.problem_reports import Reports
from ..engine.service_calls import ServiceCall
from ..events.program.topic_configuration import ANY_QUALITY, QualityOfService
from ..foundation.bounded_caches import Cache
from ..foundation.displayed_text import shorten
from ..foundation.errors import RetalisError, UsageError
from ..foundation.ros_name_checks import topic_fault
from ..messages.type_definition import Definition, SerializationFormat, service_checksum
from ..messages.type_registry import InstalledTypes
from ..node.service_caller import CallThreads
from ..node.transport import Connect, GraphChange, MessageReceiver, MessageSource, NodeGraph
from .batched_socket_reader import read_in_batches, refuse_own_connection
from .connection_writer import TopicWriter, serialized_bytes, serialized_class
from .installed_message_classes import fill_message, installed_types, read_fields
from .master_watch import MASTER_ERRORS
from .publisher_startup_queue import StartupQueue, SubscriberWait
from .tf2_buffer import choose_buffer

if TYPE_CHECKING:
    from ..events.knowledge.transform_buffer import TransformBuffer

UNSET_CLOCK_WARNING_SECONDS = 5.0
"""Seconds without a message on ``/clock`` after which a warning is logged."""

MAX_CACHED_CONNECTIONS = 1000
"""Maximum number of connections of a topic whose receivers are cached."""

_LENGTH = Struct("<I")
"""Length of a message, which precedes it on a connection."""

_SOCKET_MARGIN_SECONDS = 1.0
"""Seconds by which the timeout of the socket exceeds the limit of a call of a service, which reports it."""

_NO_PROVIDER = "no provider"
"""Error of the master for a service that no node offers."""

_began = time.monotonic()


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


def ros_now() -> int:
    """Return ROS time in nanoseconds, simulated or not.

    This runs for each event. rospy would create its object for wall time from a float, which takes ten times as long.
    """
    if is_wallclock():
        return time.time_ns()
    now = int(rospy.get_rostime().to_nsec())
    if not now and time.monotonic() > _began + UNSET_CLOCK_WARNING_SECONDS:
        rospy.logwarn_once(
            "/use_sim_time is true and nothing publishes /clock: time stands still, so no time passes "
            "between events, whatever a rule says of it; on a robot, start with use_sim_time:=false"
        )
    return now


class _CachedReceiver(NamedTuple):
    """A connection's header, and the receiver of its messages."""

    header: Dict[str, str]
    receiver: MessageReceiver


class RospySubscription:
    """A subscriber of rospy with a receiver for each connection; see `Transport.subscribe`."""

    def __init__(self, topic: str, connect: Connect, queue_size: int, max_delay: float, ignores_own: bool):
        self._connect = connect
        self._receivers: Cache[int, _CachedReceiver] = Cache(MAX_CACHED_CONNECTIONS, 16 << 20, 4 << 20)
        self._subscriber = rospy.Subscriber(
            topic, rospy.AnyMsg, self._receive, queue_size=queue_size, tcp_nodelay=True
        )
        read_in_batches(self._subscriber, self._find_handler, max_delay, self._record_end)
        if ignores_own:
            refuse_own_connection(self._subscriber)

    def publisher_count(self) -> int:
        """See `TopicSubscription`."""
        return int(self._subscriber.get_num_connections())

    def publishers(self) -> List[str]:
        """See `TopicSubscription`."""
        headers = [
            connection.header
            for connection in self._connections()
            if getattr(connection, "socket", None) is not None
        ]
        return [header["callerid"] for header in headers if header and "callerid" in header]

    def close(self) -> None:
        """See `TopicSubscription`."""
        self._subscriber.unregister()

    def _connections(self) -> Any:
        return getattr(getattr(self._subscriber, "impl", None), "connections", None) or ()

    def _receive(self, message: Any) -> None:
        """Process a message that rospy has read."""
        # rospy attaches the connection's header, the same object to each message. It has no public name.
        header = message._connection_header
        data = message._buff if message.__class__ is rospy.AnyMsg else serialized_bytes(message)
        self._find_handler(header)([data])

    def _find_handler(self, header: Dict[str, str]) -> Callable[[List[bytes]], object]:
        """Return the handler of a connection's messages."""
        # By identity: a comparison of the headers would cost more than the conversion of a small message.
        cached = self._receivers.get(id(header))
        if cached is None:
            # The cache holds the header, too: its identity is the key, and would be reused if it were freed.
            receiver = self._connect(self._make_source(header))
            size = sum(map(len, header.values()))
            cached = self._receivers.store(id(header), _CachedReceiver(header, receiver), 2 * size)
        return cached.receiver.receive

    def _make_source(self, header: Dict[str, str]) -> MessageSource:
        is_latched = header.get("latching") == "1"
        return MessageSource(
            header.get("callerid", ""),
            header.get("type", "*"),
            header.get("message_definition", ""),
            header.get("md5sum", ""),
            is_latched,
            self._find_address(header) if is_latched else "",
        )

    def _find_address(self, header: Dict[str, str]) -> str:
        """Return the XML-RPC address of a connection's publisher; "" if unknown."""
        return next(
            (
                str(connection.endpoint_id)
                for connection in self._connections()
                if connection.header is header
            ),
            "",
        )

    def _record_end(self, header: Dict[str, str], is_incomplete: bool) -> None:
        """Record that a publisher has closed its connection."""
        cached = self._receivers.get(id(header))
        if cached is not None:
            cached.receiver.close(is_incomplete)


class RospyPublication:
    """A topic that is written to the connections of rospy's publisher; see `Transport.advertise`.

    Args:
        topic_writer: writes to the connections.
        startup_queue: messages that wait for the first subscribers.
    """

    def __init__(self, topic_writer: TopicWriter, startup_queue: StartupQueue):
        self._topic_writer = topic_writer
        self._startup_queue = startup_queue

    @property
    def sent(self) -> int:
        """See `TopicPublication`."""
        return self._topic_writer.counts.sent

    @property
    def dropped(self) -> int:
        """See `TopicPublication`."""
        return self._topic_writer.counts.dropped

    def subscriber_count(self) -> int:
        """See `TopicPublication`."""
        return len(self._topic_writer.connections())

    def send(self, message: bytes) -> None:
        """See `TopicPublication`."""
        self._startup_queue.send(_LENGTH.pack(len(message)) + message)


def call_service(name: str, call: ServiceCall) -> None:
    """Call a service and wait for its response, or for the end of the call; see `Transport.call_service`.

    `rospy.ServiceProxy` waits for the response without a limit. Here the connection is closed when the call ends
    otherwise, which ends the wait. Each call has a thread, because it waits for the master, the server and the
    response.
    """
    try:
        uri = rosgraph.Master(rospy.get_name()).lookupService(name)
        address, port = rospy.core.parse_rosrpc_uri(uri)
    except rosgraph.MasterError as error:
        if _NO_PROVIDER in str(error):
            call.fail("no node offers it")
        else:
            call.fail(f"the master reports an error: {shorten(str(error))}")
        return
    except (*MASTER_ERRORS, rospy.exceptions.ROSException) as error:
        call.fail(f"the master does not answer: {shorten(str(error))}")
        return
    # The master may have answered after the time limit: the program no longer expects the service to act.
    if call.is_ended:
        return
    connection = TCPROSTransport(TCPROSServiceClient(name, _make_service_class(call)), name)
    call.on_end(connection.close)
    try:
        connection.connect(address, port, uri, call.request.seconds + _SOCKET_MARGIN_SECONDS)
        request = serialized_class(call.request.request)()
        request._buff = call.request.data
        if call.is_ended:
            # `on_end` may have closed it before it was open.
            connection.close()
            return
        connection.send_message(request, 1)
        call.reply(connection.receive_once()[0]._buff)
    except rospy.ServiceException as error:
        _, _, text = str(error).partition("responded with an error: ")
        call.fail(f"its node reports an error: {shorten(_decode(text or str(error)))}")
    except TransportException as error:
        if "md5sum" in str(error):
            call.fail(f"it has another type than {call.request.type}")
        else:
            call.fail(f"the connection to its node ends: {shorten(str(error))}")
    except (OSError, AttributeError) as error:
        # `close` of a call that has ended sets the attributes of the connection to None.
        call.fail(f"the connection to its node ends: {shorten(str(error))}")


def _decode(text: str) -> str:
    """Return the text of an error, which rospy shows as bytes."""
    return text[2:-1] if text[:2] in ("b'", 'b"') else text


def _make_service_class(call: ServiceCall) -> Type[object]:
    """Return a class with which rospy passes serialized requests and responses of a service."""
    request_class, response_class = map(serialized_class, (call.request.request, call.request.response))
    members = {
        "_type": call.request.type,
        "_md5sum": service_checksum(call.request.request, call.request.response),
        "_request_class": request_class,
        "_response_class": response_class,
    }
    return type("SerializedService", (), members)


class RospyTransport:
    """rospy as a transport; see `Transport`. The node must have been initialized.

    Args:
        reports: receives the warnings about single messages that are not sent.

    Attributes:
        format: serialization of published messages.
        received_formats: that of received messages, which is the same.
        node_name: full name of this node.
        is_time_simulated: whether time comes from ``/clock``.
        create_transform_buffer: creates the buffer of transforms: tf2's, if it is installed.
    """

    def __init__(self, reports: Reports):
        self.format = SerializationFormat.ROS1
        self.received_formats: Tuple[SerializationFormat, ...] = (self.format,)
        self._reports = reports
        self._subscriber_wait = SubscriberWait(reports)
        self._call_threads = CallThreads()
        self._clock_subscribers: List[rospy.Subscriber] = []
        self.node_name = str(rospy.get_name())
        self.is_time_simulated = not is_wallclock()
        self.create_transform_buffer: Callable[[float], TransformBuffer] = choose_buffer()

    def now(self) -> int:
        """See `Transport`."""
        return ros_now()

    def on_clock(self, callback: Callable[[int], object]) -> None:
        """See `Transport`."""
        # rospy itself subscribes to /clock. Its callback is registered earlier and runs in the same thread, so
        # rospy's time has been updated when this callback runs.
        self._clock_subscribers.append(
            rospy.Subscriber("/clock", ClockMessage, lambda message: callback(message.clock.to_nsec()))
        )

    def call_later(self, delay: int, callback: Callable[[], object]) -> Callable[[], object]:
        """See `Transport`."""
        timer = rospy.Timer(rospy.Duration(0, delay), lambda event: callback(), oneshot=True, reset=True)
        cancel: Callable[[], object] = timer.shutdown
        return cancel

    def parameters(self) -> Dict[str, Any]:
        """See `Transport`."""
        return dict(rospy.get_param("~", {}))

    def refresh_ros_parameters(self) -> None:
        """See `Transport`. The master reports changes and deletions of the parameters that exist now."""
        master = rosgraph.Master(self.node_name)
        try:
            parameters = master.subscribeParam(rospy.get_node_uri(), "/")
        except MASTER_ERRORS as error:
            raise UsageError(f"the parameters of the master cannot be read: {shorten(str(error))}") from error
        # The cache in which rospy stores the changes that the master reports.
        get_param_server_cache().set("/", parameters)

    def ros_parameter(self, name: str) -> Any:
        """See `Transport`."""
        return get_param_server_cache().get(rospy.resolve_name(name))

    def resolve_topic(self, topic: str) -> str:
        """See `Transport`."""
        return resolve(topic)

    def installed_types(self, include_rosbags: bool = True) -> InstalledTypes:
        """See `Transport`."""
        return installed_types(include_rosbags)

    def subscribe(
        self,
        topic: str,
        message_type: str,
        connect: Connect,
        queue_size: int,
        max_delay: float = 0.0,
        ignores_own: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> RospySubscription:
        """See `Transport`."""
        try:
            return RospySubscription(topic, connect, queue_size, max_delay, ignores_own)
        except rospy.ROSException as error:
            # The node is being shut down.
            raise RetalisError(f"topic {shorten(topic)}: {error}") from error

    def advertise(
        self,
        topic: str,
        definition: Definition,
        queue_size: int,
        is_latched: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> RospyPublication:
        """See `Transport`."""
        topic_writer = TopicWriter(
            topic, serialized_class(definition), queue_size, self._reports, latched=is_latched
        )
        startup_queue = StartupQueue(topic_writer, queue_size, self._reports)
        self._subscriber_wait.add(topic, startup_queue)
        return RospyPublication(topic_writer, startup_queue)

    def offer_service(
        self, name: str, service_type: str, handler: Callable[[Any], Mapping[str, Any]]
    ) -> None:
        """See `Transport`."""
        from .. import srv  # noqa: PLC0415 - generated when the package is built

        service_class = getattr(srv, service_type)
        create_response = getattr(srv, f"{service_type}Response")

        def handle(request: Any) -> Any:
            return fill_message(create_response(), handler(read_fields(request)))

        rospy.Service(name, service_class, handle)

    def resolve_service(self, name: str) -> str:
        """See `Transport`. Names of services are resolved as those of topics."""
        return resolve(name)

    def call_service(self, name: str, call: ServiceCall) -> None:
        """See `Transport`."""
        self._call_threads.start(call_service, name, call)

    def graph(self) -> Optional[NodeGraph]:
        """See `Transport`."""
        master = rosgraph.Master(self.node_name)
        try:
            published, subscribed, services = master.getSystemState()
            types = dict(master.getTopicTypes())
        except MASTER_ERRORS:
            # Reported by `MasterWatch`.
            return None
        publishers = {topic: set(nodes) for topic, nodes in published}
        return NodeGraph(
            {topic: message_type for topic, message_type in types.items() if topic in publishers},
            publishers,
            {service: set(nodes) for service, nodes in services},
            {topic: set(nodes) for topic, nodes in subscribed},
        )

    def watch_nodes(self, report: Callable[[GraphChange], object]) -> None:
        """Do nothing: nodes have no life cycle, and the parameters of the master are read at the start."""

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """See `Transport`."""
        rospy.on_shutdown(callback)

    def is_shut_down(self) -> bool:
        """See `Transport`."""
        return bool(rospy.is_shutdown())


def find_default_program(arguments: List[str]) -> Path:
    """Return the folder of the program if no parameter names it.

    Args:
        arguments: the command line with its program. Its first argument, if there is one, is the folder of a package
            that has the program in its folder ``application_source``; otherwise this package is taken.

    Raises:
        UsageError: if the package is unknown.
    """
    arguments = rospy.myargv(arguments)
    if len(arguments) > 1:
        return Path(arguments[1]) / "application_source"
    try:
        return Path(rospkg.RosPack().get_path("retalis")) / "application_source"
    except rospkg.ResourceNotFound:
        raise UsageError(
            "package retalis is not on ROS_PACKAGE_PATH: give its folder as argument, or the program's as ~program"
        ) from None
