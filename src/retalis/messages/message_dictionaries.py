"""Messages as dictionaries: conversion of plain Python values to event terms, and back.

Slots are keys. Messages of nested types are dictionaries, arrays are lists, byte arrays are bytes, and times and
durations are integers in nanoseconds. The node uses it for its own messages, such as those on ``/diagnostics``.
"""

from typing import Any, Dict, Mapping

from ..foundation.errors import MessageError
from ..prolog.terms import timestamps
from ..prolog.terms.byte_texts import (
    blob_atom,
    plain_text_atom,
    plain_text_bytes,
    text_atom,
    text_bytes,
)
from ..prolog.terms.list_terms import list_items, make_list
from ..prolog.terms.types import FALSE, TRUE, Term, deref, functor
from .decoder import raw_bytes
from .type_definition import FLOATS, TIMES, Definition, Field


def make_message_term(definition: Definition, values: Mapping[str, Any]) -> Term:
    """Return a message as event term; slots without a value are zero or empty.

    >>> definition = Definitions().find("std_msgs/ColorRGBA")
    >>> Engine().show(make_message_term(definition, {"r": 1.0}))
    'std_msgs__0__ColorRGBA(1.0,0.0,0.0,0.0)'

    Raises:
        MessageError: if the type has no slot of a name.
    """
    unknown_names = sorted(set(values).difference(slot.name for slot in definition.fields))
    if unknown_names:
        raise MessageError(f"{definition.name} has no slot {unknown_names[0]}")
    arguments = [_make_slot_term(slot, values.get(slot.name)) for slot in definition.fields]
    return functor(definition.functor_name, len(arguments))(*arguments)


def read_message_term(definition: Definition, term: Term) -> Dict[str, Any]:
    """Return the slots of a message.

    >>> definition = Definitions().find("std_msgs/String")
    >>> read_message_term(definition, make_message_term(definition, {"data": "hello"}))
    {'data': 'hello'}
    """
    message: Any = deref(term)
    # A message without slots is an atom.
    arguments = message[1:] if definition.fields else ()
    return {slot.name: _read_slot(slot, argument) for slot, argument in zip(definition.fields, arguments)}


def _make_slot_term(slot: Field, value: Any) -> Term:
    if slot.is_bytes:
        return blob_atom(value or bytes(max(0, slot.length or 0)))
    if slot.length is None:
        return _make_element(slot, value)
    elements = [None] * max(0, slot.length) if value is None else value
    return make_list(_make_element(slot, element) for element in elements)


def _make_element(slot: Field, value: Any) -> Term:
    if slot.definition is not None:
        return make_message_term(slot.definition, value or {})
    if slot.type == "string":
        make_atom = plain_text_atom if slot.is_plain else text_atom
        return make_atom((value or "").encode("utf-8", "surrogateescape"))
    if slot.type in TIMES:
        return make_list(timestamps.to_parts(value or 0))
    if slot.type == "bool":
        return TRUE if value else FALSE
    return float(value or 0) if slot.type in FLOATS else int(value or 0)


def _read_slot(slot: Field, term: Term) -> Any:
    term = deref(term)
    if slot.is_bytes:
        return _read_bytes(term)
    if slot.length is None:
        return _read_element(slot, term)
    return [_read_element(slot, element) for element in list_items(term) or ()]


def _read_element(slot: Field, term: Term) -> Any:
    term = deref(term)
    if slot.definition is not None:
        return read_message_term(slot.definition, term)
    if slot.type == "string":
        raw = (plain_text_bytes(term) or b"") if slot.is_plain else _read_bytes(term)
        return raw.decode("utf-8", "surrogateescape")
    if slot.type in TIMES:
        parts: Any = list_items(term) or (0, 0)
        return timestamps.from_parts(*parts)
    return term is TRUE if slot.type == "bool" else term


def _read_bytes(term: Term) -> bytes:
    data = raw_bytes(term)
    return text_bytes(term) or b"" if data is None else data
