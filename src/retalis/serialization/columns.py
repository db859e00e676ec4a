"""Column encodings of terms and of instants.

A memory can have hundreds of thousands of records, and a rule as many partial matches. Their terms are encoded in
columns: terms with the same functor become one column per argument, recursively. A column of floats is packed as
64-bit numbers, and a column in which the same objects recur as positions in the list of distinct ones. Columns are
created and read with functions that are implemented in C. The representation resembles the dictionary encoding of
Apache Parquet.
"""

from itertools import chain, repeat
from operator import is_, itemgetter
from struct import error as StructError
from struct import pack, unpack
from typing import Any, Dict, List, Optional, Sequence

from ..prolog.terms.timestamps import FloatSeconds, Stamp
from ..prolog.terms.types import Atom, Term
from .schema import Decoded, anything, each, fixed, functor, instant, invalid_value, items, term

_MIN_COLUMN_TERMS, _MAX_COLUMN_DEPTH, _MAX_COLUMNS = 50, 4, 64
"""Minimum number of terms that are encoded in columns; maximum nesting and total number of columns."""

_SAMPLE_SIZE = 200
"""Number of terms that are examined for repeated objects."""

_PART_SIZE = 1000
"""Number of terms that are encoded together: their arguments fit into the processor's cache, which halves the time.

Positions have 16 bits.
"""

_MAX_BYTE_POSITIONS = 256
"""Maximum number of distinct terms in a column for positions of 8 bits."""

_FORMS: Dict[Any, int] = {int: 0, FloatSeconds: 1, Stamp: 2}
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


def _encode_part(terms: List[Term], depth: int = 0, columns_left: Optional[List[None]] = None) -> List[Any]:
    """Return the encoding of terms: as columns of their arguments if all have the same functor.

    Columns of floats are packed. A column in which the same objects recur, such as atoms, is encoded as positions in
    the list of distinct objects.
    """
    columns_left = [None] * _MAX_COLUMNS if columns_left is None else columns_left
    if len(terms) < _MIN_COLUMN_TERMS:
        return _listed(terms)
    column: Any = terms
    first_class = column[0].__class__
    if first_class is float:
        if set(map(type, column)) == {float}:
            return ["floats", pack(f"{len(column)}d", *column)]
        return _listed(terms)
    if first_class is Atom and set(map(type, column)) == {Atom}:
        return _indexed(column, dict.fromkeys(column))
    # A sample decides between columns and positions: comparing all objects would cost as much as encoding them.
    mostly_distinct = 10 * len(set(map(id, column[:_SAMPLE_SIZE]))) >= 9 * min(len(column), _SAMPLE_SIZE)
    if first_class is tuple and mostly_distinct:
        # Deeper arguments are rare in messages, and many short columns would cost more than they save.
        rows = _rows(column) if depth < _MAX_COLUMN_DEPTH else None
        width = len(column[0])
        if rows is not None and width <= len(columns_left) + 1:
            # A list as a counter that nested calls share.
            del columns_left[: width - 1]
            encoded = [
                _encode_part(rows[position::width], depth + 1, columns_left) for position in range(1, width)
            ]
            return ["columns", column[0][0], encoded]
    elif first_class is not int and not mostly_distinct:
        keys = list(map(id, column))
        return _indexed(column, dict(zip(keys, column)), keys)
    return _listed(terms)


def _listed(terms: List[Term]) -> List[Any]:
    """Return terms as a list, with instants as integers."""
    classes = set(map(type, terms))
    if FloatSeconds in classes or Stamp in classes:
        terms = [int(term) if isinstance(term, int) else term for term in terms]
    return ["terms", terms]


def _indexed(terms: List[Term], distinct: Dict[Any, Any], keys: Optional[List[int]] = None) -> List[Any]:
    """Return terms as positions in the list of distinct terms.

    Args:
        terms: the terms.
        distinct: the distinct terms; atoms as keys, other terms as values of their ids.
        keys: ids of terms other than atoms, because hashing a compound term would visit its arguments.
    """
    positions = dict(zip(distinct, range(len(distinct))))
    places = itemgetter(*(keys or terms))(positions)
    packed = bytes(places) if len(distinct) <= _MAX_BYTE_POSITIONS else pack(f"{len(places)}H", *places)
    return ["indexed", _listed(list(distinct.values() if keys else distinct))[1], packed]


def _rows(terms: Sequence[Any]) -> Optional[List[Any]]:
    """Return functors and arguments of compound terms in one list, or None if the functors differ.

    Functors only occur as the first item of a term. Therefore all terms have the functor that is found at each
    multiple of the width.
    """
    try:
        rows = list(chain.from_iterable(terms))
    except TypeError:  # a term that is not compound
        return None
    width = len(terms[0])
    if len(rows) != width * len(terms) or rows[::width].count(rows[0]) != len(terms):
        return None
    return rows


def decode_terms(value: Decoded, count: int, depth: int = 0) -> Sequence[Term]:
    """Return the given number of terms from their encoding, checked.

    Raises:
        UsageError: if the encoding is invalid.
    """
    form, *rest = items(value) or [None]
    # Parts cannot be nested, so their sizes follow from the number of terms.
    if form == "parts" and len(rest) == 1 and not depth:
        sizes = [min(_PART_SIZE, count - start) for start in range(0, count, _PART_SIZE)]
        if len(items(rest[0])) == len(sizes):
            parts = [decode_terms(part, size, 1) for part, size in zip(rest[0], sizes)]
            return list(chain.from_iterable(parts))
    if form == "floats" and len(rest) == 1 and rest[0].__class__ is bytes and len(rest[0]) == 8 * count:
        return unpack(f"{count}d", rest[0])
    if form == "indexed" and len(rest) == 2 and rest[1].__class__ is bytes:
        terms: Sequence[Term] = _decode_indexed(each(term)(rest[0]), rest[1])
        if len(terms) == count:
            return terms
    if form == "columns" and len(rest) == 2 and depth <= _MAX_COLUMN_DEPTH + 1:
        term_functor = functor(rest[0])
        columns = [decode_terms(column, count, depth + 1) for column in items(rest[1])]
        if len(columns) == term_functor.arity > 0:
            return list(zip(repeat(term_functor, count), *columns))
    if form == "terms" and len(rest) == 1:
        terms = each(term)(rest[0])
        if len(terms) == count:
            return terms
    raise invalid_value(form, f"{count} terms")


def _decode_indexed(distinct: List[Term], packed: bytes) -> List[Term]:
    """Return terms from their positions in the list of distinct terms."""
    positions: Sequence[int] = packed
    if len(distinct) > _MAX_BYTE_POSITIONS:
        if len(packed) % 2:
            raise invalid_value(len(packed), "positions of 2 bytes")
        positions = unpack(f"{len(packed) // 2}H", packed)
    # The file is not trusted: a position out of range must be refused with a clear error.
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
    """Return columns of instants: nanoseconds as 64-bit integers if they fit, forms, and the terms of stamps."""
    classes = set(map(type, instants))
    # Integers, float seconds and stamps with their own text print differently. Usually all instants are alike.
    if len(classes) == 1:
        forms = bytes([_FORMS[classes.pop()]]) * len(instants)
    else:
        forms = bytes(map(_FORMS.__getitem__, map(type, instants)))
    stamps = [instant.term for instant in instants if instant.__class__ is Stamp] if 2 in forms else []
    try:
        return pack(f"{len(instants)}q", *instants), forms, stamps
    except StructError:
        return [int(instant) for instant in instants], forms, stamps


_instant_column = fixed(anything, anything, each(term))


def decode_instants(value: Decoded, count: Optional[int] = None) -> List[int]:
    """Return instants from their columns, checked.

    Args:
        value: the columns.
        count: expected number of instants, if it is known.

    Raises:
        UsageError: if the columns are invalid.
    """
    numbers, forms, stamps = _instant_column(value)
    if forms.__class__ is not bytes or forms.translate(None, b"\0\1\2") or forms.count(2) != len(stamps):
        raise invalid_value(forms, "the forms of instants")
    if count not in (None, len(forms)):
        raise invalid_value(len(forms), f"{count} instants")
    if numbers.__class__ is bytes:
        if len(numbers) != 8 * len(forms):
            raise invalid_value(len(numbers), f"{len(forms)} instants")
        numbers = unpack(f"{len(forms)}q", numbers)
    elif len(each(instant)(numbers)) != len(forms):
        raise invalid_value(numbers, f"{len(forms)} instants")
    if not any(forms):
        return list(numbers)
    if forms.count(1) == len(forms):
        return list(map(FloatSeconds, numbers))
    terms = iter(stamps)
    instants: List[int] = []
    for number, form in zip(numbers, forms):
        instants.append(
            number if form == 0 else FloatSeconds(number) if form == 1 else Stamp.of(number, next(terms))
        )
    return instants
