"""Encoding of event terms into serialized messages.

The encoder of a type has two paths:

* A function that is generated for the type unpacks a term with tuple assignments, compares all functors in one
  condition, and packs each run of slots of fixed size with one `struct` call. It accepts only the forms that decoded
  events have: numbers, lists, atoms for strings, and lazy arrays, whose bytes are copied without decoding them.
* `encode_slot_by_slot` walks over the type. It accepts every allowed form (Prolog strings, lists of bytes, ``True``,
  0 and 1, ``datime`` terms, ``inf``), and names the slot and the expected type in errors.

Any exception of the generated function leads to the second path, so the generated code contains no error messages.

`find_fault` applies the rules of the second path to terms with variables, for checks before the program runs:
variables are replaced by values that fit their slots, so that an error concerns the constant parts of the term only.
"""

from functools import partial
from struct import Struct, pack
from struct import error as StructError
from sys import getsizeof
from typing import Any, Callable, Dict, List, Optional

from ..foundation import codegen
from ..foundation.bounded_caches import Cache
from ..foundation.displayed_text import format_count
from ..foundation.errors import MessageError
from ..prolog.terms import timestamps
from ..prolog.terms.array_terms import BLOB, MAX_EAGER_ELEMENTS, element_count, lazy_array
from ..prolog.terms.byte_texts import plain_text_bytes, text_bytes
from ..prolog.terms.list_terms import list_items, make_list
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
    Var,
    atom,
    deref,
    functor,
)
from ..prolog.terms.types import String as PrologString
from .decoder import find_number_decoder, raw_bytes
from .type_definition import FLOATS, PRIMITIVES, TIMES, VARIABLE_LENGTH, Definition, Field, integer_range

_BOOLS: Dict[Atom, bool] = {TRUE: True, atom("True"): True, FALSE: False, atom("False"): False}
_SPECIAL_FLOATS = {atom("nan"): float("nan"), atom("inf"): float("inf"), atom("infinite"): float("inf")}
_MINUS_FUNCTOR = functor("-", 1)
_MAX_SHOWN_CHARACTERS = 60


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
        self.encode: Callable[..., bytes] = self._compile_encode()

    def _compile_encode(self) -> Callable[..., bytes]:
        return _compile_encoder(self.definition)


class UnusualForm(Exception):
    """Raised by the generated function for terms that `encode_slot_by_slot` must handle."""


class PackedTexts(Cache[Atom, bytes]):
    """Cache of serialized strings by atom.

    Args:
        pack_text: returns the serialized string of its bytes.
        read_bytes: returns the bytes that an atom denotes.
        max_entries, max_bytes, max_entry_bytes: see `Cache`.
    """

    def __init__(
        self,
        pack_text: Callable[[bytes], bytes],
        read_bytes: Callable[[Term], Optional[bytes]],
        max_entries: int,
        max_bytes: int,
        max_entry_bytes: int,
    ):
        super().__init__(max_entries, max_bytes, max_entry_bytes)
        self._pack_text = pack_text
        self._read_bytes = read_bytes

    def serialize(self, term: Term) -> bytes:
        """Return the serialized string of a term, and store it if the term is an atom."""
        encoded_bytes = self._read_bytes(term) if term.__class__ is Atom else raw_bytes(term)
        if encoded_bytes is None:
            raise UnusualForm
        packed = self._pack_text(encoded_bytes)
        return (
            self.store(term, packed, getsizeof(term.name) + len(packed)) if term.__class__ is Atom else packed
        )


def _pack_text(encoded_bytes: bytes) -> bytes:
    return pack("<I", len(encoded_bytes)) + encoded_bytes


_packed_texts = PackedTexts(_pack_text, text_bytes, 2048, 1 << 20, 1024)
_packed_plain_texts = PackedTexts(_pack_text, plain_text_bytes, 2048, 1 << 20, 1024)

# Unpacking a term of an unexpected form raises one of these. They select `encode_slot_by_slot`, which raises the
# error for the caller.
FALLBACK_ERRORS = (UnusualForm, MessageError, ValueError, TypeError, KeyError, StructError, OverflowError)


class EncoderGenerator:
    """Generator of the encoding function of one message type.

    Attributes:
        lines: the statements that unpack the term.
        checks: conditions under which the term is not a message of the usual form.
        chunks: expressions of the bytes of the message, in order.
        run_format: `struct` codes of the current run of slots of fixed size.
        run_values: variables of the values of the run.
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
                "packed_plain": _packed_plain_texts.get,
                "serialize_plain": _packed_plain_texts.serialize,
                "UnusualForm": UnusualForm,
                "errors": FALLBACK_ERRORS,
                "join": b"".join,
            }
        )
        self.globals, self.new_name = bound_names.values, bound_names.name

    # `value` is the name of the variable that contains the term to encode.

    def add_message(self, definition: Definition, value: str) -> None:
        """Add a message: unpack its slots, check its functor, and add the slots."""
        if not definition.fields:
            self.check_empty_message(definition, value)
            return
        for slot, variable in zip(definition.fields, self.unpack_message(definition, value)):
            self.add_slot(slot, variable)

    def check_empty_message(self, definition: Definition, value: str) -> None:
        """Add the check that a value is the atom of a type without slots."""
        self.checks.append(f"{value} is not {self.new_name('A', atom(definition.functor_name))}")

    def unpack_message(self, definition: Definition, value: str) -> List[str]:
        """Unpack a message, and check its functor; return the variables of its slots."""
        functor_variable = self.new_name("f")
        slot_variables = [self.new_name("v") for _ in definition.fields]
        self.lines.append(f"{functor_variable}, {', '.join(slot_variables)} = {value}")
        expected_functor = functor(definition.functor_name, len(definition.fields))
        self.checks.append(f"{functor_variable} is not {self.new_name('F', expected_functor)}")
        return slot_variables

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
            self.add_array(slot, value)

    def add_array(self, slot: Field, value: str) -> None:
        """Add an array that is not unpacked in the generated code."""
        self.add_expression(f"{self.new_name('array', _compile_array_packer(slot))}({value})")

    def add_value(self, slot: Field, value: str) -> None:
        """Add a single value of a slot's type."""
        if slot.definition is not None:
            self.add_message(slot.definition, value)
        elif slot.type == "string":
            # A cached string is at least the four bytes of its length, so a false value means a miss.
            suffix = "_plain" if slot.is_plain else ""
            self.add_expression(f"(packed{suffix}({value}) or serialize{suffix}({value}))")
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
        if slot.length == VARIABLE_LENGTH:
            self.add_expression(f"(packed({value}) or serialize({value}))")
        else:
            self.add_expression(self.unpack_bytes(slot, value))

    def unpack_bytes(self, slot: Field, value: str) -> str:
        """Unpack an array of a fixed number of bytes, and check the number; return the variable of the bytes."""
        encoded_bytes = self.new_name("v")
        # The cache includes the length, which an array of fixed length does not have on the wire.
        self.lines.append(f"{encoded_bytes} = (packed({value}) or serialize({value}))[4:]")
        self.checks.append(f"len({encoded_bytes}) != {slot.length}")
        return encoded_bytes

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
        result = self.make_result_expression()
        return [*self.lines, *self.generate_type_check(), f"return {result}"]

    def generate_type_check(self) -> List[str]:
        """Return the statement that raises `UnusualForm` if a condition of `checks` is true, or nothing.

        All conditions are tested in one statement, after the term was unpacked.
        """
        return [f"if {' or '.join(self.checks)}: raise UnusualForm"] if self.checks else []


def _compile_encoder(definition: Definition) -> Callable[..., bytes]:
    generator = EncoderGenerator()
    generator.add_message(definition, "term")
    lines = [
        "def encode(term, topic=''):",
        "  try:",
        *("    " + line for line in generator.generate_statements()),
    ]
    lines += ["  except errors:", "    return encode_slot_by_slot(term, topic)"]
    generator.globals["encode_slot_by_slot"] = partial(encode_slot_by_slot, definition)
    encode: Callable[..., bytes] = codegen.function(
        lines, generator.globals, f"encode {definition.name}", "encode"
    )
    return encode


def _compile_array_packer(slot: Field) -> Callable[[Term], bytes]:
    """Return the function that packs an array's list, preceded by its length if that is variable."""
    decoder = find_number_decoder(slot)
    if decoder is not None:
        return _make_number_packer(slot, decoder)
    generator = EncoderGenerator()
    generator.add_value(slot._replace(length=None), "term")
    lines = ["def encode(term):", *("  " + line for line in generator.generate_statements())]
    element = codegen.function(lines, generator.globals, f"encode element {slot.type}", "encode")
    length = slot.length

    def encode(term: Term) -> bytes:
        items = list_of_usual_form(term)
        # The count precedes the elements only if the definition does not fix it.
        if length == VARIABLE_LENGTH:
            return pack("<I", len(items)) + b"".join(map(element, items))
        if len(items) != length:
            raise UnusualForm
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
            items = list_of_usual_form(term)
            count = len(items)
            encoded_bytes = pack(f"<{count}{code}", *items)
        if length == VARIABLE_LENGTH:
            return pack("<I", count) + encoded_bytes
        if count != length:
            raise UnusualForm
        return encoded_bytes

    return encode


def list_of_usual_form(term: Term) -> List[Term]:
    """Return the items of a list without variables in its structure.

    Raises:
        ValueError, TypeError, UnusualForm: if the term is not such a list.
    """
    if term.__class__ is Lazy:
        term = term.term()
    items = []
    # An improper list cannot be unpacked, or has another functor.
    tail: Any = term
    while tail is not NIL:
        cons, item, tail = tail
        if cons is not CONS:
            raise UnusualForm
        items.append(item)
    return items


def encode_slot_by_slot(definition: Definition, term: Term, topic: str = "") -> bytes:
    """Return the bytes of the message that a term denotes, in any allowed form.

    Raises:
        MessageError: with the topic, the slot, and what was expected.
    """
    chunks: List[bytes] = []
    try:
        _encode_message(definition, term, "", chunks)
    except _Misfit as misfit:
        location = [f"topic {topic}"] if topic else []
        location.append(definition.name)
        if misfit.path:
            location.append(f"slot {misfit.path}")
        raise MessageError(f"{', '.join(location)}: {misfit.reason}") from None
    return b"".join(chunks)


class _Misfit(Exception):
    """Raised for the slot ``path`` if a term does not fit it."""

    def __init__(self, path: str, reason: str):
        super().__init__(path, reason)
        self.path = path
        self.reason = reason


def _create_misfit(path: str, expected: str, term: Term) -> _Misfit:
    return _Misfit(path, f"expected {expected}, got {_describe_term(term)}")


def _encode_message(definition: Definition, term: Term, path: str, chunks: List[bytes]) -> None:
    """Add the bytes of a message to ``chunks``.

    Raises:
        _Misfit: if the term does not fit the type.
    """
    term = deref(term)
    slots = definition.fields
    if not slots:
        if not _is_empty_message(term, definition.functor_name):
            raise _create_misfit(path, f"the atom {definition.functor_name}", term)
        return
    if term.__class__ is not tuple or term[0].name != definition.functor_name or term[0].arity != len(slots):
        raise _create_misfit(path, f"{definition.functor_name}/{len(slots)}", term)
    for slot, value in zip(slots, term[1:]):
        _encode_slot(slot, value, f"{path}.{slot.name}" if path else slot.name, chunks)


def _is_empty_message(term: Term, name: str) -> bool:
    if term.__class__ is tuple:
        return len(term) == 1 and term[0].name == name
    return term.__class__ is Atom and term.name == name


def _encode_slot(slot: Field, term: Term, path: str, chunks: List[bytes]) -> None:
    """Add the bytes of a slot, a single value or an array, to ``chunks``."""
    if slot.length is None:
        _encode_single(slot, term, path, chunks)
        return
    if slot.is_bytes:
        raw = _get_bytes(slot, term, path)
        if slot.length == VARIABLE_LENGTH:
            chunks.append(pack("<I", len(raw)))
        chunks.append(raw)
        return
    array = lazy_array(term)
    if array is not None and array.decoder is find_number_decoder(slot):
        # The array has the bytes of the slot.
        count = element_count(array)
        _check_length(slot, count, path)
        if slot.length == VARIABLE_LENGTH:
            chunks.append(pack("<I", count))
        chunks.append(bytes(array.source))
        return
    items = _get_items(slot, term, path)
    if slot.length == VARIABLE_LENGTH:
        chunks.append(pack("<I", len(items)))
    element = slot._replace(length=None)
    for index, item in enumerate(items):
        _encode_single(element, item, f"{path}[{index}]", chunks)


def _get_items(slot: Field, term: Term, path: str) -> List[Term]:
    items = list_items(term)
    if items is None:
        raise _create_misfit(path, f"a list ({slot.describe()})", deref(term))
    _check_length(slot, len(items), path)
    return items


def _check_length(slot: Field, count: int, path: str) -> None:
    if slot.length != VARIABLE_LENGTH and count != slot.length:
        raise _Misfit(
            path, f"expected {format_count(slot.length or 0, 'element')} ({slot.describe()}), got {count}"
        )


def _get_bytes(slot: Field, term: Term, path: str) -> bytes:
    """Return the bytes of a byte array, which may be a string or a list of numbers."""
    array = lazy_array(term)
    if array is not None and array.decoder in (BLOB, find_number_decoder(slot)):
        _check_length(slot, len(array.source), path)
        return bytes(array.source)
    value = deref(term)
    # An empty list is an empty byte array; any other atom would be its text.
    if value.__class__ is tuple or value is NIL:
        chunks: List[bytes] = []
        for index, item in enumerate(_get_items(slot, value, path)):
            _encode_single(slot._replace(length=None), item, f"{path}[{index}]", chunks)
        return b"".join(chunks)
    raw = _get_text_bytes(value, path, f"a string or a list ({slot.describe()})")
    _check_length(slot, len(raw), path)
    return raw


def _get_text_bytes(
    value: Term, path: str, expected: str, read_bytes: Callable[[Term], Optional[bytes]] = text_bytes
) -> bytes:
    try:
        raw = read_bytes(value)
    except MessageError as error:
        raise _Misfit(path, error.message) from None
    if raw is None:
        raise _create_misfit(path, expected, value)
    return raw


def _encode_single(slot: Field, term: Term, path: str, chunks: List[bytes]) -> None:
    if slot.definition is not None:
        _encode_message(slot.definition, term, path, chunks)
        return
    pack_value = _encode_plain_string if slot.is_plain else _PACKERS[slot.type]
    chunks.append(pack_value(slot.type, deref(term), path))


def _encode_string(type_name: str, value: Term, path: str) -> bytes:
    raw = _get_text_bytes(value, path, "a string")
    return pack("<I", len(raw)) + raw


def _encode_plain_string(type_name: str, value: Term, path: str) -> bytes:
    raw = _get_text_bytes(value, path, "a text", plain_text_bytes)
    return pack("<I", len(raw)) + raw


def _encode_time(type_name: str, value: Term, path: str) -> bytes:
    # A time may also be a `datime` term, as in the variables `t1` and `t2` of a pattern.
    if type_name == "time" and value.__class__ is tuple and timestamps.is_instant(value):
        value = make_list(timestamps.to_parts(timestamps.from_term(value)))
    items = [deref(part) for part in list_items(value) or ()]
    parts = [part for part in items if isinstance(part, int)]
    if len(items) != 2 or len(parts) != 2:
        raise _create_misfit(path, f"{type_name} as [Sec,NSec]", value)
    code = TIMES[type_name]
    for part, name in zip(parts, ("Sec", "NSec")):
        _check_range(code[0], part, path, f"{type_name} as [Sec,NSec], {name}")
    return pack("<" + code, *parts)


def _encode_bool(type_name: str, value: Term, path: str) -> bytes:
    if value.__class__ is Atom and value in _BOOLS:
        return pack("<?", _BOOLS[value])
    # ROS constants of type bool are written as 0 and 1, too.
    if isinstance(value, int) and value in (0, 1):
        return pack("<?", value)
    raise _create_misfit(path, "bool (true or false)", value)


def _encode_integer(type_name: str, value: Term, path: str) -> bytes:
    if not isinstance(value, int):
        raise _create_misfit(path, type_name, value)
    _check_range(PRIMITIVES[type_name], value, path, type_name)
    return pack("<" + PRIMITIVES[type_name], value)


def _encode_float(type_name: str, value: Term, path: str) -> bytes:
    """Return the bytes of a float: a number, or ``inf``, ``infinite`` or ``nan``, also negated."""
    if value.__class__ is Atom:
        value = _SPECIAL_FLOATS.get(value, value)
    elif value.__class__ is tuple and value[0] is _MINUS_FUNCTOR:
        operand = deref(value[1])
        value = (
            -_SPECIAL_FLOATS[operand] if operand.__class__ is Atom and operand in _SPECIAL_FLOATS else value
        )
    if not isinstance(value, (float, int)):
        raise _create_misfit(path, type_name, value)
    try:
        return pack("<" + PRIMITIVES[type_name], value)
    # A float64 that exceeds the range of float32, or an integer that exceeds that of floats.
    except (OverflowError, StructError):
        raise _Misfit(path, f"{_describe_term(value)} is too large for {type_name}") from None


def _check_range(code: str, value: int, path: str, expected: str) -> None:
    low, high = integer_range(code)
    if not low <= value <= high:
        raise _Misfit(path, f"expected {expected} from {low} to {high}, got {value}")


_Packer = Callable[[str, Term, str], bytes]
"""Takes a type, a dereferenced term, and the path of the slot; returns the bytes of the value."""

_PACKERS: Dict[str, _Packer] = {
    **dict.fromkeys(PRIMITIVES, _encode_integer),
    "bool": _encode_bool,
    **dict.fromkeys(FLOATS, _encode_float),
    "string": _encode_string,
    "time": _encode_time,
    "duration": _encode_time,
}


def _describe_term(term: Term) -> str:
    """Return a short description of a term for an error: its type and its beginning."""
    term = deref(term)
    if term.__class__ is Var:
        return "an unbound variable"
    items = list_items(term)
    if items is not None:
        return f"a list of {len(items)}" if items else "an empty list"
    if term.__class__ is tuple:
        head: Functor = term[0]
        return f"{head.name}/{head.arity}"
    if term.__class__ is Atom:
        return _shorten("the atom ", term.name)
    if term.__class__ is PrologString:
        return _shorten("the string ", f'"{term.text}"')
    return _shorten("", repr(term))


def _shorten(prefix: str, text: str) -> str:
    return prefix + (text if len(text) <= _MAX_SHOWN_CHARACTERS else text[:_MAX_SHOWN_CHARACTERS] + "...")


_DEFAULT_TERMS: Dict[str, Term] = {
    "string": atom('""'),
    "bool": FALSE,
    "time": make_list([0, 0]),
    "duration": make_list([0, 0]),
}
_TIME_PART_FIELD = Field("", "uint32")

MAX_CHECKED_BYTES = 1 << 20
"""Types with larger minimum messages are not checked: values would have to be created for all their variables."""


def find_fault(definition: Definition, term: Term, topic: str = "") -> Optional[str]:
    """Return why a term with variables cannot become a message of a type, or None if it can.

    Types whose smallest message exceeds `MAX_CHECKED_BYTES` are not checked.
    """
    # Filling in values would allocate a message of that size for a check before start.
    if definition.measure.min_size > MAX_CHECKED_BYTES:
        return None
    try:
        encode_slot_by_slot(definition, _fill_message(definition, term), topic)
    except MessageError as error:
        return error.message
    return None


def _fill_message(definition: Definition, term: Term) -> Term:
    """Return the message with variables replaced by values that fit."""
    term = deref(term)
    if term.__class__ is Var:
        return _create_default_message(definition)
    # A term of another form stays as it is: the encoder reports it.
    if term.__class__ is not tuple or len(term) - 1 != len(definition.fields):
        return term
    return (
        term[0],
        *[_fill_slot(slot, value) for slot, value in zip(definition.fields, term[1:])],
    )


def _fill_slot(slot: Field, value: Term) -> Term:
    value = deref(value)
    if value.__class__ is Var:
        return _create_default_value(slot)
    if slot.length is not None:
        return _fill_list(slot, slot._replace(length=None), value)
    if slot.definition is not None:
        return _fill_message(slot.definition, value)
    return _fill_list(slot, _TIME_PART_FIELD, value) if slot.type in TIMES else value


def _fill_list(slot: Field, element: Field, value: Any) -> Term:
    """Return the list with variables replaced by values that fit; the same if its tail is a variable."""
    items: List[Term] = []
    tail = value
    while tail.__class__ is tuple and tail[0] is CONS:
        items.append(_fill_slot(element, tail[1]))
        tail = deref(tail[2])
    # A partial list stands for lists of any length: its known elements are not checked.
    if tail.__class__ is Var:
        return _create_default_value(slot)
    return make_list(items) if tail is NIL else value


def _create_default_value(slot: Field) -> Term:
    if slot.length is not None:
        count = 0 if slot.length == VARIABLE_LENGTH else slot.length
        return make_list([_create_default_value(slot._replace(length=None))] * count)
    return (
        _DEFAULT_TERMS.get(slot.type, 0)
        if slot.definition is None
        else _create_default_message(slot.definition)
    )


def _create_default_message(definition: Definition) -> Term:
    slots = definition.fields
    if not slots:
        return atom(definition.functor_name)
    return (functor(definition.functor_name, len(slots)), *map(_create_default_value, slots))
