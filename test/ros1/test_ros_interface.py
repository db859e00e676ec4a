"""Conversion and type errors of the ROS interface. Needs rospy, no master."""

import struct
import threading

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Definitions, MessageError, Reports  # noqa: E402
from retalis.engine.runtime.clock_skew import ClockSkewMonitor  # noqa: E402
from retalis.ros1 import ros_interface  # noqa: E402
from retalis.ros1.ros_interface import InputTopic  # noqa: E402

TEXT = "float32 degrees\n"
WARM = struct.pack("<f", 36.5)


@pytest.fixture
def receive(monkeypatch):
    """Return a function that has a topic of one type receive a message of another: the terms, the warnings."""
    warnings, callbacks = [], []
    monkeypatch.setattr(
        rospy, "Subscriber", lambda name, kind, callback, **options: callbacks.append(callback)
    )
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: warnings.append(text % values))

    def receive(wanted, sent, times=1, data=WARM, event=""):
        definitions = Definitions()
        taken = []
        InputTopic(
            definitions,
            "/heat",
            wanted,
            lambda decoder: lambda data: taken.append(decoder.decode(data)),
            5,
            threading.Lock(),
            reports,
            event_name=event,
        )
        md5sum = Definitions().add(sent, TEXT).md5sum
        message = rospy.AnyMsg()
        message._buff = data
        message._connection_header = {
            "type": sent,
            "md5sum": md5sum,
            "message_definition": TEXT,
            "callerid": "/thermometer",
        }
        for _ in range(times):
            callbacks[-1](message)
        return taken, warnings

    reports = Reports()
    receive.reports = reports
    return receive


@pytest.fixture
def taken_by(monkeypatch):
    """Return what is handed to who reads the connections: for each topic, what gives the taker of one."""
    takers = []
    monkeypatch.setattr(rospy, "Subscriber", lambda *arguments, **options: None)
    monkeypatch.setattr(
        ros_interface, "read_in_batches", lambda subscriber, taker, hold, end: takers.append(taker)
    )
    return takers


def test_events_are_called_as_it_is_said(receive):
    for event, name in (("warm", "warm"), ("", "lab__0__Temperature")):
        taken, warnings = receive("lab/Temperature", "lab/Temperature", event=event)
        assert [(term[0].name, term[1]) for term in taken] == [(name, 36.5)]
        assert warnings == []


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


def test_messages_of_another_type_are_counted(receive, caplog):
    taken, _ = receive("std_msgs/String", "lab/Temperature", times=7)
    receive.reports.sum_up()
    shown = [record.getMessage() for record in caplog.records]
    text = (
        "topic /heat: expected std_msgs/String, found lab/Temperature: a message of /thermometer is dropped"
    )
    assert taken == []
    assert (shown[0], shown[-1]) == (text, f"7 times in all: {text}")


def test_messages_that_do_not_fit_their_type_are_counted(receive, caplog):
    taken, _ = receive("lab/Temperature", "lab/Temperature", times=7, data=b"12")
    receive.reports.sum_up()
    shown = [record.getMessage() for record in caplog.records]
    assert taken == []
    assert shown[0].startswith("a message on /heat is dropped: ")
    assert shown[-1] == f"7 times in all: {shown[0]}"


def test_messages_of_a_wake_up_are_taken_one_connection_at_a_time_and_none_cuts_off_the_others(
    taken_by, caplog
):
    gate, done = threading.Lock(), []

    def take(data):
        assert gate.locked()
        if data == b"wrong":
            raise MessageError("too short")
        if data == b"worse":
            raise KeyError("no such thing")
        return data

    InputTopic(
        Definitions(),
        "/heat",
        "lab/Temperature",
        lambda decoder: take,
        5,
        gate,
        Reports(),
        lambda found: done.append(list(found)),
    )
    md5sum = Definitions().add("lab/Temperature", TEXT).md5sum
    header = {"type": "lab/Temperature", "md5sum": md5sum, "message_definition": TEXT}
    take_all = taken_by[0](header)
    take_all([b"one", b"wrong", b"worse", b"two"])
    take_all([b"three"])
    assert done == [[b"one", b"two"], [b"three"]]
    assert not gate.locked()
    errors = [record.getMessage() for record in caplog.records]
    assert errors[0] == "a message on /heat is dropped: too short"
    assert "no such thing" in errors[1]


def test_a_connection_whose_messages_cannot_be_taken_is_refused_once_and_for_all(taken_by, caplog):

    def taker(decoder):
        raise KeyError("no such thing")

    reports = Reports()
    InputTopic(Definitions(), "/heat", "lab/Temperature", taker, 5, threading.Lock(), reports)
    md5sum = Definitions().add("lab/Temperature", TEXT).md5sum
    header = {"type": "lab/Temperature", "md5sum": md5sum, "message_definition": TEXT}
    for _ in range(3):
        taken_by[0](header)([WARM])
    assert (reports.errors, reports.warnings) == (1, 3)
    shown = [record.getMessage() for record in caplog.records]
    assert "no such thing" in shown[0]
    assert shown[1] == "topic /heat: internal error: a message of somebody is dropped"


def test_a_message_with_a_stamp_far_away_is_not_handed_on(monkeypatch):
    callbacks, taken = [], []
    monkeypatch.setattr(
        rospy, "Subscriber", lambda name, kind, callback, **options: callbacks.append(callback)
    )
    definitions = Definitions()
    kind = definitions.find("sensor_msgs/Temperature")
    reports = Reports()
    skew = ClockSkewMonitor(reports, lambda: 0, lambda: 0, 60.0)

    def taker(decoder):
        def take(data):
            decoder.decode(data)
            taken.append(decoder.stamp(data))

        return take

    InputTopic(definitions, "/heat", kind.name, taker, 5, threading.Lock(), reports, skew=skew)
    header = {"type": kind.name, "md5sum": kind.md5sum, "callerid": "/thermometer"}
    for second in (100, 3700, 101):
        message = rospy.AnyMsg()
        message._buff = struct.pack("<IIII", 0, second, 0, 0) + bytes(16)
        message._connection_header = header
        callbacks[-1](message)
    assert taken == [100 * 10**9, 101 * 10**9]
    assert (reports.errors, reports.warnings) == (0, 1)
