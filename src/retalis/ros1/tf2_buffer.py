"""Transform buffer of nodes: poses are computed by tf2's ``BufferCore``, which is written in C++.

Its Python interface takes times as floats of seconds, which are 2.4e-7 s apart near the present. Times are therefore
passed relative to an origin, a day before the first transform: they keep their nanoseconds for 50 days, and weights
of interpolation are as exact as those of `TransformBuffer`. If a transform is older than the origin, the buffer is
filled again with absolute times.
"""

from bisect import bisect_left, bisect_right
from importlib.util import find_spec
from typing import Any, Callable, Optional

import rospy

from ..events.knowledge.transform_buffer import (
    END_OF_TIME,
    IDENTITY,
    CoordinateFrame,
    TransformBuffer,
)
from ..prolog.builtins.pose_predicates import Pose
from ..prolog.terms.timestamps import SECOND

_AUTHORITY = "retalis"

_MAX_LATE = 86_400 * SECOND
"""Maximum age of a transform relative to the first one, in ns. After an older one, times become absolute."""

_MAX_CACHE_SECONDS = (1 << 31) - 1
"""Longest duration of ROS in seconds."""


class _Seconds(float):
    """A time in the form in which tf2 reads it."""

    __slots__ = ()

    to_sec = float.__float__


_LATEST = _Seconds(0.0)
"""The newest common time."""


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
    """A transform buffer that lets a ``BufferCore`` compute the poses.

    A frame is copied to the ``BufferCore`` from the first look-up that needs it: robots have many frames, and
    programs use few of them. With a frame, all frames above it are copied, and each with all its samples, so the
    ``BufferCore`` gives the answers that it would give with the whole tree. Later samples are copied by the next
    look-up, because those that are dropped from the history before it need not be copied.

    tf2 is imported for the first look-up, because most programs have none.

    Args:
        cache_seconds: history of each frame in seconds.
    """

    def __init__(self, cache_seconds: float):
        super().__init__(cache_seconds)
        self._core: Any = None
        self._lookup_core: Callable[..., Any] = _raise_unknown
        self._error: Any = _NotCopied
        self._origin: Optional[int] = None
        self._offset = 0
        self._message: Any = None

    def clear(self) -> None:
        """Drop all samples except those of static transforms, because the clock went back."""
        super().clear()
        if self._core is not None:
            self._core.clear()
        self._set_origin(None)

    def lookup(self, target: str, source: str, instant: int) -> Optional[Pose]:
        """Return the pose of the source frame in the target frame at an instant; None if there is none."""
        if target == source:
            return IDENTITY
        if self._pending_frames:
            self._copy_pending()
        if instant:
            relative = instant - self._offset
            # At instants up to the origin, and beyond the end of ROS time, only static transforms hold.
            if not 0 < relative < END_OF_TIME:
                relative = 1 if relative < 1 else END_OF_TIME - 1
            time = _Seconds(relative / 1e9)
        else:
            time = _LATEST
        try:
            transform = self._lookup_core(target, source, time).transform
        except self._error:
            # The frames may not have been copied to tf2. Then they are copied, and the look-up is repeated once.
            return self.lookup(target, source, instant) if self._start_copying(target, source) else None
        translation, rotation = transform.translation, transform.rotation
        return (
            (translation.x, translation.y, translation.z),
            (rotation.x, rotation.y, rotation.z, rotation.w),
        )

    def _start_copying(self, *names: str) -> bool:
        """Copy frames from now on, with those above them; return whether any was not copied before."""
        frames = [self._frames[name] for name in names if name in self._frames]
        if all(frame.is_copied for frame in frames):
            return False
        if self._core is None:
            self._create_core()
        for frame in frames:
            self._mark_copied(frame)
        return True

    def _create_core(self) -> None:
        import tf2_py  # noqa: PLC0415 - an optional package, which takes time to import

        seconds = min(self.cache / SECOND, _MAX_CACHE_SECONDS)
        self._core = tf2_py.BufferCore(rospy.Duration.from_sec(seconds))
        self._lookup_core = self._core.lookup_transform_core
        self._error = tf2_py.TransformException
        # One object, which is filled for every transform.
        self._message = _TransformStamped()

    def _set_origin(self, origin: Optional[int]) -> None:
        self._origin = origin
        self._offset = origin or 0

    def _refill(self, origin: Optional[int]) -> None:
        """Copy all samples again, with times relative to an origin."""
        self._core.clear()
        self._set_origin(origin)
        for frame in self.frames():
            frame.copied_until = -1
            if frame.is_copied:
                self._pending_frames[frame] = None
        self._copy_pending()

    def _copy_pending(self) -> None:
        """Copy the samples of the pending frames that have not been copied."""
        while self._pending_frames:
            frame, _ = self._pending_frames.popitem()
            stamps = frame.stamps
            if frame.is_static:
                self._set_transforms(frame, 0, len(stamps))
            else:
                first = bisect_right(stamps, frame.copied_until, frame.first)
                if first < len(stamps):
                    frame.copied_until = stamps[-1]
                    self._set_transforms(frame, first, len(stamps))
        self._pending_count = 0

    def _copy_inserted(self, frame: CoordinateFrame, instant: int) -> None:
        """Copy a sample that has been inserted between samples that were copied."""
        position = bisect_left(frame.stamps, instant, frame.first)
        self._set_transforms(frame, position, position + 1)

    def _set_transforms(self, frame: CoordinateFrame, first: int, end: int) -> None:
        """Store the samples at positions from ``first`` up to ``end``, which is excluded, in the ``BufferCore``."""
        start = frame.stamps[first]
        if frame.is_static:
            # The time has no meaning.
            offset, set_transform = start, self._core.set_transform_static
        else:
            if self._origin is None:
                self._set_origin(max(0, start // SECOND * SECOND - _MAX_LATE))
            elif start <= self._origin and self._origin:
                # The samples are among those that are copied again.
                self._refill(0)
                return
            offset, set_transform = self._offset, self._core.set_transform
        message = self._message
        header, transform = message.header, message.transform
        translation, rotation = transform.translation, transform.rotation
        message.child_frame_id = _tf2_name(frame.name)
        parent: Optional[CoordinateFrame] = None
        for position in range(first, end):
            if frame.parents[position] is not parent:
                parent = frame.parents[position]
                header.frame_id = _tf2_name(parent.name)
            header.stamp = _Seconds((frame.stamps[position] - offset) / 1e9)
            translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z, rotation.w = (
                frame.poses[position]
            )
            set_transform(message, _AUTHORITY)


def _tf2_name(name: str) -> str:
    """Return the name of a frame for tf2, which removes one leading slash."""
    return f"/{name}" if name[:1] == "/" else name


class _NotCopied(Exception):
    """Raised by the look-up before the first frame is copied."""


def _raise_unknown(target: str, source: str, time: float) -> Any:
    raise _NotCopied


def choose_buffer() -> Callable[[float], TransformBuffer]:
    """Return the class of the buffer for this machine: `Tf2Buffer` if tf2_py is installed."""
    return TransformBuffer if find_spec("tf2_py") is None else Tf2Buffer
