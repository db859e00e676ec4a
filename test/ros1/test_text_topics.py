"""Marks in the stream of event texts: clock epochs and latched messages. Needs rospy, no master."""

import struct

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Reports  # noqa: E402
from retalis.engine.runtime.clock_epochs import ClockEpochs  # noqa: E402
from retalis.node.latched_deduplication import LatchedConnection, LatchedMessageDeduplicator  # noqa: E402
from retalis.ros1.text_topics import format_epoch_mark, make_text_handler_factory  # noqa: E402


def message(text):
    data = text.encode()
    return struct.pack("<I", len(data)) + data


@pytest.fixture
def taken():
    return []


@pytest.fixture
def epochs():
    epochs = ClockEpochs(Reports(), lambda: 0, lambda: None)
    epochs.update_clock(9_000_000_000)
    return epochs


def test_texts_of_a_run_that_has_not_begun_wait_for_it(taken, epochs):
    receive = make_text_handler_factory(taken.append, epochs)(None, "/texts", None)
    for text in (format_epoch_mark(0), "event(a)", format_epoch_mark(1), "event(b)"):
        receive(message(text))
    assert taken == ["event(a)"]
    epochs.update_clock(0)
    epochs.update()
    assert taken == ["event(a)", "event(b)"]


def test_senders_are_told_apart(taken, epochs):
    taker = make_text_handler_factory(taken.append, epochs)
    late, silent = taker(None, "/texts", None), taker(None, "/texts", None)
    late(message(format_epoch_mark(7)))
    epochs.update_clock(0)
    late(message("event(old)"))
    silent(message("event(new)"))
    epochs.update()
    assert taken == ["event(old)"]
    late(message(format_epoch_mark(8)))
    epochs.update()
    assert taken == ["event(old)", "event(new)"]


@pytest.mark.parametrize(
    "text",
    ["event(retalis_run(x))", "event(retalis_run(-1))", "event(retalis_run(1), [1,1])", "event(retalis_run("],
)
def test_what_only_looks_like_it_is_an_event(text, taken, epochs):
    make_text_handler_factory(taken.append, epochs)(None, "/texts", None)(message(text))
    assert taken == [text]


def test_without_simulated_time_it_is_an_event(taken):
    make_text_handler_factory(taken.append)(None, "/texts", None)(message(format_epoch_mark(3)))
    assert taken == [format_epoch_mark(3)]


MAP = ("/map", "/map_server", "http://robot:4711/")


@pytest.mark.parametrize(
    "text", ["event(retalis_latched(x))", "event(retalis_latched('a','b',1))", "event(a)"]
)
def test_what_only_looks_like_a_mark_is_an_event(text):
    taken = []
    make_text_handler_factory(taken.append, None, LatchedMessageDeduplicator())(None, "/texts", None)(
        message(text)
    )
    assert taken == [text]


def test_a_text_is_taken_once_whichever_connection_it_comes_on():
    taken = []
    taker = make_text_handler_factory(taken.append, None, LatchedMessageDeduplicator())
    for _ in range(2):  # an interface, and the one that is started after it was killed
        receive, connection = taker(None, "/texts", None), LatchedConnection(*MAP)
        for text in ("event(a)", "event(b)", "event(b)"):
            receive(message(connection.describe_message(text.encode()).to_mark()))
            receive(message(text))
            receive(message("event(x)"))
    # Of the second instance: a was not the last one before, b is new after it, and again.
    assert taken == ["event(a)", "event(x)", *["event(b)", "event(x)"] * 2] * 2
    receive, connection = taker(None, "/texts", None), LatchedConnection(*MAP)
    receive(message(connection.describe_message(b"event(b)").to_mark()))
    receive(message("event(b)"))
    assert len(taken) == 12


def test_a_text_that_waits_for_its_run_is_compared_when_it_is_taken():
    taken = []
    epochs = ClockEpochs(Reports(), lambda: 0, lambda: None)
    epochs.update_clock(9_000_000_000)
    inputs = LatchedMessageDeduplicator(lambda: epochs.epoch)
    receive = make_text_handler_factory(taken.append, epochs, inputs)(None, "/texts", None)
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
    assert taken == ["event(a)"]
    epochs.update_clock(0)
    epochs.update()
    assert taken == ["event(a)", "event(a)"]
