"""A program with its engine and its topics, in a node or over a bag.

`RunningProgram` connects the engine of a program with a `MessageTransport`: messages of subscribed topics become
events, outputs become messages, topics that goals request are subscribed, and transforms are read if the program uses
them. Nodes and playback contain one, so that the same messages have the same results. It is used in this order:

1. The constructor and `accept_requests`, before the program is loaded, because its goals emit outputs and request
   topics.
2. `open_topics` and `start_transforms`, from which on messages arrive.
3. `log_mistakes`, when the program is loaded and the types of its topics are known.
"""

import logging
from pathlib import Path
from typing import Callable, Iterable, List, NamedTuple, Optional, Tuple

from ..engine.engine import Engine
from ..engine.event_input import TopicRequest
from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import (
    DEFAULT_DIRECT_TOPICS,
    DirectTopics,
    Topics,
    TopicType,
    direct_topics,
    quality_of,
)
from ..foundation.errors import RetalisError
from ..messages.decoder import Decoder
from ..messages.type_registry import Definitions
from ..prolog.terms.types import Term
from .published_topics import (
    TEXT_ONLY,
    OutputReceiver,
    PublishedTopics,
    ReportUnpublished,
    UntypedTopicWarnings,
    advertise_topics,
)
from .subscribed_topics import MessageProcessing, ReadingOptions, SubscribedTopics
from .transport import MessageSource, MessageTransport

log = logging.getLogger("retalis")


class ProgramContext(NamedTuple):
    """Transport and topics of a program, and what its parts share.

    Attributes:
        transport: the middleware, or a bag.
        definitions: known message types, to which those of publishers are added.
        reports: receives errors and warnings of single events and messages.
        direct: value of ``~direct``.
    """

    transport: MessageTransport
    definitions: Definitions
    reports: Reports
    topics: Topics
    direct: DirectTopics


class OutputCallbacks(NamedTuple):
    """Functions that a running program calls with its outputs in the engine's turn, and a text for warnings.

    Attributes:
        receive: receives each output.
        report_unpublished: reports an output that is not published as message; by default as a node does.
        untyped_consequence: what happens to outputs of a topic without a type, for warnings.
    """

    receive: OutputReceiver
    report_unpublished: Optional[ReportUnpublished] = None
    untyped_consequence: str = TEXT_ONLY


class RunningProgram:
    """A program with its engine and its topics.

    Args:
        context: transport and topics.
        engine: its engine, new or restored.
        processing: how messages become events; the engine receives the events.
        options: how topics are read.
        callbacks: receivers of outputs.

    Attributes:
        engine: see above.
        direct: topics that are subscribed in addition to those of the program.
        untyped_topics: warns about outputs without a type.
    """

    def __init__(
        self,
        context: ProgramContext,
        engine: Engine,
        processing: MessageProcessing,
        options: ReadingOptions,
        callbacks: OutputCallbacks,
    ):
        transport, definitions, reports, topics, _ = context
        self._context = context
        self.engine = engine
        self.direct = direct_topics(context.direct, topics, transport.resolve_topic)
        self.published = PublishedTopics(
            transport, definitions, options.queue_size, reports, callbacks.report_unpublished
        )
        self.subscribed = SubscribedTopics(
            transport,
            definitions,
            reports,
            processing._replace(consume_results=engine.post_each, consume_identified=engine.post_identified),
            options._replace(
                quality_of=lambda topic: quality_of(topics.subscribed_quality, topic, transport.resolve_topic)
            ),
            self.use_learned_types,
        )
        self.untyped_topics = UntypedTopicWarnings(
            transport, (topic for topic, _ in topics.published), reports, callbacks.untyped_consequence
        )
        engine.on_output(callbacks.receive)

    def accept_requests(self, subscribe: Callable[[TopicRequest], object]) -> None:
        """Call a function for each topic that goals request; at once for those that a restored engine contains.

        Args:
            subscribe: called in the engine's turn; it must not wait for the engine.
        """
        topics = self._context.topics
        self.engine.on_topic_request(subscribe, topics, self.direct, self.subscribed.resolve)

    def open_topics(self, may_learn_types: bool = False) -> None:
        """Advertise and subscribe to the topics of ``pub_sub.xml``, except those of ``~direct``. Errors are logged.

        Args:
            may_learn_types: whether publishers may define further types, also if the types of all subscribed topics
                are known.
        """
        open_topics(self.published, self.subscribed, self._context.topics, self.direct, may_learn_types)

    def subscribe_direct_topics(self) -> None:
        """Subscribe to the topics of ``~direct``. Errors are logged."""
        resolve_topic = self._context.transport.resolve_topic
        for direct_topic in self.direct:
            topic, message_type = direct_topic
            event = self._context.topics.event_name_of(topic, resolve_topic)
            request = TopicRequest(topic, message_type, event)
            # Many robots have neither of the default topics, and rclpy cannot subscribe to types that are missing.
            is_default = direct_topic in DEFAULT_DIRECT_TOPICS
            self.subscribed.try_to_subscribe(
                request, "parameter ~direct", logging.INFO if is_default else logging.ERROR
            )

    def use_learned_types(self) -> None:
        """Advertise topics whose types have become known, and warn about constants of types that came too late."""
        self.published.advertise_learned_types()
        for message_type in self.engine.pop_late_types():
            log.warning(
                "the definition of %s came after the program was loaded: its constants have no values until the "
                "program is loaded again; call ~reload, or install the package",
                message_type,
            )

    def start_transforms(self, start_feed: Callable[[], object]) -> None:
        """Call a function once, as soon as the program reads transforms; it calls `subscribe_transforms`."""
        self.require_transforms()
        self.engine.program.knowledge.transforms.add_feed(start_feed)

    def require_transforms(self) -> None:
        """Read transforms if the rules use them."""
        program = self.engine.program
        program.knowledge.transforms.require_if_mentioned(program.rules.terms())

    def subscribe_transforms(self) -> None:
        """Subscribe to the topics of transforms."""
        self.subscribed.subscribe_transforms(self.engine.post_transforms)

    def log_mistakes(
        self,
        program: Path,
        definitions: Definitions,
        topics: Optional[Topics] = None,
        find_refusal: Callable[[str], str] = lambda name: "",
    ) -> List[RetalisError]:
        """Log probable mistakes in the loaded program, and return them.

        Args:
            program: folder of the program.
            definitions: message types for the checks.
            topics: topics of the program, if they have changed.
            find_refusal: returns the reason why goals may not call a service, or "".
        """
        # These warnings cover outputs without a type.
        self.untyped_topics.mark_reported(self.engine.output_topics())
        topics = self._context.topics if topics is None else topics
        direct = direct_topics(self._context.direct, topics, self._context.transport.resolve_topic)
        warnings = list(self.engine.warnings(program, definitions, topics, direct, find_refusal))
        for warning in warnings:
            log.warning("%s", warning)
        return warnings


def open_topics(
    published: PublishedTopics,
    subscribed: SubscribedTopics,
    topics: Topics,
    direct: Iterable[TopicType],
    may_learn_types: bool = False,
) -> None:
    """Advertise and subscribe to the topics of ``pub_sub.xml``, except those of ``direct``. Errors are logged.

    Args:
        published: publishes the topics.
        subscribed: subscribes to the topics.
        topics: contents of the file.
        direct: topics that are subscribed separately.
        may_learn_types: see `RunningProgram.open_topics`.
    """
    direct = tuple(direct)
    may_be_learned = may_learn_types or any(
        not subscribed.knows_type(message_type) for _, message_type in (*topics.subscribed, *direct)
    )
    advertise_topics(published, topics, may_be_learned)
    subscribed.subscribe_all(topics, direct)


def make_event_handler(
    decoder: Decoder, topic: str, source: MessageSource
) -> Callable[[bytes], Tuple[Term, Optional[int]]]:
    """Return a function from a message to its event and the event's instant; see `HandlerFactory`."""
    decode, stamp = decoder.decode, decoder.stamp
    return lambda data: (decode(data), stamp(data))
