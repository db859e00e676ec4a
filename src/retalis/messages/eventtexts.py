"""Message bytes to the text of their event terms, without making the terms where their form allows it."""

from typing import AbstractSet, Any, Callable

from ..foundation import codegen
from ..prolog.syntax import float_text, to_text
from ..prolog.terms import Lazy, Term, atom
from .arrays import SMALL
from .decoding import Decoder
from .definition import Definition, Field
from .frame_code import FrameSource, Unsuited
from .slots import PRIMITIVES, TIMES

_EDGE = "\0"
"""Stands in texts around the source of a value; no name has it in it."""


def text_writer(decoder: Decoder) -> Callable[[bytes], str]:
    """Return the function from the bytes of a message to the text of its event term.

    Messages that are numbers, then texts, then numbers are written by the text of their type with the values
    put in; of others the term is made and written. The function raises `MessageError` as the decoder does, and has
    stamps looked at where that does.
    """

    def general(data: bytes) -> str:
        return to_text(decoder.decode(data))

    code = _TextSource(decoder.watch)
    try:
        lines = code.build(decoder.definition, general)
    except Unsuited:
        return general
    made: Callable[[bytes], str] = codegen.function(
        lines, code.names, f"text of {decoder.definition.name}", "decode"
    )
    return made


def text_without(decoder: Decoder, data: bytes, positions: AbstractSet[int], mark: Term) -> str:
    """Return the text of a message with a mark in the place of long arrays and texts that nobody reads.

    Args:
        decoder: of its type.
        data: its bytes.
        positions: the slots that nobody reads, counted from 1.
        mark: what stands there instead.

    Raises:
        MessageError: where the bytes are no such message.
    """
    term: Any = decoder.decode(data)
    slots = decoder.definition.fields
    parts = [
        mark if at in positions and _is_long(slot, value) else value
        for at, (slot, value) in enumerate(zip(slots, term[1:]), 1)
    ]
    return to_text((term[0], *parts))


def _is_long(slot: Field, value: Term) -> bool:
    """Tell whether a slot is an array or a text that is worth leaving out."""
    return (slot.length is not None or slot.type == "string") and value.__class__ in (Lazy, tuple)


class _TextSource(FrameSource):
    """Source of a function that gives the message's text, not its term.

    What is the source of a term elsewhere is its text here, with the sources of values in it.
    """

    def message(self, definition: Definition) -> str:
        name = to_text(atom(definition.functor_name))
        return f"{name}({','.join(map(self.slot, definition.fields))})" if definition.fields else name

    def single(self, slot: Field) -> str:
        if slot.definition is not None:
            return self.message(slot.definition)
        if slot.type == "string":
            return _value(self.string())
        if slot.type in TIMES:
            code = TIMES[slot.type][0]
            return f"[{_value(self.fixed(code))},{_value(self.fixed(code))}]"
        code = PRIMITIVES[slot.type]
        if code in "?c":  # not the value itself stands in the term
            raise Unsuited
        value = self.fixed(code)
        return _value(f"real({value})" if code in "fd" else value)

    def fixed_array(self, slot: Field) -> str:
        number = slot.length or 0
        if slot.is_bytes or number > SMALL or (number and slot.definition is not None):
            raise Unsuited
        return f"[{','.join(self.single(slot._replace(length=None)) for _ in range(number))}]"

    def only(self, element: str) -> str:
        return f"[{element}]"

    def finish(self, result: str) -> str:
        """Return an f-string: the pieces of the text by their names, and between them the values."""
        self.names["real"] = float_text
        pieces = result.split(_EDGE)
        pieces[::2] = [self.name("p", text) for text in pieces[::2]]
        return 'f"' + "".join(f"{{{piece}}}" for piece in pieces) + '"'

    def kept(self, text: Term) -> object:
        return to_text(text)


def _value(source: str) -> str:
    """Return the source of a value as it stands in a text."""
    return f"{_EDGE}{source}{_EDGE}"
