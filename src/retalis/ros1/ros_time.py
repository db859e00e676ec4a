"""ROS time as integer nanoseconds, its epochs if it is simulated, and receipt stamps."""

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
"""Seconds without a message on ``/clock`` after which a warning is logged."""

_began = time.monotonic()


def ros_now() -> int:
    """Return ROS time in nanoseconds, simulated or not.

    This runs for each event. rospy would create its object for wall time from a float, which takes ten times as long.
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
    """ROS time with clock epochs if it is simulated.

    When simulated time jumps back, all parts of the node enter the new epoch at the same moment; see `ClockEpochs`.

    Attributes:
        epochs: the epochs; None for wall time.
    """

    def __init__(self, reports: Reports):
        self._reports = reports
        self._wake_up = threading.Event()
        self._clock: Optional[rospy.Subscriber] = None
        self.epochs = None if is_wallclock() else ClockEpochs(reports, ros_now, self._wake_up.set)

    def now(self) -> int:
        """Return the time of the present epoch in nanoseconds."""
        return ros_now() if self.epochs is None else self.epochs.now()

    def buffers_early_messages(self) -> bool:
        """Return whether messages may be queued for an epoch that has not begun."""
        return self.epochs is not None and self.epochs.buffers_early_messages()

    def start(self, locks: Sequence[ContextManager[object]], *callbacks: Callable[[int], object]) -> None:
        """Start to follow ``/clock``; see `ClockEpochs.register_callbacks`."""
        epochs = self.epochs
        if epochs is None:
            return
        epochs.register_callbacks(locks, *callbacks)

        def update_epochs() -> None:
            timeout: Optional[float] = None
            while not rospy.is_shutdown():
                self._wake_up.wait(timeout)
                self._wake_up.clear()
                try:
                    timeout = epochs.update()
                except Exception as error:
                    # The next step continues the work of this one.
                    self._reports.error(error)

        threading.Thread(target=update_epochs, daemon=True, name="runs of /clock").start()
        # rospy itself subscribes to /clock. Its callback is registered earlier and runs in the same thread, so
        # rospy's time has been updated when this callback runs.
        self._clock = rospy.Subscriber(
            "/clock", ClockMessage, lambda message: epochs.update_clock(message.clock.to_nsec())
        )


class Receipts:
    """Receipt stamps for messages without a stamp: strictly increasing within a clock epoch, as in the engine.

    Two messages that are received while ``/clock`` stands still get different stamps, whichever node stamps them.

    Args:
        now: clock in nanoseconds; by default ROS time.
    """

    def __init__(self, now: Callable[[], int] = ros_now) -> None:
        self._clock = Clock(now)
        self._epoch = 0

    def stamp(self) -> int:
        """Return the stamp of a message that is received now, in nanoseconds."""
        instant = self._clock.stamp_at_once()
        if instant is None:
            # Time has jumped back.
            self.epoch()
            instant = self._clock.stamp()
        return instant

    def epoch(self) -> int:
        """Return the number of times that time has jumped back until now."""
        if self._clock.went_back():
            self._epoch += 1
        return self._epoch
