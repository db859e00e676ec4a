"""Encoding of event terms into CDR messages, the serialization of ROS 2; see `cdr_decoder` for the format.

`CdrEncoderGenerator` generates a function for each type, which accepts the forms that decoded events have, as
`encoder` does for ROS 1. A term of another form is encoded for ROS 1 slot by slot, which also raises the errors, and
decoded again; the result has the usual form. Messages are written in little-endian byte order, with wide characters
of four bytes, as Fast DDS and Cyclone DDS write them.

The length of the message so far is known modulo the largest alignment since the last value of variable size, so that
padding is part of the `struct` formats as far as possible.
"""

from functools import partial
from struct import Struct, pack
from struct import error as StructError
from typing import Callable, List, Optional

from ..foundation import codegen
from ..foundation.errors import MessageError
from ..prolog.terms.byte_texts import plain_text_bytes, text_bytes
from ..prolog.terms.types import ArrayDecoder, Atom, Lazy, Term
from .cdr_decoder import ENCAPSULATION_BYTES, cdr_slots
from .decoder import Decoder, find_number_decoder, raw_bytes
from .encoder import (
    FALLBACK_ERRORS,
    Encoder,
    EncoderGenerator,
    PackedTexts,
    UnusualForm,
    encode_slot_by_slot,
    list_of_usual_form,
)
from .type_definition import PRIMITIVES, TIMES, VARIABLE_LENGTH, Definition, Field

LITTLE_ENDIAN_CDR = b"\0\1\0\0"
"""Identifier of plain CDR in little-endian byte order, and two bytes of options."""

_SIGNED_SECONDS = "i"
"""Code of the seconds of a time: ROS 2 has 32 bits with a sign."""

_WriteArray = Callable[[bytearray, Term], None]
"""Function that appends the list of an array to a message."""


def _pack_text(encoded_bytes: bytes) -> bytes:
    return pack("<I", len(encoded_bytes) + 1) + encoded_bytes + b"\0"


_packed_texts = PackedTexts(_pack_text, text_bytes, 2048, 1 << 20, 1024)
_packed_plain_texts = PackedTexts(_pack_text, plain_text_bytes, 2048, 1 << 20, 1024)


def _serialize_wide(term: Term, read_bytes: Callable[[Term], Optional[bytes]] = text_bytes) -> bytes:
    encoded_bytes = read_bytes(term) if term.__class__ is Atom else raw_bytes(term)
    if encoded_bytes is None:
        raise UnusualForm
    try:
        text = encoded_bytes.decode("utf-8", "surrogatepass")
    except UnicodeDecodeError:
        raise MessageError("a wide string is not UTF-8") from None
    characters = text.encode("utf-32-le", "surrogatepass")
    return pack("<I", len(characters) // 4) + characters


class CdrEncoderGenerator(EncoderGenerator):
    """Generator of the encoding function of one message type.

    The message is a `bytearray` in the variable ``b``, to which the generated statements append.
    """

    def __init__(self) -> None:
        super().__init__()
        self._writes: List[str] = []
        """Statements that append to the message."""
        self._alignment, self._phase = 1, 0
        """The length without the encapsulation is known modulo a number: its remainder after the run."""
        self.globals.update(
            packed_text=_packed_texts.get,
            serialize_text=_packed_texts.serialize,
            serialize_wide=_serialize_wide,
            packed_plain_text=_packed_plain_texts.get,
            serialize_plain_text=_packed_plain_texts.serialize,
            serialize_plain_wide=partial(_serialize_wide, read_bytes=plain_text_bytes),
        )

    def add_from_start(self, definition: Definition, value: str) -> None:
        """Add a message that begins after the encapsulation."""
        self._alignment = 8
        self.add_message(definition, value)

    def add_message(self, definition: Definition, value: str) -> None:
        """Add a message: unpack its slots, check its functor, and add the slots."""
        if not definition.fields:
            self.check_empty_message(definition, value)
            self._add_padding(1)
            return
        variables = self.unpack_message(definition, value)
        slots = cdr_slots(definition)
        # Only the slot `seq` of a header is left out.
        for slot, variable in zip(slots, variables[len(variables) - len(slots) :]):
            self.add_slot(slot, variable)

    def add_value(self, slot: Field, value: str) -> None:
        """Add a single value of a slot's type."""
        plain = "plain_" if slot.is_plain else ""
        if slot.is_wide:
            self._append(f"serialize_{plain}wide({value})", 4)
        elif slot.type == "string" and slot.definition is None:
            self._append(f"packed_{plain}text({value}) or serialize_{plain}text({value})", 4)
        elif slot.type == "time" and slot.definition is None:
            seconds, nanoseconds = self.unpack_list(value, 2)
            self.add_to_run(_SIGNED_SECONDS, seconds)
            self.add_to_run(TIMES["time"][1], nanoseconds)
        else:
            super().add_value(slot, value)

    def add_bytes(self, slot: Field, value: str) -> None:
        """Add an array of bytes."""
        packed = f"packed({value}) or serialize({value})"
        if slot.length == VARIABLE_LENGTH:
            self._append(packed, 4)
        else:
            self._append(self.unpack_bytes(slot, value), 1)

    def add_array(self, slot: Field, value: str) -> None:
        """Add an array that is not unpacked in the generated code."""
        self._align(4 if slot.length == VARIABLE_LENGTH else 1)
        write = self.new_name("array", _compile_array_writer(slot))
        self._writes.append(f"{write}(b, {value})")
        self._restart(1)

    def add_to_run(self, code: str, value: str) -> None:
        """Add a value to the run, by its `struct` code."""
        size = Struct("<" + code).size
        if size > self._alignment:
            self._align(size)
        self._add_padding(-self._phase % size)
        self._phase = (self._phase + size) % self._alignment
        super().add_to_run(code, value)

    def _add_padding(self, size: int) -> None:
        if size:
            self.run_format += f"{size}x"
            self._phase = (self._phase + size) % self._alignment

    def end_run(self) -> None:
        """End the run: add the statement that packs it."""
        if self.run_format:
            packer = self.new_name("S", Struct("<" + self.run_format).pack)
            self._writes.append(f"b += {packer}({', '.join(self.run_values)})")
            self.run_format, self.run_values = "", []

    def _append(self, expression: str, alignment: int) -> None:
        """Append the bytes of an expression at an aligned length."""
        self._align(alignment)
        self._writes.append(f"b += {expression}")
        self._restart(1)

    def _align(self, alignment: int) -> None:
        """End the run, and pad the message."""
        if alignment <= self._alignment:
            self._add_padding(-self._phase % alignment)
            self.end_run()
            return
        self.end_run()
        paddings = self.new_name("paddings", _make_paddings(alignment))
        self._writes.append(f"b += {paddings}[len(b) % {alignment}]")
        self._restart(alignment)

    def _restart(self, alignment: int) -> None:
        self._alignment, self._phase = alignment, 0

    def generate_statements(self) -> List[str]:
        """Return the statements of the function."""
        self.end_run()
        return [*self.lines, *self.generate_type_check(), *self._writes]


def _make_paddings(alignment: int) -> List[bytes]:
    """Return the padding by the length of the message modulo an alignment, with its encapsulation."""
    return [bytes((ENCAPSULATION_BYTES - length) % alignment) for length in range(alignment)]


def _compile_array_writer(slot: Field) -> _WriteArray:
    """Return the function that appends an array, whose count, if any, is aligned."""
    decoder = find_number_decoder(slot)
    write_elements = (
        _compile_element_writer(slot)
        if decoder is None
        else _make_number_writer(PRIMITIVES[slot.type], decoder)
    )
    length = slot.length

    def write(message: bytearray, term: Term) -> None:
        count_offset = len(message)
        if length == VARIABLE_LENGTH:
            message += b"\0\0\0\0"
        count = write_elements(message, term)
        if length == VARIABLE_LENGTH:
            message[count_offset : count_offset + 4] = pack("<I", count)
        elif count != length:
            raise UnusualForm

    return write


def _compile_element_writer(slot: Field) -> Callable[[bytearray, Term], int]:
    """Return the function that appends the elements of a list, and returns their number."""
    generator = CdrEncoderGenerator()
    generator.add_value(slot._replace(length=None), "term")
    lines = ["def encode(b, term):", *("  " + line for line in generator.generate_statements())]
    write_element = codegen.function(lines, generator.globals, f"encode element {slot.type}", "encode")

    def write(message: bytearray, term: Term) -> int:
        items = list_of_usual_form(term)
        for item in items:
            write_element(message, item)
        return len(items)

    return write


def _make_number_writer(code: str, decoder: ArrayDecoder) -> Callable[[bytearray, Term], int]:
    """Return the function that appends a list of numbers, or the bytes of an array term; it returns their number."""
    size = Struct("<" + code).size
    paddings = _make_paddings(size)

    def write(message: bytearray, term: Term) -> int:
        if term.__class__ is Lazy and term.decoder is decoder:
            encoded_bytes = term.source
            count = len(encoded_bytes) // size
        else:
            items = list_of_usual_form(term)
            count = len(items)
            encoded_bytes = pack(f"<{count}{code}", *items)
        # An array without elements has no padding.
        if count:
            message += paddings[len(message) % size]
            message += encoded_bytes
        return count

    return write


class CdrEncoder(Encoder):
    """The encoder of one message type into CDR; see `Encoder`."""

    __slots__ = ()

    def _compile_encode(self) -> Callable[..., bytes]:
        return _compile_encoder(self.definition)


def _compile_encoder(definition: Definition) -> Callable[..., bytes]:
    generator = CdrEncoderGenerator()
    generator.add_from_start(definition, "term")
    lines = [
        "def encode(term):",
        "  b = bytearray(encapsulation)",
        *("  " + line for line in generator.generate_statements()),
        "  return bytes(b)",
    ]
    generator.globals.update(encapsulation=LITTLE_ENDIAN_CDR, bytearray=bytearray, bytes=bytes)
    encode_usual_form: Callable[[Term], bytes] = codegen.function(
        lines, generator.globals, f"encode {definition.name}", "encode"
    )
    decode = Decoder(definition).decode

    def encode(term: Term, topic: str = "") -> bytes:
        try:
            return encode_usual_form(term)
        except FALLBACK_ERRORS:
            usual_form = decode(encode_slot_by_slot(definition, term, topic))
        try:
            return encode_usual_form(usual_form)
        except StructError:
            reason = "expected a time before 2038-01-19, the last one of ROS 2"
        except MessageError as error:
            reason = error.message
        raise MessageError(f"{f'topic {topic}, ' if topic else ''}{definition.name}: {reason}")

    return encode
