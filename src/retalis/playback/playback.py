"""A program over a bag, without ROS: what the nodes give live, from the same messages, in the bag's time."""

import logging
from collections import Counter
from heapq import merge
from itertools import chain, count
from operator import attrgetter
from pathlib import Path
from typing import (
    Callable,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Set,
    Tuple,
    Union,
)

from ..engine.engine import Engine
from ..engine.engine_settings import Settings
from ..engine.event_input import AskedTopic, by_name
from ..engine.runtime.clock import StreamClock
from ..engine.runtime.clock_skew import ClockSkewMonitor, Refused
from ..engine.runtime.problem_reports import Reports
from ..events.program.program_folder import AUTO, TOPICS, DirectTopics, TopicType, direct_topics, read_topics
from ..foundation.errors import MessageError, ProgramErrors, RetalisError, beginning, counted, shortened
from ..foundation.ros_names import plain_type, topic_fault, type_fault
from ..messages.decoder import Decoder
from ..messages.type_definition import Definition
from ..messages.type_registry import Definitions
from ..prolog.terms.types import Term
from .bag_sources import Bag
from .rosbag1 import Record, Topic

log = logging.getLogger("retalis")

OnError = Callable[[RetalisError], None]

_TIME = attrgetter("time")


class Output(NamedTuple):
    """A message that a program published.

    >>> with BagReader(folder / "talk.bag") as bag:
    ...     (output,) = Playback(folder, report=print).run(bag)
    >>> output.topic, output.time, output.definition.name, output.data[4:]
    ('echo', 1000000000, 'std_msgs/String', b'hello')

    Attributes:
        topic: the topic as the subscription names it.
        term: the message as a term.
        time: the bag's time at which it was published, in nanoseconds.
        definition: its type; None where ``pub_sub.xml`` gives the topic none.
        data: the message; None where the term does not fit the type.
        id: of the subscription.
    """

    topic: str
    term: Term
    time: int
    definition: Optional[Definition]
    data: Optional[bytes]
    id: Optional[Term] = None


class Playback:
    """One program that is fed from bags.

    >>> playback = Playback(folder, report=print)
    >>> with BagReader(folder / "talk.bag") as bag:
    ...     for output in playback.run(bag):
    ...         print(output.topic, playback.engine.show(output.term))
    echo std_msgs__0__String('"hello"')

    Args:
        program: the program's folder.
        report: takes each error of the program and of the types of the bag's topics; messages that do not fit
            are logged with their number, as all that goes wrong while events flow.
        topics: topics that become events besides those in ``pub_sub.xml``.
        settings: of the engine.
        max_skew: how many seconds a stamp may be away from what its topic and frame had so far, for the message to
            be taken; by default any number.
        bag: whose types the program may name slots of, besides those that are installed.
        state: of an engine with this program (`Engine.snapshot`), which goes on; by default it begins anew.
        direct: the value of parameter ``~direct`` of the node: the topics that it subscribes by itself are played
            too, by default ``tf`` and ``ar_pose_marker`` if the program does not name them.

    Raises:
        UsageError: where a file of the program cannot be read, or the state is none.
    """

    def __init__(
        self,
        program: Union[str, Path],
        report: OnError,
        topics: Iterable[TopicType] = (),
        settings: Optional[Settings] = None,
        max_skew: Optional[float] = None,
        bag: Optional[Bag] = None,
        state: Optional[bytes] = None,
        direct: DirectTopics = AUTO,
    ):
        self._folder = folder = Path(program)
        self.clock = StreamClock(0)
        self._reports = Reports()
        self._reports.once = True
        self._skew = ClockSkewMonitor(self._reports, self.clock.now, self.clock.now, max_skew)
        self.definitions = Definitions()
        self._report = report
        self._learn_types(bag.topics if bag is not None else ())
        if state is None:
            self.engine = Engine(self.clock, settings, self._reports, self.definitions)
        else:
            self.engine = Engine.restore(
                state, self.clock, settings, self._reports, self.definitions, folder=folder
            )
        self._decoders: Dict[Topic, Optional[Decoder]] = {}
        self._outputs: List[Output] = []
        self._told: Set[str] = set()
        named = read_topics(folder / TOPICS)
        topics = tuple(TopicType(one.topic, plain_type(one.type)) for one in topics)
        self._topics = named._replace(subscribed=(*named.subscribed, *topics))
        self._direct = direct_topics(direct, self._topics, by_name)
        # Of a topic that several name, the last type counts: the direct ones stand above pub_sub.xml, as in a node.
        self._asked = [*named.subscribed, *self._direct, *topics]
        listed = isinstance(direct, tuple)
        named_topics = {by_name(topic) for topic, _ in self._topics.subscribed}
        self._by_default = frozenset(
            () if listed else {by_name(topic) for topic, _ in self._direct} - named_topics
        )
        self._types = {by_name(topic): kind for topic, kind in self._asked}
        self._published = {by_name(topic): kind for topic, kind in named.published}
        self._events = {by_name(topic): event for topic, event in named.events}
        self._joining: Set[str] = set()
        self._latched = {by_name(topic) for topic in named.latched}
        self.engine.on_output(self._collect)
        self.engine.input_topics.begin(self._subscribe, self._topics, self._direct)
        if state is None:
            self._load()

    def _load(self) -> None:
        try:
            self.engine.load_program(self._folder)
        except ProgramErrors as errors:
            for error in errors.errors:
                self._report(error)

    def run(self, bag: Bag, progress: Callable[[int], object] = lambda done: None) -> Iterable[Output]:
        """Feed a bag and yield what the program publishes, as it does.

        >>> with BagReader(folder / "talk.bag") as bag:
        ...     print(len(list(Playback(folder, report=print).run(bag))))
        1

        Args:
            bag: the messages, in the order of their receipt: a `BagReader`, or several bags as one.
            progress: called with the number of messages read so far, after each, while the engine is at work: it may
                look at the engine and must not use it.
        """
        outputs = self._outputs
        self._skew.forget()
        self._learn_all(bag, [topic for topic, _ in self._asked], self._by_default)
        for warning in self.engine.warnings(self._folder, self.definitions, self._topics, self._direct):
            log.warning("%s", warning)
        self._told.update(self.engine.output_topics())  # of those without a type it was said
        wanted = {topic.name for topic in bag.topics if by_name(topic.name) in self._types}
        self._joining.clear()
        decoders = {id(topic): self._decoders.get(topic) for topic in bag.topics}
        records = self._records(bag, wanted, decoders)
        done = count(1)
        for record in records:
            if record is not None:
                several = chain((record,), records)
                self.engine.post_each(self._messages(several, decoders, lambda: progress(next(done))))
                yield from outputs
                outputs.clear()
        self.clock.move_to(bag.end)
        self.engine.advance()
        yield from outputs
        outputs.clear()
        self._skew.sum_up()
        self._reports.sum_up()

    def is_latched(self, topic: str) -> bool:
        """Tell whether ``pub_sub.xml`` has a topic's last message go to those who subscribe it later.

        >>> Playback(folder, report=print).is_latched("echo")
        False
        """
        return by_name(topic) in self._latched

    def _messages(
        self,
        records: Iterable[Optional[Record]],
        decoders: Dict[int, Optional[Decoder]],
        told: Callable[[], object],
    ) -> Iterator[Tuple[Term, Optional[int]]]:
        """Yield records as messages, each at its time, until one makes an output or alarms are to ring."""
        clock, outputs = self.clock, self._outputs
        for record in records:
            if record is None:
                return
            topic, instant, data = record
            clock.move_to(instant, back=True)
            decoder = decoders[id(topic)]
            message = None if decoder is None else self._decoded(topic, decoder, data)
            if message is not None:
                yield message
            told()
            if outputs:
                return

    def _records(
        self, bag: Bag, topics: Set[str], decoders: Dict[int, Optional[Decoder]]
    ) -> Iterator[Optional[Record]]:
        """Yield the messages of some topics, and of those that goals subscribe meanwhile from then on.

        The alarms that come before a message have rung when it is given, and all when none is left. Before they
        ring None is given: whoever asks must not be at work in the engine when the next is asked for.
        """
        stream = iter(bag.records(topics))
        while True:
            record = next(stream, None)
            due = self.clock.next_alarm()
            if due is not None and not self._joining:
                until = bag.end if record is None else record.time
                if due <= until or not self.clock.reached():
                    yield None
                    self._ring_until(bag.start, until)
            if self._joining:
                rest = stream if record is None else chain((record,), stream)
                stream = iter(merge(rest, self._join(bag, decoders), key=_TIME))
            elif record is None:
                return
            else:
                yield record

    def _join(self, bag: Bag, decoders: Dict[int, Optional[Decoder]]) -> Iterator[Record]:
        """Return the messages that come from now on of the topics that goals have just subscribed."""
        joining = {topic.name for topic in bag.topics if by_name(topic.name) in self._joining}
        missing = [topic for topic, _ in self._asked if by_name(topic) in self._joining]
        self._joining.clear()
        self._learn_all(bag, missing)
        decoders.update((id(topic), self._decoders[topic]) for topic in bag.topics if topic.name in joining)
        return bag.records(joining, start=self.clock.now() + 1)

    def _subscribe(self, wanted: AskedTopic) -> None:
        """Have the messages of a topic become events, from now on or, before a bag is played, from its start."""
        plain = by_name(wanted.topic)
        self._asked.append(TopicType(wanted.topic, wanted.kind))
        self._types[plain] = wanted.kind
        self._events[plain] = wanted.event
        self._joining.add(plain)

    def _ring_until(self, begin: int, instant: int) -> None:
        """Let each alarm ring at its own time, as it does on a robot, and not when the next message comes."""
        clock = self.clock
        if not clock.reached():  # timers that wait for a time count from the bag's first message
            clock.move_to(begin)
        clock.head_for(instant)
        due = clock.next_alarm()
        while due is not None and due <= instant and not self._joining:
            clock.move_to(due)
            self.engine.advance()
            due = clock.next_alarm()

    def _decoded(self, topic: Topic, decoder: Decoder, data: bytes) -> Optional[Tuple[Term, Optional[int]]]:
        """Return a message as a term with its stamp; None where it cannot be taken, which is reported."""
        try:
            return decoder.decode(data), decoder.stamp(data)
        except Refused:  # counted and reported where it was seen
            pass
        except MessageError as error:
            message = f"a message on {topic.name} is dropped: {error.message}"
            self._reports.error(MessageError(message, error.place), ("in", topic.name))
        return None

    def _learn_types(self, topics: Iterable[Topic]) -> None:
        """Learn the types of a bag that are not known; what is wrong with them is said when it is played."""
        for topic in topics:
            try:
                self.definitions.received(topic.type, topic.type, topic.definition, topic.md5sum)
            except MessageError as error:
                log.debug("%s", error)

    def _learn_all(self, bag: Bag, asked: Iterable[str], by_default: FrozenSet[str] = frozenset()) -> None:
        """Store the decoders for the connections of topics; report what cannot become events, and what is missing.

        Args:
            bag: the messages.
            asked: names of the topics.
            by_default: those of them that nobody named: a bag need not have them, or may have another type.
        """
        asked = list(asked)
        names = set(map(by_name, asked))
        there = {by_name(topic.name) for topic in bag.topics}
        missing = [
            topic for topic in asked if by_name(topic) not in there and by_name(topic) not in by_default
        ]
        if missing:
            log.warning(
                "%s has no messages on %s; it has %s",
                bag.path,
                ", ".join(dict.fromkeys(missing)),
                ", ".join(_shown(bag.topics)) or "none at all",
            )
        dropped: Dict[Tuple[str, bool], int] = Counter()
        for topic in bag.topics:
            problem = self._learn(topic) if by_name(topic.name) in names else None
            if problem is not None:
                text = f"topic {topic.name}: {problem}"
                dropped[text, by_name(topic.name) in by_default] += topic.messages
        for (text, unnamed), messages in dropped.items():
            text = f"{text}; {counted(messages, 'message')} dropped"
            if unnamed:
                log.warning("%s", text)
            else:
                self._report(MessageError(text))

    def _learn(self, topic: Topic) -> Optional[MessageError]:
        """Note the decoder for a connection, under the type that the program gives the topic, or return why not."""
        kind = self._types[by_name(topic.name)]
        try:
            learned = self.definitions.learn(
                kind, topic.type, topic.definition, topic.md5sum, self._events.get(by_name(topic.name), "")
            )
        except MessageError as error:
            self._decoders[topic] = None
            return error
        if learned.instead:
            log.warning(
                "topic %s is requested as %s, which is unknown here; the bag has %s, which is used instead",
                topic.name,
                kind,
                topic.type,
            )
        self._decoders[topic] = self._skew.watch(learned.decoder, topic.name, topic.caller)
        return None

    def _collect(self, term: Term, topic: str, name: Term) -> None:
        kind = self._published.get(by_name(topic))
        definition = data = None
        try:
            if kind is None and topic not in self._told:
                shown = beginning(topic)
                self._reports.warning(
                    f"topic {shown} has no type: its outputs are no messages; "
                    f'<publish_to name="{shown}" msg_type="package/Type"/> in {TOPICS} would give it one',
                    "topics without a type",
                    texts=20,
                )
            elif kind is not None:
                definition = self._published_type(kind, topic)
                data = self.definitions.encoder(definition).encode(term, topic)
        except MessageError as error:
            self._reports.error(error, ("out", topic))
        self._outputs.append(Output(topic, term, self.clock.now(), definition, data, name))

    def _published_type(self, kind: str, topic: str) -> Definition:
        try:
            return self.definitions.find(kind)
        except MessageError as error:
            raise MessageError(f"topic {topic}: {error.message}", error.place) from error


def _shown(topics: Iterable[Topic]) -> List[str]:
    """Return names and types of a bag's topics, as ROS allows them or quoted."""
    return sorted(
        {
            f"{topic.name if topic_fault(topic.name) is None else shortened(topic.name)} "
            f"({topic.type if type_fault(topic.type) is None else shortened(topic.type)})"
            for topic in topics
        }
    )
