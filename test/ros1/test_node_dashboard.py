"""Dashboard of a node: on request only, and optional for the node."""

import json
import os
import re
import socket
import urllib.request

import pytest

from retalis.dashboard.page_server import DASHBOARD_PORT

LISTENS = "0A"


def launch(space, *arguments):
    space.start_master()
    space.start(
        "roslaunch", "-p", str(space.port), "retalis", "retalis.launch", "use_sim_time:=false", *arguments
    )
    space.expect(
        lambda found, services: (
            {"/retalis", "/retalis_ros_interface"} <= found and "/retalis/list" in services
        )
    )


def listening(pid):
    """Return the addresses and ports on which a process listens."""
    sockets = set()
    for name in os.listdir(f"/proc/{pid}/fd"):
        try:
            sockets.add(os.readlink(f"/proc/{pid}/fd/{name}"))
        except OSError:
            pass  # it has just been closed
    found = set()
    with open(f"/proc/{pid}/net/tcp") as table:
        for row in list(table)[1:]:
            fields = row.split()
            if fields[3] == LISTENS and f"socket:[{fields[9]}]" in sockets:
                address, port = fields[1].split(":")
                found.add((address, int(port, 16)))
    return found


@pytest.fixture
def free():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def opened(port, path="/"):
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    return opener.open(f"http://127.0.0.1:{port}{path}", timeout=60)


def next_look(stream):
    for line in stream:
        if line == b"event: snapshot\n":
            return json.loads(next(stream)[len("data: ") :])
    return pytest.fail("the stream has ended")


def test_by_default_no_port_is_opened(devel):
    launch(devel)
    found = listening(devel.pid("/retalis"))
    assert len(found) == 2  # the node's own, and that of its connections
    assert DASHBOARD_PORT not in {port for _, port in found}
    assert "the dashboard is at" not in devel.printed()


def test_the_page_is_served_on_the_loopback_address_and_shows_what_comes(space, free):
    launch(space, f"dashboard:={free}")
    space.expect(lambda found, services: f"the dashboard is at http://127.0.0.1:{free}/" in space.printed())
    assert ("0100007F", free) in listening(space.pid("/retalis"))
    for path in ("/", "/dashboard.js", "/graph.js", "/dashboard.css", "/icon.svg"):
        with opened(free, path) as answer:
            assert answer.read()
    with opened(free, "/stream") as stream:
        look = next_look(stream)
        assert (look["title"], look["queries"], look["explains"]) == ("/retalis", False, False)
        space.post_events("known_face(anna),[1,1]")
        while not any(one["text"] == "known_face(anna)" for one in look["events"]):
            look = next_look(stream)
        while not any(one["publishers"] is not None for one in look["topics"]):  # told by the other node
            look = next_look(stream)
    names = {one["name"] for one in look["topics"]}
    assert names == {"/tf", "/ar_pose_marker", "/face_recognition/feedback"}


def test_where_a_port_is_taken_the_page_has_the_next_free_one_and_the_log_names_it(devel):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen(1)
        port = other.getsockname()[1]
        launch(devel, f"dashboard:={port}")
        said = re.compile(rf"port {port} is taken: the dashboard is at http://127\.0\.0\.1:(\d+)/")
        devel.expect(lambda found, services: said.search(devel.printed()))
        taken = int(said.search(devel.printed())[1])
        assert port < taken
        with opened(taken) as answer:
            assert answer.read()
