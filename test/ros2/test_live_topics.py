"""Topics and services of the node as a process: publishers that appear and end, two namespaces, each service."""

from pathlib import Path
from typing import Any, Dict, List

import pytest
from parsed_sources import ROOT

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from ros2.node_processes import NodeProcess
from ros2.rclpy_nodes import TIMEOUT_SECONDS, Network, wait_until
from std_msgs.msg import String

from retalis import srv

PUB_SUB = """\
<publish_subscribe>
  <subscribe_to name="words" msg_type="std_msgs/String" event="word"/>
  <publish_to name="echo" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = "subscribe(word(W), [], std_msgs__0__String(W), echo, e)\n"


@pytest.fixture
def program(tmp_path: Path) -> Path:
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "pub_sub.xml").write_text(PUB_SUB)
    (folder / "goalPredicates.txt").write_text(GOALS)
    return folder


class Peer:
    """Another node, which publishes words and records their echo.

    Attributes:
        node: the node.
        echo: received texts.
    """

    def __init__(self, network: Network, name: str = "peer", namespace: str = "/") -> None:
        self.node = network.add_node(name, namespace=namespace)
        self.echo: List[str] = []
        self.node.create_subscription(String, "echo", lambda message: self.echo.append(message.data), 100)

    def send(self, publisher: Any, *words: str) -> None:
        """Publish words when node retalis is connected, and wait for their echo."""
        wait_until(publisher.get_subscription_count)
        expected = [*self.echo, *words]
        for word in words:
            publisher.publish(String(data=word))
        wait_until(lambda: len(self.echo) >= len(expected))
        assert self.echo == expected

    def call(self, name: str, service_class: Any, **fields: Any) -> Any:
        """Return the response of a service that succeeds."""
        client = self.node.create_client(service_class, name)
        assert client.wait_for_service(TIMEOUT_SECONDS)
        future = client.call_async(service_class.Request(**fields))
        wait_until(future.done)
        assert future.result().result == "ok", future.result().result
        return future.result()

    def count_publishers(self) -> int:
        """Return the number of publishers of words, as the node lists them."""
        inputs = self.call("/retalis/list", srv.List).inputs
        return next(int(entry.publishers) for entry in inputs if entry.topic == "/words")


def check_end(process: NodeProcess) -> None:
    """Check that the node ends without errors."""
    assert process.interrupt() == 0
    assert "[ERROR]" not in process.log()
    assert "Traceback" not in process.log()


@pytest.mark.slow
def test_publisher_may_appear_late_and_end(network: Network, start_node: Any, program: Path) -> None:
    process = start_node("-p", f"program:={program}")
    peer = Peer(network)
    assert peer.count_publishers() == 0
    camera = network.add_node("camera")
    peer.send(camera.create_publisher(String, "words", 10), "a", "b")
    wait_until(lambda: peer.count_publishers() == 1)
    network.remove_node(camera)
    wait_until(lambda: peer.count_publishers() == 0)
    successor = network.add_node("camera")
    peer.send(successor.create_publisher(String, "words", 10), "c")
    wait_until(lambda: peer.count_publishers() == 1)
    check_end(process)


@pytest.mark.slow
def test_nodes_of_two_namespaces_are_separate(network: Network, start_node: Any, program: Path) -> None:
    processes = [
        start_node("-p", f"program:={program}", "-r", f"__ns:={namespace}") for namespace in ("/r1", "/r2")
    ]
    first, second = Peer(network, "peer", "/r1"), Peer(network, "peer", "/r2")
    publishers = [peer.node.create_publisher(String, "words", 10) for peer in (first, second)]
    first.send(publishers[0], "a")
    second.send(publishers[1], "b", "c")
    first.send(publishers[0], "d")
    assert (first.echo, second.echo) == (["a", "d"], ["b", "c"])
    for namespace, count in (("/r1", 2), ("/r2", 2)):
        inputs = first.call(f"{namespace}/retalis/list", srv.List).inputs
        assert {entry.topic: entry.messages for entry in inputs}[f"{namespace}/words"] == count
    for process in processes:
        check_end(process)


@pytest.mark.slow
def test_each_service_answers(network: Network, start_node: Any, program: Path) -> None:
    process = start_node("-p", f"program:={program}", "-p", "explain:=true")
    peer = Peer(network)
    called: Dict[str, Any] = {}

    def call(name: str, service: str, **fields: Any) -> Any:
        called[service] = getattr(srv, service)
        return peer.call(name, called[service], **fields)

    call("/add_input_subscription", "AddInputSubscription", topic="more", message_type="std_msgs/String")
    call("/add_memory", "AddMemory", event="seen(W)", conditions="", format="W", id="seen", size="5")
    rule = call("/retalis/add_rule", "AddRule", rule="seen(W) <- std_msgs__0__String(W).")
    call(
        "/add_output_subscription",
        "AddOutputSubscription",
        event="seen(W)",
        format="std_msgs__0__String(W)",
        topic="echo",
        id="s",
    )
    peer.send(peer.node.create_publisher(String, "more", 10), "hello")
    solutions = call("/retalis/query", "Query", goal="access_mem(seen, W, _)").solutions
    assert [binding.text for solution in solutions for binding in solution.bindings] == ["'\"hello\"'"]
    explanation = call("/retalis/explain", "Explain", event="seen(_)")
    assert explanation.happened
    assert call("/retalis/reload", "Reload").changes
    listed = call("/retalis/list", "List")
    assert [memory.id for memory in listed.memories] == ["seen"]
    call("/retalis/delete_rule", "DeleteRule", label=rule.label)
    call("/delete_output_subscription", "DeleteOutputSubscription", topic="echo", id="s")
    call("/delete_memory", "DeleteMemory", id="seen")
    call("/delete_input_subscription", "DeleteInputSubscription", topic="more")
    listed = call("/retalis/list", "List")
    assert (list(listed.rules), list(listed.memories)) == ([], [])
    assert "/more" not in {entry.topic for entry in listed.inputs}
    assert sorted(called) == sorted(path.stem for path in (ROOT / "srv").glob("*.srv"))
    check_end(process)
