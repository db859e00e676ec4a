"""Column encodings of terms and of the records of memories.

A memory can have hundreds of thousands of records, and a rule as many partial matches. Their terms are encoded in
columns: terms with the same functor become one column per argument, recursively. A column of floats is packed as
64-bit numbers. A column with repeated objects is stored as indexes into a list of distinct objects, as in the
dictionary encoding of Apache Parquet. Columns are created and read with functions that are implemented in C.
"""

from itertools import chain, repeat
from operator import is_, itemgetter
from struct import pack, unpack
from typing import Any, Hashable, List, NamedTuple, Optional, Sequence, Tuple

from ..prolog.terms.timestamps import FloatSeconds, Stamp
from ..prolog.terms.types import Atom, Term
from .state_fields import named_values, record_of
from .stored_field_types import (
    ANYTHING,
    BOOLEAN,
    COUNT,
    FUNCTOR,
    NO_CONTEXT,
    TERM,
    PlainType,
    ReadContext,
    decode_instants,
    encode_instants,
    invalid_value,
    items_of,
    with_path,
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

# ---- terms -------------------------------------------------------------------------------------------


def encode_terms(terms: List[Term]) -> List[object]:
    """Return the encoding of terms, in parts of `_PART_SIZE` terms."""
    if len(terms) <= _PART_SIZE:
        return _encode_part(terms)
    return [
        "parts",
        [_encode_part(terms[start : start + _PART_SIZE]) for start in range(0, len(terms), _PART_SIZE)],
    ]


def _encode_part(
    terms: List[Term], depth: int = 0, column_budget: Optional[List[None]] = None
) -> List[object]:
    """Return the encoding of terms: as columns of their arguments if all have the same functor.

    Columns of floats are packed. A column with repeated objects, such as atoms, is encoded as indexes into a list of
    distinct objects.
    """
    column_budget = [None] * _MAX_COLUMNS if column_budget is None else column_budget
    if len(terms) < _MIN_COLUMN_TERMS:
        return _encode_list(terms)
    first = terms[0]
    if first.__class__ is float:
        if set(map(type, terms)) == {float}:
            return ["floats", pack(f"{len(terms)}d", *terms)]
        return _encode_list(terms)
    if first.__class__ is Atom and set(map(type, terms)) == {Atom}:
        return _encode_indexed(terms, terms)
    # A sample decides between columns and positions: comparing all objects would cost as much as encoding them.
    mostly_distinct = 10 * len(set(map(id, terms[:_SAMPLE_SIZE]))) >= 9 * min(len(terms), _SAMPLE_SIZE)
    if first.__class__ is tuple and mostly_distinct:
        # Deeper arguments are rare in messages, and many short columns would cost more than they save.
        flat_terms = _flatten_terms(terms) if depth < _MAX_COLUMN_DEPTH else None
        width = len(first)
        if flat_terms is not None and width <= len(column_budget) + 1:
            # The list is a mutable counter that nested calls share: one item per column that may still be created.
            del column_budget[: width - 1]
            encoded_columns = [
                _encode_part(flat_terms[position::width], depth + 1, column_budget)
                for position in range(1, width)
            ]
            return ["columns", first[0], encoded_columns]
    elif first.__class__ is not int and not mostly_distinct:
        # Hashing a compound term would visit its arguments.
        return _encode_indexed(terms, list(map(id, terms)))
    return _encode_list(terms)


def _encode_list(terms: List[Term]) -> List[object]:
    """Return terms as a list, with instants as integers."""
    classes = set(map(type, terms))
    if FloatSeconds in classes or Stamp in classes:
        terms = [int(term) if isinstance(term, int) else term for term in terms]
    return ["terms", terms]


def _encode_indexed(terms: List[Term], keys: Sequence[Hashable]) -> List[object]:
    """Return terms as positions in the list of distinct terms.

    Args:
        terms: the terms.
        keys: a key of each term; terms with equal keys are stored once.
    """
    distinct = dict(zip(keys, terms))
    positions = dict(zip(distinct, range(len(distinct))))
    term_indexes = itemgetter(*keys)(positions)
    packed = (
        bytes(term_indexes)
        if len(distinct) <= _MAX_BYTE_POSITIONS
        else pack(f"{len(term_indexes)}H", *term_indexes)
    )
    return ["indexed", _encode_list(list(distinct.values()))[1], packed]


def _flatten_terms(terms: Sequence[Term]) -> Optional[List[Term]]:
    """Return functors and arguments of compound terms in one list, or None if the functors differ.

    Functors only occur as the first item of a term. Therefore all terms have the functor that is found at each
    multiple of the width.
    """
    try:
        flat_terms = list(chain.from_iterable(terms))  # type: ignore[arg-type]
    except TypeError:  # a term that is not compound
        return None
    width = len(flat_terms) // len(terms)
    if len(flat_terms) != width * len(terms) or flat_terms[::width].count(flat_terms[0]) != len(terms):
        return None
    return flat_terms


def decode_terms(value: object, term_count: int, depth: int = 0) -> Sequence[Term]:
    """Return the given number of terms from their encoding, checked.

    Raises:
        UsageError: if the encoding is invalid.
    """
    encoding, *content = items_of(value) or [None]
    # Parts cannot be nested, so their sizes follow from the number of terms.
    if encoding == "parts" and len(content) == 1 and not depth:
        sizes = [min(_PART_SIZE, term_count - start) for start in range(0, term_count, _PART_SIZE)]
        if len(items_of(content[0])) == len(sizes):
            parts = [decode_terms(part, size, 1) for part, size in zip(items_of(content[0]), sizes)]
            return list(chain.from_iterable(parts))
    if (
        encoding == "floats"
        and len(content) == 1
        and type(content[0]) is bytes
        and len(content[0]) == 8 * term_count
    ):
        return unpack(f"{term_count}d", content[0])
    if encoding == "indexed" and len(content) == 2 and type(content[1]) is bytes:
        terms: Sequence[Term] = _decode_indexed(_check_terms(content[0]), content[1])
        if len(terms) == term_count:
            return terms
    if encoding == "columns" and len(content) == 2 and depth <= _MAX_COLUMN_DEPTH + 1:
        term_functor = FUNCTOR.check(content[0])
        columns = [decode_terms(column, term_count, depth + 1) for column in items_of(content[1])]
        if len(columns) == term_functor.arity > 0:
            return list(zip(repeat(term_functor, term_count), *columns))
    if encoding == "terms" and len(content) == 1:
        terms = _check_terms(content[0])
        if len(terms) == term_count:
            return terms
    raise invalid_value(encoding, f"{term_count} terms")


def _check_terms(value: object) -> Sequence[Term]:
    return TERM.column_checker(NO_CONTEXT)(value, ())


def _decode_indexed(distinct: Sequence[Term], packed: bytes) -> List[Term]:
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


# ---- records of memories -----------------------------------------------------------------------------


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


def are_same_instants(first: Sequence[object], second: Sequence[object]) -> bool:
    """Return whether two columns of instants are equal and print alike."""
    # Stamps print their own terms, so equal times do not suffice.
    return first == second and (
        all(map(is_, first, second))
        or (list(map(type, first)) == list(map(type, second)) and Stamp not in set(map(type, first)))
    )


def encode_records(batch: MemoryRecords) -> List[object]:
    """Return the encoding of records."""
    # One flat list of all items, sliced by column, is faster than a loop over the records.
    flat_items: List[Any] = list(chain.from_iterable(batch.records))
    terms, starts, ends = flat_items[0::3], flat_items[1::3], flat_items[2::3]
    fields = {
        "earlier_count": batch.earlier_count,
        "late_count": batch.late_count,
        "has_variables": batch.has_variables,
        "terms": encode_terms(terms),
        "ends": encode_instants(ends),
        # Most events have no duration.
        "starts": None if are_same_instants(starts, ends) else encode_instants(starts),
    }
    return named_values(list(fields), list(fields.values()))


class DecodedRecords(NamedTuple):
    """Consecutive records of a memory that were read; see `MemoryRecords`.

    Attributes:
        earlier_count, late_count, has_variables: as in `MemoryRecords`.
        terms: the terms; until `decode_records` has decoded them, their encoding.
        ends: the ends in ns.
        starts: the starts in ns.
    """

    earlier_count: int
    late_count: int
    has_variables: bool
    terms: Sequence[Term]
    ends: List[int]
    starts: List[int]


_RECORDS = record_of(
    DecodedRecords,
    earlier_count=COUNT,
    late_count=COUNT,
    has_variables=BOOLEAN,
    terms=ANYTHING,
    ends=PlainType("a column of instants", decode_instants),
    starts=ANYTHING,
)


def decode_records(value: object, context: ReadContext = NO_CONTEXT) -> DecodedRecords:
    """Check and decode the result of `encode_records`.

    Raises:
        UsageError: if it is invalid.
    """
    records = _RECORDS.checker(context)(value)
    ends = records.ends
    count = len(ends)
    stored_starts: object = records.starts
    # The numbers of terms and of starts follow from that of the ends.
    starts = ends if stored_starts is None else decode_instants(stored_starts, count)
    terms = with_path("terms", lambda stored: decode_terms(stored, count))(records.terms)
    return records._replace(terms=terms, starts=starts)
