"""Parsing and size limits of service requests."""

from typing import Any, Dict, List

import pytest
from node.memory_transport import MemoryNetwork, MemoryTransport
from recorded_calls import recording

from retalis import Engine, Reports
from retalis.node import services
from retalis.node.published_topics import UntypedTopicWarnings
from retalis.node.services import EngineServices, ListService, QueryServices, offer_service
from retalis.prolog.terms.term_traversal import variables


@pytest.fixture
def transport(network: MemoryNetwork) -> MemoryTransport:
    return MemoryTransport(network)


@pytest.fixture
def engine(transport: MemoryTransport) -> Engine:
    """Return an engine with services."""
    engine = Engine()
    untyped_topics = UntypedTopicWarnings(transport, (), Reports())
    EngineServices(transport, engine, untyped_topics, lambda pattern: "", lambda goal, topic: "")
    QueryServices(transport, engine)
    ListService(transport, list, engine.status)
    return engine


def test_long_format_is_traversed_few_times(
    network: MemoryNetwork, engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    traversed: List[Any] = []
    monkeypatch.setattr(services, "variables", recording(traversed, variables))
    slots = ",".join(f"X{number}" for number in range(200))
    request = {"event": f"a({slots})", "conditions": "", "format": f"b({slots},Y)"}
    assert network.call("/add_memory", id="m", size="5", **request) == {"result": "ok"}
    assert 0 < len(traversed) < 5


def test_unbound_variable_of_format_is_warned_of(
    network: MemoryNetwork, engine: Engine, caplog: pytest.LogCaptureFixture
) -> None:
    network.call("/add_memory", event="a(X)", conditions="", format="b(X,Y)", id="m", size="5")
    assert "memorize m: nothing in event or conditions gives Y in the format a value" in caplog.text


def test_long_request_is_not_parsed(network: MemoryNetwork, transport: MemoryTransport) -> None:
    handled: List[Any] = []
    offer_service(transport, "~query", "Query", recording(handled, lambda request: {"result": "ok"}))
    half = services.MAX_REQUEST_CHARACTERS // 2

    def call(goal: str, wait_for: List[str]) -> Any:
        return network.call("/retalis/query", goal=goal, wait_for=wait_for, seconds=1.0)

    assert call("a" * half, ["b", "b" * (half - 1)]) == {"result": "ok"}
    assert call("a" * half, ["b", "b" * half]) == {
        "result": "error: the request has 100001 characters: expected at most 100000"
    }
    assert len(handled) == 1


@pytest.mark.parametrize(
    ("changed", "error"),
    [
        ({"size": "0"}, "size: expected a whole number from 1 to 1000000, found 0"),
        ({"size": "x"}, 'size: expected a whole number, found "x"'),
        ({"event": ""}, "event is empty"),
        ({"event": "a("}, "event: "),
        ({"id": " "}, "id is empty"),
        ({"conditions": "3"}, "conditions: expected goals: atoms or compound terms, found 3"),
    ],
)
def test_invalid_memory_is_refused(
    network: MemoryNetwork, engine: Engine, changed: Dict[str, Any], error: str
) -> None:
    request = {"event": "a(X)", "conditions": "", "format": "_", "id": "m", "size": "5", **changed}
    assert network.call("/add_memory", **request)["result"].startswith(f"error: {error}")
    assert network.call("/retalis/list", most=0)["memories"] == []


def test_memory_is_added_and_deleted_once(network: MemoryNetwork, engine: Engine) -> None:
    request = {"event": "a(X)", "conditions": "", "format": "_", "id": "m", "size": "5"}
    assert network.call("/add_memory", **request) == {"result": "ok"}
    assert network.call("/add_memory", **request) == {"result": "error: a memory m already exists"}
    assert [memory["id"] for memory in network.call("/retalis/list", most=0)["memories"]] == ["m"]
    assert network.call("/delete_memory", id="m") == {"result": "ok"}
    assert network.call("/delete_memory", id="m") == {"result": "error: there is no memory m"}


def test_long_list_is_cut_and_counted(network: MemoryNetwork, engine: Engine) -> None:
    engine.load(rules="\n".join(f"a{number} <- b{number}." for number in range(5)))
    response = network.call("/retalis/list", most=2)
    assert (len(response["rules"]), response["more_rules"]) == (2, 3)


def test_query_of_waiting_memories_times_out(network: MemoryNetwork, engine: Engine) -> None:
    network.call("/add_memory", event="a(X)", conditions="", format="_", id="m", size="5")
    request = {"goal": "true", "max_solutions": 0, "seconds": 0.0, "inferences": 0}
    response = network.call("/retalis/query", wait_for=["m"], stamp=10**9, timeout=0.01, **request)
    assert response["result"].startswith("error: ")
