"""Reference of transforms: a buffer of tf2, if it is installed."""

import math
from typing import Any, List, Optional, Tuple

import pytest

tf2_py = pytest.importorskip("tf2_py", reason="tf2 is not installed")
genpy = pytest.importorskip("genpy")
geometry_msgs = pytest.importorskip("geometry_msgs.msg")

from asserting_accessors import compound, items, name_of  # noqa: E402

from retalis import BagReader, Definitions, deref  # noqa: E402


def name(atom: Any) -> str:
    return name_of(atom).strip('"').lstrip("/")


def numbers(term: Any) -> List[Any]:
    return [deref(value) for value in compound(term)[1:]]


def stamp(header: Any) -> List[Any]:
    return [deref(part) for part in items(compound(header)[2])]


class Reference:
    """A tf2 buffer with the /tf messages of a bag, if one is given, without leading slashes of frames."""

    def __init__(self, path: Any = None) -> None:
        self.buffer = tf2_py.BufferCore(genpy.Duration(100_000))
        if path is not None:
            self._add_bag(path)

    def _add_bag(self, path: Any) -> None:
        definitions = Definitions()
        with BagReader(path) as bag:
            for record in bag.records(["/tf"]):
                definition = definitions.add(record.topic.type, record.topic.definition)
                message = definitions.decoder(definition).decode(record.data)
                for transform in items(compound(message)[1]):
                    self._add(compound(transform))

    def _add(self, transform: Tuple[Any, ...]) -> None:
        header = compound(transform[1])
        seconds, nanoseconds = stamp(header)
        translation, rotation = (numbers(part) for part in compound(transform[3])[1:])
        instant = seconds * 10**9 + nanoseconds
        self.add(name(header[3]), name(transform[2]), instant, translation, rotation)

    def add(self, parent: Any, child: Any, instant: Any, translation: Any, rotation: Any) -> None:
        """Add the transform between two frames at an instant (ns)."""
        message = geometry_msgs.TransformStamped()
        message.header.stamp = genpy.Time(*divmod(instant, 10**9))
        message.header.frame_id = parent
        message.child_frame_id = child
        message.transform.translation = geometry_msgs.Vector3(*translation)
        message.transform.rotation = geometry_msgs.Quaternion(*rotation)
        self.buffer.set_transform(message, "test")

    def pose(self, target: Any, source: Any, instant: Any) -> Optional[Tuple[Any, ...]]:
        """Return translation and rotation from source to target at an instant (ns); None outside of the data."""
        try:
            result = self.buffer.lookup_transform_core(target, source, genpy.Time(*divmod(instant, 10**9)))
        except tf2_py.ExtrapolationException:
            return None
        translation, rotation = result.transform.translation, result.transform.rotation
        return (translation.x, translation.y, translation.z), (rotation.x, rotation.y, rotation.z, rotation.w)


def compose(left: Any, right: Any) -> Tuple[Any, ...]:
    """Return the product of two poses (translation, quaternion x y z w)."""
    (t, q), (s, r) = left, right
    x, y, z, w = q
    u = (y * s[2] - z * s[1], z * s[0] - x * s[2], x * s[1] - y * s[0])
    v = (y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0])
    place = tuple(t[i] + s[i] + 2 * (w * u[i] + v[i]) for i in range(3))
    a, b, c, d = r
    turn = (
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
    )
    return place, turn


def distance(left: Any, right: Any) -> float:
    """Return the distance between two points."""
    return math.dist(left, right)


def angle(left: Any, right: Any) -> float:
    """Return the angle between two rotations in radians; their quaternions may have any length and sign."""
    left, right = _normalized(left), _normalized(right)
    # The chord between the unit quaternions q and p has the length 2 sin(angle / 4); q and -q are one rotation.
    chord = min(math.dist(left, right), math.dist(left, [-component for component in right]))
    return 4 * math.asin(min(1.0, chord / 2))


def _normalized(quaternion: Any) -> List[float]:
    length = math.hypot(*quaternion)
    return [component / length for component in quaternion]
