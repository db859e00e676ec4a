"""Assignment of messages to the epochs of a simulated clock that goes back."""

import struct
import threading
from random import Random
from typing import Any, Dict, List

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Definitions, Reports
from retalis.engine.runtime import clock_epochs
from retalis.engine.runtime.clock_epochs import ClockEpochs
from retalis.engine.runtime.clock_skew import ClockSkewMonitor, EarlyMessage, RefusedMessage

SECOND = 10**9
HEADER = "\n" + "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
DEFINITIONS = Definitions()
SEEN_DECODER = DEFINITIONS.decoder(DEFINITIONS.add("my_robot/Seen", "Header header" + HEADER))


class SimulatedNode:
    """A receiver of messages and texts like a ROS node, with clocks that the test moves and without threads.

    Attributes:
        processed: the stamps and texts of processed messages, with ``"epoch"`` at the start of an epoch.
        real_time: real time in seconds, which the test advances.
    """

    def __init__(self) -> None:
        self.real_time = 50.0
        self.reports = Reports()
        self.epochs = ClockEpochs(self.reports, lambda: 0, lambda: None, lambda: self.real_time)
        self.skew = ClockSkewMonitor(
            self.reports,
            self.epochs.now,
            lambda: round(self.real_time * SECOND),
            buffers_early_messages=self.epochs.buffers_early_messages,
        )
        self.processed: List[Any] = []
        self.epochs.register_callbacks(
            [threading.Lock()], self.skew.begin_epoch, lambda end: self.processed.append("epoch")
        )
        self.processors: Dict[Any, Any] = {}

    def clock(self, seconds: float) -> None:
        self.epochs.update_clock(round(seconds * SECOND))
        self.epochs.update()

    def pass_time(self, seconds: float) -> None:
        self.real_time += seconds
        self.epochs.update()

    def send(self, stamp: Any, publisher: str = "/play", topic: str = "/seen", frame: str = "map") -> None:
        """Receive a message; a message without a stamp is recorded by its time of receipt."""
        data = struct.pack("<IIII", 0, *divmod(round(stamp * SECOND), SECOND), len(frame)) + frame.encode()
        process = self.processors.get((topic, publisher)) or self.processor_of(topic, publisher)
        if self.epochs.is_buffering and self.epochs.must_buffer(publisher):
            self.epochs.buffer(process, [data])
        else:
            process([data])

    def processor_of(self, topic: Any, publisher: Any) -> Any:
        decoder = self.skew.watch(SEEN_DECODER, topic, publisher)

        def process(messages: Any) -> None:
            for index, data in enumerate(messages):
                try:
                    decoder.decode(data)  # raises the errors of the monitor, or the next line does
                    stamp = decoder.stamp(data)
                    self.processed.append(
                        f"at {self.epochs.now() / SECOND:g}" if stamp is None else stamp / SECOND
                    )
                except RefusedMessage:
                    pass
                except EarlyMessage:
                    self.epochs.buffer_early(publisher, process, messages[index:])
                    break

        return self.processors.setdefault((topic, publisher), process)

    def text(self, text: str, sender: str = "other") -> None:
        if self.epochs.is_buffering and self.epochs.must_buffer_texts(sender):
            self.epochs.buffer(self.processed.extend, [text])
        else:
            self.processed.append(text)

    def play(self, *stamps: Any, ahead: float = 0.0, **options: Any) -> None:
        """Move the clock and publish a topic, as a played bag does."""
        for stamp in stamps:
            self.real_time += 0.5
            self.clock(stamp)
            self.send(stamp + ahead, **options)

    def processed_after(self, count: int) -> Any:
        return self.processed[count:]


@pytest.fixture
def node() -> SimulatedNode:
    return SimulatedNode()


BAG_STAMPS = (1000, 1001, 1002, 1003, 1004)


def test_early_messages_wait_for_clock(node: SimulatedNode) -> None:
    node.play(*BAG_STAMPS)
    for stamp in (1000, 1000.5, 1001):
        node.send(stamp)
        node.pass_time(0.1)
    assert node.processed == [*BAG_STAMPS]
    node.clock(1001)
    node.send(1001.5)
    assert node.processed == [*BAG_STAMPS, "epoch", 1000, 1000.5, 1001, 1001.5]
    assert node.reports.warnings == 0


def test_publisher_of_early_message_waits_entirely(node: SimulatedNode) -> None:
    node.play(*BAG_STAMPS)
    node.send(1000)
    node.send(1004, topic="/latched")
    node.send(0, topic="/without a stamp")
    node.send(0, "/robot", topic="/without a stamp")
    node.send(1004.5, "/robot")
    assert node.processed_after(5) == ["at 1004", 1004.5]
    node.clock(1000)
    assert node.processed_after(7) == ["epoch", 1000, 1004, "at 1000"]


def test_messages_of_previous_epoch_are_dropped(
    node: SimulatedNode, caplog: pytest.LogCaptureFixture
) -> None:
    node.play(*BAG_STAMPS)
    node.clock(1000)
    for stamp in (1004.1, 1004.2, 1000.1):
        node.send(stamp)
    node.send(1004.3, topic="/never seen before")
    assert node.processed_after(5) == ["epoch", 1000.1, 1004.3]
    assert "it is of the time before the clock went back" in caplog.text
    assert node.reports.warnings == 2


def test_longer_epoch_is_processed_completely(node: SimulatedNode) -> None:
    node.play(*BAG_STAMPS)
    node.play(1000, 1002, 1004, 1006, 1008)
    assert node.processed == [*BAG_STAMPS, "epoch", 1000, 1002, 1004, 1006, 1008]


@pytest.mark.parametrize("ahead", [-900.0, -3.0, 7.0, 1e6])
def test_constant_offset_of_stamps_is_accepted(node: SimulatedNode, ahead: float) -> None:
    node.play(*BAG_STAMPS, ahead=ahead)
    node.send(1000 + ahead)
    node.clock(1000)
    node.play(*BAG_STAMPS[1:], ahead=ahead)
    assert node.processed_after(5) == ["epoch", *(stamp + ahead for stamp in BAG_STAMPS)]
    node.clock(1000)
    node.send(1004.5 + ahead)
    node.send(1000.5 + ahead)
    assert node.processed_after(11) == ["epoch", 1000.5 + ahead]


@pytest.fixture(params=[(1000, 1001), (1001, 1002), (1000, 1001, 1002), (1003, 1004)])
def late_node(node: SimulatedNode, request: pytest.FixtureRequest) -> SimulatedNode:
    """A node that has received the clock on time and some messages late, as on a busy machine."""
    late = request.param
    for stamp in BAG_STAMPS:
        node.clock(stamp)
        if stamp not in late:
            node.send(stamp)
        elif stamp == late[-1]:
            node.clock(stamp + 0.3)
            for late_stamp in late:
                node.send(late_stamp)
    return node


def test_early_message_waits_after_late_ones(late_node: SimulatedNode) -> None:
    late_node.send(1000)
    late_node.clock(1000)
    assert late_node.processed == [*BAG_STAMPS, "epoch", 1000]


def test_previous_epoch_is_dropped_after_late_messages(late_node: SimulatedNode) -> None:
    late_node.clock(1000)
    for stamp in (1004.1, 1004.2, 1000.1):
        late_node.send(stamp)
    assert late_node.processed == [*BAG_STAMPS, "epoch", 1000.1]


def test_messages_before_first_clock_are_accepted(node: SimulatedNode) -> None:
    node.send(1000)
    node.play(*BAG_STAMPS[1:])
    node.send(1000)
    assert node.processed == [*BAG_STAMPS]
    node.clock(1000)
    assert node.processed_after(5) == ["epoch", 1000]


def test_first_clock_is_no_elapsed_time(node: SimulatedNode) -> None:
    node.send(1000)
    node.clock(1002)
    node.send(1002)
    node.send(1000.9)
    assert node.processed == [1000, 1002, 1000.9]


UNRELATED_STAMPS = {
    "out of order": (1003, 1007, 1000, 1005, 1001, 1006),
    "all the same": (1000, 1000, 1000, 1000, 1000, 1000),
    "of years ago, standing still": (7, 7, 7, 7, 7, 7),
    "ever slower": (1000, 1001, 1001.1, 1001.2, 1001.3, 1001.4),
}


@pytest.mark.parametrize("name", UNRELATED_STAMPS)
def test_stamps_unrelated_to_clock_are_accepted(node: SimulatedNode, name: str) -> None:
    expected: List[Any] = []
    for _ in range(2):
        for index, stamp in enumerate(UNRELATED_STAMPS[name]):
            node.real_time += 0.2
            node.clock(1000 + index * 0.4)
            node.send(stamp)
        node.send(UNRELATED_STAMPS[name][0])
        expected += ["epoch", *UNRELATED_STAMPS[name], UNRELATED_STAMPS[name][0]]
    assert node.processed == expected[1:]


def test_latched_messages_are_accepted_again(node: SimulatedNode) -> None:
    node.play(*BAG_STAMPS)
    node.send(900, topic="/tf_static")
    node.clock(1000)
    node.send(900, topic="/tf_static")
    assert node.processed_after(5) == [900, "epoch", 900]


def test_wait_for_clock_times_out(node: SimulatedNode) -> None:
    node.play(*BAG_STAMPS)
    node.send(1000)
    node.send(1001)
    node.pass_time(0.9)
    assert node.processed_after(5) == []
    node.pass_time(0.2)
    assert node.processed_after(5) == [1000, 1001]
    node.send(995)  # nothing waits after a timeout
    node.pass_time(clock_epochs.PAUSE_AFTER_TIMEOUT_SECONDS)
    node.send(985)  # a frame that does not follow the clock
    assert node.processed_after(7) == [995, 985]


def test_nothing_waits_without_simulated_clock() -> None:
    node = SimulatedNode()
    skew = ClockSkewMonitor(Reports(), lambda: round(node.real_time * SECOND))
    process = skew.watch(SEEN_DECODER, "/seen").stamp
    for stamp in (*BAG_STAMPS, *BAG_STAMPS):
        node.real_time += 1
        assert process(struct.pack("<IIII", 0, stamp, 0, 0)) == stamp * SECOND


def test_number_of_waiting_messages_is_bounded(node: SimulatedNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_epochs, "MAX_BUFFERED_MESSAGES", 10)
    node.play(*BAG_STAMPS)
    for number in range(50):
        node.send(1000 + number / 100)
    node.clock(1000)
    assert node.processed_after(5) == ["epoch", *(1000 + number / 100 for number in range(40, 50))]
    assert node.epochs.dropped == 40
    assert node.reports.warnings == 40


# ---- event texts, whose senders report their epochs


def test_epoch_begins_after_late_sender_of_texts(node: SimulatedNode) -> None:
    node.epochs.report_epoch("interface", 3)
    node.play(*BAG_STAMPS)
    node.text("old", "interface")
    node.clock(1000)
    node.text("still old", "interface")
    node.send(1000)
    node.text("by hand", "somebody")
    assert node.processed_after(5) == ["old", "still old"]
    node.epochs.report_epoch("interface", 4)
    node.text("new", "interface")
    node.epochs.update()
    assert node.processed_after(7) == ["epoch", 1000, "by hand", "new"]


def test_texts_of_sender_ahead_wait_for_epoch(node: SimulatedNode) -> None:
    node.epochs.report_epoch("interface", 0)
    node.play(*BAG_STAMPS)
    node.epochs.report_epoch("interface", 1)
    node.text("new", "interface")
    node.text("old, by hand", "somebody")
    node.send(1004.5)
    node.epochs.update()
    assert node.processed_after(5) == ["old, by hand", 1004.5]
    node.clock(1000)
    node.text("newer", "interface")
    assert node.processed_after(7) == ["epoch", "new", "newer"]


def test_silent_sender_is_awaited_once(node: SimulatedNode) -> None:
    node.epochs.report_epoch("gone", 0)
    node.play(*BAG_STAMPS)
    node.clock(1000)
    node.send(1000)
    node.pass_time(0.9)
    assert node.processed_after(5) == []
    node.pass_time(0.2)
    assert node.processed_after(5) == ["epoch", 1000]
    node.play(1001, 1002, 1000)
    assert node.processed_after(7) == [1001, 1002, "epoch", 1000]


def test_reset_of_one_sender_only_times_out(node: SimulatedNode) -> None:
    node.epochs.report_epoch("interface", 0)
    node.play(*BAG_STAMPS)
    node.epochs.report_epoch("interface", 1)
    node.text("one", "interface")
    node.pass_time(1.1)
    node.text("two", "interface")
    assert node.processed_after(5) == ["one", "two"]
    node.clock(1000)  # after the timeout
    assert node.processed_after(7) == ["epoch"]


def test_epochs_of_new_sender_count_from_its_first(node: SimulatedNode) -> None:
    node.epochs.report_epoch("first", 0)
    node.play(*BAG_STAMPS)
    node.clock(1000)
    node.pass_time(1.1)
    node.epochs.report_epoch("second", 5)
    node.play(1001, 1002)
    node.clock(1000)
    assert node.processed_after(6) == [1001, 1002]
    node.epochs.report_epoch("second", 6)
    node.epochs.update()
    assert node.processed_after(8) == ["epoch"]


def test_number_of_senders_is_bounded(node: SimulatedNode) -> None:
    for number in range(10 * clock_epochs.MAX_SENDERS):
        node.epochs.report_epoch(number, 0)
    node.clock(1000)
    node.clock(900)
    node.pass_time(1.1)
    assert node.processed == ["epoch"]


def test_time_of_ended_epoch_stands_still(node: SimulatedNode) -> None:
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
def test_epochs_of_looping_bag_are_separate(seed: int, loops: int, is_late: bool, delay: int) -> None:
    """Either the clock or the messages of a bag that is played in a loop are late by a random time."""
    play_bag_in_loop(SimulatedNode(), Random(seed), loops, is_late, delay)


def play_bag_in_loop(node: SimulatedNode, generator: Any, loops: Any, is_late: Any, delay: Any) -> None:
    """Play a bag of 6 s in a loop; the milliseconds of a stamp are the number of the epoch."""
    for epoch in range(loops):

        def stamp_at(tenth: Any, epoch: Any = epoch) -> Any:
            return (1_000_000 + 100 * tenth + epoch) / 1000

        early = generator.randrange(1, 10) if epoch and is_late else 0
        for tenth in range(early):
            node.send(stamp_at(tenth))
            node.pass_time(generator.random() / 10)
        if epoch and not is_late:
            node.clock(1000)
            for tenth in range(generator.randrange(1, 5)):
                node.send(stamp_at(60 + tenth, epoch - 1))
        last = generator.randrange(early + delay, 60)
        for tenth in range(early, 60):
            node.pass_time(generator.random() / 10)
            node.clock(1000 + tenth / 10)
            if not last - delay <= tenth < last:  # these messages are late
                for late_tenth in range(tenth - delay, tenth) if tenth == last else ():
                    node.send(stamp_at(late_tenth))
                node.send(stamp_at(tenth))
        start = max(
            position
            for position, late_tenth in enumerate(["epoch", *node.processed])
            if late_tenth == "epoch"
        )
        assert node.processed.count("epoch") == epoch
        assert node.processed[start:] == [stamp_at(tenth) for tenth in range(60)]


def test_failed_callback_of_epoch_is_reported() -> None:
    node = SimulatedNode()
    ends: List[Any] = []

    def fail(end: Any) -> None:
        raise ValueError("not now")

    node.epochs.register_callbacks([threading.Lock()], fail, ends.append)
    node.clock(100)
    node.clock(10)
    node.real_time += 60
    node.epochs.update()
    assert (len(ends), node.reports.errors, node.epochs.is_buffering) == (1, 1, False)


class ReportingLock:
    """A lock that calls a function once after it has been released a number of times."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._release_count = 0
        self.action: Any = None

    def call_after_release(self, count: int, action: Any) -> None:
        self._release_count, self.action = count, action

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *error: object) -> None:
        self._lock.release()
        self._release_count -= 1
        if self._release_count == 0:
            self.action()


def test_sender_that_reports_during_timeout_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    lock = ReportingLock()
    with monkeypatch.context() as patched:
        patched.setattr(threading, "Lock", lambda: lock)
        node = SimulatedNode()
    node.epochs.register_callbacks([], lambda end: None)
    node.clock(1000)
    node.epochs.report_epoch("other", 0)
    node.clock(10)
    lock.call_after_release(1, lambda: node.epochs.report_epoch("other", 1))
    node.pass_time(2)
    # A removed sender would define a new offset, and this report would belong to the current epoch.
    node.epochs.report_epoch("other", 2)
    assert node.epochs.epoch == 1
    assert node.epochs.must_buffer_texts("other")


def test_eviction_of_late_sender_during_timeout_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    lock = ReportingLock()
    with monkeypatch.context() as patched:
        patched.setattr(threading, "Lock", lambda: lock)
        node = SimulatedNode()
    node.epochs.register_callbacks([], lambda end: None)
    node.clock(1000)
    node.epochs.report_epoch("other", 0)
    node.clock(10)

    def report_of_many() -> None:
        for number in range(clock_epochs.MAX_SENDERS):
            node.epochs.report_epoch(number, 0)

    lock.call_after_release(1, report_of_many)
    node.pass_time(2)
    assert node.epochs.epoch == 1
