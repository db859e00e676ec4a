"""What the page asks on demand: why an event happened, and goals where that is allowed."""

import asyncio
import threading
from typing import Any, Callable, Dict, List

from ...foundation import RetalisError, SyntaxFault, beginning
from ...prolog.machine import Limits
from .. import ask
from ..explaining import explain, records_origins
from .snapshot import DashboardSource, Snapshots

AT_ONCE = 2
"""Answers that are looked for at once: each may hold a thread until the engine has time."""

MOST_SOLUTIONS = 100
"""Solutions of a query."""

LARGEST_ANSWER = 100_000
"""Characters of its solutions together."""

LONGEST_GOAL = 5_000
"""Characters of its text."""

LIMITS = Limits(seconds=5.0, output_megabytes=None)
"""What a query may use; the engine's own limits hold besides."""

MOST_LINES = 500
"""Lines of an explanation."""

LONGEST_LINE = 1_000
"""Characters of one."""

LONGEST_ERROR = 1_000

NOT_RECORDED = "what events come from is not recorded: start the node with explain:=true"
NOT_ALLOWED = "queries are not allowed: start the node with dashboard_queries:=true"
GONE = "this event is no longer kept"
BUSY = "other answers are still awaited: the engine is busy"

Json = Dict[str, Any]


class Answers:
    """Answers what the page asks, each in a thread of its own: the engine may be busy.

    Args:
        source: is asked.
        snapshots: have the events that can be explained.
    """

    def __init__(self, source: DashboardSource, snapshots: Snapshots):
        self._engine = source.engine
        self._queries = source.queries
        self._events = snapshots.events
        self._free = threading.BoundedSemaphore(AT_ONCE)

    async def run(self, work: Callable[[], Json]) -> Json:
        """Return what some work returns, or why not as ``error``."""
        if not self._free.acquire(blocking=False):
            return {"error": BUSY}
        loop = asyncio.get_event_loop()
        done: asyncio.Future[Json] = loop.create_future()

        def deliver(found: Json) -> None:
            if not done.done():  # somebody has closed the page
                done.set_result(found)

        def run() -> None:
            found: Json = {"error": "internal error"}
            try:
                found = work()
            except SyntaxFault as fault:
                found = {"error": beginning(fault.brief(), LONGEST_ERROR)}
            except RetalisError as error:
                found = {"error": beginning(error.brief(), LONGEST_ERROR)}
            finally:
                self._free.release()
                if not loop.is_closed():
                    loop.call_soon_threadsafe(deliver, found)

        threading.Thread(target=run, daemon=True, name="dashboard answer").start()
        return await done

    def explain(self, asked: Json) -> Json:
        """Say why one of the last events happened; it is named by its number, so that no text is read."""
        if not records_origins(self._engine):
            return {"error": NOT_RECORDED}
        serial: Any = asked.get("serial")
        event = self._events.find(serial) if serial.__class__ is int else None
        if event is None:
            return {"error": GONE}
        lines: List[str] = []
        for tree in explain(self._engine, event).lines:
            for line in tree.indented():
                if len(lines) == MOST_LINES:
                    return {"lines": [*lines, "..."]}
                lines.append(line[:LONGEST_LINE])
        return {"lines": lines}

    def query(self, asked: Json) -> Json:
        """Return the first solutions of a goal as texts."""
        if not self._queries:
            return {"error": NOT_ALLOWED}
        goal = asked.get("goal")
        if not isinstance(goal, str) or len(goal) > LONGEST_GOAL:
            return {"error": f"expected a goal of {LONGEST_GOAL} characters at most"}
        found = ask(self._engine, goal, MOST_SOLUTIONS, LIMITS, LARGEST_ANSWER)
        solutions = [[[value.name, value.text] for value in solution] for solution in found.solutions]
        return {"solutions": solutions, "complete": found.complete}
