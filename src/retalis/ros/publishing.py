"""Topics that are published: terms become messages."""

import threading
from struct import Struct
from typing import Dict, Tuple

from ..engine.runtime import Reports
from ..foundation import MessageError, RetalisError, UsageError, beginning
from ..messages import Definitions, Encoder
from ..prolog.terms import Term
from .names import resolve
from .raw import raw_class
from .sending import Outlet

_SIZE = Struct("<I")


class OutputTopics:
    """Publishes terms.

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

    def advertise(self, topic: str, kind: str) -> None:
        """Make a topic to which terms of a message type can be published.

        Raises:
            RetalisError: where the type or the topic's name is wrong, or the topic has another type already.
        """
        name = resolve(topic)
        definition = self._definitions.find(kind)
        with self._lock:
            known = self._typed.get(name)
            if known is not None:
                if known[1].definition.name != kind:
                    raise UsageError(f"topic {topic} already has the type {known[1].definition.name}")
                return
            outlet = Outlet(name, raw_class(definition), self._queue, self._reports)
            self._typed[name] = (outlet, self._definitions.encoder(definition))

    def publish(self, term: Term, topic: str) -> None:
        """Publish a term as a message; what does not fit the topic's type is logged and not published."""
        try:
            found = self._typed.get(resolve(topic))
            if found is None:
                raise MessageError(
                    f"nothing is published on {beginning(topic)}: pub_sub.xml has no <publish_to> that gives its type"
                )
            outlet, encoder = found
            data = encoder.encode(term, topic)
            outlet.send(_SIZE.pack(len(data)) + data)
        except RetalisError as error:
            self._reports.error(error, ("out", topic))
