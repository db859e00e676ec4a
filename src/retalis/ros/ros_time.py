"""ROS time as integer nanoseconds."""

import threading
import time
from typing import Callable, ContextManager, Optional, Sequence

import rospy
from rosgraph_msgs.msg import Clock as ClockMessage
from rospy.rostime import is_wallclock

from ..engine.runtime.clock import Clock
from ..engine.runtime.clock_epochs import ClockEpochs
from ..engine.runtime.problem_reports import Reports

UNSET_CLOCK_WARNING_SECONDS = 5.0
"""Seconds after which a clock that nobody has set is worth a warning."""

_began = time.monotonic()


def ros_now() -> int:
    """Return ROS time, simulated or not.

    Every event asks: rospy makes its object of the system's time out of a float, in ten times the time.
    """
    if is_wallclock():
        return time.time_ns()
    now = int(rospy.get_rostime().to_nsec())
    if not now and time.monotonic() > _began + UNSET_CLOCK_WARNING_SECONDS:
        rospy.logwarn_once(
            "/use_sim_time is true and nothing publishes /clock: time stands still, so no time passes "
            "between events, whatever a rule says of it; on a robot, start with use_sim_time:=false"
        )
    return now


class SimulatedTime:
    """ROS time, where it is simulated: all in the node see it go back at once, when a run begins (`ClockEpochs`).

    Attributes:
        runs: the runs; None where time is not simulated.
    """

    def __init__(self, reports: Reports):
        self._reports = reports
        self._woken = threading.Event()
        self._clock: Optional[rospy.Subscriber] = None
        self.runs = None if is_wallclock() else ClockEpochs(reports, ros_now, self._woken.set)

    def now(self) -> int:
        """Return the time of the run at hand."""
        return ros_now() if self.runs is None else self.runs.now()

    def may_wait(self) -> bool:
        """Tell whether messages may wait for a run to begin."""
        return self.runs is not None and self.runs.may_wait()

    def begin(self, turns: Sequence[ContextManager[object]], *began: Callable[[int], object]) -> None:
        """Follow ``/clock`` from now on; see `ClockEpochs.begin`."""
        runs = self.runs
        if runs is None:
            return
        runs.begin(turns, *began)

        def work() -> None:
            wait: Optional[float] = None
            while not rospy.is_shutdown():
                self._woken.wait(wait)
                self._woken.clear()
                try:
                    wait = runs.step()
                except Exception as error:  # the next step does what this one has left
                    self._reports.error(error)

        threading.Thread(target=work, daemon=True, name="runs of /clock").start()
        # rospy has subscribed it, too: this is called after it has set its time, in the same thread.
        self._clock = rospy.Subscriber(
            "/clock", ClockMessage, lambda message: runs.clock_at(message.clock.to_nsec())
        )


class Receipts:
    """Stamps what comes without a stamp as the engine does: no two alike, never going back but with time itself.

    Two messages that come while ``/clock`` stands still are one after the other then, whichever node stamps them.

    Args:
        now: the present; by default ROS time.
    """

    def __init__(self, now: Callable[[], int] = ros_now) -> None:
        self._clock = Clock(now)
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
