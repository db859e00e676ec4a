"""Serialized messages as the text of their event terms, without building the terms if the type allows it.

The interface node sends events to node ``retalis`` as text. For the layout "numbers, strings, numbers" (see
`decoder`) a function is generated that formats the unpacked values with one f-string; strings are cached as text.
Formatting a float costs as much as everything else for its slot, and most joints of a robot rest or only turn.
Therefore the text of consecutive floats is cached with the frame names, and reused while their bytes are unchanged.
"""

import re
from itertools import groupby
from struct import calcsize
from typing import AbstractSet, Any, Callable, List, NamedTuple, Optional

from ..foundation import codegen
from ..prolog.syntax.event_text import to_text
from ..prolog.terms.array_terms import MAX_EAGER_ELEMENTS
from ..prolog.terms.types import Lazy, Term, atom
from .decoder import Decoder, FrameDecoderGenerator, StampWatch, UnsupportedLayout
from .type_definition import FLOATS, PRIMITIVES, TIMES, Definition, Field, SerializationFormat

_VALUE_DELIMITER = "\0"
"""Delimiter around the source of a value in a text; it occurs in no name."""


_MAX_CACHED_FLOATS = 8
"""Maximum length of a sequence of floats whose text is cached."""

_WHOLE_MANTISSA = re.compile(r"(^|,)(-?[0-9]+)e")
"""A float with an exponent and without a decimal point."""


def _with_decimal_points(text: str) -> str:
    """Return the text of Python floats in event syntax, which requires a decimal point before an exponent."""
    return _WHOLE_MANTISSA.sub(r"\1\2.0e", text)


def make_text_writer(decoder: Decoder) -> Callable[[bytes], str]:
    """Return the function from the bytes of a message to the text of its event term.

    Types that `FrameDecoderGenerator` does not support are decoded, and the term is written. The function raises
    `MessageError` like the decoder, and calls the decoder's observer of stamps.
    """

    def write_decoded(data: bytes) -> str:
        return to_text(decoder.decode(data))

    if decoder.format is not SerializationFormat.ROS1:
        return write_decoded
    generator = _TextGenerator(decoder.watch)
    try:
        lines = generator.generate(decoder.definition, write_decoded)
    except UnsupportedLayout:
        return write_decoded
    write: Callable[[bytes], str] = codegen.function(
        lines, generator.globals, f"text of {decoder.definition.name}", "decode"
    )
    return write


def write_without_unread(decoder: Decoder, data: bytes, positions: AbstractSet[int], marker: Term) -> str:
    """Return the text of a message in which long values of unread slots are replaced by a marker.

    Args:
        decoder: decoder of the message's type.
        data: bytes of the message.
        positions: slots that no rule reads, counted from 1.
        marker: marker that replaces their values.

    Raises:
        MessageError: if the bytes are not a message of this type.
    """
    term: Any = decoder.decode(data)
    slots = decoder.definition.fields
    # Replaced only if long: the marker itself takes more characters than a number.
    arguments = [
        marker if position in positions and _is_long(slot, value) else value
        for position, (slot, value) in enumerate(zip(slots, term[1:]), 1)
    ]
    return to_text((term[0], *arguments))


def _is_long(slot: Field, value: Term) -> bool:
    """Return whether a slot is an array or a string that is worth omitting."""
    return (slot.length is not None or slot.type == "string") and value.__class__ in (Lazy, tuple)


class _Floats(NamedTuple):
    """Consecutive floats of a message.

    Attributes:
        text: variable that holds their text.
        values: variables that hold their values.
        follows_strings: whether they follow the strings of the message.
        start: offset of the first byte, in the numbers before or after the strings.
        end: offset of the end.
        cache_variable: variable of the cached pair of bytes and text; "" if they are not cached.
        cache_index: index of that pair among the values that are cached for the message.
    """

    text: str
    values: List[str]
    follows_strings: bool
    start: int
    end: int
    cache_variable: str
    cache_index: int

    def update_statements(self, tail_size: int, first_index: int) -> List[str]:
        """Return the statements that compute the text.

        Args:
            tail_size: number of bytes after the message's strings.
            first_index: index of the first such pair in the cached entry.
        """
        float_format = "{" + "!r},{".join(self.values) + "!r}"
        format_lines = [
            f'{self.text} = f"{float_format}"',
            f'if "e" in {self.text}: {self.text} = points({self.text})',
        ]
        if not self.cache_variable:
            return [f"  {line}" for line in format_lines]
        cached = self.cache_variable
        # Offsets after the strings are counted from the end, because the strings' length varies.
        start, end = (
            (self.start - tail_size, self.end - tail_size) if self.follows_strings else (self.start, self.end)
        )
        return [
            f"  b = data[{start}:{end or ''}]",
            f"  if {cached} is not None and {cached}[0] == b: {self.text} = {cached}[1]",
            "  else:",
            *(f"    {line}" for line in format_lines),
            f"    k[{first_index + self.cache_index}] = (b, {self.text})",
        ]


class _TextGenerator(FrameDecoderGenerator):
    """Generator of a function that returns the message's text instead of its term.

    Methods that return the expression of a term in the base class return its text here, with the expressions of
    values between delimiters.
    """

    def __init__(self, watch: Optional[StampWatch] = None) -> None:
        super().__init__(watch)
        self._floats: List[_Floats] = []

    def read_message(self, definition: Definition) -> str:
        name = to_text(atom(definition.functor_name))
        slot_texts: List[str] = []
        for is_float, group in groupby(definition.fields, _is_float):
            slots = list(group)
            if is_float:
                slot_texts.append(self._add_floats([PRIMITIVES[slot.type] for slot in slots]))
            else:
                slot_texts += map(self.read_slot, slots)
        return f"{name}({','.join(slot_texts)})" if slot_texts else name

    def _add_floats(self, codes: List[str]) -> str:
        """Add consecutive floats, by their `struct` codes; return the source of their text."""
        start = calcsize("<" + self.run_format)
        values = [self.add_to_run(code) for code in codes]
        # Comparing bytes costs as much as formatting one float. Long sequences rarely stay unchanged as a whole.
        cache_variable = self.new_name("b") if 1 < len(values) <= _MAX_CACHED_FLOATS else ""
        cache_index = len(self.cached_variables)
        if cache_variable:
            self.cached_variables.append(cache_variable)
        floats = _Floats(
            self.new_name("x"),
            values,
            bool(self.string_variables),
            start,
            calcsize("<" + self.run_format),
            cache_variable,
            cache_index,
        )
        self._floats.append(floats)
        return _delimit(floats.text)

    def generate_text_updates(self, tail_size: int) -> List[str]:
        first_index = len(self.string_variables)
        return [line for floats in self._floats for line in floats.update_statements(tail_size, first_index)]

    def read_value(self, slot: Field) -> str:
        if slot.definition is not None:
            return self.read_message(slot.definition)
        if slot.type == "string":
            return _delimit(self.read_string(slot))
        if slot.type in TIMES:
            code = TIMES[slot.type][0]
            return f"[{_delimit(self.add_to_run(code))},{_delimit(self.add_to_run(code))}]"
        code = PRIMITIVES[slot.type]
        # A boolean is written as an atom, and characters are bytes: neither is the value's own text.
        if code in "?c":
            raise UnsupportedLayout
        return self._add_floats([code]) if slot.type in FLOATS else _delimit(self.add_to_run(code))

    def read_fixed_array(self, slot: Field) -> str:
        length = slot.length or 0
        if slot.is_bytes or length > MAX_EAGER_ELEMENTS or (length and slot.definition is not None):
            raise UnsupportedLayout
        element = slot._replace(length=None)
        if _is_float(element):
            return f"[{self._add_floats([PRIMITIVES[slot.type]] * length)}]" if length else "[]"
        return f"[{','.join(self.read_value(element) for _ in range(length))}]"

    def format_single_element_list(self, element: str) -> str:
        return f"[{element}]"

    def finish_expression(self, result: str) -> str:
        """Return an f-string that inserts the constant texts by name, and the values between them."""
        self.globals["points"] = _with_decimal_points
        # Texts are bound to names instead of being part of the f-string: they may contain braces, quotes, or any
        # other character.
        pieces = result.split(_VALUE_DELIMITER)
        pieces[::2] = [self.new_name("p", text) for text in pieces[::2]]
        return 'f"' + "".join(f"{{{piece}}}" for piece in pieces) + '"'

    def to_cached_value(self, text: Term) -> object:
        return to_text(text)


def _is_float(slot: Field) -> bool:
    return slot.length is None and slot.type in FLOATS


def _delimit(source: str) -> str:
    """Return the source of a value in the text."""
    return f"{_VALUE_DELIMITER}{source}{_VALUE_DELIMITER}"
