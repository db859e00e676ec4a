"""The types of all stores of rosbags: this package and rosbags decode and encode random messages alike."""

import pytest

pytest.importorskip("rosbags")

from messages.reference_codecs import check, rosbags_references  # noqa: E402

MESSAGES = 10
"""Messages of each type; ``python3 -m messages.reference_codecs`` tries any number."""

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


def test_usual_types_are_decoded_and_encoded_as_by_rosbags():
    references = [reference for reference in rosbags_references() if reference.definition.name in FAST_TYPES]
    assert {reference.definition.name for reference in references} == FAST_TYPES
    for reference in references:
        check(reference, MESSAGES)


@pytest.mark.slow
def test_all_types_are_decoded_and_encoded_as_by_rosbags():
    types = 0
    for reference in rosbags_references():
        check(reference, MESSAGES)
        types += 1
    assert types > 300
