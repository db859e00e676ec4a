"""Transforms of serialized messages of type ``tf2_msgs/TFMessage`` or ``tf/tfMessage``.

The two types have the same bytes: a count, and for each transform a header (seq, secs, nsecs, frame), the child
frame, and seven doubles. They are read here without a decoder of the type, because nothing but the numbers is needed.
"""

from struct import Struct
from struct import error as StructError
from typing import Dict, List, NamedTuple, Tuple

from ..foundation.errors import MessageError

TRANSFORM_TYPES = ("tf2_msgs/TFMessage", "tf/tfMessage")
"""Types of messages with transforms."""

STATIC_TRANSFORM_TOPIC = "/tf_static"
TRANSFORM_TOPICS = ("/tf", STATIC_TRANSFORM_TOPIC)
"""Topics of transforms that hold at an instant, and of transforms that hold at every instant."""

_MAX_CACHED_NAMES = 10_000
"""Maximum number of pairs of frame names in the cache of a reader."""
_MAX_CACHED_BYTES = 512
"""Maximum length of a cached pair of names."""

Pose = Tuple[float, float, float, float, float, float, float]
"""Position (x, y, z) in m and rotation as a quaternion (x, y, z, w)."""


class TransformMessage(NamedTuple):
    """The transforms of a message.

    Attributes:
        transforms: frame names of parent and child without a leading slash, instant in nanoseconds, and pose of the
            child in the parent.
        is_static: whether they hold at every instant.
    """

    transforms: List[Tuple[str, str, int, Pose]]
    is_static: bool


_unpack_length = Struct("<I").unpack_from
_unpack_header = Struct("<4I").unpack_from
_unpack_numbers = Struct("<7d").unpack_from
_LENGTH_BYTES, _STAMP_BYTES, _NUMBERS_BYTES = 4, 12, 56


class TransformReader:
    """Reads messages with transforms.

    Args:
        is_static: whether they hold at every instant.
    """

    def __init__(self, is_static: bool):
        self._is_static = is_static
        # Names of parent and child by the bytes of both strings: one lookup for two names.
        self._names_by_bytes: Dict[bytes, Tuple[str, str]] = {}

    def read(self, data: bytes) -> TransformMessage:
        """Return the transforms of a serialized message.

        Raises:
            MessageError: if the bytes are not such a message.
        """
        transforms: List[Tuple[str, str, int, Pose]] = []
        names_by_bytes = self._names_by_bytes
        try:
            (count,) = _unpack_length(data)
            offset = _LENGTH_BYTES
            # If the count is too large, reading beyond the end raises an error, so the loop ends.
            for _ in range(count):
                _, seconds, nanoseconds, parent_length = _unpack_header(data, offset)
                start = offset + _STAMP_BYTES
                parent_end = start + _LENGTH_BYTES + parent_length
                (child_length,) = _unpack_length(data, parent_end)
                offset = parent_end + _LENGTH_BYTES + child_length
                names = data[start:offset]
                frames = names_by_bytes.get(names)
                if frames is None:
                    frames = self._read_frames(names, parent_length, child_length)
                parent, child = frames
                transforms.append(
                    (parent, child, seconds * 1_000_000_000 + nanoseconds, _unpack_numbers(data, offset))
                )
                offset += _NUMBERS_BYTES
        except StructError:
            raise MessageError(f"{len(data)} bytes are too few for the transforms of the message") from None
        if offset != len(data):
            raise MessageError(f"the message has {len(data)} bytes, but its transforms take {offset}")
        return TransformMessage(transforms, self._is_static)

    def _read_frames(self, names: bytes, parent_length: int, child_length: int) -> Tuple[str, str]:
        """Return the names of two frames, given the bytes of their strings with the lengths in front."""
        parent_end = _LENGTH_BYTES + parent_length
        if len(names) != parent_end + _LENGTH_BYTES + child_length:
            raise StructError
        frames = (
            _decode_name(names[_LENGTH_BYTES:parent_end]),
            _decode_name(names[parent_end + _LENGTH_BYTES :]),
        )
        if len(names) <= _MAX_CACHED_BYTES:
            if len(self._names_by_bytes) >= _MAX_CACHED_NAMES:
                self._names_by_bytes.clear()
            self._names_by_bytes[names] = frames
        return frames


def _decode_name(text: bytes) -> str:
    """Return the name of a frame as tf2 reads it, which removes one leading slash."""
    try:
        return text[text[:1] == b"/" :].decode("utf-8")
    except UnicodeDecodeError:
        raise MessageError("the name of a frame is not UTF-8") from None
