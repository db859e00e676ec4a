"""Where the slots of a message lie in its bytes."""

from struct import calcsize, unpack_from
from typing import Optional

from .definition import PRIMITIVES, TIMES, VARIABLE, Definition, Field

EMPTY_LIMIT = 1 << 20
"""Elements that an array of empty messages may have; its length is all that such an array is."""


def element_format(slot: Field) -> Optional[str]:
    """Return the `struct` format of one element of a slot, or None where elements differ in size."""
    if slot.definition is not None:
        return fixed_format(slot.definition)
    if slot.type == "string":
        return None
    return TIMES.get(slot.type) or PRIMITIVES[slot.type]


def fixed_format(definition: Definition) -> Optional[str]:
    """Return the `struct` format of a type whose messages are all of one size, else None."""
    parts = []
    for slot in definition.fields:
        element = element_format(slot)
        if element is None or slot.length == VARIABLE:
            return None
        parts.append(element * (1 if slot.length is None else slot.length))
    return "".join(parts)


def least_size(slot: Field) -> int:
    """Return the number of bytes of the shortest value of a slot."""
    if slot.length == VARIABLE or (slot.type == "string" and slot.length is None):
        return 4
    if slot.definition is not None:
        one = sum(least_size(nested) for nested in slot.definition.fields)
    elif slot.type == "string":
        one = 4
    else:
        one = calcsize("<" + (TIMES.get(slot.type) or PRIMITIVES[slot.type]))
    return one * (1 if slot.length is None else slot.length)


def explain(definition: Definition, data: bytes) -> str:
    """Say why bytes are no message of a type."""
    size = len(data)
    try:
        end = _end(definition, data, 0, "")
    except _Cut as cut:
        return f"{size} bytes are no {definition.name}: they end in slot {cut.path}"
    return f"{size} bytes are no {definition.name}: {size - end} are left over"


class _Cut(Exception):
    def __init__(self, path: str):
        super().__init__(path)
        self.path = path


def _end(definition: Definition, data: bytes, at: int, prefix: str) -> int:
    for slot in definition.fields:
        path = prefix + slot.name
        number = 1 if slot.length is None else slot.length
        if slot.length == VARIABLE:
            at, number = at + 4, _number(data, at, path)
        size = element_format(slot)
        if size is not None:
            at += number * calcsize("<" + size)
            if at > len(data) or (not size and number > EMPTY_LIMIT):
                raise _Cut(path)
            continue
        for index in range(number):
            place = path if slot.length is None else f"{path}[{index}]"
            if slot.definition is not None:
                at = _end(slot.definition, data, at, place + ".")
            else:
                at += 4 + _number(data, at, place)
                if at > len(data):
                    raise _Cut(place)
    return at


def _number(data: bytes, at: int, path: str) -> int:
    if at + 4 > len(data):
        raise _Cut(path)
    number: int = unpack_from("<I", data, at)[0]
    return number
