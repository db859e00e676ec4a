"""``/diagnostics`` of running nodes."""

import re
from pathlib import Path
from typing import Any, Tuple

import pytest
import yaml


def read_statuses(space: Any, arrays: int = 6) -> Tuple[Any, ...]:
    """Return the newest level of each status, and the hardware ids, of some messages."""
    messages = yaml.safe_load_all(space.run("rostopic", "echo", "-n", str(arrays), "/diagnostics"))
    statuses = [status for message in messages if message for status in message["status"]]
    levels = {status["name"]: status["level"] for status in statuses}
    return levels, {status["hardware_id"] for status in statuses}


@pytest.mark.parametrize("embedded", ["false", "true"])
def test_missing_inputs_are_diagnostic_warnings(devel: Any, tmp_path: Path, embedded: str) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text("<publish_subscribe/>")
    (program / "goalPredicates.txt").write_text("true\n")
    devel.start_master()
    options = (f"program:={program}", f"embedded:={embedded}", "use_sim_time:=false", "diagnostics:=0.2")
    devel.start(
        "roslaunch", "-p", str(devel.port), "retalis", "retalis.launch", *options, "hardware_id:=robot7"
    )
    expected = {"/retalis"} if embedded == "true" else {"/retalis", "/retalis_ros_interface"}
    devel.expect(lambda nodes, services: expected <= nodes and "/retalis/list" in services)
    levels, hardware = read_statuses(devel)
    assert {"retalis: input /tf", "retalis: input /retalisInputEvents"} <= levels.keys()
    assert {name: level for name, level in levels.items() if level} == {}
    assert hardware == {"robot7"}

    # The added rule requires tf, and the added memory an event without producers, which is a warning in the log.
    devel.run("rosservice", "call", "/retalis/add_rule", "{rule: 'moved <- tf__0__tfMessage(_)', label: ''}")
    devel.run("rosservice", "call", "/add_memory", "{event: lost(X), format: _, id: lost, size: '5'}")
    levels, _ = read_statuses(devel)
    assert levels["retalis: input /tf"] == 1
    assert levels["retalis: input /ar_pose_marker"] == 0
    (warnings,) = re.findall(r"(?m)^warnings: (\d+)$", devel.run("rosservice", "call", "/retalis/list", "0"))
    assert int(warnings) == devel.printed().count("[WARN]") > 0
