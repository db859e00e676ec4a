"""Message types that commands find on the system, with those that exist only as classes generated for ROS."""

from typing import Any, Optional, Sequence

from ..foundation.errors import UsageError
from ..messages.type_registry import Definitions, GeneratedClass, InstalledTypes


def installed_definitions(extra_folders: Sequence[str] = ()) -> Definitions:
    """Return the message types of the system.

    Args:
        extra_folders: folders that are searched first; each is a package or contains packages.
    """
    return Definitions(InstalledTypes(extra_folders=extra_folders, inspect_class=_inspect_class))


def _inspect_class(name: str) -> Optional[GeneratedClass]:
    """Inspect a generated class with package ``ros``; return None without ROS.

    ROS is imported when the first module of such a class has been found, so that other commands start fast.
    """
    from .node_commands import import_ros_module  # noqa: PLC0415 - commands do not import each other at start

    try:
        module: Any = import_ros_module("generated_classes")
    except UsageError:
        return None
    generated: GeneratedClass = module.inspect_class(name)
    return generated
