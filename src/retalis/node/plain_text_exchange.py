"""Exchange of texts with the means that every transport has."""

from typing import Callable, ContextManager, List, Optional

from ..messages.decoder import Decoder
from ..prolog.terms.types import Term
from .host_context import HostContext
from .text_exchange import (
    INPUT,
    OUTPUT,
    TEXT_TOPICS,
    TEXT_TYPE,
    EventSender,
    SubscribeTexts,
    TextHandlerFactory,
    format_output,
    make_event_sender,
    text_reader,
    text_serializer,
)
from .topic_statistics import OutputStatus, describe_publication
from .transport import MessageSource
from .transport_time import Receipts


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
