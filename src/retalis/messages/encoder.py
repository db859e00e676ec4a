"""Encoding of event terms into serialized messages, by functions that are generated for each message type.

The generated function unpacks a term with tuple assignments, compares all functors in one condition, and packs each
run of slots of fixed size with one `struct` call. It accepts only the forms that decoded events have: numbers, lists,
atoms for strings, and lazy arrays, whose bytes are copied without decoding them.

Any exception of the generated function leads to `ValidatingEncoder`, which accepts every allowed form (Prolog
strings, byte lists, ``datime`` terms, ``inf``) and reports the slot and the expected type for others. The generated
function needs no code for error messages.
"""

from struct import Struct, pack
from struct import error as StructError
from typing import Any, Callable, List

from ..foundation import codegen
from ..foundation.bounded_caches import Cache
from ..foundation.cpython_and_pypy import text_size
from ..foundation.errors import MessageError
from ..prolog.terms.array_terms import MAX_EAGER_ELEMENTS
from ..prolog.terms.byte_texts import text_bytes
from ..prolog.terms.types import CONS, FALSE, NIL, TRUE, ArrayDecoder, Atom, Lazy, Term, atom, functor
from .decoder import find_number_decoder, raw_bytes
from .type_definition import PRIMITIVES, TIMES, VARIABLE_LENGTH, Definition, Field
from .validating_encoder import ValidatingEncoder

_BOOLS = {TRUE: True, FALSE: False}


class Encoder:
    """The encoder of one message type.

    >>> definitions = Definitions()
    >>> encoder = definitions.encoder(definitions.add("my_robot/Bumper", "bool left"))
    >>> encoder.encode(functor("my_robot__0__Bumper", 1)(atom("true")), "bumper") == bytes([1])
    True

    Attributes:
        definition: the type.
        encode: the function ``encode(term, topic="")`` from an event term to the bytes of a message. It raises
            `MessageError`, which names the topic, the slot and the expected type, if the term does not fit the type.
    """

    __slots__ = ("definition", "encode")

    def __init__(self, definition: Definition):
        self.definition = definition
        self.encode: Callable[..., bytes] = _compile_encoder(definition)


class _UnusualForm(Exception):
    """Raised by the generated function for terms that `ValidatingEncoder` must handle."""


class _PackedTexts(Cache[Atom, bytes]):
    """Cache of serialized strings (length and bytes) by atom."""

    def serialize(self, term: Term) -> bytes:
        """Return the serialized string of a term, and store it if the term is an atom."""
        encoded_bytes = text_bytes(term) if term.__class__ is Atom else raw_bytes(term)
        if encoded_bytes is None:
            raise _UnusualForm
        packed: bytes = pack("<I", len(encoded_bytes)) + encoded_bytes
        return (
            self.store(term, packed, text_size(term.name) + len(packed)) if term.__class__ is Atom else packed
        )


_packed_texts = _PackedTexts(max_entries=2048, max_bytes=1 << 20, max_entry_bytes=1024)

# Unpacking a term of an unexpected form raises one of these. They select the validating encoder, which raises the
# error for the caller.
_FALLBACK_ERRORS = (_UnusualForm, MessageError, ValueError, TypeError, KeyError, StructError, OverflowError)


class _EncoderGenerator:
    """Generator of the encoding function of one message type.

    Attributes:
        lines: the statements that unpack the term.
        checks: conditions under which the term is not a message of the usual form.
        chunks: expressions of the bytes of the message, in order.
        run_format: `struct` codes of the current run of slots of fixed size.
        run_values: variables of the values of the run.
        globals: the globals of the function.
        new_name: returns a new variable name with a prefix; with a value, a global name that is bound to it.
    """

    def __init__(self) -> None:
        self.lines: List[str] = []
        self.checks: List[str] = []
        self.chunks: List[str] = []
        self.run_format = ""
        self.run_values: List[str] = []
        bound_names = codegen.BoundNames(
            {
                "C": CONS,
                "N": NIL,
                "bools": _BOOLS,
                "packed": _packed_texts.get,
                "serialize": _packed_texts.serialize,
                "UnusualForm": _UnusualForm,
                "errors": _FALLBACK_ERRORS,
                "join": b"".join,
            }
        )
        self.globals, self.new_name = bound_names.values, bound_names.name

    # `value` is the name of the variable that contains the term to encode.

    def add_message(self, definition: Definition, value: str) -> None:
        """Add a message: unpack its slots, check its functor, and add the slots."""
        if not definition.fields:
            self.checks.append(f"{value} is not {self.new_name('A', atom(definition.functor_name))}")
            return
        functor_variable = self.new_name("f")
        slot_variables = [self.new_name("v") for _ in definition.fields]
        self.lines.append(f"{functor_variable}, {', '.join(slot_variables)} = {value}")
        expected_functor = functor(definition.functor_name, len(definition.fields))
        self.checks.append(f"{functor_variable} is not {self.new_name('F', expected_functor)}")
        for slot, variable in zip(definition.fields, slot_variables):
            self.add_slot(slot, variable)

    def add_slot(self, slot: Field, value: str) -> None:
        """Add a slot: a single value or an array."""
        if slot.length is None:
            self.add_value(slot, value)
        elif slot.is_bytes:
            self.add_bytes(slot, value)
        # Short arrays are unpacked in the generated code and packed with the numbers around them.
        elif 0 < slot.length <= MAX_EAGER_ELEMENTS and slot.definition is None and slot.type != "string":
            for item in self.unpack_list(value, slot.length):
                self.add_value(slot, item)
        else:
            self.add_expression(f"{self.new_name('array', _compile_array_packer(slot))}({value})")

    def add_value(self, slot: Field, value: str) -> None:
        """Add a single value of a slot's type."""
        if slot.definition is not None:
            self.add_message(slot.definition, value)
        elif slot.type == "string":
            # A cached string is at least the four bytes of its length, so a false value means a miss.
            self.add_expression(f"(packed({value}) or serialize({value}))")
        elif slot.type in TIMES:
            # Both parts of a time have the same code.
            for item in self.unpack_list(value, 2):
                self.add_to_run(TIMES[slot.type][0], item)
        elif slot.type == "bool":
            self.add_to_run("?", f"bools[{value}]")
        else:
            self.add_to_run(PRIMITIVES[slot.type], value)

    def unpack_list(self, value: str, count: int) -> List[str]:
        """Unpack a list of a known length; return the variables of its items."""
        items = [self.new_name("v") for _ in range(count)]
        ends = [self.new_name("c") for _ in range(count)]
        last = self.new_name("e")
        pattern = last
        for item, end in zip(reversed(items), reversed(ends)):
            pattern = f"({end}, {item}, {pattern})"
        # The outermost parentheses are dropped: Python unpacks nested tuples, and a list is nested pairs.
        self.lines.append(f"{pattern[1:-1]} = {value}")
        self.checks += [f"{end} is not C" for end in ends] + [f"{last} is not N"]
        return items

    def add_bytes(self, slot: Field, value: str) -> None:
        """Add an array of bytes."""
        packed = f"(packed({value}) or serialize({value}))"
        if slot.length == VARIABLE_LENGTH:
            self.add_expression(packed)
            return
        encoded_bytes = self.new_name("v")
        # The cache includes the length, which an array of fixed length does not have on the wire.
        self.lines.append(f"{encoded_bytes} = {packed}[4:]")
        self.checks.append(f"len({encoded_bytes}) != {slot.length}")
        self.add_expression(encoded_bytes)

    def add_to_run(self, code: str, value: str) -> None:
        """Add a value to the run, by its `struct` code."""
        self.run_format += code
        self.run_values.append(value)

    def end_run(self) -> None:
        """End the run: add the expression that packs it."""
        if self.run_format:
            packer = self.new_name("S", Struct("<" + self.run_format).pack)
            self.chunks.append(f"{packer}({', '.join(self.run_values)})")
            self.run_format, self.run_values = "", []

    def add_expression(self, source: str) -> None:
        """Add an expression of bytes."""
        self.end_run()
        self.chunks.append(source)

    def make_result_expression(self) -> str:
        """Return the expression of the message's bytes."""
        self.end_run()
        if len(self.chunks) == 1:
            return self.chunks[0]
        return f"join(({', '.join(self.chunks)}))" if self.chunks else "b''"

    def generate_statements(self) -> List[str]:
        """Return the statements of the function."""
        # All conditions are tested in one statement after unpacking. If one of them is true, the validating encoder
        # encodes the term.
        result = self.make_result_expression()
        type_check = [f"if {' or '.join(self.checks)}: raise UnusualForm"] if self.checks else []
        return [*self.lines, *type_check, f"return {result}"]


def _compile_encoder(definition: Definition) -> Callable[..., bytes]:
    generator = _EncoderGenerator()
    generator.add_message(definition, "term")
    lines = [
        "def encode(term, topic=''):",
        "  try:",
        *("    " + line for line in generator.generate_statements()),
    ]
    lines += ["  except errors:", "    return validate(term, topic)"]
    generator.globals["validate"] = ValidatingEncoder(definition).encode
    encode: Callable[..., bytes] = codegen.function(
        lines, generator.globals, f"encode {definition.name}", "encode"
    )
    return encode


def _compile_array_packer(slot: Field) -> Callable[[Term], bytes]:
    """Return the function that packs an array's list, preceded by its length if that is variable."""
    decoder = find_number_decoder(slot)
    if decoder is not None:
        return _make_number_packer(slot, decoder)
    generator = _EncoderGenerator()
    generator.add_value(slot._replace(length=None), "term")
    lines = ["def encode(term):", *("  " + line for line in generator.generate_statements())]
    element = codegen.function(lines, generator.globals, f"encode element {slot.type}", "encode")
    length = slot.length

    def encode(term: Term) -> bytes:
        items = _list_items(term)
        # The count precedes the elements only if the definition does not fix it.
        if length == VARIABLE_LENGTH:
            return pack("<I", len(items)) + b"".join(map(element, items))
        if len(items) != length:
            raise _UnusualForm
        return b"".join(map(element, items))

    return encode


def _make_number_packer(slot: Field, decoder: ArrayDecoder) -> Callable[[Term], bytes]:
    """Return the function that packs a list of numbers, or copies the bytes of an array term."""
    code, length = PRIMITIVES[slot.type], slot.length
    size = Struct("<" + code).size

    def encode(term: Term) -> bytes:
        # An array term has the bytes of the numbers, which are copied. The same decoder means that the elements have
        # the same type.
        if term.__class__ is Lazy and term.decoder is decoder:
            encoded_bytes = bytes(term.source)
            count = len(encoded_bytes) // size
        else:
            items = _list_items(term)
            count = len(items)
            encoded_bytes = pack(f"<{count}{code}", *items)
        if length == VARIABLE_LENGTH:
            return pack("<I", count) + encoded_bytes
        if count != length:
            raise _UnusualForm
        return encoded_bytes

    return encode


def _list_items(term: Term) -> List[Term]:
    """Return the items of a list.

    Raises:
        ValueError, TypeError, _UnusualForm: if the term is not a list.
    """
    if term.__class__ is Lazy:
        term = term.term()
    items = []
    # An improper list cannot be unpacked, or has another functor.
    tail: Any = term
    while tail is not NIL:
        cons, item, tail = tail
        if cons is not CONS:
            raise _UnusualForm
        items.append(item)
    return items
