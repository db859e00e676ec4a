"""Test cases on a running node of ROS 2."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")
pytest.importorskip("retalis.srv", reason="the classes of this package's services have not been generated")

from program_with_live_cases import CASES, write_program
from ros2.rclpy_nodes import Network, wait_until

from retalis.cli.command_line import main

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("long_discovery")]


def test_cases_run_on_node(
    network: Network,
    start_node: Any,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_VERSION", "2")
    program = write_program(tmp_path / "program")
    (tmp_path / "smoke.yaml").write_text(CASES)
    node = start_node("-p", f"program:={program}")
    peer = network.add_node()
    wait_until(lambda: "/retalis/list" in dict(peer.get_service_names_and_types()))
    assert main(["test", "--node", "/retalis", "-v", str(tmp_path / "smoke.yaml")]) == 1
    output, errors = capsys.readouterr()
    assert errors == ""
    right, wrong, *_ = output.splitlines()
    assert right == f"passed {tmp_path}/smoke.yaml:3: right"
    assert wrong == f"FAILED {tmp_path}/smoke.yaml:12: wrong"
    assert "outputs: 1 found that must not occur" in output
    assert "  topic /scales: no node subscribes to it\n" in output
    assert output.endswith("1 passed, 2 failed\n")
    assert node.interrupt() == 0
    assert "[ERROR]" not in node.log()
