"""Connection of commands to running nodes of ROS 1. Needs rospy, no master."""

from typing import Any

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")
pytest.importorskip("retalis.srv", reason="the services of the package are not built")

from retalis import UsageError  # noqa: E402
from retalis.ros1 import rospy_client  # noqa: E402
from retalis.ros1.control_topics import INPUT_CHANGES_TOPIC  # noqa: E402
from retalis.ros1.rospy_client import RospyClient  # noqa: E402


def test_names_are_relative_to_ros_namespace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_NAMESPACE", raising=False)
    client = RospyClient()
    assert (client.namespace, client.resolve_node("retalis")) == ("/", "/retalis")
    monkeypatch.setenv("ROS_NAMESPACE", "robot1/arm")
    client = RospyClient()
    assert client.namespace == "/robot1/arm/"
    assert client.resolve_node("retalis") == "/robot1/arm/retalis"
    assert client.resolve_node("/retalis") == "/retalis"


def test_interfaces_are_found_by_topic_of_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    topic = f"/lab/{INPUT_CHANGES_TOPIC}"
    state = [
        [[topic, ["/lab/senses", "/lab/brain"]], ["/tf", ["/robot"]]],
        [[topic, ["/lab/brain"]], ["/tf", ["/lab/senses"]]],
        [["/lab/add_memory", ["/lab/brain"]]],
    ]
    monkeypatch.setattr(rospy_client, "get_system_state", lambda: state)
    nodes = RospyClient().find_nodes()
    assert nodes.services == {"/lab/add_memory": {"/lab/brain"}}
    assert nodes.publishers["/tf"] == {"/robot"}
    assert nodes.interfaces == {"/lab/brain": {"/lab/senses"}}


def test_missing_service_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    def call(self: Any, request: Any) -> None:
        raise rospy.ServiceException("no such service")

    monkeypatch.setattr(rospy.ServiceProxy, "__call__", call)
    with pytest.raises(UsageError, match="^service /retalis/list does not answer: no such service$"):
        RospyClient().call("/retalis/list", "List", {"most": 5}, 60.0)
