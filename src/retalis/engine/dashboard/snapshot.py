"""What the page shows, as it is now: texts and numbers, ready for JSON."""

import time
from collections import deque
from typing import Any, Callable, Deque, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation import beginning
from ...messages import functor_name
from ...prolog.machine import resident_bytes
from ...prolog.terms import SECOND
from .. import Engine, Status
from ..drawing import Graph, GraphTopic, graph_key, program_graph
from ..explaining import records_origins
from .recent import RecentEvents

LOOKS = 5
"""Looks over which rates are taken."""

MOST_TOPICS = 100
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
        topics = list(self._source.topics())[:MOST_TOPICS]
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
