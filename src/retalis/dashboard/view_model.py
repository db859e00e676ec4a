"""The last events of an engine, watched only while somebody looks at them.

What the page shows, as it is now: texts and numbers, ready for JSON.

The live numbers of all open pages: taken once a second while there is one, and not at all otherwise.
"""

import asyncio
import logging
import time
from collections import deque
from itertools import count
from typing import Any, Callable, Deque, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ..engine.engine import Engine
from ..engine.engine_status import Status
from ..events.dispatch.listeners import NOT_READ, Listener, ListenerPhase
from ..explanation.explain import records_origins
from ..foundation.errors import beginning, printable_json
from ..messages.type_definition import functor_name
from ..prolog.machine.resource_limits import resident_bytes
from ..prolog.syntax.term_reader import read_term
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.timestamps import SECOND
from ..prolog.terms.types import CONS, NIL, Frame, Functor, Lazy, Term, Var, atom, deref, functor
from ..visualization.program_graph import Graph, GraphTopic, graph_key, program_graph

MAX_EVENT_CHARACTERS = 800
"""Characters of an event's text."""

MAX_EVENT_PARTS = 60
"""Parts of an event that are written out, and elements of a list."""

MAX_EVENT_DEPTH = 8
"""How deep in an event they may stand."""

MAX_FUNCTORS = 200
"""Functors of events that are told apart."""

EVENTS_PER_FUNCTOR = 8
"""Events of one functor that are kept: rare ones stay beside thousands of transforms."""

AT_A_LOOK = 3
"""Events of one functor that are written out from one look to the next; the others are counted."""

MAX_SHOWN_EVENTS = 60
"""Events that are shown."""

_CUT = atom("...")
_UPDATED = functor("memory_updated", 2)
"""Events that tell of others, which are shown themselves."""
_NO_EVENT = atom("null_event")
"""The head of rules that are there for what they do."""
_ASKED = functor("event", 2)


class RecentEvent(NamedTuple):
    """An event that has happened.

    Attributes:
        serial: its own number.
        text: its text.
        whole: whether that is all of it.
        start: its interval, in nanoseconds.
        end: the same.
    """

    serial: int
    text: str
    whole: bool
    start: int
    end: int


class EventCount(NamedTuple):
    """How many events of a functor there were while somebody looked, and the end of the last one."""

    number: int
    end: int


class _Kind:
    """The events of one functor."""

    __slots__ = ("number", "end", "shown", "kept")

    def __init__(self) -> None:
        self.number = self.end = self.shown = 0
        self.kept: Deque[RecentEvent] = deque(maxlen=EVENTS_PER_FUNCTOR)


class RecentEvents:
    """Counts events by their functors and keeps the last ones as text, while that is wanted.

    A listener for all events disables fused actions and gates (`Audience.fused`, `Gate`), so it is there only while
    it is wanted. What it does for an event is bounded, and nobody waits for the engine here.

    Args:
        engine: whose events they are.
    """

    def __init__(self, engine: Engine):
        self._engine = engine
        parts = engine
        self._dispatcher, self._runner, self._show = parts.dispatcher, parts.executor, parts.logic.show
        self._listener: Optional[Listener] = None
        self._wanted = False
        self._serial = count(1)
        self._kinds: Dict[Optional[Functor], _Kind] = {}

    @property
    def watching(self) -> bool:
        """Whether events are being watched, or will be when the engine comes to it."""
        return self._wanted

    def watch(self, wanted: bool) -> None:
        """Begin or end watching, as soon as the engine has time; what is kept stays."""
        if wanted != self._wanted:
            self._wanted = wanted
            self._runner.post(self._set)

    def _set(self) -> None:
        if self._wanted and self._listener is None:
            event = Var()
            self._listener = self._dispatcher.listen(
                ListenerPhase.TRACE, event, self._see, unused={event}
            )  # what is not read stays out of the texts between the nodes
        elif not self._wanted and self._listener is not None:
            self._dispatcher.remove(self._listener)
            self._listener = None

    def _see(self, term: Term, values: Tuple[Term, ...], start: int, end: int, after: Frame) -> Frame:
        """Count an event, and keep its text where not many of its kind have been."""
        if term is _NO_EVENT:
            return after
        key = term[0] if term.__class__ is tuple else getattr(term, "functor", None)
        kind = self._kinds.get(key)
        if kind is None:
            if len(self._kinds) >= MAX_FUNCTORS:
                key = None  # all others
            kind = self._kinds.setdefault(key, _Kind())
        kind.number += 1
        kind.end = end
        if kind.shown < AT_A_LOOK and key is not _UPDATED:
            kind.shown += 1
            text, whole = event_beginning(self._show, term)
            kind.kept.append(RecentEvent(next(self._serial), text, whole, int(start), int(end)))
        return after

    def look(self) -> List[RecentEvent]:
        """Return the last events, the newest first; others are written out after that."""
        found: List[RecentEvent] = []
        for kind in list(self._kinds.values()):
            kind.shown = 0
            found += kind.kept.copy()
        found.sort(reverse=True)
        return found[:MAX_SHOWN_EVENTS]

    def counts(self) -> Dict[str, EventCount]:
        """Return the counts by functor."""
        return {
            "others" if key is None else str(key): EventCount(kind.number, int(kind.end))
            for key, kind in list(self._kinds.items())
        }

    def find(self, serial: int) -> Optional[Term]:
        """Return an event as a term to explain, ``event(Term,[T1,T2])``; None where it is no longer kept."""
        for kind in list(self._kinds.values()):
            for event in kind.kept.copy():
                if event.serial == serial and event.whole:
                    term = read_term(event.text, self._engine.operators, "event").term
                    stamps = make_list([timestamps.datime(event.start), timestamps.datime(event.end)])
                    return (_ASKED, term, stamps)
        return None


def event_beginning(show: Any, term: Term) -> Tuple[str, bool]:
    """Return the beginning of an event's text, and whether it is all of it; long lists are not even made."""
    left = [MAX_EVENT_PARTS]
    text = show(_cut(term, left, MAX_EVENT_DEPTH))
    return beginning(text, MAX_EVENT_CHARACTERS), left[0] > 0 and len(text) <= MAX_EVENT_CHARACTERS


def _cut(term: Term, left: List[int], depth: int) -> Term:
    """Return a term with dots in place of what is too much; ``left`` is 0 then."""
    if term.__class__ is Lazy and term.made is None and term.functor is CONS:
        left[0] = 0  # the numbers of an array
        return _CUT
    term = deref(term)
    if term is NOT_READ:
        return _dots(left)
    if term.__class__ is not tuple:
        return term if _is_short(term) else _dots(left)
    if left[0] <= 0 or depth == 0 or len(term) > MAX_EVENT_PARTS:
        return _dots(left)
    if term[0] is CONS:
        return _cut_list(term, left, depth)
    left[0] -= 1
    return (term[0], *[_cut(part, left, depth - 1) for part in term[1:]])


def _is_short(term: Any) -> bool:
    """Tell whether an atom, a text or a number is one that can be written out."""
    if term.__class__ is int:
        return bool(term.bit_length() <= MAX_EVENT_CHARACTERS)
    return (
        len(getattr(term, "name", "")) <= MAX_EVENT_CHARACTERS
        and len(getattr(term, "text", "")) <= MAX_EVENT_CHARACTERS
    )


def _cut_list(term: Any, left: List[int], depth: int) -> Term:
    items: List[Term] = []
    while term.__class__ is tuple and term[0] is CONS and left[0] > 0:
        left[0] -= 1
        items.append(_cut(term[1], left, depth - 1))
        term = deref(term[2])
    if term.__class__ is tuple and term[0] is CONS:
        return make_list([*items, _CUT])
    found = term if term is NIL else _cut(term, left, depth - 1)
    for item in reversed(items):
        found = (CONS, item, found)
    return found


def _dots(left: List[int]) -> Term:
    left[0] = 0
    return _CUT


LOOKS = 5
"""Looks over which rates are taken."""

MAX_SHOWN_TOPICS = 100
"""Topics that are shown."""

Json = Dict[str, Any]


class TopicLook(NamedTuple):
    """A subscribed topic.

    Attributes:
        name: its name.
        kind: the type of its messages.
        messages: how many have come; None where whoever receives them does not say.
        publishers: how many there are; None where that is not known.
        dropped: how many messages were not taken; None where that is not known.
        age: how many seconds ago the last one came; None where there was none.
        lag: by how many seconds it came later than its stamp says; None where that is not known.
        event: what its events are called, where that is not the type's.
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
        """The name of its events."""
        return self.event or functor_name(self.kind)


class DashboardSource(NamedTuple):
    """What a page is about.

    Attributes:
        engine: the running program.
        title: what to call it.
        topics: gives the topics that it subscribes.
        queries: whether those who have the page may ask.
    """

    engine: Engine
    title: str
    topics: Callable[[], Sequence[TopicLook]] = tuple
    queries: bool = False


class Snapshots:
    """Looks at an engine again and again.

    Args:
        source: what is looked at.
        clock: gives seconds.
    """

    def __init__(self, source: DashboardSource, clock: Callable[[], float] = time.monotonic):
        self._source = source
        self._engine = source.engine
        self._clock = clock
        self.events = RecentEvents(source.engine)
        self._looks: Deque[Tuple[float, Dict[str, int]]] = deque(maxlen=LOOKS + 1)
        self._topics: List[GraphTopic] = []
        self._graph_key: object = None
        self.graph: Json = {}

    def begin(self) -> None:
        """Forget what rates were taken from: there was nobody to look for a while."""
        self._looks.clear()

    def take(self) -> Json:
        """Return what there is to see now."""
        status = self._engine.status()
        topics = list(self._source.topics())[:MAX_SHOWN_TOPICS]
        counts = self.events.counts()
        numbers = {"taken": status.taken, "fired": status.fired}
        numbers.update({f"rule:{at}": rule.fired for at, rule in enumerate(status.rules)})
        numbers.update({f"memory:{one.id}": one.added for one in status.memories})
        for one in status.subscriptions:
            name = f"output:{beginning(one.topic)}"
            numbers[name] = numbers.get(name, 0) + one.sent
        numbers.update({f"event:{key}": one.number for key, one in counts.items()})
        rows = [self._topic(one, counts, status.now, numbers) for one in topics]
        self._draw([GraphTopic(one.name, one.event_name) for one in topics])
        return {
            "title": self._source.title,
            "queries": self._source.queries,
            "explains": records_origins(self._engine),
            "watching": self.events.watching,
            "memory": resident_bytes(),
            "rates": self._rates(numbers),
            "topics": rows,
            "events": [
                {**one._asdict(), "start": one.start / SECOND, "end": one.end / SECOND}
                for one in self.events.look()
            ],
            **_shown(status),
        }

    def _topic(self, one: TopicLook, counts: Any, now: int, numbers: Dict[str, int]) -> Json:
        """Return what is shown of a topic: where whoever receives it tells nothing, what its events tell."""
        row = one._asdict()
        name = one.event_name
        found = [count for key, count in counts.items() if key.rpartition("/")[0] == name]
        number = one.messages
        if number is None and found:
            number = sum(count.number for count in found)
            row["age"] = (now - max(count.end for count in found)) / SECOND
        if number is not None:
            numbers[f"topic:{one.name}"] = number
        row["messages"] = number
        return row

    def _rates(self, numbers: Dict[str, int]) -> Dict[str, float]:
        """Return by how much the numbers have grown a second."""
        now = self._clock()
        self._looks.append((now, numbers))
        then, before = self._looks[0]
        if now <= then:
            return {}
        return {
            name: max(0.0, round((number - before[name]) / (now - then), 2))
            for name, number in numbers.items()
            if name in before
        }

    def _draw(self, topics: List[GraphTopic]) -> None:
        """Draw the program anew where it has changed."""
        key = graph_key(self._engine, topics)
        if key != self._graph_key:
            self._graph_key = key
            self.graph = _graph(program_graph(self._engine, topics))


def _graph(graph: Graph) -> Json:
    return {
        "nodes": [node._asdict() for node in graph.nodes],
        "edges": [edge._asdict() for edge in graph.edges],
        "left_out": graph.left_out,
    }


_INSTANTS = frozenset(("now", "next_alarm", "last_fired", "oldest", "newest", "since", "instant", "behind"))


def _shown(status: Status) -> Json:
    """Return a status with seconds in place of nanoseconds, which JavaScript's numbers cannot hold."""

    def seconds(value: Any, name: str = "") -> Any:
        if isinstance(value, dict):
            return {key: seconds(part, key) for key, part in value.items()}
        if isinstance(value, list):
            return [seconds(part) for part in value]
        return value / SECOND if name in _INSTANTS and value is not None else value

    return {"status": seconds(status.json())}


log = logging.getLogger("retalis")

MAX_OPEN_PAGES = 8
"""Pages that may be open at once."""

PERIOD = 1.0
"""Seconds from one look to the next."""


class Client:
    """An open page: the newest numbers wait for it, older ones that it did not take in time are gone.

    Attributes:
        events: whether it shows the last events.
        graph: the one that it has been given last.
    """

    def __init__(self, events: bool) -> None:
        self.events = events
        self.graph: Any = None
        self._drawn = self._look = b""
        self._ready = asyncio.Event()

    def put(self, look: bytes, drawn: bytes = b"") -> None:
        """Have numbers sent next, and a graph before, in place of those that wait."""
        self._look = look
        self._drawn = drawn or self._drawn
        self._ready.set()

    def end(self) -> None:
        """Have nothing sent any more."""
        self._look = self._drawn = b""
        self._ready.set()

    async def next(self) -> bytes:
        """Return what is to be sent next; nothing where the page is closed."""
        await self._ready.wait()
        self._ready.clear()
        data = self._drawn + self._look
        self._look = self._drawn = b""
        return data


class LiveUpdates:
    """All open pages. Everything here runs in the thread of the server.

    Args:
        snapshots: give what is shown.
        period: seconds from one look to the next.
    """

    def __init__(self, snapshots: Snapshots, period: float = PERIOD):
        self._snapshots = snapshots
        self._period = period
        self._clients: List[Client] = []
        self._work: Optional[asyncio.Task[None]] = None
        self._failed = ""

    def enter(self, events: bool) -> Optional[Client]:
        """Return a page that has been opened; None where there are too many.

        Args:
            events: whether it shows the last events, for which the engine is listened to.
        """
        if len(self._clients) >= MAX_OPEN_PAGES:
            return None
        client = Client(events)
        self._clients.append(client)
        self._watch()
        if self._work is None:
            self._snapshots.begin()
            self._work = asyncio.ensure_future(self._run())
        return client

    def leave(self, client: Client) -> None:
        """Forget a page that has been closed; leaving twice is no error."""
        if client in self._clients:
            self._clients.remove(client)
            self._watch()

    def close(self) -> None:
        """Forget all pages."""
        for client in self._clients:
            client.end()
        self._clients = []
        self._watch()

    def _watch(self) -> None:
        self._snapshots.events.watch(any(client.events for client in self._clients))

    async def _run(self) -> None:
        """Look and tell all pages until none is open."""
        while self._clients:
            try:
                self._tell()
            except Exception as error:  # the pages that are open stay so; the next look may succeed
                if repr(error) != self._failed:
                    self._failed = repr(error)
                    log.exception("internal error: the dashboard cannot look at the program")
            await asyncio.sleep(self._period)
        self._work = None

    def _tell(self) -> None:
        look = _sent("look", self._snapshots.take())
        graph = self._snapshots.graph
        drawn = b""
        for client in list(self._clients):
            if client.graph is graph:
                client.put(look)
                continue
            drawn = drawn or _sent("graph", graph)
            client.graph = graph
            client.put(look, drawn)


def _sent(event: str, data: Dict[str, Any]) -> bytes:
    """Return data as an event of a stream."""
    return f"event: {event}\ndata: {printable_json(data)}\n\n".encode()
