"""Playback: running a program over a bag without ROS, with the results that the nodes would produce live.

A `Playback` consists of a `RunningProgram`, as a node does, and a `BagTransport` in place of a middleware. The clock
of its engine is driven by the bag: before a message is processed, the clock is moved to the time of its receipt, and
every alarm that is due earlier fires at its own time. The result therefore depends on the bag only, not on the speed
of the machine.

Messages are passed to the engine in batches (`Engine.post_each`), which is faster than one by one. A batch ends when
an alarm is due or a message has produced an output, so that outputs are yielded as soon as they exist. Topics that
goals subscribe to while the bag is played are merged into the stream of messages from then on.

If the program reads transforms, the messages of ``/tf`` and ``/tf_static`` are stored in its transform buffer, which
computes in Python here even if tf2 is installed: a bag gives the same results on every machine.

A `RunRecorder` observes a playback and creates flat records of its events, outputs, waiting queries and memories.
They are written as JSON lines, drawn as a timeline, or written to a table, one row per record; see `run_tables`.
"""

import logging
from collections import Counter
from contextlib import nullcontext
from heapq import merge
from itertools import chain, count, islice
from operator import attrgetter
from pathlib import Path
from typing import (
    Any,
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
from ..engine.event_input import TopicRequest
from ..engine.run_records import (
    EventRecord,
    IncompleteFileRecord,
    MemoryStateRecord,
    OutputRecord,
    RunRecord,
    WaitRecord,
)
from ..engine.runtime.clock_skew import ClockSkewMonitor
from ..engine.runtime.problem_reports import Reports
from ..events.knowledge.knowledge_base import MEMORY_EVENTS
from ..events.program.topic_configuration import (
    AUTO,
    TOPICS,
    DirectTopics,
    QualityOfService,
    Topics,
    TopicType,
    direct_topics,
    quality_of,
    read_topics,
)
from ..foundation.displayed_text import format_count, quote_shortened
from ..foundation.errors import MessageError, ProgramErrors, RetalisError, UsageError
from ..foundation.garbage_collection import collect_if_grown
from ..foundation.interrupts import check_interrupt, interruptible
from ..foundation.ros_name_checks import ros1_type_name, topic_fault, type_fault
from ..messages.action_events import ACTION_EVENTS, find_action_event
from ..messages.cdr_decoder import list_slot_types
from ..messages.decoder import Decoder
from ..messages.transform_messages import TRANSFORM_TOPICS
from ..messages.type_definition import Definition, SerializationFormat
from ..messages.type_registry import Definitions
from ..node.running_program import OutputCallbacks, ProgramContext, RunningProgram, make_event_handler
from ..node.subscribed_topics import (
    HandlerFactory,
    MessageHandler,
    MessageProcessing,
    ReadingOptions,
    list_endpoints,
)
from ..node.transport import MessageSource
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms.types import Term
from .bag_locations import Bag
from .bag_transport import BagTransport, RefusedConnection, list_topic_names
from .incomplete_files import IncompleteFile
from .rosbag1 import Record, Topic

log = logging.getLogger("retalis")

OnError = Callable[[RetalisError], None]

_get_time = attrgetter("time")


class Output(NamedTuple):
    """A message that a program published.

    >>> with BagReader(folder / "talk.bag") as bag:
    ...     (output,) = Playback(folder, report=print).run(bag)
    >>> output.topic, output.time, output.definition.name, output.data[4:]
    ('echo', 1000000000, 'std_msgs/String', b'hello')

    Attributes:
        topic: the topic as in the subscription.
        term: the message as a term.
        time: the time of the bag at which it was published, in nanoseconds.
        definition: the message type; None if ``pub_sub.xml`` does not specify one.
        data: the message in the serialization of the playback's outputs; None if the term does not fit the type.
        id: id of the subscription.
    """

    topic: str
    term: Term
    time: int
    definition: Optional[Definition]
    data: Optional[bytes]
    id: Optional[Term] = None


class TimedCall(NamedTuple):
    """A function to call at a time of a bag, while the engine is idle.

    Attributes:
        time: the time in nanoseconds; messages of this time are processed before.
        call: the function, which may call the engine.
    """

    time: int
    call: Callable[[], object]


class Pause(NamedTuple):
    """A place in a stream of messages at which a playback pauses; see `shared_pass`.

    Attributes:
        time: the time of the last message before it, in nanoseconds.
    """

    time: int


ReadRecords = Callable[[Set[str]], Iterator[Union[Record, Pause]]]
"""Returns the messages of the topics with some names, in the order of receipt."""


class Playback:
    """A program that processes messages from bags.

    >>> playback = Playback(folder, report=print)
    >>> with BagReader(folder / "talk.bag") as bag:
    ...     for output in playback.run(bag):
    ...         print(output.topic, playback.engine.show(output.term))
    echo std_msgs__0__String('"hello"')

    Args:
        program: folder of the program.
        report: called with each error of the program, and with errors in the types of the bag's topics. Messages that
            do not fit their type are logged with their number, like all errors during processing.
        topics: topics that become events, in addition to those in ``pub_sub.xml``.
        settings: settings of the engine.
        max_skew: limit in seconds for the deviation of a stamp from the clock of its topic and frame; messages beyond
            it are dropped. Unlimited by default.
        bag: a bag whose types the program may use with named slots and constants, in addition to the installed
            types.
        state: state of an engine with this program (`Engine.snapshot`) to continue from; a new engine by default.
        direct: value of the node's parameter ``~direct``: topics that are subscribed without the program naming them;
            by default ``tf`` and ``ar_pose_marker``, unless the program names them.
        definitions: the known message types, to which those of bags are added; the installed types by default.
        prepare: called with the new engine before the program is loaded, for example to answer calls of services.
        make_handler: returns the functions from messages to events.
        output_format: serialization of the published messages.

    Raises:
        UsageError: if a file of the program cannot be read, or the state is invalid.
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
        definitions: Optional[Definitions] = None,
        prepare: Callable[[Engine], object] = lambda engine: None,
        make_handler: HandlerFactory = make_event_handler,
        output_format: SerializationFormat = SerializationFormat.ROS1,
    ):
        self._folder = folder = Path(program)
        self._transport = BagTransport(output_format)
        self.clock = self._transport.clock
        # A bag can contain a million messages with the same problem.
        self._reports = Reports(once=True)
        self._skew_monitor = ClockSkewMonitor(self._reports, self.clock.now, self.clock.now, max_skew)
        topic_file = read_topics(folder / TOPICS)
        definitions = Definitions() if definitions is None else definitions
        self.definitions = definitions.with_strings(topic_file.strings)
        self._on_error = report
        self._register_types(bag.topics if bag is not None else ())
        if state is None:
            self.engine = Engine(self.clock, settings, self._reports, self.definitions)
        else:
            self.engine = Engine.restore(
                state, self.clock, settings, self._reports, self.definitions, folder=folder
            )
        if self.engine.strings != topic_file.strings:
            raise UsageError(
                f'the strings of messages are "{topic_file.strings}" in {folder / TOPICS}, but the state is of a '
                f'program with "{self.engine.strings}": load the program without the state'
            )
        prepare(self.engine)
        self._outputs: List[Output] = []
        self._make_handler = make_handler
        self._read_events: Optional[FrozenSet[str]] = None
        self._published_quality = topic_file.published_quality
        self._latched_topics = set(map(self._transport.resolve_topic, topic_file.latched))
        added_topics = [TopicType(topic.topic, ros1_type_name(topic.type)) for topic in topics]
        self._program = self._create_program(topic_file, added_topics, direct)
        # Topics that the caller lists must be in the bag; those of `AUTO` need not be.
        listed_topics = direct if isinstance(direct, tuple) else ()
        self._needed_topics = [*topic_file.subscribed, *listed_topics, *added_topics]
        """Topics, as written, that a bag should have."""
        self._requested_topics: List[TopicType] = []
        """Topics that goals have requested since the last message."""
        self._is_checked = False
        self._program.accept_requests(self._subscribe)
        self._program.open_topics(may_learn_types=True)
        self._program.start_transforms(self._program.subscribe_transforms)
        self._program.subscribe_direct_topics()
        # A restored engine contains its program; loading it again would duplicate the rules.
        if state is None:
            self._load_program()

    def _create_program(
        self, topic_file: Topics, added_topics: Iterable[TopicType], direct: DirectTopics
    ) -> RunningProgram:
        """Return the program on the bag.

        Args:
            topic_file: contents of ``pub_sub.xml``.
            added_topics: topics that override the types of ``pub_sub.xml`` and of direct topics.
            direct: value of ``~direct``.
        """
        resolve_topic = self._transport.resolve_topic
        added = {resolve_topic(topic.topic): topic for topic in added_topics}
        subscribed: Dict[str, TopicType] = {}
        for topic, type_name in topic_file.subscribed:
            # As a node, with the first of two entries; the checks of the program warn about the second.
            name = resolve_topic(topic)
            message_type = added[name].type if name in added else type_name
            # Names of events belong to topics as they are written in the file.
            subscribed.setdefault(name, TopicType(topic, message_type))
        topics = topic_file._replace(subscribed=tuple({**added, **subscribed}.values()))
        kept_direct_topics = tuple(
            topic
            for topic in direct_topics(direct, topics, resolve_topic)
            if resolve_topic(topic.topic) not in added
        )
        return RunningProgram(
            ProgramContext(self._transport, self.definitions, self._reports, topics, kept_direct_topics),
            self.engine,
            MessageProcessing(self._create_handler, nullcontext(), skew=self._skew_monitor),
            # The nodes of a recording may have exchanged texts, which a program may analyze.
            ReadingOptions(0, reserved=(), report_replaced_type=_log_replaced_type),
            OutputCallbacks(self._collect_output, self._report_unpublished, "its outputs are no messages"),
        )

    def limit_events(self, names: FrozenSet[str]) -> None:
        """Ignore messages whose events have other names than these; call this before the program runs.

        They are not decoded, and only advance the clock, on which the timestamps of later events depend.

        >>> playback = Playback(folder, report=print)
        >>> playback.limit_events(frozenset(("other",)))
        >>> with BagReader(folder / "talk.bag") as bag:
        ...     print(len(list(playback.run(bag))))
        0
        """
        self._read_events = names

    def _create_handler(self, decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
        """Return the handler of messages; see `HandlerFactory`."""
        if self._read_events is None or decoder.functor.name in self._read_events:
            return self._make_handler(decoder, topic, source)
        stamp, clock = (decoder.plain or decoder).stamp, self.clock

        def advance_clock(data: bytes) -> Optional[Tuple[Term, Optional[int]]]:
            instant = stamp(data)
            # As `EventInput.dispatch_message`, which assigns a timestamp to an event without one.
            is_done = clock.stamp_at_once() is not None if instant is None else clock.is_quiet()
            # If alarms are due, or time went back, the engine has to process an event.
            return None if is_done else (decoder.lazy(data), instant)

        return advance_clock

    def _load_program(self) -> None:
        """Load the program, and report each of its errors."""
        try:
            self.engine.load_program(self._folder)
        except ProgramErrors as errors:
            for error in errors.errors:
                self._on_error(error)

    def run(
        self,
        bag: Bag,
        progress: Callable[[int], object] = lambda done: None,
        is_last: bool = True,
        flush_time: int = 0,
        calls: Iterable[TimedCall] = (),
        requires_topics: bool = True,
    ) -> Iterable[Output]:
        """Process a bag, and yield the outputs of the program as they are published.

        >>> with BagReader(folder / "talk.bag") as bag:
        ...     print(len(list(Playback(folder, report=print).run(bag))))
        1

        Args:
            bag: source of messages in the order of receipt: a `BagReader`, or several bags merged into one.
            progress: called with the number of messages read so far after each message, while the engine is
                processing: it may inspect the engine but must not change it.
            is_last: whether no bag follows that continues this one; if so, alarms do not wait for late events at the
                end.
            flush_time: nanoseconds by which the clock runs on after the end of the last bag, so that windows and
                states within it end.
            calls: functions to call between the messages, ordered by time; none is later than the end of the bag.
            requires_topics: whether to warn about topics of ``pub_sub.xml``, and transforms, that the bag lacks.
        """
        for output in self._run(bag, bag.records, progress, is_last, flush_time, calls, requires_topics):
            # `bag.records` has no pauses.
            if output is not None:
                yield output

    def run_in_steps(self, bag: Bag, read_records: ReadRecords) -> Iterator[Optional[Output]]:
        """Process a bag whose messages the caller provides; yield the outputs, and None at each pause.

        Mistakes in the program are not logged; see `log_mistakes`.

        >>> with BagReader(folder / "talk.bag") as bag:
        ...     print(len(list(Playback(folder, report=print).run_in_steps(bag, bag.records))))
        1

        Args:
            bag: the bag.
            read_records: returns the messages of the bag, with pauses. Topics that goals subscribe to meanwhile are
                read from the bag itself.
        """
        self._is_checked = True
        return self._run(bag, read_records)

    def _run(
        self,
        bag: Bag,
        read_records: ReadRecords,
        progress: Callable[[int], object] = lambda done: None,
        is_last: bool = True,
        flush_time: int = 0,
        calls: Iterable[TimedCall] = (),
        requires_topics: bool = True,
    ) -> Iterator[Optional[Output]]:
        """Process a bag; see `run` and `run_in_steps`."""
        outputs, engine, program = self._outputs, self.engine, self._program
        transforms = engine.program.knowledge.transforms
        program.require_transforms()
        # A further bag may have been recorded with other clocks.
        self._skew_monitor.reset()
        if requires_topics:
            self._warn_about_missing_topics(bag, self._needed_topics)
        self._requested_topics.clear()
        topic_names, refused = self._transport.start(bag)
        self._report_refused(refused)
        # The bag may have defined types that the program publishes, or whose constants it names.
        program.use_learned_types()
        engine.fail_interrupted_calls()
        if not self._is_checked:
            self.log_mistakes()
        if requires_topics and transforms.is_required and not self._transport.has_transforms():
            log.warning(
                "%s has no transforms on %s, which the program reads", bag.path, " or ".join(TRANSFORM_TOPICS)
            )
        records = self._read_records(bag, read_records(topic_names), calls)
        message_numbers = count(1)
        # Each iteration is one batch: `records` yields None before it continues outside `post_each`.
        for record in records:
            if record.__class__ is Pause:
                yield None
            elif record is not None:
                batch = chain((record,), records)
                messages = self._convert_messages(batch, lambda: progress(next(message_numbers)))
                if transforms.is_required:
                    engine.post_transforms(messages)
                else:
                    engine.post_each(messages)
                yield from outputs
                outputs.clear()
        # Alarms that are due before the end of the bag fire even if no further message is used.
        self.clock.move_to(bag.end)
        self.engine.advance()
        if is_last:
            if flush_time:
                # One alarm after the other, so that outputs have the times of their alarms.
                self._fire_alarms_until(bag.start, bag.end + flush_time)
                self.clock.move_to(bag.end + flush_time)
                self.engine.advance()
            engine.end_input()
        yield from outputs
        outputs.clear()
        self._skew_monitor.log_counts()
        self._reports.sum_up()

    def log_mistakes(self) -> None:
        """Log probable mistakes in the program; `run` does it once if this has not been called.

        >>> Playback(folder, report=print).log_mistakes()
        """
        self._is_checked = True
        with interruptible():
            # The checks read the program, and import what reads installed message types.
            self._program.log_mistakes(self._folder, self.definitions)

    def is_latched(self, topic: str) -> bool:
        """Return whether ``pub_sub.xml`` declares a topic as latched.

        >>> Playback(folder, report=print).is_latched("echo")
        False
        """
        return self._transport.resolve_topic(topic) in self._latched_topics

    def published_quality(self, topic: str) -> QualityOfService:
        """Return the quality of service that a node of ROS 2 offers for a published topic, as far as it is stated.

        A latched topic is transient local, unless ``pub_sub.xml`` demands something else.

        >>> Playback(folder, report=print).published_quality("echo").is_transient_local
        False
        """
        quality = quality_of(self._published_quality, topic, self._transport.resolve_topic)
        if quality.is_transient_local is None:
            return quality._replace(is_transient_local=self.is_latched(topic))
        return quality

    def published_types(self) -> Dict[str, Definition]:
        """Return the known message types of the program's output topics, by the full names of the topics.

        >>> list(Playback(folder, report=print).published_types())
        ['/echo']
        """
        return {topic: publication.definition for topic, publication in self._transport.publications.items()}

    def _convert_messages(
        self, records: Iterable[Any], count_message: Callable[[], object]
    ) -> Iterator[Tuple[Any, Optional[int]]]:
        """Yield the events of records with their instants, until a message produces an output or an alarm is due.

        A message with transforms is also yielded as a `TransformMessage`, before it is yielded as an event.
        """
        move_clock, outputs, receivers = self.clock.move_to, self._outputs, self._transport.receivers
        for record in records:
            if record is None:
                return
            check_interrupt()
            collect_if_grown()
            topic, time, data = record
            # `back`: the clocks of several bags, or a bag with unordered times, may go back.
            move_clock(time, back=True)
            # Messages of topics with an unusable type have no receivers, but move the clock.
            for receiver in receivers[id(topic)]:
                message = receiver.convert(data)
                if message.__class__ is list:
                    yield from message
                elif message is not None:
                    yield message
            count_message()
            if outputs:
                return

    def _read_records(
        self, bag: Bag, records: Iterable[Union[Record, Pause]], calls: Iterable[TimedCall]
    ) -> Iterator[Union[Record, Pause, None]]:
        """Yield messages and pauses, and the messages of topics that goals subscribe to while the bag is played.

        Alarms fire before the message that follows them is yielded, and all of them after the last message. Before
        they fire, before new topics are read, before a pause, and before scheduled functions are called, None is
        yielded: the caller must leave `Engine.post_each` before it requests the next item.
        """
        has_new_topics = self._transport.has_new_subscriptions
        stream: Iterator[Union[Record, Pause, TimedCall]] = iter(records)
        # A stream without calls is not merged, which would cost time for each message.
        calls = tuple(calls)
        if calls:
            stream = iter(merge(stream, calls, key=_get_time))
        while True:
            record = next(stream, None)
            alarm = self.clock.next_alarm()
            if alarm is not None and not has_new_topics():
                limit = bag.end if record is None else record.time
                # At time 0 the clock has not been set: timers that were started before count from the first message.
                if alarm <= limit or not self.clock.reached():
                    yield None
                    self._fire_alarms_until(bag.start, limit)
            if has_new_topics():
                # Ends the batch, because messages with transforms need another one.
                yield None
                remaining = stream if record is None else chain((record,), stream)
                # The new topics start after the current time, so no message is repeated.
                stream = iter(merge(remaining, self._read_new_topics(bag), key=_get_time))
            elif record is None:
                return
            elif record.__class__ is TimedCall:
                yield None
                self.clock.move_to(record.time, back=True)
                self.engine.advance()
                record.call()
            else:
                if record.__class__ is Pause:
                    yield None
                yield record  # type: ignore[misc]

    def _read_new_topics(self, bag: Bag) -> Iterator[Record]:
        """Return the messages after the current time of the topics that goals have just subscribed to."""
        self._warn_about_missing_topics(bag, self._requested_topics)
        self._requested_topics.clear()
        joining_topics, refused = self._transport.connect(bag)
        self._report_refused(refused)
        return bag.records(joining_topics, start=self.clock.now() + 1)

    def _subscribe(self, request: TopicRequest) -> None:
        """Convert the messages of a topic to events, from the current time on, or from the start of the next bag."""
        topic = TopicType(request.topic, request.message_type)
        self._needed_topics.append(topic)
        self._requested_topics.append(topic)
        self._program.subscribed.try_to_subscribe(request)

    def _fire_alarms_until(self, first_time: int, limit: int) -> None:
        """Fire each alarm at its own time, as on a robot, instead of at the time of the next message."""
        clock, has_new_topics = self.clock, self._transport.has_new_subscriptions
        # Timers that were started before the bag count from its first message.
        if not clock.reached():
            clock.move_to(first_time)
        clock.fire_alarms(limit, self.engine.advance, has_new_topics)

    def _register_types(self, topics: Iterable[Topic]) -> None:
        """Register the unknown types of a bag; errors are reported when the bag is played."""
        for topic in topics:
            try:
                # Adds the type if it is unknown.
                definition = self.definitions.received(topic.type, topic.type, topic.definition, topic.md5sum)
                # The types of rosbags are those of ROS 1. If that of ROS 2 has other slots, outputs have these, too.
                if (
                    topic.format is SerializationFormat.CDR
                    and self.definitions.is_from_rosbags(topic.type)
                    and list_slot_types(definition) != list_slot_types(self.definitions.find(topic.type))
                ):
                    self.definitions.add(topic.type, topic.definition)
            except MessageError as error:
                log.debug("%s", error)

    def _warn_about_missing_topics(self, bag: Bag, requested: Iterable[TopicType]) -> None:
        """Warn about topics that a bag does not have."""
        available = set(map(self._transport.resolve_topic, list_topic_names(bag)))
        missing = [name for topic in requested for name in self._list_missing(topic, available)]
        if missing:
            log.warning(
                "%s has no messages on %s; it has %s",
                bag.path,
                ", ".join(dict.fromkeys(missing)),
                ", ".join(_describe_topics(bag.topics)) or "none at all",
            )

    def _list_missing(self, needed: TopicType, available: Set[str]) -> List[str]:
        """Return the name of a topic or action that is not available, as a list of at most one name.

        An action needs one of its topics: of the others, servers do not publish each.
        """
        event = find_action_event(needed.type)
        action = None if event is None else event.action_topic(needed.topic)
        topics = [needed]
        if event is not None and action is not None:
            topics = [
                TopicType(f"{action}/{kind}", event._replace(kind=kind).type_name) for kind in ACTION_EVENTS
            ]
        is_available = any(not available.isdisjoint(self._list_names(topic)) for topic in topics)
        return [] if is_available else [needed.topic if action is None else f"action {action}"]

    def _list_names(self, topic: TopicType) -> List[str]:
        """Return the full names of the topics of a bag that are read as a topic of the program."""
        return [endpoint.topic for endpoint in list_endpoints(*topic, self._transport)]

    def _report_refused(self, refused: Iterable[RefusedConnection]) -> None:
        """Report connections whose type does not fit. On a topic that is subscribed by default, this is no error."""
        resolve_topic = self._transport.resolve_topic
        needed_topics = {name for topic in self._needed_topics for name in self._list_names(topic)}
        dropped_counts: Dict[Tuple[str, bool], int] = Counter()
        for topic, error in refused:
            is_needed = resolve_topic(topic.name) in needed_topics
            dropped_counts[f"topic {topic.name}: {error}", is_needed] += topic.messages
        for (text, is_needed), message_count in dropped_counts.items():
            text = f"{text}; {format_count(message_count, 'message')} dropped"
            if is_needed:
                self._on_error(MessageError(text))
            else:
                log.warning("%s", text)

    def _collect_output(self, term: Term, topic: str, subscription_id: Term) -> None:
        """Store an output of the program, with its message if it fits the type of its topic."""
        self._program.published.publish(term, topic)
        publication = self._transport.publications.get(self._transport.resolve_topic(topic))
        definition = data = None
        if publication is not None:
            definition = publication.definition
            data = next(iter(publication.take()), None)
        self._outputs.append(Output(topic, term, self.clock.now(), definition, data, subscription_id))

    def _report_unpublished(self, topic: str, message_type: Optional[str]) -> None:
        """Report an output to a topic without a type, or with an unknown type; see `ReportUnpublished`."""
        if message_type is None:
            self._program.untyped_topics.check(topic)
            return
        try:
            self.definitions.find(message_type)
        except MessageError as error:
            self._reports.error(MessageError(f"topic {topic}: {error.message}", error.place), ("out", topic))


def _log_replaced_type(request: TopicRequest, source: MessageSource) -> None:
    """Log a warning that the bag's type is used in place of an unknown one."""
    log.warning(
        "topic %s is requested as %s, which is unknown here; the bag has %s, which is used instead",
        request.topic,
        request.message_type,
        source.message_type,
    )


def _describe_topics(topics: Iterable[Topic]) -> List[str]:
    """Return names and types of a bag's topics; names that ROS does not allow are quoted."""
    return sorted(
        {
            f"{topic.name if topic_fault(topic.name) is None else quote_shortened(topic.name)} "
            f"({topic.type if type_fault(topic.type) is None else quote_shortened(topic.type)})"
            for topic in topics
        }
    )


# ---- records of a playback ---------------------------------------------------------------------------


MAX_RECORDED_QUERIES = 1000
"""Maximum number of waiting queries that are observed; further ones are not recorded."""


MAX_RECORDED_MEMORIES = 1000
"""Maximum number of memories that are recorded at the end."""


class _Wait(NamedTuple):
    """A waiting query: its event, the ids of the memories that it waits for, and its start in bag time."""

    event: str
    memories: List[str]
    start: int


class RunRecorder:
    """Observer of a playback that reports events, outputs and waits as they occur, and the memories at the end.

    The wait of a query lasts from the message that triggers it to the message that it waits for, in bag time.
    """

    def __init__(self, playback: Playback, write_record: Callable[[RunRecord], None]):
        self._engine = playback.engine
        self._knowledge = playback.engine.program.knowledge
        self._read_clock = playback.clock.now
        self._write_record = write_record
        self._waits: Dict[int, _Wait] = {}
        self._engine.on_event(self._record_event)

    def _record_event(self, term: Term, start: int, end: int) -> None:
        # Events of memories are internal; `record_final_state` reports their result.
        if term.__class__ is not tuple or term[0] not in MEMORY_EVENTS:
            self._write_record(EventRecord(event=canonical_text(term), start=int(start), end=int(end)))

    def record_output(self, output: Output) -> None:
        """Report an output."""
        self._write_record(make_output_record(output))

    def update_waits(self) -> None:
        """Update the waiting queries; to be called after each message."""
        pending = self._knowledge.pending_queries
        # The usual case; this is called after every message.
        if not self._waits and not len(pending):
            return
        now = int(self._read_clock())
        current = {
            serial: (triggered_query, values, missing)
            for serial, triggered_query, values, _, _, missing in islice(pending, MAX_RECORDED_QUERIES)
        }
        # A list, because waits are removed in the loop.
        for serial in [serial for serial in self._waits if serial not in current]:
            self._record_wait(self._waits.pop(serial), now)
        for serial, (triggered_query, values, missing) in current.items():
            if serial not in self._waits:
                memories = [canonical_text(instance.id) for instance, _ in missing]
                self._waits[serial] = _Wait(
                    canonical_text(triggered_query.create_event(values)), memories, now
                )

    def _record_wait(self, wait: _Wait, now: int) -> None:
        self._write_record(WaitRecord(wait=wait.event, memories=wait.memories, start=wait.start, end=now))

    def record_final_state(self) -> None:
        """Report the queries that are still waiting, and the contents of the memories."""
        now = int(self._read_clock())
        for wait in self._waits.values():
            self._record_wait(wait, now)
        self._waits.clear()
        for memory in self._engine.status(MAX_RECORDED_MEMORIES).memories:
            self._write_record(
                MemoryStateRecord(
                    memory=memory.id,
                    pattern=memory.event,
                    size=memory.size,
                    records=memory.records,
                    taken=memory.added,
                    start=memory.oldest,
                    end=memory.newest,
                )
            )


def make_output_record(output: Output) -> OutputRecord:
    """Return the record of an output."""
    output_id = None if output.id is None else canonical_text(output.id)
    return OutputRecord(
        output=canonical_text(output.term), topic=output.topic, id=output_id, time=int(output.time)
    )


def make_incomplete_file_record(file: IncompleteFile) -> IncompleteFileRecord:
    """Return the record of a file of a bag that a crash has cut."""
    return IncompleteFileRecord(
        incomplete=file.path,
        problem=file.problem,
        messages=file.messages,
        position=file.position,
        unread_bytes=file.unread_bytes,
        missing_bytes=file.missing_bytes,
        lost_messages=0 if file.is_data_complete else file.lost_messages,
        end=file.end,
    )
