"""Recognition of repeated latched messages. Needs rospy, no master."""

import struct

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Reports  # noqa: E402
from retalis.engine.runtime.clock_epochs import ClockEpochs  # noqa: E402
from retalis.ros1 import latched_deduplication  # noqa: E402
from retalis.ros1.latched_deduplication import (  # noqa: E402
    LatchedConnection,
    LatchedMessageDeduplicator,
    parse_latched_mark,
)
from retalis.ros1.text_topics import format_epoch_mark, make_text_handler_factory  # noqa: E402

MAP = ("/map", "/map_server", "http://robot:4711/")


def frame(text):
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def test_the_first_message_of_a_new_connection_is_a_repetition_if_it_was_the_last_one():
    inputs = LatchedMessageDeduplicator()
    first, second, third = LatchedConnection(*MAP), LatchedConnection(*MAP), LatchedConnection(*MAP)
    assert not inputs.record_message(first.describe_message(b"a"))
    assert not inputs.record_message(first.describe_message(b"b"))
    assert inputs.record_message(second.describe_message(b"b"))
    assert not inputs.record_message(third.describe_message(b"a"))


def test_what_a_publisher_publishes_again_is_new():
    inputs = LatchedMessageDeduplicator()
    connection = LatchedConnection(*MAP)
    assert [inputs.record_message(connection.describe_message(b"a")) for _ in range(3)] == [
        False,
        False,
        False,
    ]
    again = LatchedConnection(*MAP)
    assert [inputs.record_message(again.describe_message(b"a")) for _ in range(3)] == [True, False, False]


@pytest.mark.parametrize(
    "other",
    [
        ("/floor", "/map_server", "http://robot:4711/"),
        ("/map", "/other", "http://robot:4711/"),
        ("/map", "/map_server", "http://robot:4712/"),
    ],
)
def test_another_publisher_or_process_makes_a_new_event(other):
    inputs = LatchedMessageDeduplicator()
    assert not inputs.record_message(LatchedConnection(*MAP).describe_message(b"a"))
    assert not inputs.record_message(LatchedConnection(*other).describe_message(b"a"))
    assert inputs.record_message(LatchedConnection(*MAP).describe_message(b"a"))


def test_a_publisher_whose_process_is_unknown_repeats_nothing():
    inputs = LatchedMessageDeduplicator()
    for _ in range(2):
        assert not inputs.record_message(LatchedConnection("/map", "/map_server", "").describe_message(b"a"))


def test_a_message_of_a_former_run_is_no_repetition():
    run = 0
    inputs = LatchedMessageDeduplicator(lambda: run)
    assert not inputs.record_message(LatchedConnection(*MAP).describe_message(b"a"))
    run = 1
    assert not inputs.record_message(LatchedConnection(*MAP).describe_message(b"a"))
    assert inputs.record_message(LatchedConnection(*MAP).describe_message(b"a"))


def test_the_publisher_that_was_quiet_for_longest_is_forgotten(monkeypatch):
    monkeypatch.setattr(latched_deduplication, "MAX_PUBLISHERS", 2)
    inputs = LatchedMessageDeduplicator()

    def repeats(topic):
        return inputs.record_message(
            LatchedConnection(topic, "/node", "http://robot:1/").describe_message(b"a")
        )

    assert [repeats(topic) for topic in "abacab"] == [False, False, True, False, True, False]


def test_marks_read_back():
    message = LatchedConnection(*MAP).describe_message(b"a")
    assert parse_latched_mark(message.to_mark()) == message
    assert parse_latched_mark(message._replace(may_be_repetition=False).to_mark()) == message._replace(
        may_be_repetition=False
    )


@pytest.mark.parametrize(
    "text", ["event(retalis_latched(x))", "event(retalis_latched('a','b',1))", "event(a)"]
)
def test_what_only_looks_like_a_mark_is_an_event(text):
    taken = []
    make_text_handler_factory(taken.append, None, LatchedMessageDeduplicator())(None)(frame(text))
    assert taken == [text]


def test_a_text_is_taken_once_whichever_connection_it_comes_on():
    taken = []
    taker = make_text_handler_factory(taken.append, None, LatchedMessageDeduplicator())
    for _ in range(2):  # an interface, and the one that is started after it was killed
        receive, connection = taker(None), LatchedConnection(*MAP)
        for text in ("event(a)", "event(b)", "event(b)"):
            receive(frame(connection.describe_message(text.encode()).to_mark()))
            receive(frame(text))
            receive(frame("event(x)"))
    # Of the second instance: a was not the last one before, b is new after it, and again.
    assert taken == ["event(a)", "event(x)", *["event(b)", "event(x)"] * 2] * 2
    receive, connection = taker(None), LatchedConnection(*MAP)
    receive(frame(connection.describe_message(b"event(b)").to_mark()))
    receive(frame("event(b)"))
    assert len(taken) == 12


def test_a_text_that_waits_for_its_run_is_compared_when_it_is_taken():
    taken = []
    epochs = ClockEpochs(Reports(), lambda: 0, lambda: None)
    epochs.update_clock(9_000_000_000)
    inputs = LatchedMessageDeduplicator(lambda: epochs.epoch)
    receive = make_text_handler_factory(taken.append, epochs, inputs)(None)
    mark = LatchedConnection(*MAP).describe_message(b"a").to_mark()
    for text in (
        format_epoch_mark(0),
        mark,
        "event(a)",
        format_epoch_mark(1),
        mark,
        "event(a)",
        mark,
        "event(a)",
    ):
        receive(frame(text))
    assert taken == ["event(a)"]
    epochs.update_clock(0)
    epochs.update()
    assert taken == ["event(a)", "event(a)"]
