"""Limits on connections to a node: the handshakes at its TCPROS port and the requests at its XML-RPC port.

rospy reads the header of a new TCPROS connection in the thread that accepts connections, so one idle client holds up
all others, and its XML-RPC server has a thread for each connection, without an end. `limit_connections` gives rospy
subclasses of both servers. A `ConnectionTable` holds the unfinished connections of a server in the order of their
deadlines, at most so many of one address and in all. One more than that closes the oldest one, so a client that sends
its header at once is served, whatever its neighbours do.

To close a connection is to shut its socket down: its owner, which is the loop or a thread, then reads the end of the
stream and closes it.
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

from ..foundation.errors import beginning, printable

BACKLOG = 1024
"""Connections that the system holds until the node accepts them, if `net.core.somaxconn` allows it.

Those beyond are not answered; the client's system tries again after 1, 3 and 7 seconds.
"""

HANDSHAKE_SECONDS = 5.0
MAX_HANDSHAKES = 256
MAX_HANDSHAKES_PER_ADDRESS = 192
MAX_HEADER_BYTES = 1 << 18
"""Bytes of a connection's header, which may contain the definition of a message type."""

REQUEST_SECONDS = 30.0
"""Seconds that an XML-RPC connection has for its next request, from the previous one on."""

MAX_REQUEST_CONNECTIONS = 128
MAX_REQUEST_CONNECTIONS_PER_ADDRESS = 96
MAX_REQUEST_BYTES = 1 << 18

REPORT_SECONDS = 10.0
"""Seconds from the first connection that is closed to the line that reports all until then."""

MAX_REASONS = 5
MAX_REASON_CHARACTERS = 400
"""Reasons that one line shows, and characters of each: some contain text of the client."""

LOOP_SECONDS = 1.0
"""Seconds after which a loop looks for deadlines and for the end of the node at the latest."""

_NO_RESOURCES = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}

OWNER_PAUSE = 0.001
NO_FILES_PAUSE = 0.1
"""Seconds until the next try to accept a connection without free files, with and without a connection to close."""

Now = Callable[[], float]
Address = Tuple[Any, ...]
"""Host and port, and more for IPv6."""


class ClosedConnections:
    """Counts connections that were closed by a limit, and logs one line for all of an interval.

    Args:
        server: the name of the server in the log.
        warn: takes the line.
        now: a clock in seconds.

    Attributes:
        total: how many there were.
    """

    def __init__(self, server: str, warn: Callable[[str], object] = rospy.logwarn, now: Now = time.monotonic):
        self._server = server
        self._warn = warn
        self._now = now
        self._lock = threading.Lock()
        self._reasons: Dict[str, int] = Counter()
        self._last = ""
        self._due = 0.0
        self.total = 0

    def count(self, reason: str, address: str) -> None:
        """Count a connection."""
        with self._lock:
            if not self._reasons:
                self._due = self._now() + REPORT_SECONDS
            reason = printable(beginning(reason, MAX_REASON_CHARACTERS))
            if reason not in self._reasons and len(self._reasons) >= MAX_REASONS:
                reason = "other reasons"
            self._reasons[reason] += 1
            self._last = address
            self.total += 1

    def report(self) -> None:
        """Log what was counted, if an interval has passed since the first one."""
        with self._lock:
            if not self._reasons or self._now() < self._due:
                return
            reasons = ", ".join(f"{reason} ({count})" for reason, count in self._reasons.items())
            number = sum(self._reasons.values())
            self._reasons.clear()
        self._warn(
            f"{self._server}: {number} connections closed ({self.total} so far),"
            f" the last one of {self._last}: {reasons}"
        )


class _OpenConnection(NamedTuple):
    address: str
    deadline: float


class ConnectionTable:
    """The unfinished connections of a server, the one with the earliest deadline first.

    Args:
        seconds: until the deadline of a connection.
        most: connections in all.
        most_per_address: connections of one address.
        closed: counts those that are closed.
        now: a clock in seconds.
        may_idle: whether a connection may have nothing to finish, so that its end at the deadline is not counted.
    """

    def __init__(
        self,
        seconds: float,
        most: int,
        most_per_address: int,
        closed: ClosedConnections,
        now: Now = time.monotonic,
        may_idle: bool = False,
    ):
        self._seconds = seconds
        self._most = most
        self._most_per_address = most_per_address
        self._closed = closed
        self._now = now
        self._may_idle = may_idle
        self._lock = threading.Lock()
        self._entries: OrderedDict[socket.socket, _OpenConnection] = OrderedDict()
        self._by_address: Dict[str, int] = Counter()

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, sock: socket.socket, address: str) -> None:
        """Add a connection; if there are too many, close the oldest one of the address or of all."""
        with self._lock:
            if self._by_address[address] >= self._most_per_address:
                oldest = next(other for other, entry in self._entries.items() if entry.address == address)
                self._close(oldest, f"more than {self._most_per_address} unfinished ones of one address")
            elif len(self._entries) >= self._most:
                self._close_oldest(f"more than {self._most} unfinished ones")
            self._entries[sock] = _OpenConnection(address, self._now() + self._seconds)
            self._by_address[address] += 1

    def renew(self, sock: socket.socket) -> None:
        """Give a connection that is still in the table a new deadline."""
        with self._lock:
            entry = self._entries.pop(sock, None)
            if entry is not None:
                self._entries[sock] = entry._replace(deadline=self._now() + self._seconds)

    def remove(self, sock: socket.socket) -> None:
        """Remove a connection that has been finished or closed."""
        with self._lock:
            self._remove(sock)

    def expire(self) -> None:
        """Close the connections whose deadline has passed."""
        with self._lock:
            now = self._now()
            while self._entries and next(iter(self._entries.values())).deadline <= now:
                self._close_oldest("" if self._may_idle else f"not finished within {self._seconds:g} s")

    def make_room(self) -> None:
        """Close the oldest connection, because the process can open no more files, and give its owner time for it."""
        with self._lock:
            pause = OWNER_PAUSE if self._entries else NO_FILES_PAUSE
            if self._entries:
                self._close_oldest("no more files can be opened")
        time.sleep(pause)

    def _close_oldest(self, reason: str) -> None:
        self._close(next(iter(self._entries)), reason)

    def _close(self, sock: socket.socket, reason: str) -> None:
        if reason:
            self._closed.count(reason, self._entries[sock].address)
        self._remove(sock)
        _shut_down(sock)

    def _remove(self, sock: socket.socket) -> None:
        entry = self._entries.pop(sock, None)
        if entry is None:
            return
        # The count of an address must not outlive its last connection: addresses are many.
        self._by_address[entry.address] -= 1
        if not self._by_address[entry.address]:
            del self._by_address[entry.address]


def _shut_down(sock: socket.socket) -> None:
    """End the stream of a socket in both directions, which wakes a thread that reads or writes it."""
    try:
        sock.shutdown(socket.SHUT_RDWR)
    except OSError:  # its peer or its owner has closed it
        pass


class HeaderReader:
    """Reads the header of one connection as its bytes come, and not a byte of what follows it."""

    def __init__(self, sock: socket.socket):
        self._socket = sock
        self._data = bytearray()
        self._size = 4

    def read(self) -> Optional[bytes]:
        """Read what there is; return the header with its length if it is complete.

        Raises:
            OSError: if the connection has ended before.
            ValueError: if the header is too long.
        """
        while True:
            try:
                data = self._socket.recv(self._size - len(self._data))
            except BlockingIOError:
                return None
            if not data:
                raise ConnectionResetError("the connection ended before its header was complete")
            self._data += data
            if len(self._data) < self._size:
                continue
            if self._size > 4:
                return bytes(self._data)
            (length,) = unpack("<I", self._data)
            if length > MAX_HEADER_BYTES:
                raise ValueError(f"headers longer than {MAX_HEADER_BYTES} bytes")
            self._size += length
            if not length:
                return bytes(self._data)


class EstablishedConnections:
    """The connections whose handshake is done, until rospy drops their sockets.

    Each takes a thread and a file. Their number is bounded by the files that the process may open; one address has
    three quarters of that at most, so that it cannot shut out the others.
    """

    def __init__(self, most: Optional[int] = None):
        if most is None:
            soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
            most = 3 * (min(soft, 2048) if soft >= 0 else 2048) // 8
        self._most = most
        self._most_per_address = 3 * most // 4
        self._lock = threading.Lock()
        self._by_address: Dict[str, WeakSet[socket.socket]] = {}

    @property
    def limits(self) -> str:
        """The numbers, for a message."""
        return f"{self._most_per_address} of one address, {self._most} in all"

    def add(self, sock: socket.socket, address: str) -> bool:
        """Add a connection; return False if there are too many."""
        with self._lock:
            counts = {}
            for known, sockets in list(self._by_address.items()):
                counts[known] = sum(1 for other in list(sockets) if other.fileno() >= 0)
                if not counts[known]:
                    del self._by_address[known]
            if sum(counts.values()) >= self._most or counts.get(address, 0) >= self._most_per_address:
                return False
            self._by_address.setdefault(address, WeakSet()).add(sock)
            return True


class HandshakeServer(getattr(tcpros_base, "TCPServer", object)):  # type: ignore[misc]
    """rospy's server of the TCPROS port, with handshakes that do not delay each other.

    One thread accepts connections and reads headers as their bytes come. A complete header is answered by rospy's
    handler, in a thread that ends with the handshake.
    """

    def _create_server_sock(self) -> socket.socket:
        sock: socket.socket = super()._create_server_sock()
        sock.listen(BACKLOG)
        return sock

    def run(self) -> None:
        """Serve until rospy shuts the server down; as rospy does if its parts are not the expected ones."""
        self._rospy_server: Any = getattr(self.inbound_handler, "__self__", None)
        if not all(hasattr(self._rospy_server, name) for name in _HANDLERS):
            _warn_of_fallback()
            super().run()
            return
        self.is_shutdown = False
        self.closed = ClosedConnections(f"TCPROS port {self.port}")
        self._handshakes = ConnectionTable(
            HANDSHAKE_SECONDS, MAX_HANDSHAKES, MAX_HANDSHAKES_PER_ADDRESS, self.closed
        )
        self._established = EstablishedConnections()
        log = logging.getLogger("rosout")
        log.addFilter(self._is_logged)
        try:
            with selectors.DefaultSelector() as self._selector:
                self._serve(self.server_sock)
        finally:
            log.removeFilter(self._is_logged)

    def _serve(self, listening: socket.socket) -> None:
        listening.setblocking(False)
        self._selector.register(listening, selectors.EVENT_READ)
        while not self.is_shutdown:
            is_new = False
            # Headers that have come are read before the next connection is accepted: no connection is closed
            # for a newer one while its header waits in the system's buffer.
            for key, _ in self._selector.select(LOOP_SECONDS):
                if key.data is None:
                    is_new = True
                else:
                    self._read(key.fileobj, *key.data)
            if is_new:
                self._accept(listening)
            self._handshakes.expire()
            self.closed.report()

    def _is_logged(self, record: logging.LogRecord) -> bool:
        """Count the connections of service clients that ended without a request; rospy logs an error for each."""
        if not str(record.msg).startswith("incoming connection failed"):
            return True
        self.closed.count("ended before the request of a service", "a service's client")
        return False

    def _accept(self, listening: socket.socket) -> None:
        try:
            sock, address = listening.accept()
        except OSError as error:
            if error.errno in _NO_RESOURCES:
                self._handshakes.make_room()
            return  # the client has gone, or the server is being shut down
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._handshakes.add(sock, address[0])
        self._selector.register(sock, selectors.EVENT_READ, (address, HeaderReader(sock)))

    def _read(self, sock: Any, address: Address, reader: HeaderReader) -> None:
        """Read what has come of a header; have it answered when it is complete."""
        try:
            header = reader.read()
            if header is None:
                return
            self._selector.unregister(sock)
            sock.setblocking(True)
            threading.Thread(
                target=self._answer, args=(sock, address, header), name="TCPROS handshake", daemon=True
            ).start()
        except (OSError, ValueError, RuntimeError) as error:
            if isinstance(error, ValueError):
                self.closed.count(str(error), address[0])
            elif isinstance(error, RuntimeError):
                self.closed.count("no more threads can be started", address[0])
            if sock in self._selector.get_map():
                self._selector.unregister(sock)
            self._handshakes.remove(sock)
            sock.close()

    def _answer(self, sock: socket.socket, address: Address, data: bytes) -> None:
        """Hand a connection to rospy's handler of topics or services; close it if that refuses it."""
        try:
            refusal = self._refusal(sock, address, rosgraph.network.decode_ros_handshake_header(data))
            if refusal:
                rosgraph.network.write_ros_handshake_header(sock, {"error": refusal})
        except Exception as error:  # whatever rospy raises for a header that it does not expect
            refusal = f"handshake failed: {error}"
            self.closed.count(refusal, address[0])
        finally:
            self._handshakes.remove(sock)
        if refusal:
            sock.close()

    def _refusal(self, sock: socket.socket, address: Address, header: Dict[str, str]) -> str:
        """Return why rospy or a limit refuses a connection, or "" if a transport of rospy has it now."""
        if rospy.core.is_shutdown_requested():
            return "node shutting down"
        if not self._established.add(sock, address[0]):
            refusal = f"too many connections: expected at most {self._established.limits}"
            self.closed.count(refusal, address[0])
            return refusal
        if "topic" in header:
            refusal = self._rospy_server.topic_connection_handler(sock, address, header)
        elif "service" in header:
            refusal = self._rospy_server.service_connection_handler(sock, address, header)
        else:
            refusal = "no topic or service name detected"
        if refusal:
            self.closed.count(refusal, address[0])
        return refusal or ""


class RequestHandler(getattr(rosgraph.xmlrpc, "SilenceableXMLRPCRequestHandler", object)):  # type: ignore[misc]
    """A connection to the XML-RPC server: each request has a deadline and a largest size."""

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
        self.server.closed.count(
            f"requests without a length, or longer than {MAX_REQUEST_BYTES} bytes", self.client_address[0]
        )
        self.close_connection = True
        self.send_error(413)

    def decode_request_content(self, data: bytes) -> Optional[bytes]:
        """Return a request's text; refuse a document type, whose entities can be of any size in older parsers."""
        decoded: Optional[bytes] = super().decode_request_content(data)
        if decoded is None:  # its encoding is refused already
            return None
        # Without the zeros UTF-16 and UTF-32 show the word, too.
        if b"<!DOCTYPE" in decoded.replace(b"\0", b"") or len(decoded) > MAX_REQUEST_BYTES:
            self.server.closed.count("requests with a document type, or too large", self.client_address[0])
            self.close_connection = True
            self.send_error(400)
            return None
        return decoded


class RequestServer(getattr(rosgraph.xmlrpc, "ThreadingXMLRPCServer", object)):  # type: ignore[misc]
    """rospy's XML-RPC server, with bounds on its connections and threads."""

    def __init__(self, *args: Any, **keywords: Any):
        super().__init__(*args, **keywords)
        self.socket.listen(BACKLOG)
        self.RequestHandlerClass = RequestHandler
        self.closed = ClosedConnections(f"XML-RPC port {self.server_address[1]}")
        # The master and other nodes keep a connection for their next request; they connect again when it has ended.
        self.connections = ConnectionTable(
            REQUEST_SECONDS,
            MAX_REQUEST_CONNECTIONS,
            MAX_REQUEST_CONNECTIONS_PER_ADDRESS,
            self.closed,
            may_idle=True,
        )

    def get_request(self) -> Any:
        """Accept a connection."""
        try:
            return super().get_request()
        except OSError as error:
            if error.errno in _NO_RESOURCES:
                self.connections.make_room()
            raise  # the loop goes on

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
        self.closed.report()


_HANDLERS = ("topic_connection_handler", "service_connection_handler")

_EXPECTED = (
    (tcpros_base, "TCPServer", ("run", "start", "shutdown", "_create_server_sock")),
    (tcpros_base, "TCPROSServer", ("start_server",)),
    (rosgraph.network, "decode_ros_handshake_header", ()),
    (rosgraph.network, "write_ros_handshake_header", ()),
    (rosgraph.xmlrpc, "SilenceableXMLRPCRequestHandler", ("do_POST", "decode_request_content")),
    (rosgraph.xmlrpc, "ThreadingXMLRPCServer", ("service_actions", "process_request", "shutdown_request")),
)
"""Parts of rospy that the subclasses use: modules, their names, and the attributes of these."""


def _fits() -> bool:
    return all(
        hasattr(module, name) and all(hasattr(getattr(module, name), attribute) for attribute in attributes)
        for module, name, attributes in _EXPECTED
    )


def _warn_of_fallback() -> None:
    rospy.logwarn("rospy: its servers are not the expected ones: connections to this node have no limits")


def limit_connections() -> None:
    """Have rospy start limited servers; call this before `rospy.init_node`.

    If this rospy has other internals than expected, it stays as it is, and a warning says so.
    """
    if not _fits():
        _warn_of_fallback()
        return
    tcpros_base.TCPServer = HandshakeServer
    rosgraph.xmlrpc.ThreadingXMLRPCServer = RequestServer
