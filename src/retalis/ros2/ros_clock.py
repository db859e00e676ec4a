"""ROS time of a node: the time of the machine, or that of the messages on ``/clock``."""

import logging
import time
from struct import Struct
from typing import Any, Callable, List, Optional

from rclpy.clock import ClockType, ROSClock
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.time import Time

from .installed_interfaces import InstalledInterfaces

log = logging.getLogger("retalis")

CLOCK_TOPIC = "/clock"
CLOCK_TYPE = "rosgraph_msgs/Clock"

UNSET_CLOCK_WARNING_SECONDS = 5.0
"""Seconds without a message on ``/clock`` after which a warning is logged."""

_INSTANTS = {b"\x00\x01": Struct("<iI"), b"\x00\x00": Struct(">iI")}
"""Seconds and nanoseconds, by the first bytes of a message."""


def replace_clock_subscription(node: Node) -> Optional[Callable[[int], object]]:
    """End rclpy's own subscription to ``/clock``, which takes 200 µs for a message.

    The object that subscribes is not public. If it is missing, rclpy subscribes as before.

    Returns:
        A function that sets the time of rclpy's clock in nanoseconds; None if rclpy sets it.
    """
    detach = getattr(getattr(node, "_time_source", None), "detach_node", None)
    clock = node.get_clock()
    if detach is None or not isinstance(clock, ROSClock):
        return None
    detach()
    return lambda now: clock.set_ros_time_override(Time(nanoseconds=now, clock_type=ClockType.ROS_TIME))


def follow_clock(node: Node) -> Optional[Subscription]:
    """Have rclpy's clock of a node follow ``/clock`` after `replace_clock_subscription`, as before it.

    A node whose program has ended needs its time for its logs and parameter events, and for the next start.

    Returns:
        The subscription, which the node's executor reads; None if the time of the node is not simulated.
    """
    clock = node.get_clock()
    if not isinstance(clock, ROSClock) or not clock.ros_time_is_active:
        return None

    def set_time(message: Any) -> None:
        clock.set_ros_time_override(Time.from_msg(message.clock))

    profile = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    message_class = InstalledInterfaces().message_class(CLOCK_TYPE)
    return node.create_subscription(message_class, CLOCK_TOPIC, set_time, profile)


class RosClock:
    """Time in nanoseconds since the epoch.

    rclpy's own clock takes microseconds for an answer, which each event needs.

    Args:
        is_simulated: whether the time is set from messages.
        simulated_now: simulated time before the first message; 0 if it is unknown.
    """

    def __init__(self, is_simulated: bool, simulated_now: int = 0):
        self.is_simulated = is_simulated
        self._simulated_now = simulated_now
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
