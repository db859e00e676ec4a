"""Recognition of repeated latched messages."""

from typing import Any, Tuple

import pytest

from retalis.node import latched_deduplication
from retalis.node.latched_deduplication import (
    LatchedConnection,
    LatchedMessageDeduplicator,
    parse_latched_mark,
)

MAP = ("/map", "/map_server", "http://robot:4711/")


def test_last_message_is_repeated_by_connection() -> None:
    deduplicator = LatchedMessageDeduplicator()
    first, second, third = LatchedConnection(*MAP), LatchedConnection(*MAP), LatchedConnection(*MAP)
    assert not deduplicator.record_message(first.describe_message(b"a"))
    assert not deduplicator.record_message(first.describe_message(b"b"))
    assert deduplicator.record_message(second.describe_message(b"b"))
    assert not deduplicator.record_message(third.describe_message(b"a"))


def test_message_published_again_is_no_repetition() -> None:
    deduplicator = LatchedMessageDeduplicator()
    connection = LatchedConnection(*MAP)
    assert [deduplicator.record_message(connection.describe_message(b"a")) for _ in range(3)] == [
        False,
        False,
        False,
    ]
    new_connection = LatchedConnection(*MAP)
    assert [deduplicator.record_message(new_connection.describe_message(b"a")) for _ in range(3)] == [
        True,
        False,
        False,
    ]


@pytest.mark.parametrize(
    "other",
    [
        ("/floor", "/map_server", "http://robot:4711/"),
        ("/map", "/other", "http://robot:4711/"),
        ("/map", "/map_server", "http://robot:4712/"),
    ],
)
def test_message_of_other_publisher_is_no_repetition(other: Tuple[Any, ...]) -> None:
    deduplicator = LatchedMessageDeduplicator()
    assert not deduplicator.record_message(LatchedConnection(*MAP).describe_message(b"a"))
    assert not deduplicator.record_message(LatchedConnection(*other).describe_message(b"a"))
    assert deduplicator.record_message(LatchedConnection(*MAP).describe_message(b"a"))


def test_publisher_without_address_has_no_repetition() -> None:
    deduplicator = LatchedMessageDeduplicator()
    for _ in range(2):
        assert not deduplicator.record_message(
            LatchedConnection("/map", "/map_server", "").describe_message(b"a")
        )


def test_message_of_previous_epoch_is_no_repetition() -> None:
    epoch = 0
    deduplicator = LatchedMessageDeduplicator(lambda: epoch)
    assert not deduplicator.record_message(LatchedConnection(*MAP).describe_message(b"a"))
    epoch = 1
    assert not deduplicator.record_message(LatchedConnection(*MAP).describe_message(b"a"))
    assert deduplicator.record_message(LatchedConnection(*MAP).describe_message(b"a"))


def test_least_recent_publisher_is_evicted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latched_deduplication, "MAX_PUBLISHERS", 2)
    deduplicator = LatchedMessageDeduplicator()

    def repeats(topic: Any) -> bool:
        return deduplicator.record_message(
            LatchedConnection(topic, "/node", "http://robot:1/").describe_message(b"a")
        )

    assert [repeats(topic) for topic in "abacab"] == [False, False, True, False, True, False]


def test_written_mark_is_parsed() -> None:
    message = LatchedConnection(*MAP).describe_message(b"a")
    assert parse_latched_mark(message.to_mark()) == message
    assert parse_latched_mark(message._replace(may_be_repetition=False).to_mark()) == message._replace(
        may_be_repetition=False
    )
