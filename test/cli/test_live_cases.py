"""Command ``test --node``, whose connection is in memory."""

from functools import partial
from pathlib import Path
from queue import Empty, Queue
from typing import Any, Callable, Iterator, List, Optional
from xml.etree import ElementTree

import pytest
from cli.memory_client import MemoryClient
from node.in_memory_hosts import start_host
from node.memory_transport import MemoryNetwork
from program_with_live_cases import write_program

from retalis.cli import live_cases
from retalis.cli.command_line import main
from retalis.prolog.terms.timestamps import SECOND


class SimulatedTime:
    """Time that passes only while the command waits for outputs; nodes in memory process events at once.

    Attributes:
        seconds: the time.
    """

    def __init__(self) -> None:
        self.seconds = 0.0

    def monotonic_ns(self) -> int:
        return round(self.seconds * SECOND)


class WaitingQueue(Queue):
    """A queue whose timeouts pass in simulated time."""

    def __init__(self, clock: SimulatedTime, maxsize: int) -> None:
        super().__init__(maxsize)
        self._clock = clock

    def get(self, block: bool = True, timeout: Optional[float] = None) -> Any:
        try:
            return super().get(block=False)
        except Empty:
            self._clock.seconds += timeout or 0
            raise


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> SimulatedTime:
    """Return the time of the command, so that no result depends on the speed of the computer."""
    clock = SimulatedTime()
    monkeypatch.setattr(live_cases, "monotonic_ns", clock.monotonic_ns)
    monkeypatch.setattr(live_cases, "Queue", partial(WaitingQueue, clock))
    return clock


@pytest.fixture
def client(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MemoryClient]:
    """Return the connection of the command, to a network with node ``/retalis``; the working folder is empty."""
    network = MemoryNetwork()
    host = start_host(network, write_program(tmp_path / "program"))
    client = MemoryClient(network)
    monkeypatch.setattr(live_cases, "connect_client", lambda: client)
    folder = tmp_path / "cases"
    folder.mkdir()
    monkeypatch.chdir(folder)
    yield client
    host.transport.shut_down()


@pytest.fixture
def run_case(client: MemoryClient, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return a function that runs a case on the node and returns the output of the command."""

    def run_case(
        expect: str, inputs: str = "{at: 0, event: level(4)}", status: int = 0, until: str = "until: 0.1"
    ) -> str:
        text = f"cases: [{{name: smoke, input: [{inputs}], expect: {{{expect}}}, {until}}}]"
        Path("smoke.yaml").write_text(text)
        assert main(["test", "--node", "/retalis", "--for", "30", "smoke.yaml"]) == status
        return capsys.readouterr().out

    return run_case


def list_events(client: MemoryClient) -> List[str]:
    """Return the topics of the node's subscriptions."""
    response = client.call("/retalis/list", "List", {}, 1.0)
    return [subscription.topic for subscription in response.subscriptions]


@pytest.mark.parametrize(
    "expect",
    [
        "outputs: [{topic: alarm, term: std_msgs__0__Int8(4), at: 0, id: s1}]",
        "outputs: {contains: [{topic: /alarm, message: {data: 4}, count: {max: 1}}], none: [std_msgs__0__Int8(5)]}",
        "outputs: {in_order: [_], count: {min: 1}}",
        "events: [level(4), high(4)]",
        "events: {contains: [high(_)], none: [high(5)]}",
        'state: [{at: 0.05, query: "memory_counter(levels, N)", expect: {N: 1}}, {query: fail, expect: false}]',
        "warnings: none",
    ],
)  # fmt: skip
def test_expectation_of_event_holds(run_case: Callable[..., str], expect: str) -> None:
    assert run_case(expect) == "1 passed\n"


def test_message_is_published_on_its_topic(run_case: Callable[..., str]) -> None:
    message = "{at: 0.01, topic: scale, message: {data: 7}}"
    assert run_case("outputs: [{message: {data: 7}}], events: [high(7)]", message) == "1 passed\n"
    typed = "{at: 0, topic: /scale, type: std_msgs/Int8, message: {data: 8}}"
    assert run_case("outputs: [{message: {data: 8}}]", typed) == "1 passed\n"


def test_run_ends_when_expectations_hold(run_case: Callable[..., str], clock: SimulatedTime) -> None:
    assert run_case("outputs: {contains: [_]}", until="timeout: 9") == "1 passed\n"
    assert run_case("events: {in_order: [level(_), high(_)]}", until="timeout: 9") == "1 passed\n"
    assert clock.seconds < 1


def test_failed_expectation_is_listed(run_case: Callable[..., str]) -> None:
    output = run_case("outputs: {contains: [{message: {data: 5}}], none: [std_msgs__0__Int8(4)]}", status=1)
    assert output.startswith("FAILED smoke.yaml:1: smoke\n  smoke.yaml:1: outputs: 1 not found as expected\n")
    assert "outputs: 1 found that must not occur" in output
    assert "  alone: retalis test smoke.yaml:1 --node /retalis --for 30\n0 passed, 1 failed\n" in output


def test_error_of_node_is_a_failure(run_case: Callable[..., str]) -> None:
    output = run_case("outputs: none", "{at: 0, event: divide(0)}", status=1)
    assert "the node reported 1 error in " in output
    assert "broken(X) (" in output


def test_error_of_query_is_a_failure(run_case: Callable[..., str]) -> None:
    output = run_case('state: [{query: "X is foo + 1", expect: {X: 1}}]', status=1)
    assert "query X is foo + 1 at the end: " in output


def test_subscriptions_are_deleted_after_run(run_case: Callable[..., str], client: MemoryClient) -> None:
    run_case("events: [high(4)]")
    assert list_events(client) == ["alarm"]
    assert client.started_nodes == ["retalis_test"]
    assert client.is_ended


def test_topic_without_subscriber_is_a_failure(run_case: Callable[..., str]) -> None:
    message = "{at: 0, topic: scales, type: std_msgs/Int8}"
    assert "topic /scales: no node subscribes to it" in run_case("outputs: none", message, status=1)


@pytest.mark.parametrize(
    ("case", "keys"),
    [
        ("rules: a <- b., facts: [a], expect: {}", "rules, facts"),
        ("goals: a, parameters: {max_gap: 1}, start: 5, expect: {}", "goals, parameters, start"),
        ("input: [{bag: smoke.yaml}], expect: golden.jsonl", "bag, golden"),
        ("expect: {errors: [a], warnings: [b]}", "errors, warnings (except none)"),
        (
            "expect: {events: {count: 2, contains: [X, {event: a, start: 1}]}}",
            "start of an event, count of all events, a variable as event",
        ),
    ],
)
def test_impossible_case_is_an_error_before_run(
    client: MemoryClient, capsys: pytest.CaptureFixture[str], case: str, keys: str
) -> None:
    good = "{name: good, expect: {}, input: [{at: 0, event: level(4)}]}"
    Path("smoke.yaml").write_text(f"cases:\n  - {good}\n  - {{name: smoke, {case}}}\n")
    assert main(["test", "--node", "/retalis", "smoke.yaml"]) == 2
    error = f"smoke.yaml:3:5: a case for a running node cannot have {keys}\n"
    assert error in capsys.readouterr().out
    assert client.started_nodes == []


def test_options_of_programs_are_refused(client: MemoryClient, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["test", "--node", "/retalis", "--fuzz", "3", "--coverage"]) == 2
    assert capsys.readouterr().err == "retalis: --node: a running node has no --fuzz or --coverage\n"


def test_silent_node_is_an_error(
    client: MemoryClient, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_cases, "CONNECTION_PROBE_SECONDS", 0.05)
    monkeypatch.setattr(client, "subscribe", lambda topic, receive: None)
    Path("smoke.yaml").write_text("cases: [{name: smoke, expect: {}}]")
    assert main(["test", "--node", "/retalis", "smoke.yaml"]) == 1
    error = "node /retalis does not return an event within 0.05 s: expected a node that processes events"
    assert capsys.readouterr().err == f"retalis: {error}\n"
    assert list_events(client) == ["alarm"]


def test_junit_report_has_cases_of_node(run_case: Callable[..., str], client: Any) -> None:
    run_case("outputs: none", "", until="until: 0")
    assert main(["test", "--node", "/retalis", "smoke.yaml", "--junit", "junit.xml"]) == 0
    (suite,) = ElementTree.parse("junit.xml").getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("1", "0")
