"""Messages in test files: conversion of their slots to message terms, with errors at the place of a slot.

Slots are written as for ``rostopic pub`` and ``ros2 topic pub``. A time is ``{secs: 1, nsecs: 0}``, ``{sec: 1,
nanosec: 0}``, a number of seconds, or ``now``. A header without stamp, or the text ``auto`` in place of a header,
gets the time of the message.
"""

from typing import Any, Optional

from ..foundation.displayed_text import format_count, quote_shortened
from ..foundation.errors import MessageError
from ..foundation.similar_names import did_you_mean
from ..messages.message_dictionaries import make_message_term
from ..messages.type_definition import (
    FLOATS,
    HEADER,
    PRIMITIVES,
    TIMES,
    VARIABLE_LENGTH,
    Definition,
    Field,
    SerializationFormat,
    integer_range,
)
from ..messages.type_registry import Definitions
from ..prolog.terms import timestamps
from .case_definition import CaseMessage
from .yaml_documents import CaseFileError, YamlValue

_TIME_KEYS = {"secs": "nsecs", "sec": "nanosec"}
"""Names of the slots of a time in ROS 1 and ROS 2."""


def make_input_message(
    message: CaseMessage,
    definition: Definition,
    definitions: Definitions,
    instant: int,
    serialization_format: SerializationFormat = SerializationFormat.ROS1,
) -> bytes:
    """Return a serialized input message.

    Args:
        message: the message.
        definition: its type.
        definitions: known types.
        instant: time of the message in nanoseconds since the epoch.
        serialization_format: format of the result.

    Raises:
        CaseFileError: if a slot does not exist, or its value does not fit.
    """
    try:
        return serialize_slots(message.value, definition, definitions, instant, serialization_format)
    except MessageError as error:
        place = message.place if message.value is None else message.value.place
        raise CaseFileError(f"message of topic {message.topic}: {error.message}", place) from error


def serialize_slots(
    value: Optional[YamlValue],
    definition: Definition,
    definitions: Definitions,
    instant: int,
    serialization_format: SerializationFormat = SerializationFormat.ROS1,
) -> bytes:
    """Return a serialized message with given slots; see `make_input_message`.

    Raises:
        CaseFileError: if a slot does not exist.
        MessageError: if a value does not fit.
    """
    slots = _MessageReader(instant).read_message(definition, value)
    return definitions.encoder(definition, serialization_format).encode(make_message_term(definition, slots))


class _MessageReader:
    """Reader of the slots of a message; see `make_message_term` for the result.

    Args:
        instant: the time ``now`` in nanoseconds since the epoch.
    """

    def __init__(self, instant: int):
        self._instant = instant

    def read_message(self, definition: Definition, value: Optional[YamlValue]) -> Any:
        """Return the values of a message's slots by name."""
        is_header = definition.name == HEADER
        if value is not None and is_header and value.is_text and value.text() == "auto":
            value = None
        values = {} if value is None else value.mapping()
        slots = {slot.name: slot for slot in definition.fields}
        message = {}
        for name, slot_value in values.items():
            if name not in slots:
                raise slot_value.error(f"{definition.name} has no slot {name}{did_you_mean(name, slots)}")
            message[name] = self._read_slot(definition, slots[name], slot_value)
        if is_header:
            message.setdefault("stamp", self._instant)
        # Headers of messages that are not given have the time, too.
        for name, slot in slots.items():
            if name not in message and slot.definition is not None and slot.length is None:
                message[name] = self.read_message(slot.definition, None)
        return message

    def _read_slot(self, definition: Definition, slot: Field, value: YamlValue) -> Any:
        if slot.length is None:
            return self._read_element(definition, slot, value)
        if slot.is_bytes:
            return _read_bytes(slot, value)
        elements = [self._read_element(definition, slot, element) for element in value.items()]
        _check_length(slot, len(elements), value)
        return elements

    def _read_element(self, definition: Definition, slot: Field, value: YamlValue) -> Any:
        if slot.definition is not None:
            return self.read_message(slot.definition, value)
        if slot.type in TIMES:
            return read_time(value, self._instant)
        if slot.type == "string":
            return value.text()
        if slot.type == "bool":
            return value.boolean()
        if slot.type in FLOATS:
            return read_float(value)
        constant = find_constant(definition, value)
        return _read_integer(slot, value) if constant is None else constant


def find_constant(definition: Definition, value: YamlValue) -> Optional[int]:
    """Return the value of a constant that is named in place of an integer; None for other values.

    Args:
        definition: the type of the message.
        value: the value of one of its slots.

    Raises:
        CaseFileError: if the type has constants, but none with this name.
    """
    constants = {constant.name: constant.value for constant in definition.constants}
    numbers = {name: number for name, number in constants.items() if type(number) is int}
    if not value.is_text or not numbers:
        return None
    name = value.text()
    if name not in numbers:
        hint = did_you_mean(name, numbers)
        raise value.error(
            f"{value.name}: expected an integer or the name of a constant of {definition.name}, found "
            f"{quote_shortened(name)}{hint}"
        )
    return numbers[name]


def read_time(value: YamlValue, now: int) -> int:
    """Return a time in nanoseconds: of ROS 1 or ROS 2, a number of seconds, or ``now``.

    Raises:
        CaseFileError: if this is no time.
    """
    if value.is_text and value.text() == "now":
        return now
    if not value.is_mapping:
        return timestamps.from_seconds(value.number())
    values = value.mapping()
    for seconds_name, nanoseconds_name in _TIME_KEYS.items():
        if set(values) <= {seconds_name, nanoseconds_name}:
            seconds, nanoseconds = (
                values[name].integer(-(1 << 31)) if name in values else 0
                for name in (seconds_name, nanoseconds_name)
            )
            return seconds * timestamps.SECOND + nanoseconds
    raise value.error(f"{value.name}: expected {{secs: S, nsecs: N}}, a number of seconds, or now")


def read_float(value: YamlValue) -> float:
    """Return a number, which may be infinite or not a number: sensors send both.

    Raises:
        CaseFileError: if this is no number.
    """
    number = value.scalar()
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        raise value.error(f"{value.name}: expected a number, found '{value.text()}'")
    return number


def _read_integer(slot: Field, value: YamlValue) -> int:
    minimum, maximum = integer_range(PRIMITIVES[slot.type])
    number = value.integer(minimum)
    if number > maximum:
        raise value.error(f"{value.name}: {number} is too large for {slot.type}: expected at most {maximum}")
    return number


def _read_bytes(slot: Field, value: YamlValue) -> bytes:
    if value.is_text:
        content = value.text().encode("utf-8")
    else:
        content = bytes(_read_integer(slot, element) for element in value.items())
    _check_length(slot, len(content), value)
    return content


def _check_length(slot: Field, count: int, value: YamlValue) -> None:
    if slot.length not in (None, VARIABLE_LENGTH, count):
        raise value.error(
            f"{value.name}: {slot.describe()} has {format_count(slot.length or 0, 'element')}, not {count}"
        )
