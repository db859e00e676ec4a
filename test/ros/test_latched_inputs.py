"""Recognition of repeated latched messages. Needs rospy, no master."""

import struct

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Reports  # noqa: E402
from retalis.engine.runtime.clock_epochs import ClockEpochs  # noqa: E402
from retalis.ros import latched_inputs  # noqa: E402
from retalis.ros.latched_inputs import LatchedConnection, LatchedInputs, latched_message  # noqa: E402
from retalis.ros.text_topics import epoch_mark, text_handler_factory  # noqa: E402

MAP = ("/map", "/map_server", "http://robot:4711/")


def frame(text):
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def test_the_first_message_of_a_new_connection_is_a_repetition_if_it_was_the_last_one():
    inputs = LatchedInputs()
    first, second, third = LatchedConnection(*MAP), LatchedConnection(*MAP), LatchedConnection(*MAP)
    assert not inputs.is_repetition(first.message(b"a"))
    assert not inputs.is_repetition(first.message(b"b"))
    assert inputs.is_repetition(second.message(b"b"))
    assert not inputs.is_repetition(third.message(b"a"))


def test_what_a_publisher_publishes_again_is_new():
    inputs = LatchedInputs()
    connection = LatchedConnection(*MAP)
    assert [inputs.is_repetition(connection.message(b"a")) for _ in range(3)] == [False, False, False]
    again = LatchedConnection(*MAP)
    assert [inputs.is_repetition(again.message(b"a")) for _ in range(3)] == [True, False, False]


@pytest.mark.parametrize(
    "other",
    [
        ("/floor", "/map_server", "http://robot:4711/"),
        ("/map", "/other", "http://robot:4711/"),
        ("/map", "/map_server", "http://robot:4712/"),
    ],
)
def test_another_publisher_or_process_makes_a_new_event(other):
    inputs = LatchedInputs()
    assert not inputs.is_repetition(LatchedConnection(*MAP).message(b"a"))
    assert not inputs.is_repetition(LatchedConnection(*other).message(b"a"))
    assert inputs.is_repetition(LatchedConnection(*MAP).message(b"a"))


def test_a_publisher_whose_process_is_unknown_repeats_nothing():
    inputs = LatchedInputs()
    for _ in range(2):
        assert not inputs.is_repetition(LatchedConnection("/map", "/map_server", "").message(b"a"))


def test_a_message_of_a_former_run_is_no_repetition():
    run = 0
    inputs = LatchedInputs(lambda: run)
    assert not inputs.is_repetition(LatchedConnection(*MAP).message(b"a"))
    run = 1
    assert not inputs.is_repetition(LatchedConnection(*MAP).message(b"a"))
    assert inputs.is_repetition(LatchedConnection(*MAP).message(b"a"))


def test_the_publisher_that_was_quiet_for_longest_is_forgotten(monkeypatch):
    monkeypatch.setattr(latched_inputs, "MAX_PUBLISHERS", 2)
    inputs = LatchedInputs()

    def repeats(topic):
        return inputs.is_repetition(LatchedConnection(topic, "/node", "http://robot:1/").message(b"a"))

    assert [repeats(topic) for topic in "abacab"] == [False, False, True, False, True, False]


def test_marks_read_back():
    message = LatchedConnection(*MAP).message(b"a")
    assert latched_message(message.mark()) == message
    assert latched_message(message._replace(is_first=False).mark()) == message._replace(is_first=False)


@pytest.mark.parametrize(
    "text", ["event(retalis_latched(x))", "event(retalis_latched('a','b',1))", "event(a)"]
)
def test_what_only_looks_like_a_mark_is_an_event(text):
    taken = []
    text_handler_factory(taken.append, None, LatchedInputs())(None)(frame(text))
    assert taken == [text]


def test_a_text_is_taken_once_whichever_connection_it_comes_on():
    taken = []
    taker = text_handler_factory(taken.append, None, LatchedInputs())
    for _ in range(2):  # an interface, and the one that is started after it was killed
        receive, connection = taker(None), LatchedConnection(*MAP)
        for text in ("event(a)", "event(b)", "event(b)"):
            receive(frame(connection.message(text.encode()).mark()))
            receive(frame(text))
            receive(frame("event(x)"))
    # Of the second instance: a was not the last one before, b is new after it, and again.
    assert taken == ["event(a)", "event(x)", *["event(b)", "event(x)"] * 2] * 2
    receive, connection = taker(None), LatchedConnection(*MAP)
    receive(frame(connection.message(b"event(b)").mark()))
    receive(frame("event(b)"))
    assert len(taken) == 12


def test_a_text_that_waits_for_its_run_is_compared_when_it_is_taken():
    taken = []
    epochs = ClockEpochs(Reports(), lambda: 0, lambda: None)
    epochs.update_clock(9_000_000_000)
    inputs = LatchedInputs(lambda: epochs.epoch)
    receive = text_handler_factory(taken.append, epochs, inputs)(None)
    mark = LatchedConnection(*MAP).message(b"a").mark()
    for text in (epoch_mark(0), mark, "event(a)", epoch_mark(1), mark, "event(a)", mark, "event(a)"):
        receive(frame(text))
    assert taken == ["event(a)"]
    epochs.update_clock(0)
    epochs.update()
    assert taken == ["event(a)", "event(a)"]
