"""The transport of ROS 1: time, sources of messages, requests and responses. Needs rospy, no master."""

import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, List

import pytest
import rospkg

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import UsageError  # noqa: E402
from retalis.node.transport import MessageSource  # noqa: E402
from retalis.ros1 import rospy_transport  # noqa: E402
from retalis.ros1.rospy_transport import (  # noqa: E402
    UNSET_CLOCK_WARNING_SECONDS,
    RospySubscription,
    find_default_program,
    ros_now,
)


@pytest.fixture
def warnings(monkeypatch: pytest.MonkeyPatch) -> Any:
    warnings: List[Any] = []
    monkeypatch.setattr(rospy, "logwarn_once", warnings.append)
    monkeypatch.setattr(rospy_transport, "is_wallclock", lambda: False)
    return warnings


def test_clock_without_messages_is_warned_of(warnings: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rospy, "get_rostime", rospy.Time)
    monkeypatch.setattr(rospy_transport, "_began", time.monotonic())
    assert (ros_now(), warnings) == (0, [])
    monkeypatch.setattr(rospy_transport, "_began", time.monotonic() - 2 * UNSET_CLOCK_WARNING_SECONDS)
    assert ros_now() == 0
    assert len(warnings) == 1
    assert "nothing publishes /clock" in warnings[0]


def test_running_clock_is_not_warned_of(warnings: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(3, 4))
    monkeypatch.setattr(rospy_transport, "_began", time.monotonic() - 2 * UNSET_CLOCK_WARNING_SECONDS)
    assert (ros_now(), warnings) == (3_000_000_004, [])


class RecordingReceiver:
    def __init__(self, source: Any) -> None:
        self.source = source
        self.messages: List[Any] = []
        self.ends: List[Any] = []

    def receive(self, messages: Any) -> None:
        self.messages += messages

    def close(self, is_incomplete: Any) -> None:
        self.ends.append(is_incomplete)


@pytest.fixture
def connections(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the connections and receivers of a subscription, and its handlers of messages and ends."""
    opened = SimpleNamespace(connections=[], receivers=[], find_handler=None, record_end=None)

    def connect(source: Any) -> Any:
        opened.receivers.append(RecordingReceiver(source))
        return opened.receivers[-1]

    def read_in_batches(subscriber: Any, find_handler: Any, max_delay: Any, record_end: Any) -> None:
        opened.find_handler, opened.record_end = find_handler, record_end

    monkeypatch.setattr(rospy, "Subscriber", lambda *arguments, **options: SimpleNamespace(impl=opened))
    monkeypatch.setattr(rospy_transport, "read_in_batches", read_in_batches)
    opened.subscription = RospySubscription("/heat", connect, 5, 0.0, False)
    return opened


HEADER = {
    "callerid": "/thermometer",
    "type": "lab/Temperature",
    "message_definition": "float32 degrees",
    "md5sum": "1234",
}


def test_connection_is_a_source_with_one_receiver(connections: Any) -> None:
    header = dict(HEADER)
    for data in (b"1", b"2"):
        connections.find_handler(header)([data])
    connections.record_end(header, True)
    (receiver,) = connections.receivers
    assert receiver.source == MessageSource("/thermometer", "lab/Temperature", "float32 degrees", "1234")
    assert (receiver.messages, receiver.ends) == ([b"1", b"2"], [True])


def test_latched_connection_has_an_address(connections: Any) -> None:
    header = {**HEADER, "latching": "1"}
    connections.connections.append(
        SimpleNamespace(header=header, socket=object(), endpoint_id="http://robot:1/")
    )
    connections.find_handler(header)([b"1"])
    source = connections.receivers[0].source
    assert (source.is_latched, source.address) == (True, "http://robot:1/")
    assert connections.subscription.publishers() == ["/thermometer"]


def test_equal_headers_are_separate_sources(connections: Any) -> None:
    for _ in range(2):
        connections.find_handler(dict(HEADER))([b"1"])
    assert len(connections.receivers) == 2


def test_default_program_is_found_in_package(monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_default_program(["node", "/here", "__name:=x"]) == Path("/here/application_source")
    monkeypatch.setattr(rospkg.RosPack, "get_path", lambda self, name: f"/packages/{name}")
    assert find_default_program(["node"]) == Path("/packages/retalis/application_source")


def test_unknown_package_is_an_error_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    def get_path(self: Any, name: Any) -> None:
        raise rospkg.ResourceNotFound(name)

    monkeypatch.setattr(rospkg.RosPack, "get_path", get_path)
    with pytest.raises(UsageError, match="ROS_PACKAGE_PATH"):
        find_default_program(sys.argv[:1])
