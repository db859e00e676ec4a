"""Limits on connections to a node: the handshakes at its TCPROS port and the requests at its XML-RPC port.

rospy reads the header of a new TCPROS connection in the thread that accepts connections, so one idle client holds up
all others, and its XML-RPC server starts a thread for each connection, without a limit. `limit_connections` replaces
both servers of rospy by subclasses. A `ConnectionTable` stores the connections of a server that may be closed in the
order of their deadlines, with a limit per address and in total. A connection beyond a limit closes the oldest one, so
a client that sends its header at once is served, whatever other clients do.

A connection is closed by shutting down its socket: its owner, the loop or a thread, then reads the end of the stream
and closes it. A socket that another thread uses must not be closed, because its number may be reused at once.
"""

import errno
import logging
import resource
import selectors
import socket
import threading
import time
from collections import Counter, OrderedDict
from struct import unpack
from typing import Any, Callable, Dict, NamedTuple, Optional, Tuple
from weakref import WeakSet

import rosgraph.network
import rosgraph.xmlrpc
import rospy
from rospy.impl import tcpros_base

from ..foundation.errors import printable, shorten

MAX_LISTEN_BACKLOG = 1024
"""Limit for connections that wait until the node accepts them, if `net.core.somaxconn` allows it.

Further connections are not answered; the client's system tries again after 1, 3 and 7 seconds.
"""

HANDSHAKE_TIMEOUT_SECONDS = 5.0
"""Seconds from accepting a TCPROS connection until it is closed if its handshake has not been completed."""

MAX_HANDSHAKES = 256
MAX_HANDSHAKES_PER_ADDRESS = 192
"""Limits for concurrent handshakes. The second is lower, so that one address cannot exclude the others."""

MAX_HEADER_BYTES = 1 << 18
"""Limit for the size of a connection's header, which may contain the definition of a message type."""

REQUEST_TIMEOUT_SECONDS = 30.0
"""Seconds from waiting for a request until its XML-RPC connection is closed, including the time to answer it."""

MAX_REQUEST_CONNECTIONS = 128
MAX_REQUEST_CONNECTIONS_PER_ADDRESS = 96
"""Limits for open XML-RPC connections, in total and of one address. Each connection has a thread."""

MAX_REQUEST_BYTES = 1 << 18
"""Limit for the size of an XML-RPC request."""

REPORT_DELAY_SECONDS = 10.0
"""Seconds after the first closed connection until one line reports all of them."""

MAX_REASONS = 5
MAX_REASON_CHARACTERS = 400
"""Limits for the reasons in one line and the characters of each reason, which may contain text of the client."""

DEADLINE_CHECK_SECONDS = 1.0
"""Longest interval in seconds between two checks of deadlines and of the node's shutdown."""

_NO_RESOURCES = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
"""Errors of ``accept`` that occur again until a connection has been closed."""

OWNER_CLOSE_PAUSE_SECONDS = 0.001
NO_DESCRIPTORS_PAUSE_SECONDS = 0.1
"""Seconds until the next attempt to accept a connection without free file descriptors.

The first applies if a connection could be closed, the second otherwise.
"""

MonotonicClock = Callable[[], float]
"""Returns a monotonic time in seconds."""

Address = Tuple[Any, ...]
"""Host and port; further parts for IPv6."""


class ClosedConnectionCounter:
    """Counter of the connections that were closed by a limit, which logs one line per interval.

    Args:
        server: name of the server in the log.
        log_warning: receives the line.
        now: clock in seconds.

    Attributes:
        total: number of closed connections.
    """

    def __init__(
        self,
        server: str,
        log_warning: Callable[[str], object] = rospy.logwarn,
        now: MonotonicClock = time.monotonic,
    ):
        self._server = server
        self._log_warning = log_warning
        self._now = now
        self._lock = threading.Lock()
        self._reasons: Dict[str, int] = Counter()
        self._last_address = ""
        self._report_time = 0.0
        self.total = 0

    def count(self, reason: str, address: str) -> None:
        """Count a closed connection."""
        with self._lock:
            if not self._reasons:
                self._report_time = self._now() + REPORT_DELAY_SECONDS
            reason = printable(shorten(reason, MAX_REASON_CHARACTERS))
            # A client can vary the reason with each connection: neither memory nor the line may grow with their
            # number.
            if reason not in self._reasons and len(self._reasons) >= MAX_REASONS:
                reason = "other reasons"
            self._reasons[reason] += 1
            self._last_address = address
            self.total += 1

    def report(self) -> None:
        """Log the counts if `REPORT_DELAY_SECONDS` have passed since the first connection."""
        with self._lock:
            if not self._reasons or self._now() < self._report_time:
                return
            reasons = ", ".join(f"{reason} ({count})" for reason, count in self._reasons.items())
            total = sum(self._reasons.values())
            self._reasons.clear()
        # Outside of the lock: a log handler may block, and `count` is called while connections are accepted.
        self._log_warning(
            f"{self._server}: {total} connections closed ({self.total} so far),"
            f" the last one of {self._last_address}: {reasons}"
        )


class _OpenConnection(NamedTuple):
    """Address of the client of an open connection, and the time at which the connection will be closed."""

    address: str
    deadline: float


class ConnectionTable:
    """The connections of a server that may be closed, the one with the earliest deadline first.

    Args:
        timeout: seconds until the deadline of a connection.
        max_connections: limit for all connections.
        max_per_address: limit for the connections of one address.
        closed_counter: counts the closed connections.
        now: clock in seconds.
        allows_idle: whether a connection may be idle, so that its end at the deadline is not counted.
    """

    def __init__(
        self,
        timeout: float,
        max_connections: int,
        max_per_address: int,
        closed_counter: ClosedConnectionCounter,
        now: MonotonicClock = time.monotonic,
        allows_idle: bool = False,
    ):
        self._timeout = timeout
        self._max_connections = max_connections
        self._max_per_address = max_per_address
        self._closed_counter = closed_counter
        self._now = now
        self._allows_idle = allows_idle
        self._lock = threading.Lock()
        self._entries: OrderedDict[socket.socket, _OpenConnection] = OrderedDict()
        self._counts_by_address: Dict[str, int] = Counter()

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, sock: socket.socket, address: str) -> None:
        """Add a connection; beyond a limit, close the oldest one of its address or of all."""
        with self._lock:
            if self._counts_by_address[address] >= self._max_per_address:
                oldest = next(
                    candidate for candidate, entry in self._entries.items() if entry.address == address
                )
                self._close(oldest, f"more than {self._max_per_address} unfinished ones of one address")
            elif len(self._entries) >= self._max_connections:
                self._close_oldest(f"more than {self._max_connections} unfinished ones")
            # All deadlines are equally far away, so insertion order is the order of the deadlines.
            self._entries[sock] = _OpenConnection(address, self._now() + self._timeout)
            self._counts_by_address[address] += 1

    def renew(self, sock: socket.socket) -> None:
        """Set a new deadline for a connection that is still in the table."""
        with self._lock:
            entry = self._entries.pop(sock, None)
            if entry is not None:
                self._entries[sock] = entry._replace(deadline=self._now() + self._timeout)

    def remove(self, sock: socket.socket) -> None:
        """Remove a connection that has been finished or closed."""
        with self._lock:
            self._remove(sock)

    def expire(self) -> None:
        """Close the connections whose deadline has passed."""
        with self._lock:
            now = self._now()
            while self._entries and next(iter(self._entries.values())).deadline <= now:
                self._close_oldest("" if self._allows_idle else f"not finished within {self._timeout:g} s")

    def free_descriptor(self) -> None:
        """Close the oldest connection because the process has no free file descriptor, and wait for its owner.

        Without a connection to close, wait until another part of the process may have closed a file.
        """
        with self._lock:
            pause = OWNER_CLOSE_PAUSE_SECONDS if self._entries else NO_DESCRIPTORS_PAUSE_SECONDS
            if self._entries:
                self._close_oldest("no more files can be opened")
        # The descriptor becomes free when the owner closes the socket. Without a pause, the accept loop would retry
        # continuously.
        time.sleep(pause)

    def _close_oldest(self, reason: str) -> None:
        self._close(next(iter(self._entries)), reason)

    def _close(self, sock: socket.socket, reason: str) -> None:
        if reason:
            self._closed_counter.count(reason, self._entries[sock].address)
        self._remove(sock)
        _shut_down(sock)

    def _remove(self, sock: socket.socket) -> None:
        entry = self._entries.pop(sock, None)
        if entry is None:
            return
        # The count of an address is removed with its last connection: otherwise the table would grow with each new
        # address.
        self._counts_by_address[entry.address] -= 1
        if not self._counts_by_address[entry.address]:
            del self._counts_by_address[entry.address]


def _shut_down(sock: socket.socket) -> None:
    """End the stream of a socket in both directions, which wakes a thread that reads or writes it."""
    try:
        sock.shutdown(socket.SHUT_RDWR)
    except OSError:
        # The peer or the owner has closed it already.
        pass


class HeaderReader:
    """Incremental reader of one connection's header, which reads no byte beyond the header."""

    def __init__(self, sock: socket.socket):
        self._socket = sock
        self._data = bytearray()
        self._expected_size = 4

    def read(self) -> Optional[bytes]:
        """Read the available bytes; return the header with its length if it is complete.

        Raises:
            OSError: if the connection has ended before the header was complete.
            ValueError: if the header is longer than `MAX_HEADER_BYTES`.
        """
        while True:
            try:
                data = self._socket.recv(self._expected_size - len(self._data))
            except BlockingIOError:
                return None
            if not data:
                raise ConnectionResetError("the connection ended before its header was complete")
            self._data += data
            if len(self._data) < self._expected_size:
                continue
            # The first 4 bytes are the length of the rest. They are part of the result, as rospy's parser expects
            # them.
            if self._expected_size > 4:
                return bytes(self._data)
            (length,) = unpack("<I", self._data)
            if length > MAX_HEADER_BYTES:
                raise ValueError(f"headers longer than {MAX_HEADER_BYTES} bytes")
            self._expected_size += length
            if not length:
                return bytes(self._data)


class EstablishedConnections:
    """The connections after their handshakes, until rospy drops their sockets.

    Each needs a thread and a file descriptor. Their limit is derived from the process's limit for open files; one
    address may have at most three quarters of them, so that it cannot exclude the others.
    """

    def __init__(self, max_connections: Optional[int] = None):
        if max_connections is None:
            # RLIM_INFINITY is -1. Three eighths of the files leave the others to outgoing connections and to goals.
            file_limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
            max_connections = 3 * (min(file_limit, 2048) if file_limit >= 0 else 2048) // 8
        self._max_connections = max_connections
        self._max_per_address = 3 * max_connections // 4
        self._lock = threading.Lock()
        self._sockets_by_address: Dict[str, WeakSet[socket.socket]] = {}

    @property
    def limits(self) -> str:
        """The limits as text for a message."""
        return f"{self._max_per_address} of one address, {self._max_connections} in all"

    def add(self, sock: socket.socket, address: str) -> bool:
        """Add a connection; return False if a limit is reached."""
        with self._lock:
            # rospy does not report the end of a connection. The descriptor of a closed socket is -1, and a socket
            # that was garbage collected has left its weak set.
            counts = {}
            for known_address, sockets in list(self._sockets_by_address.items()):
                counts[known_address] = sum(1 for established in list(sockets) if established.fileno() >= 0)
                if not counts[known_address]:
                    del self._sockets_by_address[known_address]
            if (
                sum(counts.values()) >= self._max_connections
                or counts.get(address, 0) >= self._max_per_address
            ):
                return False
            self._sockets_by_address.setdefault(address, WeakSet()).add(sock)
            return True


# The bases of the following classes are `object` if this rospy has no such classes; `limit_connections` then leaves
# rospy unchanged.
class HandshakeServer(getattr(tcpros_base, "TCPServer", object)):  # type: ignore[misc]
    """rospy's server of the TCPROS port, with concurrent handshakes.

    One thread accepts connections and reads headers as their bytes arrive. A complete header is answered by rospy's
    handler, in a thread that ends with the handshake.
    """

    def _create_server_sock(self) -> socket.socket:
        sock: socket.socket = super()._create_server_sock()
        sock.listen(MAX_LISTEN_BACKLOG)
        return sock

    def run(self) -> None:
        """Serve until rospy shuts the server down; use rospy's loop if its internals are not the expected ones."""
        # The handler is a method of the `TCPROSServer` that has created this server.
        self._rospy_server: Any = getattr(self.inbound_handler, "__self__", None)
        if not all(hasattr(self._rospy_server, name) for name in _ROSPY_HANDLERS):
            _log_unexpected_internals()
            super().run()
            return
        self.is_shutdown = False
        self.closed_counter = ClosedConnectionCounter(f"TCPROS port {self.port}")
        self._handshakes = ConnectionTable(
            HANDSHAKE_TIMEOUT_SECONDS, MAX_HANDSHAKES, MAX_HANDSHAKES_PER_ADDRESS, self.closed_counter
        )
        self._established = EstablishedConnections()
        log = logging.getLogger("rosout")
        log.addFilter(self._is_logged)
        try:
            with selectors.DefaultSelector() as self._selector:
                self._serve(self.server_sock)
        finally:
            log.removeFilter(self._is_logged)

    def _serve(self, listening_socket: socket.socket) -> None:
        listening_socket.setblocking(False)
        self._selector.register(listening_socket, selectors.EVENT_READ)
        while not self.is_shutdown:
            has_new_connection = False
            # Headers that have arrived are read before the next connection is accepted. Otherwise a connection could
            # be closed in favour of a newer one although its header waits in the kernel's buffer.
            for key, _ in self._selector.select(DEADLINE_CHECK_SECONDS):
                # Only the listening socket is registered without data.
                if key.data is None:
                    has_new_connection = True
                else:
                    self._read(key.fileobj, *key.data)
            if has_new_connection:
                self._accept(listening_socket)
            self._handshakes.expire()
            self.closed_counter.report()

    def _is_logged(self, record: logging.LogRecord) -> bool:
        """Return whether a record is logged.

        rospy's error for a service client that ended without a request is counted instead.
        """
        if not str(record.msg).startswith("incoming connection failed"):
            return True
        self.closed_counter.count("ended before the request of a service", "a service's client")
        return False

    def _accept(self, listening_socket: socket.socket) -> None:
        try:
            sock, address = listening_socket.accept()
        except OSError as error:
            if error.errno in _NO_RESOURCES:
                self._handshakes.free_descriptor()
            # In the other cases the client has closed the connection, or the server is being shut down.
            return
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._handshakes.add(sock, address[0])
        self._selector.register(sock, selectors.EVENT_READ, (address, HeaderReader(sock)))

    def _read(self, sock: Any, address: Address, reader: HeaderReader) -> None:
        """Read available bytes of a header; if it is complete, start a thread that answers it."""
        try:
            header = reader.read()
            if header is None:
                return
            self._selector.unregister(sock)
            # rospy's handlers and transports expect a blocking socket.
            sock.setblocking(True)
            threading.Thread(
                target=self._answer, args=(sock, address, header), name="TCPROS handshake", daemon=True
            ).start()
        except (OSError, ValueError, RuntimeError) as error:
            if isinstance(error, ValueError):
                self.closed_counter.count(str(error), address[0])
            elif isinstance(error, RuntimeError):
                self.closed_counter.count("no more threads can be started", address[0])
            if sock in self._selector.get_map():
                self._selector.unregister(sock)
            self._handshakes.remove(sock)
            sock.close()

    def _answer(self, sock: socket.socket, address: Address, data: bytes) -> None:
        """Pass a connection to rospy's handler of topics or services; close it if the handler refuses it."""
        try:
            refusal = self._pass_to_rospy(sock, address, rosgraph.network.decode_ros_handshake_header(data))
            if refusal:
                rosgraph.network.write_ros_handshake_header(sock, {"error": refusal})
        except Exception as error:
            # rospy raises arbitrary exceptions for unexpected headers.
            refusal = f"handshake failed: {error}"
            self.closed_counter.count(refusal, address[0])
        finally:
            self._handshakes.remove(sock)
        if refusal:
            sock.close()

    def _pass_to_rospy(self, sock: socket.socket, address: Address, header: Dict[str, str]) -> str:
        """Pass a connection to rospy's handler; return the reason if rospy or a limit refuses it, otherwise ""."""
        if rospy.core.is_shutdown_requested():
            return "node shutting down"
        if not self._established.add(sock, address[0]):
            refusal = f"too many connections: expected at most {self._established.limits}"
            self.closed_counter.count(refusal, address[0])
            return refusal
        if "topic" in header:
            refusal = self._rospy_server.topic_connection_handler(sock, address, header)
        elif "service" in header:
            refusal = self._rospy_server.service_connection_handler(sock, address, header)
        else:
            refusal = "no topic or service name detected"
        if refusal:
            self.closed_counter.count(refusal, address[0])
        return refusal or ""


class RequestHandler(getattr(rosgraph.xmlrpc, "SilenceableXMLRPCRequestHandler", object)):  # type: ignore[misc]
    """Handler of the requests on one XML-RPC connection, with a deadline and a size limit for each request."""

    def handle_one_request(self) -> None:
        """Wait for a request and answer it."""
        self.server.connections.renew(self.request)
        super().handle_one_request()

    def do_POST(self) -> None:  # noqa: N802 - the name that http.server calls
        """Answer a request, unless its length is unknown or too large."""
        try:
            length = int(self.headers.get("content-length", ""))
        except ValueError:
            length = -1
        if 0 <= length <= MAX_REQUEST_BYTES:
            super().do_POST()
            return
        self.server.closed_counter.count(
            f"requests without a length, or longer than {MAX_REQUEST_BYTES} bytes", self.client_address[0]
        )
        self.close_connection = True
        self.send_error(413)

    def decode_request_content(self, data: bytes) -> Optional[bytes]:
        """Return the text of a request; refuse one with a document type declaration.

        Old versions of Expat expand the entities of a declaration without limit.
        """
        decoded: Optional[bytes] = super().decode_request_content(data)
        if decoded is None:
            # Refused already because of its encoding.
            return None
        # Without its zero bytes, text in UTF-16 or UTF-32 contains the word in ASCII.
        if b"<!DOCTYPE" in decoded.replace(b"\0", b"") or len(decoded) > MAX_REQUEST_BYTES:
            self.server.closed_counter.count(
                "requests with a document type, or too large", self.client_address[0]
            )
            self.close_connection = True
            self.send_error(400)
            return None
        return decoded


class RequestServer(getattr(rosgraph.xmlrpc, "ThreadingXMLRPCServer", object)):  # type: ignore[misc]
    """rospy's XML-RPC server, with limits for its connections and threads."""

    def __init__(self, *args: Any, **keywords: Any):
        super().__init__(*args, **keywords)
        self.socket.listen(MAX_LISTEN_BACKLOG)
        self.RequestHandlerClass = RequestHandler
        self.closed_counter = ClosedConnectionCounter(f"XML-RPC port {self.server_address[1]}")
        # The master and other nodes keep a connection open for their next request; they reconnect when it was closed.
        self.connections = ConnectionTable(
            REQUEST_TIMEOUT_SECONDS,
            MAX_REQUEST_CONNECTIONS,
            MAX_REQUEST_CONNECTIONS_PER_ADDRESS,
            self.closed_counter,
            allows_idle=True,
        )

    def get_request(self) -> Any:
        """Accept a connection."""
        try:
            return super().get_request()
        except OSError as error:
            if error.errno in _NO_RESOURCES:
                self.connections.free_descriptor()
            # The server's loop ignores the error and continues.
            raise

    def process_request(self, request: socket.socket, client_address: Address) -> None:
        """Start the thread of a connection."""
        self.connections.add(request, client_address[0])
        super().process_request(request, client_address)

    def shutdown_request(self, request: socket.socket) -> None:
        """Close a connection that has ended."""
        self.connections.remove(request)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Close the connections whose deadline has passed; the server's loop calls this twice a second."""
        super().service_actions()
        self.connections.expire()
        self.closed_counter.report()


_ROSPY_HANDLERS = ("topic_connection_handler", "service_connection_handler")

_ROSPY_INTERNALS = (
    (tcpros_base, "TCPServer", ("run", "start", "shutdown", "_create_server_sock")),
    (tcpros_base, "TCPROSServer", ("start_server",)),
    (rosgraph.network, "decode_ros_handshake_header", ()),
    (rosgraph.network, "write_ros_handshake_header", ()),
    (rosgraph.xmlrpc, "SilenceableXMLRPCRequestHandler", ("do_POST", "decode_request_content")),
    (rosgraph.xmlrpc, "ThreadingXMLRPCServer", ("service_actions", "process_request", "shutdown_request")),
)
"""Internals of rospy that the subclasses use: modules, their names, and the attributes of these."""


def _has_expected_internals() -> bool:
    return all(
        hasattr(module, name) and all(hasattr(getattr(module, name), attribute) for attribute in attributes)
        for module, name, attributes in _ROSPY_INTERNALS
    )


def _log_unexpected_internals() -> None:
    rospy.logwarn("rospy: its internals are not the expected ones: connections to this node have no limits")


def limit_connections() -> None:
    """Make rospy start limited servers; must be called before `rospy.init_node`.

    If the internals of this rospy are not the expected ones, it is left unchanged, and a warning is logged.
    """
    if not _has_expected_internals():
        _log_unexpected_internals()
        return
    tcpros_base.TCPServer = HandshakeServer
    rosgraph.xmlrpc.ThreadingXMLRPCServer = RequestServer
