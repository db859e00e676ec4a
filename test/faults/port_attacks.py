#!/usr/bin/env python3
"""Attacks on the ports of running nodes from the loopback address: malformed XML-RPC requests, large service calls.

rostest retalis port_attacks.test requests:=20000 seed:=2 characters:=10000000
"""

import random
import sys
import threading
import time
import unittest
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any, Tuple
from urllib.parse import urlparse
from xmlrpc.client import Binary, Error, Fault, ServerProxy, dumps

import rospy
import rostest
from rosgraph_msgs.msg import Log

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE.parent), str(HERE.parent / "ros1")]
from fuzz.mutate import mutate_bytes  # noqa: E402
from harness import Collector, wait_for_message_path, wait_for_service, wait_until  # noqa: E402

from retalis import srv  # noqa: E402

HOST = "127.0.0.1"
NODES = ("/retalis", "/retalis_ros_interface")

PAUSE_SECONDS = 0.05
"""Seconds between two calls of other clients during a large service call."""

ANSWER_TIMEOUT_SECONDS = 10.0
"""Seconds after which a call has failed."""

MAX_GROWTH_KILOBYTES = 30 << 10
"""kB by which a node may grow in an attack."""

LARGE_ANSWER_TIMEOUT_SECONDS = 60.0
"""Seconds after which a service call with large texts has failed."""


def usage(pid: Any) -> Tuple[Any, ...]:
    """Return memory in kB, threads and open files of a process."""
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return (
        int(status["VmRSS"].split()[0]),
        int(status["Threads"]),
        sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
    )


class Node:
    """A node under attack."""

    def __init__(self, name: Any) -> None:
        master = rospy.get_master()
        self.name = name
        self.api = urlparse(master.lookupNode(name)[2]).port
        self.list = wait_for_service(f"{name}/list", srv.List)
        with self.proxy() as proxy:
            self.pid = proxy.getPid("/attacks")[2]

    def proxy(self) -> Any:
        return ServerProxy(f"http://{HOST}:{self.api}/")

    def call(self) -> None:
        assert self.list(1).result == "ok"

    def ask_api(self) -> None:
        with self.proxy() as proxy:
            assert proxy.getPid("/attacks")[2] == self.pid


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
"""Methods of the slave API without ``shutdown``, which ends the node by design."""

UNREACHABLE_URI = f"http://{HOST}:1/"
"""URI of a publisher that does not answer; the node may try to connect to it."""


def value(chance: Any, depth: int = 0) -> Any:
    """Return an argument of any type."""
    deeper = depth < 5
    return chance.choice(
        (
            lambda: chance.choice(
                ("", "/tf", "/fuzz", "/retalisInputEvents", "é\0", "x" * 10_000, UNREACHABLE_URI)
            ),
            lambda: chance.choice((0, -1, 2**31 - 1, True)),
            lambda: chance.choice((0.5, float("nan"), 1e300)),
            lambda: Binary(b"\0\xff"),
            lambda: None,
            lambda: [value(chance, depth + 1) for _ in range(chance.randrange(4))] if deeper else [],
            lambda: {"k": value(chance, depth + 1)} if deeper else {},
            lambda: [UNREACHABLE_URI] * chance.choice((1, 2, 20)),
            lambda: [["TCPROS"]],
            lambda: [[], "TCPROS", 1],
        )
    )()


def request(chance: Any) -> bytes:
    """Return the body of an XML-RPC request, with arguments of any number and type."""
    method = chance.choice(METHODS)
    arguments = ["/attacks"] * (chance.random() < 0.8)
    arguments += [value(chance) for _ in range(chance.choice((0, 0, 1, 2, 2, 2, 3, 9)))]
    return dumps(tuple(arguments), method, allow_none=True).encode("utf-8", "replace")


VALID = [
    dumps(("/attacks", "/nobody", [UNREACHABLE_URI]), "publisherUpdate").encode(),
    dumps(("/attacks", "/nobody", [["TCPROS"]]), "requestTopic").encode(),
    dumps(("/attacks", "/nobody", {"a": [1, 2.5, "x"]}), "paramUpdate").encode(),
    dumps(("/attacks",), "getBusInfo").encode(),
]
"""Requests to damage: their topic has no subscriber, so that the node connects to no damaged address."""

NESTED = b"<value><array><data>" * 5_000

FIXED_BODIES = (
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
    characters: Any
    log: Collector
    nodes: Any
    seed: Any
    requests: Any

    @classmethod
    def setUpClass(cls) -> None:
        numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
        cls.requests, cls.seed, cls.characters = numbers if len(numbers) == 3 else (100, 1, 200_000)
        wait_for_message_path()
        cls.log = Collector("/rosout", Log)
        wait_until(cls.log.is_connected, "the nodes' log")
        cls.nodes = [Node(name) for name in NODES]

    def assert_flat(self, node: Any, before: Any, attack: str) -> None:
        """Wait until a node has the previous numbers of threads and files, and log them."""

        def is_flat() -> Any:
            _, threads, files = usage(node.pid)
            return threads <= before[1] + 5 and files <= before[2] + 5

        wait_until(is_flat, f"the end of threads and files of {node.name} after {attack}", pause=0.1)
        rospy.loginfo(f"{node.name}: {attack}: kB, threads, files: {before} before, {usage(node.pid)} after")

    def test_malformed_xmlrpc_requests_are_refused(self) -> None:
        for node in self.nodes:
            chance = random.Random(f"xmlrpc {self.seed} {node.name}")
            before = usage(node.pid)
            slowest = 0.0
            bodies = [*FIXED_BODIES]
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
            self.assertLess(usage(node.pid)[0] - before[0], MAX_GROWTH_KILOBYTES, node.name)
            self.assert_flat(node, before, f"{self.requests} XML-RPC requests, the slowest {slowest:.3f} s")

    def post(self, node: Any, body: Any) -> None:
        connection = HTTPConnection(HOST, node.api, timeout=ANSWER_TIMEOUT_SECONDS)
        try:
            connection.request("POST", "/RPC2", body, {"Content-Type": "text/xml"})
            self.assertIn(connection.getresponse().status, (200, 400, 413, 500), body[:500])
        except (HTTPException, ConnectionError):
            pass  # the node closes the connection of a refused request
        finally:
            connection.close()

    def test_large_service_calls_are_answered(self) -> None:
        size = self.characters
        texts = (size * "a", size * "(", "'" + size * "a", "[" + "1," * (size // 2) + "1]")
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
        # Memory, threads and files of a node are constant after the first round.
        self.call_all_large(names, texts)
        settled = [usage(node.pid) for node in self.nodes]
        self.call_all_large(names, texts)
        for node, settled_usage in zip(self.nodes, settled):
            node.call()
            self.assertLess(usage(node.pid)[0] - settled_usage[0], MAX_GROWTH_KILOBYTES, node.name)
            self.assert_flat(node, settled_usage, f"services with {size} characters")
        self.assertEqual((), self.invalid_answers)

    def call_all_large(self, names: Any, texts: Any) -> None:
        """Call each service with each text, and measure the waits of other calls meanwhile."""
        for name, fields in names.items():
            class_name = "".join(word.capitalize() for word in name.rpartition("/")[2].split("_"))
            proxy = wait_for_service(name, getattr(srv, class_name))
            for text in texts:
                call = threading.Thread(target=self.call_large, args=(name, proxy, fields(text)), daemon=True)
                began, waits = time.monotonic(), []
                call.start()
                while call.is_alive():
                    self.assertLess(time.monotonic() - began, LARGE_ANSWER_TIMEOUT_SECONDS, (name, text[:10]))
                    for node in self.nodes:
                        call_start = time.monotonic()
                        node.ask_api()
                        waits.append(time.monotonic() - call_start)
                    call.join(PAUSE_SECONDS)
                duration = time.monotonic() - began
                rospy.loginfo(
                    f"{name} {text[:3]}: {duration:.2f} s, others up to {max(waits, default=0.0):.2f} s"
                )
                self.assertLess(max(waits, default=0.0), ANSWER_TIMEOUT_SECONDS, (name, text[:10]))

    invalid_answers: Tuple[Any, ...] = ()

    def call_large(self, name: Any, proxy: Any, fields: Any) -> None:
        """Call a service; its answer must be an error, or "ok" for a valid text."""
        try:
            result = proxy(*fields).result
        except (rospy.ServiceException, Fault, Error) as error:
            result = f"exception: {error}"
        if not result.startswith(("error: ", "ok")) or len(result) > 20_000:
            type(self).invalid_answers = (*self.invalid_answers, (name, result[:500]))

    def tearDown(self) -> None:
        for node in self.nodes:
            node.call()
            with node.proxy() as proxy:
                self.assertEqual(proxy.getPid("/attacks")[2], node.pid)
        errors = [record.msg for record in self.log.messages if "internal error" in record.msg]
        self.assertEqual(errors, [])


if __name__ == "__main__":
    rospy.init_node("attacks")
    rostest.rosrun("retalis", "attacks", Attacks)
