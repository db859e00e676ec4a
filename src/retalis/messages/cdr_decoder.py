"""Decoding of CDR messages, the serialization of ROS 2, into event terms.

CDR (OMG, Common Object Request Broker Architecture, 9.3; "plain CDR", which ROS 2 uses) differs from the format of
ROS 1 in these points, which `CdrDecoderGenerator` implements on top of `DecoderGenerator`:

* Four bytes precede a message and state its byte order. Offsets below are those in the bytes including these four.
* Each number is aligned to its size, counted from the end of the four bytes. While a function is generated, the
  offset is known modulo the largest alignment since the last value of variable size. Padding is part of the `struct`
  format as long as that suffices; otherwise the generated code aligns the offset, and a new run begins.
* A string ends in a zero byte, which its length includes. A type without slots has one byte.
* A header has no ``seq``: events have the number 0.

A ``wstring`` is a count and as many characters, without a zero at the end. Fast DDS and Cyclone DDS write characters
in four bytes, other implementations in two, and the message does not encode the width. Four bytes are tried first,
then two.
"""

from array import array
from struct import Struct
from struct import error as StructError
from typing import Any, Callable, Dict, List, Optional, Tuple

from ..foundation import codegen
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError
from ..prolog.terms.byte_texts import plain_text_atom, text_atom
from ..prolog.terms.types import Term, atom
from .decoder import (
    Decode,
    Decoder,
    DecoderGenerator,
    FrameDecoderGenerator,
    StampWatch,
    UnsupportedLayout,
    cache_text,
    compile_frame_decoder_or,
    create_text_cache,
    find_number_decoder,
    has_header,
    plain_text_term,
    slice_text,
    text_term,
)
from .type_definition import (
    HEADER,
    PRIMITIVES,
    TIMES,
    VARIABLE_LENGTH,
    Definition,
    Field,
    SerializationFormat,
)

ENCAPSULATION_BYTES = 4
"""Number of bytes before a message, which state its encoding."""

MAX_SECONDS = (1 << 31) - 1
"""Largest second of a time: ROS 2 has 32 bits with a sign, ROS 1 without, and negative times have no event form."""

MAX_PADDING_BYTES = 3
"""Maximum number of bytes after a message: some implementations pad messages to a multiple of four bytes."""

BYTE_ORDERS = {b"\0\0": ">", b"\0\1": "<"}
"""`struct` prefixes by representation identifier. Parameter-list CDR and XCDR2 have others, and other layouts."""

_LITTLE_ENDIAN = 0x0100
"""Representation identifier of little-endian messages, read as a little-endian number."""

_UNSIGNED_CODES = {2: "H", 4: "I", 8: "Q"}

_WIDE_CHARACTER_BYTES = (4, 2)

_cached_texts: Cache[bytes, Term] = create_text_cache()
"""Terms of short strings, by their bytes including the zero at the end."""

_cached_plain_texts: Cache[bytes, Term] = create_text_cache()
"""Terms of short strings in the plain form, by their bytes including the zero at the end."""


class NegativeTimeError(ValueError):
    """A time before 1970."""

    def __init__(self, *seconds: int):
        second = next(value for value in seconds if value > MAX_SECONDS)
        super().__init__(f"a time of {second - (1 << 32)} s: expected at least 0 s")


def align(offset: str, alignment: int) -> str:
    """Return the expression of an offset after padding.

    Args:
        offset: expression of the offset in the message, including the four bytes before it.
        alignment: 2, 4 or 8.
    """
    # The four bytes shift multiples of eight, but not those of two and four.
    shift = ENCAPSULATION_BYTES % alignment
    if shift:
        return f"({offset} + {alignment - 1 - shift} & -{alignment}) + {shift}"
    return f"({offset} + {alignment - 1} & -{alignment})"


def aligned_offset(offset: int, alignment: int) -> int:
    """Return an offset after padding; see `align`."""
    return offset + (ENCAPSULATION_BYTES - offset) % alignment


def _natural_alignment(code: str) -> int:
    """Return the alignment of a value, given its `struct` code: that of its size, and none for bytes."""
    return 1 if code[-1] == "s" else Struct("<" + code).size


def number_layout(slot: Field) -> Optional[Tuple[str, int]]:
    """Return the `struct` codes and the common size of the numbers in an element; None if it has anything else.

    Elements of numbers of one size follow one another without padding.
    """
    if slot.definition is None:
        code = PRIMITIVES.get(slot.type)
        return None if code is None else (code, Struct("<" + code).size)
    layouts = (
        [] if slot.definition.name == HEADER else [_slot_layout(inner) for inner in slot.definition.fields]
    )
    sizes = {None if layout is None else layout[1] for layout in layouts}
    if len(sizes) != 1 or None in sizes:
        return None
    return "".join(layout[0] for layout in layouts if layout is not None), next(filter(None, sizes))


def _slot_layout(slot: Field) -> Optional[Tuple[str, int]]:
    layout = number_layout(slot)
    if layout is None or slot.length is None:
        return layout
    return (layout[0] * slot.length, layout[1]) if slot.length > 0 else None


def cdr_slots(definition: Definition) -> Tuple[Field, ...]:
    """Return the slots that a message has in CDR: those of the type, without ``seq`` of a header."""
    return definition.fields[1:] if definition.name == HEADER else definition.fields


def list_slot_types(definition: Definition) -> List[Tuple[Any, ...]]:
    """Return the types of the slots in CDR, without their names: types with equal lists have equal messages."""
    return [
        (
            slot.length,
            slot.is_wide,
            # A `byte` has a sign in ROS 1 only, which its bits do not show.
            {"byte": "uint8", "char": "uint8"}.get(slot.type, slot.type)
            if slot.definition is None
            else list_slot_types(slot.definition),
        )
        for slot in cdr_slots(definition)
    ]


def _has_wide_strings(definition: Definition) -> bool:
    types = (definition, *definition.dependencies())
    return any(slot.is_wide for message_type in types for slot in message_type.fields)


class CdrDecoderGenerator(DecoderGenerator):
    """Generator of the decoding function of one message type in one byte order.

    Args:
        byte_order: byte order, as a `struct` prefix.
        character_bytes: bytes of a wide character.
    """

    def __init__(self, byte_order: str, character_bytes: int):
        super().__init__()
        self.byte_order = byte_order
        self._character_bytes = character_bytes
        self._alignment = 1
        """The offset of the run's end is known modulo this number."""
        self._phase = 0
        """Offset of the run's end modulo `_alignment`, counted from the end of the encapsulation."""
        self._seconds: List[str] = []
        """Variables of the run that are seconds of times."""
        self.globals.update(
            known=_cached_texts.get,
            read_text=_read_text,
            known_plain=_cached_plain_texts.get,
            read_plain_text=_read_plain_text,
            NegativeTimeError=NegativeTimeError,
        )

    def read_from_start(self, definition: Definition) -> str:
        """Return the expression of a message that begins after the encapsulation."""
        self.run_base = str(ENCAPSULATION_BYTES)
        self._alignment = 8
        return self.read_message(definition)

    def read_message(self, definition: Definition) -> str:
        """Return the expression of a whole message."""
        if not definition.fields:
            self._add_padding(1)
            return self.constant(atom(definition.functor_name))
        functor_name = self.functor_constant(definition)
        slots = [self.read_slot(slot) for slot in cdr_slots(definition)]
        if definition.name == HEADER:
            slots = ["0", *slots]
        return f"({functor_name}, {', '.join(slots)})"

    def read_value(self, slot: Field) -> str:
        """Return the expression of one value of a slot."""
        if slot.is_wide:
            return self._read_wide_string(slot)
        if slot.type in TIMES:
            seconds, nanoseconds = self.add_to_run(TIMES[slot.type][0]), self.add_to_run(TIMES[slot.type][1])
            if slot.type == "time":
                self._seconds.append(seconds)
            return f"(C, {seconds}, (C, {nanoseconds}, N))"
        return super().read_value(slot)

    def _read_wide_string(self, slot: Field) -> str:
        self.end_run()
        value = self.new_name("t")
        make_atom = plain_text_atom if slot.is_plain else text_atom
        reader = _make_wide_string_reader(self.byte_order, self._character_bytes, make_atom)
        read = self.new_name("wide", reader)
        self.lines.append(f"{value}, o = {read}(data, {align(self.run_offset(), 4)})")
        self._restart("o", 1)
        return value

    # Arrays of elements of equal size.

    def element_size(self, slot: Field) -> Optional[int]:
        """Return the number of bytes from one element to the next, or None if it varies or needs checks."""
        layout = number_layout(slot)
        return None if layout is None else Struct("<" + layout[0]).size

    def add_elements_to_run(self, slot: Field, size: int) -> str:
        """Add the bytes of all elements of a slot to the run; return the expression of these bytes."""
        return self._swap_numbers(slot, self.add_to_run(f"{size}s", self._element_alignment(slot)))

    def advance_over_elements(self, slot: Field, count: str, size: int) -> str:
        """Advance over ``count`` elements of ``size`` bytes; return the expression of their bytes."""
        alignment = self._element_alignment(slot)
        start = self.run_offset()
        self.lines.append(f"s = {start}")
        # The count before the elements is aligned to four bytes. Without elements, there is no padding.
        if alignment > self._alignment or self._phase % alignment:
            self.lines.append(f"if {count}: s = {align('s', alignment)}")
        self.lines.append(f"o = s + {count} * {size}")
        self._restart("o", min(alignment, 4))
        return self._swap_numbers(slot, "data[s:o]")

    @staticmethod
    def _element_alignment(slot: Field) -> int:
        layout = number_layout(slot)
        return 1 if layout is None else layout[1]

    def _swap_numbers(self, slot: Field, data: str) -> str:
        """Return the expression of the bytes of an array in the byte order of its decoder."""
        if self.byte_order == "<" or find_number_decoder(slot) is None or self._element_alignment(slot) == 1:
            return data
        swap = self.new_name("swap", _make_byte_swap(self._element_alignment(slot)))
        return f"{swap}({data})"

    def create_element_generator(self) -> "CdrDecoderGenerator":
        """Return a generator for one element of an array."""
        return CdrDecoderGenerator(self.byte_order, self._character_bytes)

    def min_element_size(self, slot: Field) -> int:
        """Return the minimum size of an element in bytes, which no type exceeds on all paths."""
        return 1

    # Runs of slots of fixed size.

    def add_to_run(self, code: str, alignment: int = 0) -> str:
        """Add a value to the run, by its `struct` code and its alignment; return the variable that holds it."""
        size = Struct("<" + code).size
        alignment = alignment or _natural_alignment(code)
        if alignment > self._alignment:
            self._align(alignment)
        self._add_padding(-self._phase % alignment)
        self._phase = (self._phase + size) % self._alignment
        return super().add_to_run(code)

    def _add_padding(self, size: int) -> None:
        if size:
            self.run_format += f"{size}x"
            self._phase = (self._phase + size) % self._alignment

    def _align(self, alignment: int) -> None:
        """Begin a new run at the next aligned offset."""
        self.end_run()
        self.lines.append(f"o = {align(self.run_offset(), alignment)}")
        self._restart("o", alignment)

    def _restart(self, base: str, alignment: int) -> None:
        """Begin a new run at an offset that is a multiple of a number, counted from the encapsulation's end."""
        self.run_base, self.run_shift = base, 0
        self._alignment, self._phase = alignment, 0

    def end_run(self) -> None:
        """End the run: add the statement that unpacks it, and the check of its times."""
        if not self.run_variables and self.run_format:
            # Padding only; the final comparison of offset and length covers it.
            self.run_shift += Struct(self.byte_order + self.run_format).size
            self.run_format = ""
        super().end_run()
        if self._seconds:
            condition = " or ".join(f"{seconds} > {MAX_SECONDS}" for seconds in self._seconds)
            self.lines.append(f"if {condition}: raise NegativeTimeError({', '.join(self._seconds)})")
            self._seconds = []

    def advance(self, size: str) -> None:
        """Set ``s`` and ``o`` to the start and the end of the next ``size`` bytes."""
        super().advance(size)
        self._restart("o", 1)

    def read_elements(self, slot: Field, count: str) -> str:
        """Return the expression of an array whose elements differ in size."""
        value = super().read_elements(slot, count)
        self._restart("o", 1)
        return value


def _read_text(data: bytes, start: int, stop: int) -> Term:
    """Return the string between two offsets of a message, which is not in the cache, and cache it."""
    raw = slice_text(data, start, stop)
    return cache_text(_cached_texts, raw, text_term(_strip_zero(raw)))


def _read_plain_text(data: bytes, start: int, stop: int) -> Term:
    """Return the string between two offsets in the plain form; see `_read_text`."""
    raw = slice_text(data, start, stop)
    return cache_text(_cached_plain_texts, raw, plain_text_term(_strip_zero(raw)))


def _strip_zero(raw: bytes) -> bytes:
    # Some implementations omit the zero of an empty string.
    return raw[:-1] if raw.endswith(b"\0") else raw


def _make_wide_string_reader(
    byte_order: str, character_bytes: int, make_atom: Callable[[bytes], Term]
) -> Callable[[bytes, int], Tuple[Term, int]]:
    """Return the function that reads a wide string at an aligned offset."""
    unpack_count = Struct(f"{byte_order}I").unpack_from
    suffix = {"<": "le", ">": "be"}[byte_order]
    encoding, code_units = f"utf-{8 * character_bytes}-{suffix}", f"utf-16-{suffix}"

    def read(data: bytes, offset: int) -> Tuple[Term, int]:
        start = offset + 4
        end: int = start + character_bytes * unpack_count(data, offset)[0]
        if end > len(data):
            raise StructError
        text = data[start:end].decode(encoding, "surrogatepass")
        # Characters of four bytes are code units of UTF-16, too: a surrogate pair is one character.
        text = text.encode(code_units, "surrogatepass").decode(code_units, "surrogatepass")
        return make_atom(text.encode("utf-8", "surrogatepass")), end

    return read


def _make_byte_swap(size: int) -> Callable[[bytes], bytes]:
    """Return the function that reverses the byte order of numbers of ``size`` bytes."""
    code = _UNSIGNED_CODES[size]

    def swap(data: bytes) -> bytes:
        # A truncated array is detected at the end of the message.
        numbers = array(code, data[: len(data) // size * size])
        numbers.byteswap()
        return numbers.tobytes()

    return swap


class CdrFrameDecoderGenerator(FrameDecoderGenerator, CdrDecoderGenerator):
    """Generator of decoding functions for little-endian messages of numbers, then strings, then numbers."""

    def __init__(self, watch: Optional[StampWatch] = None) -> None:
        # Generators with a wide string raise `UnsupportedLayout`, so their characters have any width.
        CdrDecoderGenerator.__init__(self, "<", _WIDE_CHARACTER_BYTES[0])
        self._initialize_frames(watch)
        self._encoding = ""
        """Variable of the representation identifier."""
        self._tail_alignment = 1
        self._times: List[str] = []
        """Variables of all seconds of times in the leading numbers."""
        self.globals["unpack_count"] = Struct("<I").unpack_from

    def read_message(self, definition: Definition) -> str:
        """Return the expression of a whole message."""
        if not self._encoding:
            self._restart("0", 8)
            self._encoding = self.add_to_run("H")
            # The rest of the encapsulation. From its end on, offsets count as multiples of eight.
            self.run_format += "2x"
            self._phase = 0
        return super().read_message(definition)

    def read_value(self, slot: Field) -> str:
        """Return the expression of one value of a slot."""
        if slot.is_wide:
            raise UnsupportedLayout
        return super().read_value(slot)

    def read_string(self, slot: Field) -> str:
        """Add a string; all strings of the message must be adjacent, and have the same form."""
        if not self.string_variables:
            self._add_padding(-self._phase % 4)
            self._times, self._seconds = self._seconds, []
        return super().read_string(slot)

    def add_to_run(self, code: str, alignment: int = 0) -> str:
        """Add a value to the run, by its `struct` code; return the variable that holds it."""
        alignment = alignment or _natural_alignment(code)
        if self.string_variables and not self.run_format:
            self._tail_alignment = alignment
            self._restart("0", alignment)
        elif alignment > self._alignment:
            # The padding before this value would depend on the lengths of the strings.
            raise UnsupportedLayout
        return super().add_to_run(code, alignment)

    def mismatch_conditions(self) -> List[str]:
        """Return conditions of the leading numbers under which a message does not have the layout."""
        return [
            f"{self._encoding} != {_LITTLE_ENDIAN}",
            *super().mismatch_conditions(),
            *(f"{seconds} > {MAX_SECONDS}" for seconds in self._times),
        ]

    def generate(self, definition: Definition, fallback: Callable[[bytes], object]) -> List[str]:
        """Return the source of the whole function; see `FrameDecoderGenerator.generate`."""
        lines = super().generate(definition, fallback)
        if self._seconds:
            # A time after the strings is checked too late for the fallback.
            raise UnsupportedLayout
        return lines

    def stamp_format(self) -> str:
        """Return the `struct` codes up to the nanoseconds of a stamp at the beginning."""
        # The representation identifier is in the place of ``seq``, so the index of the seconds is that of ROS 1.
        return "H2x" + "I" * (self.stamp_index() + 1)

    def key_statements(self, head_size: int, tail_size: int) -> List[str]:
        """Return the statements that set ``key`` to the bytes of the strings, and ``o`` to the end of their padding.

        The padding is left out, because some implementations do not clear it.
        """
        lines = [
            f"count, = unpack_count(data, {head_size})",
            f"o = {head_size + 4} + count",
            f"key = data[{head_size}:o]",
        ]
        for _ in self.string_variables[1:]:
            lines += [
                f"s = {align('o', 4)}",
                "count, = unpack_count(data, s)",
                "o = s + 4 + count",
                "key += data[s:o]",
            ]
        if self._tail_alignment > 1:
            lines.append(f"o = {align('o', self._tail_alignment)}")
        # Strings that are cut short are not looked up.
        excess = f"len(data) - o - {tail_size}" if tail_size else "len(data) - o"
        return [*lines, f"if not 0 <= {excess} <= {MAX_PADDING_BYTES}: return fallback(data)"]

    def tail_offset(self, tail_size: int) -> str:
        """Return the expression of the offset of the numbers after the strings."""
        return "o"

    def read_strings(self, key: bytes) -> Optional[Tuple[Term, ...]]:
        """Return the strings in a key; None if a string has no zero at its end."""
        terms: List[Term] = []
        offset = 0
        for _ in self.string_variables:
            end = offset + 4 + int.from_bytes(key[offset : offset + 4], "little")
            if key[offset + 4 : end][-1:] != b"\0":
                return None
            terms.append(self.make_text(key[offset + 4 : end - 1]))
            offset = end
        return tuple(terms)


class CdrDecoder(Decoder):
    """The decoder of one message type in CDR; see `Decoder`."""

    __slots__ = ()

    format = SerializationFormat.CDR
    frame_generator = CdrFrameDecoderGenerator

    def _compile_decode(self, max_empty_elements: int) -> Decode:
        # A type without slots has a byte in CDR, so the size of a message limits the number of such elements.
        return compile_frame_decoder_or(_compile_general_decode(self.definition), self)

    def _compile_stamp(self) -> Callable[[bytes], Optional[int]]:
        return _compile_stamp(self.definition)


def _compile_general_decode(definition: Definition) -> Decode:
    """Return the decoding function for any layout, byte order and width of characters."""
    # A message does not say how wide its characters are: the first width that consumes all bytes is right.
    widths = _WIDE_CHARACTER_BYTES if _has_wide_strings(definition) else _WIDE_CHARACTER_BYTES[:1]
    decoders: Dict[bytes, List[Decode]] = {}

    def decode(data: bytes) -> Term:
        encoding = data[:2]
        if encoding not in decoders:
            byte_order = _byte_order_of(definition, data)
            decoders[encoding] = [_compile_with_width(definition, byte_order, width) for width in widths]
        negative_time: Optional[NegativeTimeError] = None
        for decode_with_width in decoders[encoding]:
            try:
                return decode_with_width(data)
            except (StructError, UnicodeDecodeError):
                continue
            except NegativeTimeError as error:
                negative_time = error
        if negative_time is not None:
            raise MessageError(f"a {definition.name} has {negative_time}")
        # Recorders write an empty definition for a type that they do not find.
        advice = (
            "" if definition.fields else ": its definition is empty; --msg of retalis bag adds another one"
        )
        raise MessageError(
            f"{len(data) - ENCAPSULATION_BYTES} bytes of CDR are not a {definition.name}{advice}"
        )

    return decode


def _byte_order_of(definition: Definition, data: bytes) -> str:
    """Return the byte order of a message, as a `struct` prefix.

    Raises:
        MessageError: if the message is not plain CDR.
    """
    byte_order = BYTE_ORDERS.get(bytes(data[:2]))
    if byte_order is None or len(data) < ENCAPSULATION_BYTES:
        raise MessageError(not_plain_cdr(definition.name, data))
    return byte_order


def not_plain_cdr(type_name: str, data: bytes) -> str:
    """Return the error text for a message with another representation identifier."""
    return (
        f"a message of {type_name} is not plain CDR: expected 00 00 or 00 01 at its beginning, "
        f"found {data[:2].hex(' ') or 'nothing'}"
    )


def _compile_with_width(definition: Definition, byte_order: str, character_bytes: int) -> Decode:
    """Return the decoding function for one byte order and width; it raises `struct.error` for other messages."""
    generator = CdrDecoderGenerator(byte_order, character_bytes)
    result = generator.read_from_start(definition)
    generator.end_run()
    lines = [
        "def decode(data):",
        *("  " + line for line in generator.lines),
        f"  end = {generator.run_offset()}",
        f"  if not end <= len(data) <= {_make_max_size(definition)}: raise StructError",
        f"  return {result}",
    ]
    decode: Decode = codegen.function(lines, generator.globals, f"decode {definition.name}", "decode")
    return decode


def _make_max_size(definition: Definition) -> str:
    """Return the expression of the maximum size of a message whose slots end at the offset ``end``.

    The serialization functions of rclpy and rclcpp reserve four bytes for the padding of each array of eight-byte
    numbers, also for an empty one, which has none. They return the unused bytes, too: such messages are in bags that
    programs write with these functions.
    """
    types = (definition, *definition.dependencies())
    may_be_longer = any(
        slot.length == VARIABLE_LENGTH and (number_layout(slot) or ("", 0))[1] == 8
        for message_type in types
        for slot in message_type.fields
    )
    return "2 * end" if may_be_longer else f"end + {MAX_PADDING_BYTES}"


def _compile_stamp(definition: Definition) -> Callable[[bytes], Optional[int]]:
    """Return the function that reads the time of a message's header."""
    if not has_header(definition):
        return lambda data: None
    readers = {encoding: Struct(order + "II").unpack_from for encoding, order in BYTE_ORDERS.items()}

    def read_stamp(data: bytes) -> Optional[int]:
        try:
            seconds, nanoseconds = readers[data[:2]](data, ENCAPSULATION_BYTES)
        except (KeyError, StructError):
            # Decoding reports the error.
            return None
        if seconds > MAX_SECONDS:
            return None
        # A zero stamp means "not set" in ROS, not 1970.
        return seconds * 1_000_000_000 + nanoseconds or None

    return read_stamp
