"""Dashboard of a node: on request only, and optional for the node."""

import json
import os
import re
import socket
import urllib.request
from typing import Any, Set

import pytest
from asserting_accessors import required

from retalis.dashboard.page_server import DASHBOARD_PORT

LISTENS = "0A"


def launch(space: Any, *arguments: Any) -> None:
    space.start_master()
    space.start(
        "roslaunch", "-p", str(space.port), "retalis", "retalis.launch", "use_sim_time:=false", *arguments
    )
    space.expect(
        lambda nodes, services: (
            {"/retalis", "/retalis_ros_interface"} <= nodes and "/retalis/list" in services
        )
    )


def listening_addresses(pid: Any) -> Any:
    """Return the addresses and ports on which a process listens."""
    sockets: Set[Any] = set()
    for name in os.listdir(f"/proc/{pid}/fd"):
        try:
            sockets.add(os.readlink(f"/proc/{pid}/fd/{name}"))
        except OSError:
            pass  # the file is closed in between
    addresses: Set[Any] = set()
    with open(f"/proc/{pid}/net/tcp") as table:
        for row in list(table)[1:]:
            fields = row.split()
            if fields[3] == LISTENS and f"socket:[{fields[9]}]" in sockets:
                address, port = fields[1].split(":")
                addresses.add((address, int(port, 16)))
    return addresses


@pytest.fixture
def free_port() -> Any:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def open_page(port: Any, path: str = "/") -> Any:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    return opener.open(f"http://127.0.0.1:{port}{path}", timeout=60)


def next_snapshot(stream: Any) -> Any:
    for line in stream:
        if line == b"event: snapshot\n":
            return json.loads(next(stream)[len("data: ") :])
    return pytest.fail("the stream has ended")


def test_no_port_is_opened_by_default(devel: Any) -> None:
    launch(devel)
    addresses = listening_addresses(devel.pid("/retalis"))
    assert len(addresses) == 2  # those of the node and of its connections
    assert DASHBOARD_PORT not in {port for _, port in addresses}
    assert "the dashboard is at" not in devel.printed()


def test_page_on_loopback_address_has_events(devel: Any, free_port: Any) -> None:
    launch(devel, f"dashboard:={free_port}")
    devel.expect(
        lambda nodes, services: f"the dashboard is at http://127.0.0.1:{free_port}/" in devel.printed()
    )
    assert ("0100007F", free_port) in listening_addresses(devel.pid("/retalis"))
    for path in ("/", "/dashboard.js", "/graph.js", "/dashboard.css", "/icon.svg"):
        with open_page(free_port, path) as response:
            assert response.read()
    with open_page(free_port, "/stream") as stream:
        snapshot = next_snapshot(stream)
        assert (snapshot["title"], snapshot["queries"], snapshot["explains"]) == ("/retalis", False, False)
        devel.post_events("known_face(anna),[1,1]")
        while not any(event["text"] == "known_face(anna)" for event in snapshot["events"]):
            snapshot = next_snapshot(stream)
        # The other node sends the numbers of publishers.
        while not any(topic["publishers"] is not None for topic in snapshot["topics"]):
            snapshot = next_snapshot(stream)
    names = {topic["name"] for topic in snapshot["topics"]}
    assert names == {"/tf", "/ar_pose_marker", "/face_recognition/feedback"}


def test_used_port_is_replaced_and_logged(devel: Any) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen(1)
        port = other.getsockname()[1]
        launch(devel, f"dashboard:={port}")
        message = re.compile(rf"port {port} is taken: the dashboard is at http://127\.0\.0\.1:(\d+)/")
        devel.expect(lambda nodes, services: message.search(devel.printed()))
        next_port = int(required(message.search(devel.printed()))[1])
        assert port < next_port
        with open_page(next_port) as response:
            assert response.read()
