"""Connection of commands to running nodes of ROS 2: two nodes of rclpy.

A hidden node calls services. A second node, which reads and writes topics, exists only if a command asks for it. Each
has an executor in a thread of its own, so that a receiver of texts that waits does not delay a service's response.

There is no master: nodes, with their topics and services, are discovered one after the other, mostly within a second.
"""

import os
import threading
from contextlib import suppress
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Callable, Dict, Mapping, Optional, Sequence, Set

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from .. import srv
from ..cli.node_client import CONNECTION_SECONDS, RunningNodes, find_engine_nodes
from ..events.program.topic_configuration import ANY_QUALITY, QualityOfService
from ..foundation.errors import MessageError, UsageError
from ..foundation.interrupts import interruptible
from ..messages.type_definition import Definition, SerializationFormat
from ..messages.type_registry import InstalledTypes
from ..node.text_exchange import TEXT_TYPE
from .installed_interfaces import InstalledInterfaces, fill_message, read_fields
from .quality_of_service import choose_published_quality, choose_quality, join_node_name, read_offers

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.node import Node

DISCOVERY_SECONDS = 4.0
"""Seconds after which a node that has not been discovered counts as missing; nodes announce themselves every 3 s."""

SETTLING_SECONDS = 0.3
"""Seconds without a change after which the known nodes, or the services of one node, count as complete."""

MAX_UNREAD_TEXTS = 1000
"""Number of texts that are queued for a receiver; beyond it, the oldest are dropped."""

_POLL_SECONDS = 0.02

_CHECK_SECONDS = 0.5
"""Seconds between two checks whether the node of a called service still exists."""

_MAX_END_SECONDS = 0.1
"""Time for which the end of the connection waits for each thread."""


class RclpyClient:
    """Connection to the nodes of a domain; see `ClientConnection`.

    Attributes:
        namespace: the root: ROS 2 has no namespace of a shell.
        scope: the domain, for errors.
        end_of_time: end of the signed seconds of ``builtin_interfaces/Time``.
        format: serialization of ROS 2.
    """

    end_of_time = 1 << 31
    format = SerializationFormat.CDR

    def __init__(self) -> None:
        self.namespace = "/"
        self._context = Context()
        # Without handlers of rclpy, signals interrupt this thread as in other commands.
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.scope = f" in domain {self._context.get_domain_id()} (ROS_DOMAIN_ID)"
        # Names that begin with an underscore are hidden in lists of nodes.
        self._caller = _SpinningNode(f"_retalis_{os.getpid()}", self._context)
        self._reader: Optional[_SpinningNode] = None
        self._clients: Dict[str, Client] = {}
        self._ends_at = monotonic() + DISCOVERY_SECONDS

    def resolve_node(self, name: str) -> str:
        """See `ClientConnection`."""
        return name if name.startswith("/") else f"/{name}"

    def limit_discovery(self, seconds: float) -> None:
        """See `ClientConnection`."""
        self._ends_at = min(self._ends_at, monotonic() + seconds)

    def find_nodes(self, requested_name: Optional[str] = None) -> RunningNodes:
        """See `ClientConnection`. This waits until no further nodes are discovered."""
        nodes, changed_at = self._read_graph(), monotonic()
        while monotonic() < self._ends_at:
            is_found = bool(find_engine_nodes(nodes.services)) and (
                requested_name is None or f"{requested_name}/list" in nodes.services
            )
            if is_found and monotonic() - changed_at > SETTLING_SECONDS:
                break
            with interruptible():
                sleep(_POLL_SECONDS)
            previous, nodes = nodes, self._read_graph()
            if nodes != previous:
                changed_at = monotonic()
        return nodes

    def _read_graph(self) -> RunningNodes:
        services: Dict[str, Set[str]] = {}
        publishers: Dict[str, Set[str]] = {}
        for name, namespace in self._caller.node.get_node_names_and_namespaces():
            full_name = join_node_name(namespace, name)
            try:
                offered = self._caller.node.get_service_names_and_types_by_node(name, namespace)
                published = self._caller.node.get_publisher_names_and_types_by_node(name, namespace)
            except RuntimeError:
                # The node has ended meanwhile, or its name is not known yet.
                continue
            for service, _ in offered:
                services.setdefault(service, set()).add(full_name)
            for topic, _ in published:
                publishers.setdefault(topic, set()).add(full_name)
        return RunningNodes(services, publishers, {})

    def call(self, service: str, service_type: str, fields: Mapping[str, Any], max_seconds: float) -> Any:
        """See `ClientConnection`."""
        service_class = getattr(srv, service_type)
        try:
            request = fill_message(service_class.Request(), fields)
        except (AssertionError, OverflowError, TypeError, ValueError) as error:
            raise UsageError(f"service {service}: the request is invalid: {error}") from error
        client = self._clients.get(service)
        if client is None:
            client = self._clients[service] = self._caller.node.create_client(service_class, service)
        if not _wait(client.service_is_ready, CONNECTION_SECONDS):
            raise UsageError(f"service {service} does not answer: no node offers it")
        future = client.call_async(request)
        answered = threading.Event()
        future.add_done_callback(lambda future: answered.set())
        end = monotonic() + max_seconds
        try:
            with interruptible():
                while not answered.wait(_CHECK_SECONDS):
                    if monotonic() > end:
                        raise UsageError(
                            f"service {service} does not answer: no response within {max_seconds:g} s"
                        )
                    if not client.service_is_ready():
                        raise UsageError(f"service {service} does not answer: its node has ended")
            return read_fields(future.result())
        finally:
            # Without a response, the client would keep the request until its own end.
            client.remove_pending_request(future)

    def start_node(self, name: str) -> None:
        """See `ClientConnection`."""
        self._reader = _SpinningNode(f"{name}_{os.getpid()}", self._context)

    def subscribe(self, topic: str, receive: Callable[[str], object]) -> None:
        """See `ClientConnection`. This returns when the publishers that are known are connected."""
        if self._reader is None:
            raise UsageError("subscribe: the node has not been started")
        node = self._reader.node
        offers = read_offers(node.get_publishers_info_by_topic(topic))
        quality = choose_quality(offers, QualityOfService(depth=MAX_UNREAD_TEXTS))
        message_class = InstalledInterfaces().message_class(TEXT_TYPE)
        subscription = node.create_subscription(
            message_class, topic, lambda message: receive(message.data), quality.profile()
        )
        _wait(lambda: subscription.get_publisher_count() >= node.count_publishers(topic), CONNECTION_SECONDS)

    def installed_types(self, extra_folders: Sequence[str]) -> InstalledTypes:
        """See `ClientConnection`. Only types whose classes are built can be published."""
        return InstalledInterfaces()

    def advertise(self, topic: str, definition: Definition) -> Callable[[bytes], object]:
        """See `ClientConnection`."""
        if self._reader is None:
            raise UsageError("advertise: the node has not been started")
        node = self._reader.node
        try:
            message_class = InstalledInterfaces().message_class(definition.name)
        except MessageError as error:
            raise UsageError(f"topic {topic}: {error.message}") from error
        quality = choose_published_quality(ANY_QUALITY, False, MAX_UNREAD_TEXTS)
        publisher = node.create_publisher(message_class, topic, quality.profile())

        def is_connected() -> bool:
            return bool(0 < node.count_subscribers(topic) <= publisher.get_subscription_count())

        if not _wait(is_connected, CONNECTION_SECONDS) and not publisher.get_subscription_count():
            raise UsageError(f"topic {topic}: no node subscribes to it")
        return lambda data: publisher.publish(data)

    def end(self) -> None:
        """See `ClientConnection`."""
        self._context.try_shutdown()
        for node in (self._reader, self._caller):
            if node is not None:
                node.end()


class _SpinningNode:
    """A node whose callbacks run in a thread."""

    def __init__(self, name: str, context: Context):
        self.node: Node = rclpy.create_node(
            name,
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True, name=name)
        self._thread.start()

    def end(self) -> None:
        """Destroy the node, whose context has been shut down."""
        self._thread.join(_MAX_END_SECONDS)
        if not self._thread.is_alive():
            # Otherwise a receiver waits, and the process ends with it.
            self._executor.shutdown(timeout_sec=0)
            self.node.destroy_node()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()


def _wait(condition: Callable[[], bool], seconds: float) -> bool:
    """Wait until a condition holds; return whether it does."""
    end = monotonic() + seconds
    with interruptible():
        while not condition():
            if monotonic() > end:
                return False
            sleep(_POLL_SECONDS)
    return True
