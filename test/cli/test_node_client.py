"""Clients of running nodes: selection of the node, its services, and plain values of responses."""

from types import SimpleNamespace
from typing import Any, Dict, Iterator, Tuple

import pytest
from cli.memory_client import MemoryClient, read_message_fields, read_service_fields
from node.memory_transport import MemoryNetwork, MemoryTransport
from parsed_sources import ROOT

from retalis import UsageError
from retalis.cli.node_client import (
    DURATION_FIELDS,
    TIME_FIELDS,
    NodeClient,
    find_engine_nodes,
    format_solutions,
    make_dictionary,
    require_ok,
)


@pytest.fixture
def network() -> MemoryNetwork:
    return MemoryNetwork()


def offer(network: Any, node: str, *services: str) -> None:
    """Offer services whose response has the name of the node."""
    transport = MemoryTransport(network, node)
    for service in services:
        transport.offer_service(service, "Reload", lambda request: {"result": "ok", "changes": [node]})


def start_engine(network: Any, node: str) -> None:
    namespace = node.rpartition("/")[0]
    offer(network, node, "~list", "~reload", f"{namespace}/add_memory")


def start_interface(network: Any, node: str) -> None:
    offer(network, node, "~list", f"{node.rpartition('/')[0]}/add_input_subscription")


def select(network: Any, name: Any = None, namespace: str = "/", include_interfaces: bool = False) -> str:
    """Return the name of the selected node."""
    return NodeClient(MemoryClient(network, namespace), name, include_interfaces).name


def error_of(network: Any, *arguments: Any) -> str:
    with pytest.raises(UsageError) as raised:
        select(network, *arguments)
    return str(raised.value)


def test_only_node_is_selected(network: Any) -> None:
    assert error_of(network) == "no node retalis runs"
    start_engine(network, "/lab/brain")
    start_interface(network, "/lab/senses")
    assert select(network) == "/lab/brain"
    start_engine(network, "/robot")
    assert error_of(network) == "which node? those that run are /lab/brain, /robot; choose one by --node"


def test_namespace_limits_selection(network: Any) -> None:
    for name in ("/robot1/retalis", "/robot2/retalis", "/robot2/arm/retalis"):
        start_engine(network, name)
    assert select(network, None, "/robot1/") == "/robot1/retalis"
    assert error_of(network, None, "/robot2/").startswith(
        "which node? those that run are /robot2/arm/retalis, "
    )
    assert error_of(network, None, "/robot3/") == (
        "no node retalis runs in namespace /robot3 (ROS_NAMESPACE); those that run are "
        "/robot1/retalis, /robot2/arm/retalis, /robot2/retalis"
    )


def test_name_is_relative_to_namespace(network: Any) -> None:
    start_engine(network, "/robot1/retalis")
    start_engine(network, "/robot2/retalis")
    assert select(network, "retalis", "/robot2/") == "/robot2/retalis"
    assert select(network, "/robot1/retalis", "/robot2/") == "/robot1/retalis"
    connection = MemoryClient(network, "/robot2/")
    NodeClient(connection, "retalis")
    assert connection.requested_names == ["/robot2/retalis"]


def test_interface_is_named_in_errors_if_included(network: Any) -> None:
    start_engine(network, "/retalis")
    start_interface(network, "/senses")
    assert error_of(network, "other") == "there is no node /other; those that run are /retalis"
    assert error_of(network, "other", "/", True) == (
        "there is no node /other; those that run are /retalis, /senses"
    )
    client = NodeClient(MemoryClient(network), "senses", include_interfaces=True)
    assert (client.name, client.has_engine) == ("/senses", False)


def test_missing_service_is_an_error(network: Any) -> None:
    start_engine(network, "/retalis")
    client = NodeClient(MemoryClient(network))
    with pytest.raises(
        UsageError, match="^node /retalis has no service ~query: it is a ROS interface, or of an"
    ):
        client.call("query", "Query")
    with pytest.raises(UsageError, match="^node /retalis has no service delete_memory$"):
        client.call_relative_service("delete_memory", "DeleteMemory")


def test_services_of_other_nodes_are_not_called(network: Any) -> None:
    for name in ("/a/retalis", "/b/retalis"):
        start_engine(network, name)
        offer(network, name, f"{name.rpartition('/')[0]}/remapped/read_again")
    client = NodeClient(MemoryClient(network), "/b/retalis")
    assert client.call("reload", "Reload").changes == ["/b/retalis"]
    assert client.call_relative_service("read_again", "Reload").changes == ["/b/retalis"]


def test_published_topics_and_interfaces_are_of_node(network: Any) -> None:
    start_engine(network, "/retalis")
    interfaces = {"/retalis": {"/b", "/a"}, "/other": {"/c"}}
    client = NodeClient(MemoryClient(network, interfaces=interfaces))
    assert client.interfaces == ["/a", "/b"]
    assert client.published_topics == []


def test_scope_is_part_of_errors(network: Any) -> None:
    with pytest.raises(UsageError, match="^no node retalis runs in domain 5$"):
        NodeClient(MemoryClient(network, scope=" in domain 5"))
    with pytest.raises(UsageError, match="^there is no node /a; no node retalis runs in domain 5$"):
        NodeClient(MemoryClient(network, scope=" in domain 5"), "a")


def test_time_limit_includes_times_of_request(network: Any) -> None:
    start_engine(network, "/retalis")
    offer(network, "/retalis", "~query")
    connection = MemoryClient(network)
    client = NodeClient(connection)
    client.call("reload", "Reload")
    MemoryTransport(network).offer_service("~query", "Query", lambda request: {"result": "ok"})
    client.call("query", "Query", goal="a", seconds=5.0, timeout=0.5)
    assert connection.response_limits == [60.0, 65.5]


def test_engine_nodes_are_sorted() -> None:
    services = {"/x/add_memory": {"/b"}, "/add_memory": {"/a"}, "/add_input_subscription": {"/0"}}
    assert find_engine_nodes(services) == ["/a", "/b"]
    assert find_engine_nodes(services, include_interfaces=True) == ["/0", "/a", "/b"]


def test_reason_of_response_is_an_error() -> None:
    assert require_ok(SimpleNamespace(result="ok")).result == "ok"
    with pytest.raises(UsageError, match="^no rule a$"):
        require_ok(SimpleNamespace(result="error: no rule a"))


def fields_of_responses() -> Iterator[Tuple[str, str]]:
    """Yield the name and the type of each field in responses and in their nested messages."""
    definitions = [read_service_fields(path.stem)[1] for path in (ROOT / "srv").glob("*.srv")]
    definitions += [read_message_fields(path.stem) for path in (ROOT / "msg").glob("*.msg")]
    for definition in definitions:
        yield from definition.items()


def test_time_fields_agree_with_definitions() -> None:
    names: Dict[str, Any] = {"time": set(), "duration": set(), "other": set()}
    for name, field_type in fields_of_responses():
        names[field_type if field_type in names else "other"].add(name)
    assert names["time"] == TIME_FIELDS
    assert names["duration"] == DURATION_FIELDS
    assert not names["other"] & (TIME_FIELDS | DURATION_FIELDS)


def test_times_of_response_are_seconds() -> None:
    memory = SimpleNamespace(id="m", oldest=0, newest=1_700_000_000_123_456_789)
    topic = SimpleNamespace(age=-1, lag=0, delay=5)
    response = SimpleNamespace(
        result="ok", work_time=1_500_000_000, memories=[memory], inputs=[topic], lines=["a"]
    )
    assert make_dictionary(response) == {
        "result": "ok",
        "work_time": 1.5,
        "memories": [{"id": "m", "oldest": None, "newest": 1_700_000_000 + 0.123456789}],
        "inputs": [{"age": None, "lag": 0.0, "delay": 5}],
        "lines": ["a"],
    }


def test_solutions_are_formatted_as_by_toplevel() -> None:
    bindings = [SimpleNamespace(name="X", text="a"), SimpleNamespace(name="Y", text="f(_1)")]
    response = SimpleNamespace(solutions=[SimpleNamespace(bindings=bindings), SimpleNamespace(bindings=[])])
    assert list(format_solutions(response)) == ["X = a, Y = f(_1)", "true"]
