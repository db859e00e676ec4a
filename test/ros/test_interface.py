"""What node `retalis_ros_interface` says of types. Needs rospy, no master."""

import struct
import threading

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis.messages import Definitions  # noqa: E402
from retalis.ros.interface import Input  # noqa: E402

TEXT = "float32 degrees\n"


@pytest.fixture
def receive(monkeypatch):
    """Return a function that has a topic of one type receive a message of another: the terms, the warnings."""
    warnings = []
    monkeypatch.setattr(rospy, "Subscriber", lambda *arguments, **options: None)
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: warnings.append(text % values))

    def receive(wanted, sent):
        definitions = Definitions()
        taken = []
        found = Input(
            definitions,
            "/heat",
            wanted,
            lambda decoder: lambda data: taken.append(decoder.decode(data)),
            5,
            threading.Lock(),
        )
        md5sum = Definitions().add(sent, TEXT).md5sum
        message = rospy.AnyMsg()
        message._buff = struct.pack("<f", 36.5)
        message._connection_header = {
            "type": sent,
            "md5sum": md5sum,
            "message_definition": TEXT,
            "callerid": "/thermometer",
        }
        found._receive(message)
        return taken, warnings

    return receive


def test_a_misspelt_type_is_named_when_a_publisher_comes(receive):
    taken, warnings = receive("lab/Temperatur", "lab/Temperature")
    assert [term[0].name for term in taken] == ["lab__0__Temperatur"]
    assert len(warnings) == 1
    assert "/heat is subscribed as lab/Temperatur" in warnings[0]
    assert "/thermometer publishes lab/Temperature" in warnings[0]


def test_a_type_that_only_the_publisher_knows_is_taken_without_a_word(receive):
    taken, warnings = receive("lab/Temperature", "lab/Temperature")
    assert [term[0].name for term in taken] == ["lab__0__Temperature"]
    assert warnings == []
