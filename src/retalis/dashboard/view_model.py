"""Data of the dashboard's page: recent events, counters with rates, and the graph of the program, ready for JSON.

`RecentEvents` listens to all events, but only while a page shows them. `Snapshots` reads the engine's status and
derives rates from the last few snapshots. `LiveUpdates` takes one snapshot per second for all open pages, and none
while no page is open, so that the dashboard costs nothing unless it is used.

A page that reads slowly skips snapshots: each `PageConnection` has room for the newest one only.
"""

import asyncio
import logging
import time
from collections import deque
from itertools import count
from typing import Any, Callable, Deque, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ..engine.engine import Engine
from ..engine.engine_status import Status
from ..events.dispatch.argument_projection import NOT_READ
from ..events.dispatch.listeners import Listener, ListenerPhase
from ..explanation.event_and_output_explanations import records_origins
from ..foundation.displayed_text import printable_json, shorten
from ..messages.type_definition import functor_name
from ..prolog.machine.resource_limits import resident_bytes
from ..prolog.syntax.term_reader import read_term
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.timestamps import SECOND
from ..prolog.terms.types import CONS, NIL, Frame, Functor, Lazy, Term, Var, atom, deref, functor
from ..visualization.program_graph import NODE_STYLES, Graph, GraphTopic, graph_key, program_graph

MAX_EVENT_CHARACTERS = 800
"""Limit for the characters of an event's text."""

MAX_EVENT_PARTS = 60
"""Limit for the number of subterms of an event that are written, and for the size of each, its functor included."""

MAX_EVENT_DEPTH = 8
"""Limit for the nesting of written subterms."""

MAX_FUNCTORS = 200
"""Limit for the functors that are counted separately."""

EVENTS_PER_FUNCTOR = 8
"""Events of each functor that are stored, so that rare ones remain beside thousands of transforms."""

MAX_WRITTEN_PER_SNAPSHOT = 3
"""Events of one functor that are written between two snapshots; the others are only counted."""

MAX_SHOWN_EVENTS = 60
"""Limit for the events in a snapshot."""

_ELLIPSIS = atom("...")
"""Written in place of subterms beyond the limits."""
_MEMORY_UPDATED_FUNCTOR = functor("memory_updated", 2)
"""Functor of events that report changes of a memory; only counted, because the stored events are shown themselves."""
_NO_EVENT = atom("null_event")
"""Head of rules that only execute an action."""
_EVENT_FUNCTOR = functor("event", 2)
"""Functor of a term that names an event by its term and interval."""


class RecentEvent(NamedTuple):
    """An event that has happened.

    Attributes:
        serial: unique number.
        text: text of the event, possibly cut.
        whole: whether the text is the complete event.
        start: start of the interval in nanoseconds.
        end: end of the interval in nanoseconds.
    """

    serial: int
    text: str
    whole: bool
    start: int
    end: int


class EventCount(NamedTuple):
    """Number of events of a functor while events were observed, and the end of the last one in nanoseconds."""

    number_of_events: int
    end: int


class _FunctorEvents:
    """Events of one functor.

    Attributes:
        event_count: number of events.
        end: end of the last event in nanoseconds.
        written_count: number of events that were written as text since the last snapshot.
        last_events: the last written events.
    """

    __slots__ = ("event_count", "end", "written_count", "last_events")

    def __init__(self) -> None:
        self.event_count = self.end = self.written_count = 0
        self.last_events: Deque[RecentEvent] = deque(maxlen=EVENTS_PER_FUNCTOR)


class RecentEvents:
    """Counts events by functor and stores the last ones as text, on request.

    A listener for all events disables fused actions and early filters (`ListenerIndex.fused_actions`,
    `PushdownFilter`), so it is registered only on request. The work for each event is bounded, and no method waits
    for the engine.
    """

    def __init__(self, engine: Engine):
        self._engine = engine
        self._dispatcher = engine.program.rules.dispatcher
        self._format_term = engine.program.logic.show
        self._listener: Optional[Listener] = None
        self._is_requested = False
        self._serial = count(1)
        self._events_by_functor: Dict[Optional[Functor], _FunctorEvents] = {}

    @property
    def is_observing(self) -> bool:
        """True if events are observed, or will be as soon as the engine executes the request."""
        return self._is_requested

    def set_observing(self, observing: bool) -> None:
        """Start or stop to observe events, as soon as the engine executes the request; stored events remain."""
        if observing != self._is_requested:
            self._is_requested = observing
            self._engine.do_later(self._apply_observation)

    def _apply_observation(self) -> None:
        if self._is_requested and self._listener is None:
            event = Var()
            # The variable is declared unused, so sources need not send arguments that no rule reads.
            self._listener = self._dispatcher.listen(
                ListenerPhase.TRACE, event, self._count_event, unread_variables={event}
            )
        elif not self._is_requested and self._listener is not None:
            self._dispatcher.remove(self._listener)
            self._listener = None

    def _count_event(self, term: Term, values: Tuple[Term, ...], start: int, end: int, frame: Frame) -> Frame:
        """Count an event, and store its text unless its functor has reached `MAX_WRITTEN_PER_SNAPSHOT`."""
        if term is _NO_EVENT:
            return frame
        # This runs for every event: only a dictionary access and two assignments, unless the text is written.
        key = term[0] if term.__class__ is tuple else getattr(term, "functor", None)
        functor_events = self._events_by_functor.get(key)
        if functor_events is None:
            if len(self._events_by_functor) >= MAX_FUNCTORS:
                # Further functors are counted together, under the key None.
                key = None
            functor_events = self._events_by_functor.setdefault(key, _FunctorEvents())
        functor_events.event_count += 1
        functor_events.end = end
        if functor_events.written_count < MAX_WRITTEN_PER_SNAPSHOT and key is not _MEMORY_UPDATED_FUNCTOR:
            functor_events.written_count += 1
            text, whole = format_event_beginning(self._format_term, term)
            functor_events.last_events.append(
                RecentEvent(next(self._serial), text, whole, int(start), int(end))
            )
        return frame

    def take_latest(self) -> List[RecentEvent]:
        """Return the last events, the newest first, and allow further ones to be written."""
        events: List[RecentEvent] = []
        for functor_events in list(self._events_by_functor.values()):
            functor_events.written_count = 0
            events += functor_events.last_events.copy()
        events.sort(reverse=True)
        return events[:MAX_SHOWN_EVENTS]

    def get_counts(self) -> Dict[str, EventCount]:
        """Return the counts by functor; the key ``others`` has those beyond `MAX_FUNCTORS`."""
        return {
            "others" if key is None else str(key): EventCount(
                functor_events.event_count, int(functor_events.end)
            )
            for key, functor_events in list(self._events_by_functor.items())
        }

    def find(self, serial: int) -> Optional[Term]:
        """Return an event as a term to explain, ``event(Term,[T1,T2])``; None if it is no longer stored."""
        for functor_events in list(self._events_by_functor.values()):
            for event in functor_events.last_events.copy():
                if event.serial == serial and event.whole:
                    # The stored text is parsed again: the term itself may hold large buffers, and is not kept alive
                    # for the page.
                    term = read_term(event.text, self._engine.operators, "event").term
                    stamps = make_list([timestamps.datime(event.start), timestamps.datime(event.end)])
                    return (_EVENT_FUNCTOR, term, stamps)
        return None


class _SubtermBudget:
    """Number of further subterms that may be written; 0 after a subterm was replaced by dots."""

    __slots__ = ("remaining",)

    def __init__(self) -> None:
        self.remaining = MAX_EVENT_PARTS

    def exhaust(self) -> Term:
        """Return dots in place of a subterm; no further compound term is written."""
        self.remaining = 0
        return _ELLIPSIS


def format_event_beginning(format_term: Callable[[Term], str], term: Term) -> Tuple[str, bool]:
    """Return the beginning of an event's text, and whether it is complete.

    The term is cut before it is written: an image or a point cloud would take milliseconds.
    """
    budget = _SubtermBudget()
    text = format_term(_truncate(term, budget, MAX_EVENT_DEPTH))
    return shorten(text, MAX_EVENT_CHARACTERS), budget.remaining > 0 and len(text) <= MAX_EVENT_CHARACTERS


def _truncate(term: Term, budget: _SubtermBudget, depth: int) -> Term:
    """Return a term in which subterms beyond the limits are replaced by dots.

    Args:
        term: the term.
        budget: the subterms that may be written, in the whole event.
        depth: number of further levels that may be written.
    """
    if term.__class__ is Lazy and term.decoded_term is None and term.functor is CONS:
        # An array of numbers that has not been decoded: reading its elements would decode it.
        return budget.exhaust()
    term = deref(term)
    if term is NOT_READ:
        return budget.exhaust()
    if term.__class__ is not tuple:
        return term if _is_short(term) else budget.exhaust()
    if budget.remaining <= 0 or depth == 0 or len(term) > MAX_EVENT_PARTS:
        return budget.exhaust()
    if term[0] is CONS:
        return _truncate_list(term, budget, depth)
    budget.remaining -= 1
    return (term[0], *[_truncate(part, budget, depth - 1) for part in term[1:]])


def _is_short(term: Any) -> bool:
    """Return whether an atom, a string or a number is short enough to be written."""
    if term.__class__ is int:
        return bool(term.bit_length() <= MAX_EVENT_CHARACTERS)
    return (
        len(getattr(term, "name", "")) <= MAX_EVENT_CHARACTERS
        and len(getattr(term, "text", "")) <= MAX_EVENT_CHARACTERS
    )


def _truncate_list(term: Any, budget: _SubtermBudget, depth: int) -> Term:
    items: List[Term] = []
    while term.__class__ is tuple and term[0] is CONS and budget.remaining > 0:
        budget.remaining -= 1
        items.append(_truncate(term[1], budget, depth - 1))
        term = deref(term[2])
    if term.__class__ is tuple and term[0] is CONS:
        return make_list([*items, _ELLIPSIS])
    result = term if term is NIL else _truncate(term, budget, depth - 1)
    for item in reversed(items):
        result = (CONS, item, result)
    return result


RATE_SNAPSHOTS = 5
"""Number of intervals between snapshots over which rates are averaged."""

MAX_SHOWN_TOPICS = 100
"""Limit for the topics in a snapshot."""

Json = Dict[str, Any]


class TopicRow(NamedTuple):
    """A subscribed topic. Unknown values are None.

    Attributes:
        kind: message type.
        messages: number of received messages.
        publishers: number of connected publishers.
        dropped: number of messages that were dropped or refused, or are missing.
        age: seconds since the last message.
        lag: seconds from the stamp of a recent message to its receipt.
        event: name of the events; "" if it is derived from the type.
    """

    name: str
    kind: str
    messages: Optional[int] = None
    publishers: Optional[int] = None
    dropped: Optional[int] = None
    age: Optional[float] = None
    lag: Optional[float] = None
    event: str = ""

    @property
    def event_name(self) -> str:
        """Name of the topic's events."""
        return self.event or functor_name(self.kind)


class DashboardSource(NamedTuple):
    """The program that a page shows.

    Attributes:
        topics: returns the subscribed topics.
        allows_queries: whether users of the page may ask goals.
        forwarding: returns the state of the forwarding of outputs; "" if nothing is forwarded.
    """

    engine: Engine
    title: str
    topics: Callable[[], Sequence[TopicRow]] = tuple
    allows_queries: bool = False
    forwarding: Callable[[], str] = str


class Snapshot(NamedTuple):
    """The state of a program as the page reads it; the names of the fields are those in its scripts.

    Attributes:
        queries: whether users of the page may ask goals.
        explains: whether events can be explained.
        watching: whether events are observed.
        memory: resident memory of the process in bytes.
        forwarding: state of the forwarding of outputs, a text; "" if nothing is forwarded.
        rates: growth of each counter per second, by the name of the counter.
        topics: the topics as dictionaries with the fields of `TopicRow`.
        events: the last events as dictionaries with the fields of `RecentEvent`, with times in seconds.
        status: the fields of `Status`, with times in seconds.
    """

    title: str
    queries: bool
    explains: bool
    watching: bool
    memory: int
    forwarding: str
    rates: Dict[str, float]
    topics: List[Json]
    events: List[Json]
    status: Json


class Snapshots:
    """Successive snapshots of a program.

    Attributes:
        events: the recent events.
        graph: the graph of the program, a new object after each change.
    """

    def __init__(self, source: DashboardSource):
        self._source = source
        self._engine = source.engine
        self.events = RecentEvents(source.engine)
        self._history: Deque[Tuple[float, Dict[str, int]]] = deque(maxlen=RATE_SNAPSHOTS + 1)
        self._topics: List[GraphTopic] = []
        self._graph_key: object = None
        self.graph: Json = {}

    def reset(self) -> None:
        """Discard former snapshots, which are too old for rates after a time without an open page."""
        self._history.clear()

    def take(self) -> Json:
        """Return a snapshot."""
        status = self._engine.status()
        # The engine is not locked, so that it is not slowed down: status, topics and counts may differ by a few
        # events.
        topics = list(self._source.topics())[:MAX_SHOWN_TOPICS]
        event_counts = self.events.get_counts()
        counters = {"taken": status.taken, "fired": status.fired}
        counters.update({f"rule:{index}": rule.fired for index, rule in enumerate(status.rules)})
        counters.update({f"memory:{memory.id}": memory.added for memory in status.memories})
        for subscription in status.subscriptions:
            name = f"output:{shorten(subscription.topic)}"
            counters[name] = counters.get(name, 0) + subscription.sent
        counters.update(
            {f"event:{key}": event_count.number_of_events for key, event_count in event_counts.items()}
        )
        rows = [self._create_topic_row(topic, event_counts, status.now, counters) for topic in topics]
        self._update_graph([GraphTopic(topic.name, topic.event_name) for topic in topics])
        return Snapshot(
            title=self._source.title,
            queries=self._source.allows_queries,
            explains=records_origins(self._engine),
            watching=self.events.is_observing,
            memory=resident_bytes(),
            forwarding=self._source.forwarding(),
            rates=self._compute_rates(counters),
            topics=rows,
            events=[
                {**event._asdict(), "start": event.start / SECOND, "end": event.end / SECOND}
                for event in self.events.take_latest()
            ],
            status=_status_to_json(status),
        )._asdict()

    def _create_topic_row(
        self, topic: TopicRow, event_counts: Dict[str, EventCount], now: int, counters: Dict[str, int]
    ) -> Json:
        """Return the row of a topic, and add its counter to ``counters``.

        If the counters of its receiver are unknown, for example in another node, its events are counted instead.
        """
        row = topic._asdict()
        name = topic.event_name
        # The keys are functors as text, name/arity. The arity of a topic's events is not known here.
        counts = [event_count for key, event_count in event_counts.items() if key.rpartition("/")[0] == name]
        message_count = topic.messages
        if message_count is None and counts:
            message_count = sum(event_count.number_of_events for event_count in counts)
            row["age"] = (now - max(event_count.end for event_count in counts)) / SECOND
        if message_count is not None:
            counters[f"topic:{topic.name}"] = message_count
        row["messages"] = message_count
        return row

    def _compute_rates(self, counters: Dict[str, int]) -> Dict[str, float]:
        """Return the growth per second of each counter, since the oldest stored snapshot."""
        now = time.monotonic()
        self._history.append((now, counters))
        oldest_time, oldest_counters = self._history[0]
        # The first snapshot after a pause has no predecessor, and gives no rates.
        if now <= oldest_time:
            return {}
        return {
            name: max(0.0, round((value - oldest_counters[name]) / (now - oldest_time), 2))
            for name, value in counters.items()
            if name in oldest_counters
        }

    def _update_graph(self, topics: List[GraphTopic]) -> None:
        """Update the graph if the program has changed."""
        key = graph_key(self._engine, topics)
        if key != self._graph_key:
            self._graph_key = key
            self.graph = _make_page_graph(program_graph(self._engine, topics))._asdict()


class PageGraph(NamedTuple):
    """A graph as the page reads it; the names of the fields are those in its scripts.

    Attributes:
        nodes: the nodes as dictionaries with the fields of `GraphNode`.
        edges: the edges as dictionaries with the fields of `GraphEdge`.
        left_out: number of nodes that are not included.
        legend: kind and description of each kind of nodes that occurs.
    """

    nodes: List[Json]
    edges: List[Json]
    left_out: int
    legend: List[Tuple[str, str]]


def _make_page_graph(graph: Graph) -> PageGraph:
    kinds = {node.kind for node in graph.nodes}
    return PageGraph(
        nodes=[node._asdict() for node in graph.nodes],
        edges=[edge._asdict() for edge in graph.edges],
        left_out=graph.omitted_count,
        legend=[(kind, style.legend) for kind, style in NODE_STYLES.items() if kind in kinds],
    )


_TIME_FIELDS = frozenset(
    ("now", "next_alarm", "last_fired", "oldest", "newest", "since", "instant", "behind")
)
"""Fields of a status that are instants or durations in nanoseconds."""


def _status_to_json(status: Status) -> Json:
    """Return a status in seconds instead of nanoseconds, which exceed the integer range of JavaScript's numbers."""

    def convert_times(value: Any, field: str = "") -> Any:
        if isinstance(value, dict):
            return {name: convert_times(part, name) for name, part in value.items()}
        if isinstance(value, list):
            return [convert_times(part) for part in value]
        return value / SECOND if field in _TIME_FIELDS and value is not None else value

    converted: Json = convert_times(status.json())
    return converted


_logger = logging.getLogger("retalis")

MAX_OPEN_PAGES = 8
"""Limit for open pages."""

UPDATE_PERIOD_SECONDS = 1.0
"""Default time in seconds between two snapshots."""


class PageConnection:
    """An open page, with room for one snapshot: a newer one replaces it if the page has not read it.

    Attributes:
        shows_events: whether the page shows recent events.
        graph: the graph that the page has received last.
    """

    def __init__(self, shows_events: bool) -> None:
        self.shows_events = shows_events
        self.graph: Any = None
        self._graph_data = self._snapshot = b""
        self._ready = asyncio.Event()

    def put(self, snapshot: bytes, graph_data: bytes = b"") -> None:
        """Store a snapshot to send next, and optionally a graph to send before it."""
        self._snapshot = snapshot
        # A graph is sent once, so it must not be lost if the page skips this snapshot.
        self._graph_data = graph_data or self._graph_data
        self._ready.set()

    def end_stream(self) -> None:
        """End the stream of the page."""
        self._snapshot = self._graph_data = b""
        self._ready.set()

    async def next(self) -> bytes:
        """Wait for data to send, and return it; empty if the stream has ended."""
        await self._ready.wait()
        self._ready.clear()
        data = self._graph_data + self._snapshot
        self._snapshot = self._graph_data = b""
        return data


class LiveUpdates:
    """Distribution of snapshots to all open pages. All methods run in the thread of the server.

    Args:
        snapshots: source of the snapshots.
        period: seconds between two snapshots.
    """

    def __init__(self, snapshots: Snapshots, period: float = UPDATE_PERIOD_SECONDS):
        self._snapshots = snapshots
        self._period = period
        self._connections: List[PageConnection] = []
        self._sending_task: Optional[asyncio.Task[None]] = None
        self._last_logged_error = ""

    def add_page(self, shows_events: bool) -> Optional[PageConnection]:
        """Add and return a page; return None if there are too many.

        Args:
            shows_events: whether the page shows recent events, for which a listener is registered in the engine.
        """
        if len(self._connections) >= MAX_OPEN_PAGES:
            return None
        connection = PageConnection(shows_events)
        self._connections.append(connection)
        self._update_observation()
        if self._sending_task is None:
            self._snapshots.reset()
            self._sending_task = asyncio.ensure_future(self._run())
        return connection

    def remove_page(self, connection: PageConnection) -> None:
        """Remove a closed page; further calls have no effect."""
        if connection in self._connections:
            self._connections.remove(connection)
            self._update_observation()

    def close(self) -> None:
        """Remove all pages, and end their streams."""
        for connection in self._connections:
            connection.end_stream()
        self._connections = []
        self._update_observation()

    def _update_observation(self) -> None:
        self._snapshots.events.set_observing(any(connection.shows_events for connection in self._connections))

    async def _run(self) -> None:
        """Send a snapshot to all pages periodically, until none is open."""
        while self._connections:
            try:
                self._send_snapshot()
            # The status is read while the engine works. A failure must not end the stream of the open pages; it is
            # logged once, as the next snapshot may fail for the same reason.
            except Exception as error:
                if repr(error) != self._last_logged_error:
                    self._last_logged_error = repr(error)
                    _logger.exception("internal error: the dashboard cannot read the status of the program")
            await asyncio.sleep(self._period)
        self._sending_task = None

    def _send_snapshot(self) -> None:
        snapshot = _format_server_event("snapshot", self._snapshots.take())
        graph = self._snapshots.graph
        graph_data = b""
        for connection in list(self._connections):
            # The graph is large and rarely changes, so it is sent only when the page does not have this object.
            if connection.graph is graph:
                connection.put(snapshot)
                continue
            graph_data = graph_data or _format_server_event("graph", graph)
            connection.graph = graph
            connection.put(snapshot, graph_data)


def _format_server_event(event: str, data: Dict[str, Any]) -> bytes:
    """Return data in the format of server-sent events, with the name of the event."""
    return f"event: {event}\ndata: {printable_json(data)}\n\n".encode()
