"""Publishing of terms as messages on the output topics of a program."""

import threading
from struct import Struct
from typing import Dict, List, Optional, Set, Tuple

import rospy

from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import TOPICS
from ..foundation.errors import MessageError, RetalisError, UsageError, beginning, printable
from ..messages.encoder import Encoder
from ..messages.type_registry import Definitions
from ..prolog.terms.types import Term
from .connection_writer import TopicWriter, serialized_class
from .internal_topics import OUTPUT, WATCH, resolve
from .topic_statistics import OutputStatus

MAX_UNTYPED_TOPICS_NAMED = 100
"""Limit for the topics without a type that are logged."""

_SIZE = Struct("<I")


class OutputTopics:
    """The output topics of a program.

    A topic whose type is not installed is advertised as soon as a publisher of an input topic has defined the type;
    see `advertise_learned`.

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
        self._typed: Dict[str, Tuple[TopicWriter, Encoder]] = {}
        self._awaiting_type: Dict[str, Tuple[str, bool]] = {}
        """Unknown type and latching of topics that are not advertised yet, by topic."""
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
                self._awaiting_type[name] = (message_type, latched)
                raise

    def status(self) -> List[OutputStatus]:
        """Return the counters of each topic."""
        return [
            topic_writer.status(encoder.definition.name)
            for topic_writer, encoder in list(self._typed.values())
        ]

    def knows(self, message_type: str) -> bool:
        """Return whether a message type is known."""
        return message_type in self._definitions

    def _type_of(self, name: str) -> Optional[str]:
        """Return the type of a topic; None if it has none."""
        if name in self._typed:
            return self._typed[name][1].definition.name
        return self._awaiting_type[name][0] if name in self._awaiting_type else None

    def _advertise(self, name: str, message_type: str, latched: bool) -> None:
        definition = self._definitions.find(message_type)
        topic_writer = TopicWriter(
            name, serialized_class(definition), self._queue, self._reports, latched=latched
        )
        self._typed[name] = (topic_writer, self._definitions.encoder(definition))

    def advertise_learned(self) -> None:
        """Advertise the topics whose types have become known through a new connection to a publisher."""
        # Called for each new connection, in nearly all programs without a topic that waits for its type.
        if not self._awaiting_type:
            return
        with self._lock:
            for name, (message_type, latched) in list(self._awaiting_type.items()):
                if message_type in self._definitions:
                    self._advertise(name, message_type, latched)
                    del self._awaiting_type[name]
                    rospy.loginfo(
                        "topic %s is published: its type %s was learned from a publisher", name, message_type
                    )

    def publish(self, term: Term, topic: str) -> None:
        """Publish a term as a message; a term that does not fit the topic's type is reported and not published.

        Outputs to a topic without a type exist only as text.
        """
        try:
            output = self._typed.get(resolve(topic))
            if output is None:
                self._report_unpublished(topic)
                return
            topic_writer, encoder = output
            data = encoder.encode(term, topic)
            topic_writer.send(_SIZE.pack(len(data)) + data)
        except RetalisError as error:
            self._reports.error(error, ("out", topic))

    def _report_unpublished(self, topic: str) -> None:
        """Report an output that is not published as message.

        For a topic that waits for its type each message is a loss, and is counted as a warning. For a topic without a
        type it is normal, and is logged once.
        """
        awaited = self._awaiting_type.get(resolve(topic))
        if awaited is not None:
            message_type, _ = awaited
            text = f"topic {topic}: a message is dropped: type {message_type} is unknown until a publisher defines it"
            self._reports.warning(text, ("out", topic))
        elif (
            len(self._logged_topics) < MAX_UNTYPED_TOPICS_NAMED
            and topic not in self._logged_topics
            and not topic.startswith(WATCH)
        ):
            self._logged_topics.add(topic)
            rospy.loginfo(
                "topic %s has no type in %s: its outputs are on %s only",
                printable(beginning(topic)),
                TOPICS,
                OUTPUT,
            )
