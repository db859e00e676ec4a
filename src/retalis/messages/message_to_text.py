"""Message bytes to the text of their event terms, without making the terms where their form allows it."""

import re
from itertools import groupby
from struct import calcsize
from typing import AbstractSet, Any, Callable, List, NamedTuple, Optional

from ..foundation import codegen
from ..prolog.syntax.event_text import to_text
from ..prolog.terms.types import Lazy, Term, atom
from .decoder import Decoder, FrameSource, Unsuited, Watch
from .field_values import SMALL
from .type_definition import PRIMITIVES, TIMES, Definition, Field

_EDGE = "\0"
"""Stands in texts around the source of a value; no name has it in it."""


_MAX_CACHED_FLOATS = 8
"""Floats that stand together whose text is kept, at most."""

_WHOLE = re.compile(r"(^|,)(-?[0-9]+)e")


def _with_points(text: str) -> str:
    """Return the text of floats, as Python writes them, as event text has them: with a point before an exponent."""
    return _WHOLE.sub(r"\1\2.0e", text)


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


class _Floats(NamedTuple):
    """Floats that stand together in a message.

    Attributes:
        text: the variable that has their text.
        values: the variables that have them.
        behind: whether they stand behind the texts of the message.
        start: where they stand there, or before the texts.
        stop: where they end.
        kept: the variable of what is kept of them with the frames; "" for nothing.
        place: its index among all that is kept of the message.
    """

    text: str
    values: List[str]
    behind: bool
    start: int
    stop: int
    kept: str
    place: int

    def lines(self, tail: int, first: int) -> List[str]:
        """Return the lines that make the text.

        Args:
            tail: the bytes behind the message's texts.
            first: the index of place 0 in what is known of the frames.
        """
        written = "{" + "!r},{".join(self.values) + "!r}"
        make = [f'{self.text} = f"{written}"', f'if "e" in {self.text}: {self.text} = points({self.text})']
        if not self.kept:
            return [f"  {line}" for line in make]
        start, stop = (self.start - tail, self.stop - tail) if self.behind else (self.start, self.stop)
        return [
            f"  b = data[{start}:{stop or ''}]",
            f"  if {self.kept} is not None and {self.kept}[0] == b: {self.text} = {self.kept}[1]",
            "  else:",
            *(f"    {line}" for line in make),
            f"    k[{first + self.place}] = (b, {self.text})",
        ]


class _TextSource(FrameSource):
    """Source of a function that gives the message's text, not its term.

    What is the source of a term elsewhere is its text here, with the sources of values in it. Writing a float takes
    as long as all else for its slot, and most joints of a robot only turn or stand still: of floats that stand
    together the last text is kept with the names of the frames.
    """

    def __init__(self, watch: Optional[Watch] = None) -> None:
        super().__init__(watch)
        self._floats: List[_Floats] = []

    def message(self, definition: Definition) -> str:
        name = to_text(atom(definition.functor_name))
        parts: List[str] = []
        for real, group in groupby(definition.fields, _is_float):
            slots = list(group)
            if real:
                parts.append(self._together([PRIMITIVES[one.type] for one in slots]))
            else:
                parts += map(self.slot, slots)
        return f"{name}({','.join(parts)})" if parts else name

    def _together(self, codes: List[str]) -> str:
        """Return the source of the text of floats that stand together."""
        start = calcsize("<" + self.format)
        values = [self.fixed(code) for code in codes]
        kept = self.name("b") if 1 < len(values) <= _MAX_CACHED_FLOATS else ""
        place = len(self.beside)
        if kept:
            self.beside.append(kept)
        found = _Floats(
            self.name("x"),
            values,
            bool(self.texts),
            start,
            calcsize("<" + self.format),
            kept,
            place,
        )
        self._floats.append(found)
        return _value(found.text)

    def prepare(self, tail: int) -> List[str]:
        first = len(self.texts)
        return [line for floats in self._floats for line in floats.lines(tail, first)]

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
        return self._together([code]) if code in "fd" else _value(self.fixed(code))

    def fixed_array(self, slot: Field) -> str:
        number = slot.length or 0
        if slot.is_bytes or number > SMALL or (number and slot.definition is not None):
            raise Unsuited
        one = slot._replace(length=None)
        if _is_float(one):
            return f"[{self._together([PRIMITIVES[slot.type]] * number)}]" if number else "[]"
        return f"[{','.join(self.single(one) for _ in range(number))}]"

    def only(self, element: str) -> str:
        return f"[{element}]"

    def finish(self, result: str) -> str:
        """Return an f-string: the pieces of the text by their names, and between them the values."""
        self.names["points"] = _with_points
        pieces = result.split(_EDGE)
        pieces[::2] = [self.name("p", text) for text in pieces[::2]]
        return 'f"' + "".join(f"{{{piece}}}" for piece in pieces) + '"'

    def kept(self, text: Term) -> object:
        return to_text(text)


def _is_float(slot: Field) -> bool:
    return slot.length is None and slot.type in ("float32", "float64")


def _value(source: str) -> str:
    """Return the source of a value as it stands in a text."""
    return f"{_EDGE}{source}{_EDGE}"
