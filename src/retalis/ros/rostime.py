"""ROS time as integer nanoseconds."""

import time

import rospy
from rospy.rostime import is_wallclock

from ..engine.runtime import Clock

PATIENCE = 5.0
"""Seconds after which a clock that nobody has set is worth a warning."""

_began = time.monotonic()


def ros_now() -> int:
    """Return ROS time, simulated or not.

    Every event asks: rospy makes its object of the system's time out of a float, in ten times the time.
    """
    if is_wallclock():
        return time.time_ns()
    now = int(rospy.get_rostime().to_nsec())
    if not now and time.monotonic() > _began + PATIENCE:
        rospy.logwarn_once(
            "/use_sim_time is true and nothing publishes /clock: time stands still, so no sequence of events is "
            "detected; on a robot, start with use_sim_time:=false"
        )
    return now


class Receipts:
    """Stamps what comes without a stamp as the engine does: no two alike, never going back but with time itself.

    Two messages that come while ``/clock`` stands still are one after the other then, whichever node stamps them.
    """

    def __init__(self) -> None:
        self._clock = Clock(ros_now)
        self._runs = 0

    def stamp(self) -> int:
        """Return the instant of what has come now."""
        instant = self._clock.stamp_at_once()
        if instant is None:  # time has gone back
            self.runs()
            instant = self._clock.stamp()
        return instant

    def runs(self) -> int:
        """Return how often time has gone back so far."""
        if self._clock.went_back():
            self._runs += 1
        return self._runs
