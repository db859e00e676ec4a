"""Random messages of the types of rosbags, decoded and encoded by this package and by rosbags."""

import pytest

pytest.importorskip("rosbags")

from messages import cdr_codec_comparison  # noqa: E402
from messages.codec_comparison import compare_messages, rosbags_references  # noqa: E402

MESSAGES_PER_TYPE = 10
"""Messages of each type; ``python3 -m messages.codec_comparison`` compares any number."""

FAST_TYPES = {
    "std_msgs/Header",
    "std_msgs/Empty",
    "std_msgs/ByteMultiArray",
    "std_msgs/UInt8MultiArray",
    "sensor_msgs/LaserScan",
    "sensor_msgs/Image",
    "sensor_msgs/PointCloud2",
    "nav_msgs/OccupancyGrid",
    "nav_msgs/Odometry",
    "diagnostic_msgs/DiagnosticArray",
    "visualization_msgs/MarkerArray",
    "trajectory_msgs/JointTrajectory",
}


def test_common_types_agree_with_rosbags() -> None:
    references = [reference for reference in rosbags_references() if reference.definition.name in FAST_TYPES]
    assert {reference.definition.name for reference in references} == FAST_TYPES
    for reference in references:
        compare_messages(reference, MESSAGES_PER_TYPE)


@pytest.mark.slow
def test_all_types_agree_with_rosbags() -> None:
    types = 0
    for reference in rosbags_references():
        compare_messages(reference, MESSAGES_PER_TYPE)
        types += 1
    assert types > 300


@pytest.mark.slow
def test_all_types_of_ros2_agree_with_rosbags() -> None:
    types = 0
    for reference in cdr_codec_comparison.rosbags_references():
        cdr_codec_comparison.compare_messages(reference, MESSAGES_PER_TYPE)
        types += 1
    assert types > 150
