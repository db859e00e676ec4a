"""Column encodings of terms, of instants, and of the records of memories.

A memory can have hundreds of thousands of records, and a rule as many partial matches. Their terms are encoded in
columns: terms with the same functor become one column per argument, recursively. A column of floats is packed as
64-bit numbers. A column with repeated objects is stored as indexes into a list of distinct objects, as in the
dictionary encoding of Apache Parquet. Columns are created and read with functions that are implemented in C.
"""

from itertools import chain, repeat
from operator import is_, itemgetter
from struct import error as StructError
from struct import pack, unpack
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ..prolog.terms.timestamps import FloatSeconds, Stamp
from ..prolog.terms.types import Atom, Term
from .decoded_value_checks import (
    Decoded,
    any_value,
    boolean,
    count,
    functor,
    instant,
    invalid_value,
    items,
    sequence_of,
    term,
    tuple_of,
    with_name,
)

_MIN_COLUMN_TERMS, _MAX_COLUMN_DEPTH, _MAX_COLUMNS = 50, 4, 64
"""Minimum number of terms that are encoded in columns; maximum nesting and total number of columns."""

_SAMPLE_SIZE = 200
"""Number of terms that are examined for repeated objects."""

_PART_SIZE = 1000
"""Number of terms that are encoded together: their arguments fit into the processor's cache, which halves the time.

Must not exceed 65,536, because positions have 16 bits.
"""

_MAX_BYTE_POSITIONS = 256
"""Maximum number of distinct terms in a column for positions of 8 bits."""

_CLASS_CODES: Dict[Any, int] = {int: 0, FloatSeconds: 1, Stamp: 2}
"""Codes of the classes of instants, which print differently."""


# ---- terms -------------------------------------------------------------------------------------------


def encode_terms(terms: List[Term]) -> List[Any]:
    """Return the encoding of terms, in parts of `_PART_SIZE` terms."""
    if len(terms) <= _PART_SIZE:
        return _encode_part(terms)
    return [
        "parts",
        [_encode_part(terms[start : start + _PART_SIZE]) for start in range(0, len(terms), _PART_SIZE)],
    ]


def _encode_part(terms: List[Term], depth: int = 0, column_budget: Optional[List[None]] = None) -> List[Any]:
    """Return the encoding of terms: as columns of their arguments if all have the same functor.

    Columns of floats are packed. A column with repeated objects, such as atoms, is encoded as indexes into a list of
    distinct objects.
    """
    column_budget = [None] * _MAX_COLUMNS if column_budget is None else column_budget
    if len(terms) < _MIN_COLUMN_TERMS:
        return _encode_list(terms)
    column: Any = terms
    first_class = column[0].__class__
    if first_class is float:
        if set(map(type, column)) == {float}:
            return ["floats", pack(f"{len(column)}d", *column)]
        return _encode_list(terms)
    if first_class is Atom and set(map(type, column)) == {Atom}:
        return _encode_indexed(column, dict.fromkeys(column))
    # A sample decides between columns and positions: comparing all objects would cost as much as encoding them.
    mostly_distinct = 10 * len(set(map(id, column[:_SAMPLE_SIZE]))) >= 9 * min(len(column), _SAMPLE_SIZE)
    if first_class is tuple and mostly_distinct:
        # Deeper arguments are rare in messages, and many short columns would cost more than they save.
        flat_terms = _flatten_terms(column) if depth < _MAX_COLUMN_DEPTH else None
        width = len(column[0])
        if flat_terms is not None and width <= len(column_budget) + 1:
            # The list is a mutable counter that nested calls share: one item per column that may still be created.
            del column_budget[: width - 1]
            encoded_columns = [
                _encode_part(flat_terms[position::width], depth + 1, column_budget)
                for position in range(1, width)
            ]
            return ["columns", column[0][0], encoded_columns]
    elif first_class is not int and not mostly_distinct:
        keys = list(map(id, column))
        return _encode_indexed(column, dict(zip(keys, column)), keys)
    return _encode_list(terms)


def _encode_list(terms: List[Term]) -> List[Any]:
    """Return terms as a list, with instants as integers."""
    classes = set(map(type, terms))
    if FloatSeconds in classes or Stamp in classes:
        terms = [int(term) if isinstance(term, int) else term for term in terms]
    return ["terms", terms]


def _encode_indexed(
    terms: List[Term], distinct: Dict[Any, Any], keys: Optional[List[int]] = None
) -> List[Any]:
    """Return terms as positions in the list of distinct terms.

    Args:
        terms: the terms.
        distinct: the distinct terms; atoms as keys, other terms as values of their ids.
        keys: ids of terms other than atoms, because hashing a compound term would visit its arguments.
    """
    positions = dict(zip(distinct, range(len(distinct))))
    term_indexes = itemgetter(*(keys or terms))(positions)
    packed = (
        bytes(term_indexes)
        if len(distinct) <= _MAX_BYTE_POSITIONS
        else pack(f"{len(term_indexes)}H", *term_indexes)
    )
    return ["indexed", _encode_list(list(distinct.values() if keys else distinct))[1], packed]


def _flatten_terms(terms: Sequence[Any]) -> Optional[List[Any]]:
    """Return functors and arguments of compound terms in one list, or None if the functors differ.

    Functors only occur as the first item of a term. Therefore all terms have the functor that is found at each
    multiple of the width.
    """
    try:
        flat_terms = list(chain.from_iterable(terms))
    except TypeError:  # a term that is not compound
        return None
    width = len(terms[0])
    if len(flat_terms) != width * len(terms) or flat_terms[::width].count(flat_terms[0]) != len(terms):
        return None
    return flat_terms


def decode_terms(value: Decoded, term_count: int, depth: int = 0) -> Sequence[Term]:
    """Return the given number of terms from their encoding, checked.

    Raises:
        UsageError: if the encoding is invalid.
    """
    encoding, *content = items(value) or [None]
    # Parts cannot be nested, so their sizes follow from the number of terms.
    if encoding == "parts" and len(content) == 1 and not depth:
        sizes = [min(_PART_SIZE, term_count - start) for start in range(0, term_count, _PART_SIZE)]
        if len(items(content[0])) == len(sizes):
            parts = [decode_terms(part, size, 1) for part, size in zip(content[0], sizes)]
            return list(chain.from_iterable(parts))
    if (
        encoding == "floats"
        and len(content) == 1
        and content[0].__class__ is bytes
        and len(content[0]) == 8 * term_count
    ):
        return unpack(f"{term_count}d", content[0])
    if encoding == "indexed" and len(content) == 2 and content[1].__class__ is bytes:
        terms: Sequence[Term] = _decode_indexed(sequence_of(term)(content[0]), content[1])
        if len(terms) == term_count:
            return terms
    if encoding == "columns" and len(content) == 2 and depth <= _MAX_COLUMN_DEPTH + 1:
        term_functor = functor(content[0])
        columns = [decode_terms(column, term_count, depth + 1) for column in items(content[1])]
        if len(columns) == term_functor.arity > 0:
            return list(zip(repeat(term_functor, term_count), *columns))
    if encoding == "terms" and len(content) == 1:
        terms = sequence_of(term)(content[0])
        if len(terms) == term_count:
            return terms
    raise invalid_value(encoding, f"{term_count} terms")


def _decode_indexed(distinct: List[Term], packed: bytes) -> List[Term]:
    """Return terms from their positions in the list of distinct terms."""
    positions: Sequence[int] = packed
    if len(distinct) > _MAX_BYTE_POSITIONS:
        if len(packed) % 2:
            raise invalid_value(len(packed), "positions of 2 bytes")
        positions = unpack(f"{len(packed) // 2}H", packed)
    # The file is not trusted: a position out of range must raise an error that names it.
    if positions and max(positions) >= len(distinct):
        raise invalid_value(max(positions), f"a position among {len(distinct)} terms")
    return list(map(distinct.__getitem__, positions))


# ---- instants ----------------------------------------------------------------------------------------


def are_same_instants(first: Sequence[Any], second: Sequence[Any]) -> bool:
    """Return whether two columns of instants are equal and print alike."""
    # Stamps print their own terms, so equal times do not suffice.
    return first == second and (
        all(map(is_, first, second))
        or (list(map(type, first)) == list(map(type, second)) and Stamp not in set(map(type, first)))
    )


def encode_instants(instants: Sequence[Any]) -> Any:
    """Return columns of instants: nanoseconds as 64-bit integers if they fit, class codes, terms of stamps."""
    classes = set(map(type, instants))
    # Integers, float seconds and stamps with their own text print differently. Usually all instants are alike.
    if len(classes) == 1:
        class_codes = bytes([_CLASS_CODES[classes.pop()]]) * len(instants)
    else:
        class_codes = bytes(map(_CLASS_CODES.__getitem__, map(type, instants)))
    stamps = [instant.term for instant in instants if instant.__class__ is Stamp] if 2 in class_codes else []
    try:
        return pack(f"{len(instants)}q", *instants), class_codes, stamps
    except StructError:
        return [int(instant) for instant in instants], class_codes, stamps


_check_instant_columns = tuple_of(any_value, any_value, sequence_of(term))


def decode_instants(value: Decoded, expected_count: Optional[int] = None) -> List[int]:
    """Return instants from their columns, checked.

    Args:
        value: the columns.
        expected_count: expected number of instants, if it is known.

    Raises:
        UsageError: if the columns are invalid.
    """
    numbers, class_codes, stamps = _check_instant_columns(value)
    if (
        class_codes.__class__ is not bytes
        or class_codes.translate(None, b"\0\1\2")
        or class_codes.count(2) != len(stamps)
    ):
        raise invalid_value(class_codes, "the forms of instants")
    if expected_count not in (None, len(class_codes)):
        raise invalid_value(len(class_codes), f"{expected_count} instants")
    if numbers.__class__ is bytes:
        if len(numbers) != 8 * len(class_codes):
            raise invalid_value(len(numbers), f"{len(class_codes)} instants")
        numbers = unpack(f"{len(class_codes)}q", numbers)
    elif len(sequence_of(instant)(numbers)) != len(class_codes):
        raise invalid_value(numbers, f"{len(class_codes)} instants")
    if not any(class_codes):
        return list(numbers)
    if class_codes.count(1) == len(class_codes):
        return list(map(FloatSeconds, numbers))
    terms = iter(stamps)
    instants: List[int] = []
    for number, class_code in zip(numbers, class_codes):
        instants.append(
            number
            if class_code == 0
            else FloatSeconds(number)
            if class_code == 1
            else Stamp.of(number, next(terms))
        )
    return instants


# ---- records of memories -----------------------------------------------------------------------------


EncodedRecords = Tuple[int, int, bool, Any, Any, Any]
"""Number of earlier records, number of late records, whether terms may contain variables; then the encoded terms and
ends, and the encoded starts or None if they equal the ends."""

DecodedRecords = Tuple[int, int, bool, List[Term], List[int], List[int]]
"""As `EncodedRecords`, with the decoded terms, ends and starts."""


class MemoryRecords(NamedTuple):
    """Consecutive records of a memory.

    Attributes:
        earlier_count: number of records that the memory stored before these.
        dropped_count: number of records before the oldest one that the memory still has.
        late_count: number of records that were rejected because they were late.
        has_variables: whether terms may contain variables.
        records: term, start and end of each record.
    """

    earlier_count: int
    dropped_count: int
    late_count: int
    has_variables: bool
    records: List[Tuple[Term, int, int]]

    def slice(self, begin: int, end: int) -> "MemoryRecords":
        """Return the records from index ``begin`` up to, not including, ``end``; index 0 is the first record here."""
        return self._replace(earlier_count=self.earlier_count + begin, records=self.records[begin:end])

    def empty_end(self) -> "MemoryRecords":
        """Return an empty slice, positioned after the last record."""
        return self.slice(len(self.records), len(self.records))


def encode_records(batch: MemoryRecords) -> EncodedRecords:
    """Return the encoding of records."""
    # One flat list of all items, sliced by column, is faster than a loop over the records.
    flat_items = list(chain.from_iterable(batch.records))
    terms, starts, ends = flat_items[0::3], flat_items[1::3], flat_items[2::3]
    return (
        batch.earlier_count,
        batch.late_count,
        batch.has_variables,
        encode_terms(terms),
        encode_instants(ends),
        # Most events have no duration.
        None if are_same_instants(starts, ends) else encode_instants(starts),
    )


_check_records = tuple_of(count, count, boolean, any_value, any_value, any_value)


def decode_records(value: Decoded) -> DecodedRecords:
    """Check and decode `EncodedRecords`, and return them.

    Raises:
        UsageError: if they are invalid.
    """
    earlier_count, late_count, has_variables, encoded_terms, encoded_ends, encoded_starts = _check_records(
        value
    )
    ends = decode_instants(encoded_ends)
    record_count = len(ends)
    starts = ends if encoded_starts is None else decode_instants(encoded_starts, record_count)
    terms = with_name("terms", lambda encoded: decode_terms(encoded, record_count))(encoded_terms)
    return earlier_count, late_count, has_variables, terms, ends, starts
