"""Input of a case as one bag: messages of the case, merged with those of its bags."""

from contextlib import ExitStack
from heapq import merge
from operator import attrgetter
from typing import Collection, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import MessageError, UsageError
from ..foundation.ros_name_checks import ros1_type_name, strip_slashes, type_fault
from ..messages.type_definition import Definition
from ..messages.type_registry import Definitions
from ..playback.bag_locations import MergedBag
from ..playback.rosbag1 import Record, Topic, UnreadableTopic
from .case_definition import DEFAULT_START, Case, CaseMessage, InputBag
from .input_mutations import MessageMutator
from .message_values import make_input_message
from .yaml_documents import CaseFileError


class _SelectedTopics(NamedTuple):
    """A bag, and the topics of it that are played; None for all."""

    bag: MergedBag
    names: Optional[Tuple[str, ...]]


class CaseBag:
    """The messages of a case and of its bags; presents itself as a bag, see `playback.bag_locations.Bag`.

    Args:
        path: description of the input.
        messages: messages of the case by time, with times since the epoch.
        start: start of the case in nanoseconds since the epoch.
        mutator: changes the messages; None if they remain as they are.

    Attributes:
        path: see above.
        topics: topics of the messages, with those of the bags.
        unreadable: topics of the bags that cannot be read.
        start, end: see above.
    """

    def __init__(
        self,
        path: str,
        bags: Sequence[_SelectedTopics],
        messages: Sequence[Record],
        start: int,
        end: int,
        mutator: Optional[MessageMutator] = None,
    ):
        self.path = path
        self._mutator = mutator
        self.start, self.end = start, end
        self._bags = bags
        self._messages = messages
        own_topics = {id(message.topic): message.topic for message in messages}
        bag_topics = [
            topic for bag, names in bags for topic in bag.topics if names is None or topic.name in names
        ]
        self.topics: Tuple[Topic, ...] = (*own_topics.values(), *bag_topics)
        self.unreadable: Tuple[UnreadableTopic, ...] = tuple(
            topic for bag, _ in bags for topic in bag.unreadable
        )

    def records(
        self,
        topics: Optional[Collection[str]] = None,
        start: Optional[int] = None,
        stop: Optional[int] = None,
    ) -> Iterator[Record]:
        """Yield the messages in the order of their times; see `BagReader.records`."""
        streams = [self._own_records(topics, start, stop)]
        # Readers of bags omit messages at ``stop``.
        last = self.end + 1 if stop is None else min(stop, self.end + 1)
        for bag, names in self._bags:
            if names is None:
                selected = topics
            else:
                selected = [name for name in names if topics is None or name in topics]
            streams.append(bag.records(selected, start, last))
        records = merge(*streams, key=attrgetter("time"))
        return iter(records) if self._mutator is None else self._mutator.mutate(records)

    def _own_records(
        self, topics: Optional[Collection[str]], start: Optional[int], stop: Optional[int]
    ) -> Iterator[Record]:
        for record in self._messages:
            if (
                (topics is None or record.topic.name in topics)
                and (start is None or record.time >= start)
                and (stop is None or record.time <= stop)
            ):
                yield record


def open_bags(case: Case, stack: ExitStack) -> List[_SelectedTopics]:
    """Open the bags of a case; the stack closes them.

    Raises:
        CaseFileError: if a bag cannot be read, or has no topic of a name.
    """
    return [_open_bag(bag, stack) for bag in case.bags]


def _open_bag(bag: InputBag, stack: ExitStack) -> _SelectedTopics:
    try:
        opened = stack.enter_context(MergedBag([bag.path], bag.start, bag.duration))
    except (UsageError, MessageError) as error:
        raise CaseFileError(f"bag: {error.message}", bag.place) from error
    if not bag.topics:
        return _SelectedTopics(opened, None)
    names_by_full_name: Dict[str, str] = {strip_slashes(topic.name): topic.name for topic in opened.topics}
    names = []
    for name in bag.topics:
        if strip_slashes(name) not in names_by_full_name:
            available = ", ".join(sorted(set(names_by_full_name.values()))) or "none"
            raise CaseFileError(
                f"bag: {bag.path} has no topic {quote_shortened(name)}: it has {available}", bag.place
            )
        names.append(names_by_full_name[strip_slashes(name)])
    return _SelectedTopics(opened, tuple(names))


def start_of(case: Case, bags: Sequence[_SelectedTopics]) -> int:
    """Return the start of a case: as stated, that of its bags, or `DEFAULT_START`."""
    if case.start is not None:
        return case.start
    return min((bag.start for bag, _ in bags), default=DEFAULT_START)


def create_case_bag(
    case: Case,
    bags: Sequence[_SelectedTopics],
    types: Mapping[str, str],
    definitions: Definitions,
    mutator: Optional[MessageMutator] = None,
) -> CaseBag:
    """Return the input of a case.

    Args:
        case: the case.
        bags: its opened bags.
        types: types of the program's topics, by name without slashes at the ends.
        definitions: known types.
        mutator: changes the messages; None if they remain as they are.

    Raises:
        CaseFileError: if a message has no type, or does not fit it.
    """
    start = start_of(case, bags)
    topics: Dict[Tuple[str, str], Topic] = {}
    records: List[Record] = []
    for message in case.messages:
        definition = find_input_type(message, types, definitions)
        key = (message.topic, definition.name)
        if key not in topics:
            topics[key] = Topic(message.topic, definition.name, definition.full_text, definition.md5sum)
        instant = start + message.time
        records.append(
            Record(topics[key], instant, make_input_message(message, definition, definitions, instant))
        )
    ends = [start, *(record.time for record in records), *(bag.end for bag, _ in bags)]
    ends += [start + event.time for event in case.events]
    ends += [start + answer.time for answer in case.expectations.answers if answer.time is not None]
    ends += [start + mutation.input.time + mutation.amount for mutation in case.mutations or ()]
    end = max(ends) if case.end is None else start + case.end
    return CaseBag(f"{case.path}: {case.name}", bags, records, start, end, mutator)


def find_input_type(message: CaseMessage, types: Mapping[str, str], definitions: Definitions) -> Definition:
    """Return the type of a message: its own, or that of its topic.

    Args:
        message: the message.
        types: types of topics, by name without slashes at the ends.
        definitions: known types.

    Raises:
        CaseFileError: if it has no type, or the type is unknown.
    """
    type_name = message.type or types.get(strip_slashes(message.topic))
    if type_name is None:
        raise CaseFileError(
            f"topic {quote_shortened(message.topic)} is not in pub_sub.xml: expected the key 'type'",
            message.place,
        )
    type_name = ros1_type_name(type_name)
    problem = type_fault(type_name)
    if problem is None:
        try:
            return definitions.find(type_name)
        except MessageError as error:
            similar = definitions.misspelt(type_name)
            problem = f"{error.message}; did you mean {similar}?" if similar else error.message
    raise CaseFileError(problem, message.place)
