"""Fields of requests and responses that genpy has generated, as plain values."""

from types import SimpleNamespace
from typing import Any, Mapping

import genpy
from roslib.message import get_message_class


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
