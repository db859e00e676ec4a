"""Names of ROS: topics and message types."""

import pytest
from asserting_accessors import required

from retalis.foundation.ros_name_checks import name_fault, ros1_type_name, topic_fault, type_fault

INVALID_NAMES = ["x²", "ﬁle", "x\0", "\ud800", "x y", "x\n", "1x", "", "a:b", "\u212a", "x" * 256, "x;y", "é"]


@pytest.mark.parametrize("name", INVALID_NAMES)
def test_name_with_other_characters_is_refused(name: str) -> None:
    for fault in (
        name_fault(name),
        topic_fault(name),
        type_fault(f"pkg/{name}"),
        type_fault(f"{name}/Type"),
    ):
        assert fault is not None
        assert fault.isascii()
        assert fault.startswith("expected a")
        assert len(fault) < 400


@pytest.mark.parametrize("name", ["a/b/c", "/a", "a/", "//", "ab", "a//b"])
def test_type_without_package_and_name_is_refused(name: str) -> None:
    assert type_fault(name) is not None


@pytest.mark.parametrize("name", ["tf/tfMessage", "a/B", "std_msgs/UInt8MultiArray", "a1_/B2_"])
def test_valid_type_is_accepted(name: str) -> None:
    assert type_fault(name) is None


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("geometry_msgs/msg/Point", "geometry_msgs/Point"),
        ("my_msgs/action/Go_FeedbackMessage", "my_msgs/Go_FeedbackMessage"),
        ("geometry_msgs/Point", "geometry_msgs/Point"),
        ("msg/Point", "msg/Point"),
        ("a/msg/", "a/msg/"),
        ("a/b/C", "a/b/C"),
        ("a/msg/b/C", "a/msg/b/C"),
    ],
)
def test_ros2_type_name_is_shortened(name: str, plain: str) -> None:
    assert ros1_type_name(name) == plain


@pytest.mark.parametrize("name", ["/tf", "tf", "~private", "~", "/a/b_1/C", "a/b", "a/"])
def test_valid_topic_is_accepted(name: str) -> None:
    assert topic_fault(name) is None


def test_error_names_invalid_character() -> None:
    assert topic_fault("a//b") == "expected a topic name, found 'a//b', which has \"//\" in it"
    assert required(type_fault('a/b:=__import__("os")')).endswith(
        """found 'a/b:=__import__("os")': ':' is not allowed in it"""
    )
