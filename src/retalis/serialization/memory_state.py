"""Serialization of memories with their records, and of subscriptions.

Records are encoded in columns, see `columns`: one each for terms, starts and ends.
"""

from itertools import chain
from operator import gt, itemgetter
from typing import Any, List, NamedTuple, Sequence, Tuple

from ..events.knowledge.knowledge_base import KnowledgeBase
from ..events.knowledge.memory import MemoryInstance
from ..foundation.errors import UsageError
from ..prolog.terms.types import Term
from .columns import are_same_instants, decode_instants, decode_terms, encode_instants, encode_terms
from .schema import Decoded, anything, boolean, count, fixed, named

KeptRecords = Tuple[int, int, bool, Any, Any, Any]
"""Number of earlier records, number of refused records, whether terms may contain variables; then the terms, the
ends, and the starts unless they equal the ends."""


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
    return (
        new.first,
        new.late,
        new.open,
        encode_terms(terms),
        encode_instants(ends),
        # Most events have no duration.
        None if are_same_instants(starts, ends) else encode_instants(starts),
    )


_kept_records = fixed(count, count, boolean, anything, anything, anything)


def decode_records(value: Decoded) -> Decoded:
    """Return consecutive records of a memory: as `KeptRecords`, with checked and decoded columns.

    Raises:
        UsageError: if they are invalid.
    """
    before, late, is_open, terms, ends, starts = _kept_records(value)
    record_ends = decode_instants(ends)
    number = len(record_ends)
    record_starts = record_ends if starts is None else decode_instants(starts, number)
    record_terms = named("terms", lambda encoded: decode_terms(encoded, number))(terms)
    return before, late, is_open, record_terms, record_ends, record_starts


def restore_memories(knowledge: KnowledgeBase, kept: Sequence[Tuple[Any, ...]]) -> List[MemoryInstance]:
    """Create memories from their definitions, without records and without emitting events."""
    return [knowledge.memories.create_unreported(definition, active) for definition, active in kept]


def restore_records(instance: MemoryInstance, parts: Sequence[KeptRecords]) -> None:
    """Restore the records of a memory from consecutive parts, see `decode_records`."""
    records: List[Tuple[Term, int, int]] = []
    dropped = late = 0
    for before, refused, is_open, terms, ends, starts in parts:
        late = refused
        instance.has_variables = instance.has_variables or is_open
        if not records:
            dropped = before
        elif before > dropped + len(records):
            raise UsageError("records of a memory are missing")
        # Parts may overlap: the records of a later part replace those of earlier ones.
        del records[max(0, before - dropped) :]
        records += zip(terms, starts, ends)
    # Parts may contain records that the memory had dropped by the time of the last part.
    surplus = max(0, len(records) - max(instance.memory.size, 1))
    records = records[surplus:]
    kept_ends = list(map(int, map(itemgetter(2), records)))
    # Queries use binary search over the ends.
    if kept_ends != sorted(kept_ends) or any(map(gt, map(itemgetter(1), records), kept_ends)):
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
