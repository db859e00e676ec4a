"""Types of stored fields: how values are checked when they are read, and how they are encoded.

State files are not trusted. A type checks each value before it reaches its owner, and returns it in the form that the
owner uses. An error is a `UsageError` whose text begins with the path of the value. Types of sequences, tuples and
records combine those of their items. Values of many objects are stored in columns, which a type can check and encode
faster than one by one.
"""

from __future__ import annotations

import re
from math import isfinite
from struct import error as StructError
from struct import pack, unpack
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    FrozenSet,
    Generic,
    Hashable,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Type,
    TypeVar,
    Union,
)

from ..foundation.errors import RetalisError, UsageError
from ..prolog.terms.timestamps import MAX_TIMESTAMP, FloatSeconds, Stamp
from ..prolog.terms.types import Atom, CompoundTerm, Functor, String, Term, Var

if TYPE_CHECKING:
    from .object_graph import ObjectReader, ObjectWriter

Value = TypeVar("Value")
Key = TypeVar("Key", bound=Hashable)
Item = TypeVar("Item")
Row = TypeVar("Row", bound=NamedTuple)

ValueCheck = Callable[[object], Value]
"""Returns a decoded value in the form that its owner uses, or raises a `UsageError`."""

Encode = Callable[[Value, "ObjectWriter"], object]
"""Returns the value of a field as data that the codec accepts, given the writer of the objects that it refers to."""

ColumnCheck = Callable[[object, Sequence[int]], Sequence[Value]]
"""Returns the values of a column, given the numbers of the objects or rows that have them."""

State = Dict[str, Any]
"""Values of the fields of an object, by name. Their types are declared beside the class of the object."""

NestedPairs = Union[Tuple[()], Tuple["NestedPairs[Item]", Item]]
"""Linked list ``((((), first), second), third)``."""

MAX_INSTANT = 1 << 80
"""Limit of instants in ns: larger than any value by which the engine itself represents "never"."""

MAX_COUNT = (1 << 63) - 1

MAX_KEY_DEPTH = 8
"""Maximum nesting of keys: hashing a deeply nested tuple would overflow the stack of the process."""

ITEM_FUNCTOR_NAME = "item of a run"
"""Name of terms that hold the values of one repetition, and so may contain instants."""


class FlatKey(tuple):  # type: ignore[type-arg]
    """A dictionary key of a term, see `term_key`, which is not a term itself."""

    __slots__ = ()


_SEQUENCES = (list, tuple)
_OBJECT = re.compile(r"<[\w.]+ object at 0x[0-9a-f]+>")
"""Python's representation of an object whose class has none of its own."""
_INSTANTS: FrozenSet[type] = frozenset((int, FloatSeconds, Stamp))
_KEYS: FrozenSet[type] = frozenset((int, Atom, String, Functor))


def invalid_value(value: object, expected: str) -> UsageError:
    """Return the error for an invalid value."""
    try:
        text_of_value = value if isinstance(value, str) else _OBJECT.sub(_class_in_words, repr(value))
    except (ValueError, RecursionError):  # an integer with too many digits, or a deeply nested sequence
        text_of_value = type(value).__name__
    return UsageError(f"'{text_of_value[:80]}': expected {expected}")


def _class_in_words(match: re.Match[str]) -> str:
    """Return "partial match" for an object of class ``PartialMatch``, whose address says nothing to a user."""
    class_name = match[0].partition(" ")[0].rpartition(".")[2]
    return "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in class_name).strip()


def items_of(value: object) -> Sequence[object]:
    """Return the items of a sequence."""
    if isinstance(value, _SEQUENCES):
        return value
    raise invalid_value(value, "a sequence")


def with_path(name: str, check: ValueCheck[Value]) -> ValueCheck[Value]:
    """Return a check whose error texts begin with a name."""

    def check_named(value: object) -> Value:
        try:
            return check(value)
        except RetalisError as error:
            raise UsageError(f"{name}: {error.message}") from None

    return check_named


# ---- types -------------------------------------------------------------------------------------------


class FieldChange(NamedTuple):
    """Change of the fields of a record from one format to the next.

    Attributes:
        renamed: new names by former names.
        added: values of new fields by name, as they are stored.
        removed: names of fields that are dropped.
        convert: returns the stored fields by name from those with the new names; None if no value changes.
    """

    renamed: Mapping[str, str] = {}
    added: Mapping[str, object] = {}
    removed: Sequence[str] = ()
    convert: Optional[Callable[[Dict[str, object]], Dict[str, object]]] = None


class SameForAll(NamedTuple):
    """A column of an added field: one value for all rows."""

    value: object


class ReadContext(NamedTuple):
    """Context of the checks of a state.

    Attributes:
        objects: the objects that the state can refer to; None if it has no references.
        changes: by name of a record, the changes from the format of the file to the present one, oldest first.
        check_item: check of an object in the state of a part, set by the owner of the part; see `part_state`.
    """

    objects: Optional[ObjectReader] = None
    changes: Mapping[str, Sequence[FieldChange]] = {}
    check_item: Callable[[object, int], None] = lambda item, channel: None


NO_CONTEXT = ReadContext()
NO_OBJECTS: ObjectWriter = None  # type: ignore[assignment]


class FieldType(Generic[Value]):
    """Type of the values of a field: how they are checked and encoded, one by one and as a column.

    Args:
        name: description in `StateFields.describe`.
        encoder: encoding of a value; None if it is stored unchanged.
        has_sources: whether values can have references to what an object consists of, see `reference`.
    """

    def __init__(
        self,
        name: str,
        checker: Callable[[ReadContext], ValueCheck[Value]],
        encoder: Optional[Encode[Value]] = None,
        has_sources: bool = False,
    ):
        self.name = name
        self.checker = checker
        self.encoder = encoder
        self.has_sources = has_sources

    def check(self, value: object) -> Value:
        """Check a value of a type without references.

        Raises:
            UsageError: if the value is invalid.
        """
        return self.checker(NO_CONTEXT)(value)

    def encode(self, value: Value) -> object:
        """Return the encoding of a value of a type without references."""
        return value if self.encoder is None else self.encoder(value, NO_OBJECTS)

    def column_checker(self, context: ReadContext) -> ColumnCheck[Value]:
        """Return the check of a column."""
        check = self.checker(context)
        if not self.has_sources:
            return lambda column, numbers: check_items(items_of(column), check)
        objects = objects_of(context)

        def check_column(column: object, numbers: Sequence[int]) -> Sequence[Value]:
            values = []
            for number, value in zip(numbers, items_of(column)):
                objects.current_sources = objects.sources_of(number)
                values.append(check(value))
            return values

        return check_column

    def encode_column(self, values: List[Value], graph: ObjectWriter) -> object:
        """Return the encoding of a column."""
        encode = self.encoder
        return values if encode is None else [encode(value, graph) for value in values]


def encode_each(
    values: Iterable[object], encodings: Sequence[Optional[Encode[Any]]], graph: ObjectWriter
) -> List[object]:
    """Return the encodings of values of several types; see `FieldType.encoder`."""
    return [value if encode is None else encode(value, graph) for encode, value in zip(encodings, values)]


def check_items(values: Iterable[object], check: ValueCheck[Value]) -> List[Value]:
    """Return checked values; the error text of an invalid one begins with its index."""
    checked: List[Value] = []
    try:
        # If a value is rejected, those before it remain in the list, which gives its index.
        checked += map(check, values)
    except RetalisError as error:
        raise UsageError(f"item {len(checked)}: {error.message}") from None
    return checked


class PlainType(FieldType[Value]):
    """Type whose check needs no context and whose values are stored unchanged.

    Args:
        name: description.
        check: see `Check`.
        classes: if given, `check` returns values of exactly these classes unchanged, and rejects all others.
    """

    def __init__(self, name: str, check: ValueCheck[Value], classes: FrozenSet[type] = frozenset()):
        super().__init__(name, lambda context: check)
        self.classes = classes
        self._check = check

    def check_all(self, values: Sequence[object]) -> Sequence[Value]:
        """Return checked values."""
        # Columns have thousands of values: their classes are compared by functions that are implemented in C.
        if self.classes.issuperset(map(type, values)):
            return values  # type: ignore[return-value]
        return check_items(values, self._check)

    def column_checker(self, context: ReadContext) -> ColumnCheck[Value]:
        """See `FieldType.column_checker`."""
        return lambda column, numbers: self.check_all(items_of(column))


def instances(expected: str, *classes: Type[Value]) -> PlainType[Value]:
    """Return the type of the instances of exactly these classes; ``expected`` describes them in the error."""

    def check(value: object) -> Value:
        if type(value) not in classes:
            raise invalid_value(value, expected)
        return value  # type: ignore[return-value]

    return PlainType(expected, check, frozenset(classes))


def _check_path(value: object) -> str:
    if type(value) is not str or "\0" in value:
        raise invalid_value(value, "a path")
    return value


def _check_seconds(value: object) -> float:
    if (type(value) is int or type(value) is float) and isfinite(value):
        return value
    raise invalid_value(value, "a number of seconds")


def _check_match_value(value: object) -> Term:
    # An integer is a term; the start or end of a part of a match is an instant of another class.
    return INSTANT.check(value) if type(value) in (FloatSeconds, Stamp) else TERM.check(value)


def _check_key(value: object, depth: int = MAX_KEY_DEPTH) -> Hashable:
    value_class = type(value)
    if value is None or value_class in _KEYS or value_class is str:
        return value
    if isinstance(value, FlatKey):
        return tuple(value)
    if isinstance(value, tuple):
        if all(type(item) in _KEYS for item in value):
            return value
    elif isinstance(value, list) and depth:
        return tuple([_check_key(item, depth - 1) for item in value])
    raise invalid_value(value, "a key")


def _check_finite_number(value: object) -> float:
    number = NUMBER.check(value)
    # An integer can be too large for a float, and is finite.
    if type(number) is float and not isfinite(number):
        raise invalid_value(value, "a finite number")
    return number


def _check_comparable_number(value: object) -> float:
    number = NUMBER.check(value)
    if number != number:  # not a number
        raise invalid_value(value, "a number with an order")
    return number


ANYTHING: PlainType[object] = PlainType("any data, which its owner checks", lambda value: value)
INTEGER = instances("an integer", int)
BOOLEAN = instances("true or false", bool)
TEXT = instances("a text", str)
FUNCTOR = instances("a functor", Functor)
VARIABLE = instances("a variable", Var)
NOTHING = instances("nothing", type(None))
PATH = PlainType("a path", _check_path)
SECONDS = PlainType("a number of seconds", _check_seconds)
TERM: PlainType[Term] = instances("a term", int, float, Atom, String, Var, tuple)
"""A term; the arguments of compound terms are checked when they are decoded."""

MATCH_VALUE = PlainType("a term, or an instant of a part of a match", _check_match_value)
CALLABLE_TERM: PlainType[Term] = instances("an atom or a compound term", Atom, tuple)
COMPOUND_TERM: PlainType[CompoundTerm] = instances("a compound term", tuple)
KEY = PlainType("a key of constants, terms of constants, and tuples of such keys", _check_key)
NUMBER: PlainType[float] = instances("a number", int, float)
FINITE = PlainType("a finite number", _check_finite_number)
ORDERED = PlainType("a number with an order", _check_comparable_number)


class _IntegerType(PlainType[int]):
    """Integers in a range."""

    def __init__(self, minimum: int, maximum: int):
        def check(value: object) -> int:
            if type(value) is not int or not minimum <= value <= maximum:
                raise invalid_value(value, f"an integer from {minimum} to {maximum}")
            return value

        super().__init__(f"an integer from {minimum} to {maximum}", check)
        self._minimum = minimum
        self._maximum = maximum

    def check_all(self, values: Sequence[object]) -> Sequence[int]:
        """See `PlainType.check_all`."""
        if set(map(type, values)) == {int}:
            integers: Sequence[int] = values  # type: ignore[assignment]
            if self._minimum <= min(integers) and max(integers) <= self._maximum:
                return integers
        return check_items(values, self.check)


def integer(minimum: int = -MAX_COUNT, maximum: int = MAX_COUNT) -> PlainType[int]:
    """Return the type of the integers in a range."""
    return _IntegerType(minimum, maximum)


COUNT = integer(0)
MATCH_ORDER = integer(0, 2 * MAX_INSTANT)
"""The order of a match, which is a timestamp or a number that follows one."""


def one_of(*values: Value) -> PlainType[Value]:
    """Return the type of some constants."""
    expected = f"one of {', '.join(map(str, values))}"

    def check(value: object) -> Value:
        # Classes are compared as well, because True equals 1.
        for allowed in values:
            if type(value) is type(allowed) and value == allowed:
                return allowed
        raise invalid_value(value, expected)

    return PlainType(expected, check)


_CLASS_CODES: Dict[type, int] = {int: 0, FloatSeconds: 1, Stamp: 2}
"""Codes of the classes of instants, which print differently."""


def encode_instants(instants: Sequence[int]) -> Tuple[object, ...]:
    """Return columns of instants: nanoseconds as 64-bit integers if they fit, class codes, terms of stamps."""
    classes = set(map(type, instants))
    # Integers, float seconds and stamps with their own text print differently. Usually all instants are alike.
    if len(classes) == 1:
        class_codes = bytes([_CLASS_CODES[classes.pop()]]) * len(instants)
    else:
        class_codes = bytes(map(_CLASS_CODES.__getitem__, map(type, instants)))
    stamps = [instant.term for instant in instants if isinstance(instant, Stamp)] if 2 in class_codes else []
    try:
        return pack(f"{len(instants)}q", *instants), class_codes, stamps
    except StructError:
        return [int(instant) for instant in instants], class_codes, stamps


def decode_instants(value: object, expected_count: Optional[int] = None) -> List[int]:
    """Return instants from their columns, checked.

    Raises:
        UsageError: if the columns are invalid.
    """
    if len(items_of(value)) != 3:
        raise invalid_value(value, "3 columns of instants")
    numbers, class_codes, stamps = items_of(value)
    terms = TERM.column_checker(NO_CONTEXT)(stamps, ())
    if (
        type(class_codes) is not bytes
        or class_codes.translate(None, b"\0\1\2")
        or class_codes.count(2) != len(terms)
    ):
        raise invalid_value(class_codes, "the forms of instants")
    if expected_count not in (None, len(class_codes)):
        raise invalid_value(len(class_codes), f"{expected_count} instants")
    integers: Sequence[int]
    if type(numbers) is bytes:
        if len(numbers) != 8 * len(class_codes):
            raise invalid_value(len(numbers), f"{len(class_codes)} instants")
        integers = unpack(f"{len(class_codes)}q", numbers)
    else:
        integers = check_items(items_of(numbers), INSTANT.check)
        if len(integers) != len(class_codes):
            raise invalid_value(numbers, f"{len(class_codes)} instants")
    if not any(class_codes):
        return list(integers)
    if class_codes.count(1) == len(class_codes):
        return list(map(FloatSeconds, integers))
    next_term = iter(terms)
    return [
        number
        if class_code == 0
        else FloatSeconds(number)
        if class_code == 1
        else Stamp.of(number, next(next_term))
        for number, class_code in zip(integers, class_codes)
    ]


class _InstantType(PlainType[int]):
    """Instants in nanoseconds, in any of their forms."""

    def column_checker(self, context: ReadContext) -> ColumnCheck[int]:
        """See `FieldType.column_checker`."""

        def check_column(column: object, numbers: Sequence[int]) -> Sequence[int]:
            instants = decode_instants(column, len(numbers))
            return instants if self is INSTANT else check_items(instants, self.check)

        return check_column

    def encode_column(self, values: List[int], graph: ObjectWriter) -> object:
        """See `FieldType.encode_column`."""
        return encode_instants(values)


def _check_instant(value: object) -> int:
    if type(value) not in _INSTANTS or not -MAX_INSTANT <= value <= MAX_INSTANT:  # type: ignore[operator]
        raise invalid_value(value, "an instant")
    return value  # type: ignore[return-value]


def _check_clock_instant(value: object) -> int:
    # A clock nearer to the largest instant of the format would leave no room for the events after a restore.
    instant = _check_instant(value)
    if abs(instant) > _MAX_CLOCK_INSTANT:
        raise invalid_value(value, "an instant that a clock can reach")
    return instant


_MAX_CLOCK_INSTANT = MAX_TIMESTAMP + (1 << 60)
"""Largest instant in ns that a clock reaches: each event without a timestamp advances it by 1 ns."""

INSTANT = _InstantType("an instant", _check_instant)
CLOCK_INSTANT = _InstantType("an instant that a clock can reach", _check_clock_instant)


def optional(content: FieldType[Item]) -> FieldType[Optional[Item]]:
    """Return the type of values of a type, or None."""

    def checker(context: ReadContext) -> ValueCheck[Optional[Item]]:
        check = content.checker(context)
        return lambda value: None if value is None else check(value)

    encode = content.encoder
    return FieldType(
        f"{content.name}, or nothing",
        checker,
        None if encode is None else lambda value, graph: None if value is None else encode(value, graph),
        content.has_sources,
    )


def sequence_of(
    content: FieldType[Item],
    make: Callable[[Sequence[Item]], Sequence[Item]] = list,
    min_count: int = 0,
) -> FieldType[Sequence[Item]]:
    """Return the type of sequences of values of one type.

    Args:
        content: type of the items.
        make: makes the owner's form from the sequence of items, which are stored in its order of iteration.
        min_count: minimum number of items.
    """

    def checker(context: ReadContext) -> ValueCheck[Sequence[Item]]:
        check = content.checker(context)
        check_all = content.check_all if isinstance(content, PlainType) else None

        def check_sequence(value: object) -> Sequence[Item]:
            values = items_of(value)
            if len(values) < min_count:
                raise invalid_value(value, f"at least {min_count} items")
            checked = check_items(values, check) if check_all is None else check_all(values)
            return checked if make is type(checked) else make(checked)

        return check_sequence

    encode = content.encoder
    # The codec accepts lists and tuples only. Other sequences are stored as lists, which the encoding of items makes.
    assert encode is not None or make in (list, tuple)
    return FieldType(
        f"a sequence of [{content.name}]",
        checker,
        None if encode is None else lambda values, graph: [encode(value, graph) for value in values],
        content.has_sources,
    )


def tuple_of(*contents: FieldType[Any]) -> FieldType[Tuple[Any, ...]]:
    """Return the type of tuples with one type for each item."""

    def checker(context: ReadContext) -> ValueCheck[Tuple[object, ...]]:
        checks = [content.checker(context) for content in contents]

        def check_tuple(value: object) -> Tuple[object, ...]:
            values = items_of(value)
            if len(values) != len(checks):
                raise invalid_value(value, f"{len(checks)} items")
            return tuple([check(item) for check, item in zip(checks, values)])

        return check_tuple

    encodings = [content.encoder for content in contents]
    return FieldType(
        f"({', '.join(content.name for content in contents)})",
        checker,
        (lambda values, graph: encode_each(values, encodings, graph)) if any(encodings) else None,
        any(content.has_sources for content in contents),
    )


def mapping_of(key: FieldType[Key], content: FieldType[Item]) -> FieldType[Dict[Key, Item]]:
    """Return the type of mappings, stored as pairs, without duplicate keys."""
    pairs_type = sequence_of(tuple_of(key, content))

    def checker(context: ReadContext) -> ValueCheck[Dict[Key, Item]]:
        check_pairs = pairs_type.checker(context)

        def check_mapping(value: object) -> Dict[Key, Item]:
            pairs = check_pairs(value)
            result = dict(pairs)
            if len(result) != len(pairs):
                raise invalid_value(value, "each key once")
            return result

        return check_mapping

    encode_pairs = pairs_type.encoder
    return FieldType(
        f"a mapping from [{key.name}] to [{content.name}]",
        checker,
        lambda mapping, graph: (
            list(mapping.items()) if encode_pairs is None else encode_pairs(list(mapping.items()), graph)
        ),
    )


def nested_pairs_of(content: FieldType[Item]) -> FieldType[NestedPairs[Item]]:
    """Return the type of `NestedPairs`, stored as sequences: nested data would be as deep as long."""
    items_type = sequence_of(content)

    def checker(context: ReadContext) -> ValueCheck[NestedPairs[Item]]:
        check = items_type.checker(context)

        def check_pairs(value: object) -> NestedPairs[Item]:
            pairs: NestedPairs[Item] = ()
            for item in check(value):
                pairs = (pairs, item)
            return pairs

        return check_pairs

    def encode(pairs: NestedPairs[Item], graph: ObjectWriter) -> List[Item]:
        values: List[Item] = []
        while pairs:
            pairs, item = pairs
            values.append(item)
        values.reverse()
        return values

    return FieldType(f"nested pairs of [{content.name}]", checker, encode)


def stored_as(
    content: FieldType[Item], make: Callable[[Item], Value], stored: Callable[[Value], Item]
) -> FieldType[Value]:
    """Return the type of values that are stored as values of another type."""

    def checker(context: ReadContext) -> ValueCheck[Value]:
        check = content.checker(context)
        return lambda value: make(check(value))

    encode = content.encoder
    return FieldType(
        content.name,
        checker,
        lambda value, graph: stored(value) if encode is None else encode(stored(value), graph),
        content.has_sources,
    )


def compact_record_of(row_class: Type[Row], **fields: FieldType[Any]) -> FieldType[Row]:
    """Return the type of named tuples that occur often, stored as sequences; their fields do not change."""
    assert tuple(fields) == row_class._fields, row_class
    assert not any(content.encoder for content in fields.values()), row_class
    make: Callable[..., Row] = row_class

    def checker(context: ReadContext) -> ValueCheck[Row]:
        checks = [with_path(name, content.checker(context)) for name, content in fields.items()]

        def check(value: object) -> Row:
            values = items_of(value)
            if len(values) != len(checks):
                raise invalid_value(value, f"{len(checks)} items")
            return make(*[check_value(item) for check_value, item in zip(checks, values)])

        return check

    contents = ", ".join(f"{name}: {content.name}" for name, content in fields.items())
    return FieldType(f"{row_class.__name__}: ({contents})", checker)


# ---- references to objects -------------------------------------------------------------------------------


def objects_of(context: ReadContext) -> ObjectReader:
    """Return the objects that a state refers to."""
    assert context.objects is not None
    return context.objects


class _ReferenceType(FieldType[object]):
    """References to objects, which a column has as numbers."""

    def __init__(self, name: str, kinds: Sequence[str], is_optional: bool, is_source: bool):
        def checker(context: ReadContext) -> ValueCheck[object]:
            read = objects_of(context).reference_reader(kinds, is_source)
            return (lambda value: None if value is None else read(value)) if is_optional else read

        super().__init__(
            name,
            checker,
            lambda value, graph: None if value is None else graph.reference_to(value),
            is_source,
        )
        self._kinds = kinds
        self._is_optional = is_optional

    def column_checker(self, context: ReadContext) -> ColumnCheck[object]:
        """See `FieldType.column_checker`."""
        objects = objects_of(context)

        def check_column(column: object, numbers: Sequence[int]) -> Sequence[object]:
            referenced = items_of(column)
            present = [number for number in referenced if number is not None]
            present_objects = objects.objects_by_number(present, self._kinds)
            if self.has_sources:
                for number, source in zip(numbers, referenced):
                    if isinstance(source, int):
                        objects.sources_of(number).append(source)
            if len(present) == len(referenced):
                return present_objects
            if not self._is_optional:
                raise invalid_value(None, self.name)
            remaining = iter(present_objects)
            return [None if number is None else next(remaining) for number in referenced]

        return check_column

    def encode_column(self, values: List[object], graph: ObjectWriter) -> object:
        """See `FieldType.encode_column`."""
        # Numbers need less space than references.
        return [None if value is None else graph.number_of(value) for value in values]


def reference(
    *kinds: str,
    is_optional: bool = False,
    is_source: bool = False,
    accepts: Optional[FieldType[Any]] = None,
) -> FieldType[object]:
    """Return the type of references to objects of some kinds.

    Args:
        kinds: names of `ObjectFields`, or of external objects, see `ObjectWriter`.
        is_optional: whether the value can be None.
        is_source: whether an object with this field consists of the object that it refers to. No object consists of
            itself, because the engine follows such references recursively.
        accepts: type of values other than references; None if there are none.
    """
    name = f"a reference to {' or '.join(kinds)}"
    if is_optional:
        name += ", or nothing"
    if accepts is None:
        return _ReferenceType(name, kinds, is_optional, is_source)
    accepted: FieldType[Any] = accepts

    def checker(context: ReadContext) -> ValueCheck[object]:
        objects = objects_of(context)
        read, check_other = objects.reference_reader(kinds, is_source), accepted.checker(context)
        return lambda value: read(value) if objects.is_reference(value) else check_other(value)

    def encode(value: object, graph: ObjectWriter) -> object:
        if graph.is_object(value):
            return graph.reference_to(value)
        return value if value is None or accepted.encoder is None else accepted.encoder(value, graph)

    return FieldType(f"{name}, or {accepts.name}", checker, encode, is_source)


def references(*kinds: str) -> FieldType[Sequence[object]]:
    """Return the type of sequences of many objects, stored as their numbers."""

    def checker(context: ReadContext) -> ValueCheck[Sequence[object]]:
        objects = objects_of(context)
        return lambda value: objects.objects_by_number(items_of(value), kinds)

    return FieldType(
        f"references to {' or '.join(kinds)}",
        checker,
        lambda values, graph: list(map(graph.number_of, values)),
    )


def objects_and_values(*kinds: str, accepts: FieldType[Any]) -> FieldType[Optional[Tuple[object, ...]]]:
    """Return the type of sequences of objects, stored as numbers, and other values, stored as sequences of one item.

    Args:
        kinds: kinds of the objects.
        accepts: type of the other values.
    """

    def checker(context: ReadContext) -> ValueCheck[Optional[Tuple[object, ...]]]:
        objects = objects_of(context)
        check_other = accepts.checker(context)

        def check_part(part: object) -> object:
            if type(part) is int:
                (item,) = objects.objects_by_number([part], kinds)
                objects.current_sources.append(part)
                return item
            if len(items_of(part)) != 1:
                raise invalid_value(part, "1 item")
            return check_other(items_of(part)[0])

        return lambda value: None if value is None else tuple(check_items(items_of(value), check_part))

    def encode(parts: Optional[Tuple[object, ...]], graph: ObjectWriter) -> object:
        if parts is None:
            return None
        # A number of an object and a number that is a part itself must differ.
        return [graph.number_of(part) if graph.is_object(part) else [part] for part in parts]

    return FieldType(f"objects, {' or '.join(kinds)}, or {accepts.name}", checker, encode, has_sources=True)
