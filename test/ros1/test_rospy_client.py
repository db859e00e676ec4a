"""Connection of commands to running nodes of ROS 1. Needs rospy, no master."""

import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any, Iterator

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")
pytest.importorskip("retalis.srv", reason="the services of the package are not built")

from retalis import UsageError  # noqa: E402
from retalis.ros1 import rospy_client  # noqa: E402
from retalis.ros1.internode_control_topics import INPUT_CHANGES_TOPIC  # noqa: E402
from retalis.ros1.internode_delivery import find_nodes_offering  # noqa: E402
from retalis.ros1.rospy_client import RospyClient  # noqa: E402


def test_names_are_relative_to_ros_namespace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_NAMESPACE", raising=False)
    client = RospyClient()
    assert (client.namespace, client.resolve_node("retalis")) == ("/", "/retalis")
    monkeypatch.setenv("ROS_NAMESPACE", "robot1/arm")
    client = RospyClient()
    assert client.namespace == "/robot1/arm/"
    assert client.resolve_node("retalis") == "/robot1/arm/retalis"
    assert client.resolve_node("/retalis") == "/retalis"


def test_interfaces_are_found_by_topic_of_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    topic = f"/lab/{INPUT_CHANGES_TOPIC}"
    state = [
        [[topic, ["/lab/senses", "/lab/brain"]], ["/tf", ["/robot"]]],
        [[topic, ["/lab/brain"]], ["/tf", ["/lab/senses"]]],
        [["/lab/add_memory", ["/lab/brain"]]],
    ]
    monkeypatch.setattr(rospy_client, "get_system_state", lambda: state)
    nodes = RospyClient().find_nodes()
    assert nodes.services == {"/lab/add_memory": {"/lab/brain"}}
    assert nodes.publishers["/tf"] == {"/robot"}
    assert nodes.interfaces == {"/lab/brain": {"/lab/senses"}}


class PageHandler(BaseHTTPRequestHandler):
    """Handler of a web server that is no master: it answers a POST with a page."""

    def do_POST(self) -> None:  # noqa: N802 - name of the base class
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><p>Hello</br>")

    def log_message(self, *arguments: Any) -> None:
        """Print nothing."""


class ReadOnlyHandler(BaseHTTPRequestHandler):
    """Handler of a web server that does not support POST."""

    def log_message(self, *arguments: Any) -> None:
        """Print nothing."""


@pytest.fixture
def web_server(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Return the URI of a web server with a handler, which is the URI of the master."""
    with HTTPServer(("127.0.0.1", 0), request.param) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        uri = f"http://127.0.0.1:{server.server_port}"
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        yield uri
        server.shutdown()
        thread.join(30)


@pytest.mark.parametrize(
    ("web_server", "reason"),
    [(PageHandler, "syntax error: line 1"), (ReadOnlyHandler, "501 Unsupported method")],
    indirect=["web_server"],
)
def test_web_server_is_no_master(web_server: str, reason: str) -> None:
    with pytest.raises(UsageError) as caught:
        rospy_client.get_system_state()
    text = str(caught.value)
    assert text.startswith(f"no master answers at {web_server}: ")
    assert reason in text
    assert text.endswith(": start one (roscore), or set ROS_MASTER_URI")
    # A buffer of texts asks the same master, and goes on without an answer.
    assert find_nodes_offering("/retalis/list") == set()


def test_missing_service_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    def call(self: Any, request: Any) -> None:
        raise rospy.ServiceException("no such service")

    monkeypatch.setattr(rospy.ServiceProxy, "__call__", call)
    with pytest.raises(UsageError, match="^service /retalis/list does not answer: no such service$"):
        RospyClient().call("/retalis/list", "List", {"most": 5}, 60.0)
