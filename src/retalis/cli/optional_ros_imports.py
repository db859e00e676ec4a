"""Import of packages ``ros1`` and ``ros2`` by commands: connections to running nodes, and generated types.

Package `cli` does not depend on these packages: the command line works without ROS. Their modules are therefore
imported by name, when a command needs them.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any, List, Optional, Sequence

from ..foundation.errors import UsageError

if TYPE_CHECKING:
    from ..messages.type_registry import Definitions, GeneratedClass
    from .node_client import ClientConnection

_CLIENTS = {"1": ("ros1.rospy_client", "RospyClient"), "2": ("ros2.rclpy_client", "RclpyClient")}
"""Module and class of a connection, by ``ROS_VERSION``."""


def import_ros_module(name: str) -> Any:
    """Import a module of package ``ros1``.

    Raises:
        UsageError: if ROS is not installed.
    """
    try:
        return import_module(f"retalis.ros1.{name}")
    except ImportError as error:
        raise _missing_ros(error) from error


def connect_client() -> "ClientConnection":
    """Return a connection to running nodes.

    They are nodes of the ROS that ``ROS_VERSION`` states. Without it, ROS 1 precedes ROS 2 if both can be imported.

    Raises:
        UsageError: if ROS is not installed.
    """
    version = os.environ.get("ROS_VERSION", "")
    clients = [_CLIENTS[version]] if version in _CLIENTS else list(_CLIENTS.values())
    errors: List[ImportError] = []
    for module, class_name in clients:
        try:
            client_class = getattr(import_module(f"retalis.{module}"), class_name)
        except ImportError as error:
            errors.append(error)
            continue
        connection: ClientConnection = client_class()
        return connection
    raise _missing_ros(errors[0]) from errors[0]


def _missing_ros(error: ImportError) -> UsageError:
    return UsageError(f"this needs ROS ({error}): source its setup.bash, and that of the workspace")


def installed_definitions(extra_folders: Sequence[str] = ()) -> "Definitions":
    """Return the message types of the system, with those of packages in further folders, which are searched first."""
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
