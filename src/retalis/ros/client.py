"""A node that runs, as the command line reaches it: finding it, and calling its services."""

import socket
from typing import Any, Container, Dict, List, Optional, Set, Tuple

import genpy
import rosgraph
import rospy

from ..foundation import UsageError
from .listing import NEVER

MARK = "/add_memory"
"""End of the name of a service that every node with an engine offers, old and new."""

INTERFACE_MARK = "/add_input_subscription"
"""End of the name of a service that every node with a ROS interface offers."""

PATIENCE = 5.0
"""Seconds in which the master has to answer."""

State = Tuple[Dict[str, Set[str]], Dict[str, Set[str]]]
"""The nodes that publish each topic, and those that have each service."""


def master_state() -> State:
    """Return what the master knows.

    Raises:
        UsageError: where there is none.
    """
    master = rosgraph.Master("/retalis_command_line")
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(PATIENCE)
    try:
        published, _, services = master.getSystemState()
    except (OSError, rosgraph.MasterException) as error:
        uri = rosgraph.get_master_uri()
        raise UsageError(f"no master answers at {uri}: start one (roscore), or set ROS_MASTER_URI") from error
    finally:
        socket.setdefaulttimeout(before)
    return _by_name(published), _by_name(services)


def _by_name(found: List[Tuple[str, List[str]]]) -> Dict[str, Set[str]]:
    return {name: set(nodes) for name, nodes in found}


def nodes_of(services: Dict[str, Set[str]], interfaces: bool = False) -> List[str]:
    """Return the nodes of ours that run and have an engine, or also those that are only a ROS interface."""
    marks = (MARK, INTERFACE_MARK) if interfaces else (MARK,)
    return sorted({node for name, nodes in services.items() if name.endswith(marks) for node in nodes})


class LiveNode:
    """A node ``retalis`` that runs.

    Args:
        wanted: its name, relative to the namespace of environment variable ``ROS_NAMESPACE``; by default the only
            one that runs in that namespace.
        interfaces: whether a node that is only a ROS interface may be named, too.

    Attributes:
        name: its name.
        has_engine: whether it is more than a ROS interface.
        published: the topics that it publishes.

    Raises:
        UsageError: where there is no master, no such node, or more than one.
    """

    def __init__(self, wanted: Optional[str] = None, interfaces: bool = False):
        topics, self._services = master_state()
        found = nodes_of(self._services)
        if wanted is None:
            self.name = _only(found)
        else:
            self.name = _named(wanted, nodes_of(self._services, interfaces), self._services)
        self.has_engine = self.name in found
        self.published = sorted(topic for topic, nodes in topics.items() if self.name in nodes)

    def call(self, service: str, kind: Any, **fields: Any) -> Any:
        """Call a service of the node; return the response.

        Args:
            service: its private name.
            kind: its class.
            fields: of the request.

        Raises:
            UsageError: where it has no such service, or does not answer.
        """
        name = f"{self.name}/{service}"
        if self.name not in self._services.get(name, ()):
            raise UsageError(
                f"node {self.name} has no service ~{service}: it is a ROS interface, or of an older version"
            )
        return self._call(name, kind, fields)

    def call_shared(self, service: str, kind: Any, **fields: Any) -> Any:
        """Call a service of the node whose name is relative: that with this ending which the node has."""
        for name, nodes in self._services.items():
            if name.endswith(f"/{service}") and self.name in nodes:
                return self._call(name, kind, fields)
        raise UsageError(f"node {self.name} has no service {service}")

    def _call(self, name: str, kind: Any, fields: Dict[str, Any]) -> Any:
        try:
            return rospy.ServiceProxy(name, kind)(kind._request_class(**fields))  # noqa: SLF001
        except (rospy.ServiceException, rospy.ROSException, genpy.SerializationError, OSError) as error:
            raise UsageError(f"service {name} does not answer: {error}") from error


def _named(wanted: str, found: List[str], services: Container[str]) -> str:
    """Return the full name of a node that a user has named."""
    name = str(
        rosgraph.names.resolve_name(wanted, f"{rosgraph.names.get_ros_namespace()}retalis_command_line")
    )
    if name not in found and f"{name}/list" not in services:  # which the ROS interface has too
        raise UsageError(f"there is no node {name}; {_there(found)}")
    return name


def _only(found: List[str]) -> str:
    """Return the only node that runs in the namespace of ``ROS_NAMESPACE``."""
    space = rosgraph.names.get_ros_namespace()
    inside = [name for name in found if name.startswith(space)]
    if len(inside) == 1:
        return inside[0]
    if inside:
        raise UsageError(f"which node? {_there(inside)}; choose one by --node")
    if found:
        raise UsageError(f"no node retalis runs in namespace {space[:-1]} (ROS_NAMESPACE); {_there(found)}")
    raise UsageError(_there(found))


def _there(found: List[str]) -> str:
    return f"those that run are {', '.join(found)}" if found else "no node retalis runs"


def plain(message: Any) -> Any:
    """Return a message as dictionaries, lists and plain values; times as seconds, None where there is none."""
    if isinstance(message, genpy.Message):
        return {name: plain(getattr(message, name)) for name in message.__slots__}
    if isinstance(message, (list, tuple)):
        return [plain(one) for one in message]
    if isinstance(message, genpy.TVal):
        nanoseconds = message.to_nsec()
        none = nanoseconds == NEVER if isinstance(message, genpy.Duration) else not nanoseconds
        return None if none else message.to_sec()
    return message


def checked(response: Any) -> Any:
    """Return a response whose result is good.

    Raises:
        UsageError: what its result says.
    """
    if response.result != "ok":
        raise UsageError(response.result[len("error: ") :])
    return response
