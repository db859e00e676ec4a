"""Changes of the graph as messages, and as events of a program."""

import time
from pathlib import Path
from typing import Any, Callable, List, Set, Tuple

import pytest
from node.in_memory_hosts import Robot, start_host
from node.memory_transport import MemoryNetwork

from retalis import Definitions
from retalis.messages.message_dictionaries import read_message_term
from retalis.messages.type_registry import InstalledTypes
from retalis.node.graph_watch import (
    GRAPH_TYPE,
    NO_GRAPH,
    WatchedGraph,
    find_changes,
    read_graph,
)
from retalis.node.transport import GraphChange, Mismatch, NodeGraph

MESSAGE = Path(__file__).parents[2] / "msg" / "GraphChange.msg"


def make_graph(
    nodes: Tuple[str, ...] = (), published: Tuple[str, ...] = (), missing: Tuple[str, ...] = ()
) -> WatchedGraph:
    return WatchedGraph(set(nodes), set(published), set(missing), set())


def test_nodes_of_topics_and_services_are_read() -> None:
    mismatch = Mismatch("/scan", "/lidar", "/slam", "/lidar: best effort")
    graph = NodeGraph(
        {"/scan": "a/B"},
        {"/scan": {"/lidar"}},
        {"/s": {"/server"}},
        {"/scan": {"/slam"}, "/scam": {"/slam"}},
        {"/idle"},
        [mismatch],
    )
    assert read_graph(graph) == WatchedGraph(
        {"/lidar", "/server", "/slam", "/idle"},
        {"/scan"},
        {"/scam"},
        {GraphChange("", "/slam", "/scan", "/lidar: best effort")},
    )


def test_first_graph_consists_of_changes() -> None:
    assert list(find_changes(NO_GRAPH, make_graph(("/a",), ("/t",), ("/u",)))) == [
        GraphChange("node_started", "/a"),
        GraphChange("topic_published", name="/t"),
        GraphChange("publisher_missing", name="/u"),
    ]


def test_end_of_node_and_topic_is_change() -> None:
    before, after = make_graph(("/a", "/b"), ("/t",), ("/u",)), make_graph(("/b",))
    assert list(find_changes(before, after)) == [
        GraphChange("publisher_found", name="/u"),
        GraphChange("topic_unpublished", name="/t"),
        GraphChange("node_ended", "/a"),
    ]


def test_mismatch_begins_and_ends() -> None:
    mismatch = GraphChange("", "/slam", "/scan", "/lidar: best effort")
    graph = NO_GRAPH._replace(mismatches={mismatch})
    assert [change.kind for change in find_changes(NO_GRAPH, graph)] == ["mismatch"]
    assert [change.kind for change in find_changes(graph, NO_GRAPH)] == ["mismatch_ended"]


def test_equal_graphs_have_no_changes() -> None:
    graph = make_graph(("/a",), ("/t",))
    assert list(find_changes(graph, graph)) == []


def test_definition_without_installation_is_that_of_file() -> None:
    definition = Definitions(InstalledTypes([], [], include_rosbags=False)).find(GRAPH_TYPE)
    lines = MESSAGE.read_text(encoding="utf-8").splitlines()
    assert [f"string {field.name}" for field in definition.fields] == [
        line for line in lines if line and not line.startswith("#")
    ]
    assert tuple(field.name for field in definition.fields) == GraphChange._fields


def test_kinds_are_listed_in_message() -> None:
    kinds: Set[str] = set()
    mismatch = GraphChange("", "/a", "/t", "reason")
    full = WatchedGraph({"/a"}, {"/t"}, {"/t"}, {mismatch})
    for before, after in ((NO_GRAPH, full), (full, NO_GRAPH)):
        kinds |= {change.kind for change in find_changes(before, after)}
    text = MESSAGE.read_text(encoding="utf-8")
    assert len(kinds) == 8
    assert [kind for kind in kinds if kind not in text] == []


def wait_until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


TOPICS = """
<publish_subscribe>
  <subscribe_to name="ros_graph" msg_type="retalis/GraphChange" event="graph"/>
  <publish_to name="alarm" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
RULES = "std_msgs__0__String(Topic) <- graph('\"topic_published\"', _, Topic, _).\n"
GOALS = "compile_event_file('rules.txt')\nsubscribe(std_msgs__0__String(_), [], _, alarm, s1)\n"


@pytest.fixture
def network() -> MemoryNetwork:
    return MemoryNetwork()


def start(network: MemoryNetwork, folder: Path, topics: str, rules: str = RULES) -> Any:
    (folder / "pub_sub.xml").write_text(topics)
    (folder / "goalPredicates.txt").write_text(GOALS)
    (folder / "rules.txt").write_text(rules)
    return start_host(network, folder)


def test_changes_are_events_of_program(network: MemoryNetwork, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("retalis.node.graph_watch.PERIOD_SECONDS", 0.01)
    robot = Robot(network)
    robot.subscribe("/alarm")
    host = start(network, tmp_path, TOPICS)
    robot.publish("/new_topic")
    topics: List[str] = robot.received["/alarm"]
    wait_until(lambda: "/new_topic" in topics)
    host.transport.shut_down()
    assert topics.count("/new_topic") == 1


def test_graph_is_watched_for_its_subscription_only(tmp_path: Path) -> None:
    for topic, is_watched in (("ros_graph", True), ("other", False)):
        network = MemoryNetwork()
        host = start(network, tmp_path, TOPICS.replace("ros_graph", topic))
        assert ("/ros_graph" in network.publications) is is_watched
        host.transport.shut_down()


def test_message_has_slots_of_change(network: MemoryNetwork, tmp_path: Path) -> None:
    definitions = Definitions()
    definition = definitions.find(GRAPH_TYPE)
    host = start(network, tmp_path, TOPICS)
    (publication,) = network.publications["/ros_graph"]
    wait_until(lambda: publication.messages)
    host.transport.shut_down()
    first = read_message_term(definition, definitions.decoder(definition).decode(publication.messages[0]))
    assert first["kind"] == "node_started"


def test_changes_of_nodes_are_published(network: MemoryNetwork, tmp_path: Path) -> None:
    robot = Robot(network)
    robot.subscribe("/alarm")
    rules = "std_msgs__0__String(Name) <- graph('\"state_changed\"', '\"/slam\"', Name, '\"inactive\"')."
    host = start(network, tmp_path, TOPICS, rules)
    (report,) = network.watches
    report(GraphChange("state_changed", "/slam", "active", "inactive"))
    wait_until(lambda: robot.received["/alarm"] == ["active"])
    host.transport.shut_down()
