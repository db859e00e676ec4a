"""Encoding of event terms into serialized messages, by functions that are generated for each message type.

The generated function unpacks a term with tuple assignments, compares all functors in one condition, and packs each
run of slots of fixed size with one `struct` call. It accepts only the forms that decoded events have: numbers, lists,
atoms for strings, and lazy arrays, whose bytes are copied without decoding them.

Any exception of the fast function leads to `ValidatingEncoder`, which accepts every allowed form (Prolog strings,
byte lists, ``datime`` terms, ``inf``) and reports the slot and the expected type for others. Errors are therefore
detailed without checks in the fast function.
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
from .field_values import number_decoder, raw_bytes
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
        self.encode: Callable[..., bytes] = _compile_encode(definition)


class _UnusualForm(Exception):
    """Raised by the generated function for terms that `ValidatingEncoder` must handle."""


class _PackedTexts(Cache[Atom, bytes]):
    """Cache of the bytes of atoms that stand for strings, with the length before them."""

    def read(self, term: Term) -> bytes:
        encoded_bytes = text_bytes(term) if term.__class__ is Atom else raw_bytes(term)
        if encoded_bytes is None:
            raise _UnusualForm
        packed: bytes = pack("<I", len(encoded_bytes)) + encoded_bytes
        return (
            self.store(term, packed, text_size(term.name) + len(packed)) if term.__class__ is Atom else packed
        )


_packed_texts = _PackedTexts(2048, 1 << 20, 1024)

# Unpacking a term of an unexpected form raises one of these. They select the validating encoder, which raises the
# error for the caller.
_FALLBACK_ERRORS = (_UnusualForm, MessageError, ValueError, TypeError, KeyError, StructError, OverflowError)


class _EncoderSource:
    """Generator of the encoding function of one message type.

    Attributes:
        lines: the statements that unpack the term.
        checks: conditions under which the term is not a message of the usual form.
        chunks: expressions of the bytes of the message, in order.
        format: `struct` codes of the current run of slots of fixed size.
        values: variables of the values of the run.
        names: the globals of the function.
    """

    def __init__(self) -> None:
        self.lines: List[str] = []
        self.checks: List[str] = []
        self.chunks: List[str] = []
        self.format = ""
        self.values: List[str] = []
        bound_names = codegen.BoundNames(
            {
                "C": CONS,
                "N": NIL,
                "bools": _BOOLS,
                "packed": _packed_texts.get,
                "read": _packed_texts.read,
                "Unusual": _UnusualForm,
                "errors": _FALLBACK_ERRORS,
                "join": b"".join,
            }
        )
        self.names, self.name = bound_names.values, bound_names.name

    # The following methods add the source that encodes a value, given the variable that contains its term.

    def message(self, definition: Definition, value: str) -> None:
        """Add a message: unpack its slots, check its functor, and add the slots."""
        if not definition.fields:
            self.checks.append(f"{value} is not {self.name('A', atom(definition.functor_name))}")
            return
        head = self.name("f")
        parts = [self.name("v") for _ in definition.fields]
        self.lines.append(f"{head}, {', '.join(parts)} = {value}")
        expected_functor = functor(definition.functor_name, len(definition.fields))
        self.checks.append(f"{head} is not {self.name('F', expected_functor)}")
        for slot, part in zip(definition.fields, parts):
            self.slot(slot, part)

    def slot(self, slot: Field, value: str) -> None:
        """Add a slot: a single value or an array."""
        if slot.length is None:
            self.single(slot, value)
        elif slot.is_bytes:
            self.blob(slot, value)
        # Short arrays are unpacked in the generated code and packed with the numbers around them.
        elif 0 < slot.length <= MAX_EAGER_ELEMENTS and slot.definition is None and slot.type != "string":
            for item in self.items(value, slot.length):
                self.single(slot, item)
        else:
            self.chunk(f"{self.name('array', _array_packer(slot))}({value})")

    def single(self, slot: Field, value: str) -> None:
        """Add a single value of a slot's type."""
        if slot.definition is not None:
            self.message(slot.definition, value)
        elif slot.type == "string":
            # A cached string is at least the four bytes of its length, so a false value means a miss.
            self.chunk(f"(packed({value}) or read({value}))")
        elif slot.type in TIMES:
            for item in self.items(value, 2):
                self.fixed(TIMES[slot.type][0], item)
        elif slot.type == "bool":
            self.fixed("?", f"bools[{value}]")
        else:
            self.fixed(PRIMITIVES[slot.type], value)

    def items(self, value: str, count: int) -> List[str]:
        """Unpack a list of a known length; return the variables of its items."""
        items = [self.name("v") for _ in range(count)]
        ends = [self.name("c") for _ in range(count)]
        last = self.name("e")
        pattern = last
        for item, end in zip(reversed(items), reversed(ends)):
            pattern = f"({end}, {item}, {pattern})"
        # The outermost parentheses are dropped: Python unpacks nested tuples, and a list is nested pairs.
        self.lines.append(f"{pattern[1:-1]} = {value}")
        self.checks += [f"{end} is not C" for end in ends] + [f"{last} is not N"]
        return items

    def blob(self, slot: Field, value: str) -> None:
        """Add an array of bytes."""
        packed = f"(packed({value}) or read({value}))"
        if slot.length == VARIABLE_LENGTH:
            self.chunk(packed)
            return
        encoded_bytes = self.name("v")
        # The cache includes the length, which an array of fixed length does not have on the wire.
        self.lines.append(f"{encoded_bytes} = {packed}[4:]")
        self.checks.append(f"len({encoded_bytes}) != {slot.length}")
        self.chunk(encoded_bytes)

    def fixed(self, code: str, value: str) -> None:
        """Add a value to the run, by its `struct` code."""
        self.format += code
        self.values.append(value)

    def flush(self) -> None:
        """End the run: add the expression that packs it."""
        if self.format:
            packer = self.name("S", Struct("<" + self.format).pack)
            self.chunks.append(f"{packer}({', '.join(self.values)})")
            self.format, self.values = "", []

    def chunk(self, source: str) -> None:
        """Add an expression of bytes."""
        self.flush()
        self.chunks.append(source)

    def result(self) -> str:
        """Return the expression of the message's bytes."""
        self.flush()
        if len(self.chunks) == 1:
            return self.chunks[0]
        return f"join(({', '.join(self.chunks)}))" if self.chunks else "b''"

    def body(self) -> List[str]:
        """Return the statements of the function."""
        # All conditions are tested in one statement after unpacking. If one of them is true, the validating encoder
        # encodes the term.
        result = self.result()
        check = [f"if {' or '.join(self.checks)}: raise Unusual"] if self.checks else []
        return [*self.lines, *check, f"return {result}"]


def _compile_encode(definition: Definition) -> Callable[..., bytes]:
    code = _EncoderSource()
    code.message(definition, "term")
    lines = ["def encode(term, topic=''):", "  try:", *("    " + line for line in code.body())]
    lines += ["  except errors:", "    return check(term, topic)"]
    code.names["check"] = ValidatingEncoder(definition).encode
    encode: Callable[..., bytes] = codegen.function(lines, code.names, f"encode {definition.name}", "encode")
    return encode


def _array_packer(slot: Field) -> Callable[[Term], bytes]:
    """Return the function that packs an array's list, preceded by its length if that is variable."""
    make = number_decoder(slot)
    if make is not None:
        return _number_packer(slot, make)
    code = _EncoderSource()
    code.single(slot._replace(length=None), "term")
    lines = ["def encode(term):", *("  " + line for line in code.body())]
    element = codegen.function(lines, code.names, f"encode element {slot.type}", "encode")
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


def _number_packer(slot: Field, make: ArrayDecoder) -> Callable[[Term], bytes]:
    code, length = PRIMITIVES[slot.type], slot.length
    size = Struct("<" + code).size

    def encode(term: Term) -> bytes:
        # An array term has the bytes of the numbers, which are copied. An equal `make` means that the
        # elements have the same type.
        if term.__class__ is Lazy and term.make is make:
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
