"""Topics that are published: terms become messages."""

import threading
from struct import Struct
from typing import Dict, List, Optional, Set, Tuple

import rospy

from ..engine.runtime.problem_reports import Reports
from ..events.program.program_folder import TOPICS
from ..foundation.errors import MessageError, RetalisError, UsageError, beginning, printable
from ..messages.encoder import Encoder
from ..messages.type_registry import Definitions
from ..prolog.terms.types import Term
from .connection_writer import Outlet, raw_class
from .internal_topics import OUTPUT, WATCH, resolve
from .topic_statistics import OutputStatus

MAX_UNTYPED_TOPICS_NAMED = 100
"""Topics without a type that are named."""

_SIZE = Struct("<I")


class OutputTopics:
    """Publishes terms.

    A topic whose type is not installed is published once a publisher has brought the definition; see `learned`.

    Args:
        definitions: the message types that are known.
        queue: length of the queues.
        reports: takes what goes wrong while messages flow.
    """

    def __init__(self, definitions: Definitions, queue: int, reports: Reports):
        self._definitions = definitions
        self._queue = queue
        self._reports = reports
        self._lock = threading.Lock()
        self._typed: Dict[str, Tuple[Outlet, Encoder]] = {}
        self._awaited: Dict[str, Tuple[str, bool]] = {}
        """Types that are not known yet, and whether to latch, by topic."""
        self._told: Set[str] = set()

    def advertise(self, topic: str, kind: str, latched: bool = False) -> None:
        """Make a topic to which terms of a message type can be published.

        Args:
            topic: its name.
            kind: the message type; where it is not known, the topic is made when it is.
            latched: whether its last message goes to each subscriber that comes later.

        Raises:
            MessageError: where the type is not known yet, or wrong.
            UsageError: where the topic's name is wrong, or it has another type already.
        """
        name = resolve(topic)
        with self._lock:
            known = self._kind(name)
            if known is not None:
                if known != kind:
                    raise UsageError(f"topic {topic} already has the type {known}")
                return
            try:
                self._make(name, kind, latched)
            except MessageError:
                self._awaited[name] = (kind, latched)
                raise

    def status(self) -> List[OutputStatus]:
        """Return what has gone out on each topic."""
        return [outlet.status(encoder.definition.name) for outlet, encoder in list(self._typed.values())]

    def knows(self, kind: str) -> bool:
        """Tell whether a message type is known."""
        return kind in self._definitions

    def _kind(self, name: str) -> Optional[str]:
        """Return the type that a topic has been given."""
        if name in self._typed:
            return self._typed[name][1].definition.name
        return self._awaited[name][0] if name in self._awaited else None

    def _make(self, name: str, kind: str, latched: bool) -> None:
        definition = self._definitions.find(kind)
        outlet = Outlet(name, raw_class(definition), self._queue, self._reports, latched=latched)
        self._typed[name] = (outlet, self._definitions.encoder(definition))

    def learned(self) -> None:
        """Make the topics whose types have become known: a publisher of a subscribed topic has come."""
        if not self._awaited:
            return
        with self._lock:
            for name, (kind, latched) in list(self._awaited.items()):
                if kind in self._definitions:
                    self._make(name, kind, latched)
                    del self._awaited[name]
                    rospy.loginfo(
                        "topic %s is published: its type %s was learned from a publisher", name, kind
                    )

    def publish(self, term: Term, topic: str) -> None:
        """Publish a term as a message; what does not fit the topic's type is logged and not published.

        A topic without a type is for those who listen to the outputs as text.
        """
        try:
            found = self._typed.get(resolve(topic))
            if found is None:
                self._leave(topic)
                return
            outlet, encoder = found
            data = encoder.encode(term, topic)
            outlet.send(_SIZE.pack(len(data)) + data)
        except RetalisError as error:
            self._reports.error(error, ("out", topic))

    def _leave(self, topic: str) -> None:
        """Say that a topic's outputs stay text: once, where nothing was promised; each time counts where it was."""
        awaited = self._awaited.get(resolve(topic))
        if awaited is not None:
            text = f"topic {topic}: {awaited[0]} is not known yet, and no publisher has brought it: a message is lost"
            self._reports.warning(text, ("out", topic))
        elif (
            len(self._told) < MAX_UNTYPED_TOPICS_NAMED
            and topic not in self._told
            and not topic.startswith(WATCH)
        ):
            self._told.add(topic)
            rospy.loginfo(
                "topic %s has no type in %s: its outputs are on %s only",
                printable(beginning(topic)),
                TOPICS,
                OUTPUT,
            )
