"""Exchange of messages with a DDS participant that is not rclpy."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")

from ros2.node_processes import EXIT_SECONDS, NodeProcess

PEER = Path(__file__).with_name("cyclonedds_peer.py")
PUB_SUB = """\
<publish_subscribe>
  <subscribe_to name="texts" msg_type="std_msgs/String" event="text"/>
  <publish_to name="echo" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = "subscribe(text(T), [], std_msgs__0__String(T), echo, e)\n"


@pytest.mark.slow
def test_messages_pass_in_both_directions(domain: int, tmp_path: Path) -> None:
    (tmp_path / "pub_sub.xml").write_text(PUB_SUB)
    (tmp_path / "goalPredicates.txt").write_text(GOALS)
    node = NodeProcess(tmp_path / "node.log", "-p", f"program:={tmp_path}")
    texts = ["", "hello", "Grüße", "x" * 10_000]
    peer = subprocess.run(
        [sys.executable, str(PEER), *texts], capture_output=True, text=True, timeout=2 * EXIT_SECONDS
    )
    assert peer.stderr == ""
    assert peer.stdout == "\n".join(texts) + "\n"
    assert node.interrupt() == 0
    assert "Traceback" not in node.log()
