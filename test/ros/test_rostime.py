"""ROS time. Needs rospy, no master."""

import time

import pytest

rospy = pytest.importorskip("rospy", reason="ROS is not installed")

from retalis.ros import rostime  # noqa: E402


@pytest.fixture
def warnings(monkeypatch):
    found = []
    monkeypatch.setattr(rospy, "logwarn_once", found.append)
    monkeypatch.setattr(rostime, "is_wallclock", lambda: False)
    return found


def test_a_clock_that_stands_still_is_warned_of_after_a_while(warnings, monkeypatch):
    monkeypatch.setattr(rospy, "get_rostime", rospy.Time)
    monkeypatch.setattr(rostime, "_began", time.monotonic())
    assert rostime.ros_now() == 0
    assert warnings == []
    monkeypatch.setattr(rostime, "_began", time.monotonic() - 2 * rostime.PATIENCE)
    assert rostime.ros_now() == 0
    assert len(warnings) == 1
    assert "nothing publishes /clock" in warnings[0]


def test_a_clock_that_runs_is_not_warned_of(warnings, monkeypatch):
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(3, 4))
    monkeypatch.setattr(rostime, "_began", time.monotonic() - 2 * rostime.PATIENCE)
    assert rostime.ros_now() == 3_000_000_004
    assert warnings == []


def test_receipts_are_all_different_and_start_anew_where_time_goes_back(monkeypatch):
    times = [5, 5, 5, 4.5, 5.5, 2, 2, 9]
    monkeypatch.setattr(rostime, "is_wallclock", lambda: False)
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time.from_sec(times[0]))
    receipts = rostime.Receipts()
    found = []
    while times:
        found.append(receipts.stamp())
        times.pop(0)
    second = 10**9
    assert found == [
        *(5 * second + more for more in (0, 1, 2, 3)),
        5 * second + second // 2,
        *(2 * second + more for more in (0, 1)),
        9 * second,
    ]
