"""Choice between ROS 1 and ROS 2 for connections to running nodes."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest

from retalis import UsageError
from retalis.cli.optional_ros_imports import connect_client


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that replaces the modules of the clients; those of other versions cannot be imported."""

    def install(*versions: str) -> None:
        ros1 = SimpleNamespace(RospyClient=lambda: "1") if "1" in versions else None
        ros2 = SimpleNamespace(RclpyClient=lambda: "2") if "2" in versions else None
        monkeypatch.setitem(sys.modules, "retalis.ros1.rospy_client", ros1)
        monkeypatch.setitem(sys.modules, "retalis.ros2.rclpy_client", ros2)

    return install


@pytest.mark.parametrize(
    ("ros_version", "versions", "chosen"),
    [
        ("1", "12", "1"),
        ("2", "12", "2"),
        ("", "12", "1"),
        ("", "2", "2"),
        ("", "1", "1"),
        ("3", "2", "2"),
    ],
)
def test_ros_version_chooses_client(
    installed: Any, monkeypatch: pytest.MonkeyPatch, ros_version: str, versions: str, chosen: str
) -> None:
    installed(*versions)
    monkeypatch.setenv("ROS_VERSION", ros_version)
    client: Any = connect_client()
    assert client == chosen


@pytest.mark.parametrize(("ros_version", "versions"), [("1", "2"), ("2", "1"), ("", "")])
def test_missing_client_is_an_error(
    installed: Any, monkeypatch: pytest.MonkeyPatch, ros_version: str, versions: str
) -> None:
    installed(*versions)
    monkeypatch.setenv("ROS_VERSION", ros_version)
    with pytest.raises(
        UsageError, match=r"^this needs ROS \(.*\): source its setup.bash, and that of the workspace$"
    ):
        connect_client()
