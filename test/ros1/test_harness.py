"""Connection state of the subscribers of tests. Needs the built package, no master."""

import os
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Iterator, List, Tuple
from xmlrpc.server import SimpleXMLRPCServer

import pytest

pytest.importorskip("retalis.srv", reason="./install.py test builds the package")

import rospy  # noqa: E402

sys.path.append(str(Path(__file__).resolve().parent))
import harness  # noqa: E402
from harness import ENGINE, INTERFACE, Collector, NodeProcesses  # noqa: E402


@pytest.fixture
def publisher() -> Iterator[Any]:
    """Serve a node that lists its connections as rospy and roscpp do; return its address and their ports."""
    ports: List[Any] = []

    def bus_info(caller: Any) -> List[Any]:
        description = "TCPROS connection on port 40001 to [127.0.0.1:{} on socket 9]"
        rows = [
            [number, "/listener", "o", "TCPROS", "/news", True, description.format(port)]
            for number, port in enumerate(ports)
        ]
        return [1, "bus info", rows]

    with SimpleXMLRPCServer(("localhost", 0), logRequests=False) as server:
        server.register_function(bus_info, "getBusInfo")
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://localhost:{server.server_address[1]}", ports
        server.shutdown()
        thread.join()


@pytest.fixture
def link(publisher: Tuple[Any, ...]) -> Any:
    """Return a connection on which the publisher has written its header."""
    return SimpleNamespace(
        endpoint_id=publisher[0], header={"callerid": "/talker"}, local_endpoint=("127.0.0.1", 5000)
    )


@pytest.fixture
def collector(link: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    subscriber = SimpleNamespace(impl=SimpleNamespace(connections=[link]))
    monkeypatch.setattr(rospy, "Subscriber", lambda *_, **__: subscriber)
    return Collector("news", rospy.AnyMsg)


def test_connection_needs_more_than_header(collector: Any, publisher: Tuple[Any, ...]) -> None:
    assert not collector.is_connected()
    assert collector.publishers() == []
    publisher[1].append(15000)  # the port of another subscriber
    assert not collector.is_connected()
    assert collector.publishers() == []


def test_connection_is_known_by_publisher(collector: Any, publisher: Tuple[Any, ...]) -> None:
    publisher[1].append(5000)
    assert collector.is_connected()
    assert collector.publishers() == ["/talker"]


def test_ended_publisher_has_no_connection(collector: Any, link: Any) -> None:
    link.endpoint_id = "http://localhost:1"
    assert not collector.is_connected()
    assert collector.publishers() == []


def test_hanging_node_is_killed_and_others_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    node = tmp_path / "node"
    # `sleep` inherits that the signal is ignored. Each node writes its process number when it is ready.
    node.write_text(
        f'#!/bin/sh\n[ "$1" = "__name:={ENGINE}" ] && trap "" INT\necho $$ > "{tmp_path}/$1"\nexec sleep 100\n'
    )
    node.chmod(0o755)
    monkeypatch.setattr(harness.roslib.packages, "find_node", lambda package, name: [str(node)])
    monkeypatch.setattr(harness, "TIMEOUT_SECONDS", 0.2)
    nodes = NodeProcesses("program")
    for name in (ENGINE, INTERFACE):
        nodes.start(name)
        ready_file = tmp_path / f"__name:={name}"
        harness.wait_until(lambda path=ready_file: path.exists() and path.read_text(), name, timeout=20.0)
    with pytest.raises(AssertionError, match=rf"nodes that did not end: \['{ENGINE}'\]"):
        nodes.end_all()
    for name in (ENGINE, INTERFACE):
        with pytest.raises(ProcessLookupError):
            os.kill(int((tmp_path / f"__name:={name}").read_text()), 0)
