"""Commands for a running node, without ROS."""

import sys
from typing import List

import pytest

from retalis.cli.command_line import main


@pytest.fixture
def no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_VERSION", raising=False)
    for name in ("rospy", "rosgraph", "genpy", "rclpy"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in [name for name in sys.modules if name.startswith(("retalis.ros1.", "retalis.ros2."))]:
        monkeypatch.delitem(sys.modules, name)


@pytest.mark.parametrize(
    "words",
    [
        ["query", "true"],
        ["list"],
        ["status"],
        ["explain", "a"],
        ["watch"],
        ["reload"],
        ["console", "--node", "/x"],
    ],
)
def test_missing_ros_is_an_error(no_ros: None, capsys: pytest.CaptureFixture[str], words: List[str]) -> None:
    assert main(words) == 1
    assert "this needs ROS" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [["query"], ["query", "a", "--most", "-1"], ["explain"], ["status", "--every", "x"]],
)
def test_invalid_options_are_usage_errors(capsys: pytest.CaptureFixture[str], words: List[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main(words)
    assert raised.value.code == 2
    assert capsys.readouterr().err.startswith("usage: retalis ")
