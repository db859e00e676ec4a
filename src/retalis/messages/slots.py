"""The types that slots of messages are made of, and how large a message can be."""

from typing import Dict

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
