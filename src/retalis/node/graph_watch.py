"""Changes of the graph of nodes and topics, published as messages on the topic ``ros_graph``.

A program that subscribes to ``ros_graph`` receives them as events, as those of any other topic; other nodes and bags
can receive them, too. Without a subscription in ``pub_sub.xml``, the graph is not watched.
"""

import threading
from typing import Iterator, Mapping, NamedTuple, Optional, Set

from ..engine.runtime.problem_reports import Reports
from ..events.program.topic_configuration import Topics
from ..messages.message_dictionaries import make_message_term
from ..messages.type_registry import Definitions
from .transport import GraphChange, NodeGraph, Transport

GRAPH_TOPIC = "ros_graph"
GRAPH_TYPE = "retalis/GraphChange"

PERIOD_SECONDS = 1.0
"""Seconds between two readings of the graph."""

QUEUE_SIZE = 1000
"""Number of changes that wait for a slow subscriber."""


class WatchedGraph(NamedTuple):
    """The parts of a graph whose changes are published.

    Attributes:
        nodes: names of the nodes.
        published: topics with a publisher.
        missing: topics with a subscriber and without a publisher.
        mismatches: pairs that cannot connect, as changes without a kind.
    """

    nodes: Set[str]
    published: Set[str]
    missing: Set[str]
    mismatches: Set[GraphChange]


def read_graph(graph: NodeGraph) -> WatchedGraph:
    """Return the parts of a graph whose changes are published."""
    published = {topic for topic, nodes in graph.publishers.items() if nodes}
    return WatchedGraph(
        {
            *graph.nodes,
            *_all_nodes(graph.publishers),
            *_all_nodes(graph.subscribers),
            *_all_nodes(graph.servers),
        },
        published,
        {topic for topic, nodes in graph.subscribers.items() if nodes} - published,
        {
            GraphChange("", mismatch.subscriber, mismatch.topic, mismatch.reason)
            for mismatch in graph.mismatches
        },
    )


def _all_nodes(nodes_by_name: Mapping[str, Set[str]]) -> Set[str]:
    return {node for nodes in nodes_by_name.values() for node in nodes}


def find_changes(before: WatchedGraph, after: WatchedGraph) -> Iterator[GraphChange]:
    """Yield the changes between two states of the graph, in the order of their names."""
    for node in sorted(after.nodes - before.nodes):
        yield GraphChange("node_started", node)
    for topic in sorted(after.published - before.published):
        yield GraphChange("topic_published", name=topic)
    for topic in sorted(after.missing - before.missing):
        yield GraphChange("publisher_missing", name=topic)
    for mismatch in sorted(after.mismatches - before.mismatches):
        yield mismatch._replace(kind="mismatch")
    for mismatch in sorted(before.mismatches - after.mismatches):
        yield mismatch._replace(kind="mismatch_ended")
    for topic in sorted(before.missing - after.missing):
        yield GraphChange("publisher_found", name=topic)
    for topic in sorted(before.published - after.published):
        yield GraphChange("topic_unpublished", name=topic)
    for node in sorted(before.nodes - after.nodes):
        yield GraphChange("node_ended", node)


NO_GRAPH = WatchedGraph(set(), set(), set(), set())
"""The graph before the first reading: everything that exists then is a change."""


class GraphWatch:
    """Publisher of the changes of the graph, by wall time: simulated time may stand still.

    Args:
        transport: the middleware.
        topics: topics of the program; the graph is watched if they contain `GRAPH_TOPIC`.
        definitions: known message types.
        reports: receives errors.
    """

    def __init__(self, transport: Transport, topics: Topics, definitions: Definitions, reports: Reports):
        self._transport = transport
        self._reports = reports
        self._before = NO_GRAPH
        self._is_shut_down = threading.Event()
        name = transport.resolve_topic(GRAPH_TOPIC)
        if name not in {transport.resolve_topic(topic) for topic, _ in topics.subscribed}:
            return
        self._definition = definitions.find(GRAPH_TYPE)
        self._encoder = definitions.encoder(self._definition, transport.format)
        self._publication = transport.advertise(name, self._definition, QUEUE_SIZE)
        # Changes are reported by other threads.
        self._lock = threading.Lock()
        transport.on_shutdown(self._is_shut_down.set)
        transport.watch_nodes(self._publish)
        threading.Thread(target=self._run, daemon=True, name="graph").start()

    def _run(self) -> None:
        while True:
            try:
                self.publish_changes(self._transport.graph())
            except Exception as error:
                # Otherwise the watch would end without a report.
                if not self._transport.is_shut_down():
                    self._reports.error(error)
            if self._is_shut_down.wait(PERIOD_SECONDS):
                return

    def publish_changes(self, graph: Optional[NodeGraph]) -> None:
        """Publish the changes since the last reading; none if the graph is unknown now."""
        if graph is None:
            return
        after = read_graph(graph)
        changes = list(find_changes(self._before, after))
        self._before = after
        for change in changes:
            self._publish(change)

    def _publish(self, change: GraphChange) -> None:
        term = make_message_term(self._definition, change._asdict())
        with self._lock:
            self._publication.send(self._encoder.encode(term, GRAPH_TOPIC))
