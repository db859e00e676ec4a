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
from .schema import Decoded, any_value, boolean, count, tuple_of, with_name

EncodedRecords = Tuple[int, int, bool, Any, Any, Any]
"""Number of earlier records, number of late records, whether terms may contain variables; then the encoded terms and
ends, and the encoded starts or None if they equal the ends."""

DecodedRecords = Tuple[int, int, bool, List[Term], List[int], List[int]]
"""As `EncodedRecords`, with the decoded terms, ends and starts."""


def snapshot_memories(knowledge: KnowledgeBase) -> List[Tuple[Any, ...]]:
    """Return the definition of each memory, and whether it is active, in their order."""
    return [(instance.definition, instance.active) for instance in knowledge.memories]


class MemoryRecords(NamedTuple):
    """Consecutive records of a memory.

    Attributes:
        first_position: number of earlier records.
        oldest_position: number of records before the oldest one that the memory still has.
        late_count: number of records that were rejected because they were late.
        has_variables: whether terms may contain variables.
        records: term, start and end of each record.
    """

    first_position: int
    oldest_position: int
    late_count: int
    has_variables: bool
    records: List[Tuple[Term, int, int]]

    def slice(self, begin: int, end: int) -> "MemoryRecords":
        """Return the records from index ``begin`` up to, not including, ``end``; index 0 is the first record here."""
        return self._replace(first_position=self.first_position + begin, records=self.records[begin:end])

    def empty_end(self) -> "MemoryRecords":
        """Return an empty slice, positioned after the last record."""
        return self.slice(len(self.records), len(self.records))


def records_since(instance: MemoryInstance, position: int = 0) -> MemoryRecords:
    """Return the records of a memory, or only those after the first ``position`` records."""
    memory = instance.memory
    first_position, records = memory.records_since(position)
    return MemoryRecords(
        first_position, memory.oldest_number, memory.late_count, instance.has_variables, records
    )


def encode_records(batch: MemoryRecords) -> EncodedRecords:
    """Return the encoding of records."""
    # One flat list of all items, sliced by column, is faster than a loop over the records.
    flat_items = list(chain.from_iterable(batch.records))
    terms, starts, ends = flat_items[0::3], flat_items[1::3], flat_items[2::3]
    return (
        batch.first_position,
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
    first_position, late_count, has_variables, encoded_terms, encoded_ends, encoded_starts = _check_records(
        value
    )
    ends = decode_instants(encoded_ends)
    record_count = len(ends)
    starts = ends if encoded_starts is None else decode_instants(encoded_starts, record_count)
    terms = with_name("terms", lambda encoded: decode_terms(encoded, record_count))(encoded_terms)
    return first_position, late_count, has_variables, terms, ends, starts


def restore_memories(
    knowledge: KnowledgeBase, definitions: Sequence[Tuple[Any, ...]]
) -> List[MemoryInstance]:
    """Create memories from their definitions, without records and without emitting events."""
    return [knowledge.memories.create_unreported(definition, active) for definition, active in definitions]


def restore_records(instance: MemoryInstance, batches: Sequence[DecodedRecords]) -> None:
    """Restore the records of a memory from consecutive batches, see `decode_records`."""
    records: List[Tuple[Term, int, int]] = []
    dropped_count = late_count = 0
    for first_position, late_count_of_batch, has_variables, terms, ends, starts in batches:
        late_count = late_count_of_batch
        instance.has_variables = instance.has_variables or has_variables
        if not records:
            # The memory had dropped the records before the first batch.
            dropped_count = first_position
        elif first_position > dropped_count + len(records):
            raise UsageError("records of a memory are missing")
        # Batches may overlap: the records of a later batch replace those of earlier ones.
        del records[max(0, first_position - dropped_count) :]
        records += zip(terms, starts, ends)
    # Batches may contain records that the memory had dropped by the time of the last batch.
    surplus_count = max(0, len(records) - max(instance.memory.size, 1))
    records = records[surplus_count:]
    record_ends = list(map(int, map(itemgetter(2), records)))
    # Queries use binary search over the ends.
    if record_ends != sorted(record_ends) or any(map(gt, map(itemgetter(1), records), record_ends)):
        raise UsageError("the records of a memory are not ordered by their ends")
    instance.memory.restore(dropped_count + surplus_count, late_count, record_ends, records)


def snapshot_subscriptions(knowledge: KnowledgeBase) -> List[Term]:
    """Return the definitions of subscriptions in their order."""
    return [subscription.definition for _, subscription in knowledge.subscriptions.items()]


def snapshot_sent_counts(knowledge: KnowledgeBase) -> List[int]:
    """Return the number of events that each subscription has sent."""
    return [subscription.sent_counter.count for _, subscription in knowledge.subscriptions.items()]


def restore_subscriptions(
    knowledge: KnowledgeBase, definitions: Sequence[Term], sent_counts: Sequence[int]
) -> None:
    """Create subscriptions from their definitions, with the numbers of events that they have sent."""
    for definition in definitions:
        knowledge.subscriptions.create(definition)
    for (_, subscription), number in zip(knowledge.subscriptions.items(), sent_counts):
        subscription.sent_counter.count = number
