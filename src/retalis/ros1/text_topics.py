"""Events as text on the ``std_msgs/String`` topics between node ``retalis`` and the interface node.

`EventTextPublisher` sends events to node ``retalis``, `OutputTextPublisher` sends outputs to the interface. Both
deliver through a `LatePeerBuffer`. Some texts are *marks*, control texts for the receiver: one announces the clock
epoch of the texts after it, another describes the latched message after it. A mark has the syntax of an event, so
that other subscribers can read the stream.

`RospyTextExchange` combines them in node ``retalis``. If that node reads the messages itself, no other node needs the
texts of events, and they are sent to whoever subscribes.
"""

import threading
from functools import partial
from struct import Struct
from typing import Any, Callable, ContextManager, Iterable, List, Optional, Tuple

from std_msgs.msg import String

from ..engine.runtime.clock_epochs import ClockEpochs
from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import Topics
from ..foundation.bounded_caches import Cache
from ..foundation.errors import UsageError
from ..messages.decoder import Decoder
from ..messages.type_registry import Definitions
from ..node.latched_deduplication import (
    LATCHED_MARK_PREFIX,
    LatchedMessage,
    LatchedMessageDeduplicator,
    parse_latched_mark,
)
from ..node.program_host_context import HostContext
from ..node.subscribed_topics import HandlerFactory
from ..node.text_exchange import (
    INPUT,
    OUTPUT,
    TEXT_TYPE,
    EventSender,
    SubscribeTexts,
    format_output,
    make_event_sender,
    read_text_message,
    serialize_text,
)
from ..node.topic_statistics import OutputStatus, describe_publication
from ..node.transport_time import Receipts
from ..prolog.terms.types import Term
from .connection_writer import TopicWriter
from .internode_delivery import ENGINE, INTERFACE, LatePeerBuffer, Publishers, SubscriberIdentifier
from .rospy_transport import resolve

MAX_TEXTS_PER_WRITE = 64
"""Limit for the texts that one write combines."""

NO_TEXT_HINT = "direct:=auto or embedded:=true passes no text between the nodes, and is faster"
"""Advice for avoiding delays and losses of messages as text, at the end of a warning."""

_UINT32 = Struct("<I")


def serialize_string(text: str) -> bytes:
    """Return a text as a ``std_msgs/String`` message, framed as on the wire."""
    message = serialize_text(text)
    return _UINT32.pack(len(message)) + message


class EventTextPublisher:
    """Publisher of events as text for node retalis, several texts per write. Not thread-safe.

    Args:
        topic: name of the topic.
        queue_size: number of texts to buffer.
        reports: receives a warning for every dropped text.
        epoch: returns the current clock epoch; see `LatePeerBuffer`.
        clock_epochs: the epochs of a simulated clock, which are announced to the receivers; None for wall time.
    """

    def __init__(
        self,
        topic: str,
        queue_size: int,
        reports: Reports,
        epoch: Callable[[], int],
        clock_epochs: Optional[ClockEpochs] = None,
    ):
        self._clock_epochs = clock_epochs
        self._subscriber_identifier = SubscriberIdentifier()
        self._topic_writer = TopicWriter(
            topic,
            String,
            queue_size,
            reports,
            self._must_wait_for,
            listener=self._subscriber_identifier,
            wait_hint=NO_TEXT_HINT,
        )
        self._peer_buffer = LatePeerBuffer(
            self._topic_writer, ENGINE, queue_size, reports, epoch, self._serialize_epoch_mark
        )
        self._pending_messages: List[bytes] = []

    def start_identification(self, processing_lock: ContextManager[object], publishers: Publishers) -> None:
        """Start to identify subscribers.

        Args:
            processing_lock: lock that the caller holds in all other methods.
            publishers: returns topic and publisher of all connections that deliver messages.
        """
        self._subscriber_identifier.start(self._peer_buffer, processing_lock, publishers)

    def _serialize_epoch_mark(self) -> bytes:
        """Return the mark of the current epoch as a serialized message; empty for wall time."""
        return (
            b""
            if self._clock_epochs is None
            else serialize_string(format_epoch_mark(self._clock_epochs.epoch))
        )

    def begin_epoch(self, previous_end: int) -> None:
        """Announce a new epoch of simulated time, after all texts of the former one.

        Args:
            previous_end: end of the former epoch in ns; unused, but passed to each callback of `ClockEpochs`.
        """
        self.flush()
        self._peer_buffer.send(self._serialize_epoch_mark(), 1)

    def _must_wait_for(self, connection: Any) -> bool:
        """Return whether the publisher blocks until this subscriber accepts a message.

        It does not block for third parties, which may be slow.
        """
        return not self._peer_buffer.is_third_party(connection)

    def add(self, text: str) -> None:
        """Add a text to the next write."""
        self._pending_messages.append(serialize_string(text))
        if len(self._pending_messages) >= MAX_TEXTS_PER_WRITE:
            self.flush()

    def connections(self) -> Any:
        """Return the connections to the receivers."""
        return self._topic_writer.connections()

    def status(self) -> OutputStatus:
        """Return the counters of the topic."""
        return self._topic_writer.status("std_msgs/String")

    def add_latched(
        self,
        text: str,
        message: LatchedMessage,
        publisher: Tuple[str, str],
        current_text: Callable[[], str],
        size: int,
    ) -> None:
        """Send the text of a latched message, and store it for instances of node retalis that connect later.

        Args:
            text: text to send now.
            message: description of the message, by which node retalis recognizes a repetition.
            publisher: topic and publisher of the message; the newest message of each is stored.
            current_text: returns the text for a node that connects later.
            size: size of the stored message in bytes.
        """
        self.flush()
        # A node whose connection has only dropped and returned has processed the message already.
        # ``may_be_repetition`` makes that node compare the message with the last one that it has processed.
        repeated_mark = serialize_string(message._replace(may_be_repetition=True).to_mark())
        self._peer_buffer.latch(publisher, lambda: repeated_mark + serialize_string(current_text()), size)
        self._peer_buffer.send(serialize_string(text), 1, serialize_string(message.to_mark()))

    def flush(self) -> None:
        """Write the added texts."""
        messages = self._pending_messages
        if messages:
            self._peer_buffer.send(b"".join(messages), len(messages))
            messages.clear()


class OutputTextPublisher:
    """Publisher of outputs as text for the interface node and all other subscribers. Thread-safe.

    An output to a topic that the interface publishes is buffered until the interface has connected. The last output
    to a latched topic is sent again to an interface that is restarted.

    Args:
        queue_size: number of texts to buffer.
        reports: receives a warning for every dropped text.
        published: topics that the interface publishes.
        latched: latched topics among ``published``.
    """

    def __init__(
        self, topic: str, queue_size: int, reports: Reports, published: Iterable[str], latched: Iterable[str]
    ):
        self._published = frozenset(map(_resolve_if_valid, published))
        self._latched = frozenset(map(_resolve_if_valid, latched))
        self._full_names: Cache[str, str] = Cache(1000, 1 << 20)
        """Full names of topics by their names in programs."""
        self._subscriber_identifier = SubscriberIdentifier()
        self._topic_writer = TopicWriter(
            topic, String, queue_size, reports, listener=self._subscriber_identifier
        )
        self._peer_buffer = LatePeerBuffer(self._topic_writer, INTERFACE, queue_size, reports)
        self._processing_lock = threading.Lock()
        self._subscriber_identifier.start(self._peer_buffer, self._processing_lock)

    def send(self, topic: str, format_text: Callable[[], str]) -> None:
        """Send or buffer an output to a topic; ``format_text`` is called only if the text is needed."""
        name = self._full_names.get(topic) or self._full_names.store(
            topic, _resolve_if_valid(topic), 2 * len(topic)
        )
        is_published = name in self._published
        # Topics such as those of `retalis watch` exist only as text: without a subscriber nothing is written.
        if not is_published and not self.connections():
            return
        data = serialize_string(format_text())
        with self._processing_lock:
            if name in self._latched:
                self._peer_buffer.latch(name, lambda: data, len(data))
            self._peer_buffer.send(data, 1, for_peer=is_published)

    def connections(self) -> Any:
        """Return the connections to the subscribers."""
        return self._topic_writer.connections()

    def status(self) -> OutputStatus:
        """Return the counters of the topic."""
        return self._topic_writer.status("std_msgs/String")


class RospyTextExchange:
    """Exchange of node ``retalis`` with the interface node and all others; see `TextExchange`.

    Args:
        context: what the parts of the host share.
    """

    def __init__(self, context: HostContext):
        topics, parameters, reports = context.topics, context.parameters, context.reports
        self._time = context.time
        self._latched = context.latched
        self._uses_texts = parameters.uses_texts
        self._reports = reports
        self._stamp = Receipts(context.time.now).stamp
        # If this node reads and publishes the messages, no other node requires texts.
        self._events = None
        if not self._uses_texts:
            topics = Topics()
            self._events = context.transport.advertise(
                resolve(INPUT), Definitions().find(TEXT_TYPE), parameters.queue
            )
        self._outputs = OutputTextPublisher(
            OUTPUT, parameters.queue, reports, [topic for topic, _ in topics.published], topics.latched
        )

    def make_event_sender(self, decoder: Decoder) -> Optional[EventSender]:
        """See `TextExchange`."""
        if self._events is None:
            return None
        return make_event_sender(decoder, self._events, self._stamp, self._reports, serialize_text)

    def send_output(self, term: Term, topic: str, name: Term) -> None:
        """See `TextExchange`."""
        self._outputs.send(topic, lambda: format_output(term, topic, name))

    def is_output_received(self) -> bool:
        """See `TextExchange`."""
        return not self._uses_texts or bool(self._outputs.connections())

    def receive_outputs(self, subscribe: SubscribeTexts, publish: Callable[[str], object]) -> None:
        """See `TextExchange`."""
        subscribe(OUTPUT, make_text_handler_factory(publish))

    def receive_events(
        self, subscribe: SubscribeTexts, post: Callable[[str], object]
    ) -> List[ContextManager[object]]:
        """See `TextExchange`."""
        return [subscribe(INPUT, make_text_handler_factory(post, self._time.epochs, self._latched))]

    def statuses(self) -> List[OutputStatus]:
        """See `TextExchange`."""
        events = (
            [] if self._events is None else [describe_publication(resolve(INPUT), TEXT_TYPE, self._events)]
        )
        return [self._outputs.status(), *events]


def _resolve_if_valid(topic: str) -> str:
    """Return the full name of a topic; an invalid name is returned unchanged, as its outputs are only text."""
    try:
        return resolve(topic)
    except UsageError:
        return topic


EPOCH_MARK_PREFIX = "event(retalis_run("
"""Prefix of the mark that announces the clock epoch of the texts after it."""

_MARK_END = "))"


def format_epoch_mark(epoch: int) -> str:
    """Return the mark that announces texts of an epoch."""
    return f"{EPOCH_MARK_PREFIX}{epoch}{_MARK_END}"


def _parse_epoch_mark(text: str) -> Optional[int]:
    """Return the epoch that a mark announces; None if the text is an event."""
    number = text[len(EPOCH_MARK_PREFIX) : -len(_MARK_END)]
    is_mark = len(number) < 10 and number.isascii() and number.isdigit() and text.endswith(_MARK_END)
    return int(number) if is_mark else None


_MARK_PREFIX = "event(retalis_"


def make_text_handler_factory(
    handler: Callable[[str], object],
    epochs: Optional[ClockEpochs] = None,
    latched: Optional[LatchedMessageDeduplicator] = None,
) -> HandlerFactory:
    """Return a factory of message handlers that pass the texts of ``std_msgs/String`` messages to ``handler``.

    Args:
        handler: handler of a text.
        epochs: clock epochs, which buffer texts of an epoch that has not begun. None if marks are not expected.
        latched: recognizes texts of latched messages that ``handler`` has received already.
    """
    return lambda decoder, topic, source: _TextReceiver(handler, epochs, latched).receive


class _TextReceiver:
    """Receiver of the texts of one connection; see `make_text_handler_factory`."""

    def __init__(
        self,
        handler: Callable[[str], object],
        epochs: Optional[ClockEpochs],
        latched: Optional[LatchedMessageDeduplicator],
    ):
        self._handler = handler
        self._epochs = epochs
        self._latched = latched
        self._latched_message: Optional[LatchedMessage] = None
        """Latched message that the next text contains."""

    def receive(self, data: bytes) -> None:
        text = read_text_message(data)
        # The prefix is tested first, because nearly all texts are events.
        if text.startswith(_MARK_PREFIX) and self._apply_mark(text):
            return
        epochs, latched_message = self._epochs, self._latched_message
        if latched_message is not None:
            self._latched_message = None
        if epochs is not None and epochs.is_buffering and epochs.must_buffer_texts(self):
            # The text of a latched message is compared when it is processed: the next epoch may have begun by then.
            epochs.buffer(
                self._handle_texts
                if latched_message is None
                else partial(self._handle_latched, latched_message),
                [text],
            )
        elif latched_message is None:
            self._handler(text)
        else:
            self._handle_latched(latched_message, [text])

    def _apply_mark(self, text: str) -> bool:
        """Apply a mark; return False if the text is an event."""
        epoch = _parse_epoch_mark(text) if text.startswith(EPOCH_MARK_PREFIX) else None
        if epoch is not None and self._epochs is not None:
            self._epochs.report_epoch(self, epoch)
            return True
        message = parse_latched_mark(text) if text.startswith(LATCHED_MARK_PREFIX) else None
        if message is not None:
            self._latched_message = message
        return message is not None

    def _handle_texts(self, texts: List[str]) -> None:
        for text in texts:
            self._handler(text)

    def _handle_latched(self, latched_message: LatchedMessage, texts: List[str]) -> None:
        if self._latched is None or not self._latched.record_message(latched_message):
            self._handle_texts(texts)
