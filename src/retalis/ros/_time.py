"""ROS time as integer nanoseconds."""

import time

import rospy
from rospy.rostime import is_wallclock


def ros_now() -> int:
    """Return ROS time, simulated or not.

    Every event asks: rospy makes its object of the system's time out of a float, in ten times the time.
    """
    return time.time_ns() if is_wallclock() else int(rospy.get_rostime().to_nsec())
