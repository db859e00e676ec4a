"""Messages beside a clock that goes back: which run each is taken in, and that none is lost or mixed."""

import struct
import threading
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Definitions, Reports
from retalis.engine.runtime import clock_epochs
from retalis.engine.runtime.clock_epochs import ClockEpochs
from retalis.engine.runtime.clock_skew import ClockSkewMonitor, EarlyMessage, RefusedMessage

SECOND = 10**9
HEADER = "\n" + "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
KNOWN = Definitions()
SEEN = KNOWN.decoder(KNOWN.add("my_robot/Seen", "Header header" + HEADER))


class Node:
    """What takes messages and texts as the ROS nodes do, with clocks that the test moves and no thread.

    What is taken is noted by stamp or text, with ``"run"`` where a run begins.
    """

    def __init__(self):
        self.wall = 50.0
        self.reports = Reports()
        self.epochs = ClockEpochs(self.reports, lambda: 0, lambda: None, lambda: self.wall)
        self.skew = ClockSkewMonitor(
            self.reports,
            self.epochs.now,
            lambda: round(self.wall * SECOND),
            buffers_early_messages=self.epochs.buffers_early_messages,
        )
        self.taken = []
        self.epochs.register_callbacks(
            [threading.Lock()], self.skew.begin_epoch, lambda end: self.taken.append("run")
        )
        self.takers = {}

    def clock(self, seconds):
        self.epochs.update_clock(round(seconds * SECOND))
        self.epochs.update()

    def pass_time(self, seconds):
        self.wall += seconds
        self.epochs.update()

    def send(self, stamp, publisher="/play", topic="/seen", frame="map"):
        """Receive a message; one without a stamp is noted by its time of receipt, as a text."""
        data = struct.pack("<IIII", 0, *divmod(round(stamp * SECOND), SECOND), len(frame)) + frame.encode()
        take = self.takers.get((topic, publisher)) or self.taker(topic, publisher)
        if self.epochs.is_buffering and self.epochs.must_buffer(publisher):
            self.epochs.buffer(take, [data])
        else:
            take([data])

    def taker(self, topic, publisher):
        decoder = self.skew.watch(SEEN, topic, publisher)

        def take(messages):
            for at, data in enumerate(messages):
                try:
                    decoder.decode(data)  # this looks, or the next
                    stamp = decoder.stamp(data)
                    self.taken.append(
                        f"at {self.epochs.now() / SECOND:g}" if stamp is None else stamp / SECOND
                    )
                except RefusedMessage:
                    pass
                except EarlyMessage:
                    self.epochs.buffer_early(publisher, take, messages[at:])
                    break

        return self.takers.setdefault((topic, publisher), take)

    def text(self, text, sender="other"):
        if self.epochs.is_buffering and self.epochs.must_buffer_texts(sender):
            self.epochs.buffer(self.taken.extend, [text])
        else:
            self.taken.append(text)

    def play(self, *stamps, ahead=0.0, **options):
        """Have the clock and a topic go on together, as a bag that is played."""
        for stamp in stamps:
            self.wall += 0.5
            self.clock(stamp)
            self.send(stamp + ahead, **options)

    def since(self, count):
        return self.taken[count:]


@pytest.fixture
def node():
    return Node()


BAG = (1000, 1001, 1002, 1003, 1004)


def test_messages_before_the_clock_wait_for_it(node):
    node.play(*BAG)
    for stamp in (1000, 1000.5, 1001):
        node.send(stamp)
        node.pass_time(0.1)
    assert node.taken == [*BAG]
    node.clock(1001)
    node.send(1001.5)
    assert node.taken == [*BAG, "run", 1000, 1000.5, 1001, 1001.5]
    assert node.reports.warnings == 0


def test_all_that_its_publisher_sends_waits_with_it(node):
    node.play(*BAG)
    node.send(1000)
    node.send(1004, topic="/latched")
    node.send(0, topic="/without a stamp")
    node.send(0, "/robot", topic="/without a stamp")
    node.send(1004.5, "/robot")
    assert node.since(5) == ["at 1004", 1004.5]
    node.clock(1000)
    assert node.since(7) == ["run", 1000, 1004, "at 1000"]


def test_messages_of_the_run_before_are_dropped(node, caplog):
    node.play(*BAG)
    node.clock(1000)
    for stamp in (1004.1, 1004.2, 1000.1):
        node.send(stamp)
    node.send(1004.3, topic="/never seen before")
    assert node.since(5) == ["run", 1000.1, 1004.3]
    assert "it is of the time before the clock went back" in caplog.text
    assert node.reports.warnings == 2


def test_a_run_that_gets_further_than_the_one_before(node):
    node.play(*BAG)
    node.play(1000, 1002, 1004, 1006, 1008)
    assert node.taken == [*BAG, "run", 1000, 1002, 1004, 1006, 1008]


@pytest.mark.parametrize("ahead", [-900.0, -3.0, 7.0, 1e6])
def test_stamps_that_are_always_off_are_judged_by_how_much(node, ahead):
    node.play(*BAG, ahead=ahead)
    node.send(1000 + ahead)
    node.clock(1000)
    node.play(*BAG[1:], ahead=ahead)
    assert node.since(5) == ["run", *(stamp + ahead for stamp in BAG)]
    node.clock(1000)
    node.send(1004.5 + ahead)
    node.send(1000.5 + ahead)
    assert node.since(11) == ["run", 1000.5 + ahead]


@pytest.fixture(params=[(1000, 1001), (1001, 1002), (1000, 1001, 1002), (1003, 1004)])
def busy(node, request):
    """A node to which the clock came on time and some messages late, together, as on a busy machine."""
    late = request.param
    for stamp in BAG:
        node.clock(stamp)
        if stamp not in late:
            node.send(stamp)
        elif stamp == late[-1]:
            node.clock(stamp + 0.3)
            for one in late:
                node.send(one)
    return node


def test_messages_before_the_clock_wait_for_it_after_some_that_were_held_up(busy):
    busy.send(1000)
    busy.clock(1000)
    assert busy.taken == [*BAG, "run", 1000]


def test_messages_of_the_run_before_are_dropped_after_some_that_were_held_up(busy):
    busy.clock(1000)
    for stamp in (1004.1, 1004.2, 1000.1):
        busy.send(stamp)
    assert busy.taken == [*BAG, "run", 1000.1]


def test_messages_before_the_first_word_of_the_clock(node):
    node.send(1000)
    node.play(*BAG[1:])
    node.send(1000)
    assert node.taken == [*BAG]
    node.clock(1000)
    assert node.since(5) == ["run", 1000]


def test_the_first_word_of_the_clock_is_no_time_that_passed(node):
    node.send(1000)
    node.clock(1002)
    node.send(1002)
    node.send(1000.9)
    assert node.taken == [1000, 1002, 1000.9]


STRANGE = {
    "out of order": (1003, 1007, 1000, 1005, 1001, 1006),
    "all the same": (1000, 1000, 1000, 1000, 1000, 1000),
    "of years ago, standing still": (7, 7, 7, 7, 7, 7),
    "ever slower": (1000, 1001, 1001.1, 1001.2, 1001.3, 1001.4),
}


@pytest.mark.parametrize("name", STRANGE)
def test_stamps_that_follow_no_clock_are_taken_as_they_come(node, name):
    expected = []
    for _ in range(2):
        for at, stamp in enumerate(STRANGE[name]):
            node.wall += 0.2
            node.clock(1000 + at * 0.4)
            node.send(stamp)
        node.send(STRANGE[name][0])
        expected += ["run", *STRANGE[name], STRANGE[name][0]]
    assert node.taken == expected[1:]


def test_latched_messages_are_taken_again(node):
    node.play(*BAG)
    node.send(900, topic="/tf_static")
    node.clock(1000)
    node.send(900, topic="/tf_static")
    assert node.since(5) == [900, "run", 900]


def test_a_clock_that_does_not_go_back(node):
    node.play(*BAG)
    node.send(1000)
    node.send(1001)
    node.pass_time(0.9)
    assert node.since(5) == []
    node.pass_time(0.2)
    assert node.since(5) == [1000, 1001]
    node.send(995)  # and nothing waits for a while
    node.pass_time(clock_epochs.PAUSE_AFTER_TIMEOUT_SECONDS)
    node.send(985)  # nor by this frame, which follows no clock
    assert node.since(7) == [995, 985]


def test_without_a_simulated_clock_nothing_waits():
    node = Node()
    skew = ClockSkewMonitor(Reports(), lambda: round(node.wall * SECOND))
    take = skew.watch(SEEN, "/seen").stamp
    for stamp in (*BAG, *BAG):
        node.wall += 1
        assert take(struct.pack("<IIII", 0, stamp, 0, 0)) == stamp * SECOND


def test_what_waits_is_bounded(node, monkeypatch):
    monkeypatch.setattr(clock_epochs, "MAX_BUFFERED_MESSAGES", 10)
    node.play(*BAG)
    for at in range(50):
        node.send(1000 + at / 100)
    node.clock(1000)
    assert node.since(5) == ["run", *(1000 + at / 100 for at in range(40, 50))]
    assert node.epochs.dropped == 40
    assert node.reports.warnings == 40


# ---- events as text, whose sender has the clock as well


def test_a_sender_of_texts_that_is_late(node):
    node.epochs.report_epoch("interface", 3)
    node.play(*BAG)
    node.text("old", "interface")
    node.clock(1000)
    node.text("still old", "interface")
    node.send(1000)
    node.text("by hand", "somebody")
    assert node.since(5) == ["old", "still old"]
    node.epochs.report_epoch("interface", 4)
    node.text("new", "interface")
    node.epochs.update()
    assert node.since(7) == ["run", 1000, "by hand", "new"]


def test_a_sender_of_texts_that_is_ahead(node):
    node.epochs.report_epoch("interface", 0)
    node.play(*BAG)
    node.epochs.report_epoch("interface", 1)
    node.text("new", "interface")
    node.text("old, by hand", "somebody")
    node.send(1004.5)
    node.epochs.update()
    assert node.since(5) == ["old, by hand", 1004.5]
    node.clock(1000)
    node.text("newer", "interface")
    assert node.since(7) == ["run", "new", "newer"]


def test_a_sender_that_never_tells_is_waited_for_once(node):
    node.epochs.report_epoch("gone", 0)
    node.play(*BAG)
    node.clock(1000)
    node.send(1000)
    node.pass_time(0.9)
    assert node.since(5) == []
    node.pass_time(0.2)
    assert node.since(5) == ["run", 1000]
    node.play(1001, 1002, 1000)
    assert node.since(7) == [1001, 1002, "run", 1000]


def test_a_sender_whose_clock_alone_goes_back(node):
    node.epochs.report_epoch("interface", 0)
    node.play(*BAG)
    node.epochs.report_epoch("interface", 1)
    node.text("one", "interface")
    node.pass_time(1.1)
    node.text("two", "interface")
    assert node.since(5) == ["one", "two"]
    node.clock(1000)  # later than it is waited for
    assert node.since(7) == ["run"]


def test_a_sender_that_comes_again_counts_anew(node):
    node.epochs.report_epoch("first", 0)
    node.play(*BAG)
    node.clock(1000)
    node.pass_time(1.1)
    node.epochs.report_epoch("second", 5)
    node.play(1001, 1002)
    node.clock(1000)
    assert node.since(6) == [1001, 1002]
    node.epochs.report_epoch("second", 6)
    node.epochs.update()
    assert node.since(8) == ["run"]


def test_the_senders_that_are_remembered_are_bounded(node):
    for number in range(10 * clock_epochs.MAX_SENDERS):
        node.epochs.report_epoch(number, 0)
    node.clock(1000)
    node.clock(900)
    node.pass_time(1.1)
    assert node.taken == ["run"]


def test_time_of_a_run_that_is_over_stands_still(node):
    node.epochs.report_epoch("interface", 0)
    node.clock(1000)
    node.clock(900)
    assert (node.epochs.now(), node.epochs.now(0), node.epochs.now(1)) == (
        1000 * SECOND,
        1000 * SECOND,
        900 * SECOND,
    )
    node.epochs.report_epoch("interface", 1)
    node.clock(901)
    assert (node.epochs.now(), node.epochs.now(0)) == (901 * SECOND, 1000 * SECOND)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 4), st.booleans(), st.integers(0, 20))
def test_runs_are_never_mixed(seed, loops, is_late, held_up):
    """A bag in a loop, in which the clock or the messages come late by as much as they like."""
    _loop(Node(), Random(seed), loops, is_late, held_up)


def _loop(node, draw, loops, is_late, held_up):
    """Play a bag of 6 s again and again; the milliseconds of a stamp are the number of the run."""
    for run in range(loops):

        def at(tenth, run=run):
            return (1_000_000 + 100 * tenth + run) / 1000

        early = draw.randrange(1, 10) if run and is_late else 0
        for tenth in range(early):
            node.send(at(tenth))
            node.pass_time(draw.random() / 10)
        if run and not is_late:
            node.clock(1000)
            for tenth in range(draw.randrange(1, 5)):
                node.send(at(60 + tenth, run - 1))
        last = draw.randrange(early + held_up, 60)
        for tenth in range(early, 60):
            node.pass_time(draw.random() / 10)
            node.clock(1000 + tenth / 10)
            if not last - held_up <= tenth < last:  # those come together, late
                for one in range(tenth - held_up, tenth) if tenth == last else ():
                    node.send(at(one))
                node.send(at(tenth))
        begun = max(place for place, one in enumerate(["run", *node.taken]) if one == "run")
        assert node.taken.count("run") == run
        assert node.taken[begun:] == [at(tenth) for tenth in range(60)]


def test_an_error_where_a_run_begins_keeps_neither_others_nor_messages_back():
    node, told = Node(), []

    def fails(end):
        raise ValueError("not now")

    node.epochs.register_callbacks([threading.Lock()], fails, told.append)
    node.clock(100)
    node.clock(10)
    node.wall += 60
    node.epochs.update()
    assert (len(told), node.reports.errors, node.epochs.is_buffering) == (1, 1, False)
