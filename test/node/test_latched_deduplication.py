"""Recognition of repeated latched messages."""

import pytest

from retalis.node import latched_deduplication
from retalis.node.latched_deduplication import (
    LatchedConnection,
    LatchedMessageDeduplicator,
    parse_latched_mark,
)

MAP = ("/map", "/map_server", "http://robot:4711/")


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
