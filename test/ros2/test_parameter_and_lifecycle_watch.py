"""Changes within nodes: parameters, and states of life cycles."""

from typing import Any, Iterator, List

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")

from array import array

from lifecycle_msgs.msg import TransitionEvent
from lifecycle_msgs.srv import GetState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.task import Future
from ros2.rclpy_nodes import Network, wait_until

from retalis.node.transport import GraphChange
from retalis.ros2 import parameter_and_lifecycle_watch
from retalis.ros2.parameter_and_lifecycle_watch import format_value


@pytest.fixture
def network(domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Network]:
    monkeypatch.setattr(parameter_and_lifecycle_watch, "CHECK_SECONDS", 0.02)
    network = Network()
    yield network
    network.close()


def watch(network: Network) -> List[GraphChange]:
    """Return the list to which changes are added."""
    changes: List[GraphChange] = []
    network.add_transport().watch_nodes(changes.append)
    return changes


def find_states(changes: List[GraphChange], node: str) -> List[str]:
    return [change.name for change in changes if change.kind == "state_changed" and change.node == node]


def test_state_of_unconfigured_node_is_reported(network: Network) -> None:
    network.add_lifecycle_node("slam")
    changes = watch(network)
    wait_until(lambda: GraphChange("state_changed", "/slam", "unconfigured", "") in changes)


def test_transitions_are_reported_once(network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_and_lifecycle_watch, "ASK_SECONDS", 0.02)
    node = network.add_lifecycle_node("slam")
    changes = watch(network)
    wait_until(lambda: find_states(changes, "/slam"))
    node.trigger_configure()
    node.trigger_activate()
    wait_until(lambda: "active" in find_states(changes, "/slam"))
    # Without the intermediate states, which another question may have found first.
    assert [state for state in find_states(changes, "/slam") if not state.endswith("ing")] == [
        "unconfigured",
        "inactive",
        "active",
    ]


def add_node_with_state(network: Network, name: str, state: str) -> Any:
    """Return a node with the topic and the service of a life cycle, whose end is that of both."""

    def answer(request: Any, response: Any) -> Any:
        response.current_state.label = state
        return response

    node = network.add_node(name)
    node.create_publisher(TransitionEvent, "~/transition_event", 1)
    node.create_service(GetState, "~/get_state", answer)
    return node


def test_state_that_changes_without_event_is_reported(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parameter_and_lifecycle_watch, "ASK_SECONDS", 0.02)
    changes = watch(network)
    for state in ("inactive", "active"):
        node = add_node_with_state(network, "planner", state)
        wait_until(lambda: state in find_states(changes, "/planner"))  # noqa: B023 - called at once
        network.remove_node(node)
    assert find_states(changes, "/planner") == ["inactive", "active"]


def test_nodes_without_answer_do_not_block_others(network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_and_lifecycle_watch, "MAX_CALLS", 1)
    monkeypatch.setattr(parameter_and_lifecycle_watch, "MAX_ANSWER_SECONDS", 0.05)
    never: Any = Future()

    async def answer(request: Any, response: Any) -> Any:
        await never

    group = ReentrantCallbackGroup()
    silent = network.add_node("silent")
    for name in ("a", "b", "c"):
        silent.create_publisher(TransitionEvent, f"/{name}/transition_event", 1)
        silent.create_service(GetState, f"/{name}/get_state", answer, callback_group=group)
    network.add_lifecycle_node("slam")
    changes = watch(network)
    wait_until(lambda: find_states(changes, "/slam") == ["unconfigured"])
    never.set_result(None)


def test_nodes_beyond_limit_are_warned_of_once(network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_and_lifecycle_watch, "MAX_NODES", 1)
    for name in ("one", "two"):
        network.add_lifecycle_node(name)
    changes = watch(network)
    wait_until(lambda: network.reports.recorded_warnings)
    wait_until(lambda: find_states(changes, "/one") + find_states(changes, "/two"))
    assert network.reports.recorded_warnings == [
        "ros_graph: there are more than 1 nodes with a life cycle: others are ignored"
    ]


def test_changes_of_parameters_are_reported(network: Network) -> None:
    changes = watch(network)
    node = network.add_node("camera", allow_undeclared_parameters=True)
    wait_until(lambda: node.count_subscribers("/parameter_events"))
    # The subscription is connected when the first change arrives.
    wait_until(
        lambda: (
            node.set_parameters([Parameter("ready", value=True)])
            and GraphChange("parameter_changed", "/camera", "ready", "true") in changes
        )
    )
    node.set_parameters([Parameter("gain", value=1.5)])
    node.set_parameters([Parameter("gain", value="high")])
    node.set_parameters([Parameter("gain", type_=Parameter.Type.NOT_SET)])
    expected = [
        GraphChange("parameter_new", "/camera", "gain", "1.5"),
        GraphChange("parameter_changed", "/camera", "gain", "high"),
        GraphChange("parameter_deleted", "/camera", "gain", ""),
    ]
    wait_until(lambda: [change for change in changes if change.name == "gain"] == expected)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""),
        ("ä b", "ä b"),
        (True, "true"),
        (7, "7"),
        (0.5, "0.5"),
        ([1, 2], "[1, 2]"),
        (array("d", [0.5]), "[0.5]"),
        (["a", "b"], '["a", "b"]'),
        ([True, False], "[true, false]"),
        ([b"\x00", b"\xff"], "[0, 255]"),
        ("x" * 600, "x" * 500 + "..."),
    ],
)
def test_value_of_parameter_is_text(value: Any, text: str) -> None:
    assert format_value(Parameter("p", value=value).to_parameter_msg()) == text
