"""Transform buffer: a tree of coordinate frames with a bounded history of the transform of each frame to its parent.

The answers are those of tf2's ``BufferCore`` (http://wiki.ros.org/tf2): each frame has one parent at an instant, and
a look-up multiplies the transforms from the source frame up to the root, and the inverse of those from the target
frame. A frame's transform at an instant between two samples is interpolated: positions linearly, rotations by slerp.
Before the first and after the last sample there is no transform. If the two samples have different parents, the
earlier one holds until the later one. Static transforms hold at every instant. The instant 0 stands for the newest
instant at which all frames of the path have transforms.

`TransformBuffer` computes in Python. A subclass may override `lookup` to let other code compute the poses. All
samples are stored here in any case, for errors, gaps, counts, and waiting queries. A frame with new samples that the
other code needs (`CoordinateFrame.is_copied`) is added to `_pending_frames`, and the next look-up copies the samples.

A query that waits for a transform is registered with a frame of the path that has no sample at the instant yet
(`find_blocking`). Each `CoordinateFrame` is therefore a `QueryQueue` of the queries that need its next samples.
Queries about frames that are unknown or not connected are registered with `TransformBuffer.topology`.
"""

from bisect import bisect_left, bisect_right
from itertools import islice
from math import acos, sin, sqrt
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Tuple, Union

from ...foundation.displayed_text import format_number
from ...prolog.builtins.pose_predicates import Pose, compose
from ...prolog.terms.timestamps import SECOND
from .memory import QueryQueue

DEFAULT_CACHE_SECONDS = 10.0
"""History of each frame in seconds, as in tf2."""

MAX_FRAMES = 10_000
"""Maximum number of frames; transforms of further frames are refused."""

MAX_SAMPLES = 500_000
"""Maximum number of samples of all frames; further ones are refused."""

MAX_NAME_LENGTH = 256
"""Maximum length of the name of a frame."""

END_OF_TIME = SECOND << 32
"""End of the range of ROS time in nanoseconds."""

MAX_TREE_DEPTH = 1000
"""Maximum number of frames between a frame and the root; longer paths are loops, as in tf2."""

NORM_TOLERANCE = 0.01
"""Largest deviation of a rotation's squared length from 1, as in tf2."""

Numbers = Tuple[float, float, float, float, float, float, float]
"""Position x, y, z in metres, and rotation x, y, z, w."""

Transform = Tuple[str, str, int, Numbers]
"""Parent, child, instant in nanoseconds, and the pose of the child in the frame of the parent."""

IDENTITY: Pose = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)

_MAX_PENDING_SAMPLES = 10_000
"""Maximum number of samples that are stored before they are copied, which bounds the time of the next look-up."""

_TRIM_LENGTH = 256
"""Number of dropped samples from which on lists are cut, if at least half of their samples are dropped."""

_NEVER = 1 << 100
"""An instant after all others."""

REPEATED = "it has a transform of that instant already"
"""Refusal of a second sample of one instant. Publishers repeat transforms, so this is no reason for a warning."""


class CoordinateFrame(QueryQueue):
    """A frame, the samples of its transform to its parent, and the queries that need further ones.

    The lists are ordered by instant. Only the entries from `first` on count.

    Attributes:
        is_child: whether it ever had a transform; otherwise it is known as a parent only.
        is_static: whether its transform holds at every instant; then it has one sample.
        first: position of the earliest sample.
        stamps: stamps of the samples in nanoseconds.
        is_copied: whether other code needs the samples, too.
        copied_until: instant of the last sample that has been copied; -1 if there is none.
    """

    __slots__ = (
        "name",
        "is_child",
        "is_static",
        "first",
        "stamps",
        "parents",
        "poses",
        "is_copied",
        "copied_until",
    )

    def __init__(self, name: str):
        super().__init__()
        self.name = name
        self.is_child = False
        self.is_static = False
        self.is_copied = False
        self.copied_until = -1
        self.first = 0
        self.stamps: List[int] = []
        self.parents: List[CoordinateFrame] = []
        self.poses: List[Numbers] = []

    @property
    def sample_count(self) -> int:
        """Number of samples."""
        return len(self.stamps) - self.first

    @property
    def earliest(self) -> int:
        """Instant of the earliest sample, which must exist."""
        return self.stamps[self.first]

    def position_at(self, instant: int) -> int:
        """Return the position of the last sample at an instant or before; -1 if that requires extrapolation."""
        if self.is_static:
            return 0
        stamps = self.stamps
        last = len(stamps) - 1
        if last < self.first:
            return -1
        if not instant or stamps[last] == instant:
            return last
        position = bisect_right(stamps, instant, self.first) - 1
        return position if self.first <= position < last else -1

    def assumed_parent(self, instant: int) -> "Optional[CoordinateFrame]":
        """Return the parent at an instant, or that of the nearest sample; None without samples."""
        if self.is_static:
            return self.parents[0]
        count = len(self.stamps)
        if count <= self.first:
            return None
        if not instant:
            return self.parents[count - 1]
        position = bisect_right(self.stamps, instant, self.first) - 1
        return self.parents[max(position, self.first)]

    def has_reached(self, instant: int) -> bool:
        """Return whether there is a sample at an instant or later, or the transform is static."""
        stamps = self.stamps
        return self.is_static or (len(stamps) > self.first and stamps[-1] >= instant)

    def gap_at(self, position: int, instant: int) -> int:
        """Return the distance in nanoseconds of the two samples around an instant; 0 at a sample."""
        stamps = self.stamps
        if self.is_static or not instant or stamps[position] == instant:
            return 0
        return stamps[position + 1] - stamps[position]

    def pose_at(self, position: int, instant: int) -> Pose:
        """Return the transform at an instant, given the position of the last sample before."""
        pose = _to_pose(self.poses[position])
        if self.is_static or not instant:
            return pose
        start = self.stamps[position]
        if start == instant or self.parents[position] is not self.parents[position + 1]:
            return pose
        ratio = (instant - start) / (self.stamps[position + 1] - start)
        return _interpolate(self.poses[position], self.poses[position + 1], ratio)

    def has_sample_at(self, instant: int) -> bool:
        """Return whether there is a sample of an instant, which is not after the last one."""
        return self.stamps[bisect_left(self.stamps, instant, self.first)] == instant

    def insert(self, instant: int, parent: "CoordinateFrame", pose: Numbers) -> None:
        """Insert a sample before the last one, of an instant that has none."""
        position = bisect_left(self.stamps, instant, self.first)
        self.poses.insert(position, pose)
        self.parents.insert(position, parent)
        self.stamps.insert(position, instant)

    def replace(self, instant: int, parent: "CoordinateFrame", pose: Numbers) -> None:
        """Set the only sample of a static transform."""
        self.poses, self.parents, self.stamps = [pose], [parent], [instant]

    def trim(self, oldest: int) -> int:
        """Drop the samples before an instant, but keep the last sample; return the number of dropped samples."""
        stamps = self.stamps
        first = bisect_left(stamps, oldest, self.first)
        dropped = first - self.first
        self.first = first
        if first >= _TRIM_LENGTH and 2 * first >= len(stamps):
            del self.poses[:first], self.parents[:first], stamps[:first]
            self.first = 0
        return dropped

    def clear(self) -> int:
        """Drop all samples, unless the transform is static; return their number."""
        if self.is_static:
            return 0
        count = self.sample_count
        self.poses, self.parents, self.stamps, self.first = [], [], [], 0
        self.copied_until = -1
        return count


class TransformFault(NamedTuple):
    """The reason why there is no transform.

    Attributes:
        kind: ``invalid`` (a frame's name), ``unknown`` (a frame), ``unconnected`` (two frames), ``loop`` (of the
            tree), ``before`` the first or ``after`` the last sample of a frame.
        frame: name of the frame.
        other_frame: name of the other frame, if two are not connected.
        instant: instant in nanoseconds of the frame's first or last sample; None if it has none.
    """

    kind: str
    frame: str
    other_frame: str = ""
    instant: Optional[int] = None


Link = Tuple[CoordinateFrame, int]
"""A frame of a path, and the position of its sample."""


class FramePath(NamedTuple):
    """The path between two frames in the tree at an instant.

    Attributes:
        up: the links from the source frame.
        down: the links from the target frame, up to the same frame.
        instant: the instant; the newest common one if that was asked for, 0 if all links are static then.
    """

    up: List[Link]
    down: List[Link]
    instant: int


class TransformBuffer:
    """A tree of frames; not thread-safe.

    Args:
        cache_seconds: history of each frame in seconds.

    Attributes:
        topology: queue of the queries about frames that are unknown or not connected.
        sample_count: number of samples.
        refused: number of transforms that were refused, without repetitions.
        version: increases with each change.
        topology_version: increases if a frame gets its first sample, or another parent.
    """

    def __init__(self, cache_seconds: float = DEFAULT_CACHE_SECONDS):
        self.cache = round(cache_seconds * SECOND)
        self._frames: Dict[str, CoordinateFrame] = {}
        self.topology = CoordinateFrame("")
        self.sample_count = 0
        self.refused = 0
        self.version = 0
        self.topology_version = 0
        self._pending_frames: Dict[CoordinateFrame, None] = {}
        self._pending_count = 0

    def __len__(self) -> int:
        return len(self._frames)

    def knows(self, name: str) -> bool:
        """Return whether there is a frame with a name."""
        return name in self._frames

    def frames(self) -> Iterator[CoordinateFrame]:
        """Yield all frames."""
        return iter(list(self._frames.values()))

    def names(self) -> List[str]:
        """Return the names of all frames."""
        return list(self._frames)

    def clear(self) -> None:
        """Drop all samples except those of static transforms, because the clock went back."""
        self.version += 1
        for frame in self._frames.values():
            self.sample_count -= frame.clear()

    def store(  # noqa: C901 - on the path of every transform
        self, parent: str, child: str, instant: int, numbers: Numbers, is_static: bool = False
    ) -> Union[CoordinateFrame, str]:
        """Store a transform; return the frame of the child, or the reason why it is refused.

        Whether a frame is static is decided by its first transform, as in tf2.

        Args:
            parent: name of the parent frame, without the slash that tf2 removes.
            child: name of the child frame, without the slash that tf2 removes.
            instant: the instant in nanoseconds.
            numbers: pose of the child in the frame of the parent.
            is_static: whether the transform holds at every instant.
        """
        x, y, z, i, j, k, w = numbers
        # Comparisons with nan are false.
        if (
            not -NORM_TOLERANCE < i * i + j * j + k * k + w * w - 1.0 < NORM_TOLERANCE
            or not (x == x and y == y and z == z)  # noqa: PLR0124
            or child == parent
            or not 0 <= instant < END_OF_TIME
        ):
            return self._refuse(parent, child, instant, numbers)
        frame = self._frames.get(child)
        if frame is None:
            if not child or not parent or self._is_name_refused(child):
                return self._refuse(parent, child, instant, numbers)
            frame = CoordinateFrame(child)
        stamps = frame.stamps
        has_samples = len(stamps) > frame.first
        if has_samples and frame.parents[-1].name == parent:
            parent_frame: Any = frame.parents[-1]
        else:
            parent_frame = self._find_parent(parent)
            if parent_frame is None:
                return self._refuse(parent, child, instant, numbers)
            self.topology_version += 1
            if frame.is_copied:
                self._mark_copied(parent_frame)
        if not frame.is_child:
            self._frames[child] = frame
            frame.is_child, frame.is_static = True, is_static
        if frame.is_static:
            self.sample_count += not has_samples
            frame.replace(instant, parent_frame, numbers)
            if frame.is_copied:
                self._pending_frames[frame] = None
        else:
            is_newest = not has_samples or instant > stamps[-1]
            if not is_newest:
                if instant < stamps[-1] - self.cache:
                    self.refused += 1
                    return f"it is older than the history of {format_number(self.cache / SECOND)} s"
                if frame.has_sample_at(instant):
                    return REPEATED
            if self.sample_count >= MAX_SAMPLES and not self._make_room(frame, instant):
                self.refused += 1
                return f"there are {MAX_SAMPLES} transforms already"
            self.sample_count += 1
            if is_newest:
                frame.poses.append(numbers)
                frame.parents.append(parent_frame)
                stamps.append(instant)
                if stamps[frame.first] < instant - self.cache:
                    self.sample_count -= frame.trim(instant - self.cache)
                if frame.is_copied:
                    self._pending_frames[frame] = None
                    self._pending_count += 1
                    if self._pending_count > _MAX_PENDING_SAMPLES:
                        self._copy_pending()
            else:
                frame.insert(instant, parent_frame, numbers)
                # Later ones are copied with the samples around them.
                if instant < frame.copied_until:
                    self._copy_inserted(frame, instant)
        self.version += 1
        return frame

    def lookup(self, target: str, source: str, instant: int) -> Optional[Pose]:
        """Return the pose of the source frame in the target frame at an instant; None if there is none."""
        return IDENTITY if target == source else self._find_pose(target, source, instant)

    def find_fault(self, target: str, source: str, instant: int) -> Optional[TransformFault]:
        """Return the reason why there is no transform; None if there is one."""
        if target == source:
            return None
        path = self.path(target, source, instant)
        return path if isinstance(path, TransformFault) else None

    def latest_common(self, target: str, source: str) -> Union[int, TransformFault]:
        """Return the newest instant with transforms of all frames of the path, 0 if all are static."""
        target_frame = self._find_frame(target)
        if isinstance(target_frame, TransformFault):
            return target_frame
        source_frame = self._find_frame(source)
        if isinstance(source_frame, TransformFault):
            return source_frame
        return self._latest_common(target_frame, source_frame)

    def path(  # noqa: C901 - the steps of tf2, in its order
        self, target: str, source: str, instant: int
    ) -> Union[FramePath, TransformFault]:
        """Return the path between two frames at an instant, or the reason why there is none.

        The order of the steps, and therefore the reason, is that of tf2: the path from the source frame up ends at
        the first frame without a transform, and the path from the target frame up must lead to it.
        """
        target_frame = self._find_frame(target)
        if isinstance(target_frame, TransformFault):
            return target_frame
        source_frame = self._find_frame(source)
        if isinstance(source_frame, TransformFault):
            return source_frame
        if not instant:
            latest = self._latest_common(target_frame, source_frame)
            if isinstance(latest, TransformFault):
                return latest
            instant = latest
        up: List[Link] = []
        fault: Optional[TransformFault] = None
        top = source_frame
        while top is not target_frame and top.is_child:
            position = top.position_at(instant)
            if position < 0:
                fault = _extrapolation_fault(top, instant)
                break
            up.append((top, position))
            top = top.parents[position]
            if len(up) > MAX_TREE_DEPTH:
                return TransformFault("loop", source)
        down: List[Link] = []
        frame = target_frame
        while frame is not top:
            if not frame.is_child:
                return fault or TransformFault("unconnected", target, source)
            position = frame.position_at(instant)
            if position < 0:
                return _extrapolation_fault(frame, instant)
            if frame is source_frame:
                return FramePath([], down, instant)
            down.append((frame, position))
            frame = frame.parents[position]
            if len(down) > MAX_TREE_DEPTH:
                return TransformFault("loop", target)
        return FramePath(up, down, instant)

    def widest_gap(self, target: str, source: str, instant: int) -> Tuple[int, str]:
        """Return the largest distance of two samples that a look-up interpolates between, and the frame.

        Without a transform, the distance is 0.
        """
        path = self.path(target, source, instant) if target != source else None
        if path is None or isinstance(path, TransformFault):
            return 0, ""
        # Above the first common frame, both paths have the same links, which cancel out.
        in_both = {frame for frame, _ in path.up} & {frame for frame, _ in path.down}
        gaps = [
            (frame.gap_at(position, path.instant), frame.name)
            for frame, position in (*path.up, *path.down)
            if frame not in in_both
        ]
        return max(gaps, default=(0, ""))

    def find_blocking(self, target: str, source: str, instant: int) -> Optional[CoordinateFrame]:
        """Return the frame whose samples a query for a transform waits for.

        This is the first frame of the path whose last sample is before the instant, or `topology` if there is no
        path. A frame without a sample at the instant is assumed to have the parent of its nearest sample.

        Returns:
            The frame; None if all frames of the path have reached the instant.
        """
        if target == source:
            return None
        target_frame, source_frame = self._frames.get(target), self._frames.get(source)
        if target_frame is None or source_frame is None:
            return self.topology
        up = _distances_to_ancestors(source_frame, instant)
        down: List[CoordinateFrame] = []
        for frame in _distances_to_ancestors(target_frame, instant):
            if frame in up:
                links = (*islice(up, up[frame]), *down)
                behind = next((link for link in links if not link.has_reached(instant)), None)
                # In a loop of frames, another path may lead from one to the other.
                return behind if behind is None or self.find_fault(target, source, instant) else None
            down.append(frame)
        return self.topology

    def _latest_common(  # noqa: C901 - the steps of tf2, in its order
        self, target: CoordinateFrame, source: CoordinateFrame
    ) -> Union[int, TransformFault]:
        """Return the newest instant that all frames of the path have reached, as tf2 determines it."""
        if target is source:
            return _newest_instant(source)
        up: List[Tuple[int, CoordinateFrame]] = []
        frame, common = source, _NEVER
        while frame.sample_count:
            parent = frame.parents[-1]
            common = min(common, _newest_instant(frame) or _NEVER)
            up.append((_newest_instant(frame), parent))
            frame = parent
            if frame is target:
                return 0 if common == _NEVER else common
            if len(up) > MAX_TREE_DEPTH:
                return TransformFault("loop", source.name)
        frame, common, steps = target, _NEVER, 0
        ancestors = {parent for _, parent in up}
        while frame.sample_count:
            common = min(common, _newest_instant(frame) or _NEVER)
            frame = frame.parents[-1]
            if frame in ancestors:
                break
            if frame is source:
                return 0 if common == _NEVER else common
            steps += 1
            if steps > MAX_TREE_DEPTH:
                return TransformFault("loop", target.name)
        else:
            return TransformFault("unconnected", target.name, source.name)
        for newest, parent in up:
            common = min(common, newest or _NEVER)
            if parent is frame:
                break
        return 0 if common == _NEVER else common

    def _find_frame(self, name: str) -> Union[CoordinateFrame, TransformFault]:
        """Return the frame of a name, or the fault of a name that is invalid or unknown."""
        if not name or name[0] == "/":
            return TransformFault("invalid", name)
        return self._frames.get(name) or TransformFault("unknown", name)

    def _find_parent(self, name: str) -> Optional[CoordinateFrame]:
        """Return the frame of a parent, which may be new; None if it is refused."""
        frame = self._frames.get(name)
        if frame is None and name and not self._is_name_refused(name):
            frame = self._frames[name] = CoordinateFrame(name)
        return frame

    def _is_name_refused(self, name: str) -> bool:
        return len(name) > MAX_NAME_LENGTH or len(self._frames) >= MAX_FRAMES

    def _make_room(self, frame: CoordinateFrame, instant: int) -> bool:
        """Drop the samples of a frame that a new one makes too old; return whether there is room for it."""
        if frame.sample_count and instant > frame.stamps[-1]:
            while frame.sample_count and frame.earliest < instant - self.cache:
                frame.first += 1
                self.sample_count -= 1
        return self.sample_count < MAX_SAMPLES

    def _refuse(self, parent: str, child: str, instant: int, numbers: Numbers) -> str:
        self.refused += 1
        return self.refusal(parent, child, instant, numbers)

    def refusal(self, parent: str, child: str, instant: int, numbers: Numbers) -> str:
        """Return the reason why a transform is refused whatever the buffer contains; "" if there is none."""
        if child == parent:
            return "a frame cannot be its own parent"
        if not child or not parent:
            return "the name of the frame or of its parent is empty"
        if any(value != value for value in numbers):  # noqa: PLR0124 - nan
            return "it contains nan"
        if not 0 <= instant < END_OF_TIME:
            return "its time is not one of ROS, which are from 1970 to 2106"
        if not abs(sum(value * value for value in numbers[3:]) - 1.0) < NORM_TOLERANCE:
            return f"its rotation {list(numbers[3:])} does not have length 1"
        if max(len(child), len(parent)) > MAX_NAME_LENGTH:
            return f"names of frames have at most {MAX_NAME_LENGTH} characters"
        if len(self._frames) + sum(name not in self._frames for name in (child, parent)) > MAX_FRAMES:
            return f"there are {MAX_FRAMES} frames already"
        return ""

    # Samples for other code

    def _mark_copied(self, frame: CoordinateFrame) -> None:
        """Let the next look-up, and those after it, copy the samples of a frame and of those above it."""
        stack = [frame]
        while stack:
            frame = stack.pop()
            if not frame.is_copied:
                frame.is_copied = True
                self._pending_frames[frame] = None
                stack += frame.parents

    def _copy_pending(self) -> None:
        """Copy the samples of the pending frames that have not been copied."""

    def _copy_inserted(self, frame: CoordinateFrame, instant: int) -> None:
        """Copy a sample that has been inserted between samples that were copied."""

    # Computation of poses

    def _find_pose(self, target: str, source: str, instant: int) -> Optional[Pose]:
        """Return the pose of a frame in another one; None if there is none."""
        path = self.path(target, source, instant)
        if isinstance(path, TransformFault):
            return None
        up, down, instant = path
        if not down:
            return _compose_links(up, instant)
        # The inverse of the target's path: its rotation is the conjugate, as rotations have length 1.
        (x, y, z), (i, j, k, w) = _compose_links(down, instant)
        rotation = -i, -j, -k, w
        inverse = compose((IDENTITY[0], rotation), ((-x, -y, -z), IDENTITY[1]))[0], rotation
        return compose(inverse, _compose_links(up, instant)) if up else inverse


def _newest_instant(frame: CoordinateFrame) -> int:
    """Return the instant of a frame's last sample; 0 for static frames and frames without samples."""
    return frame.stamps[-1] if frame.sample_count and not frame.is_static else 0


def _extrapolation_fault(frame: CoordinateFrame, instant: int) -> TransformFault:
    """Return the fault of a frame that has no transform at an instant."""
    if not frame.sample_count:
        return TransformFault("after", frame.name)
    if instant < frame.earliest:
        return TransformFault("before", frame.name, "", frame.earliest)
    return TransformFault("after", frame.name, "", frame.stamps[-1])


def _distances_to_ancestors(frame: CoordinateFrame, instant: int) -> Dict[CoordinateFrame, int]:
    """Return a frame and its known ancestors at an instant, with their distances from it in links.

    In a loop, each frame is visited once.
    """
    distances = {frame: 0}
    parent = frame.assumed_parent(instant) if frame.is_child else None
    while parent is not None and parent not in distances:
        distances[parent] = len(distances)
        parent = parent.assumed_parent(instant) if parent.is_child else None
    return distances


def _to_pose(numbers: Numbers) -> Pose:
    return numbers[:3], numbers[3:]


def _interpolate(first: Numbers, second: Numbers, ratio: float) -> Pose:
    """Return the pose that is interpolated between two poses.

    Rotations that are equal up to rounding are not interpolated, in contrast to `pose_predicates.interpolate`: tf2
    returns the first one, and the results must be equal.
    """
    ax, ay, az, ai, aj, ak, aw = first
    bx, by, bz, bi, bj, bk, bw = second
    complement = 1.0 - ratio
    position = complement * ax + ratio * bx, complement * ay + ratio * by, complement * az + ratio * bz
    dot = ai * bi + aj * bj + ak * bk + aw * bw
    norm_product = sqrt((ai * ai + aj * aj + ak * ak + aw * aw) * (bi * bi + bj * bj + bk * bk + bw * bw))
    cosine = abs(dot) / norm_product
    # Equal up to rounding: the sine would be zero.
    angle = acos(cosine) if cosine < 1.0 else 0.0
    if not angle:
        return position, (ai, aj, ak, aw)
    scale = 1.0 / sin(angle)
    first_factor, second_factor = sin(complement * angle) * scale, sin(ratio * angle) * scale
    # q and -q are the same rotation; the negative one of them is on the shorter arc.
    if dot < 0:
        second_factor = -second_factor
    return position, (
        ai * first_factor + bi * second_factor,
        aj * first_factor + bj * second_factor,
        ak * first_factor + bk * second_factor,
        aw * first_factor + bw * second_factor,
    )


def _compose_links(links: List[Link], instant: int) -> Pose:
    """Return the pose of the first frame of a path in the frame above the last one."""
    product: Optional[Pose] = None
    for frame, position in links:
        pose = frame.pose_at(position, instant)
        product = pose if product is None else compose(pose, product)
    return IDENTITY if product is None else product
