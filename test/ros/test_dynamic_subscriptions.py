"""List of subscriptions of goals between the nodes, and its validation."""

import json

import pytest

pytest.importorskip("rospy")

from retalis import MessageError  # noqa: E402
from retalis.ros.dynamic_subscriptions import read_subscriptions  # noqa: E402
from retalis.ros.internal_topics import MAX_CONTROL_CHARACTERS  # noqa: E402

GOOD = ["right", "std_msgs/Bool", "bumper_right"]


def test_what_is_told_is_read():
    assert [tuple(one) for one in read_subscriptions(json.dumps([GOOD, ["a", "b/C", ""]]))] == [
        tuple(GOOD),
        ("a", "b/C", ""),
    ]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[" * 100_000,
        "[1]",
        json.dumps([GOOD[:2]]),
        json.dumps([[*GOOD[:2], 1]]),
        json.dumps([[*GOOD[:2], "seq"]]),
        json.dumps([[*GOOD[:2], "tf__0__tfMessage"]]),
        json.dumps([[*GOOD[:2], "a(b)"]]),
        json.dumps([GOOD]) + " " * MAX_CONTROL_CHARACTERS,
    ],
)
def test_what_is_wrong_is_refused(text):
    with pytest.raises(MessageError, match="expected topics, types and names of events"):
        read_subscriptions(text)
