"""Mutations of the input of a case: events and messages that are lost, late, repeated, or have other stamps.

A mutation changes the receipt of an event or message and keeps its stamp, as a network does, or changes the stamp
alone, as a clock does. Messages without a header have the time of their receipt, so that a later receipt moves them.
"""

from heapq import heappop, heappush
from itertools import count
from operator import attrgetter
from typing import Callable, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

from ..foundation.errors import MessageError
from ..messages.decoder import has_header
from ..messages.header_stamps import shift_header_stamp
from ..messages.type_registry import Definitions
from ..playback.rosbag1 import Record, Topic
from .case_definition import CaseEvent, InputId, Mutation, MutationType

MAX_LISTED_INPUTS = 100_000
"""Maximum number of messages of a case that are candidates for mutations: the first ones."""

_LATER = (MutationType.DELAYED, MutationType.OVERTAKEN)


class InputMessage(NamedTuple):
    """A message that may be changed, and whether it has a header with a stamp."""

    id: InputId
    has_stamp: bool


class _InputNumbering:
    """Numbering of the events or messages of equal topic and time; the times of a topic do not decrease."""

    def __init__(self) -> None:
        self._last_ids: Dict[str, InputId] = {}

    def next_id(self, topic: str, time: int) -> InputId:
        """Return the identity of the next event or message."""
        last_id = self._last_ids.get(topic)
        number = last_id.number + 1 if last_id is not None and last_id.time == time else 0
        self._last_ids[topic] = InputId(topic, time, number)
        return self._last_ids[topic]


def identify_events(events: Iterable[CaseEvent]) -> Iterator[Tuple[InputId, CaseEvent]]:
    """Yield the events of a case, which are ordered by time, with their identities."""
    numbering = _InputNumbering()
    for event in events:
        yield numbering.next_id("", event.time), event


def mutate_events(events: Sequence[CaseEvent], mutations: Iterable[Mutation]) -> List[CaseEvent]:
    """Return the events of a case after mutations, by time. A late event follows those that are in time."""
    mutation_by_input = {mutation.input: mutation for mutation in mutations}
    mutated: List[CaseEvent] = []
    late: List[CaseEvent] = []
    for input_id, event in identify_events(events):
        mutation = mutation_by_input.get(input_id)
        if mutation is None:
            mutated.append(event)
        else:
            (late if mutation.type in _LATER else mutated).extend(_mutate_event(event, mutation))
    return sorted([*mutated, *late], key=attrgetter("time"))


def _mutate_event(event: CaseEvent, mutation: Mutation) -> List[CaseEvent]:
    if mutation.type is MutationType.LOST:
        return []
    if mutation.type is MutationType.REPEATED:
        return [event, event]
    start = event.time if event.start is None else event.start
    end = event.time if event.end is None else event.end
    if mutation.type in _LATER:
        return [event._replace(time=event.time + mutation.amount, start=start, end=end)]
    return [event._replace(start=start + mutation.amount, end=end + mutation.amount)]


class MessageMutator:
    """Mutation of the messages of a case and its bags.

    Args:
        definitions: known message types.
        start: start of the case in nanoseconds since the epoch.

    Attributes:
        inputs: the messages that were read, up to `MAX_LISTED_INPUTS`.
    """

    def __init__(self, mutations: Iterable[Mutation], definitions: Definitions, start: int):
        self.inputs: List[InputMessage] = []
        self._mutations = {mutation.input: mutation for mutation in mutations}
        self._definitions = definitions
        self._start = start
        self._has_header: Dict[str, bool] = {}

    def mutate(self, records: Iterable[Record]) -> Iterator[Record]:
        """Yield messages after the mutations by time, as they are. A late message follows those that are in time."""
        numbering = _InputNumbering()
        # Numbers keep the order of records of equal time, which cannot be compared.
        late_records: List[Tuple[int, int, Record]] = []
        numbers = count()
        for record in records:
            while late_records and late_records[0][0] < record.time:
                yield heappop(late_records)[2]
            input_id = numbering.next_id(record.topic.name, record.time - self._start)
            if len(self.inputs) < MAX_LISTED_INPUTS:
                self.inputs.append(InputMessage(input_id, self._find_header(record.topic)))
            mutation = self._mutations.get(input_id)
            if mutation is None:
                yield record
            elif mutation.type in _LATER:
                late_record = record._replace(time=record.time + mutation.amount)
                heappush(late_records, (late_record.time, next(numbers), late_record))
            else:
                yield from _mutate_record(record, mutation)
        while late_records:
            yield heappop(late_records)[2]

    def _find_header(self, topic: Topic) -> bool:
        if topic.type not in self._has_header:
            try:
                self._has_header[topic.type] = has_header(self._definitions.find(topic.type))
            except MessageError:
                # The playback reports types that it cannot read.
                self._has_header[topic.type] = False
        return self._has_header[topic.type]


def _mutate_record(record: Record, mutation: Mutation) -> List[Record]:
    if mutation.type is MutationType.LOST:
        return []
    if mutation.type is MutationType.REPEATED:
        return [record, record]
    return [record._replace(data=shift_header_stamp(record.data, record.topic.format, mutation.amount))]


def largest_amount(mutations: Iterable[Mutation]) -> int:
    """Return the largest time in nanoseconds by which mutations move a receipt or a stamp."""
    return max((abs(mutation.amount) for mutation in mutations), default=0)


def describe_mutation(mutation: Mutation, describe_input: Callable[[InputId], str]) -> str:
    """Return a mutation as a clause, such as ``the event at 3.5 s (bump(left)) is lost``."""
    subject = describe_input(mutation.input)
    amount = f"{abs(mutation.amount) / 1e9:.6g} s"
    if mutation.type is MutationType.LOST:
        return f"{subject} is lost"
    if mutation.type is MutationType.REPEATED:
        return f"{subject} is received twice"
    if mutation.type is MutationType.DELAYED:
        return f"{subject} is received {amount} later"
    if mutation.next_input is not None:
        return f"{subject} is received after {describe_input(mutation.next_input)}"
    return f"{subject} has a stamp that is {amount} {'later' if mutation.amount > 0 else 'earlier'}"
