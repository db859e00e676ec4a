"""Memories with their records, and subscriptions."""

from array import array
from itertools import repeat
from operator import is_, itemgetter
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ...events.knowledge import Instance, Knowledge
from ...foundation import UsageError
from ...prolog.terms import Stamp, Term, WholeSeconds
from .schema import each, functor, items, term, wrong

_FORMS: Dict[Any, int] = {int: 0, WholeSeconds: 1, Stamp: 2}

KeptRecords = Tuple[int, int, bool, Any, Any, Any]
"""How many records there were before these, how many were refused, whether there may be variables; their terms; ends,
and starts where these are others, see `_instants`."""


def keep_memories(knowledge: Knowledge) -> List[Tuple[Any, ...]]:
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


def new_records(instance: Instance, since: int = 0) -> NewRecords:
    """Return the records of a memory, or those that came after so many."""
    memory = instance.memory
    first, records = memory.since(since)
    return NewRecords(first, memory.oldest, memory.late, instance.open, records)


def keep_records(new: NewRecords) -> KeptRecords:
    """Return records as data."""
    records = new.records
    terms = [record[0] for record in records]
    ends = [record[2] for record in records]
    starts = [record[1] for record in records]
    same = all(map(is_, starts, ends))
    return (
        new.first,
        new.late,
        new.open,
        _keep_terms(terms),
        _instants(ends),
        None if same else _instants(starts),
    )


_FEW, _DEEP, _WIDE = 50, 4, 64
"""Terms are kept by columns from so many on; those of their arguments to that depth, and so many at most."""


_SAMPLE = 2000
"""Terms among which those are counted that are the same."""


def _keep_terms(terms: List[Term], depth: int = 0, left: Optional[List[None]] = None) -> List[Any]:
    """Return terms as data: by the columns of their arguments where all have the same functor.

    Columns are made and read by functions that are written in C, and columns of floats are packed.
    """
    left = [None] * _WIDE if left is None else left
    compounds: Any = terms
    kinds = set(map(type, terms)) if len(terms) >= _FEW else set()
    if kinds == {float}:
        return ["floats", array("d", compounds).tobytes()]
    first = terms[:_SAMPLE]
    if kinds == {tuple} and depth < _DEEP and 10 * len(set(map(id, first))) >= 9 * len(first):
        functors = set(map(itemgetter(0), compounds))
        arity = next(iter(functors)).arity
        if len(functors) == 1 and arity <= len(left):
            del left[:arity]
            columns = [list(map(itemgetter(at), compounds)) for at in range(1, arity + 1)]
            return ["columns", *functors, [_keep_terms(one, depth + 1, left) for one in columns]]
    return ["terms", terms]


def read_terms(value: Any, number: int, depth: int = 0) -> List[Term]:
    """Return so many terms from data, checked.

    Raises:
        UsageError: where it is not what `keep_records` returns.
    """
    form, *rest = items(value) or [None]
    if form == "floats" and len(rest) == 1 and rest[0].__class__ is bytes and len(rest[0]) == 8 * number:
        floats = array("d")
        floats.frombytes(rest[0])
        return floats.tolist()  # type: ignore[return-value]
    if form == "columns" and len(rest) == 2 and depth <= _DEEP:
        of = functor(rest[0])
        columns = [read_terms(one, number, depth + 1) for one in items(rest[1])]
        if len(columns) == of.arity > 0:
            return list(zip(repeat(of, number), *columns))
    if form == "terms" and len(rest) == 1:
        found: List[Term] = each(term)(rest[0])
        if len(found) == number:
            return found
    raise wrong(form, f"{number} terms")


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


def restore_memories(knowledge: Knowledge, kept: Sequence[Tuple[Any, ...]]) -> List[Instance]:
    """Make memories as others were, without records; nobody is told of them."""
    return [knowledge.memories.begin(definition, active) for definition, active in kept]


def restore_records(instance: Instance, parts: Sequence[KeptRecords]) -> None:
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


def keep_subscriptions(knowledge: Knowledge) -> List[Term]:
    """Return what subscriptions are made of, in their order."""
    return [one.definition for _, one in knowledge.subscriptions.items()]


def keep_sent(knowledge: Knowledge) -> List[int]:
    """Return how many events each subscription has sent."""
    return [one.tally.sent for _, one in knowledge.subscriptions.items()]


def restore_subscriptions(knowledge: Knowledge, kept: Sequence[Term], sent: Sequence[int]) -> None:
    """Make subscriptions as others were."""
    for definition in kept:
        knowledge.subscriptions.create(definition)
    for (_, one), number in zip(knowledge.subscriptions.items(), sent):
        one.tally.sent = number
