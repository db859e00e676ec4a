"""What happens in a run over a bag, as plain records that turn into JSON: for files, and for pictures of it."""

from itertools import islice
from typing import Callable, Dict, List, NamedTuple, Union

from ...events.knowledge import OF_MEMORIES
from ...prolog.syntax import canonical_text
from ...prolog.terms import Term
from .. import parts_of
from .playback import Output, Playback

Line = Dict[str, Union[None, int, str, List[str]]]
"""A record; its kind is the name of its first field. Instants are nanoseconds since the epoch, terms are texts."""

MOST_WAITING = 1000
"""Queries that are looked at; where more wait at once, the others are not told of."""


class _Wait(NamedTuple):
    """A query that waits: its event, the ids of the memories, and since when by the bag's time."""

    event: str
    memories: List[str]
    start: int


class RunLook:
    """Looks at a run and tells of events, outputs and waits as they come, and of memories at the end.

    A wait of a query lasts from the message that had it wait to the one that it was waiting for, by the bag's time.

    Args:
        playback: whose events, queries and memories are looked at.
        tell: takes each record.
    """

    def __init__(self, playback: Playback, tell: Callable[[Line], None]):
        self._engine = playback.engine
        self._knowledge = parts_of(playback.engine).knowledge
        self._now = playback.clock.now
        self._tell = tell
        self._waits: Dict[int, _Wait] = {}
        self._engine.on_event(self._event)

    def _event(self, term: Term, start: int, end: int) -> None:
        if term.__class__ is not tuple or term[0] not in OF_MEMORIES:
            self._tell({"event": canonical_text(term), "start": int(start), "end": int(end)})

    def output(self, output: Output) -> None:
        """Tell of an output."""
        self._tell(output_line(output))

    def look(self) -> None:
        """Look which queries wait; to be called after each message."""
        waiting = self._knowledge.waiting
        if not self._waits and not len(waiting):
            return
        now = int(self._now())
        there = {one[0]: one for one in islice(waiting, MOST_WAITING)}
        for order in [one for one in self._waits if one not in there]:
            self._end(self._waits.pop(order), now)
        for order, (_, question, values, _, _, missing) in there.items():
            if order not in self._waits:
                memories = [canonical_text(instance.id) for instance, _ in missing]
                self._waits[order] = _Wait(canonical_text(question.event(values)), memories, now)

    def _end(self, wait: _Wait, now: int) -> None:
        self._tell({"wait": wait.event, "memories": wait.memories, "start": wait.start, "end": now})

    def finish(self) -> None:
        """Tell of the queries that still wait, and of what the memories hold."""
        now = int(self._now())
        for wait in self._waits.values():
            self._end(wait, now)
        self._waits.clear()
        for memory in self._engine.status(MOST_WAITING).memories:
            self._tell(
                {
                    "memory": memory.id,
                    "pattern": memory.event,
                    "size": memory.size,
                    "records": memory.records,
                    "taken": memory.added,
                    "start": memory.oldest,
                    "end": memory.newest,
                }
            )


def output_line(output: Output) -> Line:
    """Return what is told of an output."""
    name = None if output.id is None else canonical_text(output.id)
    return {
        "output": canonical_text(output.term),
        "topic": output.topic,
        "id": name,
        "time": int(output.time),
    }
