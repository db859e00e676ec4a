"""Marks of clock epochs in the stream of event texts. Needs rospy, no master."""

import struct

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Reports  # noqa: E402
from retalis.engine.runtime.clock_epochs import ClockEpochs  # noqa: E402
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
    receive = make_text_handler_factory(taken.append, epochs)(None)
    for text in (format_epoch_mark(0), "event(a)", format_epoch_mark(1), "event(b)"):
        receive(message(text))
    assert taken == ["event(a)"]
    epochs.update_clock(0)
    epochs.update()
    assert taken == ["event(a)", "event(b)"]


def test_senders_are_told_apart(taken, epochs):
    taker = make_text_handler_factory(taken.append, epochs)
    late, silent = taker(None), taker(None)
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
    make_text_handler_factory(taken.append, epochs)(None)(message(text))
    assert taken == [text]


def test_without_simulated_time_it_is_an_event(taken):
    make_text_handler_factory(taken.append)(None)(message(format_epoch_mark(3)))
    assert taken == [format_epoch_mark(3)]
