"""Message types of ROS 2 that are installed on this machine.

The prefixes in ``AMENT_PREFIX_PATH`` contain the definitions as ``share/<package>/msg/<Type>.msg``. rclpy needs the
generated class of a type as well; see `message_class`.
"""

import os
import sys
from importlib import import_module
from typing import Any, List, Optional

from ..foundation.errors import MessageError, quote_shortened, shorten
from ..foundation.ros_name_checks import ros1_type_name
from ..messages.ros2_definitions import parse_ros2_type
from ..messages.type_registry import InstalledType, InstalledTypes

_NAMES_IN_ROS2 = {"tf/tfMessage": "tf2_msgs/TFMessage"}
"""Types of ROS 1 that programs name, and that ROS 2 has under another name."""


def ament_prefixes() -> List[str]:
    """Return the prefixes of installed packages, in the order in which they are searched.

    Without ``AMENT_PREFIX_PATH``, it is the prefix of Python: packages from PyPI are installed there.
    """
    paths = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [path for path in paths if path] or [sys.prefix]


class InstalledInterfaces(InstalledTypes):
    """The message types of ROS 2 that are installed, with their definitions in the form of ROS 1."""

    def __init__(self) -> None:
        super().__init__(
            [os.path.join(prefix, "share") for prefix in ament_prefixes()], modules=(), include_rosbags=False
        )

    def find(self, name: str) -> Optional[InstalledType]:
        """See `InstalledTypes.find`; the text includes the definitions of nested types.

        Raises:
            MessageError: if the definition is invalid, or a nested type is not installed.
        """
        installed_type = super().find(name)
        if installed_type is None:
            return None
        try:
            definition = parse_ros2_type(name, installed_type.text, self._find_text)
        except MessageError as error:
            raise MessageError(f"{installed_type.source}: {error}") from error
        return installed_type._replace(text=definition.full_text)

    def _find_text(self, name: str) -> Optional[str]:
        installed_type = super().find(name)
        return None if installed_type is None else installed_type.text

    def message_class(self, name: str) -> Any:
        """Return the generated class of a type, which rclpy subscribes and publishes with.

        Only types whose definitions are installed are imported: other nodes choose names, and must not make this
        process import other modules.

        Args:
            name: ``pkg/Type``.

        Raises:
            MessageError: if the type is not installed, or its class cannot be imported.
        """
        name = ros1_type_name(name)
        name = _NAMES_IN_ROS2.get(name, name)
        if super().find(name) is None:
            suggestion = "its package has to be built, and its setup.bash sourced before this node starts"
            raise MessageError(f"the message type {shorten(name)} is not installed: {suggestion}")
        package, _, type_name = name.partition("/")
        try:
            return getattr(import_module(f"{package}.msg"), type_name)
        except Exception as error:  # the import can raise any exception
            raise MessageError(
                f"{name}: the generated Python class of this message type cannot be imported: "
                f"{quote_shortened(str(error))}: build its package for this Python"
            ) from error
