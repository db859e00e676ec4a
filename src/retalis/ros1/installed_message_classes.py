"""Message classes that genpy has generated: their definitions, and the fields of their messages.

rospy publishes and subscribes with these classes. Their attributes, not the text of their modules, are therefore the
definition of an installed type in a node and in commands on a machine with ROS. The first type of a package imports
all classes of the package.
"""

import sys
from importlib import import_module
from types import SimpleNamespace
from typing import Any, Mapping, Optional

import genpy
from roslib.message import get_message_class, get_service_class

from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import MessageError
from ..messages.type_registry import GeneratedClass, InstalledTypes


def installed_types(include_rosbags: bool = True) -> InstalledTypes:
    """Return the installed types, with those that only exist as generated classes.

    Args:
        include_rosbags: whether types that only the package ``rosbags`` has are included.
    """
    return InstalledTypes(include_rosbags=include_rosbags, inspect_class=inspect_class)


def inspect_class(name: str) -> GeneratedClass:
    """Return the attributes of the generated class of a message type; the implementation of `InspectClass`.

    Args:
        name: ``pkg/Type``, or ``pkg/Type_Request`` or ``pkg/Type_Response`` of a service.

    Raises:
        MessageError: if the class cannot be imported.
    """
    try:
        message_class: Any = _find_service_part(name) or get_message_class(name)
    except Exception as error:  # the import can raise any exception, for example SyntaxError for Python 2
        raise _import_error(name, error) from error
    if message_class is None:
        raise _import_error(name, _find_import_error(name))
    module = sys.modules[message_class.__module__]
    return GeneratedClass(
        message_class._full_text,
        message_class._md5sum,
        tuple(message_class.__slots__),
        tuple(message_class._slot_types),
        str(module.__file__),
    )


def _find_service_part(name: str) -> Optional[Any]:
    """Return the class of the requests or responses of a service; None if the name is not that of one."""
    service, _, part = name.rpartition("_")
    service_class = get_service_class(service) if part in ("Request", "Response") else None
    return getattr(service_class, f"_{part.lower()}_class", None)


def _find_import_error(name: str) -> Exception:
    """Return the reason why roslib returned no class: it suppresses the errors of imports."""
    package, _, type_name = name.partition("/")
    try:
        module = import_module(f"{package}.msg")
    except ImportError as error:
        return error
    return ImportError(f"{module.__file__} has no class {type_name}")


def _import_error(name: str, reason: Exception) -> MessageError:
    return MessageError(
        f"{name}: the generated Python class of this message type cannot be imported: "
        f"{quote_shortened(str(reason))}: "
        "build its package, with all packages that it depends on, for this Python"
    )


def read_fields(message: Any) -> SimpleNamespace:
    """Return the fields of a message, with times and durations in nanoseconds; nested messages in the same form."""
    return SimpleNamespace(**{field: _read_value(getattr(message, field)) for field in message.__slots__})


def _read_value(value: Any) -> Any:
    if isinstance(value, genpy.TVal):
        return value.to_nsec()
    if isinstance(value, genpy.Message):
        return read_fields(value)
    if isinstance(value, (list, tuple)):
        return [_read_value(item) for item in value]
    return value


def fill_message(message: Any, values: Mapping[str, Any]) -> Any:
    """Assign values to the fields of a message, and return it.

    Args:
        message: the message.
        values: values by field. Nested messages are dictionaries; times and durations are integers in nanoseconds.
    """
    types = dict(zip(message.__slots__, message._slot_types))
    for field, value in values.items():
        default = getattr(message, field)
        if isinstance(default, genpy.TVal):
            setattr(message, field, type(default)(0, value))
        elif isinstance(value, Mapping):
            fill_message(default, value)
        elif value.__class__ is list and value and isinstance(value[0], Mapping):
            element_class = get_message_class(types[field].partition("[")[0])
            setattr(message, field, [fill_message(element_class(), element) for element in value])
        else:
            setattr(message, field, value)
    return message
