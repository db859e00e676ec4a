"""The transport of ROS 2: rclpy, with its own reading of messages and its own timers."""

import threading
import time
from contextlib import suppress
from queue import SimpleQueue
from typing import Any, Callable, Dict, List, Mapping, Optional, Set, Tuple

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import InvalidHandle, InvalidServiceNameException, InvalidTopicNameException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from ..engine.runtime.problem_reports import Reports
from ..engine.service_calls import ServiceCall
from ..events.knowledge.transform_buffer import TransformBuffer
from ..events.program.topic_configuration import ANY_QUALITY, SERVICE_EVENTS, QualityOfService
from ..foundation.bounded_caches import Cache
from ..foundation.displayed_text import shorten
from ..foundation.errors import MessageError, RetalisError, UsageError
from ..foundation.ros_name_checks import ros1_type_name, topic_fault
from ..messages.type_definition import VARIABLE_LENGTH, Definition, Field, SerializationFormat
from ..messages.type_registry import Definitions, InstalledTypes
from ..node.parameters import FIXED_PARAMETERS, PARAMETER_DESCRIPTIONS
from ..node.service_caller import CallThreads
from ..node.transport import Connect, GraphChange, Mismatch, NodeGraph
from .installed_interfaces import InstalledInterfaces, fill_message, read_fields
from .message_intake import MessageIntake
from .parameter_and_lifecycle_watch import ParameterAndLifecycleWatch
from .quality_of_service import choose_published_quality, find_mismatches, full_node_name, join_node_name
from .rclpy_service_call import RclpyServiceCalls
from .ros_clock import CLOCK_TOPIC, CLOCK_TYPE, RosClock, replace_clock_subscription
from .timer_thread import TransportTimers
from .topic_publication import OwnMessages, RclpyPublication
from .topic_subscription import RclpySubscription, TopicOptions

MAX_CONCURRENT_REQUESTS = 64
"""Number of service requests that are handled at the same time; synchronized queries wait for seconds."""

MAX_WAITING_REQUESTS = 1000
"""Number of service requests that wait for one of these; further ones are answered with an error."""

MAX_DEPTH = 1000
"""Largest number of messages that the middleware stores for a topic, if the program does not demand a number."""

MAX_LARGE_DEPTH = 50
"""Largest number for types with arrays of bytes, such as images and point clouds, which may have megabytes."""

AUTOSTART = "autostart"
"""Parameter: whether the node activates itself."""

NODE_PARAMETERS = (AUTOSTART, "use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters of the node itself, and of rclpy; all are read at the start."""

MAX_WAIT_SECONDS = 1.0
"""Longest wait for each thread when the node ends."""


class RclpyTransport:
    """rclpy as a transport; see `Transport`.

    Callbacks run in four kinds of threads: one reads messages, one calls timers, one is that of the executor, and
    each service request has one of its own, because it may wait.

    Args:
        executor: runs the callbacks of the node.
        reports: receives errors and warnings of single messages.

    Attributes:
        format: serialization of published messages.
        received_formats: that of received messages, which is the same.
        node_name: full name of this node.
        is_time_simulated: whether time comes from ``/clock``.
    """

    def __init__(self, node: Node, executor: SingleThreadedExecutor, reports: Reports):
        self.format = SerializationFormat.CDR
        self.received_formats: Tuple[SerializationFormat, ...] = (self.format,)
        self.node_name = str(node.get_fully_qualified_name())
        self.create_transform_buffer: Callable[[float], TransformBuffer] = TransformBuffer
        self.is_time_simulated = bool(node.get_parameter("use_sim_time").value)
        self._node = node
        self._executor = executor
        self._reports = reports
        self._interfaces = InstalledInterfaces()
        self._definitions = Definitions(self._interfaces)
        self._resolved: Cache[str, str] = Cache(1000, 1 << 20)
        # rclpy may know the time already, and no further message may come while a simulation stands still.
        self._clock = RosClock(
            self.is_time_simulated, node.get_clock().now().nanoseconds if self.is_time_simulated else 0
        )
        self._timers = TransportTimers(self._clock.now, self.is_time_simulated, reports.error)
        # For the transport itself: the clock of the machine may be set, and the engine may run in the other one.
        self._own_timers = TransportTimers(time.monotonic_ns, False, reports.error)
        self._intake = MessageIntake(node, reports.error)
        self._requests = RequestThreads()
        # Of its own: a request that waits would block the other callbacks of the node's group.
        self._service_group = ReentrantCallbackGroup()
        self._service_calls = RclpyServiceCalls(node, self._interfaces, self._service_group)
        self._call_threads = CallThreads()
        self._own_messages: Dict[str, OwnMessages] = {}
        self._publications: List[RclpyPublication] = []
        self._services: List[Any] = []
        self._node_watches: List[ParameterAndLifecycleWatch] = []
        self._shutdown_lock = threading.Lock()
        self._shutdown_callbacks: List[Callable[[], object]] = []
        self._is_shut_down = False
        if self.is_time_simulated:
            self._clock.on_tick(lambda now: self._timers.notify())
            set_node_time = replace_clock_subscription(node)
            if set_node_time is not None:
                self._clock.on_tick(set_node_time)
            self.subscribe(CLOCK_TOPIC, CLOCK_TYPE, lambda source: _ClockReceiver(self._clock), queue_size=10)

    # ---- time

    def now(self) -> int:
        """See `Transport`."""
        return self._clock.now()

    def on_clock(self, callback: Callable[[int], object]) -> None:
        """See `Transport`."""
        self._clock.on_tick(callback)

    def call_later(self, delay: int, callback: Callable[[], object]) -> Callable[[], object]:
        """See `Transport`."""
        return self._timers.call_later(delay, callback).cancel

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
            if topic.endswith(SERVICE_EVENTS):
                # As in rcl, which resolves the name of the service by the rules for services, and then the topic's.
                service = _private_name(topic[: -len(SERVICE_EVENTS)])
                topic = f"{self._node.resolve_service_name(service)}{SERVICE_EVENTS}"
            return str(self._node.resolve_topic_name(_private_name(topic)))
        except (RuntimeError, ValueError, InvalidServiceNameException, InvalidTopicNameException) as error:
            reason = str(error).partition("\n")[0].partition(", at ")[0]
            raise UsageError(f'"{topic}" is not a topic name of ROS 2: {reason}') from error

    def installed_types(self, include_rosbags: bool = True) -> InstalledTypes:
        """See `Transport`. The types of rosbags are those of ROS 1, and are never included."""
        return self._interfaces

    def parameters(self) -> Dict[str, Any]:
        """See `Transport`."""
        return read_node_parameters(self._node)

    def refresh_ros_parameters(self) -> None:
        """Do nothing: the parameters of the node are known."""

    def ros_parameter(self, name: str) -> Any:
        """See `Transport`. The parameters are those of the node: ``a.b``, also written ``~a/b`` or ``/a/b``."""
        name = name.lstrip("~/").replace("/", ".")
        if self._node.has_parameter(name):
            value = plain_value(self._node.get_parameter(name))
            if value is not None:
                return value
        group = nest_parameters(self._node.get_parameters_by_prefix(name)) if name else {}
        if not group:
            raise KeyError(name)
        return group

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
            try:
                await self._requests.run(lambda: answer(request, response), self._executor)
            except UsageError as error:
                response.result = f"error: {error}"
            return response

        self._services.append(
            self._node.create_service(
                service_class, _private_name(name), handle, callback_group=self._service_group
            )
        )

    def resolve_service(self, name: str) -> str:
        """See `Transport`."""
        fault = topic_fault(name)
        if fault is not None:
            raise UsageError(fault)
        try:
            return str(self._node.resolve_service_name(_private_name(name)))
        except (RuntimeError, ValueError, InvalidServiceNameException) as error:
            reason = str(error).partition("\n")[0].partition(", at ")[0]
            raise UsageError(f'"{name}" is not a name of a service of ROS 2: {reason}') from error

    def call_service(self, name: str, call: ServiceCall) -> None:
        """See `Transport`."""
        # A new client may have to wait until its service is discovered.
        self._call_threads.start(self._service_calls.call_service, name, call)

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

    def watch_nodes(self, report: Callable[[GraphChange], object]) -> None:
        """See `Transport`."""
        self._node_watches.append(
            ParameterAndLifecycleWatch(self._node, report, self._reports.warning, self._own_timers.call_later)
        )

    # ---- shutdown

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """See `Transport`. After the end, the function is called at once: the end may interrupt the start."""
        with self._shutdown_lock:
            is_shut_down = self._is_shut_down
            if not is_shut_down:
                self._shutdown_callbacks.append(callback)
        if is_shut_down:
            callback()

    def is_shut_down(self) -> bool:
        """See `Transport`."""
        return self._is_shut_down or not self._node.context.ok()

    def shut_down(self) -> None:
        """End the topics, services and timers of the node; the node itself goes on."""
        with self._shutdown_lock:
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
        for watch in self._node_watches:
            watch.stop()
        for service in self._services:
            self._node.destroy_service(service)


class NodeExecutor:
    """A thread that runs the callbacks of a node: events, parameters, services and states of the life cycle.

    Args:
        on_error: receives exceptions of callbacks.
    """

    def __init__(self, node: Node, on_error: Callable[[Exception], object]):
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)
        self._context = node.context
        self._on_error = on_error
        self._is_stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True, name="executor")
        self._thread.start()

    def stop(self) -> None:
        """Run no more callbacks."""
        self._is_stopped = True
        self.executor.shutdown(timeout_sec=MAX_WAIT_SECONDS)
        self._thread.join(timeout=MAX_WAIT_SECONDS)

    def _run(self) -> None:
        while not self._is_stopped and self._context.ok():
            try:
                self.executor.spin()
            except ExternalShutdownException:
                return
            except Exception as error:
                # The failure of one callback must not end the others.
                if not self._is_stopped:
                    self._on_error(error)


class RequestThreads:
    """Threads that call functions, each started when all others are busy, at most `MAX_CONCURRENT_REQUESTS`.

    They do not keep the process from ending, as those of `concurrent.futures` would.
    """

    def __init__(self) -> None:
        # None ends a thread.
        self._functions: SimpleQueue[Optional[Callable[[], object]]] = SimpleQueue()
        self._lock = threading.Lock()
        self._thread_count = 0
        self._unfinished_count = 0

    def submit(self, function: Callable[[], object]) -> None:
        """Call a function, which raises no errors, as soon as a thread is free.

        Raises:
            UsageError: if too many functions are waiting.
        """
        with self._lock:
            if self._unfinished_count >= MAX_CONCURRENT_REQUESTS + MAX_WAITING_REQUESTS:
                raise UsageError(
                    f"{MAX_CONCURRENT_REQUESTS} requests are running and {MAX_WAITING_REQUESTS} are waiting: "
                    "send this one later"
                )
            self._unfinished_count += 1
            if self._thread_count < min(self._unfinished_count, MAX_CONCURRENT_REQUESTS):
                self._thread_count += 1
                threading.Thread(target=self._run, daemon=True, name="request").start()
        self._functions.put(function)

    def run(self, function: Callable[[], object], executor: Executor) -> Future:
        """Call a function as `submit` does; return a future with its end or error, which a callback can wait for.

        Raises:
            UsageError: see `submit`.
        """
        future = Future(executor=executor)

        def run() -> None:
            error: Optional[Exception] = None
            try:
                function()
            except Exception as raised:
                error = raised
            # The executor may have ended meanwhile.
            with suppress(InvalidHandle, AttributeError):
                if error is None:
                    future.set_result(None)
                else:
                    future.set_exception(error)
                # A future does not do so in all versions of rclpy.
                executor.wake()

        self.submit(run)
        return future

    def _run(self) -> None:
        while True:
            function = self._functions.get()
            if function is None:
                return
            try:
                function()
            except BaseException:
                # The error ends this thread, and another one may be started in its place.
                with self._lock:
                    self._thread_count -= 1
                raise
            finally:
                with self._lock:
                    self._unfinished_count -= 1

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

    def receive(self, messages: List[bytes], *_: object) -> None:
        for message in messages:
            self._clock.set_from(message)

    def record_lost(self, count: int) -> None:
        """Do nothing: the next message has the time, too."""

    def close(self, is_incomplete: bool) -> None:
        """Do nothing."""


def _is_byte_array(field: Field) -> bool:
    return field.is_bytes and field.length == VARIABLE_LENGTH


def declare_parameters(node: Node) -> None:
    """Declare the parameters of the package with their descriptions, and the reasons why some are read-only.

    Those that are not given have no value. Parameters with other names stay as they are.
    """
    if not node.has_parameter(AUTOSTART):
        node.declare_parameter(
            AUTOSTART, True, ParameterDescriptor(description="Whether the node activates itself")
        )
    for name, description in PARAMETER_DESCRIPTIONS.items():
        descriptor = ParameterDescriptor(
            name=name,
            description=description,
            additional_constraints=FIXED_PARAMETERS.get(name, ""),
            read_only=name in FIXED_PARAMETERS,
            dynamic_typing=True,
        )
        if node.has_parameter(name):
            node.set_descriptor(name, descriptor)
        else:
            node.declare_parameter(name, None, descriptor)


def read_node_parameters(node: Node) -> Dict[str, Any]:
    """Return the parameters of a node as plain values, lists and nested dictionaries, without `NODE_PARAMETERS`."""
    parameters = node.get_parameters_by_prefix("").items()
    return nest_parameters(
        {name: value for name, value in parameters if name.partition(".")[0] not in NODE_PARAMETERS}
    )


def nest_parameters(parameters: Mapping[str, Any]) -> Dict[str, Any]:
    """Return parameters that have a value as nested dictionaries; points in their names separate the groups.

    Raises:
        UsageError: if a parameter is both a value and a group.
    """
    values: Dict[str, Any] = {}
    for name, parameter in parameters.items():
        *path, last = name.split(".")
        if parameter.value is None:
            continue
        target = values
        for part in path:
            target = target.setdefault(part, {})
            if not isinstance(target, dict):
                raise UsageError(f"parameter ~{part}: expected a value or a group of parameters, found both")
        target[last] = plain_value(parameter)
    return values


def plain_value(parameter: Any) -> Any:
    """Return the value of a parameter of rclpy; arrays of all kinds as lists."""
    value = parameter.value
    return list(value) if hasattr(value, "__len__") and not isinstance(value, (str, bytes)) else value


def _private_name(name: str) -> str:
    """Return a name with the form that ROS 2 has for names in the namespace of the node: ``~/name`` for ``~name``."""
    return f"~/{name[1:]}" if name[:1] == "~" and name[1:2] not in ("/", "") else name
