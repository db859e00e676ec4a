"""The transport of ROS 2: rclpy, with its own reading of messages and its own timers."""

import threading
import time
from contextlib import suppress
from queue import SimpleQueue
from typing import Any, Callable, Dict, List, Mapping, Optional, Set

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import InvalidHandle, InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from ..engine.runtime.problem_reports import Reports
from ..events.knowledge.transform_buffer import TransformBuffer
from ..events.program.topic_configuration import ANY_QUALITY, QualityOfService
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, RetalisError, UsageError, shorten
from ..foundation.ros_name_checks import ros1_type_name, topic_fault
from ..messages.type_definition import VARIABLE_LENGTH, Definition, Field, SerializationFormat
from ..messages.type_registry import Definitions, InstalledTypes
from ..node.parameters import PARAMETER_DESCRIPTIONS
from ..node.transport import Connect, Mismatch, NodeGraph
from .installed_interfaces import InstalledInterfaces
from .message_intake import MessageIntake
from .node_executor import MAX_WAIT_SECONDS
from .quality_of_service import choose_published_quality, find_mismatches, full_node_name, join_node_name
from .ros_clock import RosClock
from .service_messages import fill_message, read_fields
from .timers import ScheduledCall, TransportTimers
from .topic_publication import OwnMessages, RclpyPublication
from .topic_subscription import RclpySubscription, TopicOptions

CLOCK_TOPIC = "/clock"
CLOCK_TYPE = "rosgraph_msgs/Clock"

MAX_CONCURRENT_REQUESTS = 64
"""Number of service requests that are handled at the same time; synchronized queries wait for seconds."""

MAX_DEPTH = 1000
"""Largest number of messages that the middleware stores for a topic, if the program does not demand a number."""

MAX_LARGE_DEPTH = 50
"""Largest number for types with arrays of bytes, such as images and point clouds, which may have megabytes."""

AUTOSTART = "autostart"
"""Parameter: whether the node activates itself."""

NODE_PARAMETERS = (AUTOSTART, "use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters of the node itself, and of rclpy."""


class RclpyTransport:
    """rclpy as a transport; see `Transport`.

    Callbacks run in four kinds of threads: one reads messages, one calls timers, one is that of the executor, and
    each service request has one of its own, because it may wait.

    Args:
        node: the node.
        executor: runs the callbacks of the node.
        reports: receives errors and warnings of single messages.

    Attributes:
        format: serialization of published messages.
        node_name: full name of this node.
        is_time_simulated: whether time comes from ``/clock``.
        create_transform_buffer: creates the buffer of transforms.
    """

    def __init__(self, node: Node, executor: SingleThreadedExecutor, reports: Reports):
        self.format = SerializationFormat.CDR
        self.node_name = str(node.get_fully_qualified_name())
        self.create_transform_buffer: Callable[[float], TransformBuffer] = TransformBuffer
        self.is_time_simulated = bool(node.get_parameter("use_sim_time").value)
        self._node = node
        self._executor = executor
        self._reports = reports
        self._interfaces = InstalledInterfaces()
        self._definitions = Definitions(self._interfaces)
        self._resolved: Cache[str, str] = Cache(1000, 1 << 20)
        self._clock = RosClock(self.is_time_simulated)
        self._timers = TransportTimers(self._clock.now, self.is_time_simulated, reports.error)
        # For the transport itself: the clock of the machine may be set, and the engine may run in the other one.
        self._own_timers = TransportTimers(time.monotonic_ns, False, reports.error)
        self._intake = MessageIntake(node, reports.error)
        self._requests = RequestThreads()
        # Of its own: a request that waits would block the other callbacks of the node's group.
        self._service_group = ReentrantCallbackGroup()
        self._own_messages: Dict[str, OwnMessages] = {}
        self._publications: List[RclpyPublication] = []
        self._services: List[Any] = []
        self._shutdown_callbacks: List[Callable[[], object]] = []
        self._is_shut_down = False
        if self.is_time_simulated:
            self._clock.on_tick(lambda now: self._timers.notify())
            self._subscribe_clock()

    # ---- time

    def now(self) -> int:
        """See `Transport`."""
        return self._clock.now()

    def on_clock(self, callback: Callable[[int], object]) -> None:
        """See `Transport`."""
        self._clock.on_tick(callback)

    def call_later(self, delay: int, callback: Callable[[], object]) -> ScheduledCall:
        """See `Transport`."""
        return self._timers.call_later(delay, callback)

    def _subscribe_clock(self) -> None:
        self.subscribe(CLOCK_TOPIC, CLOCK_TYPE, lambda source: _ClockReceiver(self._clock), queue_size=10)

    # ---- names and types

    def resolve_topic(self, topic: str) -> str:
        """See `Transport`."""
        # Called for each output.
        resolved = self._resolved.get(topic)
        return (
            self._resolved.store(topic, self._resolve(topic), 2 * len(topic))
            if resolved is None
            else resolved
        )

    def _resolve(self, topic: str) -> str:
        topic = topic.strip()
        fault = topic_fault(topic)
        if fault is not None or not topic.strip("/"):
            raise UsageError(fault or f'"{topic}" is not a topic name')
        try:
            return str(self._node.resolve_topic_name(_private_name(topic)))
        except (RuntimeError, ValueError, InvalidTopicNameException) as error:
            reason = str(error).partition("\n")[0].partition(", at ")[0]
            raise UsageError(f'"{topic}" is not a topic name of ROS 2: {reason}') from error

    def installed_types(self, include_rosbags: bool = True) -> InstalledTypes:
        """See `Transport`. The types of rosbags are those of ROS 1, and are never included."""
        return self._interfaces

    def parameters(self) -> Dict[str, Any]:
        """See `Transport`."""
        return read_node_parameters(self._node)

    # ---- topics

    def subscribe(
        self,
        topic: str,
        message_type: str,
        connect: Connect,
        queue_size: int,
        max_delay: float = 0.0,
        ignores_own: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> RclpySubscription:
        """See `Transport`."""
        message_class = self._interfaces.message_class(message_type)
        is_own = self._own_messages.setdefault(topic, OwnMessages()).take if ignores_own else None
        depth = quality.depth or min(queue_size, self._max_depth(message_type))
        options = TopicOptions(topic, message_type, message_class, quality._replace(depth=depth), is_own)
        try:
            return RclpySubscription(
                self._node,
                self._intake,
                options,
                connect,
                self._own_timers.call_later,
                self._warn_of_change,
            )
        except RuntimeError as error:
            raise self._make_error(topic, error) from error

    def advertise(
        self,
        topic: str,
        definition: Definition,
        queue_size: int,
        is_latched: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> RclpyPublication:
        """See `Transport`."""
        message_class = self._interfaces.message_class(definition.name)
        try:
            publication = RclpyPublication(
                self._node,
                message_class,
                topic,
                choose_published_quality(quality, is_latched, min(queue_size, MAX_DEPTH)),
                lambda: self._own_messages.get(topic),
                self._own_timers.call_later,
            )
        except RuntimeError as error:
            raise self._make_error(topic, error) from error
        self._publications.append(publication)
        return publication

    def _max_depth(self, message_type: str) -> int:
        """Return the largest number of messages that the middleware may store for a subscription."""
        fields = self._definitions.find(message_type).fields
        return MAX_LARGE_DEPTH if any(map(_is_byte_array, fields)) else MAX_DEPTH

    def _warn_of_change(self, text: str) -> None:
        self._reports.warning(text)

    def _make_error(self, topic: str, error: Exception) -> RetalisError:
        """Return the error of a topic that exists with another type, or whose node is being shut down."""
        return MessageError(f"topic {shorten(topic)}: {str(error).partition(', at ')[0]}")

    # ---- services

    def offer_service(
        self, name: str, service_type: str, handler: Callable[[Any], Mapping[str, Any]]
    ) -> None:
        """See `Transport`."""
        from .. import srv  # noqa: PLC0415 - generated when the package is built

        service_class = getattr(srv, service_type)

        def answer(request: Any, response: Any) -> None:
            try:
                fill_message(response, handler(read_fields(request)))
            except Exception as error:
                self._reports.error(error)
                response.result = "error: internal error; the log of the node has the details"

        async def handle(request: Any, response: Any) -> Any:
            await self._run_in_thread(lambda: answer(request, response))
            return response

        self._services.append(
            self._node.create_service(
                service_class, _private_name(name), handle, callback_group=self._service_group
            )
        )

    def _run_in_thread(self, function: Callable[[], object]) -> Future:
        """Return a future that is done when a function has ended, which may wait and raises no errors."""
        future = Future(executor=self._executor)

        def run() -> None:
            function()
            # The executor may have ended meanwhile.
            with suppress(InvalidHandle, AttributeError):
                future.set_result(None)
                # A future does not do so in all versions of rclpy.
                self._executor.wake()

        self._requests.submit(run)
        return future

    # ---- graph

    def graph(self) -> Optional[NodeGraph]:
        """See `Transport`."""
        try:
            return self._read_graph()
        except (RuntimeError, InvalidHandle):
            # The node is ending.
            return None

    def _read_graph(self) -> NodeGraph:
        node = self._node
        types: Dict[str, str] = {}
        publishers: Dict[str, Set[str]] = {}
        subscribers: Dict[str, Set[str]] = {}
        mismatches: List[Mismatch] = []
        for topic, topic_types in node.get_topic_names_and_types():
            published = node.get_publishers_info_by_topic(topic)
            subscribed = node.get_subscriptions_info_by_topic(topic)
            if published:
                types[topic] = ros1_type_name(topic_types[0])
                publishers[topic] = {full_node_name(endpoint) for endpoint in published} - {""}
            subscribers[topic] = {full_node_name(endpoint) for endpoint in subscribed} - {""}
            mismatches += find_mismatches(topic, published, subscribed)
        servers: Dict[str, Set[str]] = {}
        nodes: Set[str] = set()
        for name, namespace in node.get_node_names_and_namespaces():
            full_name = join_node_name(namespace, name)
            if not full_name:
                continue
            nodes.add(full_name)
            try:
                services = node.get_service_names_and_types_by_node(name, namespace)
            except RuntimeError:
                # The node has ended meanwhile.
                continue
            for service, _ in services:
                servers.setdefault(service, set()).add(full_name)
        return NodeGraph(types, publishers, servers, subscribers, nodes, mismatches)

    # ---- shutdown

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """See `Transport`."""
        self._shutdown_callbacks.append(callback)

    def is_shut_down(self) -> bool:
        """See `Transport`."""
        return self._is_shut_down or not self._node.context.ok()

    def shut_down(self) -> None:
        """End the topics, services and timers of the node; the node itself goes on."""
        self._is_shut_down = True
        self._intake.stop()
        for timers in (self._timers, self._own_timers):
            timers.stop()
            timers.join(MAX_WAIT_SECONDS)
        for end in [*self._shutdown_callbacks, *(publication.end for publication in self._publications)]:
            try:
                end()
            except Exception as error:
                self._reports.error(error)
        self._requests.stop()
        for service in self._services:
            self._node.destroy_service(service)


class RequestThreads:
    """Threads that call functions, each started when all others are busy, at most `MAX_CONCURRENT_REQUESTS`.

    They do not keep the process from ending, as those of `concurrent.futures` would.
    """

    def __init__(self) -> None:
        # None ends a thread.
        self._functions: SimpleQueue[Optional[Callable[[], object]]] = SimpleQueue()
        self._lock = threading.Lock()
        self._thread_count = 0
        self._free_count = 0

    def submit(self, function: Callable[[], object]) -> None:
        """Call a function, which raises no errors, as soon as a thread is free."""
        with self._lock:
            self._free_count -= 1
            if self._free_count < 0 and self._thread_count < MAX_CONCURRENT_REQUESTS:
                self._thread_count += 1
                threading.Thread(target=self._run, daemon=True, name="request").start()
        self._functions.put(function)

    def _run(self) -> None:
        while True:
            with self._lock:
                self._free_count += 1
            function = self._functions.get()
            if function is None:
                return
            function()

    def stop(self) -> None:
        """End the threads when they have called their functions."""
        for _ in range(self._thread_count):
            self._functions.put(None)


class _ClockReceiver:
    """Receiver of the messages on ``/clock``; see `MessageReceiver`."""

    error = ""
    reads_transforms = False

    def __init__(self, clock: RosClock):
        self._clock = clock

    def convert(self, message: bytes) -> None:
        self._clock.set_from(message)

    def receive(self, messages: List[bytes]) -> None:
        for message in messages:
            self._clock.set_from(message)

    def record_lost(self, count: int) -> None:
        """Do nothing: the next message has the time, too."""

    def close(self, is_incomplete: bool) -> None:
        """Do nothing."""


def _is_byte_array(field: Field) -> bool:
    return field.is_bytes and field.length == VARIABLE_LENGTH


def declare_parameters(node: Node) -> None:
    """Declare the parameters of the package with their descriptions; they are read when the node starts.

    Those that are not given have no value. Parameters with other names stay as they are.
    """
    if not node.has_parameter(AUTOSTART):
        node.declare_parameter(
            AUTOSTART, True, ParameterDescriptor(description="Whether the node activates itself")
        )
    for name, description in PARAMETER_DESCRIPTIONS.items():
        descriptor = ParameterDescriptor(
            name=name, description=description, read_only=True, dynamic_typing=True
        )
        if node.has_parameter(name):
            node.set_descriptor(name, descriptor)
        else:
            node.declare_parameter(name, None, descriptor)


def read_node_parameters(node: Node) -> Dict[str, Any]:
    """Return the parameters of a node as plain values, lists and nested dictionaries."""
    values: Dict[str, Any] = {}
    for name, parameter in node.get_parameters_by_prefix("").items():
        *path, last = name.split(".")
        if (path or [last])[0] in NODE_PARAMETERS or parameter.value is None:
            continue
        target = values
        for part in path:
            target = target.setdefault(part, {})
            if not isinstance(target, dict):
                raise UsageError(f"parameter ~{part}: expected a value or a group of parameters, found both")
        value = parameter.value
        is_text = isinstance(value, (str, bytes))
        target[last] = list(value) if hasattr(value, "__len__") and not is_text else value
    return values


def _private_name(name: str) -> str:
    """Return a name with the form that ROS 2 has for names in the namespace of the node: ``~/name`` for ``~name``."""
    return f"~/{name[1:]}" if name[:1] == "~" and name[1:2] not in ("/", "") else name
