"""The live numbers of all open pages: taken once a second while there is one, and not at all otherwise."""

import asyncio
import logging
from typing import Any, Dict, List, Optional

from ...foundation import printable_json
from .snapshot import Snapshots

log = logging.getLogger("retalis")

MOST_PAGES = 8
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


class Streams:
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
        if len(self._clients) >= MOST_PAGES:
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
