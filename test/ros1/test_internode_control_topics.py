"""Control data between the nodes: unread arguments, and subscriptions of goals. Needs rospy, no master."""

import json
from types import SimpleNamespace
from typing import Any, Dict, List

import pytest
from recording_reports import RecordingReports

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import MessageError, UsageError, functor  # noqa: E402
from retalis.engine.event_input import TopicRequest  # noqa: E402
from retalis.engine.runtime.problem_reports import Reports  # noqa: E402
from retalis.ros1.internode_control_topics import (  # noqa: E402
    MAX_CONTROL_CHARACTERS,
    InputTopicChangesReceiver,
    ProjectionReceiver,
    read_input_changes,
    read_subscriptions,
)

IMAGE = functor("image", 3)
HEADER = {"callerid": "/retalis"}


@pytest.fixture
def interface(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the projection of the interface, with connections of rospy and warnings in lists."""
    sources: List[Any] = []
    impl = SimpleNamespace(connections=sources)
    monkeypatch.setattr(rospy, "Subscriber", lambda *_, **__: SimpleNamespace(impl=impl))
    texts = [SimpleNamespace(endpoint_id="/retalis")]
    reports = RecordingReports()
    projection = ProjectionReceiver(lambda: texts, reports)
    return SimpleNamespace(projection=projection, sources=sources, texts=texts, reports=reports)


def receive_control_message(interface: Any, text: str, header: Any = HEADER) -> None:
    interface.sources.append(SimpleNamespace(header=header, done=False))
    interface.projection._receive(SimpleNamespace(data=text, _connection_header=header))  # noqa: SLF001


def test_all_arguments_are_read_initially(interface: Any) -> None:
    assert interface.projection.unread_positions(IMAGE) == set()


def test_newest_message_defines_unread_arguments(interface: Any) -> None:
    receive_control_message(interface, '{"image/3": [2, 3], "other/1": [1]}')
    assert interface.projection.unread_positions(IMAGE) == {2, 3}
    assert interface.projection.unread_positions(functor("image", 2)) == set()
    receive_control_message(interface, '{"image/3": [3]}')
    assert interface.projection.unread_positions(IMAGE) == {3}
    receive_control_message(interface, "{}")
    assert interface.projection.unread_positions(IMAGE) == set()


def test_other_subscribers_need_all_arguments(interface: Any) -> None:
    receive_control_message(interface, '{"image/3": [3]}')
    interface.texts.append(SimpleNamespace(endpoint_id="/rostopic_1"))
    assert interface.projection.unread_positions(IMAGE) == set()
    del interface.texts[0]
    assert interface.projection.unread_positions(IMAGE) == set()
    del interface.texts[0]
    assert interface.projection.unread_positions(IMAGE) == set()
    interface.texts.append(SimpleNamespace(endpoint_id="/retalis"))
    assert interface.projection.unread_positions(IMAGE) == {3}


def test_message_of_closed_connection_is_ignored(interface: Any) -> None:
    receive_control_message(interface, '{"image/3": [3]}')
    interface.sources[0].done = True
    assert interface.projection.unread_positions(IMAGE) == set()
    interface.sources[:] = [SimpleNamespace(header=dict(HEADER), done=False)]  # restarted, without a message
    assert interface.projection.unread_positions(IMAGE) == set()
    del interface.sources[:]
    assert interface.projection.unread_positions(IMAGE) == set()


@pytest.mark.parametrize(
    "text", ["", "nonsense", "[]", '{"image/3": 3}', '{"image/3": ["3"]}', "[" * 100_000, "1" * 2_000_000]
)
def test_malformed_message_is_reported_and_ignored(interface: Any, text: str) -> None:
    receive_control_message(interface, '{"image/3": [3]}')
    receive_control_message(interface, text)
    assert interface.projection.unread_positions(IMAGE) == set()
    assert len(interface.reports.texts) == 1
    assert len(interface.reports.texts[0]) < 1000


SUBSCRIPTION = ["right", "std_msgs/Bool", "bumper_right"]


def test_list_of_subscriptions_is_read() -> None:
    assert [
        tuple(request) for request in read_subscriptions(json.dumps([SUBSCRIPTION, ["a", "b/C", ""]]))
    ] == [
        tuple(SUBSCRIPTION),
        ("a", "b/C", ""),
    ]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[" * 100_000,
        "[1]",
        json.dumps([SUBSCRIPTION[:2]]),
        json.dumps([[*SUBSCRIPTION[:2], 1]]),
        json.dumps([[*SUBSCRIPTION[:2], "seq"]]),
        json.dumps([[*SUBSCRIPTION[:2], "tf__0__tfMessage"]]),
        json.dumps([[*SUBSCRIPTION[:2], "a(b)"]]),
        json.dumps([SUBSCRIPTION]) + " " * MAX_CONTROL_CHARACTERS,
    ],
)
def test_malformed_list_is_refused(text: str) -> None:
    with pytest.raises(MessageError, match="expected topics, types and names of events"):
        read_subscriptions(text)


CHANGES = '{"direct": "auto", "added": [["scan", "sensor_msgs/LaserScan"]], "deleted": ["/odom"]}'


def test_changes_of_input_topics_are_read() -> None:
    assert tuple(read_input_changes(CHANGES)) == (
        "auto",
        {"/scan": "sensor_msgs/LaserScan"},
        frozenset({"/odom"}),
    )


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "[" * 100_000,
        CHANGES.replace('"auto"', '"never"'),
        CHANGES.replace('["scan", ', '["scan", 1, '),
        CHANGES.replace('"scan"', "1"),
        CHANGES.replace('"scan"', '"a b"'),
        CHANGES.replace('"scan"', '"retalisInputEvents"'),
        CHANGES.replace("sensor_msgs/", ""),
        CHANGES.replace('"/odom"', "[]"),
        CHANGES + " " * MAX_CONTROL_CHARACTERS,
    ],
)
def test_malformed_changes_are_refused(text: Any) -> None:
    with pytest.raises(MessageError, match="expected direct, added and deleted topics"):
        read_input_changes(text)


class Subscriptions:
    """Stand-in of the ROS interface, which stores its subscriptions."""

    def __init__(self, **topics: Any) -> None:
        self.topics = {f"/{topic}": TopicRequest(f"/{topic}", *rest) for topic, rest in topics.items()}

    def subscribe(self, topic: Any, message_type: Any, event_name: str = "") -> None:
        if topic in self.topics:
            raise UsageError(f"topic {topic} is already subscribed")
        self.topics[topic] = TopicRequest(topic, message_type, event_name)

    def try_to_subscribe(self, request: Any, requester: str = "") -> bool:
        try:
            self.subscribe(*request)
        except UsageError:
            return False
        return True

    def unsubscribe(self, topic: Any) -> Any:
        if topic not in self.topics:
            raise UsageError(f"topic {topic} is not subscribed")
        return self.topics.pop(topic)


@pytest.fixture
def receiver(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the receiver of changes, and the subscriptions that it changes."""
    monkeypatch.setattr(rospy, "Subscriber", lambda *_, **__: None)
    subscriptions: Any = Subscriptions(a=("std_msgs/Int8", "number"), b=("std_msgs/Bool",))
    return SimpleNamespace(
        changes=InputTopicChangesReceiver(subscriptions, "auto", Reports()), subscriptions=subscriptions
    )


def apply_changes(receiver: Any, added: Any, deleted: Any) -> Dict[Any, Any]:
    """Pass changes to the receiver; return type and event of each topic afterwards."""
    text = json.dumps({"direct": "auto", "added": list(added.items()), "deleted": deleted})
    receiver.changes._receive(SimpleNamespace(data=text))  # noqa: SLF001
    return {topic: tuple(request)[1:] for topic, request in receiver.subscriptions.topics.items()}


A, B = ("std_msgs/Int8", "number"), ("std_msgs/Bool", "")


def test_list_of_changes_replaces_previous_one(receiver: Any) -> None:
    added = {"/c": "std_msgs/Empty"}
    expected = {"/a": A, "/b": B, "/c": ("std_msgs/Empty", "")}
    assert apply_changes(receiver, added, []) == expected
    assert apply_changes(receiver, added, []) == expected
    assert apply_changes(receiver, {"/c": "std_msgs/Int8"}, []) == {**expected, "/c": ("std_msgs/Int8", "")}
    assert apply_changes(receiver, {}, []) == {"/a": A, "/b": B}


def test_deleted_topic_is_restored_with_event_name(receiver: Any) -> None:
    assert apply_changes(receiver, {}, ["/a", "/unknown"]) == {"/b": B}
    assert apply_changes(receiver, {"/a": "std_msgs/Int16"}, ["/a"]) == {
        "/a": ("std_msgs/Int16", ""),
        "/b": B,
    }
    assert apply_changes(receiver, {}, []) == {"/a": A, "/b": B}


def test_deleted_and_added_topic_stays_added(receiver: Any) -> None:
    expected = {"/a": A, "/b": B, "/c": ("std_msgs/Empty", "")}
    for _ in range(3):
        assert apply_changes(receiver, {"/c": "std_msgs/Empty"}, ["/c"]) == expected


def test_added_topic_keeps_present_subscription(receiver: Any) -> None:
    assert apply_changes(receiver, {"/a": "std_msgs/Int16"}, []) == {"/a": A, "/b": B}
    assert apply_changes(receiver, {}, []) == {"/a": A, "/b": B}
