"""Commands for a running node, whose connection is in memory."""

import json
import re
import signal
from pathlib import Path
from typing import Any, Callable, Iterator, List

import pytest
from cli.memory_client import MemoryClient
from node.in_memory_hosts import Robot, start_host
from node.memory_transport import MemoryNetwork, MemoryTransport

from retalis import UsageError
from retalis.cli import node_client_commands, node_console
from retalis.cli.command_line import main
from retalis.cli.completion import list_names
from retalis.node.text_exchange import serialize_text

GOALS = """
compile_event_file('rules.txt')
subscribe(std_msgs__0__String(_), [], _, alarm, s1)
memorize(a(X), [], X, numbers, 5)
"""
TOPICS = """
<publish_subscribe>
  <subscribe_to name="scan" msg_type="std_msgs/String" event="scan"/>
  <publish_to name="alarm" msg_type="std_msgs/String"/>
</publish_subscribe>
"""


@pytest.fixture
def network() -> MemoryNetwork:
    return MemoryNetwork()


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "pub_sub.xml").write_text(TOPICS)
    (tmp_path / "goalPredicates.txt").write_text(GOALS)
    (tmp_path / "rules.txt").write_text("b(X) <- a(X).\n")
    return tmp_path


@pytest.fixture
def node(network: Any, program: Path) -> Iterator[Any]:
    """Return node ``/retalis`` of the network."""
    host = start_host(network, program, explain=True)
    yield host
    host.transport.shut_down()


@pytest.fixture
def connect(monkeypatch: pytest.MonkeyPatch, network: Any) -> Callable[..., MemoryClient]:
    """Return a function that lets the commands use a connection in memory, with options."""

    def connect(**options: Any) -> MemoryClient:
        client = MemoryClient(network, **options)
        for module in (node_client_commands, node_console):
            monkeypatch.setattr(module, "connect_client", lambda: client)
        return client

    return connect


@pytest.fixture
def client(node: Any, connect: Any) -> MemoryClient:
    """Return the connection of the commands."""
    return connect()


@pytest.fixture
def output(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return a function that returns the output of a command."""

    def output(*words: str, status: int = 0) -> str:
        assert main([*words]) == status
        texts = capsys.readouterr()
        assert texts.err == ""
        return texts.out

    return output


@pytest.fixture
def error(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return a function that returns the error of a command."""

    def error(*words: str) -> str:
        assert main([*words]) == 1
        return capsys.readouterr().err

    return error


def send(network: Any, *events: str) -> None:
    """Publish events as texts."""
    publisher = Robot(network).publish("/retalisInputEvents")
    for event in events:
        publisher.send(serialize_text(f"event({event})"))
    publisher.close()


def test_connection_ends_after_command(client: MemoryClient, output: Any, error: Any) -> None:
    output("list")
    assert client.is_ended
    client.is_ended = False
    error("query", "true", "--node", "other")
    assert client.is_ended


def test_query_prints_solutions(client: MemoryClient, output: Any) -> None:
    assert output("query", "member(X, [1, f(_)])") == "X = 1\nX = f(_1)\n"
    assert output("query", "true") == "true\n"
    assert output("query", "fail", status=1) == "false\n"
    lines = output("query", "member(X-Y, [a-1, b-[2]])", "--json", "--node", "/retalis").splitlines()
    assert [json.loads(line) for line in lines] == [{"X": "a", "Y": 1}, {"X": "b", "Y": [2]}]


def test_omitted_solutions_are_reported(client: MemoryClient, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["query", "member(X, [1, 2])", "--most", "1"]) == 0
    assert capsys.readouterr() == ("X = 1\n", "there are more solutions (see --most)\n")


def test_errors_of_node_are_printed(client: MemoryClient, error: Any) -> None:
    assert "column 4" in error("query", "f(X")
    assert "those that run are /retalis" in error("query", "true", "--node", "other")
    late = error("query", "true", "--wait-for", "numbers", "--stamp", "5.5", "--timeout", "0.01")
    assert "in memory numbers (nothing yet) after 0.01 s" in late


@pytest.mark.parametrize("stamp", ["1e12", "-1", "nan"])
def test_invalid_stamp_is_an_error(client: MemoryClient, error: Any, stamp: str) -> None:
    (line,) = error("query", "true", "--stamp", stamp).splitlines()
    assert line.startswith("retalis: --stamp: expected seconds since the epoch")


@pytest.mark.parametrize("every", ["0", "nan", "inf"])
def test_invalid_interval_is_an_error(client: MemoryClient, error: Any, every: str) -> None:
    (line,) = error("status", "--every", every).splitlines()
    assert line.startswith("retalis: --every: expected a number above 0")


def test_stamp_beyond_times_of_middleware_is_an_error(
    client: MemoryClient, error: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "end_of_time", 1 << 31)
    assert error("query", "true", "--stamp", "2147483648") == (
        "retalis: --stamp: expected seconds since the epoch, below 2147483648, found 2147483648\n"
    )


@pytest.mark.parametrize(
    ("stamp", "nanoseconds"),
    [("4294967295.5", 4_294_967_295_500_000_000), ("1.001", 1_001_000_000), ("0.3", 300_000_000)],
)
def test_stamp_keeps_its_digits(
    client: MemoryClient, node: Any, network: Any, output: Any, stamp: str, nanoseconds: int
) -> None:
    requests: List[Any] = []

    def handle(request: Any) -> Any:
        requests.append(request)
        return {"result": "ok", "complete": True, "solutions": [{"bindings": []}]}

    node.transport.offer_service("~query", "Query", handle)
    output("query", "true", "--stamp", stamp, "--seconds", "2", "--wait-for", "m")
    assert vars(requests[0]) == {
        "goal": "true",
        "max_solutions": 100,
        "seconds": 2.0,
        "inferences": 0,
        "wait_for": ["m"],
        "stamp": nanoseconds,
        "timeout": 10.0,
    }


def test_explanation_is_printed(client: MemoryClient, network: Any, output: Any) -> None:
    send(network, "a(1)")
    assert output("explain", "b(1)").startswith("b(1) happened\n")
    assert output("explain", "b(2)").startswith("b(2) did not happen\n")
    assert json.loads(output("explain", "b(2)", "--json"))["happened"] is False


def test_reload_prints_changes(client: MemoryClient, program: Path, output: Any, error: Any) -> None:
    (program / "rules.txt").write_text("b(X) <- a(X).\nc(X) <- a(X).\n")
    assert "rules: 1 new, 0 gone, 1 kept" in output("reload")
    assert json.loads(output("reload", "--json"))[0].startswith("rules: 0 new")
    (program / "rules.txt").write_text("b(X <- a(X).\n")
    assert "rules.txt" in error("reload")


def test_list_prints_contents_of_node(client: MemoryClient, network: Any, output: Any) -> None:
    listed = json.loads(output("list", "--json"))
    assert list(listed)[:2] == ["node", "now"]
    assert (listed["node"], listed["now"], listed["memories"][0]["oldest"]) == ("/retalis", 1000.0, None)
    assert {topic["topic"]: topic["age"] for topic in listed["inputs"]}["/scan"] is None
    send(network, "a(1)")
    text = output("list")
    assert text.startswith("node      /retalis\ntime      1000\n")
    assert "events    1 received" in text
    assert re.search(r"\n  numbers +a\(", text)


def test_inputs_of_interface_are_listed(node: Any, network: Any, connect: Any, output: Any) -> None:
    interface = MemoryTransport(network, "/senses")
    topic = {"topic": "/tf", "type": "tf/tfMessage", "messages": 4}
    interface.offer_service(
        "~list", "List", lambda request: {"result": "ok", "inputs": [topic], "more_inputs": 3}
    )
    connect(interfaces={"/retalis": {"/senses"}})
    listed = json.loads(output("list", "--json"))
    assert listed["inputs"][-1]["node"] == "/senses"
    assert (listed["inputs"][-1]["topic"], listed["more_inputs"]) == ("/tf", 3)


def test_ended_interface_is_reported_once(
    node: Any, connect: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    connect(interfaces={"/retalis": {"/senses"}})
    assert main(["status", "--once", "--every", "0.001"]) == 0
    texts = capsys.readouterr()
    assert texts.out.startswith("/retalis  idle")
    assert texts.err == "retalis: there is no node /senses; those that run are /retalis\n"


def test_status_fits_terminal(client: MemoryClient, output: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = output("status", "--once", "--every", "0.001").split("\n")
    assert lines[0].startswith("/retalis  idle  0.0 events/s  0.0 firings/s")
    assert "memories" in lines
    assert max(map(len, lines)) <= 80
    assert not any(re.search(r"\d{9}", line) for line in lines)  # no seconds since the epoch
    assert client.started_nodes == []


def test_repeated_status_has_rates(
    client: MemoryClient, network: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: List[float] = []

    def sleep(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) > 2:
            raise KeyboardInterrupt
        send(network, "a(1)")

    monkeypatch.setattr(node_client_commands, "sleep", sleep)
    assert main(["status", "--json", "--every", "7"]) == 130
    reports = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [report["taken"] for report in reports] == [1, 2]
    assert all(report["events_a_second"] > 0 for report in reports)
    assert pauses == [7.0] * 3
    assert client.started_nodes == ["retalis_status"]


def test_status_continues_after_error(
    client: MemoryClient, network: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: List[float] = []
    _, answer = network.services["/retalis/list"]

    def refuse(request: Any) -> Any:
        raise UsageError("service /retalis/list does not answer")

    def sleep(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) > 3:
            raise KeyboardInterrupt
        network.services["/retalis/list"] = ("/retalis", refuse if len(pauses) < 3 else answer)

    monkeypatch.setattr(node_client_commands, "sleep", sleep)
    assert main(["status", "--json"]) == 130
    texts = capsys.readouterr()
    assert texts.err == "retalis: service /retalis/list does not answer\n"
    assert json.loads(texts.out)["node"] == "/retalis"


def watch_after(network: Any, *events: str) -> Callable[[str], None]:
    """Return a function that publishes events when a subscription has been added."""

    def publish(service: str) -> None:
        if service == "/add_output_subscription":
            send(network, *events)

    return publish


def subscriptions_of(network: Any) -> List[str]:
    return [item["topic"] for item in network.call("/retalis/list", most=0)["subscriptions"]]


def test_events_are_watched(node: Any, network: Any, connect: Any, output: Any) -> None:
    client = connect(after_call=watch_after(network, "fever_('A b')", "other", "fever_(2)"))
    assert (
        output("watch", "--event", "fever_(_)", "--count", "2") == "event: fever_('A b')\nevent: fever_(2)\n"
    )
    assert subscriptions_of(network) == ["alarm"]
    assert client.started_nodes == ["retalis_watch"]


def test_inputs_and_outputs_are_watched(node: Any, network: Any, connect: Any, output: Any) -> None:
    connect(after_call=watch_after(network, "std_msgs__0__String(hot)"))
    lines = output("watch", "--event", "none", "--inputs", "--count", "2", "--json").splitlines()
    assert sorted((json.loads(line) for line in lines), key=lambda line: line["kind"]) == [
        {"kind": "input", "topic": None, "term": "event(std_msgs__0__String(hot))"},
        {"kind": "output", "topic": "alarm", "term": "std_msgs__0__String(hot)"},
    ]


def test_outputs_of_other_watchers_are_ignored(node: Any, network: Any, connect: Any, output: Any) -> None:
    other = {"conditions": "", "format": "_", "topic": "retalis_watch_0", "id": "0"}
    network.call("/add_output_subscription", event="x", **other)
    connect(after_call=watch_after(network, "x", "y"))
    assert output("watch", "--event", "y", "--count", "1") == "event: y\n"


def test_interrupted_watch_deletes_subscriptions(
    node: Any, network: Any, connect: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(service: str) -> None:
        if service == "/add_output_subscription":
            assert len(subscriptions_of(network)) == 2
            monkeypatch.setattr(node_client_commands, "_print_received", raise_interrupt)

    connect(after_call=interrupt)
    assert main(["watch", "--event", "fever_(_)"]) == 130
    assert subscriptions_of(network) == ["alarm"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_ended_watch_deletes_subscriptions(
    node: Any, network: Any, connect: Any, monkeypatch: pytest.MonkeyPatch, number: Any
) -> None:
    monkeypatch.setattr(
        node_client_commands, "_print_received", lambda *arguments: signal.raise_signal(number)
    )
    connect()
    # Under nohup, SIGHUP is ignored.
    previous_handler = signal.signal(number, signal.SIG_DFL)
    try:
        with pytest.raises(SystemExit) as raised:
            main(["watch", "--event", "fever_(_)"])
    finally:
        signal.signal(number, previous_handler)
    assert raised.value.code == 128 + number
    assert subscriptions_of(network) == ["alarm"]


def raise_interrupt(*arguments: Any) -> None:
    raise KeyboardInterrupt


def test_refused_pattern_is_an_error(client: MemoryClient, error: Any) -> None:
    assert "column" in error("watch", "--event", "f(")


def test_node_without_outputs_cannot_be_watched(network: Any, connect: Any, error: Any) -> None:
    MemoryTransport(network, "/old").offer_service("/add_memory", "AddMemory", dict)
    connect()
    assert error("watch") == "retalis: node /old publishes no retalisOutputEvents\n"


def test_names_are_completed(client: MemoryClient) -> None:
    assert list_names("nodes", None) == ["/retalis"]
    assert client.discovery_limits == [1.5]
    assert list_names("memories", None) == list_names("memories", "retalis") == ["numbers"]
    assert list_names("memories", "other") == []
    assert client.is_ended


def test_console_solves_goals_by_node(
    client: MemoryClient, output: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    console = ("console", "--node", "retalis")
    assert output(*console, "--goal", "X = 1 ; X = 2", "--goal", "true.") == "X = 1 ;\nX = 2.\ntrue.\n"
    assert output(*console, "--goal", "fail", status=1) == "false.\n"
    assert output(*console, "--json", "--goal", "member(X, [1, a])") == '{"X": 1}\n{"X": "a"}\n'
    assert output(*console, "--goal", "X = 1 % a note.") == "X = 1.\n"
    assert main([*console, "--goal", "f(X"]) == 1
    assert "column" in capsys.readouterr().err


def test_console_with_node_takes_no_files(client: MemoryClient, error: Any) -> None:
    assert error("console", "--node", "retalis", "rules.txt") == (
        "retalis: files are loaded where the console is: leave them out with --node\n"
    )
