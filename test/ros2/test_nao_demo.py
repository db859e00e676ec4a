"""The NAO example on ROS 2: a node, and a process that plays a simulated robot to it."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("tf2_msgs", reason="tf2_msgs is not installed")
pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).resolve().parents[2] / "examples" / "nao" / "demo_ros2.py"


def test_demo_locates_all_markers() -> None:
    process = subprocess.run(
        [sys.executable, str(SCRIPT), "--seconds", "4"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=180,
    )
    assert process.returncode == 0, process.stdout
    assert "8 of 8 markers located" in process.stdout
