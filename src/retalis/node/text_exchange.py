"""Events and outputs as text, on two topics that every node can read and write.

``retalisInputEvents`` carries events to the program, ``retalisOutputEvents`` its outputs. They are part of the
interface of the original package, in which all messages passed between two nodes in this form.

`PlainTextExchange` exchanges texts on any transport; ROS 1 has an exchange that loses no text while a node restarts.
"""

from struct import Struct
from typing import Any, Callable, ContextManager, Iterable, List, Optional, Protocol

from ..engine.runtime.problem_reports import Reports
from ..foundation.errors import MessageError, RetalisError, UsageError
from ..messages.cdr_decoder import BYTE_ORDERS, MAX_PADDING_BYTES, not_plain_cdr
from ..messages.cdr_encoder import LITTLE_ENDIAN_CDR
from ..messages.decoder import Decoder
from ..messages.message_to_event_text import make_text_writer
from ..messages.type_definition import SerializationFormat
from ..prolog.syntax.event_text import event_text, to_text
from ..prolog.terms.types import Term, atom, functor
from .program_host_context import HostContext
from .topic_statistics import OutputStatus, describe_publication
from .transport import MessageSource, TopicPublication
from .transport_time import Receipts

INPUT = "retalisInputEvents"
OUTPUT = "retalisOutputEvents"
"""Topics of texts: events for the program, and its outputs."""

TEXT_TOPICS = (INPUT, OUTPUT)

WATCH = "retalis_watch_"
"""Beginning of the names of topics whose outputs exist only as text, for ``retalis watch``."""

OUTPUT_EVENT = functor("event", 3)
"""Functor of an output as text: term, topic, and id of the subscription."""

TEXT_TYPE = "std_msgs/String"

EventSender = Callable[[bytes, Optional[int]], None]
"""Sends a serialized message as text, with the stamp of its event in ns, or None."""

TextHandlerFactory = Callable[[Decoder, str, MessageSource], Callable[[bytes], Any]]
"""Returns the handler of a source's messages of texts."""

SubscribeTexts = Callable[[str, TextHandlerFactory], ContextManager[object]]
"""Subscribes to a topic of texts with the handler of each source; see `SubscribedTopics.subscribe_texts`."""

_UINT32 = Struct("<I")


class TextExchange(Protocol):
    """Exchange of events and outputs as text with other nodes."""

    def make_event_sender(self, decoder: Decoder) -> Optional[EventSender]:
        """Return the function that sends messages of a type as text to others; None if it is never needed."""

    def send_output(self, term: Term, topic: str, name: Term) -> None:
        """Send an output with the id of its subscription, if anybody needs the text."""

    def is_output_received(self) -> bool:
        """Return whether the node that publishes the outputs, if it is another one, is connected."""

    def receive_outputs(self, subscribe: SubscribeTexts, publish: Callable[[str], object]) -> None:
        """Start to pass on the outputs that other nodes send."""

    def receive_events(
        self, subscribe: SubscribeTexts, post: Callable[[str], object]
    ) -> List[ContextManager[object]]:
        """Start to pass on the events that other nodes send; return the locks under which this happens."""

    def statuses(self) -> List[OutputStatus]:
        """Return the counters of the published topics."""


def resolve_subscribable_topic(
    topic: str, resolve_topic: Callable[[str], str], reserved: Iterable[str] = TEXT_TOPICS
) -> str:
    """Return the full name of a topic that a program may subscribe to.

    Raises:
        UsageError: if the name is invalid, or the topic is reserved.
    """
    name = resolve_topic(topic)
    if name in map(resolve_topic, reserved):
        raise UsageError(f"topic {topic} is for events as text, between the nodes")
    return name


def make_event_sender(
    decoder: Decoder,
    publication: TopicPublication,
    stamp: Callable[[], int],
    reports: Reports,
    serialize: Callable[[str], bytes],
) -> EventSender:
    """Return the function that sends messages of a type as text. Without a subscriber it does nothing.

    Args:
        decoder: decoder of the messages.
        publication: topic of the texts.
        stamp: returns the instant of an event without one, in ns.
        reports: receives the errors of single messages.
        serialize: returns the message of a text; see `text_serializer`.
    """
    # Without the clock skew check, which is done.
    write = make_text_writer(decoder.plain or decoder)
    count_subscribers = publication.subscriber_count

    def send(data: bytes, instant: Optional[int]) -> None:
        if not count_subscribers():
            return
        try:
            text = event_text(write(data), stamp() if instant is None else instant)
        except RetalisError as error:
            # The event itself is processed.
            reports.error(error, INPUT)
            return
        publication.send(serialize(text))

    return send


def format_output(term: Term, topic: str, name: Term) -> str:
    """Return an output with the id of its subscription as text."""
    return to_text((OUTPUT_EVENT, term, atom(topic), name))


def text_serializer(serialization_format: SerializationFormat) -> Callable[[str], bytes]:
    """Return the function from a text to a serialized ``std_msgs/String``."""
    return serialize_text if serialization_format is SerializationFormat.ROS1 else _serialize_cdr_text


def serialize_text(text: str) -> bytes:
    """Return a text as a serialized ``std_msgs/String`` of ROS 1."""
    data = text.encode("utf-8", "surrogateescape")
    return _UINT32.pack(len(data)) + data


def _serialize_cdr_text(text: str) -> bytes:
    data = text.encode("utf-8", "surrogateescape")
    return LITTLE_ENDIAN_CDR + _UINT32.pack(len(data) + 1) + data + b"\0"


def text_reader(serialization_format: SerializationFormat) -> Callable[[bytes], str]:
    """Return the function from a serialized ``std_msgs/String`` to its text; see `read_text_message`."""
    return read_text_message if serialization_format is SerializationFormat.ROS1 else _read_cdr_text


def read_text_message(data: bytes) -> str:
    """Return the text of a serialized ``std_msgs/String`` of ROS 1.

    Raises:
        MessageError: if the bytes are another message.
    """
    if len(data) < 4 or _UINT32.unpack_from(data)[0] != len(data) - 4:
        raise MessageError("expected a std_msgs/String, found other bytes")
    return str(data[4:], "utf-8", "replace")


def _read_cdr_text(data: bytes) -> str:
    byte_order = BYTE_ORDERS.get(data[:2])
    if byte_order is None or len(data) < 8:
        raise MessageError(not_plain_cdr(TEXT_TYPE, data))
    end = 8 + Struct(byte_order + "I").unpack_from(data, 4)[0]
    if not 0 <= len(data) - end <= MAX_PADDING_BYTES:
        raise MessageError("expected a std_msgs/String, found other bytes")
    return str(data[8:end].rstrip(b"\0"), "utf-8", "replace")


class PlainTextExchange:
    """Exchange with the means that every transport has: texts reach the nodes that are connected.

    Args:
        context: what the parts of the host share.
    """

    def __init__(self, context: HostContext):
        transport = context.transport
        definition = context.definitions.find(TEXT_TYPE)
        self._reports = context.reports
        self._serialize = text_serializer(transport.format)
        self._stamp = Receipts(context.time.now).stamp
        self._topics = {
            name: transport.advertise(transport.resolve_topic(name), definition, context.parameters.queue)
            for name in TEXT_TOPICS
        }
        self._names = {name: transport.resolve_topic(name) for name in self._topics}

    def make_event_sender(self, decoder: Decoder) -> Optional[EventSender]:
        """See `TextExchange`."""
        return make_event_sender(decoder, self._topics[INPUT], self._stamp, self._reports, self._serialize)

    def send_output(self, term: Term, topic: str, name: Term) -> None:
        """See `TextExchange`."""
        publication = self._topics[OUTPUT]
        if publication.subscriber_count():
            publication.send(self._serialize(format_output(term, topic, name)))

    def is_output_received(self) -> bool:
        """See `TextExchange`: outputs are published by this node."""
        return True

    def receive_outputs(self, subscribe: SubscribeTexts, publish: Callable[[str], object]) -> None:
        """See `TextExchange`."""
        subscribe(OUTPUT, _make_handler_factory(publish))

    def receive_events(
        self, subscribe: SubscribeTexts, post: Callable[[str], object]
    ) -> List[ContextManager[object]]:
        """See `TextExchange`."""
        return [subscribe(INPUT, _make_handler_factory(post))]

    def statuses(self) -> List[OutputStatus]:
        """See `TextExchange`."""
        return [
            describe_publication(self._names[name], TEXT_TYPE, publication)
            for name, publication in self._topics.items()
        ]


def _make_handler_factory(receive: Callable[[str], object]) -> TextHandlerFactory:
    """Return the factory of handlers that pass on the texts of messages."""

    def make_handler(decoder: Decoder, topic: str, source: MessageSource) -> Callable[[bytes], object]:
        read = text_reader(decoder.format)
        return lambda data: receive(read(data))

    return make_handler
