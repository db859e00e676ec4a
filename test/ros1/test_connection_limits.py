"""Limits on a node's connections, with socket pairs and servers on the loopback address. Needs rospy, no master."""

import errno
import logging
import socket
import threading
from http.client import HTTPConnection, HTTPException
from struct import pack
from xmlrpc.client import ServerProxy, dumps

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

import rosgraph.xmlrpc  # noqa: E402
import rospy  # noqa: E402
from rosgraph.network import encode_ros_handshake_header  # noqa: E402
from rospy.impl import tcpros_base  # noqa: E402

from retalis.ros1 import connection_limits  # noqa: E402
from retalis.ros1.connection_limits import (  # noqa: E402
    MAX_HEADER_BYTES,
    ClosedConnectionCounter,
    ConnectionTable,
    EstablishedConnections,
    HandshakeServer,
    HeaderReader,
    RequestServer,
    limit_connections,
)

HOST = "127.0.0.1"
PATIENCE = 60.0

IDLE = 300
HEADER = encode_ros_handshake_header({"topic": "/chatter", "md5sum": "*", "callerid": "/test"})


@pytest.fixture(autouse=True)
def _short_loops(monkeypatch):
    monkeypatch.setattr(connection_limits, "DEADLINE_CHECK_SECONDS", 0.02)


@pytest.fixture
def pair():
    """Two ends of a connection; the first does not block."""
    ends = socket.socketpair()
    ends[0].setblocking(False)
    yield ends
    for end in ends:
        end.close()


@pytest.fixture
def pairs():
    """A function that makes connections whose other end says whether the first was shut down."""
    made = []

    def make(number):
        made.extend(socket.socketpair() for _ in range(number))
        return made[-number:]

    yield make
    for ends in made:
        for end in ends:
            end.close()


def is_closed(end):
    """Tell whether a connection was shut down at its other end."""
    end.setblocking(False)
    try:
        return not end.recv(1)
    except BlockingIOError:
        return False


class Seconds:
    """A clock that stands still until it is set."""

    def __init__(self):
        self.time = 0.0

    def __call__(self):
        return self.time


def counter():
    return ClosedConnectionCounter("a port", lambda line: None, Seconds())


# Headers


def test_a_header_is_read_as_its_bytes_come(pair):
    end, peer = pair
    reader = HeaderReader(end)
    for byte in HEADER[:-1]:
        peer.send(bytes([byte]))
        assert reader.read() is None
    peer.send(HEADER[-1:])
    assert reader.read() == HEADER


def test_what_follows_a_header_stays_in_the_connection(pair):
    end, peer = pair
    peer.send(HEADER + b"a request")
    assert HeaderReader(end).read() == HEADER
    assert end.recv(100) == b"a request"


def test_an_empty_header_is_complete(pair):
    end, peer = pair
    peer.send(bytes(4))
    assert HeaderReader(end).read() == bytes(4)


@pytest.mark.parametrize("begin", [b"", HEADER[:3], HEADER[:10]])
def test_a_connection_that_ends_in_its_header(pair, begin):
    end, peer = pair
    peer.send(begin)
    peer.shutdown(socket.SHUT_WR)
    with pytest.raises(ConnectionResetError):
        HeaderReader(end).read()


@pytest.mark.parametrize("length", [MAX_HEADER_BYTES + 1, 2**32 - 1])
def test_a_header_that_is_too_long_is_refused_by_its_length(pair, length):
    end, peer = pair
    peer.send(pack("<I", length))
    with pytest.raises(ValueError, match="headers longer than"):
        HeaderReader(end).read()


# Tables of unfinished connections


def test_the_oldest_connection_of_an_address_makes_room(pairs):
    closed = counter()
    table = ConnectionTable(5, 10, 3, closed, Seconds())
    (other, far), *ends = pairs(5)
    table.add(other, "10.0.0.2")
    for end, _ in ends:
        table.add(end, HOST)
    assert [is_closed(peer) for _, peer in ends] == [True, False, False, False]
    assert not is_closed(far)
    assert len(table) == 4
    assert closed.total == 1


def test_the_oldest_connection_of_all_makes_room(pairs):
    table = ConnectionTable(5, 3, 3, counter(), Seconds())
    ends = pairs(5)
    for number, (end, _) in enumerate(ends):
        table.add(end, f"10.0.0.{number}")
    assert [is_closed(peer) for _, peer in ends] == [True, True, False, False, False]


def test_connections_are_closed_at_their_deadline(pairs):
    seconds, closed = Seconds(), counter()
    table = ConnectionTable(5, 10, 10, closed, seconds)
    ends = pairs(3)
    for end, _ in ends:
        table.add(end, HOST)
        seconds.time += 1
    table.renew(ends[0][0])
    table.remove(ends[1][0])
    seconds.time = 7.9
    table.expire()
    assert [is_closed(peer) for _, peer in ends] == [False, False, True]
    seconds.time = 8
    table.expire()
    assert [is_closed(peer) for _, peer in ends] == [True, False, True]
    assert (len(table), closed.total) == (0, 2)


def test_finished_connections_do_not_count(pairs):
    table = ConnectionTable(5, 2, 1, counter(), Seconds())
    for end, peer in pairs(5):
        table.add(end, HOST)
        table.remove(end)
        table.renew(end)
        assert not is_closed(peer)
    assert len(table) == 0


def test_a_table_makes_room_when_files_run_out(pairs):
    table = ConnectionTable(5, 9, 9, counter(), Seconds())
    table.free_descriptor()
    ((end, peer),) = pairs(1)
    table.add(end, HOST)
    table.free_descriptor()
    assert is_closed(peer)


def test_established_connections_have_limits_of_an_address_and_in_all(pairs):
    established = EstablishedConnections(8)
    ends = [end for end, _ in pairs(9)]
    assert [established.add(end, HOST) for end in ends[:7]] == [True] * 6 + [False]
    assert [established.add(end, "10.0.0.2") for end in ends[6:9]] == [True, True, False]
    for end in ends[:3]:
        end.close()
    assert [established.add(end, HOST) for end in (ends[8], *ends[3:5])][0]


# Reports


def test_one_line_tells_of_all_connections_of_an_interval():
    lines, seconds = [], Seconds()
    closed = ClosedConnectionCounter("TCPROS port 1", lines.append, seconds)
    closed.report()
    for _ in range(500):
        closed.count("idle", HOST)
        closed.report()
    assert lines == []
    seconds.time = 10
    closed.report()
    closed.report()
    assert lines == [
        "TCPROS port 1: 500 connections closed (500 so far), the last one of 127.0.0.1: idle (500)"
    ]


def test_a_line_shows_few_reasons_and_no_control_characters():
    lines, seconds = [], Seconds()
    closed = ClosedConnectionCounter("a port", lines.append, seconds)
    for number in range(100):
        closed.count(f"\x1b[2J{number}" + 1000 * "x", HOST)
    seconds.time = 10
    closed.report()
    (line,) = lines
    assert len(line) < 2500
    assert "\x1b" not in line
    assert "other reasons (95)" in line


# The TCPROS server


class RospyServer:
    """Stands for rospy's server, which knows the topics and services."""

    def __init__(self):
        self.answered = []

    def callback(self, sock, address):
        raise AssertionError("plain rospy is not called")

    def topic_connection_handler(self, sock, address, header):
        if header["topic"] == "/wrong":
            return "this is no topic"
        if header["topic"] == "/bad":
            raise ValueError("bad")
        self.answered.append(header)
        sock.sendall(b"answer")
        return None

    service_connection_handler = topic_connection_handler


@pytest.fixture
def tcpros():
    """A server with limits, and the one of rospy behind it."""
    behind = RospyServer()
    server = HandshakeServer(behind.callback)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    yield server, behind
    server.shutdown()
    thread.join(PATIENCE)
    assert not thread.is_alive()


def connect(server):
    return socket.create_connection((HOST, server.port), timeout=PATIENCE)


def handshake(server, data=HEADER):
    """Send a header; return what comes back until the connection ends, or the answer."""
    with connect(server) as sock:
        sock.sendall(data)
        received = b""
        while received != b"answer":
            part = sock.recv(4096)
            received += part
            if not part:
                break
        return received


def test_idle_connections_hold_up_nobody(tcpros, monkeypatch):
    """No deadline passes here: before, the first of these connections was waited for."""
    monkeypatch.setattr(connection_limits, "HANDSHAKE_TIMEOUT_SECONDS", 10 * PATIENCE)
    server, behind = tcpros
    idle = [connect(server) for _ in range(IDLE)]
    try:
        assert handshake(server) == b"answer"
        assert behind.answered == [{"topic": "/chatter", "md5sum": "*", "callerid": "/test"}]
        assert any(map(is_closed, idle))
        assert threading.active_count() < 50
    finally:
        for sock in idle:
            sock.close()


@pytest.mark.parametrize("begin", [b"", HEADER[:9]])
def test_a_connection_without_a_header_ends_at_the_time_limit(monkeypatch, begin):
    monkeypatch.setattr(connection_limits, "HANDSHAKE_TIMEOUT_SECONDS", 0.1)
    server = HandshakeServer(RospyServer().callback)
    threading.Thread(target=server.run, daemon=True).start()
    try:
        assert handshake(server, begin) == b""
    finally:
        server.shutdown()


@pytest.mark.parametrize(
    ("fields", "reason"),
    [({"topic": "/wrong"}, b"this is no topic"), ({"x": "y"}, b"no topic or service name")],
)
def test_a_refused_client_is_told_why(tcpros, fields, reason):
    assert b"error=" + reason in handshake(tcpros[0], encode_ros_handshake_header(fields))


@pytest.mark.parametrize(
    "data",
    [
        bytes(4),
        pack("<I", 2**32 - 1),
        pack("<II", 4, 0),
        pack("<II", 4, 99),
        pack("<I", 2) + b"ab",
        pack("<II", 6, 2) + b"\xff=",
        encode_ros_handshake_header({"topic": "/bad"}),
    ],
)
def test_wrong_headers_are_counted_and_others_are_served(tcpros, data):
    server, behind = tcpros
    handshake(server, data)
    assert handshake(server) == b"answer"
    assert len(behind.answered) == 1
    assert server.closed_counter.total == 1


def test_the_node_goes_on_when_files_run_out(tcpros):
    """Plain rospy ends its accepting thread there, and never answers again."""
    server = tcpros[0]

    class NoFiles:
        def accept(self):
            raise OSError(errno.EMFILE, "too many open files")

    idle = connect(server)
    assert handshake(server) == b"answer"  # the idle one is in the table now
    server._accept(NoFiles())  # noqa: SLF001
    idle.settimeout(PATIENCE)
    assert idle.recv(1) == b""
    assert handshake(server) == b"answer"
    idle.close()


def test_many_connections_at_once_are_held(tcpros):
    """More than five wait in the system until they are accepted."""
    server = tcpros[0]
    results = []
    threads = [threading.Thread(target=lambda: results.append(handshake(server))) for _ in range(100)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert results == [b"answer"] * 100


def test_service_clients_that_end_without_a_request_are_counted_and_not_logged_each(tcpros):
    server = tcpros[0]
    assert handshake(server) == b"answer"  # the server runs
    records = []
    handler = logging.Handler()
    handler.emit = records.append
    log = logging.getLogger("rosout")
    log.addHandler(handler)
    try:
        for _ in range(3):
            rospy.logerr("incoming connection failed: unable to receive data from sender")
        rospy.logerr("another error")
    finally:
        log.removeHandler(handler)
    assert [record.msg for record in records] == ["another error"]
    assert server.closed_counter.total == 3


# The XML-RPC server


@pytest.fixture
def requests():
    """An XML-RPC server with limits."""
    server = RequestServer((HOST, 0))
    server.register_function(lambda text: len(text), "length")
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join(PATIENCE)


def length_of(server, text):
    with ServerProxy(f"http://{HOST}:{server.server_address[1]}/") as proxy:
        return proxy.length(text)


def test_idle_xmlrpc_connections_take_a_bounded_number_of_threads(requests):
    idle = [socket.create_connection(requests.server_address, timeout=PATIENCE) for _ in range(IDLE)]
    try:
        assert length_of(requests, "abc") == 3
        assert len(requests.connections) <= connection_limits.MAX_REQUEST_CONNECTIONS
        assert threading.active_count() < IDLE
        idle[0].settimeout(PATIENCE)
        assert idle[0].recv(1) == b""
    finally:
        for sock in idle:
            sock.close()


def test_a_request_that_never_ends_is_closed_at_its_deadline(requests, monkeypatch):
    seconds, renewed = Seconds(), threading.Event()
    requests.connections._now = seconds  # noqa: SLF001
    renew = requests.connections.renew
    monkeypatch.setattr(requests.connections, "renew", lambda sock: (renew(sock), renewed.set()))
    with socket.create_connection(requests.server_address, timeout=PATIENCE) as sock:
        sock.sendall(b"POST / HTTP/1.1\r\nContent-Length: 100\r\n\r\n<")
        assert renewed.wait(PATIENCE)  # a later renewal would be given a deadline after the time set here
        seconds.time = 1e9
        assert sock.recv(1) == b""
    assert (
        requests.closed_counter.total == 0
    )  # a connection that a client keeps for later ends in the same way


@pytest.mark.parametrize("length", [None, "-1", "x", str(1 << 40)])
def test_requests_without_a_length_or_too_long_are_refused_unread(requests, length):
    connection = HTTPConnection(*requests.server_address, timeout=PATIENCE)
    connection.putrequest("POST", "/")
    if length is not None:
        connection.putheader("Content-Length", length)
    connection.endheaders()
    assert connection.getresponse().status == 413
    connection.close()
    assert length_of(requests, "abc") == 3


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_not_expanded(requests, encoding):
    text = f'<?xml version="1.0" encoding="{encoding}"?><!DOCTYPE a [<!ENTITY b "{9 * "b"}">]>' + dumps(
        ("&b;",), "length"
    ).replace("&amp;", "&")
    connection = HTTPConnection(*requests.server_address, timeout=PATIENCE)
    connection.request("POST", "/", text.encode(encoding))
    try:
        assert connection.getresponse().status == 400
    except HTTPException:
        pytest.fail("no answer")
    connection.close()
    assert length_of(requests, "abc") == 3


# In place of rospy's own


def test_a_rospy_with_other_internals_stays_as_it_is(monkeypatch):
    warnings = []
    before = rosgraph.xmlrpc.ThreadingXMLRPCServer
    monkeypatch.setattr(rospy, "logwarn", lambda text, *_: warnings.append(text))
    monkeypatch.setattr(tcpros_base, "TCPServer", object)
    limit_connections()
    assert tcpros_base.TCPServer is object
    assert rosgraph.xmlrpc.ThreadingXMLRPCServer is before
    assert len(warnings) == 1


def test_a_server_without_handlers_runs_as_in_rospy(monkeypatch):
    warnings, served = [], threading.Event()
    monkeypatch.setattr(rospy, "logwarn", lambda text, *_: warnings.append(text))

    def handle(sock, address):
        served.set()
        sock.close()

    server = HandshakeServer(handle)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    with connect(server):
        assert served.wait(PATIENCE)
    server.is_shutdown = True
    with connect(server):  # rospy's loop ends when it has accepted another connection
        thread.join(PATIENCE)
    server.server_sock.close()
    assert len(warnings) == 1


def test_both_servers_are_replaced(monkeypatch):
    monkeypatch.setattr(tcpros_base, "TCPServer", tcpros_base.TCPServer)
    monkeypatch.setattr(rosgraph.xmlrpc, "ThreadingXMLRPCServer", rosgraph.xmlrpc.ThreadingXMLRPCServer)
    limit_connections()
    assert tcpros_base.TCPServer is HandshakeServer
    assert rosgraph.xmlrpc.ThreadingXMLRPCServer is RequestServer
