"""Message types of ROS 2 that are installed on this machine, and the fields of messages of their classes.

The prefixes in ``AMENT_PREFIX_PATH`` contain the definitions as ``share/<package>/msg/<Type>.msg``, and those of
services and actions in ``srv`` and ``action``. rclpy also needs the generated class of a type; see `message_class`.
"""

import os
import sys
from importlib import import_module
from operator import attrgetter
from types import SimpleNamespace
from typing import Any, List, Mapping, Optional

from ..foundation.displayed_text import quote_shortened, shorten
from ..foundation.errors import MessageError
from ..foundation.ros_name_checks import ros1_type_name
from ..messages.ros2_definitions import NAMES_IN_ROS2, find_interfaces
from ..messages.type_registry import InstalledType, InstalledTypes, parse_ros2_type

_NANOSECONDS = 10**9

_END_OF_TIME = (1 << 31) * _NANOSECONDS
"""End of the range of times and durations, whose seconds are signed, in nanoseconds."""


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
            definition = parse_ros2_type(ros1_type_name(name), installed_type.text, self._find_text)
        except MessageError as error:
            raise MessageError(f"{installed_type.source}: {error}") from error
        return installed_type._replace(text=definition.full_text, is_derived=False)

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
        name = NAMES_IN_ROS2.get(name, name)
        installed_type = super().find(name)
        if installed_type is None:
            suggestion = "its package has to be built, and its setup.bash sourced before this node starts"
            raise MessageError(f"the message type {shorten(name)} is not installed: {suggestion}")
        package, _, type_name = name.partition("/")
        folder, path = "msg", type_name
        if installed_type.is_derived:
            # The file of the service or action is that from which the definition was read.
            folder = os.path.basename(os.path.dirname(installed_type.source))
            path = next(
                _find_derived_class(interface.name.partition("/")[2], type_name)
                for interface, interface_folder in find_interfaces(name)
                if interface_folder == folder
            )
        try:
            return attrgetter(path)(import_module(f"{package}.{folder}"))
        except Exception as error:  # the import can raise any exception
            if isinstance(error, AttributeError) and type_name.endswith("_Event"):
                raise MessageError(f"{name}: services have events in ROS 2 Iron and later") from error
            raise MessageError(
                f"{name}: the generated Python class of this message type cannot be imported: "
                f"{quote_shortened(str(error))}: build its package for this Python"
            ) from error

    def service_class(self, name: str) -> Any:
        """Return the generated class of a service, which rclpy calls it with.

        Args:
            name: ``pkg/Type``.

        Raises:
            MessageError: see `message_class`.
        """
        self.message_class(f"{name}_Request")
        package, _, type_name = name.partition("/")
        return getattr(import_module(f"{package}.srv"), type_name)


def _find_derived_class(interface: str, type_name: str) -> str:
    """Return the path of the class of a derived type in the module of services or actions.

    Args:
        interface: name of the service or action, without its package.
        type_name: name of the type: that of the interface with a suffix.
    """
    *service, kind = type_name[len(interface) + 1 :].split("_")
    if service:
        return f"{interface}.Impl.{service[0]}Service.{kind}"
    return f"{interface}.Impl.{kind}" if kind == "FeedbackMessage" else f"{interface}.{kind}"


def read_fields(message: Any) -> SimpleNamespace:
    """Return the fields of a message, with times and durations in nanoseconds; nested messages in the same form."""
    return SimpleNamespace(
        **{field: _read_value(getattr(message, field)) for field in message.get_fields_and_field_types()}
    )


def _read_value(value: Any) -> Any:
    if _is_instant(value):
        return value.sec * _NANOSECONDS + value.nanosec
    if hasattr(value, "get_fields_and_field_types"):
        return read_fields(value)
    if isinstance(value, (list, tuple)):
        return [_read_value(item) for item in value]
    return value


def fill_message(message: Any, values: Mapping[str, Any]) -> Any:
    """Assign values to the fields of a message, and return it.

    Args:
        message: the message.
        values: values by field. Nested messages are dictionaries; times and durations are integers in nanoseconds, of
            which those out of range become the nearest one.
    """
    types = message.get_fields_and_field_types()
    for field, value in values.items():
        default = getattr(message, field)
        if _is_instant(default):
            default.sec, default.nanosec = divmod(
                min(max(value, -_END_OF_TIME), _END_OF_TIME - 1), _NANOSECONDS
            )
        elif isinstance(value, Mapping):
            fill_message(default, value)
        elif isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping):
            element_class = _element_class(types[field])
            setattr(message, field, [fill_message(element_class(), element) for element in value])
        else:
            setattr(message, field, value)
    return message


def _is_instant(value: Any) -> bool:
    return hasattr(value, "nanosec")


def _element_class(sequence_type: str) -> Any:
    package, _, type_name = sequence_type[len("sequence<") :].partition(">")[0].partition("/")
    return getattr(import_module(f"{package}.msg"), type_name)
