"""Conversion between ROS messages and terms: subscription of input topics, publishing of output topics.

Both nodes use it: the interface node, and node ``retalis`` for the topics that it subscribes to itself. A message
passes through these steps:

1. `connection_reader` reads a batch of serialized messages of one connection.
2. The handler that was created for the connection (`HandlerFactory`) converts each message. The types of publisher
   and subscription are compared once per connection; an unknown type is learned from the connection header.
3. The results of a batch are passed on together (`ResultConsumer`), under the lock `RosInterface.processing_lock`.

A message that cannot be converted is dropped, counted and reported; the connection continues.
"""

import threading
import time
from collections import deque
from functools import partial
from struct import Struct
from typing import (
    Any,
    Callable,
    ContextManager,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

import rospy

from ..engine.event_input import TopicRequest
from ..engine.runtime.clock_epochs import ClockEpochs
from ..engine.runtime.clock_skew import ClockSkewMonitor, EarlyMessage, RefusedMessage
from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import TOPICS, Topics, TopicType, topic_type
from ..foundation.bounded_caches import Cache
from ..foundation.errors import MessageError, RetalisError, UsageError, printable, shorten
from ..messages.decoder import Decoder, has_header
from ..messages.encoder import Encoder
from ..messages.transform_messages import (
    STATIC_TRANSFORM_TOPIC,
    TRANSFORM_TOPICS,
    TRANSFORM_TYPES,
    TransformReader,
)
from ..messages.type_registry import Definitions
from ..prolog.syntax.event_text import EventReader, to_text
from ..prolog.terms.types import Term, deref, functor
from .connection_reader import read_in_batches, refuse_own_connection
from .connection_writer import TopicWriter, serialized_bytes, serialized_class
from .first_outputs import StartupQueue, SubscriberWait
from .internode_topics import INPUT, OUTPUT, WATCH, resolve
from .latched_deduplication import LatchedConnection, LatchedMessageDeduplicator
from .text_topics import make_text_handler_factory
from .topic_statistics import InputCounts, InputStatus, LossMonitor, OutputStatus

MessageHandler = Callable[[bytes], Any]
"""Handler of a message; returns the result to pass on, or None if the handler has passed it on itself."""

ResultConsumer = Callable[[Iterable[Any]], object]
"""Receives the results of messages that were read together, as a lazy iterable."""

Publisher = Tuple[str, str]
"""A topic, and a node that publishes it."""

LatchedHandlerFactory = Callable[[Decoder, Publisher, LatchedConnection], MessageHandler]
"""Returns the handler of a latched connection's messages."""

HandlerFactory = Callable[[Decoder], MessageHandler]
"""Returns the handler of messages that a decoder reads."""

MAX_CACHED_CONNECTIONS = 1000
"""Maximum number of connections of a topic whose handlers are cached."""

BatchHandler = Callable[[List[bytes]], None]
"""Handler of messages that were read together."""


class _CachedHandler(NamedTuple):
    """A connection's header, the handler of its messages, and the monitor of its losses."""

    header: Dict[str, str]
    handler: BatchHandler
    monitor: LossMonitor


LOSS_HINT = "have it publish more slowly, with a longer queue, or end later (rosbag play --keep-alive)"
"""Advice for losing fewer messages, at the end of a warning."""

MAX_DELAY_SECONDS = 0.0012
"""Seconds for which a message of a fast topic may wait for the next ones."""


consume_and_discard: ResultConsumer = deque(maxlen=0).extend
"""Processes all messages of a batch and discards the results."""


class RosInterface:
    """Subscriptions and publications of a program.

    Args:
        handler_factory: returns the handler of messages of a type.
        queue: length of rospy's queues, in messages.
        reports: receives the errors of single messages.
        definitions: known message types.
        consume_results: receives the results of messages that were read together.
        max_delay: seconds for which a message of a fast topic may wait for the next ones.
        skew: checks the stamps of messages.
        latched: returns the handler of messages of latched connections; by default ``handler_factory`` does.
        clock_epochs: clock epochs; messages of an epoch that has not begun are queued there.
        loss_hint: how to lose fewer messages, for warnings about losses.

    Attributes:
        processing_lock: lock under which messages are processed.
        outputs: the published topics.
    """

    def __init__(
        self,
        handler_factory: HandlerFactory,
        queue: int,
        reports: Reports,
        definitions: Optional[Definitions] = None,
        consume_results: ResultConsumer = consume_and_discard,
        max_delay: float = MAX_DELAY_SECONDS,
        skew: Optional[ClockSkewMonitor] = None,
        latched: Optional[LatchedHandlerFactory] = None,
        clock_epochs: Optional[ClockEpochs] = None,
        loss_hint: str = LOSS_HINT,
    ):
        self._loss_hint = loss_hint
        self._clock_epochs = clock_epochs
        self._handler_factory = handler_factory
        self._latched = None if latched is None else self._wrap_latched_factory(latched)
        self._consume_results = consume_results
        self._max_delay = max_delay
        self._skew = skew
        self._queue = queue
        self._definitions = Definitions() if definitions is None else definitions
        self._inputs: Dict[str, InputTopic] = {}
        self.outputs = OutputTopics(self._definitions, queue, reports)
        self._text_topics: List[InputTopic] = []
        self._transform_topics: Dict[str, InputTopic] = {}
        self._excluded: Set[str] = set()
        self._reserved = {rospy.resolve_name(topic) for topic in (INPUT, OUTPUT)}
        self._lock = threading.Lock()
        self.processing_lock = threading.Lock()
        self._reports = reports

    def subscribe(self, topic: str, message_type: str, event_name: str = "") -> None:
        """Subscribe to a topic; each message becomes an event.

        Args:
            topic: name of the topic.
            message_type: message type.
            event_name: name of the events; by default it is derived from the type.

        Raises:
            UsageError: if the topic is subscribed already, or a name is invalid.
        """
        topic, message_type = topic_type(topic, message_type)
        name = resolve(topic)
        if name in self._reserved:
            raise UsageError(f"topic {topic} is for events as text, between the nodes")
        if name in self._excluded:
            raise UsageError(f"topic {topic} is subscribed by node retalis itself (its parameter ~direct)")
        with self._lock:
            if name in self._inputs:
                raise UsageError(
                    f"topic {topic} is already subscribed (as {self._inputs[name].message_type})"
                )
            self._inputs[name] = InputTopic(
                self._definitions,
                name,
                message_type,
                self._create_handler,
                self._queue,
                self.processing_lock,
                self._reports,
                self._consume_results,
                self._max_delay,
                self._skew,
                self._latched,
                event_name,
                self._clock_epochs,
                self._loss_hint,
            )

    def publishers(self) -> Set[Publisher]:
        """Return the topic and node of each connected publisher."""
        with self._lock:
            topics = list(self._inputs.items())
        return {(name, node) for name, topic in topics for node in topic.publishers()}

    def _create_handler(self, decoder: Decoder) -> MessageHandler:
        """Return the handler of a new connection's messages, after output topics have used a type that it defines."""
        self.outputs.advertise_learned_types()
        return self._handler_factory(decoder)

    def _wrap_latched_factory(self, latched_handler: LatchedHandlerFactory) -> LatchedHandlerFactory:
        """Return the equivalent of `_create_handler` for latched connections."""

        def handler_factory(
            decoder: Decoder, publisher: Publisher, connection: LatchedConnection
        ) -> MessageHandler:
            self.outputs.advertise_learned_types()
            return latched_handler(decoder, publisher, connection)

        return handler_factory

    def subscribe_texts(
        self,
        topic: str,
        handler: Callable[[str], object],
        clock_epochs: Optional[ClockEpochs] = None,
        latched: Optional[LatchedMessageDeduplicator] = None,
    ) -> ContextManager[object]:
        """Subscribe to a topic of texts between the nodes; return the lock under which the texts are processed.

        Texts that this node publishes itself are not received.

        Args:
            topic: name of the topic.
            handler: handler of a text.
            clock_epochs: clock epochs; texts of an epoch that has not begun are queued there.
            latched: recognizes the texts of latched messages that were processed already.
        """
        name = rospy.resolve_name(topic)
        handler_factory = make_text_handler_factory(handler, clock_epochs, latched)
        processing_lock = threading.Lock()
        input_topic = InputTopic(
            self._definitions,
            name,
            "std_msgs/String",
            handler_factory,
            self._queue,
            processing_lock,
            self._reports,
        )
        input_topic.refuse_own_connection()
        self._text_topics.append(input_topic)
        return processing_lock

    def subscribe_output_texts(self) -> None:
        """Subscribe to the outputs that other nodes send as text, and publish them as messages."""
        reader = EventReader()

        def publish(text: str) -> None:
            try:
                output = reader.read(text)
                if output.__class__ is not tuple or output[0] is not OUTPUT_EVENT:
                    raise UsageError(f"expected event(Term,Topic,Id), found {shorten(text)}")
            except RetalisError as error:
                self._reports.error(RetalisError(f"an output is not published: {error}"), OUTPUT)
                return
            topic = deref(output[2])
            self.outputs.publish(deref(output[1]), getattr(topic, "name", None) or to_text(topic))

        self.subscribe_texts(OUTPUT, publish)

    def subscribe_transforms(self, consume_results: ResultConsumer) -> None:
        """Subscribe to the topics of transforms; their messages become no events, unless a program names the topics.

        Args:
            consume_results: receives the messages that were read together, as pairs of a `TransformMessage` and None.
        """
        for topic in TRANSFORM_TOPICS:
            name = rospy.resolve_name(topic)
            reader = TransformReader(topic == STATIC_TRANSFORM_TOPIC)
            self._transform_topics[name] = InputTopic(
                self._definitions,
                name,
                TRANSFORM_TYPES[0],
                lambda decoder, read=reader.read: lambda data: (read(data), None),  # type: ignore[misc]
                self._queue,
                self.processing_lock,
                self._reports,
                consume_results,
                self._max_delay,
                clock_epochs=self._clock_epochs,
            )

    def exclude(self, topics: Iterable[TopicType]) -> None:
        """Reject topics that node retalis subscribes to itself, so that no message is processed twice."""
        self._excluded = {rospy.resolve_name(topic) for topic, _ in topics}

    def learn(self, topic: str, message_type: str) -> None:
        """Learn an unknown type from a publisher of a topic that node retalis subscribes to; process no messages."""
        if self.knows_type(message_type):
            return
        is_learned = threading.Event()

        def handler_factory(decoder: Decoder) -> MessageHandler:
            self.outputs.advertise_learned_types()
            is_learned.set()
            return lambda data: None

        input_topic = InputTopic(
            self._definitions,
            resolve(topic),
            message_type,
            handler_factory,
            self._queue,
            self.processing_lock,
            self._reports,
        )

        # Not closed by `handler_factory`: rospy calls it in the thread of the connection that closing would end.
        def close() -> None:
            is_learned.wait()
            input_topic.close()

        threading.Thread(target=close, daemon=True, name=f"learning {message_type}").start()

    def input_statuses(self) -> List[InputStatus]:
        """Return the counters of each subscribed topic."""
        topics = {**self._transform_topics, **self._inputs}
        return [topic.status() for topic in [*topics.values(), *self._text_topics]]

    def knows_type(self, message_type: str) -> bool:
        """Return whether a message type is known."""
        return message_type in self._definitions

    def unsubscribe(self, topic: str) -> TopicRequest:
        """Unsubscribe from a topic; return its subscription.

        Raises:
            UsageError: if it is not subscribed.
        """
        name = resolve(topic)
        with self._lock:
            input_topic = self._inputs.pop(name, None)
        if input_topic is None:
            raise UsageError(f"topic {topic} is not subscribed")
        input_topic.close()
        return TopicRequest(name, input_topic.message_type, input_topic.event_name)


class InputTopic:
    """Subscribed topic.

    A type that is not installed is learned from the publisher's connection header. ``event`` is the name of the
    events; by default it is derived from the type. The other arguments are those of `RosInterface`.

    rospy has a thread for each publisher. The lock ``processing_lock`` lets one thread at a time pass on its
    messages. The others wait, and TCP's flow control slows down their publishers (backpressure), instead of a queue
    growing before the engine.
    """

    def __init__(
        self,
        definitions: Definitions,
        name: str,
        message_type: str,
        handler_factory: HandlerFactory,
        queue: int,
        processing_lock: ContextManager[object],
        reports: Reports,
        consume_results: ResultConsumer = consume_and_discard,
        max_delay: float = MAX_DELAY_SECONDS,
        skew: Optional[ClockSkewMonitor] = None,
        latched: Optional[LatchedHandlerFactory] = None,
        event_name: str = "",
        clock_epochs: Optional[ClockEpochs] = None,
        loss_hint: str = LOSS_HINT,
    ):
        self._loss_hint = loss_hint
        self._latched = latched
        self.event_name = event_name
        self._clock_epochs = clock_epochs
        self.message_type = message_type
        self._skew = skew
        self._reports = reports
        self._processing_lock = processing_lock
        self._consume_results = consume_results
        self._definitions = definitions
        self._name = name
        self._handler_factory = handler_factory
        self.counts = InputCounts()
        self._cached_handlers: Cache[int, _CachedHandler] = Cache(MAX_CACHED_CONNECTIONS, 16 << 20, 4 << 20)
        self._subscriber = rospy.Subscriber(
            name, rospy.AnyMsg, self._receive, queue_size=queue, tcp_nodelay=True
        )
        read_in_batches(self._subscriber, self._handler_for, max_delay, self._record_end)

    def status(self) -> InputStatus:
        """Return the counters, and request that the lag of the next message is measured."""
        counts = self.counts
        counts.needs_lag = True
        age = None if counts.last is None else time.monotonic() - counts.last
        return InputStatus(
            self._name,
            self.message_type,
            self._subscriber.get_num_connections(),
            counts.messages,
            counts.dropped,
            counts.refused,
            counts.missing,
            age,
            counts.lag,
        )

    def refuse_own_connection(self) -> None:
        """Receive no messages that this node publishes."""
        refuse_own_connection(self._subscriber)

    def close(self) -> None:
        """Stop receiving."""
        self._subscriber.unregister()

    def publishers(self) -> List[str]:
        """Return the connected publishers."""
        topic = getattr(self._subscriber, "impl", None)
        connections = getattr(topic, "connections", None) or ()
        headers = [
            connection.header for connection in connections if getattr(connection, "socket", None) is not None
        ]
        return [header["callerid"] for header in headers if header and "callerid" in header]

    def _receive(self, message: Any) -> None:
        """Process a message that rospy has read."""
        # rospy attaches the connection's header, the same object to each message. It has no public name.
        header = message._connection_header
        data = message._buff if message.__class__ is rospy.AnyMsg else serialized_bytes(message)
        self._handler_for(header)([data])

    def _handler_for(self, header: Dict[str, str]) -> BatchHandler:
        """Return the handler of a connection's messages."""
        # By identity: a comparison of the headers would cost more than the conversion of a small message.
        cached = self._cached_handlers.get(id(header))
        if cached is None:
            cached = self._add_connection(header)
        return cached.handler

    def _record_end(self, header: Dict[str, str], is_incomplete: bool) -> None:
        """Record that a publisher has closed its connection."""
        cached = self._cached_handlers.get(id(header))
        if cached is not None:
            cached.monitor.close(is_incomplete)

    def _make_loss_monitor(self, publisher: str, has_header: bool) -> LossMonitor:
        """Return the monitor of a connection, which reports losses as warnings."""

        def report(loss: str) -> None:
            self._reports.warning(
                f"topic {self._name}: {publisher} sends faster than this node reads: {loss}; {self._loss_hint}",
                ("loss", self._name),
            )

        return LossMonitor(self.counts, has_header, report)

    def _make_batch_handler(
        self,
        handler: MessageHandler,
        stamp: Callable[[bytes], Optional[int]],
        publisher: str,
        monitor: LossMonitor,
    ) -> BatchHandler:
        """Return the handler of messages that were read together, which queues those of a coming epoch."""
        processing_lock, counts, clock_epochs = self._processing_lock, self.counts, self._clock_epochs
        handle_batch = self._make_reporting_handler(handler, publisher)

        def handle_messages(messages: List[bytes]) -> None:
            counts.count(len(messages))
            monitor.begin(messages)
            if counts.needs_lag:
                counts.measure_lag(stamp, messages[-1])
            with processing_lock:
                if (
                    clock_epochs is not None
                    and clock_epochs.is_buffering
                    and clock_epochs.must_buffer(publisher)
                ):
                    clock_epochs.buffer(handle_batch, messages)
                else:
                    handle_batch(messages)
            monitor.end()

        return handle_messages

    def _make_reporting_handler(self, handler: MessageHandler, publisher: str) -> BatchHandler:
        """Return a handler that converts messages, passes on the results, and reports failures."""
        consume_results, counts = self._consume_results, self.counts

        def convert(messages: List[bytes]) -> Iterator[Any]:
            for position, data in enumerate(messages):
                try:
                    result = handler(data)
                except RefusedMessage:
                    # Reported by the clock skew monitor.
                    counts.refused += 1
                # The message belongs to the next epoch. It and all later ones of its connection wait for the
                # epoch's begin, so that the order within the connection is preserved.
                except EarlyMessage:
                    if self._clock_epochs is not None:
                        self._clock_epochs.buffer_early(publisher, handle_batch, messages[position:])
                        return
                except Exception as error:
                    # rospy would close the connection.
                    self._report_failure(error)
                else:
                    if result is not None:
                        yield result

        def handle_batch(messages: List[bytes]) -> None:
            consume_results(convert(messages))

        return handle_batch

    def _report_failure(self, error: Exception) -> None:
        """Count and report a message that cannot be converted."""
        self.counts.dropped += 1
        if isinstance(error, MessageError):
            text = f"a message on {self._name} is dropped: {error}"
            self._reports.error(RetalisError(text), ("in", self._name))
        else:
            self._reports.error(error)

    def _add_connection(self, header: Dict[str, str]) -> _CachedHandler:
        """Create and cache the handler of a new connection's messages.

        The cache holds the header, too: its identity is the key, and would be reused if the header were freed.
        """
        publisher = header.get("callerid", "")
        monitor = self._make_loss_monitor(publisher, False)
        try:
            decoder = self._decoder_for(header)
            stamp = decoder.stamp
            monitor = self._make_loss_monitor(publisher, has_header(decoder.definition))
            if self._skew is not None:
                decoder = self._skew.watch(decoder, self._name, publisher)
            handler = self._make_batch_handler(
                self._make_message_handler(header, decoder), stamp, publisher, monitor
            )
        # Without a handler, rospy would close the connection and connect again at once, forever. A publisher of the
        # wrong type is therefore connected to a handler that drops its messages.
        except Exception as error:
            if not isinstance(error, MessageError):
                self._reports.error(error)
            reason = getattr(error, "message", "internal error")
            handler = self._make_dropping_handler(
                f"topic {self._name}: {reason}: a message of {publisher or 'somebody'} is dropped"
            )
        size = sum(map(len, header.values()))
        return self._cached_handlers.store(id(header), _CachedHandler(header, handler, monitor), 2 * size)

    def _make_message_handler(self, header: Dict[str, str], decoder: Decoder) -> MessageHandler:
        """Return the handler of a connection's messages, latched or not."""
        if self._latched is not None and header.get("latching") == "1":
            publisher = (self._name, header.get("callerid", ""))
            return self._latched(
                decoder, publisher, LatchedConnection(*publisher, self._find_publisher_address(header))
            )
        return self._handler_factory(decoder)

    def _find_publisher_address(self, header: Dict[str, str]) -> str:
        """Return the XML-RPC address of a connection's publisher; "" if unknown."""
        topic = getattr(self._subscriber, "impl", None)
        connections = getattr(topic, "connections", None) or ()
        return next(
            (str(connection.endpoint_id) for connection in connections if connection.header is header), ""
        )

    def _make_dropping_handler(self, reason: str) -> BatchHandler:
        """Return a handler that drops, counts and reports messages."""

        def reject(messages: List[bytes]) -> None:
            self.counts.count(len(messages))
            self.counts.refused += len(messages)
            for _ in messages:
                self._reports.warning(reason)

        return reject

    def _decoder_for(self, header: Dict[str, str]) -> Decoder:
        """Return the decoder for a publisher's messages.

        Raises:
            MessageError: if their type differs from the subscription's.
        """
        sent_type = header.get("type", "*")
        learned = self._definitions.learn(
            self.message_type,
            sent_type,
            header.get("message_definition", ""),
            header.get("md5sum", ""),
            self.event_name,
        )
        if learned.is_replacement:
            rospy.logwarn(
                "topic %s is subscribed as %s, which is unknown here; %s publishes %s, which is used instead",
                self._name,
                self.message_type,
                printable(shorten(header.get("callerid", "somebody"))),
                printable(shorten(sent_type)),
            )
        return learned.decoder


MAX_UNTYPED_TOPICS_NAMED = 100
"""Maximum number of topics without a type that are logged."""

_LENGTH = Struct("<I")
"""Length of a message, which precedes it on a connection."""


class _TypedTopic(NamedTuple):
    """An advertised topic.

    Attributes:
        writer: writer of its messages.
        queue: messages that wait for the subscribers that were registered before.
        encoder: encoder of terms to messages of its type.
    """

    writer: TopicWriter
    queue: StartupQueue
    encoder: Encoder


class _UnadvertisedTopic(NamedTuple):
    """A topic with an unknown type, and whether it will be latched."""

    message_type: str
    latched: bool


class OutputTopics:
    """The output topics of a program.

    A topic whose type is not installed is advertised as soon as a publisher of an input topic has defined the type;
    see `advertise_learned_types`.

    Args:
        definitions: known message types.
        queue: number of messages to queue for each subscriber.
        reports: receives the errors of single messages.
    """

    def __init__(self, definitions: Definitions, queue: int, reports: Reports):
        self._definitions = definitions
        self._queue = queue
        self._reports = reports
        self._lock = threading.Lock()
        self._subscriber_wait = SubscriberWait(reports)
        self._typed: Dict[str, _TypedTopic] = {}
        self._unadvertised: Dict[str, _UnadvertisedTopic] = {}
        """Topics that are advertised when their types become known."""
        self._logged_topics: Set[str] = set()

    def advertise(self, topic: str, message_type: str, latched: bool = False) -> None:
        """Advertise a topic with a message type.

        Args:
            topic: name of the topic.
            message_type: message type; if it is unknown, the topic is advertised when the type becomes known.
            latched: whether each new subscriber receives the last message.

        Raises:
            MessageError: if the type is unknown yet, or invalid.
            UsageError: if the topic's name is invalid, or the topic has another type already.
        """
        name = resolve(topic)
        with self._lock:
            known_type = self._type_of(name)
            if known_type is not None:
                if known_type != message_type:
                    raise UsageError(f"topic {topic} already has the type {known_type}")
                return
            try:
                self._advertise(name, message_type, latched)
            except MessageError:
                self._unadvertised[name] = _UnadvertisedTopic(message_type, latched)
                raise

    def status(self) -> List[OutputStatus]:
        """Return the counters of each topic."""
        return [topic.writer.status(topic.encoder.definition.name) for topic in list(self._typed.values())]

    def _type_of(self, name: str) -> Optional[str]:
        """Return the type of a topic; None if it has none."""
        if name in self._typed:
            return self._typed[name].encoder.definition.name
        return self._unadvertised[name].message_type if name in self._unadvertised else None

    def _advertise(self, name: str, message_type: str, latched: bool) -> None:
        definition = self._definitions.find(message_type)
        topic_writer = TopicWriter(
            name, serialized_class(definition), self._queue, self._reports, latched=latched
        )
        queue = StartupQueue(topic_writer, self._queue, self._reports)
        self._typed[name] = _TypedTopic(topic_writer, queue, self._definitions.encoder(definition))
        self._subscriber_wait.add(name, queue)

    def advertise_learned_types(self) -> None:
        """Advertise the topics whose types have become known through a new connection to a publisher."""
        # Called for each new connection, in nearly all programs without a topic that waits for its type.
        if not self._unadvertised:
            return
        with self._lock:
            for name, (message_type, latched) in list(self._unadvertised.items()):
                if message_type in self._definitions:
                    self._advertise(name, message_type, latched)
                    del self._unadvertised[name]
                    rospy.loginfo(
                        "topic %s is published: its type %s was learned from a publisher", name, message_type
                    )

    def publish(self, term: Term, topic: str) -> None:
        """Publish a term as a message; a term that does not fit the topic's type is reported and not published.

        Outputs to a topic without a type exist only as text.
        """
        try:
            typed_topic = self._typed.get(resolve(topic))
            if typed_topic is None:
                self._report_unpublished(topic)
                return
            data = typed_topic.encoder.encode(term, topic)
            typed_topic.queue.send(_LENGTH.pack(len(data)) + data)
        except RetalisError as error:
            self._reports.error(error, ("out", topic))

    def _report_unpublished(self, topic: str) -> None:
        """Report an output that is not published as message.

        For a topic that waits for its type each message is a loss, and is counted as a warning. For a topic without a
        type it is normal, and is logged once.
        """
        unadvertised = self._unadvertised.get(resolve(topic))
        if unadvertised is not None:
            text = (
                f"topic {topic}: a message is dropped: type {unadvertised.message_type} is unknown until a publisher "
                "defines it"
            )
            self._reports.warning(text, ("out", topic))
        elif (
            len(self._logged_topics) < MAX_UNTYPED_TOPICS_NAMED
            and topic not in self._logged_topics
            and not topic.startswith(WATCH)
        ):
            self._logged_topics.add(topic)
            rospy.loginfo(
                "topic %s has no type in %s: its outputs are on %s only",
                printable(shorten(topic)),
                TOPICS,
                OUTPUT,
            )


class UntypedTopicWarnings:
    """Warns once about each output topic without a type, whose outputs are published only as text.

    Args:
        published: topics with a type.
        reports: receives the warnings.
    """

    def __init__(self, published: Iterable[str], reports: Reports):
        self._reports = reports
        self._published = {rospy.resolve_name(topic) for topic in published}
        self._checked: Cache[str, bool] = Cache(1000, 1 << 20)

    def check(self, topic: str) -> None:
        """Check a topic to which outputs are sent or will be sent."""
        if topic not in self._checked and not topic.startswith(WATCH):
            self._checked.store(topic, True, len(topic))
            if not self._has_type(topic):
                name = shorten(topic)
                self._reports.warning(
                    f"topic {name} has no type: its events are published only as text on {OUTPUT}; "
                    f'<publish_to name="{name}" msg_type="package/Type"/> in {TOPICS} would give it one',
                    "topics without a type",
                    texts=20,
                )

    def mark_reported(self, topics: Iterable[str]) -> None:
        """Record topics whose warning has been given elsewhere."""
        for topic in topics:
            self._checked.store(topic, True, len(topic))

    def _has_type(self, topic: str) -> bool:
        try:
            return resolve(topic) in self._published
        except UsageError:
            # Not a valid topic name: its outputs exist only as text.
            return False


OUTPUT_EVENT = functor("event", 3)
"""Functor of an output between the nodes: term, topic, and id of the subscription."""


def connect(interface: RosInterface, topics: Topics, direct_topics: Iterable[TopicType] = ()) -> None:
    """Subscribe to and advertise the topics of ``pub_sub.xml``, except those that node retalis has subscribed to."""
    direct_topics = tuple(direct_topics)
    direct_names = {rospy.resolve_name(topic) for topic, _ in direct_topics}
    may_be_learned = any(
        not interface.knows_type(message_type) for _, message_type in (*topics.subscribed, *direct_topics)
    )
    for topic, message_type in topics.published:
        latched = topic in topics.latched
        advertise = partial(interface.outputs.advertise, topic, message_type, latched)
        _apply_configuration(advertise, topic, may_be_learned)
    for topic, message_type in topics.subscribed:
        if rospy.resolve_name(topic) not in direct_names:
            subscribe = partial(interface.subscribe, topic, message_type, topics.event_name_of(topic))
            _apply_configuration(subscribe, topic)


def _apply_configuration(work: Callable[[], None], topic: str, may_be_learned: bool = False) -> None:
    """Apply a line of ``pub_sub.xml``; log a failure, as information if a publisher may still define the type."""
    try:
        work()
    except RetalisError as error:
        if may_be_learned and isinstance(error, MessageError):
            rospy.loginfo("%s: topic %s: %s; it may come with a message", TOPICS, topic, error)
        else:
            rospy.logerr("%s: topic %s: %s", TOPICS, topic, error)
