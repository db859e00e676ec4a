"""A simple second implementation of the wire format and of event terms, as reference for tests.

A message is the list of its slot values; times are pairs; strings and byte arrays are bytes.
"""

import struct
from typing import Any, List

from hypothesis import strategies as st

from retalis import Atom, Definition, Term, atom, functor
from retalis.prolog.terms.types import CONS, NIL

CODES = {
    "bool": "?",
    "int8": "b",
    "byte": "b",
    "uint8": "B",
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
NAN = float("nan")


def serialize(definition: Any, values: Any) -> bytes:
    return b"".join(_slot(slot, value) for slot, value in zip(definition.fields, values))


def _slot(slot: Any, value: Any) -> Any:
    if slot.length is None:
        return _single(slot, value)
    if slot.type in ("uint8", "char"):
        body, number = bytes(value), len(value)
    else:
        body, number = b"".join(_single(slot, item) for item in value), len(value)
    return (struct.pack("<I", number) if slot.length < 0 else b"") + body


def _single(slot: Any, value: Any) -> Any:
    if slot.definition is not None:
        return serialize(slot.definition, value)
    if slot.type == "string":
        return struct.pack("<I", len(value)) + value
    if slot.type == "time":
        return struct.pack("<II", *value)
    if slot.type == "duration":
        return struct.pack("<ii", *value)
    return struct.pack("<" + CODES[slot.type], value)


def to_term(definition: Any, values: Any) -> Any:
    """Return the event term of a message with printable texts only."""
    name = definition.name.replace("/", "__0__")
    if not definition.fields:
        return atom(name)
    arguments: List[Any] = []
    for slot, value in zip(definition.fields, values):
        if slot.length is None:
            arguments.append(_single_term(slot, value))
        elif slot.type in ("uint8", "char"):
            arguments.append(_text(bytes(value)))
        else:
            arguments.append(_list([_single_term(slot, item) for item in value]))
    return functor(name, len(arguments))(*arguments)


def _single_term(slot: Any, value: Any) -> Any:
    if slot.definition is not None:
        return to_term(slot.definition, value)
    if slot.type == "string":
        return _text(value)
    if slot.type in ("time", "duration"):
        return _list(value)
    return atom("true" if value else "false") if slot.type == "bool" else value


def _text(value: bytes) -> Atom:
    return atom('"' + value.decode("ascii") + '"')


def _list(items: Any) -> Any:
    term: Term = NIL
    for item in reversed(items):
        term = (CONS, item, term)
    return term


def messages(definition: Definition, texts: Any = None) -> Any:
    """Return the strategy for messages of a type."""
    texts = st.binary(max_size=40) | st.text(max_size=20).map(str.encode) if texts is None else texts
    return st.tuples(*(_values(slot, texts) for slot in definition.fields)).map(list)


def _values(slot: Any, texts: Any) -> Any:
    if slot.length is None:
        return _element(slot, texts)
    low, high = (0, 7 if slot.definition is None else 2) if slot.length < 0 else (slot.length,) * 2
    if slot.type in ("uint8", "char"):
        return (
            texts.map(lambda text: text[:high].ljust(low, b" "))
            if high > 7
            else st.binary(min_size=low, max_size=high if slot.length >= 0 else 1500)
        )
    return st.lists(_element(slot, texts), min_size=low, max_size=high)


def _element(slot: Any, texts: Any) -> Any:
    if slot.definition is not None:
        return messages(slot.definition, texts)
    if slot.type == "string":
        return texts
    if slot.type in ("time", "duration"):  # genpy carries nanoseconds over a second
        low, high = (0, 2**32 - 1) if slot.type == "time" else (-(2**31), 2**31 - 1)
        return st.tuples(st.integers(low, high), st.integers(0, 999_999_999)).map(list)
    if slot.type == "bool":
        return st.booleans()
    if slot.type.startswith("float"):
        # Event text has one NaN only, so other NaNs do not survive it.
        bit_count: Any = 8 * struct.calcsize(f"<{CODES[slot.type]}")
        floats = st.floats(width=bit_count)
        return floats.map(lambda value: NAN if value != value else value)
    code = CODES[slot.type]
    bits = 8 * struct.calcsize(code)
    return (
        st.integers(0, 2**bits - 1)
        if code.isupper()
        else st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    )
