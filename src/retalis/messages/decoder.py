"""Decoding of serialized messages into event terms, by functions that are generated for each message type.

Serialized ROS 1 messages are little-endian and unaligned: numbers have fixed sizes; strings and arrays of variable
length are preceded by a 32-bit count. The generator walks over the type definition once and writes Python source:

* consecutive slots of fixed size are read with one `struct` call, however deep they are nested;
* long arrays and strings become lazy terms, so that data which no rule reads is sliced out but never decoded;
* an array of elements of equal size is decoded with one `Struct.iter_unpack` over its slice;
* elements of different sizes are decoded one after the other, because only decoding finds where the next begins.

`FrameDecoderGenerator` generates a second form for the layout "numbers, then strings, then numbers", which covers
transforms, odometry and stamped poses. Their strings are frame names, which repeat in every message. All strings are
therefore looked up at once in a bounded cache, by the bytes from the first string to the last one. A transform then
costs two `struct` calls and one lookup. If a message does not fit (an array with more than one element), the general
function decodes it.

Short strings are cached by their bytes as well, because frame names repeat in every message (`cached_texts`).
"""

from copy import copy
from struct import Struct
from struct import error as StructError
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple, TypeVar, Union

from ..foundation import codegen
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError
from ..prolog.terms.array_terms import BLOB, LAZY_STRING_FUNCTOR, MAX_EAGER_ELEMENTS, decoder_of_code
from ..prolog.terms.byte_texts import blob_atom, plain_text_atom, text_atom
from ..prolog.terms.timestamps import SECOND
from ..prolog.terms.types import (
    CONS,
    FALSE,
    NIL,
    TRUE,
    ArrayDecoder,
    Atom,
    Functor,
    Lazy,
    Term,
    atom,
    functor,
)
from .type_definition import (
    HEADER,
    MAX_EMPTY_ELEMENTS,
    PRIMITIVES,
    TIMES,
    VARIABLE_LENGTH,
    Definition,
    Field,
    SerializationFormat,
    check_empty_elements,
    describe_mismatch,
    element_size,
    measure_of,
)

MAX_EAGER_BYTES = 1024
"""Strings longer than this many bytes become lazy terms."""


def text_term(data: bytes) -> Term:
    """Return the atom of a message's string, as a lazy term if it is long."""
    if len(data) > MAX_EAGER_BYTES:
        return Lazy(LAZY_STRING_FUNCTOR, text_atom, data)
    return text_atom(data)


def plain_text_term(data: bytes) -> Term:
    """Return the atom of a message's string in the plain form, as a lazy term if it is long."""
    if len(data) > MAX_EAGER_BYTES:
        return Lazy(LAZY_STRING_FUNCTOR, plain_text_atom, data)
    return plain_text_atom(data)


def blob_term(data: bytes) -> Term:
    """Return the atom of a message's byte array, as a lazy term if it is long."""
    if len(data) > MAX_EAGER_BYTES:
        return Lazy(LAZY_STRING_FUNCTOR, BLOB, data)
    return blob_atom(data)


def raw_bytes(term: Term) -> Optional[bytes]:
    """Return the bytes of a lazy term of a byte array, or of a string that was not accessed; otherwise None."""
    if term.__class__ is Lazy and (
        term.decoder is BLOB or (term.decoder in _TEXT_DECODERS and term.decoded_term is None)
    ):
        raw: bytes = term.source
        return raw
    return None


_TEXT_DECODERS = (text_atom, plain_text_atom)

_Value = TypeVar("_Value")

CACHE_BYTES_PER_CHARACTER = 5
"""Bytes of memory per byte of a cached string: one in the key, and up to four per character in the atom."""


def create_text_cache() -> "Cache[bytes, _Value]":
    """Return a bounded cache of values by the bytes of strings.

    Only short strings are worth caching: frame names repeat, while long strings usually differ.
    """
    return Cache(2048, 1 << 20, 1024)


cached_texts: Cache[bytes, Term] = create_text_cache()
"""Terms of short strings, by their bytes."""


def cache_text(cache: Cache[bytes, _Value], key: bytes, value: _Value) -> _Value:
    """Store a value under the bytes of strings; return the value."""
    return cache.store(key, value, CACHE_BYTES_PER_CHARACTER * len(key))


cached_plain_texts: Cache[bytes, Term] = create_text_cache()
"""Terms of short strings in the plain form, by their bytes."""


def read_text(data: bytes, start: int, stop: int) -> Term:
    """Return the string between two offsets of a message, which is not in the cache, and cache it."""
    raw = slice_text(data, start, stop)
    return cache_text(cached_texts, raw, text_term(raw))


def read_plain_text(data: bytes, start: int, stop: int) -> Term:
    """Return the string between two offsets in the plain form; see `read_text`."""
    raw = slice_text(data, start, stop)
    return cache_text(cached_plain_texts, raw, plain_text_term(raw))


def slice_text(data: bytes, start: int, stop: int) -> bytes:
    """Return the bytes between two offsets."""
    raw = data[start:stop]
    # A slice beyond the end of the message is shorter than the length field says.
    if len(raw) != stop - start:
        raise StructError
    return raw


def read_texts(key: bytes, count: int, make_term: Callable[[bytes], Term]) -> Optional[Tuple[Term, ...]]:
    """Return the strings that fill ``key``, each preceded by its length; None if they do not fill it exactly.

    Args:
        key: the bytes.
        count: number of strings.
        make_term: returns the term of a string.
    """
    terms: List[Term] = []
    offset = 0
    for _ in range(count):
        size = int.from_bytes(key[offset : offset + 4], "little")
        raw = key[offset + 4 : offset + 4 + size]
        # The lengths do not fit the key, so the message does not have the assumed layout.
        if len(raw) != size:
            return None
        terms.append(make_term(raw))
        offset += 4 + size
    return tuple(terms) if offset == len(key) and count else None


def find_number_decoder(slot: Field) -> Optional[ArrayDecoder]:
    """Return the decoder of the array terms that have the bytes of a slot; None if its elements are no numbers."""
    if slot.definition is not None or slot.type == "bool" or slot.type not in PRIMITIVES:
        return None
    return decoder_of_code(PRIMITIVES[slot.type])


ArrayDecode = Callable[[bytes], Term]
"""Function from the bytes of an array's elements to their list."""


def repeated_list(element: Term, count: int) -> Term:
    """Return a list of ``count`` elements that are the same term."""
    term: Term = NIL
    for _ in range(count):
        term = (CONS, element, term)
    return term


def compile_array_decoder(
    title: str, layout: Struct, targets: List[str], element: str, names: Dict[str, object]
) -> ArrayDecode:
    """Return the function that decodes an array of elements of equal size into a list.

    Args:
        title: name of the type, for tracebacks.
        layout: layout of one element.
        targets: variables of an element's values.
        element: expression of an element's term, in terms of these variables.
        names: globals of that expression.
    """
    lines = [
        "def make(source):",
        "  term = N",
        f"  for {', '.join(targets)}, in reversed(list(unpack(source))):",
        f"    term = (C, {element}, term)",
        "  return term",
    ]
    namespace = {**names, "unpack": layout.iter_unpack}
    decode: ArrayDecode = codegen.function(lines, namespace, f"decode {title}", "make")
    return decode


def make_variable_array_decoder(
    element: Callable[[bytes, int], Tuple[Term, int]], min_size: int
) -> Callable[[bytes, int, int], Tuple[Term, int]]:
    """Return the function that decodes an array of elements that differ in size.

    Args:
        element: decodes the element at an offset; returns it and the offset after it.
        min_size: minimum size of an element in bytes.
    """

    def decode(data: bytes, offset: int, count: int) -> Tuple[Term, int]:
        # A wrong count must fail before memory is allocated for that many elements.
        if count * min_size > len(data) - offset:
            raise StructError
        items = []
        for _ in range(count):
            item, offset = element(data, offset)
            items.append(item)
        term: Term = NIL
        while items:
            term = (CONS, items.pop(), term)
        return term, offset

    return decode


class DecoderGenerator:
    """Generator of the decoding function of one message type.

    Consecutive slots of fixed size are collected in a run, which `end_run` ends when a value of variable size
    follows.

    Attributes:
        lines: the statements of the function so far; they advance the offset ``o`` in the bytes ``data``.
        new_name: returns a new variable name with a prefix; with a value, a global name that is bound to it.
        run_base: source of the offset that the start of the run is relative to.
        run_shift: bytes from ``run_base`` to the start of the run.
        run_format: `struct` codes of the run.
        run_variables: variables of the values of the run.
    """

    byte_order = "<"
    """Byte order of numbers, as a `struct` prefix."""

    def __init__(self) -> None:
        self.lines: List[str] = []
        self._bound_names = bound_names = codegen.BoundNames(
            {
                "C": CONS,
                "N": NIL,
                "T": TRUE,
                "F": FALSE,
                "Lazy": Lazy,
                "StructError": StructError,
                "known": cached_texts.get,
                "read_text": read_text,
                "known_plain": cached_plain_texts.get,
                "read_plain_text": read_plain_text,
                "blob": blob_term,
                "repeated_list": repeated_list,
            }
        )
        self.globals, self.new_name = bound_names.values, bound_names.name
        self.run_base, self.run_shift = "o", 0
        self.run_format = ""
        self.run_variables: List[str] = []

    def constant(self, value: Union[Atom, Functor]) -> str:
        """Return the global name that the generated source uses for an atom or a functor."""
        return self._bound_names.constant(value, value)

    def functor_constant(self, definition: Definition) -> str:
        """Return the global name of the functor of a message's terms."""
        return self.constant(functor(definition.functor_name, len(definition.fields)))

    # The following methods add the statements that read a value, and return the expression of its term.

    def read_message(self, definition: Definition) -> str:
        """Return the expression of a whole message."""
        if not definition.fields:
            return self.constant(atom(definition.functor_name))
        functor_name = self.functor_constant(definition)
        slots = [self.read_slot(slot) for slot in definition.fields]
        return f"({functor_name}, {', '.join(slots)})"

    def read_slot(self, slot: Field) -> str:
        """Return the expression of a slot: a single value or an array."""
        if slot.length is None:
            return self.read_value(slot)
        if slot.length == VARIABLE_LENGTH:
            return self.read_variable_array(slot)
        return self.read_fixed_array(slot)

    def read_value(self, slot: Field) -> str:
        """Return the expression of one value of a slot."""
        if slot.definition is not None:
            return self.read_message(slot.definition)
        if slot.type == "string":
            return self.read_string(slot)
        if slot.type in TIMES:
            # Both parts of a time have the same code.
            code = TIMES[slot.type][0]
            return f"(C, {self.add_to_run(code)}, (C, {self.add_to_run(code)}, N))"
        value = self.add_to_run(PRIMITIVES[slot.type])
        return f"(T if {value} else F)" if slot.type == "bool" else value

    def read_fixed_array(self, slot: Field) -> str:
        """Return the expression of an array of fixed length."""
        count = slot.length or 0
        if count == 0:
            return "blob(b'')" if slot.is_bytes else "N"
        if slot.is_bytes:
            return f"blob({self.add_to_run(f'{count}s')})"
        # Short arrays (colours, positions) are decoded with the run around them: one `struct` call covers both.
        if count <= MAX_EAGER_ELEMENTS and slot.definition is None:
            items = [self.read_value(slot._replace(length=None)) for _ in range(count)]
            return "".join(f"(C, {item}, " for item in items) + "N" + ")" * count
        size = self.element_size(slot)
        if size is None:
            return self.read_elements(slot, str(count))
        if not size:
            return self.read_repeated_list(slot, str(count))
        value = self.add_elements_to_run(slot, count * size)
        # The functor of a list is known before its elements are, so that patterns can reject the term without
        # decoding it.
        return f"Lazy(C, {self.new_name('make', self.find_array_decoder(slot))}, {value})"

    def read_variable_array(self, slot: Field) -> str:
        """Return the expression of an array whose length precedes its elements."""
        count = self.add_to_run("I")
        self.end_run()
        if slot.is_bytes:
            return self.read_bytes(count)
        size = self.element_size(slot)
        if size is None:
            return self.read_elements(slot, count)
        if not size:
            return self.read_repeated_list(slot, count)
        value = self.new_name("t")
        make = self.new_name("make", self.find_array_decoder(slot))
        # The count is not compared with the message's size here: slices beyond the end are empty, and the final
        # comparison of offset and length fails.
        elements = self.advance_over_elements(slot, count, size)
        self.lines += [
            f"if not {count}: {value} = N",
            f"elif {count} <= {MAX_EAGER_ELEMENTS}: {value} = {make}({elements})",
            f"else: {value} = Lazy(C, {make}, {elements})",
        ]
        return value

    def read_repeated_list(self, slot: Field, count: str) -> str:
        """Return the expression of an array whose elements have no bytes: all elements are the same term."""
        # Such elements occupy no bytes, so the message's size does not bound their number; `check_empty_elements`
        # does.
        return f"repeated_list({self.read_value(slot._replace(length=None))}, {count})"

    def read_elements(self, slot: Field, count: str) -> str:
        """Return the expression of an array whose elements differ in size."""
        self.end_run()
        read = self.new_name("read", make_variable_array_decoder(*self.compile_element(slot)))
        value = self.new_name("t")
        self.lines.append(f"{value}, o = {read}(data, {self.run_offset()}, {count})")
        # The end of the array is only known when the generated code runs: offsets restart at the variable `o`.
        self.run_base, self.run_shift = "o", 0
        return value

    def read_string(self, slot: Field) -> str:
        """Return the expression of a string, in the form that the slot has."""
        count = self.add_to_run("I")
        self.end_run()
        self.advance(count)
        value = self.new_name("t")
        known, read = ("known_plain", "read_plain_text") if slot.is_plain else ("known", "read_text")
        self.lines += [
            # A hit costs no function call.
            f"{value} = {known}(data[s:o])",
            f"if {value} is None: {value} = {read}(data, s, o)",
        ]
        return value

    def read_bytes(self, count: str) -> str:
        """Return the expression of an array of ``count`` bytes."""
        self.advance(count)
        value = self.new_name("t")
        self.lines.append(f"{value} = blob(data[s:o])")
        return value

    # Arrays of elements of equal size.

    def element_size(self, slot: Field) -> Optional[int]:
        """Return the number of bytes from one element of a slot to the next, or None if it varies."""
        return element_size(slot)

    def add_elements_to_run(self, slot: Field, size: int) -> str:
        """Add the bytes of all elements of a slot to the run; return the expression of these bytes."""
        return self.add_to_run(f"{size}s")

    def advance_over_elements(self, slot: Field, count: str, size: int) -> str:
        """Advance over ``count`` elements of ``size`` bytes; return the expression of their bytes."""
        self.advance(f"{count} * {size}")
        return "data[s:o]"

    def find_array_decoder(self, slot: Field) -> ArrayDecode:
        """Return the function that decodes the bytes of an array."""
        return find_number_decoder(slot) or self.compile_records(slot)

    def compile_records(self, slot: Field) -> ArrayDecode:
        """Return the function that decodes an array of records of equal size into a list."""
        generator = self.create_element_generator()
        result = generator.read_value(slot._replace(length=None))
        # All elements have the same layout, so the run is never ended and its format covers a whole element.
        layout = Struct(generator.byte_order + generator.run_format)
        return compile_array_decoder(
            slot.describe(), layout, generator.run_variables, result, generator.globals
        )

    # Arrays of elements of different sizes.

    def create_element_generator(self) -> "DecoderGenerator":
        """Return a generator for one element of an array."""
        return DecoderGenerator()

    def min_element_size(self, slot: Field) -> int:
        """Return the minimum size of an element in bytes."""
        return measure_of(slot).min_size

    def compile_element(self, slot: Field) -> Tuple[Callable[[bytes, int], Tuple[Term, int]], int]:
        """Return the function that decodes one element of an array, and the minimum size of an element in bytes."""
        generator = self.create_element_generator()
        result = generator.read_value(slot._replace(length=None))
        generator.end_run()
        lines = ["def element(data, o):", *("  " + line for line in generator.lines)]
        lines.append(f"  return {result}, {generator.run_offset()}")
        element = codegen.function(lines, generator.globals, f"decode element {slot.type}", "element")
        return element, self.min_element_size(slot)

    # Runs of slots of fixed size.

    def add_to_run(self, code: str) -> str:
        """Add a value to the run, by its `struct` code; return the variable that holds it."""
        self.run_format += code
        self.run_variables.append(self.new_name("v"))
        return self.run_variables[-1]

    def run_offset(self) -> str:
        """Return the expression of the offset at which the run starts."""
        return f"{self.run_base} + {self.run_shift}" if self.run_shift else self.run_base

    def end_run(self) -> None:
        """End the run: add the statement that unpacks it."""
        if not self.run_format:
            return
        layout = Struct(self.byte_order + self.run_format)
        unpack = self.new_name("S", layout.unpack_from)
        self.lines.append(f"{', '.join(self.run_variables)}, = {unpack}(data, {self.run_offset()})")
        # The variable `o` stays where it is: a constant added at compile time is cheaper than an assignment at run
        # time.
        self.run_shift += layout.size
        self.run_format, self.run_variables = "", []

    def advance(self, size: str) -> None:
        """Set ``s`` and ``o`` to the start and the end of the next ``size`` bytes."""
        self.lines += [f"s = {self.run_offset()}", f"o = s + {size}"]
        self.run_base, self.run_shift = "o", 0


CACHED_VALUE_BYTES = 400
"""Bytes that one value cached beside the strings of a message costs, as an estimate for the cache's limit."""


class UnsupportedLayout(Exception):
    """Raised if a type does not have the layout "numbers, strings, numbers"."""


class StampWatch(NamedTuple):
    """Observer of the stamps of messages, which is called while a message is decoded.

    The cache of frame names is looked up for every message anyway, so comparing the second of the stamp there costs
    almost nothing.

    Attributes:
        string_count: number of strings that name the frames; the type must have no other strings.
        get_state: returns the state of a frame by its bytes, or None. A state has the attribute ``second``: the
            second of the last observed stamp, negative for a state that ``get_state`` does not return any more.
        observe_all: called with a message that the general function decodes. Its exceptions propagate.
        observe: called with the bytes of the frames and the time in nanoseconds, if the second has changed.
    """

    string_count: int
    get_state: Callable[[bytes], Any]
    observe_all: Callable[[bytes], object]
    observe: Callable[[bytes, int], object]


class _UnknownStamp:
    """State of frames without an observed stamp: no second equals -1."""

    second = -1


_UNKNOWN_STAMP = _UnknownStamp()


class FrameDecoderGenerator(DecoderGenerator):
    """Generator of decoding functions for types that are numbers, then strings, then numbers.

    The last array of messages is assumed to have one element, as in nearly every ``tf2_msgs/TFMessage``.
    """

    def __init__(self, watch: Optional[StampWatch] = None) -> None:
        super().__init__()
        self._initialize_frames(watch)

    def _initialize_frames(self, watch: Optional[StampWatch]) -> None:
        self.watch = watch
        self.string_variables: List[str] = []
        self.make_text = text_term
        """Returns the term of a string."""
        self.leading_format = ""
        """`struct` codes of the numbers before the strings."""
        self.leading_variables: List[str] = []
        self.element_count: Optional[str] = None
        self.cached_variables: List[str] = []
        """Variables of values that are cached beside the strings of a message; None until they are first computed."""

    def read_string(self, slot: Field) -> str:
        """Add a string; all strings of the message must be adjacent, and have the same form."""
        self.make_text = plain_text_term if slot.is_plain else text_term
        # Numbers between strings would move the strings that follow, so the key could not be one slice.
        if self.string_variables and self.run_format:
            raise UnsupportedLayout
        if not self.string_variables:
            self.leading_format, self.leading_variables = self.run_format, self.run_variables
            self.run_format, self.run_variables = "", []
        self.string_variables.append(self.new_name("t"))
        return self.string_variables[-1]

    def read_variable_array(self, slot: Field) -> str:
        """Add the array of messages, if it is the only array and precedes all strings."""
        # After a string, the array's count would not be at a fixed offset.
        if slot.definition is None or self.string_variables or self.element_count:
            raise UnsupportedLayout
        self.element_count = self.add_to_run("I")
        element = self.read_message(slot.definition)
        return self.format_single_element_list(element)

    def format_single_element_list(self, element: str) -> str:
        """Return the expression of a list of one element."""
        return f"(C, {element}, N)"

    def read_elements(self, slot: Field, count: str) -> str:
        """Raise `UnsupportedLayout`: elements that differ in size do not fit the layout."""
        raise UnsupportedLayout

    def generate(self, definition: Definition, fallback: Callable[[bytes], object]) -> List[str]:
        """Return the source of the whole function.

        Args:
            definition: the message type.
            fallback: decodes messages that do not fit; it calls the observer itself.

        Raises:
            UnsupportedLayout: if the type does not have the layout.
        """
        # Zero-byte elements must be counted before anything is decoded.
        if definition.measure.may_have_empty_elements:
            raise UnsupportedLayout
        result = self.read_message(definition)
        head, tail = Struct(self.byte_order + self.leading_format), Struct(self.byte_order + self.run_format)
        if not self.string_variables or not (head.size or tail.size):
            raise UnsupportedLayout
        result = self.finish_expression(result)
        self.globals.update(head=head.unpack_from, tail=tail.unpack_from, fallback=fallback)
        self._cache_texts()
        lines = ["def decode(data):", "  try:"]
        if self.leading_variables:
            lines.append(f"    {', '.join(self.leading_variables)}, = head(data)")
        # Checked before the lookup: with another count of elements, the key would contain the elements' numbers and
        # fill the cache.
        lines += [f"    if {condition}: return fallback(data)" for condition in self.mismatch_conditions()]
        lines += [f"    {line}" for line in self.key_statements(head.size, tail.size)]
        lines += [
            "    k = known(key)",
            "    if k is None:",
            "      k = learn(key)",
            "      if k is None: return fallback(data)",
        ]
        if tail.size:
            # The byte of a type without slots, in CDR, has no variable.
            variables_text = f"{', '.join(self.run_variables)}, = " if self.run_variables else ""
            lines.append(f"    {variables_text}tail(data, {self.tail_offset(tail.size)})")
        lines += ["  except StructError:", "    return fallback(data)"]
        # A cached entry has the strings, the values beside them, and the frame's state, which `observe` replaces.
        variables = list(self.string_variables)
        if self.watch is not None:
            variables.append("f")
        variables[len(self.string_variables) : len(self.string_variables)] = self.cached_variables
        lines.append(f"  {', '.join(variables)}{'' if len(variables) == 1 else ','} = k")
        if self.watch is not None:
            lines += self._observer_call(self.watch)
        lines += self.generate_text_updates(tail.size)
        return [*lines, f"  return {result}"]

    def mismatch_conditions(self) -> List[str]:
        """Return conditions of the leading numbers under which a message does not have the layout."""
        return [f"{self.element_count} != 1"] if self.element_count else []

    def key_statements(self, head_size: int, tail_size: int) -> List[str]:
        """Return the statements that set ``key`` to the bytes of the strings.

        Args:
            head_size: number of bytes before the strings.
            tail_size: number of bytes of the numbers after the strings.
        """
        # The strings' bytes are those between the two runs of numbers. A key of other lengths is parsed by `learn`,
        # which returns None if the counts in it do not add up, for example in a truncated message.
        return [f"key = data[{head_size}:{-tail_size if tail_size else ''}]"]

    def tail_offset(self, tail_size: int) -> str:
        """Return the expression of the offset of the numbers after the strings."""
        return str(-tail_size)

    def stamp_index(self) -> int:
        """Return the index of the seconds among the leading numbers, if the message begins with a stamp."""
        # The seconds follow ``seq``, and the array's count if there is an array.
        return 2 if self.element_count else 1

    def stamp_format(self) -> str:
        """Return the `struct` codes up to the nanoseconds of a stamp at the beginning."""
        return "I" * (self.stamp_index() + 2)

    def read_strings(self, key: bytes) -> Optional[Tuple[Term, ...]]:
        """Return the strings in the bytes from the first to the last one; None if they do not fill it exactly."""
        return read_texts(key, len(self.string_variables), self.make_text)

    def _observer_call(self, watch: StampWatch) -> List[str]:
        """Return the statements that call the observer if the second of the stamp differs from the frame's state.

        Raises:
            UnsupportedLayout: if not all strings name frames, or the message does not begin with a header's stamp.
        """
        second_index = self.stamp_index()
        if len(self.string_variables) != watch.string_count or not self.leading_format.startswith(
            self.stamp_format()
        ):
            raise UnsupportedLayout
        get_state, call_observer = watch.get_state, watch.observe

        def observe(key: bytes, second: int, nanosecond: int, entry: List[object]) -> None:
            """Call the observer, and cache the state of the frames beside the strings."""
            state = get_state(key)
            try:
                if state is None or state.second != second:
                    call_observer(key, second * SECOND + nanosecond)
                    state = get_state(key)
            finally:
                # Also after an exception: the entry must not refer to a state that the observer has dropped.
                entry[-1] = state or _UNKNOWN_STAMP

        self.globals["observe"] = observe
        second, nanosecond = self.leading_variables[second_index : second_index + 2]
        return [f"  if f.second != {second}: observe(key, {second}, {nanosecond}, k)"]

    def _cache_texts(self) -> None:
        """Define ``known`` and ``learn``, which return the strings of a message by the bytes that they occupy."""
        cached_bytes = CACHED_VALUE_BYTES * len(self.cached_variables)
        cache: Cache[bytes, object] = (
            Cache(2048, 2 << 20, 1024 + cached_bytes) if cached_bytes else create_text_cache()
        )
        string_count, read_strings = len(self.string_variables), self.read_strings
        cached_value, has_watch = self.to_cached_value, self.watch is not None
        uncomputed = [None] * len(self.cached_variables)

        def learn(key: bytes) -> object:
            strings = read_strings(key)
            if strings is None:
                return None
            values = [cached_value(text) for text in strings]
            # A list, because the generated code replaces the cached values in place.
            if has_watch or uncomputed:
                entry = [*values, *uncomputed, *([_UNKNOWN_STAMP] if has_watch else ())]
                return cache.store(key, entry, CACHE_BYTES_PER_CHARACTER * len(key) + cached_bytes)
            return cache_text(cache, key, tuple(values) if string_count > 1 else values[0])

        self.globals.update(known=cache.get, learn=learn)

    def generate_text_updates(self, tail_size: int) -> List[str]:
        """Return statements that compute further values for the result.

        The entry of the cache is in the variable ``k``; the values of `cached_variables` follow the strings in it.

        Args:
            tail_size: number of bytes after the strings.
        """
        return []

    def finish_expression(self, result: str) -> str:
        """Return the expression that the function returns, from the expression of the message."""
        return result

    def to_cached_value(self, text: Term) -> object:
        """Return the value that is cached for a string."""
        return text


Decode = Callable[[bytes], Term]


class Decoder:
    """The decoder of one message type.

    >>> definitions = Definitions()
    >>> decoder = definitions.decoder(definitions.add("my_robot/Bumper", "bool left"))
    >>> Engine().show(decoder.decode(bytes([1])))
    'my_robot__0__Bumper(true)'

    Args:
        definition: the type.
        max_empty_elements: maximum number of zero-byte elements in a message.

    Attributes:
        definition: the type.
        functor: the functor of its event terms (arity 0: the term is an atom).
        decode: the function from the bytes of a message to its term. Raises `MessageError` if the bytes are not a
            message of this type.
        stamp: the function from the bytes to the time of ``header.stamp`` in nanoseconds; None for a zero
            stamp, and always for a type without a header.
        watch: observer of the stamps of the messages that `decode` reads, or None.
        plain: the same decoder without the observer; None if there is no observer.
    """

    __slots__ = ("definition", "functor", "decode", "stamp", "watch", "plain")

    format = SerializationFormat.ROS1
    """Format of the messages."""
    frame_generator = FrameDecoderGenerator
    """Generator for the layout "numbers, then strings, then numbers" in this format."""

    def __init__(self, definition: Definition, max_empty_elements: int = MAX_EMPTY_ELEMENTS):
        self.definition = definition
        self.functor = functor(definition.functor_name, len(definition.fields))
        self.decode: Decode = self._compile_decode(max_empty_elements)
        self.stamp: Callable[[bytes], Optional[int]] = self._compile_stamp()
        # Set by `make_watching_decoder`, on a copy.
        self.watch: Optional[StampWatch] = None
        self.plain: Optional[Decoder] = None

    def _compile_decode(self, max_empty_elements: int) -> Decode:
        """Return the decoding function: the frame decoder if it supports the type."""
        decode = _compile_general_decode(self.definition)
        if self.definition.measure.may_have_empty_elements:
            return _with_element_limit(self.definition, max_empty_elements, decode)
        return compile_frame_decoder_or(decode, self)

    def _compile_stamp(self) -> Callable[[bytes], Optional[int]]:
        return _compile_stamp(self.definition)

    def lazy(self, data: bytes) -> Term:
        """Return a term that is decoded on first access.

        A malformed message is therefore reported on first access, not by this call.

        >>> definitions = Definitions()
        >>> decoder = definitions.decoder(definitions.add("my_robot/Bumper", "bool left"))
        >>> Engine().show(decoder.lazy(bytes([1])))
        'my_robot__0__Bumper(true)'
        """
        # The term of an empty message is an atom, and only compound terms and strings can be lazy.
        if not self.definition.fields:
            return self.decode(data)
        return Lazy(self.functor, self.decode, data)


def make_watching_decoder(decoder: Decoder, watch: StampWatch) -> Decoder:
    """Return a decoder that passes the stamps of the messages that it decodes to an observer.

    Raises:
        UnsupportedLayout: if the type does not have the layout that `FrameDecoderGenerator` supports.
    """
    decode = decoder.decode

    def fallback(data: bytes) -> Term:
        watch.observe_all(data)
        return decode(data)

    # The original decoder stays as it is: it is shared by all subscribers to topics of this type.
    observed_decoder = copy(decoder)
    observed_decoder.decode = _compile_frame_decoder(decoder, fallback, watch)
    observed_decoder.watch = watch
    observed_decoder.plain = decoder
    return observed_decoder


def compile_frame_decoder_or(fallback: Decode, decoder: Decoder) -> Decode:
    """Return a decoding function for the layout of `FrameDecoderGenerator`, or ``fallback`` for other types."""
    try:
        return _compile_frame_decoder(decoder, fallback)
    except UnsupportedLayout:
        return fallback


def _compile_frame_decoder(decoder: Decoder, fallback: Decode, watch: Optional[StampWatch] = None) -> Decode:
    generator = decoder.frame_generator(watch)
    lines = generator.generate(decoder.definition, fallback)
    title = f"decode {decoder.definition.name}"
    decode: Decode = codegen.function(lines, generator.globals, title, "decode")
    return decode


def _compile_general_decode(definition: Definition) -> Decode:
    """Return the decoding function for any layout."""
    generator = DecoderGenerator()
    generator.run_base = "0"
    result = generator.read_message(definition)
    generator.end_run()
    generator.globals["raise_mismatch"] = _make_mismatch_function(definition)
    lines = ["def decode(data):", "  try:", *("    " + line for line in generator.lines)]
    lines += [
        # Trailing bytes are an error as well: they mean that the publisher uses another version of the type.
        f"    if len(data) != {generator.run_offset()}: raise_mismatch(data)",
        "  except StructError: raise_mismatch(data)",
        f"  return {result}",
    ]
    decode: Decode = codegen.function(lines, generator.globals, f"decode {definition.name}", "decode")
    return decode


def _with_element_limit(definition: Definition, max_empty_elements: int, decode: Decode) -> Decode:
    """Return a decoding function that first limits the number of zero-byte elements.

    Without the limit, a message of a few bytes could claim 2**32 elements and exhaust the memory.
    """

    def decode_checked(data: bytes) -> Term:
        check_empty_elements(definition, data, max_empty_elements)
        return decode(data)

    return decode_checked


def _make_mismatch_function(definition: Definition) -> Callable[[bytes], None]:
    def raise_mismatch(data: bytes) -> None:
        raise MessageError(describe_mismatch(definition, data))

    return raise_mismatch


def has_header(definition: Definition) -> bool:
    """Return whether messages of a type begin with a header, as ROS defines it."""
    first = definition.fields[0] if definition.fields else None
    return first is not None and first.type == HEADER and first.length is None and first.name == "header"


def _compile_stamp(definition: Definition) -> Callable[[bytes], Optional[int]]:
    """Return the function that reads the time of a message's header."""
    if not has_header(definition):
        return _no_stamp
    unpack = Struct("<II").unpack_from
    raise_mismatch = _make_mismatch_function(definition)

    def read_stamp(data: bytes) -> Optional[int]:
        try:
            seconds, nanoseconds = unpack(data, 4)
        except StructError:
            raise_mismatch(data)
        # A zero stamp means "not set" in ROS, not 1970.
        return seconds * 1_000_000_000 + nanoseconds or None

    return read_stamp


def _no_stamp(data: bytes) -> None:
    return None
