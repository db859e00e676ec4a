"""Nodes of rclpy in the process of a test."""

import threading
import time
from typing import Any, Callable, List, Optional, Sequence

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from recording_reports import RecordingReports

from retalis import Reports
from retalis.node.transport import MessageSource
from retalis.ros2.rclpy_transport import NodeExecutor, RclpyTransport

TIMEOUT_SECONDS = 60.0
"""Seconds after which a wait fails; only a busy machine needs most of them."""


def wait_until(condition: Callable[[], Any]) -> Any:
    """Return the value of a condition as soon as it is true."""
    end = time.monotonic() + TIMEOUT_SECONDS
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < end, "nothing has happened"
        time.sleep(0.01)


class RecordingReceiver:
    """A receiver of messages; see `MessageReceiver`.

    Attributes:
        messages: the received messages.
        received: instants of their reception in ns.
        identities: what tells apart those that may be repeated.
        lost: number of messages that the transport has lost.
        source: the source.
    """

    error = ""
    reads_transforms = False

    def __init__(self) -> None:
        self.messages: List[bytes] = []
        self.received: List[int] = []
        self.identities: List[Any] = []
        self.lost = 0
        self.source = MessageSource("")

    def connect(self, source: MessageSource) -> "RecordingReceiver":
        """Return this receiver for a source."""
        self.source = source
        return self

    def receive(
        self, messages: List[bytes], received: Sequence[int] = (), identities: Sequence[Any] = ()
    ) -> None:
        """Record messages."""
        self.messages += messages
        self.received += received
        self.identities += identities

    def convert(self, message: bytes) -> None:
        """Record a message."""
        self.messages.append(message)

    def record_lost(self, count: int) -> None:
        """Count lost messages."""
        self.lost += count

    def close(self, is_incomplete: bool) -> None:
        """Do nothing."""


class Network:
    """Nodes in one process.

    Attributes:
        reports: the reports of all transports.
    """

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.reports = RecordingReports()
        self._transports: List[RclpyTransport] = []
        self._node_executors: List[NodeExecutor] = []
        self._executor = SingleThreadedExecutor(context=self.context)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()
        self._nodes: List[Any] = []

    def add_node(self, name: str = "peer", **options: Any) -> Any:
        """Return a node of rclpy whose callbacks run in a thread."""
        node = self._create_node(name, **options)
        self._executor.add_node(node)
        return node

    def add_lifecycle_node(self, name: str = "peer") -> Any:
        """Return a node with a life cycle whose callbacks run in a thread."""
        node = LifecycleNode(name, context=self.context)
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def remove_node(self, node: Any) -> None:
        """End a node that `add_node` has returned."""
        self._executor.remove_node(node)
        self._nodes.remove(node)
        node.destroy_node()

    def add_transport(
        self,
        name: str = "retalis",
        reports: Optional[Reports] = None,
        remappings: Sequence[str] = (),
        **parameters: Any,
    ) -> RclpyTransport:
        """Return the transport of a node with parameters and remappings of names."""
        overrides = [rclpy.Parameter(key, value=value) for key, value in parameters.items()]
        node = self._create_node(
            name,
            cli_args=["--ros-args", *(argument for rule in remappings for argument in ("-r", rule))],
            parameter_overrides=overrides,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        reports = reports or self.reports
        executor = NodeExecutor(node, reports.error)
        self._node_executors.append(executor)
        transport = RclpyTransport(node, executor.executor, reports)
        self._transports.append(transport)
        return transport

    def close(self) -> None:
        """End all nodes."""
        for transport in self._transports:
            transport.shut_down()
        for executor in self._node_executors:
            executor.stop()
        self._executor.shutdown()
        self._thread.join()
        for node in self._nodes:
            node.destroy_node()
        self.context.try_shutdown()

    def _create_node(self, name: str, **options: Any) -> Any:
        node = rclpy.create_node(name, context=self.context, **options)
        self._nodes.append(node)
        return node
