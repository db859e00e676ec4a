"""Transform buffer of nodes: poses are computed by tf2's ``BufferCore``, which is written in C++.

Its Python interface takes times as floats of seconds, which are 2.4e-7 s apart near the present. Times are therefore
passed relative to an origin, a day before the first transform: they keep their nanoseconds for 50 days, and weights
of interpolation are as exact as those of `TransformBuffer`. If a transform is older than the origin, the buffer is
filled again with absolute times.
"""

from importlib.util import find_spec
from typing import Any, Callable, Optional

import rospy

from ..events.knowledge.transform_buffer import (
    END_OF_TIME,
    CoordinateFrame,
    Numbers,
    TransformBuffer,
)
from ..prolog.builtins.pose_predicates import Pose
from ..prolog.terms.timestamps import SECOND

_AUTHORITY = "retalis"

_MAX_LATE = 86_400 * SECOND
"""Time before the first transform that others may have, in nanoseconds, before times become absolute."""

_MAX_CACHE_SECONDS = (1 << 31) - 1
"""Longest duration of ROS in seconds."""


class _Seconds(float):
    """A time in the form in which tf2 reads it."""

    __slots__ = ()

    to_sec = float.__float__


class _HeaderSlots:
    __slots__ = ("stamp", "frame_id")

    def __init__(self) -> None:
        self.stamp = _Seconds()
        self.frame_id = ""


class _TransformSlots:
    __slots__ = ("translation", "rotation")

    def __init__(self) -> None:
        # tf2 warns about other classes of these two.
        from geometry_msgs.msg import Quaternion, Vector3  # noqa: PLC0415 - an optional package, as tf2_py

        self.translation: Any = Vector3()
        self.rotation: Any = Quaternion()


class _TransformStamped:
    """A ``geometry_msgs/TransformStamped``: a message of genpy for each transform takes longer than storing it."""

    __slots__ = ("header", "child_frame_id", "transform")

    def __init__(self) -> None:
        self.header = _HeaderSlots()
        self.child_frame_id = ""
        self.transform = _TransformSlots()


class Tf2Buffer(TransformBuffer):
    """A transform buffer whose poses are in a ``BufferCore``.

    tf2 is imported for the first transform: most programs read none.

    Args:
        cache_seconds: history of each frame in seconds.
    """

    def __init__(self, cache_seconds: float):
        super().__init__(cache_seconds)
        self._core: Any = None
        self._error: Any = None
        self._origin: Optional[int] = None
        self._message: Any = None

    def _create_core(self) -> None:
        import tf2_py  # noqa: PLC0415 - an optional package, which takes time to import

        seconds = min(self.cache / SECOND, _MAX_CACHE_SECONDS)
        self._core = tf2_py.BufferCore(rospy.Duration.from_sec(seconds))
        self._error = tf2_py.TransformException
        # One object, which is filled for every transform.
        self._message = _TransformStamped()

    def clear(self) -> None:
        """Drop all samples except those of static transforms, because the clock went back."""
        super().clear()
        if self._core is not None:
            self._core.clear()
        self._origin = None

    def repair(self) -> None:
        """Repair the samples after an interrupt."""
        super().repair()
        if self._core is not None:
            self._core.clear()
            self._fill(self._origin)

    def _fill(self, origin: Optional[int]) -> None:
        """Store all samples again, with times relative to an origin."""
        self._origin = origin
        for frame in self.frames():
            for position in range(frame.first, len(frame.stamps)):
                parent, instant = frame.parents[position].name, frame.stamps[position]
                self._store_pose(frame, parent, instant, frame.poses[position])

    def _store_pose(self, frame: CoordinateFrame, parent: str, instant: int, numbers: Numbers) -> None:
        if self._core is None:
            self._create_core()
        seconds = 0.0
        if not frame.is_static:
            origin = self._origin
            if origin is None:
                origin = self._origin = max(0, instant // SECOND * SECOND - _MAX_LATE)
            elif instant <= origin and origin:
                self._core.clear()
                self._fill(0)
                origin = 0
            seconds = (instant - origin) / 1e9
        message = self._message
        header, transform = message.header, message.transform
        header.stamp = _Seconds(seconds)
        # tf2 removes one leading slash, as `store` has done.
        header.frame_id = f"/{parent}" if parent[:1] == "/" else parent
        child = frame.name
        message.child_frame_id = f"/{child}" if child[:1] == "/" else child
        translation, rotation = transform.translation, transform.rotation
        translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z, rotation.w = numbers
        if frame.is_static:
            self._core.set_transform_static(message, _AUTHORITY)
        else:
            self._core.set_transform(message, _AUTHORITY)

    def _find_pose(self, target: str, source: str, instant: int) -> Optional[Pose]:
        if self._core is None:
            return None
        if instant:
            # Only static transforms hold at instants that are not after the origin, or after the end of ROS time.
            instant = min(max(instant - (self._origin or 0), 1), END_OF_TIME - 1)
        try:
            transform = self._core.lookup_transform_core(target, source, _Seconds(instant / 1e9)).transform
        except self._error:
            return None
        translation, rotation = transform.translation, transform.rotation
        return (
            (translation.x, translation.y, translation.z),
            (rotation.x, rotation.y, rotation.z, rotation.w),
        )


def choose_buffer() -> Callable[[float], TransformBuffer]:
    """Return the class of the buffer for this machine: `Tf2Buffer` if tf2_py is installed."""
    return TransformBuffer if find_spec("tf2_py") is None else Tf2Buffer
