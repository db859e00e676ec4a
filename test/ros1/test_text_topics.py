"""Marks in the stream of event texts: clock epochs and latched messages. Needs rospy, no master."""

import struct
from typing import Any, List

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Reports  # noqa: E402
from retalis.engine.runtime.clock_epochs import ClockEpochs  # noqa: E402
from retalis.node.latched_deduplication import LatchedConnection, LatchedMessageDeduplicator  # noqa: E402
from retalis.ros1.text_topics import format_epoch_mark, make_text_handler_factory  # noqa: E402

UNUSED: Any = None
"""Decoder and source of messages, which a receiver of texts does not read."""


def message(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


@pytest.fixture
def processed() -> List[Any]:
    return []


@pytest.fixture
def epochs() -> ClockEpochs:
    epochs = ClockEpochs(Reports(), lambda: 0, lambda: None)
    epochs.update_clock(9_000_000_000)
    return epochs


def test_texts_of_next_epoch_are_buffered(processed: List[Any], epochs: ClockEpochs) -> None:
    receive = make_text_handler_factory(processed.append, epochs)(UNUSED, "/texts", UNUSED)
    for text in (format_epoch_mark(0), "event(a)", format_epoch_mark(1), "event(b)"):
        receive(message(text))
    assert processed == ["event(a)"]
    epochs.update_clock(0)
    epochs.update()
    assert processed == ["event(a)", "event(b)"]


def test_epochs_of_senders_are_separate(processed: List[Any], epochs: ClockEpochs) -> None:
    make_handler = make_text_handler_factory(processed.append, epochs)
    late, silent = make_handler(UNUSED, "/texts", UNUSED), make_handler(UNUSED, "/texts", UNUSED)
    late(message(format_epoch_mark(7)))
    epochs.update_clock(0)
    late(message("event(old)"))
    silent(message("event(new)"))
    epochs.update()
    assert processed == ["event(old)"]
    late(message(format_epoch_mark(8)))
    epochs.update()
    assert processed == ["event(old)", "event(new)"]


@pytest.mark.parametrize(
    "text",
    ["event(retalis_run(x))", "event(retalis_run(-1))", "event(retalis_run(1), [1,1])", "event(retalis_run("],
)
def test_malformed_epoch_mark_is_an_event(text: str, processed: List[Any], epochs: ClockEpochs) -> None:
    make_text_handler_factory(processed.append, epochs)(UNUSED, "/texts", UNUSED)(message(text))
    assert processed == [text]


def test_epoch_mark_in_wall_time_is_an_event(processed: List[Any]) -> None:
    make_text_handler_factory(processed.append)(UNUSED, "/texts", UNUSED)(message(format_epoch_mark(3)))
    assert processed == [format_epoch_mark(3)]


MAP = ("/map", "/map_server", "http://robot:4711/")


@pytest.mark.parametrize(
    "text", ["event(retalis_latched(x))", "event(retalis_latched('a','b',1))", "event(a)"]
)
def test_malformed_latched_mark_is_an_event(text: str) -> None:
    processed: List[Any] = []
    make_text_handler_factory(processed.append, None, LatchedMessageDeduplicator())(UNUSED, "/texts", UNUSED)(
        message(text)
    )
    assert processed == [text]


def test_repeated_text_of_connection_is_dropped() -> None:
    processed: List[Any] = []
    make_handler = make_text_handler_factory(processed.append, None, LatchedMessageDeduplicator())
    for _ in range(2):  # an interface, and its successor after a kill
        receive, connection = make_handler(UNUSED, "/texts", UNUSED), LatchedConnection(*MAP)
        for text in ("event(a)", "event(b)", "event(b)"):
            receive(message(connection.describe_message(text.encode()).to_mark()))
            receive(message(text))
            receive(message("event(x)"))
    # The second connection begins with a, which differs from the last text b, so all its texts are processed.
    assert processed == ["event(a)", "event(x)", *["event(b)", "event(x)"] * 2] * 2
    receive, connection = make_handler(UNUSED, "/texts", UNUSED), LatchedConnection(*MAP)
    receive(message(connection.describe_message(b"event(b)").to_mark()))
    receive(message("event(b)"))
    assert len(processed) == 12


def test_latched_text_is_processed_once_per_epoch() -> None:
    processed: List[Any] = []
    epochs = ClockEpochs(Reports(), lambda: 0, lambda: None)
    epochs.update_clock(9_000_000_000)
    inputs = LatchedMessageDeduplicator(lambda: epochs.epoch)
    receive = make_text_handler_factory(processed.append, epochs, inputs)(UNUSED, "/texts", UNUSED)
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
        receive(message(text))
    assert processed == ["event(a)"]
    epochs.update_clock(0)
    epochs.update()
    assert processed == ["event(a)", "event(a)"]
