"""Requests and responses of services, as classes that rosidl has generated."""

from importlib import import_module
from types import SimpleNamespace
from typing import Any, Mapping

_NANOSECONDS = 10**9

_END_OF_TIME = (1 << 31) * _NANOSECONDS
"""End of the range of times and durations, whose seconds are signed, in nanoseconds."""


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
    """Return the class of the elements of ``sequence<pkg/Type>``."""
    package, _, type_name = sequence_type[len("sequence<") :].partition(">")[0].partition("/")
    return getattr(import_module(f"{package}.msg"), type_name)
