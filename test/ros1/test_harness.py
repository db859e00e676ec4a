"""Connection state of the subscribers of tests. Needs the built package, no master."""

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
from harness import Collector  # noqa: E402


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
