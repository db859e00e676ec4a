"""Published topics of a program: outputs as messages."""

import logging
import threading
from collections import deque
from typing import Any, Callable, Deque, Dict, Iterable, List, NamedTuple, Optional, Set

from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import (
    ANY_QUALITY,
    TOPICS,
    QualityOfService,
    Topics,
    quality_of,
)
from ..foundation.bounded_caches import Cache
from ..foundation.displayed_text import printable, shorten
from ..foundation.errors import MessageError, RetalisError, UsageError
from ..foundation.ros_name_checks import topic_fault
from ..messages.encoder import Encoder
from ..messages.type_definition import PLAIN_STRINGS
from ..messages.type_registry import Definitions
from ..prolog.syntax.event_text import EventReader, to_text
from ..prolog.terms.types import Term, deref
from .text_exchange import OUTPUT, OUTPUT_EVENT, WATCH
from .topic_statistics import OutputStatus, describe_publication
from .transport import MessageTransport, TopicPublication

log = logging.getLogger("retalis")

TEXT_ONLY = f"its events are published only as text on {OUTPUT}"
"""Consequence for the outputs of a topic without a type in a node."""

MAX_UNTYPED_TOPICS_NAMED = 100
"""Maximum number of topics without a type that are logged."""

OutputReceiver = Callable[[Term, str, Term], object]
"""Publishes an output: term, topic and id of the subscription."""

ReportUnpublished = Callable[[str, Optional[str]], object]
"""Reports an output that is not published as message: its topic, and the topic's type, which is unknown; None if the
topic has no type."""


class OutputRelay:
    """Callback of the engine that passes outputs on, and stores them until there are receivers.

    Goals of a program emit events while it is loaded, before its topics are advertised.

    Args:
        max_stored: number of outputs to store; beyond it the oldest are dropped.
        reports: receives a warning for dropped outputs.
    """

    def __init__(self, max_stored: int, reports: Reports):
        self._max_stored = max_stored
        self._reports = reports
        self._stored: Optional[Deque[Any]] = deque()
        self._receivers: List[OutputReceiver] = []

    def __call__(self, term: Term, topic: str, name: Term) -> None:
        """Pass an output on, or store it."""
        if self._stored is None:
            for receive in self._receivers:
                receive(term, topic, name)
            return
        if len(self._stored) >= self._max_stored:
            self._stored.popleft()
            self._reports.warning(
                f"an output is dropped: the program emits more than {self._max_stored} while it is loaded"
            )
        self._stored.append((term, topic, name))

    def start(self, *receivers: OutputReceiver) -> None:
        """Pass the stored outputs on, and all later ones at once; called in the engine's turn."""
        self._receivers.extend(receivers)
        stored, self._stored = self._stored or (), None
        for output in stored:
            self(*output)


class _TypedTopic(NamedTuple):
    """An advertised topic, and the encoder of terms to messages of its type."""

    publication: TopicPublication
    encoder: Encoder


class _UnadvertisedTopic(NamedTuple):
    """A topic with an unknown type, and how it will be advertised."""

    message_type: str
    latched: bool
    quality: QualityOfService


class PublishedTopics:
    """The output topics of a program.

    A topic whose type is not installed is advertised as soon as a publisher of an input topic has defined the type;
    see `advertise_learned_types`.

    Args:
        transport: the middleware.
        definitions: known message types.
        queue: number of messages to queue for each subscriber.
        reports: receives the errors of single messages.
        report_unpublished: reports outputs that exist only as text; by default as a node does.
    """

    def __init__(
        self,
        transport: MessageTransport,
        definitions: Definitions,
        queue: int,
        reports: Reports,
        report_unpublished: Optional[ReportUnpublished] = None,
    ):
        self._transport = transport
        self._definitions = definitions
        self._queue = queue
        self._reports = reports
        self._lock = threading.Lock()
        self._typed: Dict[str, _TypedTopic] = {}
        self._unadvertised: Dict[str, _UnadvertisedTopic] = {}
        """Topics that are advertised when their types become known."""
        self._report_unpublished = report_unpublished or TextOnlyOutputs(reports).report
        self._text_reader = EventReader(has_plain_strings=definitions.strings == PLAIN_STRINGS)

    def advertise(
        self,
        topic: str,
        message_type: str,
        latched: bool = False,
        quality: QualityOfService = ANY_QUALITY,
    ) -> None:
        """Advertise a topic with a message type.

        Args:
            topic: name of the topic.
            message_type: message type; if it is unknown, the topic is advertised when the type becomes known.
            latched: whether each new subscriber receives the last message.
            quality: what the program demands of the quality of service.

        Raises:
            MessageError: if the type is unknown yet, or invalid.
            UsageError: if the topic's name is invalid, or the topic has another type already.
        """
        name = self._transport.resolve_topic(topic)
        with self._lock:
            known_type = self._type_of(name)
            if known_type is not None:
                if known_type != message_type:
                    raise UsageError(f"topic {topic} already has the type {known_type}")
                return
            try:
                self._advertise(name, message_type, latched, quality)
            except MessageError:
                self._unadvertised[name] = _UnadvertisedTopic(message_type, latched, quality)
                raise

    def statuses(self) -> List[OutputStatus]:
        """Return the counters of each topic."""
        return [
            describe_publication(name, topic.encoder.definition.name, topic.publication)
            for name, topic in list(self._typed.items())
        ]

    def _type_of(self, name: str) -> Optional[str]:
        """Return the type of a topic; None if it has none."""
        if name in self._typed:
            return self._typed[name].encoder.definition.name
        return self._unadvertised[name].message_type if name in self._unadvertised else None

    def _advertise(self, name: str, message_type: str, latched: bool, quality: QualityOfService) -> None:
        definition = self._definitions.find(message_type)
        publication = self._transport.advertise(name, definition, self._queue, latched, quality)
        self._typed[name] = _TypedTopic(
            publication, self._definitions.encoder(definition, self._transport.format)
        )

    def may_be_defined_later(self, message_type: str) -> bool:
        """Return whether a publisher may define an unknown type; not if its installed package does not have it."""
        return not self._definitions.is_missing_in_package(message_type)

    def advertise_learned_types(self) -> None:
        """Advertise the topics whose types have become known through a new connection to a publisher."""
        # Called for each new connection, in nearly all programs without a topic that waits for its type.
        if not self._unadvertised:
            return
        with self._lock:
            for name, (message_type, latched, quality) in list(self._unadvertised.items()):
                if message_type in self._definitions:
                    self._advertise(name, message_type, latched, quality)
                    del self._unadvertised[name]
                    log.info(
                        "topic %s is published: its type %s was learned from a publisher", name, message_type
                    )

    def publish(self, term: Term, topic: str) -> None:
        """Publish a term as a message; a term that does not fit the topic's type is reported and not published.

        Outputs to a topic without a type exist only as text. A topic with an invalid name has none; the checks of a
        program report the subscriptions to it.
        """
        try:
            name = self._transport.resolve_topic(topic)
        except UsageError:
            self._report_unpublished(topic, None)
            return
        try:
            typed_topic = self._typed.get(name)
            if typed_topic is None:
                unadvertised = self._unadvertised.get(name)
                self._report_unpublished(topic, None if unadvertised is None else unadvertised.message_type)
                return
            typed_topic.publication.send(typed_topic.encoder.encode(term, topic))
        except RetalisError as error:
            self._reports.error(error, ("out", topic))

    def publish_text(self, text: str) -> None:
        """Publish an output that another node has sent as text; a text of another form is reported."""
        try:
            output = self._text_reader.read(text)
            if output.__class__ is not tuple or output[0] is not OUTPUT_EVENT:
                raise UsageError(f"expected event(Term,Topic,Id), found {shorten(text)}")
        except RetalisError as error:
            self._reports.error(RetalisError(f"an output is not published: {error}"), OUTPUT)
            return
        topic = deref(output[2])
        self.publish(deref(output[1]), getattr(topic, "name", None) or to_text(topic))


class TextOnlyOutputs:
    """Reports of outputs that a node publishes only as text.

    Args:
        reports: receives the warnings.
        is_forwarded: returns whether the outputs of a topic are also forwarded, so that it needs no type.
    """

    def __init__(self, reports: Reports, is_forwarded: Callable[[str], bool] = lambda topic: False):
        self._reports = reports
        self._is_forwarded = is_forwarded
        self._logged_topics: Set[str] = set()

    def report(self, topic: str, message_type: Optional[str]) -> None:
        """Report an output; see `ReportUnpublished`.

        For a topic that waits for its type each message is a loss, and is counted as a warning. For a topic without a
        type it is normal, and is logged once.
        """
        if message_type is not None:
            self._reports.warning(
                f"topic {topic}: a message is dropped: type {message_type} is unknown until a publisher defines it",
                ("out", topic),
            )
        elif (
            len(self._logged_topics) < MAX_UNTYPED_TOPICS_NAMED
            and topic not in self._logged_topics
            and not topic.startswith(WATCH)
            and not self._is_forwarded(topic)
        ):
            self._logged_topics.add(topic)
            log.info(
                "topic %s has no type in %s: its outputs are on %s only",
                printable(shorten(topic)),
                TOPICS,
                OUTPUT,
            )


class UntypedTopicWarnings:
    """Warns once about each output topic without a type.

    Args:
        transport: the middleware.
        reports: receives the warnings.
        consequence: what happens to the outputs.
    """

    def __init__(
        self,
        transport: MessageTransport,
        published: Iterable[str],
        reports: Reports,
        consequence: str = TEXT_ONLY,
    ):
        self._transport = transport
        self._reports = reports
        self._consequence = consequence
        self._published = {transport.resolve_topic(topic) for topic in published}
        self._checked: Cache[str, bool] = Cache(1000, 1 << 20)

    def check(self, topic: str) -> None:
        """Check a topic to which outputs are sent or will be sent."""
        if topic not in self._checked and not topic.startswith(WATCH):
            self._checked.store(topic, True, len(topic))
            if not self._has_type(topic):
                name = shorten(topic)
                advice = topic_fault(topic) or (
                    f'<publish_to name="{name}" msg_type="package/Type"/> in {TOPICS} would give it one'
                )
                self._reports.warning(
                    f"topic {name} has no type: {self._consequence}; {advice}",
                    "topics without a type",
                    texts=20,
                )

    def mark_reported(self, topics: Iterable[str]) -> None:
        """Record topics whose warning has been given elsewhere."""
        for topic in topics:
            self._checked.store(topic, True, len(topic))

    def _has_type(self, topic: str) -> bool:
        try:
            return self._transport.resolve_topic(topic) in self._published
        except UsageError:
            # Not a valid topic name: its outputs exist only as text.
            return False


def advertise_topics(published: PublishedTopics, topics: Topics, may_be_learned: bool) -> None:
    """Advertise the topics of ``pub_sub.xml``.

    Args:
        published: the published topics.
        topics: contents of the file.
        may_be_learned: whether a publisher may still define an unknown type, so that it is no error.
    """
    for topic, message_type in topics.published:
        try:
            quality = quality_of(topics.published_quality, topic)
            published.advertise(topic, message_type, topic in topics.latched, quality)
        except RetalisError as error:
            if (
                may_be_learned
                and isinstance(error, MessageError)
                and published.may_be_defined_later(message_type)
            ):
                log.info("%s: topic %s: %s; it may come with a message", TOPICS, topic, error)
            else:
                log.error("%s: topic %s: %s", TOPICS, topic, error)
