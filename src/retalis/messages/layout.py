"""Where the slots of a message lie in its bytes."""

from struct import error as StructError
from struct import unpack_from
from typing import Optional

from ..foundation import MessageError, beginning, counted
from .definition import Definition, Field, measure_of
from .slots import VARIABLE

BARE = 10_000
"""Elements without bytes (messages without slots in an array) that a message may have, where no setting says so."""


def element_size(slot: Field) -> Optional[int]:
    """Return the bytes of one element of a slot, or None where elements differ in size."""
    measure = measure_of(slot)
    return measure.least if measure.fixed else None


def explain(definition: Definition, data: bytes) -> str:
    """Say why bytes are not a message of a type."""
    size = len(data)
    try:
        end = _Walk(data).end(definition, 0, "")
    except _Truncated as cut:
        return f"{_size(size)} not a {definition.name}: they end inside slot {beginning(cut.path)}"
    return f"{_size(size)} not a {definition.name}: {size - end} left over"


def _size(size: int) -> str:
    return f"{counted(size, 'byte')} {'is' if size == 1 else 'are'}"


def check_bare(definition: Definition, data: bytes, most: int) -> None:
    """Count the elements without bytes in a message: their number is all that there is of them.

    Raises:
        MessageError: where there are too many, or the bytes are not a message.
    """
    walk = _Walk(data)
    try:
        walk.end(definition, 0, "")
    except _Truncated:
        raise MessageError(explain(definition, data)) from None
    if walk.bare > most:
        raise MessageError(
            f"a {definition.name} has {walk.bare} zero-byte elements in its arrays: at most {most} are allowed"
        )


def element_end(data: bytes, slot: Field, at: int) -> int:
    """Return where a slot ends that begins at a place.

    Raises:
        struct.error: where the bytes end before.
    """
    try:
        return _Walk(data).end_of(slot, at, slot.name)
    except _Truncated as cut:
        raise StructError(cut.path) from None


class _Truncated(Exception):
    def __init__(self, path: str):
        super().__init__(path)
        self.path = path


class _Walk:
    """Goes over the bytes of a message without making anything of them, and counts elements without bytes."""

    def __init__(self, data: bytes):
        self.data = data
        self.bare = 0

    def end(self, definition: Definition, at: int, prefix: str) -> int:
        """Return where a message that begins at a place ends."""
        for slot in definition.fields:
            at = self.end_of(slot, at, prefix + slot.name)
        return at

    def end_of(self, slot: Field, at: int, path: str) -> int:
        """Return where a slot that begins at a place ends."""
        number = 1 if slot.length is None else slot.length
        if slot.length == VARIABLE:
            at, number = at + 4, self.number(at, path)
        one = measure_of(slot)
        if not one.fixed:
            return self.elements(slot, number, at, path)
        at += number * one.least
        self.bare += number * (one.bare + (slot.length is not None and not one.least))
        if at > len(self.data):
            raise _Truncated(path)
        return at

    def elements(self, slot: Field, number: int, at: int, path: str) -> int:
        """Return where elements that differ in size end."""
        for index in range(number):
            place = path if slot.length is None else f"{path}[{index}]"
            if slot.definition is not None:
                at = self.end(slot.definition, at, place + ".")
            else:
                at += 4 + self.number(at, place)
                if at > len(self.data):
                    raise _Truncated(place)
        return at

    def number(self, at: int, path: str) -> int:
        """Return the number at a place."""
        if at + 4 > len(self.data):
            raise _Truncated(path)
        number: int = unpack_from("<I", self.data, at)[0]
        return number
