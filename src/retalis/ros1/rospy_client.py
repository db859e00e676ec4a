"""Connection of commands to running nodes of ROS 1: the master, and proxies of services.

The process itself becomes a ROS node only if a command asks for it.
"""

import socket
from time import monotonic, sleep
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Set, Tuple

import genpy
import rosgraph
import rospy
from std_msgs.msg import String

from .. import srv
from ..cli.node_client import CONNECTION_SECONDS, RunningNodes
from ..foundation.errors import UsageError
from ..foundation.interrupts import interruptible
from ..messages.type_definition import Definition, SerializationFormat
from ..messages.type_registry import InstalledTypes
from .connection_writer import serialized_class
from .installed_message_classes import fill_message, inspect_class, read_fields
from .internode_control_topics import INPUT_CHANGES_TOPIC
from .master_watch import MASTER_ERRORS, MasterWatch

MASTER_TIMEOUT_SECONDS = 5.0
"""Timeout in seconds for calls of the master."""

MAX_QUEUED_MESSAGES = 1000
"""Number of messages that are queued for a slow subscriber; beyond it, the oldest are dropped."""

_POLL_SECONDS = 0.02

_OWN_NAME = "retalis_command_line"


class RospyClient:
    """Connection to the nodes of a master; see `ClientConnection`.

    Attributes:
        namespace: namespace of the environment variable ``ROS_NAMESPACE``.
        scope: empty: there is one master.
        end_of_time: end of the unsigned seconds of ROS 1.
        format: serialization of ROS 1.
    """

    scope = ""
    end_of_time = 1 << 32
    format = SerializationFormat.ROS1

    def __init__(self) -> None:
        self.namespace = str(rosgraph.names.get_ros_namespace())
        self._master_watch: Optional[MasterWatch] = None

    def resolve_node(self, name: str) -> str:
        """See `ClientConnection`."""
        return str(rosgraph.names.resolve_name(name, f"{self.namespace}{_OWN_NAME}"))

    def limit_discovery(self, seconds: float) -> None:
        """Do nothing: the master knows all nodes."""

    def find_nodes(self, requested_name: Optional[str] = None) -> RunningNodes:
        """See `ClientConnection`. The master knows all nodes: there is nothing to wait for."""
        publishers, subscribers, services = map(_nodes_by_name, get_system_state())
        return RunningNodes(services, publishers, _find_interfaces(publishers, subscribers))

    def call(self, service: str, service_type: str, fields: Mapping[str, Any], max_seconds: float) -> Any:
        """See `ClientConnection`."""
        service_class = getattr(srv, service_type)
        request = fill_message(getattr(srv, f"{service_type}Request")(), fields)
        try:
            return read_fields(rospy.ServiceProxy(service, service_class)(request))
        except (rospy.ServiceException, rospy.ROSException, genpy.SerializationError, OSError) as error:
            raise UsageError(f"service {service} does not answer: {error}") from error

    def start_node(self, name: str) -> None:
        """See `ClientConnection`."""
        rospy.init_node(name, anonymous=True, disable_signals=True, disable_rosout=True)

    def subscribe(self, topic: str, receive: Callable[[str], object]) -> None:
        """See `ClientConnection`. If a new master is started, the node subscribes there, too."""
        if self._master_watch is None:
            self._master_watch = MasterWatch()
            self._master_watch.start()
        rospy.Subscriber(topic, String, lambda message: receive(message.data))

    def installed_types(self, extra_folders: Sequence[str]) -> InstalledTypes:
        """See `ClientConnection`."""
        return InstalledTypes(extra_folders=extra_folders, inspect_class=inspect_class)

    def advertise(self, topic: str, definition: Definition) -> Callable[[bytes], object]:
        """See `ClientConnection`."""
        message_class = serialized_class(definition)
        publisher = rospy.Publisher(topic, message_class, queue_size=MAX_QUEUED_MESSAGES)
        end = monotonic() + CONNECTION_SECONDS
        subscribers = _nodes_by_name(get_system_state()[1]).get(topic, ())
        with interruptible():
            while publisher.get_num_connections() < max(1, len(subscribers)) and monotonic() < end:
                sleep(_POLL_SECONDS)
        # A subscriber that has ended without the master's knowledge never connects.
        if not publisher.get_num_connections():
            raise UsageError(f"topic {topic}: no node subscribes to it")

        def publish(data: bytes) -> None:
            message = message_class()
            message._buff = data
            publisher.publish(message)

        return publish

    def end(self) -> None:
        """See `ClientConnection`."""
        rospy.signal_shutdown("done")


def get_system_state() -> List[List[Tuple[str, List[str]]]]:
    """Return the publishers, the subscribers and the services that the master knows, as names with their nodes.

    Raises:
        UsageError: if no master answers.
    """
    master = rosgraph.Master(f"/{_OWN_NAME}")
    # rosgraph has no parameter for a timeout: without the default of sockets, a master that hangs would block
    # forever.
    default_timeout = socket.getdefaulttimeout()
    socket.setdefaulttimeout(MASTER_TIMEOUT_SECONDS)
    try:
        state: List[List[Tuple[str, List[str]]]] = master.getSystemState()
    except MASTER_ERRORS as error:
        uri = rosgraph.get_master_uri()
        raise UsageError(
            f"no master answers at {uri}: {error}: start one (roscore), or set ROS_MASTER_URI"
        ) from error
    finally:
        socket.setdefaulttimeout(default_timeout)
    return state


def _nodes_by_name(pairs: List[Tuple[str, List[str]]]) -> Dict[str, Set[str]]:
    return {name: set(nodes) for name, nodes in pairs}


def _find_interfaces(
    publishers: Mapping[str, Set[str]], subscribers: Mapping[str, Set[str]]
) -> Dict[str, Set[str]]:
    """Return the nodes that are the ROS interface of a node: they publish their subscriptions, which it reads."""
    interfaces: Dict[str, Set[str]] = {}
    for topic, nodes in publishers.items():
        if topic.endswith(f"/{INPUT_CHANGES_TOPIC}"):
            for node in subscribers.get(topic, ()):
                interfaces.setdefault(node, set()).update(nodes - {node})
    return interfaces
