"""Memories with their records, and subscriptions."""

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
"""How many records there were before these, how many were refused, whether there may be variables; their terms; ends,
and starts where these are others, see `_instants`."""


def keep_memories(knowledge: KnowledgeBase) -> List[Tuple[Any, ...]]:
    """Return what memories are made of, in their order: definition, and whether events tell of them."""
    return [(one.definition, one.active) for one in knowledge.memories]


class NewRecords(NamedTuple):
    """Records of a memory that came one after the other.

    Attributes:
        first: how many there were before.
        oldest: how many there were before the first that the memory still has.
        late: how many were refused.
        open: whether there may be variables.
        records: they.
    """

    first: int
    oldest: int
    late: int
    open: bool
    records: List[Tuple[Term, int, int]]

    def part(self, begin: int, end: int) -> "NewRecords":
        """Return some of them, by their places."""
        return self._replace(first=self.first + begin, records=self.records[begin:end])

    def end(self) -> "NewRecords":
        """Return none of them, as what comes after the last."""
        return self.part(len(self.records), len(self.records))


def new_records(instance: MemoryInstance, since: int = 0) -> NewRecords:
    """Return the records of a memory, or those that came after so many."""
    memory = instance.memory
    first, records = memory.since(since)
    return NewRecords(first, memory.oldest, memory.late, instance.open, records)


def keep_records(new: NewRecords) -> KeptRecords:
    """Return records as data."""
    parts = list(chain.from_iterable(new.records))
    terms, starts, ends = parts[0::3], parts[1::3], parts[2::3]
    same = all(map(is_, starts, ends))
    return (
        new.first,
        new.late,
        new.open,
        _keep_parts(terms),
        _instants(ends),
        None if same else _instants(starts),
    )


_FEW, _DEEP, _WIDE = 50, 4, 64
"""Terms are kept by columns from so many on; those of their arguments to that depth, and so many at most."""


_SAMPLE = 200
"""Terms among which those are counted that are the same."""

_PART = 1000
"""Terms that are kept together: their arguments fit into a processor's cache, which takes half of the time.

Lengths have 16 bits, and positions at most as many.
"""

_ONE_BYTE = 256
"""Distinct terms of a column whose positions have 8 bits."""


def _keep_parts(terms: List[Term]) -> List[Any]:
    """Return terms as data, see `_keep_terms`, in parts if there are many."""
    if len(terms) <= _PART:
        return _keep_terms(terms)
    return ["parts", [_keep_terms(terms[at : at + _PART]) for at in range(0, len(terms), _PART)]]


def _keep_terms(terms: List[Term], depth: int = 0, left: Optional[List[None]] = None) -> List[Any]:
    """Return terms as data: by the columns of their arguments where all have the same functor.

    Columns are made and read by functions that are written in C. Columns of floats are packed, and a column in which
    the same objects recur, such as atoms, is packed as their positions in a list of the distinct ones.
    """
    left = [None] * _WIDE if left is None else left
    if len(terms) < _FEW:
        return _listed(terms)
    columns: Any = terms
    if columns[0].__class__ is float:
        packed = _pack_floats(columns)
        return _listed(terms) if packed is None else ["floats", packed]
    if columns[0].__class__ is Atom and set(map(type, columns)) == {Atom}:
        return _indexed(columns, dict.fromkeys(columns))
    mostly_distinct = 10 * len(set(map(id, columns[:_SAMPLE]))) >= 9 * min(len(columns), _SAMPLE)
    if columns[0].__class__ is tuple and mostly_distinct:
        rows = _rows(columns) if depth < _DEEP else None
        width = len(columns[0])
        if rows is not None and width <= len(left) + 1:
            del left[: width - 1]
            made = [_keep_terms(rows[at::width], depth + 1, left) for at in range(1, width)]
            return ["columns", columns[0][0], made]
    elif columns[0].__class__ is not int and not mostly_distinct:
        keys = list(map(id, columns))
        return _indexed(columns, dict(zip(keys, columns)), keys)
    return _listed(terms)


def _listed(terms: List[Term]) -> List[Any]:
    """Return terms as a list, in which instants are integers."""
    kinds = set(map(type, terms))
    if WholeSeconds in kinds or Stamp in kinds:
        terms = [int(one) if isinstance(one, int) else one for one in terms]
    return ["terms", terms]


def _indexed(terms: List[Term], distinct: Dict[Any, Any], keys: Optional[List[int]] = None) -> List[Any]:
    """Return terms as positions in the list of the distinct ones.

    Args:
        terms: the terms.
        distinct: the distinct ones; atoms as keys, other terms as values of their identities.
        keys: the identities of terms that are no atoms: a hash of a compound term would visit its arguments.
    """
    positions = dict(zip(distinct, range(len(distinct))))
    places = itemgetter(*(keys or terms))(positions)
    packed = bytes(places) if len(distinct) <= _ONE_BYTE else array("H", places).tobytes()
    return ["indexed", _listed(list(distinct.values() if keys else distinct))[1], packed]


def _rows(terms: Sequence[Any]) -> Optional[List[Any]]:
    """Return functors and arguments of compound terms one after the other, or None if the functors differ.

    A functor only occurs as the first item of a term. Thus all terms have the same one if it is at each place.
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

    MessagePack writes a float as the byte 0xcb and eight more, and no other value begins with that byte. Checking
    these bytes takes half as long as checking the classes first.
    """
    try:
        data = bytearray(msgpack.packb(column))
    except (TypeError, ValueError, OverflowError, RecursionError):
        return None
    del data[:3]  # the length of the list, from _FEW to _PART
    if len(data) != 9 * len(column) or data[::9].count(0xCB) != len(column):
        return None
    del data[::9]
    floats = array("d", bytes(data))
    floats.byteswap()
    return floats.tobytes()


def read_terms(value: Any, number: int, depth: int = 0) -> List[Term]:
    """Return so many terms from data, checked.

    Raises:
        UsageError: where it is not what `keep_records` returns.
    """
    form, *rest = items(value) or [None]
    if form == "parts" and len(rest) == 1 and not depth:
        sizes = [min(_PART, number - at) for at in range(0, number, _PART)]
        if len(items(rest[0])) == len(sizes):
            parts = [read_terms(part, size, 1) for part, size in zip(rest[0], sizes)]
            return list(chain.from_iterable(parts))
    if form == "floats" and len(rest) == 1 and rest[0].__class__ is bytes and len(rest[0]) == 8 * number:
        floats = array("d")
        floats.frombytes(rest[0])
        return floats.tolist()  # type: ignore[return-value]
    if form == "indexed" and len(rest) == 2 and rest[1].__class__ is bytes:
        found: List[Term] = _read_indexed(each(term)(rest[0]), rest[1])
        if len(found) == number:
            return found
    if form == "columns" and len(rest) == 2 and depth <= _DEEP + 1:
        of = functor(rest[0])
        columns = [read_terms(one, number, depth + 1) for one in items(rest[1])]
        if len(columns) == of.arity > 0:
            return list(zip(repeat(of, number), *columns))
    if form == "terms" and len(rest) == 1:
        found = each(term)(rest[0])
        if len(found) == number:
            return found
    raise wrong(form, f"{number} terms")


def _read_indexed(distinct: List[Term], packed: bytes) -> List[Term]:
    """Return terms from their positions among the distinct ones."""
    places = array("B" if len(distinct) <= _ONE_BYTE else "H")
    if len(packed) % places.itemsize:
        raise wrong(len(packed), f"positions of {places.itemsize} bytes")
    places.frombytes(packed)
    if places and max(places) >= len(distinct):
        raise wrong(max(places), f"a position among {len(distinct)} terms")
    return list(map(distinct.__getitem__, places))


def _instants(found: Sequence[Any]) -> Any:
    """Return instants by their columns: nanoseconds as 64-bit integers where they fit, forms, terms of stamps."""
    plain = set(map(type, found)) == {int}
    forms = bytes(len(found)) if plain else bytes([_FORMS[one.__class__] for one in found])
    stamps = [] if plain else [one.term for one in found if one.__class__ is Stamp]
    try:
        return array("q", found).tobytes(), forms, stamps
    except OverflowError:
        return [int(one) for one in found], forms, stamps


def _read_instants(column: Any) -> List[int]:
    numbers, forms, stamps = column
    if isinstance(numbers, bytes):
        read = array("q")
        read.frombytes(numbers)
        numbers = read.tolist()
    if not any(forms):
        return list(numbers)
    if forms.count(1) == len(forms):
        return list(map(WholeSeconds, numbers))
    terms = iter(stamps)
    made: List[int] = []
    for number, form in zip(numbers, forms):
        made.append(
            number if form == 0 else WholeSeconds(number) if form == 1 else Stamp.of(number, next(terms))
        )
    return made


def restore_memories(knowledge: KnowledgeBase, kept: Sequence[Tuple[Any, ...]]) -> List[MemoryInstance]:
    """Make memories as others were, without records; nobody is told of them."""
    return [knowledge.memories.begin(definition, active) for definition, active in kept]


def restore_records(instance: MemoryInstance, parts: Sequence[KeptRecords]) -> None:
    """Have a memory have the records that another one had, from parts in the order in which they came."""
    records: List[Tuple[Term, int, int]] = []
    gone = late = 0
    for before, refused, is_open, terms, ends, starts in parts:
        late = refused
        instance.open = instance.open or is_open
        last = _read_instants(ends)
        first = last if starts is None else _read_instants(starts)
        if not records:
            gone = before
        elif before > gone + len(records):
            raise UsageError("records of a memory are missing")
        del records[max(0, before - gone) :]  # those that come now stand in their places
        records += zip(terms, first, last)
    over = max(0, len(records) - max(instance.memory.size, 1))
    records = records[over:]
    kept_ends = [int(end) for _, _, end in records]
    if kept_ends != sorted(kept_ends) or any(start > end for _, start, end in records):
        raise UsageError("the records of a memory are not in the order of their ends")
    instance.memory.restore(gone + over, late, kept_ends, records)


def keep_subscriptions(knowledge: KnowledgeBase) -> List[Term]:
    """Return what subscriptions are made of, in their order."""
    return [one.definition for _, one in knowledge.subscriptions.items()]


def keep_sent(knowledge: KnowledgeBase) -> List[int]:
    """Return how many events each subscription has sent."""
    return [one.tally.sent for _, one in knowledge.subscriptions.items()]


def restore_subscriptions(knowledge: KnowledgeBase, kept: Sequence[Term], sent: Sequence[int]) -> None:
    """Make subscriptions as others were."""
    for definition in kept:
        knowledge.subscriptions.create(definition)
    for (_, one), number in zip(knowledge.subscriptions.items(), sent):
        one.tally.sent = number
