#!/usr/bin/env python3
"""Attacks on the ports of live nodes from the loopback address: idle and slow clients, XML-RPC, large requests.

rostest retalis attacks.test seconds:=300 requests:=20000 seed:=2
"""

import os
import random
import socket
import struct
import sys
import threading
import time
import unittest
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from urllib.parse import urlparse
from xmlrpc.client import Binary, Error, Fault, ServerProxy, dumps

import rospy
import rostest
from rosgraph.network import decode_ros_handshake_header, encode_ros_handshake_header
from rosgraph_msgs.msg import Log

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE.parent), str(HERE.parent / "ros1")]
from fuzz.mutate import mutate_bytes  # noqa: E402
from harness import Collector, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402
from retalis.ros1.connection_limits import HANDSHAKE_TIMEOUT_SECONDS, REPORT_DELAY_SECONDS  # noqa: E402

HOST = "127.0.0.1"
NODES = {"/retalis": "/retalisOutputEvents", "/retalis_ros_interface": "/retalisInputTopics"}
"""The nodes, and a topic that each of them publishes."""

IDLE = 500
CALLS = 20
LATER = 0.1
"""Seconds by which a call may take longer while idle connections are there; without limits each takes 5 s longer."""

SILENT = 700
"""Connections that ask for a service and send no request: more than one address may have."""

SLOW = 20
"""Slow clients of each kind at each port."""

PAUSE = 0.05
"""Seconds from one byte of a slow client to the next."""

CONNECTED = 0.2
"""Seconds that a slow client waits for its connection before it tries again later."""

ANSWERED = 10.0
"""Seconds after which a call by a client that is not slow has failed."""

GROWTH = 30 << 10
"""kB by which a node may grow in an attack, beyond the first third of it."""

LARGE = 10_000_000
LARGE_ANSWERED = 60.0


def sockets_of(pid):
    """Return the inodes of a process's sockets."""
    links = (link for link in Path(f"/proc/{pid}/fd").iterdir())
    found = set()
    for link in links:
        try:
            found.add(os.readlink(str(link)))
        except OSError:  # closed meanwhile
            pass
    return {text.split("[")[1].rstrip("]") for text in found if text.startswith("socket:[")}


def ports_of(pid):
    """Return the TCP ports at which a process listens."""
    inodes = sockets_of(pid)
    ports = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                ports.add(int(fields[1].rpartition(":")[2], 16))
    return sorted(ports)


def usage(pid):
    """Return memory in kB, threads and open files of a process."""
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return (
        int(status["VmRSS"].split()[0]),
        int(status["Threads"]),
        sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
    )


def seconds_of(work):
    """Return the lower quartile of the times of some calls, which other work on the machine changes little."""
    times = []
    for _ in range(CALLS):
        start = time.monotonic()
        work()
        times.append(time.monotonic() - start)
    return sorted(times)[CALLS // 4]


def is_open(sock):
    """Tell whether the other end of a connection that does not block has not closed it."""
    try:
        return bool(sock.recv(65536))
    except BlockingIOError:
        return True
    except OSError:
        return False


class Node:
    """A node under attack."""

    def __init__(self, name, topic):
        master = rospy.get_master()
        self.name = name
        self.topic = topic
        self.api = urlparse(master.lookupNode(name)[2]).port
        self.tcpros = urlparse(master.lookupService(f"{name}/list")[2]).port
        self.list = wait_for_service(f"{name}/list", srv.List)
        with self.proxy() as proxy:
            self.pid = proxy.getPid("/attacks")[2]
        self.ports = ports_of(self.pid)

    def proxy(self):
        return ServerProxy(f"http://{HOST}:{self.api}/")

    def call(self):
        assert self.list(1).result == "ok"

    def subscribe(self):
        """Connect as a subscriber of a topic."""
        with socket.create_connection((HOST, self.tcpros), timeout=ANSWERED) as sock:
            sock.sendall(
                encode_ros_handshake_header({"topic": self.topic, "md5sum": "*", "callerid": "/attacks"})
            )
            answer = sock.recv(65536)
        assert decode_ros_handshake_header(answer)["topic"] == self.topic, answer

    def ask_api(self):
        with self.proxy() as proxy:
            assert proxy.getPid("/attacks")[2] == self.pid


class SlowClient:
    """A connection on which bytes come one at a time; it is made anew whenever the node has closed it.

    Args:
        port: of the node.
        begin: is sent at once.
        more: is sent byte by byte, without an end; nothing if it is empty.
    """

    def __init__(self, port, begin, more):
        self.port = port
        self.begin = begin
        self.more = more
        self.sock = None
        self.made = self.sent = 0

    def step(self):
        """Send a byte."""
        if self.sock is None:
            self.sock = socket.create_connection((HOST, self.port), timeout=CONNECTED)
            self.sock.sendall(self.begin)
            self.sock.setblocking(False)
            self.made += 1
        try:
            if self.more:
                self.sock.send(self.more[self.sent % len(self.more) :][:1])
                self.sent += 1
        except BlockingIOError:
            pass
        except OSError:
            self.close()
            return
        if not is_open(self.sock):
            self.close()

    def close(self):
        if self.sock is not None:
            self.sock.close()
            self.sock = None


SLOW_WAYS = (
    (b"", b""),
    (b"\x10", b""),
    (struct.pack("<I", 1 << 17), b"\x06\0\0\0topic="),
    (b"", struct.pack("<I", 200) + b"\x06\0\0\0topic="),
    (b"", b"POST / HTTP/1.1\r\nHost: localhost\r\n" + 100 * b"X-Header: x\r\n"),
    (b"POST / HTTP/1.1\r\nContent-Length: 200000\r\n\r\n", b"<methodCall>"),
    (b"GET /events HTTP/1.1\r\nHost: localhost\r\n", b"X"),
)
"""Bytes that slow clients send at once, and those that they send one by one."""

METHODS = (
    "getBusStats",
    "getBusInfo",
    "getMasterUri",
    "getPid",
    "getSubscriptions",
    "getPublications",
    "getName",
    "getUri",
    "paramUpdate",
    "publisherUpdate",
    "requestTopic",
    "system.listMethods",
    "system.multicall",
    "_shutdown",
    "__init__",
    "reg_man.cleanup",
    "",
)
"""All of the slave API but ``shutdown``, which ends the node, as it is meant to."""

NOBODY = f"http://{HOST}:1/"
"""The URI of a publisher that does not answer: the node may try to connect to it."""


def value(chance, depth=0):
    """Return an argument of any type."""
    deeper = depth < 5
    return chance.choice(
        (
            lambda: chance.choice(("", "/tf", "/fuzz", "/retalisInputEvents", "é\0", "x" * 10_000, NOBODY)),
            lambda: chance.choice((0, -1, 2**31 - 1, True)),
            lambda: chance.choice((0.5, float("nan"), 1e300)),
            lambda: Binary(b"\0\xff"),
            lambda: None,
            lambda: [value(chance, depth + 1) for _ in range(chance.randrange(4))] if deeper else [],
            lambda: {"k": value(chance, depth + 1)} if deeper else {},
            lambda: [NOBODY] * chance.choice((1, 2, 20)),
            lambda: [["TCPROS"]],
            lambda: [[], "TCPROS", 1],
        )
    )()


def request(chance):
    """Return the body of an XML-RPC request, with arguments of any number and type."""
    method = chance.choice(METHODS)
    arguments = ["/attacks"] * (chance.random() < 0.8)
    arguments += [value(chance) for _ in range(chance.choice((0, 0, 1, 2, 2, 2, 3, 9)))]
    return dumps(tuple(arguments), method, allow_none=True).encode("utf-8", "replace")


VALID = [
    dumps(("/attacks", "/nobody", [NOBODY]), "publisherUpdate").encode(),
    dumps(("/attacks", "/nobody", [["TCPROS"]]), "requestTopic").encode(),
    dumps(("/attacks", "/nobody", {"a": [1, 2.5, "x"]}), "paramUpdate").encode(),
    dumps(("/attacks",), "getBusInfo").encode(),
]
"""Requests to be damaged: their topic has no subscriber, so no damaged address is connected to."""

NESTED = b"<value><array><data>" * 5_000

WHOLE = (
    b"",
    b"\0" * 1000,
    b"<" * 100_000,
    b"<methodCall>" * 10_000,
    b"<methodCall><methodName>getPid</methodName><params><param>" + NESTED,
    b'<!DOCTYPE a [<!ENTITY a "' + 1000 * b"a" + b'"><!ENTITY b "' + 100 * b"&a;" + b'">]>' + VALID[3],
    b"<methodCall><methodName>getPid</methodName><params><param><value><int>"
    + 200_000 * b"9"
    + b"</int></value></param></params></methodCall>",
    dumps((["/a"] * 10_000, "/tf"), "publisherUpdate").encode(),
    dumps(([{"methodName": "getPid", "params": ["/a"]}] * 1000,), "system.multicall").encode(),
)


class Attacks(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
        cls.seconds, cls.requests, cls.seed = numbers if len(numbers) == 3 else (10, 1000, 1)
        wait_for_message_path()
        cls.began = time.monotonic()
        cls.log = Collector("/rosout", Log)
        wait_until(cls.log.is_connected, "the nodes' log")
        cls.nodes = [Node(*node) for node in NODES.items()]

    def assert_flat(self, node, before, what):
        """Wait until a node has the threads and files that it had, and print what it has."""

        def few():
            _, threads, files = usage(node.pid)
            return threads <= before[1] + 5 and files <= before[2] + 5

        wait_until(few, f"the threads and files of {node.name} to go after {what}", pause=0.1)
        rospy.loginfo(f"{node.name}: {what}: kB, threads, files: {before} before, {usage(node.pid)} after")

    def test_idle_connections_delay_nobody(self):
        for node in self.nodes:
            node.call()
            before = usage(node.pid)
            for port, works in (
                (node.tcpros, (node.call, node.subscribe)),
                (node.api, (node.ask_api, node.call)),
            ):
                usual = [seconds_of(work) for work in works]
                idle = [socket.create_connection((HOST, port), timeout=ANSWERED) for _ in range(IDLE)]
                began = time.monotonic()
                try:
                    delayed = [seconds_of(work) for work in works]
                    rospy.loginfo(f"{node.name}: {IDLE} idle: {delayed} s in place of {usual} s")
                    for now, then in zip(delayed, usual):
                        self.assertLess(now, then + LATER)
                    if port == node.tcpros:
                        for sock in idle:
                            sock.settimeout(
                                max(0.1, began + HANDSHAKE_TIMEOUT_SECONDS + ANSWERED - time.monotonic())
                            )
                            self.assertEqual(sock.recv(1), b"")
                finally:
                    for sock in idle:
                        sock.close()
            self.assert_flat(node, before, f"{IDLE} idle connections")
            place = f"TCPROS port {node.tcpros}: "
            self.log.wait_for(
                lambda messages: any(one.msg.startswith(place) for one in messages),  # noqa: B023
                "the report of closed connections",
            )
            lines = [one.msg for one in self.log.messages if one.msg.startswith(place)]
            # One line in an interval, however many connections were closed; a busy machine takes longer.
            self.assertLess(len(lines), 4 + (time.monotonic() - self.began) / REPORT_DELAY_SECONDS, lines)

    def test_slow_clients_take_a_bounded_part_of_the_node(self):
        clients = [
            SlowClient(port, *way)
            for node in self.nodes
            for port in node.ports
            for way in SLOW_WAYS
            for _ in range(SLOW)
        ]
        before = [usage(node.pid) for node in self.nodes]
        start = time.monotonic()
        settled, most, slowest, calls = None, [(0, 0, 0)] * len(self.nodes), 0.0, 0
        try:
            while time.monotonic() - start < self.seconds:
                for client in clients:
                    try:
                        client.step()
                    except OSError:
                        client.close()
                for node in self.nodes:
                    for work in (node.call, node.subscribe, node.ask_api):
                        began = time.monotonic()
                        work()
                        slowest = max(slowest, time.monotonic() - began)
                        calls += 1
                now = [usage(node.pid) for node in self.nodes]
                most = [tuple(map(max, one, other)) for one, other in zip(most, now)]
                if settled is None and time.monotonic() - start > self.seconds / 3:
                    settled = now
                time.sleep(PAUSE)
            made = sum(client.made for client in clients)
            rospy.loginfo(
                f"{len(clients)} slow clients, {made} connections, {self.seconds} s: {calls} calls, "
                f"the slowest {slowest:.3f} s; at most (kB, threads, files) {most}",
            )
        finally:
            for client in clients:
                client.close()
        self.assertLess(slowest, ANSWERED)
        for node, then, at_first, largest in zip(self.nodes, settled, before, most):
            self.assertLess(largest[1], 450, node.name)
            self.assertLess(usage(node.pid)[0] - then[0], GROWTH, node.name)
            self.assert_flat(node, at_first, "slow clients")

    def test_clients_that_send_a_header_and_say_nothing(self):
        """More real connections than a node takes: it refuses the rest, and goes on when they are gone."""
        for node in self.nodes:
            before = usage(node.pid)
            header = encode_ros_handshake_header(
                {"service": f"{node.name}/list", "md5sum": "*", "callerid": "/attacks"}
            )
            ends, refused = [], 0
            try:
                for _ in range(SILENT):
                    sock = socket.create_connection((HOST, node.tcpros), timeout=ANSWERED)
                    ends.append(sock)
                    sock.sendall(header)
                    refused += b"error=too many connections" in sock.recv(4096)
                self.assertGreater(refused, 0)
            finally:
                for sock in ends:
                    sock.close()
            node.call()
            self.assert_flat(node, before, f"{SILENT} connections to a service, {refused} refused")

    def test_xmlrpc(self):
        for node in self.nodes:
            chance = random.Random(f"xmlrpc {self.seed} {node.name}")
            before = usage(node.pid)
            slowest = 0.0
            bodies = [*WHOLE]
            for number in range(self.requests):
                if number >= len(bodies):
                    body = (
                        request(chance)
                        if chance.random() < 0.5
                        else mutate_bytes(chance, chance.choice(VALID), VALID)
                    )
                else:
                    body = bodies[number]
                began = time.monotonic()
                self.post(node, body)
                slowest = max(slowest, time.monotonic() - began)
                if number % 100 == 0:
                    node.ask_api()
                    node.call()
            self.assertLess(usage(node.pid)[0] - before[0], GROWTH, node.name)
            self.assert_flat(node, before, f"{self.requests} XML-RPC requests, the slowest {slowest:.3f} s")

    def post(self, node, body):
        connection = HTTPConnection(HOST, node.api, timeout=ANSWERED)
        try:
            connection.request("POST", "/RPC2", body, {"Content-Type": "text/xml"})
            self.assertIn(connection.getresponse().status, (200, 400, 413, 500), body[:500])
        except (HTTPException, ConnectionError):
            pass  # closed in the middle of a request that is refused
        finally:
            connection.close()

    def test_services_with_large_texts(self):
        texts = (LARGE * "a", LARGE * "(", "'" + LARGE * "a", "[" + "1," * (LARGE // 2) + "1]")
        names = {
            "add_memory": lambda text: (text, text, "_", "large", "10"),
            "add_output_subscription": lambda text: (text, "", "_", text, "large"),
            "delete_memory": lambda text: (text,),
            "delete_output_subscription": lambda text: (text, text),
            "add_input_subscription": lambda text: (text, text),
            "delete_input_subscription": lambda text: (text,),
            "retalis/query": lambda text: (text, 0, 0, 0, [], rospy.Time(), 0),
            "retalis/explain": lambda text: (text,),
            "retalis/add_rule": lambda text: (text, ""),
            "retalis/delete_rule": lambda text: (text,),
        }
        before = [usage(node.pid) for node in self.nodes]
        self.call_all_large(names, texts)
        settled = [usage(node.pid) for node in self.nodes]
        self.call_all_large(names, texts)
        for node, then, at_first in zip(self.nodes, settled, before):
            node.call()
            self.assertLess(usage(node.pid)[0] - then[0], GROWTH, node.name)
            self.assert_flat(node, at_first, "services with 10 MB")
        self.assertEqual((), self.wrong)

    def call_all_large(self, names, texts):
        """Call each service with each text, and see how long others wait meanwhile."""
        for name, fields in names.items():
            kind = getattr(srv, "".join(word.capitalize() for word in name.rpartition("/")[2].split("_")))
            proxy = wait_for_service(name, kind)
            for text in texts:
                call = threading.Thread(target=self.call_large, args=(name, proxy, fields(text)), daemon=True)
                began, waits = time.monotonic(), []
                call.start()
                while call.is_alive():
                    self.assertLess(time.monotonic() - began, LARGE_ANSWERED, (name, text[:10]))
                    for node in self.nodes:
                        asked = time.monotonic()
                        node.ask_api()
                        waits.append(time.monotonic() - asked)
                    call.join(PAUSE)
                took = time.monotonic() - began
                rospy.loginfo(f"{name} {text[:3]}: {took:.2f} s, others up to {max(waits):.2f} s")
                self.assertLess(max(waits), ANSWERED, (name, text[:10]))

    wrong = ()

    def call_large(self, name, proxy, fields):
        """Call a service; its answer has to be an error, or "ok" for what is long and right."""
        try:
            result = proxy(*fields).result
        except (rospy.ServiceException, Fault, Error) as error:
            result = f"exception: {error}"
        if not result.startswith(("error: ", "ok")) or len(result) > 20_000:
            type(self).wrong = (*self.wrong, (name, result[:500]))

    def tearDown(self):
        for node in self.nodes:
            node.call()
            with node.proxy() as proxy:
                self.assertEqual(proxy.getPid("/attacks")[2], node.pid)
        traces = [one.msg for one in self.log.messages if "internal error" in one.msg]
        self.assertEqual(traces, [])


if __name__ == "__main__":
    rospy.init_node("attacks")
    rostest.rosrun("retalis", "attacks", Attacks)
