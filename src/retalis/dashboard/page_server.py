"""Web server of the dashboard: an asyncio loop in a thread, bound to the loopback address."""

import asyncio
import socket
import threading
from concurrent.futures import Future
from errno import EADDRINUSE

from ..foundation.errors import UsageError
from .view_model import UPDATE_PERIOD_SECONDS, DashboardSource, LiveUpdates, Snapshots

ADDRESS = "127.0.0.1"
"""Loopback address: other machines cannot connect."""

DASHBOARD_PORT = 8088
"""Default port."""

_PORT_END = 1 << 16
"""First number above the TCP ports."""

BACKLOG = 16
"""Limit for connections that wait to be accepted."""


class Dashboard:
    """Web page that shows a running program, served until `close`.

    While no page is open, the engine is not observed.

    Args:
        port: port to bind; 0 for any free one.
        period: seconds between two updates.
        port_count: number of ports to try, from ``port`` on.

    Attributes:
        port: the bound port.

    Raises:
        UsageError: if no port can be bound, or tornado is not installed.
    """

    def __init__(
        self,
        source: DashboardSource,
        port: int = DASHBOARD_PORT,
        period: float = UPDATE_PERIOD_SECONDS,
        port_count: int = 1,
    ):
        try:
            from .request_handlers import create_server  # noqa: PLC0415 - tornado is an optional dependency
        except ImportError as error:
            raise UsageError(f"the dashboard needs the package tornado (python3-tornado): {error}") from None
        self._create_server = create_server
        self._source = source
        self._period = period
        # The port is bound here and not in the thread, so that the caller gets the error.
        self._socket = _listen_on_free_port(port, port_count)
        self.port: int = self._socket.getsockname()[1]
        self._loop = asyncio.new_event_loop()
        started: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(started,), daemon=True, name="dashboard")
        self._thread.start()
        try:
            started.result()
        except BaseException:
            self.close()
            raise

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{ADDRESS}:{self.port}/"

    def close(self) -> None:
        """Stop the server; further calls have no effect."""
        if not self._loop.is_closed():
            try:
                self._loop.call_soon_threadsafe(self._loop.stop)
            except RuntimeError:
                # The loop has been closed meanwhile.
                pass
        self._thread.join(5)

    def _run(self, started: "Future[None]") -> None:
        """Serve until `close`; ``started`` receives the end of the start, or its error."""
        # Everything that uses the loop is created in its own thread: asyncio objects are not thread-safe.
        asyncio.set_event_loop(self._loop)
        try:
            snapshots = Snapshots(self._source)
            live_updates = LiveUpdates(snapshots, self._period)
            server = self._create_server(self._source, snapshots, live_updates)
            server.add_socket(self._socket)
        except BaseException as error:  # raised by the constructor
            self._socket.close()
            self._loop.close()
            started.set_exception(error)
            return
        started.set_result(None)
        try:
            self._loop.run_forever()
        finally:
            server.stop()
            live_updates.close()
            self._loop.run_until_complete(_cancel_tasks())
            # A browser keeps connections open for further requests. If they stayed open, a page would send the next
            # request to this server, which does not answer, although another one listens on the port.
            server.close_streams()
            self._loop.close()


async def _cancel_tasks() -> None:
    """Cancel all tasks, and wait for their end."""
    current = asyncio.current_task()
    other_tasks = [task for task in asyncio.all_tasks() if task is not current]
    # Open pages wait for data in tasks, which would keep the loop from ending.
    for task in other_tasks:
        task.cancel()
    await asyncio.gather(*other_tasks, return_exceptions=True)


def _listen_on_free_port(port: int, port_count: int) -> socket.socket:
    """Return a listening socket on a port, or on one of the next ones if it is in use.

    Raises:
        UsageError: if all ports are in use, or a port cannot be bound for another reason.
    """
    ports = range(port, max(port + 1, min(port + port_count, _PORT_END)))
    for candidate in ports:
        try:
            return _bind_socket(candidate)
        except (OSError, OverflowError) as error:
            # Any other error, such as missing permissions, would occur for the next ports, too.
            if getattr(error, "errno", None) != EADDRINUSE or candidate == ports[-1]:
                tried_ports = str(port) if candidate == port else f"{port} to {candidate}"
                reason = getattr(error, "strerror", None) or error
                raise UsageError(
                    f"the dashboard cannot bind port {tried_ports} of {ADDRESS}: {reason}"
                ) from None
    raise AssertionError("at least one port is tried")


def _bind_socket(port: int) -> socket.socket:
    server_socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        # A port with connections in state TIME_WAIT can be bound again after a restart of the program.
        server_socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server_socket.bind((ADDRESS, port))
        server_socket.listen(BACKLOG)
        server_socket.setblocking(False)
    except BaseException:
        server_socket.close()
        raise
    return server_socket
