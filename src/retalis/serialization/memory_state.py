"""Serialization of memories with their records, and of subscriptions.

Records are encoded in columns, because a memory can have hundreds of thousands of them: terms with the same functor
become one column per argument, recursively. A column of floats is packed as 64-bit numbers, and a column in which the
same objects recur as positions in the list of distinct ones. All columns are created and read with functions that are
implemented in C. The representation resembles the dictionary encoding of Apache Parquet.
"""

from array import array
from itertools import chain, repeat
from operator import is_, itemgetter
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import msgpack

from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.memory import MemoryInstance
from ..foundation.errors import UsageError
from ..prolog.terms.timestamps import Stamp, WholeSeconds
from ..prolog.terms.types import Atom, Term
from .schema import each, functor, items, term, wrong

_FORMS: Dict[Any, int] = {int: 0, WholeSeconds: 1, Stamp: 2}

KeptRecords = Tuple[int, int, bool, Any, Any, Any]
"""Number of earlier records, number of refused records, whether terms may contain variables; then the terms, the
ends, and the starts unless they equal the ends, see `_instants`."""


def keep_memories(knowledge: KnowledgeBase) -> List[Tuple[Any, ...]]:
    """Return the definition of each memory, and whether it is active, in their order."""
    return [(instance.definition, instance.active) for instance in knowledge.memories]


class NewRecords(NamedTuple):
    """Consecutive records of a memory.

    Attributes:
        first: number of earlier records.
        oldest: number of records before the oldest one that the memory still has.
        late: number of records that were refused.
        open: if terms may contain variables.
        records: the records: term, start and end.
    """

    first: int
    oldest: int
    late: int
    open: bool
    records: List[Tuple[Term, int, int]]

    def part(self, begin: int, end: int) -> "NewRecords":
        """Return the records between two positions."""
        return self._replace(first=self.first + begin, records=self.records[begin:end])

    def end(self) -> "NewRecords":
        """Return an empty part, positioned after the last record."""
        return self.part(len(self.records), len(self.records))


def new_records(instance: MemoryInstance, since: int = 0) -> NewRecords:
    """Return the records of a memory, or only those after the first ``since`` records."""
    memory = instance.memory
    first, records = memory.records_since(since)
    return NewRecords(first, memory.oldest_number, memory.late_count, instance.has_variables, records)


def keep_records(new: NewRecords) -> KeptRecords:
    """Return the encoding of records."""
    parts = list(chain.from_iterable(new.records))
    terms, starts, ends = parts[0::3], parts[1::3], parts[2::3]
    # Identity is enough: records of events without duration share one object for start and end.
    starts_equal_ends = all(map(is_, starts, ends))
    return (
        new.first,
        new.late,
        new.open,
        _keep_parts(terms),
        _instants(ends),
        None if starts_equal_ends else _instants(starts),
    )


_MIN_COLUMN_TERMS, _MAX_COLUMN_DEPTH, _MAX_COLUMNS = 50, 4, 64
"""Minimum number of terms that are encoded in columns; maximum nesting and total number of columns."""


_SAMPLE_SIZE = 200
"""Number of terms that are examined for repeated objects."""

_PART_SIZE = 1000
"""Number of terms that are encoded together: their arguments fit into the processor's cache, which halves the time.

Lengths and positions have 16 bits.
"""

_MAX_BYTE_POSITIONS = 256
"""Maximum number of distinct terms in a column for positions of 8 bits."""


def _keep_parts(terms: List[Term]) -> List[Any]:
    """Return the encoding of terms (see `_keep_terms`), in parts of `_PART` terms."""
    if len(terms) <= _PART_SIZE:
        return _keep_terms(terms)
    return [
        "parts",
        [_keep_terms(terms[start : start + _PART_SIZE]) for start in range(0, len(terms), _PART_SIZE)],
    ]


def _keep_terms(terms: List[Term], depth: int = 0, columns_left: Optional[List[None]] = None) -> List[Any]:
    """Return the encoding of terms: as columns of their arguments if all have the same functor.

    Columns of floats are packed. A column in which the same objects recur, such as atoms, is encoded as positions in
    the list of distinct objects.
    """
    columns_left = [None] * _MAX_COLUMNS if columns_left is None else columns_left
    if len(terms) < _MIN_COLUMN_TERMS:
        return _listed(terms)
    columns: Any = terms
    if columns[0].__class__ is float:
        packed = _pack_floats(columns)
        return _listed(terms) if packed is None else ["floats", packed]
    if columns[0].__class__ is Atom and set(map(type, columns)) == {Atom}:
        return _indexed(columns, dict.fromkeys(columns))
    # A sample decides between columns and positions: comparing all objects would cost as much as encoding them.
    mostly_distinct = 10 * len(set(map(id, columns[:_SAMPLE_SIZE]))) >= 9 * min(len(columns), _SAMPLE_SIZE)
    if columns[0].__class__ is tuple and mostly_distinct:
        # Deeper arguments are rare in messages, and many short columns would cost more than they save.
        rows = _rows(columns) if depth < _MAX_COLUMN_DEPTH else None
        width = len(columns[0])
        if rows is not None and width <= len(columns_left) + 1:
            # A list as a counter that nested calls share.
            del columns_left[: width - 1]
            encoded = [
                _keep_terms(rows[column::width], depth + 1, columns_left) for column in range(1, width)
            ]
            return ["columns", columns[0][0], encoded]
    elif columns[0].__class__ is not int and not mostly_distinct:
        keys = list(map(id, columns))
        return _indexed(columns, dict(zip(keys, columns)), keys)
    return _listed(terms)


def _listed(terms: List[Term]) -> List[Any]:
    """Return terms as a list, with instants as integers."""
    classes = set(map(type, terms))
    if WholeSeconds in classes or Stamp in classes:
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
    packed = bytes(places) if len(distinct) <= _MAX_BYTE_POSITIONS else array("H", places).tobytes()
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


def _pack_floats(column: List[float]) -> Optional[bytes]:
    """Return the 64-bit floats of a column, or None if it contains other terms.

    MessagePack encodes a float as the byte 0xcb and eight further bytes, and no other value begins with that byte.
    Checking these bytes takes half the time of checking the classes first.
    """
    try:
        data = bytearray(msgpack.packb(column))
    except (TypeError, ValueError, OverflowError, RecursionError):
        return None
    del data[:3]  # the length of the list, from _FEW to _PART
    if len(data) != 9 * len(column) or data[::9].count(0xCB) != len(column):
        return None
    del data[::9]
    # MessagePack is big-endian, the packed column is little-endian.
    floats = array("d", bytes(data))
    floats.byteswap()
    return floats.tobytes()


def read_terms(value: Any, count: int, depth: int = 0) -> List[Term]:
    """Return the given number of terms from their encoding, checked.

    Raises:
        UsageError: if the encoding is invalid.
    """
    form, *rest = items(value) or [None]
    # Parts cannot be nested, so their sizes follow from the number of terms.
    if form == "parts" and len(rest) == 1 and not depth:
        sizes = [min(_PART_SIZE, count - start) for start in range(0, count, _PART_SIZE)]
        if len(items(rest[0])) == len(sizes):
            parts = [read_terms(part, size, 1) for part, size in zip(rest[0], sizes)]
            return list(chain.from_iterable(parts))
    if form == "floats" and len(rest) == 1 and rest[0].__class__ is bytes and len(rest[0]) == 8 * count:
        floats = array("d")
        floats.frombytes(rest[0])
        return floats.tolist()  # type: ignore[return-value]
    if form == "indexed" and len(rest) == 2 and rest[1].__class__ is bytes:
        terms: List[Term] = _read_indexed(each(term)(rest[0]), rest[1])
        if len(terms) == count:
            return terms
    if form == "columns" and len(rest) == 2 and depth <= _MAX_COLUMN_DEPTH + 1:
        term_functor = functor(rest[0])
        columns = [read_terms(column, count, depth + 1) for column in items(rest[1])]
        if len(columns) == term_functor.arity > 0:
            return list(zip(repeat(term_functor, count), *columns))
    if form == "terms" and len(rest) == 1:
        terms = each(term)(rest[0])
        if len(terms) == count:
            return terms
    raise wrong(form, f"{count} terms")


def _read_indexed(distinct: List[Term], packed: bytes) -> List[Term]:
    """Return terms from their positions in the list of distinct terms."""
    # The file is not trusted: a position out of range must be refused with a clear error.
    places = array("B" if len(distinct) <= _MAX_BYTE_POSITIONS else "H")
    if len(packed) % places.itemsize:
        raise wrong(len(packed), f"positions of {places.itemsize} bytes")
    places.frombytes(packed)
    if places and max(places) >= len(distinct):
        raise wrong(max(places), f"a position among {len(distinct)} terms")
    return list(map(distinct.__getitem__, places))


def _instants(instants: Sequence[Any]) -> Any:
    """Return columns of instants: nanoseconds as 64-bit integers if they fit, forms, and the terms of stamps."""
    are_plain = set(map(type, instants)) == {int}
    forms = bytes(len(instants)) if are_plain else bytes([_FORMS[instant.__class__] for instant in instants])
    stamps = [] if are_plain else [instant.term for instant in instants if instant.__class__ is Stamp]
    try:
        # The form distinguishes integers, whole seconds and stamps with their own text, which print differently.
        return array("q", instants).tobytes(), forms, stamps
    except OverflowError:
        return [int(instant) for instant in instants], forms, stamps


def _read_instants(column: Any) -> List[int]:
    numbers, forms, stamps = column
    if isinstance(numbers, bytes):
        integers = array("q")
        integers.frombytes(numbers)
        numbers = integers.tolist()
    if not any(forms):
        return list(numbers)
    if forms.count(1) == len(forms):
        return list(map(WholeSeconds, numbers))
    terms = iter(stamps)
    instants: List[int] = []
    for number, form in zip(numbers, forms):
        instants.append(
            number if form == 0 else WholeSeconds(number) if form == 1 else Stamp.of(number, next(terms))
        )
    return instants


def restore_memories(knowledge: KnowledgeBase, kept: Sequence[Tuple[Any, ...]]) -> List[MemoryInstance]:
    """Create memories from their definitions, without records and without emitting events."""
    return [knowledge.memories.create_unreported(definition, active) for definition, active in kept]


def restore_records(instance: MemoryInstance, parts: Sequence[KeptRecords]) -> None:
    """Restore the records of a memory from consecutive parts."""
    records: List[Tuple[Term, int, int]] = []
    dropped = late = 0
    for before, refused, is_open, terms, ends, starts in parts:
        late = refused
        instance.has_variables = instance.has_variables or is_open
        record_ends = _read_instants(ends)
        record_starts = record_ends if starts is None else _read_instants(starts)
        if not records:
            dropped = before
        elif before > dropped + len(records):
            raise UsageError("records of a memory are missing")
        # Parts may overlap: the records of a later part replace those of earlier ones.
        del records[max(0, before - dropped) :]
        records += zip(terms, record_starts, record_ends)
    # Parts may contain records that the memory had dropped by the time of the last part.
    surplus = max(0, len(records) - max(instance.memory.size, 1))
    records = records[surplus:]
    kept_ends = [int(end) for _, _, end in records]
    # Queries use binary search over the ends.
    if kept_ends != sorted(kept_ends) or any(start > end for _, start, end in records):
        raise UsageError("the records of a memory are not ordered by their ends")
    instance.memory.restore(dropped + surplus, late, kept_ends, records)


def keep_subscriptions(knowledge: KnowledgeBase) -> List[Term]:
    """Return the definitions of subscriptions in their order."""
    return [subscription.definition for _, subscription in knowledge.subscriptions.items()]


def keep_sent(knowledge: KnowledgeBase) -> List[int]:
    """Return the number of events that each subscription has sent."""
    return [subscription.tally.number for _, subscription in knowledge.subscriptions.items()]


def restore_subscriptions(knowledge: KnowledgeBase, kept: Sequence[Term], sent: Sequence[int]) -> None:
    """Create subscriptions from their definitions, with the numbers of events that they have sent."""
    for definition in kept:
        knowledge.subscriptions.create(definition)
    for (_, subscription), number in zip(knowledge.subscriptions.items(), sent):
        subscription.tally.number = number
