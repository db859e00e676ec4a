"""Warnings about topics without publishers after the start, and detection of lost messages."""

from struct import pack
from typing import Any, Dict, List, Tuple

import pytest

from retalis.node.topic_statistics import (
    MIN_BEHIND_SECONDS,
    InputCounts,
    InputStatus,
    LossMonitor,
    unpublished_topic_warnings,
)

SCAN = InputStatus(
    topic="/robot/scan",
    type="sensor_msgs/LaserScan",
    publishers=0,
    messages=0,
    dropped=0,
    refused=0,
    missing=0,
    age=None,
    lag=None,
)
OWN = {"/retalis", "/retalis_ros_interface"}


@pytest.mark.parametrize(
    ("publishers", "suggestion"),
    [
        ({"/rosout": ["/lidar"], "/robot/scn": ["/lidar"]}, "; did you mean /robot/scn?"),
        ({"/rosout": ["/lidar"], "/tf": ["/lidar"]}, ""),
        ({"/robot/scn": ["/retalis"]}, ""),
        ({"/robot/scn": ["/retalis_ros_interface"]}, ""),
        ({"/robot/scn": ["/retalis_ros_interface", "/lidar"]}, "; did you mean /robot/scn?"),
        ({"/robot/scan": [], "/robot/scans": ["/retalis"]}, ""),
        ({}, ""),
    ],
)
def test_unpublished_topic_is_warned_of(publishers: Dict[str, List[str]], suggestion: str) -> None:
    expected = f"nobody publishes topic /robot/scan (sensor_msgs/LaserScan) 10 s after the start{suggestion}"
    assert list(unpublished_topic_warnings([SCAN], publishers, OWN)) == [expected]


def test_published_topic_is_not_warned_of() -> None:
    assert list(unpublished_topic_warnings([SCAN], {"/robot/scan": ["/lidar"]}, OWN)) == []
    assert list(unpublished_topic_warnings([SCAN._replace(publishers=1)], {}, OWN)) == []
    # Its publisher has ended.
    assert list(unpublished_topic_warnings([SCAN._replace(messages=3)], {}, OWN)) == []


class Connection:
    """A monitored connection with a clock of its own.

    Args:
        has_header: whether messages begin with a header.
    """

    def __init__(self, has_header: bool = True) -> None:
        self.now = 0.0
        self.counts = InputCounts(lambda: 0)
        self.reports: List[Any] = []
        self.monitor = LossMonitor(self.counts, has_header, self.reports.append, lambda: self.now)

    def read(self, *numbers: Any, waited: float = 0.0, busy: float = 1.0) -> None:
        """Read messages, given as number or bytes, after a wait, and process them; times are in seconds."""
        self.now += waited
        self.monitor.begin(
            [number if isinstance(number, bytes) else pack("<I", number) for number in numbers]
        )
        self.now += busy
        self.monitor.end()


def test_gap_in_busy_node_is_a_loss() -> None:
    connection = Connection()
    connection.read(7)
    connection.read(8, 12)
    connection.read(13)
    connection.read(15)
    assert connection.counts.missing == 4
    assert connection.reports == [
        "3 messages missing between header.seq 8 and 12",
        "1 message missing between header.seq 13 and 15",
    ]


def test_gap_after_a_wait_is_no_loss() -> None:
    connection = Connection()
    for number in range(0, 100, 10):
        connection.read(number, number + 1, waited=2.0)
    assert (connection.counts.missing, connection.reports) == (0, [])


@pytest.mark.parametrize("numbers", [(3, 100, 4, 101, 200), (0, 9, 9, 30), (5, 8, 1, 40)])
def test_gaps_of_unordered_numbers_are_no_loss(numbers: Tuple[Any, ...]) -> None:
    connection = Connection()
    for number in numbers:
        connection.read(number)
    assert connection.counts.missing == 0


def test_message_without_number_has_no_gap() -> None:
    connection = Connection()
    connection.read(1)
    connection.read(b"abc", 5)
    connection.read(9)
    assert connection.counts.missing == 7
    connection = Connection(has_header=False)
    connection.read(1)
    connection.read(9)
    assert connection.counts.missing == 0


def test_incomplete_last_message_is_a_loss() -> None:
    connection = Connection()
    connection.read(1, waited=2.0)
    connection.monitor.close(is_incomplete=True)
    assert connection.counts.missing == 1
    assert connection.reports == [
        "it closed the connection within a message: those in its queue are lost, too"
    ]


def test_end_of_delayed_connection_is_reported() -> None:
    connection = Connection()
    connection.read(1, busy=2 * MIN_BEHIND_SECONDS)
    connection.read(2, busy=0.0)
    connection.monitor.close(is_incomplete=False)
    assert connection.counts.missing == 0
    assert connection.reports == ["it closed the connection: messages that were still in its queue are lost"]


@pytest.mark.parametrize("busy", [MIN_BEHIND_SECONDS / 100, 2 * MIN_BEHIND_SECONDS])
def test_end_after_idle_time_is_not_reported(busy: float) -> None:
    connection = Connection()
    for number in range(3):
        connection.read(number, waited=0.0, busy=busy)
    connection.now += 98.0
    connection.monitor.close(is_incomplete=False)
    assert connection.reports == []


def test_end_after_short_burst_is_not_reported() -> None:
    connection = Connection()
    connection.read(1, busy=MIN_BEHIND_SECONDS / 4)
    connection.read(2, busy=MIN_BEHIND_SECONDS / 4)
    connection.monitor.close(is_incomplete=False)
    connection.read(3, waited=2.0)
    connection.now += 1.0
    connection.monitor.close(is_incomplete=False)
    assert connection.reports == []
