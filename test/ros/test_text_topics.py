"""What a text says of the run of those after it. Needs rospy, no master."""

import struct

import pytest

pytest.importorskip("rospy", reason="ROS is not installed")

from retalis import Reports  # noqa: E402
from retalis.engine.runtime.clock_epochs import ClockEpochs  # noqa: E402
from retalis.ros.text_topics import mark_of, text_handler_factory  # noqa: E402


def message(text):
    data = text.encode()
    return struct.pack("<I", len(data)) + data


@pytest.fixture
def taken():
    return []


@pytest.fixture
def runs():
    runs = ClockEpochs(Reports(), lambda: 0, lambda: None)
    runs.clock_at(9_000_000_000)
    return runs


def test_texts_of_a_run_that_has_not_begun_wait_for_it(taken, runs):
    receive = text_handler_factory(taken.append, runs)(None)
    for text in (mark_of(0), "event(a)", mark_of(1), "event(b)"):
        receive(message(text))
    assert taken == ["event(a)"]
    runs.clock_at(0)
    runs.step()
    assert taken == ["event(a)", "event(b)"]


def test_senders_are_told_apart(taken, runs):
    taker = text_handler_factory(taken.append, runs)
    late, silent = taker(None), taker(None)
    late(message(mark_of(7)))
    runs.clock_at(0)
    late(message("event(old)"))
    silent(message("event(new)"))
    runs.step()
    assert taken == ["event(old)"]
    late(message(mark_of(8)))
    runs.step()
    assert taken == ["event(old)", "event(new)"]


@pytest.mark.parametrize(
    "text",
    ["event(retalis_run(x))", "event(retalis_run(-1))", "event(retalis_run(1), [1,1])", "event(retalis_run("],
)
def test_what_only_looks_like_it_is_an_event(text, taken, runs):
    text_handler_factory(taken.append, runs)(None)(message(text))
    assert taken == [text]


def test_without_simulated_time_it_is_an_event(taken):
    text_handler_factory(taken.append)(None)(message(mark_of(3)))
    assert taken == [mark_of(3)]
