"""Commands for a node that runs, where there is no ROS."""

import sys

import pytest

from retalis.cli.command_line import main


@pytest.fixture
def no_ros(monkeypatch):
    for name in ("rospy", "rosgraph", "genpy"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in [name for name in sys.modules if name.startswith("retalis.ros1.")]:
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
def test_without_ros_they_say_what_is_missing(no_ros, capsys, words):
    assert main(words) == 1
    assert "this needs ROS" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [["query"], ["query", "a", "--most", "-1"], ["explain"], ["status", "--every", "x"]],
)
def test_called_wrongly(capsys, words):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    capsys.readouterr()
