"""The page's server: a thread with a loop of its own, on the loopback address."""

import asyncio
import socket
import threading
from errno import EADDRINUSE
from typing import Any, List

from ..foundation.errors import UsageError
from .request_handlers import Answers
from .view_model import PERIOD, DashboardSource, LiveUpdates, Snapshots

ADDRESS = "127.0.0.1"

DASHBOARD_PORT = 8088
"""The port where none is given."""

_PORTS = 1 << 16
"""Number of ports that there are."""

BACKLOG = 16
"""Connections that may wait to be taken."""


class Dashboard:
    """A page that shows a running program, until `close`.

    Nothing is looked at while nobody has it open.

    Args:
        source: what is shown.
        port: where; 0 for any that is free.
        tries: ports that are tried, from this one on.
        period: seconds from one look to the next.

    Attributes:
        port: where it is.

    Raises:
        UsageError: where the ports are taken, or tornado is not installed.
    """

    def __init__(
        self, source: DashboardSource, port: int = DASHBOARD_PORT, period: float = PERIOD, tries: int = 1
    ):
        try:
            from .request_handlers import server  # noqa: PLC0415 - tornado is needed for this alone
        except ImportError as error:
            raise UsageError(f"the dashboard needs the package tornado (python3-tornado): {error}") from None
        self._server = server
        self._source = source
        self._period = period
        self._sockets = _listen(port, tries)
        self.port: int = self._sockets[0].getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True, name="dashboard")
        self._thread.start()

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{ADDRESS}:{self.port}/"

    def close(self) -> None:
        """Stop serving; closing twice is no error."""
        if not self._loop.is_closed():
            try:
                self._loop.call_soon_threadsafe(self._loop.stop)
            except RuntimeError:
                pass  # it has just ended
        self._thread.join(5)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        snapshots = Snapshots(self._source)
        streams = LiveUpdates(snapshots, self._period)
        answers = Answers(self._source, snapshots)
        server = self._server(streams, answers)
        server.add_sockets(self._sockets)
        try:
            self._loop.run_forever()
        finally:
            server.stop()
            streams.close()
            self._loop.run_until_complete(_settle())
            self._loop.close()


async def _settle() -> None:
    """Let what is under way end."""
    me = asyncio.current_task()
    others = [task for task in asyncio.all_tasks() if task is not me]
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


def _listen(port: int, tries: int) -> List[Any]:
    """Return the socket on which requests come: on a port, or the next ones if it is taken.

    Raises:
        UsageError: if there is none to be had.
    """
    ports = range(port, max(port + 1, min(port + tries, _PORTS)))
    for wanted in ports:
        try:
            return [_bound(wanted)]
        except (OSError, OverflowError) as error:
            if getattr(error, "errno", None) != EADDRINUSE or wanted == ports[-1]:
                tried = str(port) if wanted == port else f"{port} to {wanted}"
                reason = getattr(error, "strerror", None) or error
                raise UsageError(f"the dashboard cannot have port {tried} of {ADDRESS}: {reason}") from None
    raise AssertionError("at least one port is tried")


def _bound(port: int) -> socket.socket:
    """Return a socket that listens on a port."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((ADDRESS, port))
        listening.listen(BACKLOG)
        listening.setblocking(False)
    except BaseException:
        listening.close()
        raise
    return listening
