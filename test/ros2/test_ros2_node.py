"""The node as a user starts it: a process, with another node of rclpy that sees its topics and services."""

import time
from pathlib import Path
from typing import Any, List, Set

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros2.rclpy_nodes import TIMEOUT_SECONDS, Network, wait_until
from std_msgs.msg import String

from retalis.node.parameters import PARAMETER_DESCRIPTIONS
from retalis.srv import List as ListService
from retalis.srv import Query

PUB_SUB = """\
<publish_subscribe>
  <subscribe_to name="pose" msg_type="geometry_msgs/PoseStamped"/>
  <publish_to name="frames" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """\
memorize(geometry_msgs__0__PoseStamped(H, _), [], H, header, 10)
subscribe(geometry_msgs__0__PoseStamped(std_msgs__0__Header(_, _, F), _), [], std_msgs__0__String(F), frames, f)
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "pub_sub.xml").write_text(PUB_SUB)
    (folder / "goalPredicates.txt").write_text(GOALS)
    return folder


TRANSIENT_LOCAL = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

REPETITION_SECONDS = 10.0
"""Seconds after which a request without response is repeated."""


def call(node: Any, service_class: Any, name: str, **fields: Any) -> Any:
    """Return the response of a service."""
    client = node.create_client(service_class, name)
    assert client.wait_for_service(TIMEOUT_SECONDS)
    # A response is lost if the node has not found its reader yet: then the request is repeated.
    futures = []
    next_time = time.monotonic()

    def find_response() -> Any:
        nonlocal next_time
        if time.monotonic() >= next_time:
            next_time = time.monotonic() + REPETITION_SECONDS
            futures.append(client.call_async(service_class.Request(**fields)))
        return [future for future in futures if future.done()]

    return wait_until(find_response)[0].result()


@pytest.mark.slow
def test_node_publishes_outputs_of_messages(network: Network, start_node: Any, program: Path) -> None:
    frames: List[str] = []
    peer = network.add_node()
    peer.create_subscription(String, "frames", lambda message: frames.append(message.data), 10)
    node = start_node("-p", f"program:={program}")
    publisher = peer.create_publisher(PoseStamped, "pose", 10)
    wait_until(publisher.get_subscription_count)
    message = PoseStamped()
    message.header.frame_id = "map"
    message.header.stamp.sec = 5
    publisher.publish(message)
    wait_until(lambda: frames)
    response = call(peer, Query, "/retalis/query", goal="X is 1 + 2", max_solutions=1)
    assert response.result == "ok"
    assert [binding.text for binding in response.solutions[0].bindings] == ["3"]
    status = call(peer, ListService, "/retalis/list")
    assert status.result == "ok"
    assert [(memory.id, memory.records, memory.newest.sec) for memory in status.memories] == [
        ("header", 1, 5)
    ]
    assert [(topic.topic, topic.messages) for topic in status.inputs if topic.topic == "/pose"] == [
        ("/pose", 1)
    ]
    assert node.interrupt() == 0
    assert frames == ["map"]
    assert "[ERROR]" not in node.log()
    assert "Traceback" not in node.log()


@pytest.mark.slow
def test_name_and_remapping_of_node_are_followed(network: Network, start_node: Any, program: Path) -> None:
    node = start_node(
        "-p", f"program:={program}", "-r", "__node:=monitor", "-r", "__ns:=/robot", "-r", "pose:=other"
    )
    publisher = network.add_node().create_publisher(PoseStamped, "/robot/other", 10)
    wait_until(publisher.get_subscription_count)
    assert call(network.add_node("caller"), ListService, "/robot/monitor/list").result == "ok"
    assert node.interrupt() == 0


@pytest.mark.slow
def test_repeated_message_is_ignored_after_restart(
    network: Network, start_node: Any, program: Path, tmp_path: Path
) -> None:
    frames: List[str] = []
    peer = network.add_node()
    peer.create_subscription(String, "frames", lambda message: frames.append(message.data), 10)
    publisher = peer.create_publisher(PoseStamped, "pose", TRANSIENT_LOCAL)
    message = PoseStamped()
    message.header.frame_id = "map"
    publisher.publish(message)
    arguments = ("-p", f"program:={program}", "-p", f"checkpoint:={tmp_path / 'state.db'}")
    node = start_node(*arguments)
    wait_until(lambda: frames)
    assert node.interrupt() == 0
    wait_until(lambda: not publisher.get_subscription_count())
    restarted = start_node(*arguments)
    wait_until(lambda: "was processed before the restart" in restarted.log())
    # An equal message that is sent again.
    publisher.publish(message)
    wait_until(lambda: len(frames) == 2)
    assert restarted.interrupt() == 0
    assert frames == ["map", "map"]


def set_parameter(node: Any, name: str, value: Any) -> str:
    """Set a parameter of node retalis; return the reason of a rejection, "" if it is changed."""
    parameter = Parameter(name, value=value).to_parameter_msg()
    (result,) = call(node, SetParameters, "/retalis/set_parameters", parameters=[parameter]).results
    return "" if result.successful else str(result.reason)


@pytest.mark.slow
def test_changed_parameters_apply_to_running_program(
    network: Network, start_node: Any, program: Path
) -> None:
    node = start_node("-p", f"program:={program}")
    peer = network.add_node()
    hardware_ids: Set[str] = set()
    peer.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda message: hardware_ids.update(status.hardware_id for status in message.status),
        10,
    )
    goal = "between(1, 9000, X), X >= 9000"
    assert call(peer, Query, "/retalis/query", goal=goal).result == "ok"
    assert set_parameter(peer, "max_inferences", 5000) == ""
    wait_until(lambda: "inferences" in call(peer, Query, "/retalis/query", goal=goal).result)
    assert set_parameter(peer, "hardware_id", "robot7") == ""
    assert set_parameter(peer, "diagnostics", 0.01) == ""
    wait_until(lambda: "robot7" in hardware_ids)
    assert node.interrupt() == 0
    assert "Traceback" not in node.log()


@pytest.mark.slow
def test_rejected_change_of_parameter_has_reason(network: Network, start_node: Any, program: Path) -> None:
    node = start_node("-p", f"program:={program}", "-p", "limit:=4")
    peer = network.add_node()
    # Goals may read it.
    assert set_parameter(peer, "limit", 5) == ""
    assert set_parameter(peer, "queue", 8) == (
        "parameter ~queue: it cannot be changed, because buffers have the size of the start: start the node with it"
    )
    assert set_parameter(peer, "use_sim_time", True) == (
        "parameter use_sim_time: it is read at the start: start the node with it"
    )
    assert set_parameter(peer, "max_second", 8) == (
        "there is no parameter ~max_second; did you mean ~max_seconds?"
    )
    assert set_parameter(peer, "max_seconds", -1) == (
        "parameter ~max_seconds (0 means no limit): expected a number from 0 to 1e+09, found -1"
    )
    assert set_parameter(peer, "max_seconds", None) == (
        "parameter ~max_seconds: it cannot be deleted: set a value"
    )
    values = call(peer, GetParameters, "/retalis/get_parameters", names=["max_seconds", "use_sim_time"])
    assert [value.type for value in values.values] == [
        ParameterType.PARAMETER_NOT_SET,
        ParameterType.PARAMETER_BOOL,
    ]
    assert node.interrupt() == 0


@pytest.mark.slow
def test_parameters_are_described(network: Network, start_node: Any, program: Path) -> None:
    node = start_node("-p", f"program:={program}", "-p", "queue:=7")
    peer = network.add_node()
    descriptions = call(peer, DescribeParameters, "/retalis/describe_parameters", names=["queue", "max_skew"])
    assert [
        (each.description, each.read_only, each.additional_constraints) for each in descriptions.descriptors
    ] == [
        (PARAMETER_DESCRIPTIONS["queue"], True, "buffers have the size of the start"),
        (PARAMETER_DESCRIPTIONS["max_skew"], False, ""),
    ]
    values = call(peer, GetParameters, "/retalis/get_parameters", names=["queue", "max_skew"])
    assert [(value.type, value.integer_value) for value in values.values] == [
        (ParameterType.PARAMETER_INTEGER, 7),
        (ParameterType.PARAMETER_NOT_SET, 0),
    ]
    assert node.interrupt() == 0


def find_state(node: Any) -> str:
    """Return the state of the life cycle."""
    return str(call(node, GetState, "/retalis/get_state").current_state.label)


def change_state(node: Any, transition: int) -> bool:
    """Return whether a transition of the life cycle succeeds."""
    request = Transition(id=transition)
    return bool(call(node, ChangeState, "/retalis/change_state", transition=request).success)


@pytest.mark.slow
def test_program_runs_while_node_is_active(network: Network, start_node: Any, program: Path) -> None:
    node = start_node("-p", f"program:={program}", "-p", "autostart:=false")
    frames: List[str] = []
    peer = network.add_node()
    peer.create_subscription(String, "frames", lambda message: frames.append(message.data), 10)
    publisher = peer.create_publisher(PoseStamped, "pose", 10)
    message = PoseStamped()
    message.header.frame_id = "map"
    assert find_state(peer) == "unconfigured"
    assert change_state(peer, Transition.TRANSITION_CONFIGURE)
    assert publisher.get_subscription_count() == 0
    for round_number in (1, 2):
        assert change_state(peer, Transition.TRANSITION_ACTIVATE)
        assert find_state(peer) == "active"
        wait_until(publisher.get_subscription_count)
        publisher.publish(message)
        wait_until(lambda: len(frames) == round_number)  # noqa: B023 - called at once
        assert change_state(peer, Transition.TRANSITION_DEACTIVATE)
        wait_until(lambda: not publisher.get_subscription_count())
    assert change_state(peer, Transition.TRANSITION_CLEANUP)
    assert find_state(peer) == "unconfigured"
    assert change_state(peer, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert node.process.wait(TIMEOUT_SECONDS) == 0
    assert "Traceback" not in node.log()


@pytest.mark.slow
def test_node_with_invalid_parameter_stays_unconfigured(
    network: Network, start_node: Any, program: Path
) -> None:
    node = start_node("-p", f"program:={program}", "-p", "autostart:=false", "-p", "queue:=-1")
    peer = network.add_node()
    assert not change_state(peer, Transition.TRANSITION_CONFIGURE)
    assert find_state(peer) == "unconfigured"
    assert "parameter ~queue: expected" in node.log()
    assert node.interrupt() == 0


@pytest.mark.slow
def test_invalid_parameter_ends_node(start_node: Any, program: Path) -> None:
    node = start_node("-p", f"program:={program}", "-p", "queue:=-1")
    assert node.process.wait(TIMEOUT_SECONDS) == 1
    assert "parameter ~queue: expected" in node.log()
    assert "Traceback" not in node.log()


@pytest.mark.slow
def test_node_ends_while_query_waits(network: Network, start_node: Any, program: Path) -> None:
    node = start_node("-p", f"program:={program}")
    client = network.add_node().create_client(Query, "/retalis/query")
    assert client.wait_for_service(TIMEOUT_SECONDS)
    client.call_async(Query.Request(goal="true", wait_for=["header"], stamp=make_time(9), timeout=600.0))
    other = client.call_async(Query.Request(goal="true"))
    wait_until(other.done)
    assert node.interrupt() == 0
    assert "Traceback" not in node.log()


GRAPH_TOPICS = """\
<publish_subscribe>
  <subscribe_to name="ros_graph" msg_type="retalis/GraphChange" event="graph"/>
  <publish_to name="changes" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GRAPH_RULES = """\
std_msgs__0__String(Name) <-
  graph(Kind, '"/slam"', Name, _) where (member(Kind, ['"state_changed"', '"parameter_changed"'])).
"""


@pytest.mark.slow
def test_states_and_parameters_of_nodes_are_events(network: Network, start_node: Any, program: Path) -> None:
    (program / "pub_sub.xml").write_text(GRAPH_TOPICS)
    (program / "rules.txt").write_text(GRAPH_RULES)
    (program / "goalPredicates.txt").write_text(
        "compile_event_file('rules.txt')\nsubscribe(std_msgs__0__String(_), [], _, changes, c)\n"
    )
    names: List[str] = []
    network.add_node().create_subscription(String, "changes", lambda message: names.append(message.data), 10)
    slam = network.add_lifecycle_node("slam")
    slam.declare_parameter("gain", 1)
    node = start_node("-p", f"program:={program}")
    wait_until(lambda: names == ["unconfigured"])
    slam.set_parameters([Parameter("gain", value=2)])
    wait_until(lambda: names[1:] == ["gain"])
    slam.trigger_configure()
    wait_until(lambda: names[-1] == "inactive")
    assert node.interrupt() == 0
    assert "Traceback" not in node.log()


def make_time(seconds: int) -> Any:
    """Return a time for a request."""
    stamp = Query.Request().stamp
    stamp.sec = seconds
    return stamp
