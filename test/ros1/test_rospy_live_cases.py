"""Test cases on a running node of ROS 1."""

import subprocess
from pathlib import Path
from typing import Any

from program_with_live_cases import CASES, write_program


def test_cases_run_on_node(devel: Any, tmp_path: Path) -> None:
    program = write_program(tmp_path / "program")
    (tmp_path / "smoke.yaml").write_text(CASES)
    devel.start_master()
    devel.start(devel.executable("retalis_node"), f"_program:={program}")
    devel.expect(lambda nodes, services: "/retalis/delete_rule" in services)
    command = devel.command(
        devel.executable("retalis"), "test", "--node", "/retalis", "-v", str(tmp_path / "smoke.yaml")
    )
    process = subprocess.run(command, env=devel.env, capture_output=True, text=True, timeout=120)
    assert process.stderr == ""
    assert process.returncode == 1
    right, wrong, *_ = process.stdout.splitlines()
    assert right == f"passed {tmp_path}/smoke.yaml:3: right"
    assert wrong == f"FAILED {tmp_path}/smoke.yaml:12: wrong"
    assert "outputs: 1 found that must not occur" in process.stdout
    assert "  topic /scales: no node subscribes to it\n" in process.stdout
    assert process.stdout.endswith("1 passed, 2 failed\n")
