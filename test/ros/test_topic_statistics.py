"""Warnings about topics without publishers after the start."""

import pytest

from retalis.ros.topic_statistics import InputStatus, unpublished_topic_warnings

SCAN = InputStatus("/robot/scan", "sensor_msgs/LaserScan", 0, 0, 0, 0, None, None)
OWN = {"/retalis", "/retalis_ros_interface"}


@pytest.mark.parametrize(
    ("publishers", "said"),
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
def test_a_topic_that_nobody_publishes_is_said(publishers, said):
    expected = f"nobody publishes topic /robot/scan (sensor_msgs/LaserScan) 10 s after the start{said}"
    assert list(unpublished_topic_warnings([SCAN], publishers, OWN)) == [expected]


def test_topics_that_somebody_publishes_are_left_alone():
    assert list(unpublished_topic_warnings([SCAN], {"/robot/scan": ["/lidar"]}, OWN)) == []
    assert list(unpublished_topic_warnings([SCAN._replace(publishers=1)], {}, OWN)) == []
    assert (
        list(unpublished_topic_warnings([SCAN._replace(messages=3)], {}, OWN)) == []
    )  # from one who has gone
