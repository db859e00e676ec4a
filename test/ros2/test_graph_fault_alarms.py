"""Faults of the graph on a live node: the events of ``ros_graph`` become alarms on ``/diagnostics``."""

from pathlib import Path
from typing import Any, Dict

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros2.node_processes import NodeProcess
from ros2.rclpy_nodes import Network, wait_until
from std_msgs.msg import String

ERROR = b"\x02"
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)

PUB_SUB = """\
<publish_subscribe>
  <subscribe_to name="ros_graph" msg_type="retalis/GraphChange" event="graph"/>
  <publish_to name="/diagnostics" msg_type="diagnostic_msgs/DiagnosticArray"/>
</publish_subscribe>
"""
GOALS = """\
compile_event_file('rules.txt').
subscribe(alarm(Stamp, Status), [], diagnostic_msgs__0__DiagnosticArray{header: {stamp: Stamp}, status: [Status]},
  '/diagnostics', a).
"""
RULES = """\
fault(Topic, Detail) <- graph('"mismatch"', _, Topic, Detail).
fault(Topic, '"no publisher"')
  <- (graph('"publisher_missing"', _, Topic, _) seq absent(graph('"publisher_found"', _, Topic, _), 2))
     where \\+ memberchk(Topic, ['"/tf"', '"/ar_pose_marker"', '"/retalisInputEvents"', '"/retalisOutputEvents"']).
fault(Node, '"the node has ended"') <- graph('"node_ended"', Node, _, _).
alarm(T, diagnostic_msgs__0__DiagnosticStatus(2, Name, Message, '"graph"', [])) <- fault(Name, Message) check t2(T).
"""


@pytest.fixture
def process(start_node: Any, tmp_path: Path) -> NodeProcess:
    for name, text in (("pub_sub.xml", PUB_SUB), ("goalPredicates.txt", GOALS), ("rules.txt", RULES)):
        (tmp_path / name).write_text(text)
    process: NodeProcess = start_node("-p", f"program:={tmp_path}")
    return process


@pytest.mark.slow
def test_faults_of_graph_are_alarms_on_diagnostics(network: Network, process: NodeProcess) -> None:
    alarms: Dict[str, str] = {}

    def record(message: Any) -> None:
        alarms.update(
            (status.name, status.message)
            for status in message.status
            if status.level == ERROR and status.hardware_id == "graph"
        )

    network.add_node("monitor").create_subscription(DiagnosticArray, "/diagnostics", record, 100)
    lidar, slam, camera = map(network.add_node, ("lidar", "slam", "camera"))
    # A pair that connects, one with different qualities, and a subscription with a misspelt name.
    lidar.create_publisher(String, "scan", 10)
    lidar.create_publisher(String, "cloud", BEST_EFFORT)
    for topic in ("scan", "cloud", "odon"):
        slam.create_subscription(String, topic, lambda message: None, 10)
    wait_until(lambda: {"/cloud", "/odon"} <= set(alarms))
    assert "/camera" not in alarms
    network.remove_node(camera)
    wait_until(lambda: "/camera" in alarms)
    assert sorted(alarms) == ["/camera", "/cloud", "/odon"]
    assert "/lidar" in alarms["/cloud"]
    assert alarms["/odon"] == "no publisher"
    assert alarms["/camera"] == "the node has ended"
    assert process.interrupt() == 0
    assert "[ERROR]" not in process.log()
