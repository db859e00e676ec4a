"""Distant stamps: warnings, refusals, and streams without either."""

import logging
import struct
from typing import Any, Dict, List

import pytest
from hypothesis import given
from hypothesis import strategies as st
from logging_handlers import RecordingHandler

from retalis import Definitions, Reports
from retalis.engine.runtime import clock_skew
from retalis.engine.runtime.clock_skew import (
    MAX_FRAMES,
    MIN_AGREEING_STAMPS,
    ClockSkewMonitor,
    RefusedMessage,
)

SECOND = 10**9
HEADER = "\n" + "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
ARRAY = "Seen[] all\n" + "=" * 80 + "\nMSG: my_robot/Seen\nHeader header" + HEADER
ROBOT = 1_300_000_000.0
"""Time of a bag in seconds, years before the present."""


class SimulatedTopics:
    """Topics with their messages, and the clocks of their receipt."""

    def __init__(self, **options: Any) -> None:
        self.now = self.wall = 5_000 * SECOND
        self.reports = Reports()
        self.skew = ClockSkewMonitor(self.reports, lambda: self.now, lambda: self.wall, **options)
        known = Definitions()
        self.decoder = known.decoder(known.add("my_robot/Seen", "Header header" + HEADER))
        self.array_decoder = known.decoder(known.add("my_robot/SeenArray", ARRAY))
        self.watches: Dict[Any, Any] = {}

    def pass_time(self, wall: Any, now: Any = None) -> None:
        """Advance the clocks by seconds."""
        self.wall += round(wall * SECOND)
        self.now += round((wall if now is None else now) * SECOND)

    def send(self, stamp: float, frame: str = "map", topic: str = "/seen", publisher: str = "/robot") -> bool:
        """Return whether a message is accepted."""
        nanoseconds = round(stamp * SECOND)
        data = struct.pack("<IIII", 0, *divmod(nanoseconds, SECOND), len(frame)) + frame.encode()
        if (topic, publisher) not in self.watches:
            self.watches[topic, publisher] = self.skew.watch(self.decoder, topic, publisher)
        watch = self.watches[topic, publisher]
        try:
            watch.decode(data)
            assert watch.stamp(data) == (nanoseconds or None)
        except RefusedMessage:
            return False
        return True

    def send_array(self, stamp: float) -> bool:
        """Return whether a message of twelve elements with equal stamps and frames is accepted."""
        element = struct.pack("<IIII", 0, *divmod(round(stamp * SECOND), SECOND), 3) + b"map"
        data = struct.pack("<I", 12) + 12 * element
        watch = self.skew.watch(self.array_decoder, "/all")
        try:
            watch.decode(data)
            watch.stamp(data)
        except RefusedMessage:
            return False
        return True


@pytest.fixture
def topics() -> SimulatedTopics:
    return SimulatedTopics()


@pytest.fixture
def strict() -> SimulatedTopics:
    return SimulatedTopics(max_distance_seconds=10.0)


def logged_messages(caplog: pytest.LogCaptureFixture) -> List[Any]:
    return [record.getMessage() for record in caplog.records]


@pytest.mark.parametrize("pause", [0, 1, 3600])
@pytest.mark.parametrize("rate", [0.1, 1, 10])
@pytest.mark.parametrize("step", [0.02, 1, 60, 86400])
@pytest.mark.parametrize("clock", ["wall", "simulated", "late"])
def test_bag_at_any_rate_gives_no_warning(
    strict: SimulatedTopics, step: float, rate: float, pause: int, clock: str
) -> None:
    """A bag of another year, played at any rate with a pause, on any clock of the node."""
    for number in range(40):
        assert strict.send(ROBOT + number * step)
        wall = step / rate + (pause if number == 20 else 0)
        strict.pass_time(wall, {"wall": wall, "simulated": step, "late": 0}[clock])
    assert strict.reports.warnings == 0


def test_slow_topic_may_step_as_far_as_fast_one(strict: SimulatedTopics) -> None:
    """The fast topic shows that time has passed, independent of the clocks."""
    for second in range(600):
        assert strict.send(ROBOT + second)
        if second % 200 == 0:
            assert strict.send(ROBOT + second, topic="/slow")
        strict.pass_time(0.01)
    assert strict.reports.warnings == 0


def test_stamp_an_hour_ahead_gives_one_warning(
    topics: SimulatedTopics, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(100):
        assert topics.send(ROBOT + number / 10)
        topics.pass_time(0.1)
    for _ in range(3):
        assert topics.send(ROBOT + 3610, publisher="/other")
        assert topics.send(ROBOT + 10)
    assert logged_messages(caplog) == [
        "topic /seen, frame map: a stamp from /other is 3600 s ahead of the stamps before it",
    ]
    topics.skew.log_counts()
    assert logged_messages(caplog)[1:] == ["topic /seen: 3 messages in all had a stamp far from those before"]


def test_stamp_behind_gives_warning(topics: SimulatedTopics, caplog: pytest.LogCaptureFixture) -> None:
    topics.send(ROBOT)
    topics.pass_time(1)
    assert topics.send(ROBOT - 19)
    assert "19 s behind the stamps" in logged_messages(caplog)[0]


def test_frames_have_separate_times(strict: SimulatedTopics, caplog: pytest.LogCaptureFixture) -> None:
    for second in range(20):
        assert strict.send(ROBOT + second)
        assert strict.send(2 * ROBOT + second, frame="odom")
        assert strict.send(3 * ROBOT + second, topic="/other")
        strict.pass_time(1)
    assert logged_messages(caplog) == []


def test_stamp_beyond_limit_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    topics = SimulatedTopics(max_distance_seconds=0.5)
    accepted: List[Any] = []
    for number in range(20):
        accepted.append(topics.send(ROBOT + number / 10 + (0.7 if number == 10 else 0)))
        topics.pass_time(0.1)
    assert accepted == [number != 10 for number in range(20)]
    assert "0.7 s ahead" in logged_messages(caplog)[0]
    assert logged_messages(caplog)[0].endswith("such messages are dropped")
    assert [(times.distant_count, times.refused_count) for times in topics.skew] == [(1, 1)]


def test_stamp_within_limit_is_counted_and_accepted() -> None:
    topics = SimulatedTopics(max_distance_seconds=100.0)
    topics.send(ROBOT)
    assert topics.send(ROBOT + 50)
    assert not topics.send(ROBOT + 200)
    assert [(times.distant_count, times.refused_count) for times in topics.skew] == [(2, 1)]


def test_agreeing_stamps_set_new_time(strict: SimulatedTopics, caplog: pytest.LogCaptureFixture) -> None:
    for second in range(20):
        strict.send(ROBOT + second)
        strict.pass_time(1)
    accepted: List[Any] = []
    for second in range(20, 50):
        accepted.append(strict.send(ROBOT - 5000 + second))
        strict.pass_time(1)
    assert accepted == [False] * (MIN_AGREEING_STAMPS - 1) + [True] * (31 - MIN_AGREEING_STAMPS)
    assert len(logged_messages(caplog)) == 2
    assert f"the last {MIN_AGREEING_STAMPS} stamps agree and are" in logged_messages(caplog)[1]


def test_elements_of_one_message_set_no_new_time() -> None:
    topics = SimulatedTopics(max_distance_seconds=10.0)
    for second in range(5):
        assert topics.send_array(ROBOT + second)
        topics.pass_time(1)
    accepted = [topics.send_array(ROBOT + 5000 + second) for second in range(MIN_AGREEING_STAMPS)]
    assert accepted == [False] * (MIN_AGREEING_STAMPS - 1) + [True]


def test_alternating_stamps_set_no_new_time(strict: SimulatedTopics) -> None:
    for number in range(100):
        assert strict.send(ROBOT + number / 10)
        assert not strict.send(ROBOT + 3600 + number / 10, publisher="/wrong")
        strict.pass_time(0.1)


def test_wrong_first_stamp_is_replaced(strict: SimulatedTopics) -> None:
    strict.send(ROBOT + 3600)
    accepted = [strict.send(ROBOT + number / 10) for number in range(50)]
    assert accepted == [False] * (MIN_AGREEING_STAMPS - 1) + [True] * (51 - MIN_AGREEING_STAMPS)


def test_stamps_of_zero_are_ignored(strict: SimulatedTopics) -> None:
    for number in range(20):
        assert strict.send(ROBOT + number / 10)
        assert strict.send(0)


def test_number_of_frames_is_bounded(strict: SimulatedTopics) -> None:
    for number in range(3 * MAX_FRAMES):
        strict.send(ROBOT, frame=str(number))
    strict.send(ROBOT, frame="x" * 100_000)
    (times,) = strict.skew
    assert len(times) <= MAX_FRAMES


def test_memory_of_all_topics_is_bounded(strict: SimulatedTopics, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_skew, "MAX_FRAME_BYTES", 100_000)
    for topic in range(20):
        for number in range(20):
            assert strict.send(ROBOT, frame=str(number), topic=f"/t{topic}")
            assert sum(times.total_bytes for times in strict.skew) <= 100_000
    assert any(times for times in strict.skew)
    assert not all(times for times in strict.skew)


def test_reset_accepts_earlier_stamps(strict: SimulatedTopics) -> None:
    strict.send(ROBOT)
    strict.skew.reset()
    assert strict.send(ROBOT - 5000)
    assert strict.reports.warnings == 0


def test_repeated_bag_gives_one_warning_per_topic(
    topics: SimulatedTopics, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(3):
        for number in range(30):
            for frame in "abcdef":
                assert topics.send(ROBOT + 5 * number, frame=frame)
            topics.pass_time(5)
    assert [text.partition(":")[0] for text in logged_messages(caplog)] == [
        "topic /seen, frame a",
        "topic /seen",
        "topic /seen, frame a",
    ]
    assert "a bag that is played again without /clock" in logged_messages(caplog)[1]


def test_number_of_warnings_is_bounded(topics: SimulatedTopics) -> None:
    logger = logging.getLogger("retalis")
    records: List[str] = []
    handler = RecordingHandler(records)
    logger.addHandler(handler)
    try:
        for number in range(1000):
            topics.send(ROBOT, frame=str(number))
            topics.send(ROBOT + 3600, frame=str(number))
    finally:
        logger.removeHandler(handler)
    assert len(records) < 40


@given(
    st.lists(
        st.tuples(st.floats(0.001, 100), st.floats(0.1, 9.99), st.floats(0, 100)), min_size=1, max_size=50
    ),
    st.sampled_from(["wall", "simulated"]),
)
def test_stamps_that_follow_a_clock_give_no_warning(steps: List[Any], clock: Any) -> None:
    """Each step is played at a rate between 0.1 and 9.99, with a pause after it.

    The rate is less than 10, because the stamps are floats, which have errors of a quarter of a microsecond.
    """
    topics = SimulatedTopics(max_distance_seconds=11.0)
    stamp = ROBOT
    paces = [pace for _, pace, _ in steps] if clock == "simulated" else [steps[0][1]] * len(steps)
    for (step, _, pause), pace in zip(steps, paces):
        assert topics.send(stamp)
        stamp += step
        topics.pass_time(step / pace + pause, None if clock == "wall" else step)
    assert topics.send(stamp)
    assert topics.reports.warnings == 0


@given(st.lists(st.floats(0.01, 1), min_size=2, max_size=50), st.floats(15, 1e8), st.booleans())
def test_distant_stamp_is_always_refused(steps: List[Any], distance: float, is_ahead: bool) -> None:
    topics = SimulatedTopics(max_distance_seconds=11.0)
    stamp = ROBOT
    for step in steps:
        assert topics.send(stamp)
        stamp += step
        topics.pass_time(step)
    assert not topics.send(stamp + distance if is_ahead else stamp - distance)
    assert topics.send(stamp)
