"""Exchange of texts with the means that every transport has."""

from typing import Callable, ContextManager, List, Optional

from ..messages.decoder import Decoder
from ..prolog.terms.types import Term
from .host_context import HostContext
from .host_time import Receipts
from .text_exchange import (
    INPUT,
    OUTPUT,
    TEXT_TOPICS,
    TEXT_TYPE,
    EventSender,
    SubscribeTexts,
    format_output,
    make_event_sender,
    read_text_message,
    serialize_text,
)
from .topic_statistics import OutputStatus, describe_publication


class PlainTextExchange:
    """Exchange with the means that every transport has: texts reach the nodes that are connected.

    Args:
        context: what the parts of the host share.
    """

    def __init__(self, context: HostContext):
        transport = context.transport
        definition = context.definitions.find(TEXT_TYPE)
        self._reports = context.reports
        self._stamp = Receipts(context.time.now).stamp
        self._topics = {
            name: transport.advertise(transport.resolve_topic(name), definition, context.parameters.queue)
            for name in TEXT_TOPICS
        }
        self._names = {name: transport.resolve_topic(name) for name in self._topics}

    def make_event_sender(self, decoder: Decoder) -> Optional[EventSender]:
        """See `TextExchange`."""
        return make_event_sender(decoder, self._topics[INPUT], self._stamp, self._reports)

    def send_output(self, term: Term, topic: str, name: Term) -> None:
        """See `TextExchange`."""
        publication = self._topics[OUTPUT]
        if publication.subscriber_count():
            publication.send(serialize_text(format_output(term, topic, name)))

    def is_output_received(self) -> bool:
        """See `TextExchange`: outputs are published by this node."""
        return True

    def receive_outputs(self, subscribe: SubscribeTexts, publish: Callable[[str], object]) -> None:
        """See `TextExchange`."""
        subscribe(OUTPUT, lambda decoder, topic, source: lambda data: publish(read_text_message(data)))

    def receive_events(
        self, subscribe: SubscribeTexts, post: Callable[[str], object]
    ) -> List[ContextManager[object]]:
        """See `TextExchange`."""
        return [subscribe(INPUT, lambda decoder, topic, source: lambda data: post(read_text_message(data)))]

    def statuses(self) -> List[OutputStatus]:
        """See `TextExchange`."""
        return [
            describe_publication(self._names[name], TEXT_TYPE, publication)
            for name, publication in self._topics.items()
        ]
