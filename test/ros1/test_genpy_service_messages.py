"""Fields of requests and responses that genpy has generated. Needs genpy, no master."""

from types import SimpleNamespace

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402

from retalis.ros1.installed_message_classes import fill_message, read_fields  # noqa: E402


def test_times_are_read_in_nanoseconds() -> None:
    request = SimpleNamespace(__slots__=["goal", "stamp"], goal="a", stamp=rospy.Time(1, 2))
    assert vars(read_fields(request)) == {"goal": "a", "stamp": 1_000_000_002}


def test_nested_messages_are_read() -> None:
    message = DiagnosticArray(status=[DiagnosticStatus(name="a", values=[KeyValue("k", "v")])])
    fields = read_fields(message)
    assert list(vars(fields)) == ["header", "status"]
    assert fields.header.stamp == 0
    assert fields.status[0].values == [SimpleNamespace(key="k", value="v")]


def test_message_is_filled_from_values() -> None:
    values = {
        "header": {"stamp": 3 * 10**9 + 4},
        "status": [{"name": "a", "values": [{"key": "k", "value": "v"}]}],
    }
    message = fill_message(DiagnosticArray(), values)
    assert message.header.stamp == rospy.Time(3, 4)
    assert (message.status[0].name, message.status[0].values[0].value) == ("a", "v")
