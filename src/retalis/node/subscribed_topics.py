"""Subscribed topics of a program, and the conversion of their messages to events.

A message passes through these steps:

1. The transport reads serialized messages of one source; see `MessageSource`.
2. The handler that was created for the source (`HandlerFactory`) converts each message; see `SourceReader.convert`.
   The types of source and subscription are compared once per source; an unknown type is learned from the source.
   Messages of actions are first converted to those of an event type; see `messages.action_events`.
3. The results of messages that were read together are passed on together (`ResultConsumer`), under the lock
   `MessageProcessing.lock`.

A message that cannot be converted is dropped, counted and reported; the source stays connected.
"""

import logging
import threading
import time
from collections import deque
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
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
    Sequence,
    Set,
    Tuple,
)

from ..engine.event_input import TopicRequest
from ..engine.redelivered_messages import IdentifiedMessage, MessageIdentity
from ..engine.runtime.clock_epochs import ClockEpochs
from ..engine.runtime.clock_skew import ClockSkewMonitor, EarlyMessage, RefusedMessage
from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import (
    ANY_QUALITY,
    TOPICS,
    QualityOfService,
    Topics,
    TopicType,
    topic_type,
)
from ..foundation.displayed_text import printable, shorten
from ..foundation.errors import MessageError, RetalisError, UsageError
from ..messages.action_events import FEEDBACK, STATUS, ActionEvent, ActionMessages, find_action_event
from ..messages.decoder import Decoder, has_header
from ..messages.transform_messages import (
    STATIC_TRANSFORM_TOPIC,
    TRANSFORM_TOPICS,
    TRANSFORM_TYPES,
    TransformReader,
)
from ..messages.type_definition import SerializationFormat
from ..messages.type_registry import Definitions
from .text_exchange import TEXT_TOPICS, resolve_subscribable_topic
from .topic_statistics import InputCounts, InputStatus, LossMonitor
from .transport import MessageSource, MessageTransport

log = logging.getLogger("retalis")

MessageHandler = Callable[[bytes], Any]
"""Handler of a message; returns the result to pass on, or None if the handler has passed it on itself."""

HandlerFactory = Callable[[Decoder, str, MessageSource], MessageHandler]
"""Returns the handler of messages that a decoder reads, by the full name of their topic and their source."""

ResultConsumer = Callable[[Iterable[Any]], object]
"""Receives the results of messages that were read together, as a lazy iterable."""

BatchHandler = Callable[..., None]
"""Handler of messages that were read together; see `MessageReceiver.receive`."""

Convert = Callable[[bytes], Any]
"""Returns the result of a message; None if it is dropped."""

Split = Callable[[bytes], List[bytes]]
"""Returns the messages of an event type that a message of an action becomes."""

consume_and_discard: ResultConsumer = deque(maxlen=0).extend
"""Processes all messages of a batch and discards the results."""

LOSS_HINT = "have it publish more slowly, with a longer queue, or end later (rosbag play --keep-alive)"
"""Advice for losing fewer messages, at the end of a warning."""

MAX_ACTION_SERVERS = 100
"""Number of nodes with an action of one name whose goals are known while they are not connected."""

MAX_DELAY_SECONDS = 0.0012
"""Seconds for which a message of a fast topic may wait for the next ones."""


class MessageProcessing(NamedTuple):
    """Processing of the messages of topics.

    Attributes:
        make_handler: returns the handler of a source's messages.
        lock: lock under which messages are processed. A transport may have a thread for each source. The lock lets
            one thread at a time pass on its messages. The others wait, and slow down their publishers
            (backpressure), instead of a queue growing before the engine.
        consume_results: receives the results of messages that were read together.
        skew: checks the stamps of messages.
        clock_epochs: clock epochs; messages of an epoch that has not begun are queued there.
        reads_transforms: whether messages are converted to transforms.
        stamp_receipt: returns the instant of an event without one, given the instant at which the middleware has
            received its message; None if this cannot be the instant. Results are pairs of event and instant then.
        consume_identified: receives the results of messages that may be delivered again, with `IdentifiedMessage` in
            place of the events; None if ``consume_results`` receives them as others.
    """

    make_handler: HandlerFactory
    lock: ContextManager[object]
    consume_results: ResultConsumer = consume_and_discard
    skew: Optional[ClockSkewMonitor] = None
    clock_epochs: Optional[ClockEpochs] = None
    reads_transforms: bool = False
    stamp_receipt: Optional[Callable[[int], Optional[int]]] = None
    consume_identified: Optional[ResultConsumer] = None


def log_replaced_type(request: TopicRequest, source: MessageSource) -> None:
    """Log a warning that a source's type is used in place of an unknown one, as which its topic is subscribed."""
    log.warning(
        "topic %s is subscribed as %s, which is unknown here; %s publishes %s, which is used instead",
        request.topic,
        request.message_type,
        printable(shorten(source.node or "somebody")),
        printable(shorten(source.message_type)),
    )


def list_endpoints(topic: str, message_type: str, transport: MessageTransport) -> List[TopicType]:
    """Return the topics whose messages become the events of a topic: one, or for an action those of its server.

    As in clients and servers, the name of an action is resolved first, then those of its topics, which may be
    remapped, too.

    Args:
        topic: name of the topic, or ``action/kind`` for an event of an action.
        message_type: type of the topic, or an event type.
        transport: the middleware.

    Raises:
        UsageError: if a name is invalid.
    """
    resolve_topic = transport.resolve_topic
    event = find_action_event(message_type)
    action_topic = None if event is None else event.action_topic(topic)
    if event is None or action_topic is None:
        return [TopicType(resolve_topic(topic), message_type)]
    endpoints = [
        event.endpoint(resolve_topic(action_topic), message_format)
        for message_format in transport.received_formats
    ]
    return [TopicType(resolve_topic(endpoint), type_name) for endpoint, type_name in endpoints]


class ReadingOptions(NamedTuple):
    """Options for reading a topic.

    Attributes:
        queue_size: number of messages to queue.
        max_delay: seconds for which a message of a fast topic may wait for the next ones.
        loss_hint: how to lose fewer messages, for warnings about losses.
        ignores_own: whether messages of this node are not received.
        reserved: topics that a program may not subscribe to.
        quality_of: returns what the program demands of a topic's quality of service, by its full name.
        report_replaced_type: called if a source's type is used in place of an unknown one.
    """

    queue_size: int
    max_delay: float = MAX_DELAY_SECONDS
    loss_hint: str = LOSS_HINT
    ignores_own: bool = False
    reserved: Tuple[str, ...] = TEXT_TOPICS
    quality_of: Callable[[str], QualityOfService] = lambda topic: ANY_QUALITY
    report_replaced_type: Callable[[TopicRequest, MessageSource], object] = log_replaced_type


class SubscribedTopics:
    """The subscribed topics of a node.

    Args:
        transport: the middleware.
        definitions: known message types.
        reports: receives the errors of single messages.
        processing: how messages become events.
        options: how topics are read.
        on_type_learned: called when a source may have defined a type that was unknown.
    """

    def __init__(
        self,
        transport: MessageTransport,
        definitions: Definitions,
        reports: Reports,
        processing: MessageProcessing,
        options: ReadingOptions,
        on_type_learned: Callable[[], object],
    ):
        self._transport = transport
        self._definitions = definitions
        self._reports = reports
        self._processing = processing._replace(make_handler=self._make_handler)
        self._factory = processing.make_handler
        self._options = options
        self._on_type_learned = on_type_learned
        self._topics: Dict[str, SubscribedTopic] = {}
        self._transform_topics: Dict[str, SubscribedTopic] = {}
        self._text_topics: List[SubscribedTopic] = []
        self._excluded: Set[str] = set()
        self._lock = threading.Lock()

    def subscribe(self, topic: str, message_type: str, event_name: str = "") -> None:
        """Subscribe to a topic; each message becomes an event, by default with the name of its type.

        Raises:
            UsageError: if the topic is subscribed already, or a name is invalid.
        """
        topic, message_type = topic_type(topic, message_type)
        action_event = find_action_event(message_type)
        if action_event is not None and action_event.action_topic(topic) is None:
            raise UsageError(
                f"topic {topic}: {message_type} is an event of an action: expected the name of an action and "
                f"/{action_event.kind}"
            )
        name = self.resolve(topic)
        if name in self._excluded:
            raise UsageError(f"topic {topic} is subscribed by node retalis itself (its parameter ~direct)")
        with self._lock:
            if name in self._topics:
                raise UsageError(
                    f"topic {topic} is already subscribed (as {self._topics[name].request.message_type})"
                )
            request = TopicRequest(name, message_type, event_name)
            endpoints = list_endpoints(topic, message_type, self._transport)
            self._topics[name] = self._open(request, self._processing, endpoints=endpoints)

    def forget_goals(self) -> None:
        """Forget the states of the goals of all actions, since time begins again."""
        for subscribed_topic in list(self._topics.values()):
            subscribed_topic.forget_goals()

    def subscribe_all(self, topics: Topics, direct: Iterable[TopicType]) -> None:
        """Subscribe to the topics of ``pub_sub.xml``, except those of ``direct``. Errors are logged."""
        resolve_topic = self._transport.resolve_topic
        direct_names = {resolve_topic(topic) for topic, _ in direct}
        reported: Set[Tuple[str, int]] = set()
        for topic, message_type in topics.subscribed:
            if resolve_topic(topic) in direct_names:
                continue
            try:
                self.subscribe(topic, message_type, topics.event_name_of(topic))
            except RetalisError as error:
                subject, level = f"topic {topic}", logging.ERROR
                event = find_action_event(message_type)
                if event is not None:
                    subject = f"action {event.action_topic(topic)}"
                    # Servers of ROS 2 need not publish the others, and older distributions lack their types.
                    level = logging.ERROR if event.kind in (STATUS, FEEDBACK) else logging.INFO
                # The topics of an action fail for the same reason.
                if event is None or (subject, level) not in reported:
                    log.log(level, "%s: %s: %s", TOPICS, subject, str(error))
                    reported.add((subject, level))

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic that a program may subscribe to.

        Raises:
            UsageError: if the name is invalid, or the topic is reserved.
        """
        return resolve_subscribable_topic(topic, self._transport.resolve_topic, self._options.reserved)

    def try_to_subscribe(
        self, request: TopicRequest, requester: str = "subscribe_to", error_level: int = logging.ERROR
    ) -> bool:
        """Subscribe to a topic; return whether it succeeds. An error is logged, with the name of the requester."""
        try:
            self.subscribe(*request)
        except RetalisError as error:
            # A node that is being shut down can subscribe no more.
            level = logging.DEBUG if self._transport.is_shut_down() else error_level
            log.log(level, "%s: %s", requester, error)
            return False
        return True

    def unsubscribe(self, topic: str) -> TopicRequest:
        """Unsubscribe from a topic; return its subscription.

        Raises:
            UsageError: if it is not subscribed.
        """
        name = self._transport.resolve_topic(topic)
        with self._lock:
            subscribed_topic = self._topics.pop(name, None)
        if subscribed_topic is None:
            raise UsageError(f"topic {topic} is not subscribed")
        subscribed_topic.close()
        return subscribed_topic.request

    def subscribe_texts(self, topic: str, make_handler: HandlerFactory) -> ContextManager[object]:
        """Subscribe to a topic of texts between nodes, without the texts of this node.

        Returns:
            The lock under which the texts are processed.
        """
        lock = threading.Lock()
        request = TopicRequest(self._transport.resolve_topic(topic), "std_msgs/String")
        processing = MessageProcessing(make_handler, lock)
        options = ReadingOptions(self._options.queue_size, ignores_own=True)
        self._text_topics.append(self._open(request, processing, options))
        return lock

    def subscribe_transforms(self, consume_results: ResultConsumer) -> None:
        """Subscribe to the topics of transforms; their messages become no events, unless a program names the topics.

        Args:
            consume_results: receives the messages that were read together, as pairs of a `TransformMessage` and None.
        """
        for topic in TRANSFORM_TOPICS:
            name = self._transport.resolve_topic(topic)
            processing = self._processing._replace(
                make_handler=make_transform_handler_factory(topic == STATIC_TRANSFORM_TOPIC),
                consume_results=consume_results,
                consume_identified=None,
                skew=None,
                reads_transforms=True,
                stamp_receipt=None,
            )
            self._transform_topics[name] = self._open(TopicRequest(name, TRANSFORM_TYPES[0]), processing)

    def exclude(self, topics: Iterable[TopicType]) -> None:
        """Reject topics that another node subscribes to, so that no message is processed twice."""
        self._excluded = {self._transport.resolve_topic(topic) for topic, _ in topics}

    def learn(self, topic: str, message_type: str) -> None:
        """Learn an unknown type from a publisher of a topic that another node subscribes to; process no messages."""
        if self.knows_type(message_type):
            return
        is_learned = threading.Event()

        def make_handler(decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
            self._on_type_learned()
            is_learned.set()
            return lambda data: None

        request = TopicRequest(self._transport.resolve_topic(topic), message_type)
        subscribed_topic = self._open(request, MessageProcessing(make_handler, self._processing.lock))

        # Not closed by `make_handler`, which a transport may call in a thread that closing would end.
        def close() -> None:
            is_learned.wait()
            subscribed_topic.close()

        threading.Thread(target=close, daemon=True, name=f"learning {message_type}").start()

    def publishers(self) -> Set[Tuple[str, str]]:
        """Return the topic and node of each connected publisher."""
        with self._lock:
            topics = list(self._topics.items())
        return {(name, node) for name, topic in topics for node in topic.publishers()}

    def statuses(self) -> List[InputStatus]:
        """Return the counters of each subscribed topic."""
        topics = {**self._transform_topics, **self._topics}
        return [topic.status() for topic in [*topics.values(), *self._text_topics]]

    def knows_type(self, message_type: str) -> bool:
        """Return whether a message type is known."""
        return message_type in self._definitions

    def _open(
        self,
        request: TopicRequest,
        processing: MessageProcessing,
        options: Optional[ReadingOptions] = None,
        endpoints: Sequence[TopicType] = (),
    ) -> "SubscribedTopic":
        return SubscribedTopic(
            self._transport,
            self._definitions,
            self._reports,
            request,
            processing,
            options or self._options,
            endpoints,
        )

    def _make_handler(self, decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
        """Return the handler of a new source's messages, after others have used a type that it defines."""
        self._on_type_learned()
        return self._factory(decoder, topic, source)


def make_transform_handler_factory(is_static: bool) -> HandlerFactory:
    """Return the factory of handlers that convert messages to pairs of a `TransformMessage` and None."""

    def make_handler(decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
        read = TransformReader(is_static, decoder.format).read
        return lambda data: (read(data), None)

    return make_handler


class SubscribedTopic:
    """A subscribed topic. A type that is not installed is learned from a source.

    Args:
        transport: the middleware.
        definitions: known message types.
        reports: receives the errors of single messages.
        request: full name of the topic, its type, and the name of its events.
        processing: how messages become events.
        options: how the topic is read.
        endpoints: the topics whose messages become its events; by default the topic itself.

    Attributes:
        request: see above.
        counts: counters of the messages.
    """

    def __init__(
        self,
        transport: MessageTransport,
        definitions: Definitions,
        reports: Reports,
        request: TopicRequest,
        processing: MessageProcessing,
        options: ReadingOptions,
        endpoints: Sequence[TopicType] = (),
    ):
        self.request = request
        self._definitions = definitions
        self._reports = reports
        self._processing = processing
        self._options = options
        self._action_event = find_action_event(request.message_type)
        self._action_lock = threading.Lock()
        self._action_messages: Dict[Tuple[str, str, SerializationFormat], ActionMessages] = {}
        self.counts = InputCounts(transport.now)
        self._subscriptions = [
            transport.subscribe(
                topic,
                message_type,
                partial(self._connect, message_type),
                options.queue_size,
                options.max_delay,
                options.ignores_own,
                options.quality_of(request.topic),
            )
            for topic, message_type in endpoints or [TopicType(request.topic, request.message_type)]
        ]

    def status(self) -> InputStatus:
        """Return the counters, and request that the lag of the next message is measured."""
        counts = self.counts
        counts.needs_lag = True
        age = None if counts.last is None else time.monotonic() - counts.last
        return InputStatus(
            topic=self.request.topic,
            type=self.request.message_type,
            publishers=sum(subscription.publisher_count() for subscription in self._subscriptions),
            messages=counts.messages,
            dropped=counts.dropped,
            refused=counts.refused,
            missing=counts.missing,
            age=age,
            lag=counts.lag,
        )

    def publishers(self) -> List[str]:
        """Return the connected publishers."""
        return [name for subscription in self._subscriptions for name in subscription.publishers()]

    def close(self) -> None:
        """Stop receiving."""
        for subscription in self._subscriptions:
            subscription.close()

    def _connect(self, message_type: str, source: MessageSource) -> "SourceReader":
        """Return the receiver of a new source's messages. A source of the wrong type gets one that drops them."""
        topic, processing = self.request.topic, self._processing
        monitor = self._make_loss_monitor(source, False)
        action_messages: Optional[ActionMessages] = None
        try:
            decoder = self._find_decoder(message_type, source)
            if self._action_event is not None:
                action_messages = self._find_action_messages(self._action_event, source.node, decoder)
                decoder = self._definitions.decoder(action_messages.definition.as_event(self.request.event))
            stamp = decoder.stamp
            # In ROS 2, headers have no sequence number.
            is_numbered = decoder.format is SerializationFormat.ROS1 and has_header(decoder.definition)
            monitor = self._make_loss_monitor(source, is_numbered)
            if processing.skew is not None and action_messages is None:
                decoder = processing.skew.watch(decoder, topic, source.node)
            handler = processing.make_handler(decoder, topic, source)
        # Without a receiver, a transport might connect again at once, forever.
        except Exception as error:
            if not isinstance(error, MessageError):
                self._reports.error(error)
            reason = getattr(error, "message", "internal error")
            reject = self._make_dropping_handler(
                f"topic {topic}: {reason}: a message of {source.node or 'somebody'} is dropped"
            )
            return SourceReader(
                lambda data: reject([data]), reject, monitor, processing.reads_transforms, reason
            )
        convert = self._make_converter(handler)
        split = None if action_messages is None else self._make_splitter(action_messages)
        receive = self._make_batch_handler(convert, stamp, source, monitor, split)
        if split is not None:
            convert = _join(split, convert)
        return SourceReader(convert, receive, monitor, processing.reads_transforms)

    def _find_action_messages(self, event: ActionEvent, node: str, decoder: Decoder) -> ActionMessages:
        """Return the conversion of a node's messages; it knows the states of its goals if the node connects again."""
        # In ROS 2 a name states only one of several publishers, whose goals have unique ids: all are one source.
        source_name = node if decoder.format is SerializationFormat.ROS1 else ""
        key = source_name, decoder.definition.md5sum, decoder.format
        # Several sources may connect at the same time.
        with self._action_lock:
            # Removed and added again, so that the node that has not connected for longest is evicted first.
            action_messages = self._action_messages.pop(key, None) or ActionMessages(
                event, decoder.definition, decoder.format
            )
            self._action_messages[key] = action_messages
            if len(self._action_messages) > MAX_ACTION_SERVERS:
                del self._action_messages[next(iter(self._action_messages))]
        return action_messages

    def forget_goals(self) -> None:
        """Forget the states of an action's goals, since time begins again."""
        with self._action_lock:
            for action_messages in self._action_messages.values():
                action_messages.forget_goals()

    def _find_decoder(self, message_type: str, source: MessageSource) -> Decoder:
        """Return the decoder for a source's messages, which are expected to be of a type.

        Raises:
            MessageError: if their type differs from the subscription's.
        """
        request = self.request
        if not (source.definition or source.md5sum):
            # The middleware does not say: the messages have the type as it is known here.
            is_named = source.message_type != "*"
            known = self._definitions.find(source.message_type if is_named else message_type)
            source = source._replace(message_type=known.name, definition=known.full_text, md5sum=known.md5sum)
        learned = self._definitions.learn(
            message_type,
            source.message_type,
            source.definition,
            source.md5sum,
            "" if self._action_event else request.event,
            source.format,
        )
        if learned.is_replacement:
            self._options.report_replaced_type(request, source)
        return learned.decoder

    def _make_loss_monitor(self, source: MessageSource, has_header: bool) -> LossMonitor:
        """Return the monitor of a source, which reports losses as warnings."""

        def report(loss: str) -> None:
            self._reports.warning(
                f"topic {self.request.topic}: {source.node} sends faster than this node reads: {loss}; "
                f"{self._options.loss_hint}",
                ("loss", self.request.topic),
            )

        return LossMonitor(self.counts, has_header, report)

    def _make_batch_handler(
        self,
        convert: Convert,
        stamp: Callable[[bytes], Optional[int]],
        source: MessageSource,
        monitor: LossMonitor,
        split: Optional[Split],
    ) -> BatchHandler:
        """Return the handler of messages that were read together, which queues those of a coming epoch."""
        lock, counts, clock_epochs = self._processing.lock, self.counts, self._processing.clock_epochs
        handle_batch = self._make_result_handler(convert, source)
        if split is not None:
            handle_batch = _handle_parts(split, handle_batch)
        uses_receipts = self._processing.stamp_receipt is not None

        def handle_messages(
            messages: List[bytes],
            received: Sequence[int] = (),
            identities: Sequence[MessageIdentity] = (),
        ) -> None:
            counts.count(len(messages))
            monitor.begin(messages)
            if not uses_receipts:
                received = ()
            if counts.needs_lag:
                counts.measure_lag(stamp, messages[-1], received[-1] if received else None)
            with lock:
                if (
                    clock_epochs is not None
                    and clock_epochs.is_buffering
                    and clock_epochs.must_buffer(source.node)
                ):
                    clock_epochs.buffer(handle_batch, messages)
                else:
                    handle_batch(messages, received, identities)
            monitor.end()

        return handle_messages

    def _make_result_handler(self, convert: Convert, source: MessageSource) -> BatchHandler:
        """Return a handler that converts messages and passes on the results."""
        consume_results, clock_epochs = self._processing.consume_results, self._processing.clock_epochs
        consume_identified, topic = self._processing.consume_identified, self.request.topic
        stamp_receipt = self._processing.stamp_receipt

        def convert_all(
            messages: List[bytes], received: Sequence[int], identities: Sequence[MessageIdentity]
        ) -> Iterator[Any]:
            for position, data in enumerate(messages):
                try:
                    result = convert(data)
                # The message belongs to the next epoch. It and all later ones of its source wait for the epoch's
                # begin, so that the order within the source is preserved.
                except EarlyMessage:
                    if clock_epochs is not None:
                        clock_epochs.buffer_early(source.node, handle_batch, messages[position:])
                        return
                    continue
                if result is None:
                    continue
                if received and stamp_receipt is not None and result[1] is None:
                    result = result[0], stamp_receipt(received[position])
                if identities:
                    result = IdentifiedMessage(result[0], topic, identities[position]), result[1]
                yield result

        def handle_batch(
            messages: List[bytes],
            received: Sequence[int] = (),
            identities: Sequence[MessageIdentity] = (),
        ) -> None:
            if identities and consume_identified is not None:
                consume_identified(convert_all(messages, received, identities))
            else:
                consume_results(convert_all(messages, received, ()))

        return handle_batch

    def _make_splitter(self, action_messages: ActionMessages) -> Split:
        """Return a function that converts a message of an action, and reports failures."""

        def split(data: bytes) -> List[bytes]:
            try:
                return action_messages.convert(data)
            except Exception as error:
                self._report_failure(error)
            return []

        return split

    def _make_converter(self, handler: MessageHandler) -> Convert:
        """Return a function that converts a message, and reports failures except `EarlyMessage`."""
        counts = self.counts

        def convert(data: bytes) -> Any:
            try:
                return handler(data)
            except RefusedMessage:
                # Reported by the clock skew monitor.
                counts.refused += 1
            except EarlyMessage:
                raise
            except Exception as error:
                # The transport would close the connection.
                self._report_failure(error)
            return None

        return convert

    def _report_failure(self, error: Exception) -> None:
        """Count and report a message that cannot be converted."""
        self.counts.dropped += 1
        if isinstance(error, MessageError):
            text = f"a message on {self.request.topic} is dropped: {error}"
            self._reports.error(RetalisError(text), ("in", self.request.topic))
        else:
            self._reports.error(error)

    def _make_dropping_handler(self, reason: str) -> BatchHandler:
        """Return a handler that drops, counts and reports messages."""

        def reject(messages: List[bytes], *details: object) -> None:
            self.counts.count(len(messages))
            self.counts.refused += len(messages)
            for _ in messages:
                self._reports.warning(reason)

        return reject


def _handle_parts(split: Split, handle_batch: BatchHandler) -> BatchHandler:
    """Return the handler of messages whose parts another handler receives; the parts have no identities."""

    def handle_parts(
        messages: List[bytes],
        received: Sequence[int] = (),
        identities: Sequence[MessageIdentity] = (),
    ) -> None:
        split_messages = list(map(split, messages))
        # Each part was received with its message.
        part_receipts = [instant for parts, instant in zip(split_messages, received) for _ in parts]
        handle_batch([part for parts in split_messages for part in parts], part_receipts)

    return handle_parts


def _join(split: Split, convert: Convert) -> Convert:
    """Return a function from a message to the list of the results of its parts."""
    return lambda data: [result for result in map(convert, split(data)) if result is not None]


class SourceReader:
    """Receiver of the messages of one source; see `MessageReceiver`.

    Args:
        convert: returns the result of a message.
        receive: processes messages that were read together.
        monitor: detects lost messages.
        reads_transforms: whether messages are converted to transforms.
        error: the reason why all messages are dropped; "" if they are not.
    """

    def __init__(
        self,
        convert: Convert,
        receive: BatchHandler,
        monitor: LossMonitor,
        reads_transforms: bool = False,
        error: str = "",
    ):
        # Attributes rather than methods, because a call more per message is measurable.
        self.convert = convert
        self.receive = receive
        self.close = monitor.close
        self.record_lost = monitor.record_lost
        self.reads_transforms = reads_transforms
        self.error = error


class RequestQueue:
    """Queue of topics that goals request, executed by a thread as soon as topics can be subscribed.

    A thread is necessary because subscribing may wait for the middleware, which would block the engine. The length of
    the queue is bounded by `MAX_INPUT_TOPICS`.

    Args:
        on_shutdown: registers a function to call when the node ends.
    """

    def __init__(self, on_shutdown: Callable[[Callable[[], object]], object]) -> None:
        # None ends the thread.
        self._requests: SimpleQueue[Optional[TopicRequest]] = SimpleQueue()
        on_shutdown(lambda: self._requests.put(None))

    def put(self, request: TopicRequest) -> None:
        """Queue a request."""
        self._requests.put(request)

    def start(self, *executors: Callable[[TopicRequest], object]) -> None:
        """Execute the queued requests, and start the thread for later ones."""

        def execute_next(request: Optional[TopicRequest]) -> bool:
            if request is None:
                return False
            for executor in executors:
                executor(request)
            return True

        def run() -> None:
            while execute_next(self._requests.get()):
                pass

        # Requests of the program's loading are executed before this returns, as for the topics of `pub_sub.xml`.
        with suppress(Empty):
            while execute_next(self._requests.get_nowait()):
                pass
        threading.Thread(target=run, daemon=True, name="topics of goals").start()
