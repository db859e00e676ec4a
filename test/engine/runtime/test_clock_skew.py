"""Stamps far from those before: what is warned of, what is refused, and what is none of it."""

import logging
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
ROBOT = 1_300_000_000.0
"""What a bag's stamps say, years before anybody's present."""


class Bench:
    """A topic whose messages are made here, and the clocks by which they are received."""

    def __init__(self, **options):
        self.now = self.wall = 5_000 * SECOND
        self.reports = Reports()
        self.skew = ClockSkewMonitor(self.reports, lambda: self.now, lambda: self.wall, **options)
        known = Definitions()
        self.decoder = known.decoder(known.add("my_robot/Seen", "Header header" + HEADER))
        self.watching = {}

    def pass_time(self, wall, now=None):
        """Let time pass, in seconds."""
        self.wall += round(wall * SECOND)
        self.now += round((wall if now is None else now) * SECOND)

    def send(self, stamp, frame="map", topic="/seen", publisher="/robot"):
        """Return whether a message is taken."""
        nanoseconds = round(stamp * SECOND)
        data = struct.pack("<IIII", 0, *divmod(nanoseconds, SECOND), len(frame)) + frame.encode()
        if (topic, publisher) not in self.watching:
            self.watching[topic, publisher] = self.skew.watch(self.decoder, topic, publisher)
        watching = self.watching[topic, publisher]
        try:
            watching.decode(data)
            assert watching.stamp(data) == (nanoseconds or None)
        except RefusedMessage:
            return False
        return True


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def strict():
    return Bench(max_distance_seconds=10.0)


def said(caplog):
    return [record.getMessage() for record in caplog.records]


@pytest.mark.parametrize("pause", [0, 1, 3600])
@pytest.mark.parametrize("rate", [0.1, 1, 10])
@pytest.mark.parametrize("step", [0.02, 1, 60, 86400])
@pytest.mark.parametrize("clock", ["wall", "simulated", "late"])
def test_no_false_alarm(strict, step, rate, pause, clock):
    """A bag at any pace, paused in the middle, of a robot of other years, by any clock of the node."""
    for at in range(40):
        assert strict.send(ROBOT + at * step)
        wall = step / rate + (pause if at == 20 else 0)
        strict.pass_time(wall, {"wall": wall, "simulated": step, "late": 0}[clock])
    assert strict.reports.warnings == 0


def test_a_slow_topic_beside_a_fast_one(strict):
    """The slow one may step by what the fast one has shown to have passed, whatever the clocks say."""
    for at in range(600):
        assert strict.send(ROBOT + at)
        if at % 200 == 0:
            assert strict.send(ROBOT + at, topic="/slow")
        strict.pass_time(0.01)
    assert strict.reports.warnings == 0


def test_an_hour_ahead(bench, caplog):
    for at in range(100):
        assert bench.send(ROBOT + at / 10)
        bench.pass_time(0.1)
    for _ in range(3):
        assert bench.send(ROBOT + 3610, publisher="/other")
        assert bench.send(ROBOT + 10)
    assert said(caplog) == [
        "topic /seen, frame map: a stamp from /other is 3600 s ahead of the stamps before it",
    ]
    bench.skew.log_counts()
    assert said(caplog)[1:] == ["topic /seen: 3 messages in all had a stamp far from those before"]


def test_behind(bench, caplog):
    bench.send(ROBOT)
    bench.pass_time(1)
    assert bench.send(ROBOT - 19)
    assert "20 s behind the stamps" in said(caplog)[0] or "19 s behind the stamps" in said(caplog)[0]


def test_each_frame_has_its_own_time(strict, caplog):
    for at in range(20):
        assert strict.send(ROBOT + at)
        assert strict.send(2 * ROBOT + at, frame="odom")
        assert strict.send(3 * ROBOT + at, topic="/other")
        strict.pass_time(1)
    assert said(caplog) == []


def test_refused(caplog):
    bench = Bench(max_distance_seconds=0.5)
    taken = []
    for at in range(20):
        taken.append(bench.send(ROBOT + at / 10 + (0.7 if at == 10 else 0)))
        bench.pass_time(0.1)
    assert taken == [at != 10 for at in range(20)]
    assert "0.7 s ahead" in said(caplog)[0] and said(caplog)[0].endswith("such messages are dropped")
    assert [(one.distant_count, one.refused_count) for one in bench.skew] == [(1, 1)]


def test_between_the_warning_and_the_limit(caplog):
    bench = Bench(max_distance_seconds=100.0)
    bench.send(ROBOT)
    assert bench.send(ROBOT + 50)
    assert not bench.send(ROBOT + 200)
    assert [(one.distant_count, one.refused_count) for one in bench.skew] == [(2, 1)]


def test_a_clock_that_is_set_is_taken_up(strict, caplog):
    for at in range(20):
        strict.send(ROBOT + at)
        strict.pass_time(1)
    taken = []
    for at in range(20, 50):
        taken.append(strict.send(ROBOT - 5000 + at))
        strict.pass_time(1)
    assert taken == [False] * (MIN_AGREEING_STAMPS - 1) + [True] * (31 - MIN_AGREEING_STAMPS)
    assert len(said(caplog)) == 2
    assert f"the last {MIN_AGREEING_STAMPS} stamps agree and are" in said(caplog)[1]


def test_what_alternates_is_not_taken_up(strict):
    for at in range(100):
        assert strict.send(ROBOT + at / 10)
        assert not strict.send(ROBOT + 3600 + at / 10, publisher="/wrong")
        strict.pass_time(0.1)


def test_a_first_stamp_that_is_wrong_does_not_last(strict):
    strict.send(ROBOT + 3600)
    taken = [strict.send(ROBOT + at / 10) for at in range(50)]
    assert taken == [False] * (MIN_AGREEING_STAMPS - 1) + [True] * (51 - MIN_AGREEING_STAMPS)


def test_stamps_of_zero_say_nothing(strict):
    for at in range(20):
        assert strict.send(ROBOT + at / 10)
        assert strict.send(0)


def test_bounded(strict):
    for at in range(3 * MAX_FRAMES):
        strict.send(ROBOT, frame=str(at))
    strict.send(ROBOT, frame="x" * 100_000)
    (times,) = strict.skew
    assert len(times) <= MAX_FRAMES


def test_bounded_over_all_topics(strict, monkeypatch):
    monkeypatch.setattr(clock_skew, "MAX_FRAME_BYTES", 100_000)
    for topic in range(20):
        for at in range(20):
            assert strict.send(ROBOT, frame=str(at), topic=f"/t{topic}")
            assert sum(times.total_bytes for times in strict.skew) <= 100_000
    assert any(times for times in strict.skew)
    assert not all(times for times in strict.skew)


def test_time_that_went_back_is_a_new_beginning(strict):
    strict.send(ROBOT)
    strict.skew.reset()
    assert strict.send(ROBOT - 5000)
    assert strict.reports.warnings == 0


def test_a_bag_that_is_played_again_is_one_matter_for_all_frames_of_a_topic(bench, caplog):
    for _ in range(3):
        for at in range(30):
            for frame in "abcdef":
                assert bench.send(ROBOT + 5 * at, frame=frame)
            bench.pass_time(5)
    assert [text.partition(":")[0] for text in said(caplog)] == [
        "topic /seen, frame a",
        "topic /seen",
        "topic /seen, frame a",
    ]
    assert "a bag that is played again without /clock" in said(caplog)[1]


def test_warnings_are_bounded(bench):
    bench_logged = logging.getLogger("retalis")
    lines = []
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(record)
    bench_logged.addHandler(handler)
    for at in range(1000):
        bench.send(ROBOT, frame=str(at))
        bench.send(ROBOT + 3600, frame=str(at))
    bench_logged.removeHandler(handler)
    assert len(lines) < 40


@given(
    st.lists(
        st.tuples(st.floats(0.001, 100), st.floats(0.1, 9.99), st.floats(0, 100)), min_size=1, max_size=50
    ),
    st.sampled_from(["wall", "simulated"]),
)
def test_stamps_that_go_with_some_time_are_never_far(steps, clock):
    """Each step is played at a pace of its own between a tenth and nearly ten times, with a pause after it.

    Not at ten times exactly: the stamps here are floats, which are right to a quarter of a microsecond.
    """
    bench = Bench(max_distance_seconds=11.0)
    stamp = ROBOT
    paces = [pace for _, pace, _ in steps] if clock == "simulated" else [steps[0][1]] * len(steps)
    for (step, _, pause), pace in zip(steps, paces):
        assert bench.send(stamp)
        stamp += step
        bench.pass_time(step / pace + pause, None if clock == "wall" else step)
    assert bench.send(stamp)
    assert bench.reports.warnings == 0


@given(st.lists(st.floats(0.01, 1), min_size=2, max_size=50), st.floats(15, 1e8), st.booleans())
def test_one_far_stamp_is_always_found(steps, far, ahead):
    bench = Bench(max_distance_seconds=11.0)
    stamp = ROBOT
    for step in steps:
        assert bench.send(stamp)
        stamp += step
        bench.pass_time(step)
    assert not bench.send(stamp + far if ahead else stamp - far)
    assert bench.send(stamp)
