"""Connection of commands to running nodes of ROS 1: the master, and proxies of services.

The process itself becomes a ROS node only if a command asks for it.
"""

import socket
from typing import Any, Callable, Dict, List, Mapping, Optional, Set, Tuple

import genpy
import rosgraph
import rospy
from std_msgs.msg import String

from .. import srv
from ..cli.node_client import RunningNodes
from ..foundation.errors import UsageError
from .control_topics import INPUT_CHANGES_TOPIC
from .genpy_fields import fill_message, read_fields
from .master_watch import MasterWatch

MASTER_TIMEOUT_SECONDS = 5.0
"""Timeout in seconds for calls of the master."""

_OWN_NAME = "retalis_command_line"


class RospyClient:
    """Connection to the nodes of a master; see `ClientConnection`.

    Attributes:
        namespace: namespace of the environment variable ``ROS_NAMESPACE``.
        scope: empty: there is one master.
    """

    scope = ""

    def __init__(self) -> None:
        self.namespace = str(rosgraph.names.get_ros_namespace())
        self._master_watch: Optional[MasterWatch] = None

    def resolve_node(self, name: str) -> str:
        """See `ClientConnection`."""
        return str(rosgraph.names.resolve_name(name, f"{self.namespace}{_OWN_NAME}"))

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
    except (OSError, rosgraph.MasterException) as error:
        uri = rosgraph.get_master_uri()
        raise UsageError(f"no master answers at {uri}: start one (roscore), or set ROS_MASTER_URI") from error
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
