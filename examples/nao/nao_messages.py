"""Messages of the NAO example: definitions and terms.

``ar_pose`` and ``face_recognition`` are installed nowhere any more, so their definitions are here and travel
in the bag. The others are the common ones, repeated so that the bag can be made where ROS is not installed.
"""

from typing import Dict, Sequence, Tuple

from nao_robot import Pose

from retalis import Definition, Definitions, Encoder, Term, atom, functor, make_list
from retalis.messages.type_registry import InstalledTypes

HEADER = """\
uint32 seq
time stamp
string frame_id
"""
_GEOMETRY: Dict[str, str] = {
    "std_msgs/Header": HEADER,
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Transform": "Vector3 translation\nQuaternion rotation\n",
    "geometry_msgs/TransformStamped": "Header header\nstring child_frame_id\nTransform transform\n",
    "geometry_msgs/Pose": "Point position\nQuaternion orientation\n",
    "geometry_msgs/PoseWithCovariance": "Pose pose\nfloat64[36] covariance\n",
}
_AR_POSE = {
    "ar_pose/ARMarker": """\
Header header
uint32 id
geometry_msgs/PoseWithCovariance pose
uint32 confidence
""",
}
_FACES = {
    "actionlib_msgs/GoalID": "time stamp\nstring id\n",
    "actionlib_msgs/GoalStatus": """\
GoalID goal_id
uint8 status
uint8 PENDING=0
uint8 ACTIVE=1
uint8 PREEMPTED=2
uint8 SUCCEEDED=3
uint8 ABORTED=4
uint8 REJECTED=5
uint8 PREEMPTING=6
uint8 RECALLING=7
uint8 RECALLED=8
uint8 LOST=9
string text
""",
    "face_recognition/FaceRecognitionFeedback": "uint8 order_id\nstring[] names\nfloat32[] confidence\n",
}
TYPES: Dict[str, Tuple[str, Dict[str, str]]] = {
    "tf/tfMessage": ("geometry_msgs/TransformStamped[] transforms\n", _GEOMETRY),
    "ar_pose/ARMarkers": ("Header header\nARMarker[] markers\n", {**_GEOMETRY, **_AR_POSE}),
    "face_recognition/FaceRecognitionActionFeedback": (
        "Header header\nactionlib_msgs/GoalStatus status\nFaceRecognitionFeedback feedback\n",
        {"std_msgs/Header": HEADER, **_FACES},
    ),
}
"""Types of the bag's topics, with their definitions and those of the types that they contain."""

_ACTIVE = 1
_RECOGNIZE_CONTINUOUS = 1

_header = functor("std_msgs__0__Header", 3)
_vector = functor("geometry_msgs__0__Vector3", 3)
_point = functor("geometry_msgs__0__Point", 3)
_quaternion = functor("geometry_msgs__0__Quaternion", 4)
_transform = functor("geometry_msgs__0__Transform", 2)
_stamped = functor("geometry_msgs__0__TransformStamped", 3)
_message = functor("tf__0__tfMessage", 1)
_pose = functor("geometry_msgs__0__Pose", 2)
_with_covariance = functor("geometry_msgs__0__PoseWithCovariance", 2)
_marker = functor("ar_pose__0__ARMarker", 4)
_markers = functor("ar_pose__0__ARMarkers", 2)
_goal = functor("actionlib_msgs__0__GoalID", 2)
_status = functor("actionlib_msgs__0__GoalStatus", 3)
_feedback = functor("face_recognition__0__FaceRecognitionFeedback", 3)
_face = functor("face_recognition__0__FaceRecognitionActionFeedback", 3)
_no_covariance = make_list([0.0] * 36)


def definitions() -> Dict[str, Definition]:
    """Return the definitions of the bag's topics by type."""
    registry = Definitions(InstalledTypes(packages=(), modules=(), include_rosbags=False))
    return {name: registry.add(name, _joined(*texts)) for name, texts in TYPES.items()}


def encoders(known: Dict[str, Definition]) -> Dict[str, Encoder]:
    """Return the encoders of the bag's topics by type."""
    return {name: Encoder(definition) for name, definition in known.items()}


def _joined(text: str, nested: Dict[str, str]) -> str:
    line = "=" * 80
    return text + "".join(f"{line}\nMSG: {name}\n{part}" for name, part in nested.items())


def text(name: str) -> Term:
    """Return the atom that stands for a message's string."""
    return atom(f'"{name}"')


def header(sequence: int, stamp: int, frame: str) -> Term:
    """Return a header; ``stamp`` in nanoseconds."""
    return _header(sequence, make_list(divmod(stamp, 1_000_000_000)), text(frame))


def transform(sequence: int, stamp: int, parent: str, child: str, pose: Pose) -> Term:
    """Return a ``tf/tfMessage`` of one transform."""
    position, rotation = pose
    moved = _transform(_vector(*position), _quaternion(*rotation))
    return _message(make_list([_stamped(header(sequence, stamp, parent), text(child), moved)]))


def marker(sequence: int, stamp: int, name: str, pose: Pose, confidence: int) -> Term:
    """Return an ``ar_pose/ARMarkers`` of one marker; its name is the frame of the inner header."""
    position, rotation = pose
    number = int(name.rpartition("_")[2])
    seen = _with_covariance(_pose(_point(*position), _quaternion(*rotation)), _no_covariance)
    found = _marker(header(sequence, stamp, name), number, seen, confidence)
    return _markers(header(sequence, stamp, "CameraTop_frame"), make_list([found]))


def faces(sequence: int, stamp: int, started: int, names: Sequence[str], confidence: Sequence[float]) -> Term:
    """Return a ``face_recognition/FaceRecognitionActionFeedback``."""
    goal = _goal(make_list(divmod(started, 1_000_000_000)), text("/watch-1"))
    found = _feedback(_RECOGNIZE_CONTINUOUS, make_list(map(text, names)), make_list(confidence))
    return _face(header(sequence, stamp, ""), _status(goal, _ACTIVE, text("")), found)
