"""Import of package ``ros1`` by commands: connections to running nodes, and generated message types.

Package `cli` does not depend on package `ros1`: the command line works without ROS. Modules of `ros1` are therefore
imported by name, when a command needs them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Optional, Sequence

from ..foundation.errors import UsageError

if TYPE_CHECKING:
    from ..messages.type_registry import Definitions, GeneratedClass
    from .node_client import ClientConnection


def import_ros_module(name: str) -> Any:
    """Import a module of package ``ros1``.

    Raises:
        UsageError: if ROS is not installed.
    """
    try:
        return import_module(f"retalis.ros1.{name}")
    except ImportError as error:
        raise UsageError(
            f"this needs ROS ({error}): source its setup.bash, and that of the workspace"
        ) from error


def connect_client() -> "ClientConnection":
    """Return a connection to running nodes.

    Raises:
        UsageError: if ROS is not installed.
    """
    connection: ClientConnection = import_ros_module("rospy_client").RospyClient()
    return connection


def installed_definitions(extra_folders: Sequence[str] = ()) -> "Definitions":
    """Return the message types of the system.

    Args:
        extra_folders: folders that are searched first; each is a package or contains packages.
    """
    # Commands for a running node import this module, but read no message types.
    from ..messages.type_registry import Definitions, InstalledTypes  # noqa: PLC0415

    return Definitions(InstalledTypes(extra_folders=extra_folders, inspect_class=_inspect_class))


def _inspect_class(name: str) -> "Optional[GeneratedClass]":
    """Inspect a generated class with package ``ros1``; return None without ROS.

    ROS is imported when the first module of such a class has been found, so that other commands start fast.
    """
    try:
        module: Any = import_ros_module("installed_message_classes")
    except UsageError:
        return None
    generated: GeneratedClass = module.inspect_class(name)
    return generated
