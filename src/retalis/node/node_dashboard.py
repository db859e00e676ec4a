"""Dashboard of node ``retalis``, with the input topics of all nodes of the program.

The counters of topics that other nodes subscribe are read from ``/diagnostics``.
"""

import logging
import threading
from typing import Any, Callable, Dict, Iterable, List, Mapping, Optional, Sequence

from ..dashboard.page_server import Dashboard
from ..dashboard.view_model import DashboardSource, TopicRow
from ..engine.engine import Engine
from ..engine.event_input import TopicRequest
from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import TopicEvent, TopicType
from ..foundation.errors import UsageError
from ..messages.decoder import Decoder
from ..messages.message_dictionaries import read_message_term
from ..messages.type_registry import Definitions
from ..prolog.terms.timestamps import SECOND
from .diagnostics import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE
from .subscribed_topics import MessageHandler, MessageProcessing, ReadingOptions, SubscribedTopic
from .text_exchange import INPUT, OUTPUT
from .topic_statistics import InputStatus
from .transport import MessageSource, Transport

log = logging.getLogger("retalis")

_SEPARATOR = ": input "
"""Separator between the names of node and topic in a status on ``/diagnostics``; see `InputHealth`."""

_TOPIC_KEYS = {"type", "publishers", "messages", "lag (s)"}
"""Keys that identify the status of a subscribed topic, whatever the hardware id of the node."""

MAX_PORTS_TRIED = 100
"""Number of ports to try, from the requested one on."""

_QUEUE_SIZE = 10

MAX_REMOTE_TOPICS = 200
"""Limit for the topics of other nodes."""


class NodeDashboard:
    """Web page of the engine, served while the node runs.

    If the port is in use, the next free one is taken and logged. If the page cannot be served, a warning gives the
    reason, and the node continues without it.

    Args:
        transport: the middleware.
        reports: receives errors.
        port: port on the loopback address; None for no page.
        allow_queries: whether users of the page may ask goals.
        engine: the engine to show.
        inputs: returns the counters of the topics that this node subscribes.
        program_topics: topics of the program, whichever node subscribes to them.
        event_names: returns pairs of topic and event name, for topics whose events are not named after their type.

    Attributes:
        url: address of the page; "" if there is none.
    """

    def __init__(
        self,
        transport: Transport,
        reports: Reports,
        port: Optional[int],
        allow_queries: bool,
        engine: Engine,
        inputs: Callable[[], Sequence[InputStatus]],
        forwarding: Callable[[], str],
        program_topics: Sequence[TopicType],
        event_names: Callable[[], Iterable[TopicEvent]] = tuple,
    ):
        self._transport = transport
        self._reports = reports
        self._inputs = inputs
        self._program_topics = [
            TopicRow(transport.resolve_topic(topic_type.topic), topic_type.type)
            for topic_type in program_topics
        ]
        self._event_names = event_names
        self._remote_topics: Dict[str, TopicRow] = {}
        self.url = ""
        if port is None:
            return
        source = DashboardSource(engine, transport.node_name, self.topics, allow_queries, forwarding)
        try:
            page = Dashboard(source, port, port_count=MAX_PORTS_TRIED)
        except UsageError as error:
            log.warning("%s; the node goes on without it", error)
            return
        self._subscribe_diagnostics()
        transport.on_shutdown(page.close)
        self.url = page.url
        if page.port != port:
            log.warning("port %d is taken: the dashboard is at %s", port, page.url)
        else:
            log.info("the dashboard is at %s", page.url)

    def topics(self) -> List[TopicRow]:
        """Return all input topics with the known counters of each."""
        by_name = {row.name: row for row in self._program_topics}
        # In increasing precedence: names only, statuses of other nodes, the node's own counters.
        by_name.update(self._remote_topics)
        by_name.update({row.topic: _topic_row(row) for row in self._inputs()})
        event_names = {self._transport.resolve_topic(topic): event for topic, event in self._event_names()}
        internal_topics = {self._transport.resolve_topic(name) for name in (INPUT, OUTPUT)}
        return [
            row._replace(event=event_names.get(name, ""))
            for name, row in by_name.items()
            if name not in internal_topics
        ]

    def _subscribe_diagnostics(self) -> None:
        """Subscribe ``/diagnostics``, on which the interface node reports its topics."""
        definitions = Definitions(self._transport.installed_types(include_rosbags=False))
        if DIAGNOSTICS_TYPE not in definitions:
            return

        def make_handler(decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
            return lambda data: self._receive(read_message_term(decoder.definition, decoder.decode(data)))

        self._diagnostics = SubscribedTopic(
            self._transport,
            definitions,
            self._reports,
            TopicRequest(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE),
            MessageProcessing(make_handler, threading.Lock()),
            ReadingOptions(_QUEUE_SIZE),
        )

    def _receive(self, message: Mapping[str, Any]) -> None:
        """Store the topics that nodes of this package report in the same namespace."""
        own_name = self._transport.node_name.strip("/")
        namespace = own_name.rpartition("/")[0]
        for status in message["status"]:
            node, separator, topic = status["name"].partition(_SEPARATOR)
            values = {value["key"]: value["value"] for value in status["values"]}
            if (
                not separator
                or not values.keys() >= _TOPIC_KEYS
                or node == own_name
                or node.rpartition("/")[0] != namespace
            ):
                # The status of another program, or of something else than a topic.
                continue
            # Any node may publish on /diagnostics: the number of stored topics must be bounded.
            if topic in self._remote_topics or len(self._remote_topics) < MAX_REMOTE_TOPICS:
                self._remote_topics[topic] = _remote_topic_row(topic, values)


def _topic_row(status: InputStatus) -> TopicRow:
    lag = None if status.lag is None else status.lag / SECOND
    lost = status.dropped + status.refused + status.missing
    return TopicRow(status.topic, status.type, status.messages, status.publishers, lost, status.age, lag)


def _remote_topic_row(topic: str, values: Dict[str, str]) -> TopicRow:
    """Return the topic that the values of a status describe; see `InputHealth.of`."""
    messages, publishers = _number(values, "messages"), _number(values, "publishers")
    return TopicRow(
        topic,
        values.get("type", ""),
        None if messages is None else int(messages),
        None if publishers is None else int(publishers),
        int(sum(_number(values, name) or 0 for name in ("dropped", "refused", "missing"))),
        _number(values, "last message (s ago)"),
        _number(values, "lag (s)"),
    )


def _number(values: Dict[str, str], key: str) -> Optional[float]:
    """Return a value as finite number; None if it is absent or not a number."""
    try:
        number = float(values.get(key, ""))
    except ValueError:
        return None
    return number if abs(number) < float("inf") else None
