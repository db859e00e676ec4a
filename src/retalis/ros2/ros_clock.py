"""ROS time of a node: the time of the machine, or that of the messages on ``/clock``."""

import logging
import time
from struct import Struct
from typing import Callable, List

log = logging.getLogger("retalis")

UNSET_CLOCK_WARNING_SECONDS = 5.0
"""Seconds without a message on ``/clock`` after which a warning is logged."""

_INSTANTS = {b"\x00\x01": Struct("<iI"), b"\x00\x00": Struct(">iI")}
"""Seconds and nanoseconds, by the first bytes of a message."""


class RosClock:
    """Time in nanoseconds since the epoch.

    rclpy's own clock takes microseconds for an answer, which each event needs.

    Args:
        is_simulated: whether the time is set from messages.
    """

    def __init__(self, is_simulated: bool):
        self.is_simulated = is_simulated
        self._simulated_now = 0
        self._started = time.monotonic()
        self._has_warned = False
        self._callbacks: List[Callable[[int], object]] = []

    def now(self) -> int:
        """Return the time; 0 while simulated time is unknown."""
        if not self.is_simulated:
            return time.time_ns()
        if not self._simulated_now:
            self._warn_if_unset()
        return self._simulated_now

    def on_tick(self, callback: Callable[[int], object]) -> None:
        """Call a function with each new instant of simulated time, after `now` returns it."""
        self._callbacks.append(callback)

    def set_from(self, message: bytes) -> None:
        """Set the time from a serialized ``rosgraph_msgs/Clock``."""
        reader = _INSTANTS.get(message[:2])
        if reader is None or len(message) < 12:
            return
        seconds, nanoseconds = reader.unpack_from(message, 4)
        self._simulated_now = now = seconds * 10**9 + nanoseconds
        for callback in self._callbacks:
            callback(now)

    def _warn_if_unset(self) -> None:
        if not self._has_warned and time.monotonic() > self._started + UNSET_CLOCK_WARNING_SECONDS:
            self._has_warned = True
            log.warning(
                "use_sim_time is true and nothing publishes /clock: time stands still, so no time passes "
                "between events, whatever a rule says of it; on a robot, start with use_sim_time:=false"
            )
