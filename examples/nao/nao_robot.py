"""A simulated NAO: poses of its links at any time, and markers around it.

Poses are pairs of a position (x, y, z) in metres and a quaternion (x, y, z, w); times are seconds since the
start.
"""

from math import cos, pi, sin, sqrt
from random import Random
from typing import Callable, Dict, List, NamedTuple, Tuple

Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]
Pose = Tuple[Vector, Quaternion]

IDENTITY: Pose = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


class Link(NamedTuple):
    """A transform of ``tf``: two frames, the rate in Hz, and a function from the time to the pose of the child."""

    parent: str
    child: str
    rate: float
    pose: Callable[[float], Pose]


CHAIN = (
    ("/odom", "/base_link", 10.0),
    ("base_link", "torso", 50.0),
    ("torso", "Neck", 10.0),
    ("Neck", "Head", 10.0),
    ("Head", "CameraTop_frame", 50.0),
)
"""Links from the world to the camera, with the names of the robot: only the first has leading slashes."""

MARKERS = tuple(f"4x4_{number}" for number in range(1, 9))

_LIMBS = {
    "LArm": ("LShoulder", "LBicep", "LElbow", "LForeArm", "l_wrist", "l_gripper"),
    "RArm": ("RShoulder", "RBicep", "RElbow", "RForeArm", "r_wrist", "r_gripper"),
    "LLeg": ("LPelvis", "LHip", "LThigh", "LTibia", "LAnklePitch", "l_ankle", "l_sole"),
    "RLeg": ("RPelvis", "RHip", "RThigh", "RTibia", "RAnklePitch", "r_ankle", "r_sole"),
}
_FIXTURES = (
    ("Head", "CameraBottom_frame"),
    ("Head", "gaze"),
    ("Head", "LeftEar_frame"),
    ("Head", "RightEar_frame"),
    ("torso", "ImuTorsoAccelerometer_frame"),
    ("torso", "ImuTorsoGyrometer_frame"),
    ("torso", "Sonar_left_frame"),
    ("torso", "Sonar_right_frame"),
    ("torso", "ChestButton_frame"),
)
_SLOW = (("base_link", "base_footprint", 12.0), ("torso", "Battery_frame", 8.0))


def multiply(left: Quaternion, right: Quaternion) -> Quaternion:
    """Return the rotation ``right`` followed by ``left``."""
    x1, y1, z1, w1 = left
    x2, y2, z2, w2 = right
    return (
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    )


def rotate(rotation: Quaternion, point: Vector) -> Vector:
    """Return a point turned by a rotation."""
    x, y, z, w = rotation
    turned = multiply(multiply(rotation, (*point, 0.0)), (-x, -y, -z, w))
    return turned[:3]


def compose(left: Pose, right: Pose) -> Pose:
    """Return the pose ``right``, given in the frame ``left``, in the frame that ``left`` is given in."""
    (x, y, z), rotation = left
    dx, dy, dz = rotate(rotation, right[0])
    return (x + dx, y + dy, z + dz), multiply(rotation, right[1])


def inverse(pose: Pose) -> Pose:
    """Return the inverse of a pose."""
    (px, py, pz), (x, y, z, w) = pose
    back = (-x, -y, -z, w)
    return rotate(back, (-px, -py, -pz)), back


def from_angles(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation by roll, pitch and yaw in radians (about fixed x, y, z), with w not negative."""
    turned = multiply(
        (0.0, 0.0, sin(yaw / 2), cos(yaw / 2)),
        multiply((0.0, sin(pitch / 2), 0.0, cos(pitch / 2)), (sin(roll / 2), 0.0, 0.0, cos(roll / 2))),
    )
    return turned if turned[3] >= 0 else tuple(-part for part in turned)  # type: ignore[return-value]


class Robot:
    """A NAO that walks in a circle, sways with its steps and turns its head, and the markers around it.

    Attributes:
        chain: the five links from ``/odom`` to ``CameraTop_frame``.
        filler: the other links, until there are 1,900 transforms a second.
        markers: the poses of the markers in the world, by name.
    """

    def __init__(self, seed: int):
        random = Random(f"robot {seed}")
        phase = [random.uniform(0, 2 * pi) for _ in range(6)]
        motions = (_walk(phase[0]), _sway(phase[1]), _neck(phase[2]), _head(phase[3]), _camera(phase[4]))
        self.chain: List[Link] = [Link(*names, motion) for names, motion in zip(CHAIN, motions)]
        self.filler: List[Link] = _filler(random)
        self.markers: Dict[str, Pose] = _markers(random)

    def camera(self, time: float) -> Pose:
        """Return the true pose of the camera in the world."""
        pose = IDENTITY
        for link in self.chain:
            pose = compose(pose, link.pose(time))
        return pose

    def seen(self, marker: str, time: float) -> Pose:
        """Return the pose of a marker relative to the camera."""
        return compose(inverse(self.camera(time)), self.markers[marker])


def _walk(phase: float) -> Callable[[float], Pose]:
    radius, speed, step = 1.5, 0.08, 2 * pi * 0.8

    def pose(time: float) -> Pose:
        angle = speed * time
        bounce = 0.006 * sin(step * time + phase)
        place = (radius * sin(angle) + bounce, radius * (1 - cos(angle)), 0.0)
        return place, from_angles(0.0, 0.0, angle + 0.25 * sin(0.5 * time + phase))

    return pose


def _sway(phase: float) -> Callable[[float], Pose]:
    step = 2 * pi * 0.8

    def pose(time: float) -> Pose:
        side, up = sin(step * time + phase), sin(2 * step * time + phase)
        return (0.0, 0.015 * side, 0.32 + 0.008 * up), from_angles(0.04 * side, 0.05 + 0.01 * up, 0.0)

    return pose


def _neck(phase: float) -> Callable[[float], Pose]:
    return lambda time: ((0.0, 0.0, 0.1265), from_angles(0.0, 0.0, 0.6 * sin(0.9 * time + phase)))


def _head(phase: float) -> Callable[[float], Pose]:
    return lambda time: ((0.0, 0.0, 0.0), from_angles(0.0, 0.25 * sin(0.7 * time + phase) - 0.05, 0.0))


def _camera(phase: float) -> Callable[[float], Pose]:
    shake = 2 * pi * 4.0
    return lambda time: (
        (0.0587, 0.0, 0.0636),
        from_angles(0.0, 0.0209 + 0.004 * sin(shake * time + phase), 0.0),
    )


def _filler(random: Random) -> List[Link]:
    pairs = [
        ("torso" if index == 0 else names[index - 1], names[index])
        for names in _LIMBS.values()
        for index in range(len(names))
    ]
    links = [Link(parent, child, 50.0, _joint(random)) for parent, child in [*pairs, *_FIXTURES]]
    return links + [Link(parent, child, rate, _joint(random)) for parent, child, rate in _SLOW]


def _joint(random: Random) -> Callable[[float], Pose]:
    offset = tuple(round(random.uniform(-0.15, 0.15), 4) for _ in range(3))
    swing, speed, phase = random.uniform(0.05, 0.5), random.uniform(0.5, 5.0), random.uniform(0, 2 * pi)

    def pose(time: float) -> Pose:
        half = swing * sin(speed * time + phase) / 2
        return offset, (0.0, sin(half), 0.0, cos(half))  # type: ignore[return-value]

    return pose


def _markers(random: Random) -> Dict[str, Pose]:
    """Return markers on a ring around the robot's path, each approximately facing the centre."""
    markers = {}
    for index, name in enumerate(MARKERS):
        angle = 2 * pi * (index + random.uniform(-0.3, 0.3)) / len(MARKERS)
        radius = random.uniform(2.5, 3.2)
        place = (radius * cos(angle), 1.5 + radius * sin(angle), random.uniform(0.2, 0.9))
        facing = from_angles(
            random.uniform(-0.1, 0.1), random.uniform(-0.2, 0.2), angle + pi + random.uniform(-0.4, 0.4)
        )
        markers[name] = (place, facing)
    return markers


def distance(left: Vector, right: Vector) -> float:
    """Return the distance of two points in metres."""
    return sqrt(sum((one - other) ** 2 for one, other in zip(left, right)))
