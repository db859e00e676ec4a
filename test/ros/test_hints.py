"""What is said once after the start: topics that nobody publishes."""

import pytest

from retalis.ros.counting import InputStatus
from retalis.ros.hints import unpublished

SCAN = InputStatus("/robot/scan", "sensor_msgs/LaserScan", 0, 0, 0, 0, None, None)


@pytest.mark.parametrize(
    ("published", "said"),
    [
        (["/rosout", "/robot/scn"], "; did you mean /robot/scn?"),
        (["/rosout", "/tf"], ""),
        ([], ""),
    ],
)
def test_a_topic_that_nobody_publishes_is_said(published, said):
    expected = f"nobody publishes topic /robot/scan (sensor_msgs/LaserScan) 10 s after the start{said}"
    assert list(unpublished([SCAN], published)) == [expected]


def test_topics_that_somebody_publishes_are_left_alone():
    assert list(unpublished([SCAN], ["/robot/scan"])) == []
    assert list(unpublished([SCAN._replace(publishers=1)], [])) == []
    assert list(unpublished([SCAN._replace(messages=3)], [])) == []  # from one who has gone
