"""Connection of commands to running nodes of ROS 2, and the commands themselves with nodes in this process."""

import json
import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, Iterator, List

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from rclpy.client import Client
from ros2.rclpy_nodes import Network, wait_until
from std_msgs.msg import String

from retalis import UsageError
from retalis.cli.command_line import main
from retalis.cli.completion import list_names
from retalis.cli.node_client import NodeClient
from retalis.node.parameters import read_parameters
from retalis.node.program_host import ProgramHost
from retalis.node.program_host_context import HostContext
from retalis.node.text_exchange import INPUT, OUTPUT, PlainTextExchange
from retalis.ros2 import rclpy_client
from retalis.ros2.rclpy_client import RclpyClient

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("long_discovery")]


@pytest.fixture
def network(domain: int) -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


@pytest.fixture
def client(domain: int) -> Iterator[RclpyClient]:
    client = RclpyClient()
    yield client
    client.end()


def add_engine(network: Network, name: str = "retalis", **handlers: Any) -> Any:
    """Add a node that is recognized as a node with an engine; return its transport.

    Args:
        network: the nodes.
        name: name of the node.
        handlers: handlers of private services of type ``Query`` by name.
    """
    transport = network.add_transport(name)
    for service, handler in handlers.items():
        transport.offer_service(f"~{service}", "Query", handler)
    transport.offer_service("~list", "List", lambda request: {"result": "ok"})
    transport.offer_service("add_memory", "AddMemory", lambda request: {"result": "ok"})
    return transport


def test_nodes_have_services_and_topics(network: Network, client: RclpyClient) -> None:
    add_engine(network)
    network.add_node("peer", namespace="/robot").create_publisher(String, "texts", 10)
    nodes = client.find_nodes("/retalis")
    assert nodes.services["/retalis/list"] == nodes.services["/add_memory"] == {"/retalis"}
    # The nodes of a process are discovered one after the other.
    wait_until(lambda: client.find_nodes().publishers.get("/robot/texts") == {"/robot/peer"})
    assert NodeClient(client).name == NodeClient(client, "retalis").name == "/retalis"


def test_found_node_ends_wait(network: Network, client: RclpyClient) -> None:
    add_engine(network, "monitor")
    assert NodeClient(client, "/monitor").has_engine
    assert NodeClient(client).name == "/monitor"


def test_missing_node_is_an_error(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rclpy_client, "DISCOVERY_SECONDS", 0.1)
    client = RclpyClient()
    try:
        with pytest.raises(UsageError, match=rf"^no node retalis runs in domain {domain} \(ROS_DOMAIN_ID\)$"):
            NodeClient(client)
    finally:
        client.end()


def test_names_are_relative_to_root(client: RclpyClient) -> None:
    assert client.resolve_node("robot/retalis") == client.resolve_node("/robot/retalis") == "/robot/retalis"


def test_request_and_response_have_plain_values(network: Network, client: RclpyClient) -> None:
    requests: List[Dict[str, Any]] = []
    binding = {"name": "X", "text": "1", "json": "1"}

    def answer(request: Any) -> Dict[str, Any]:
        requests.append(vars(request))
        return {"result": "ok", "complete": True, "solutions": [{"bindings": [binding]}]}

    add_engine(network, query=answer)
    fields = {"goal": "X = 1", "wait_for": ["m"], "stamp": 5 * 10**9 + 7, "seconds": 0.5}
    response = NodeClient(client, "retalis").call("query", "Query", **fields)
    assert requests[0].items() >= fields.items()
    assert requests[0]["inferences"] == 0
    assert vars(response) == {
        "result": "ok",
        "complete": True,
        "solutions": [SimpleNamespace(bindings=[SimpleNamespace(**binding)])],
    }


def test_times_of_response_are_nanoseconds(network: Network, client: RclpyClient) -> None:
    transport = network.add_transport("retalis")
    memory = {"id": "m", "newest": 3 * 10**9 + 4}
    status = {"result": "ok", "now": 2 * 10**9 + 1, "work_time": -1, "memories": [memory]}
    transport.offer_service("~list", "List", lambda request: status)
    transport.offer_service("add_memory", "AddMemory", lambda request: {"result": "ok"})
    response = NodeClient(client, "retalis").call("list", "List")
    assert (response.now, response.work_time) == (2 * 10**9 + 1, -1)
    assert (response.memories[0].newest, response.memories[0].oldest) == (3 * 10**9 + 4, 0)


def test_silent_service_is_an_error(
    network: Network, client: RclpyClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = threading.Event()
    service_clients: List[Client] = []
    call_async = Client.call_async

    def record_call(service_client: Client, request: Any) -> Any:
        service_clients.append(service_client)
        return call_async(service_client, request)

    monkeypatch.setattr(Client, "call_async", record_call)

    def wait(request: Any) -> Dict[str, Any]:
        ended.wait(60)
        return {"result": "ok"}

    add_engine(network, query=wait)
    client.find_nodes("/retalis")
    try:
        with pytest.raises(
            UsageError, match="^service /retalis/query does not answer: no response within 0.1 s$"
        ):
            client.call("/retalis/query", "Query", {}, 0.1)
        # rclpy has no public list of the requests that wait for a response.
        assert [service_client._pending_requests for service_client in service_clients] == [{}]  # noqa: SLF001
    finally:
        ended.set()


def test_end_of_called_node_is_an_error(client: RclpyClient) -> None:
    other_process = Network()
    called, ended = threading.Event(), threading.Event()

    def wait(request: Any) -> Dict[str, Any]:
        called.set()
        ended.wait(60)
        return {"result": "ok"}

    add_engine(other_process, query=wait)
    client.find_nodes("/retalis")

    def end_node() -> None:
        called.wait(60)
        other_process.close()

    thread = threading.Thread(target=end_node)
    thread.start()
    try:
        with pytest.raises(UsageError, match="^service /retalis/query does not answer: its node has ended$"):
            client.call("/retalis/query", "Query", {}, 3600.0)
    finally:
        ended.set()
        thread.join()


def test_service_without_server_is_an_error(client: RclpyClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rclpy_client, "CONNECTION_SECONDS", 0.1)
    with pytest.raises(UsageError, match="^service /x/list does not answer: no node offers it$"):
        client.call("/x/list", "List", {}, 1.0)


def test_published_texts_are_received(network: Network, client: RclpyClient) -> None:
    publisher = network.add_node("peer").create_publisher(String, "texts", 10)
    texts: List[str] = []
    add_engine(network)
    client.start_node("retalis_watch")
    wait_until(lambda: "/texts" in client.find_nodes().publishers)
    client.subscribe("/texts", texts.append)
    wait_until(publisher.get_subscription_count)
    publisher.publish(String(data="a"))
    wait_until(lambda: texts)
    assert texts == ["a"]
    (subscriber,) = network.add_node("other").get_subscriptions_info_by_topic("/texts")
    assert subscriber.node_name == f"retalis_watch_{os.getpid()}"


def test_waiting_receiver_delays_no_response(network: Network, client: RclpyClient) -> None:
    publisher = network.add_node("peer").create_publisher(String, "texts", 10)
    add_engine(network)
    received, ended = threading.Event(), threading.Event()

    def wait(text: str) -> None:
        received.set()
        ended.wait(60)

    client.find_nodes("/retalis")
    client.start_node("retalis_watch")
    client.subscribe("/texts", wait)
    wait_until(publisher.get_subscription_count)
    publisher.publish(String(data="a"))
    assert received.wait(60)
    assert client.call("/retalis/list", "List", {}, 60.0).result == "ok"
    ended.set()


@pytest.fixture
def node(network: Network, tmp_path: Path) -> Any:
    """Return the transport of a node with a program."""
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "goalPredicates.txt").write_text("memorize(a(X), [], X, numbers, 5)\n")
    transport = network.add_transport("retalis")
    parameters = read_parameters(
        {"program": str(tmp_path), "diagnostics": 0, "watchdog": 0, "embedded": True}, lambda: tmp_path
    )
    context = HostContext(transport, parameters, network.reports)
    ProgramHost(context, PlainTextExchange(context))
    return transport


def test_commands_ask_node(
    node: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_VERSION", "2")
    assert main(["query", "member(X, [1, f(_)])"]) == 0
    assert capsys.readouterr() == ("X = 1\nX = f(_1)\n", "")
    assert main(["list", "--json", "--node", "/retalis"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["memories"][0]["id"] == "numbers"
    # Completion has little time, in which a busy machine does not discover the node.
    wait_until(lambda: list_names("nodes", None) == ["/retalis"])
    wait_until(lambda: list_names("memories", "retalis") == ["numbers"])
    # Which other nodes are known after this time depends on the machine.
    monkeypatch.setattr(rclpy_client, "DISCOVERY_SECONDS", 0.1)
    assert main(["query", "true", "--node", "other"]) == 1
    assert capsys.readouterr().err.startswith("retalis: there is no node /other; ")


def test_events_are_watched(
    node: Any, network: Network, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_VERSION", "2")
    publisher = network.add_node("peer").create_publisher(String, INPUT, 10)
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.05):
            publisher.publish(String(data="event(fever_('A b'))"))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        assert main(["watch", "--event", "fever_(_)", "--count", "1"]) == 0
    finally:
        ended.set()
        thread.join()
    assert capsys.readouterr().out == "event: fever_('A b')\n"
    assert f"/{OUTPUT}" in node.graph().publishers
    assert node.graph().servers
