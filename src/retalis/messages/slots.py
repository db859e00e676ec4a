"""Slots of messages: their types, and how large they are."""

from struct import calcsize
from typing import TYPE_CHECKING, Dict, Iterable, NamedTuple, Optional

if TYPE_CHECKING:
    from .definition import Definition

PRIMITIVES: Dict[str, str] = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "byte": "b",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Number types and their `struct` codes; ``byte`` and ``char`` are old names of int8 and uint8."""

TIMES: Dict[str, str] = {"time": "II", "duration": "ii"}
BUILTIN = frozenset(PRIMITIVES) | frozenset(TIMES) | {"string"}

VARIABLE = -1
"""The length of an array whose number of elements is in the message."""

MOST_SLOTS = 10_000
"""Slots that a type may have, those of the types in it included: its functions name each of them."""

DEEPEST = 50
"""How deep types may lie in each other."""

LARGEST = (1 << 32) - 1
"""Bytes that a message can have: the wire gives its size in 32 bits."""


class Field(NamedTuple):
    """A slot of a message.

    Attributes:
        name: the slot's name.
        type: the type of the slot or of its elements: a built-in one, or ``pkg/Type``.
        length: None for a single value, `VARIABLE` or the number of elements for an array.
        definition: the definition of a ``pkg/Type``, None for built-in types.
    """

    name: str
    type: str
    length: Optional[int] = None
    definition: Optional["Definition"] = None

    @property
    def is_bytes(self) -> bool:
        """Whether the slot is an array of bytes, which events show as text."""
        return self.length is not None and self.type in ("uint8", "char")

    def describe(self) -> str:
        """Return the type as a definition writes it: ``float64[36]``."""
        if self.length is None:
            return self.type
        return f"{self.type}[{'' if self.length == VARIABLE else self.length}]"


class Measure(NamedTuple):
    """How large the messages of a type are, and what is made for them.

    Attributes:
        least: bytes of the shortest one.
        fixed: whether all are as long as that.
        slots: how many slots there are, those of nested types included.
        depth: how deep types lie in each other.
        bare: how many elements of fixed arrays have no bytes.
        may_be_bare: whether there is an array, of whatever length, whose elements have no bytes.
    """

    least: int = 0
    fixed: bool = True
    slots: int = 0
    depth: int = 0
    bare: int = 0
    may_be_bare: bool = False

    def plus(self, slot: Field) -> "Measure":
        """Return the measure of messages with one more slot."""
        one = measure_of(slot)
        number = 1 if slot.length is None else slot.length
        varies = number == VARIABLE
        is_bare = slot.length is not None and not one.least
        return Measure(
            self.least + (4 if varies else one.least * number),
            self.fixed and one.fixed and not varies,
            self.slots + one.slots + 1,
            max(self.depth, one.depth + 1),
            self.bare + (0 if varies else number * (one.bare + is_bare)),
            self.may_be_bare or one.may_be_bare or is_bare,
        )

    def problem(self) -> str:
        """Return what is too much; an empty text where nothing is."""
        if self.slots > MOST_SLOTS:
            return (
                f"a type cannot have more than {MOST_SLOTS} slots, including those of the types it contains"
            )
        if self.depth > DEEPEST:
            return f"types cannot be nested more than {DEEPEST} deep"
        if self.least > LARGEST:
            return f"a message cannot have more than {LARGEST} bytes"
        return ""


def measure_of(slot: Field) -> Measure:
    """Return the measure of one element of a slot."""
    if slot.definition is not None:
        return slot.definition.measure
    if slot.type == "string":
        return Measure(4, False)
    return Measure(calcsize("<" + (TIMES.get(slot.type) or PRIMITIVES[slot.type])))


def measured(fields: Iterable[Field]) -> Measure:
    """Return the measure of messages with these slots."""
    found = Measure()
    for slot in fields:
        found = found.plus(slot)
    return found
