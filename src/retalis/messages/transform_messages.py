"""Transforms of serialized messages of type ``tf2_msgs/TFMessage`` or ``tf/tfMessage``.

The two types have the same bytes: a count, and for each transform a header (seq, secs, nsecs, frame), the child
frame, and seven doubles. They are read here without a decoder of the type, because nothing but the numbers is needed.
In CDR there is no seq, names end in a zero, and numbers are aligned; see `cdr_decoder`.
"""

from struct import Struct
from struct import error as StructError
from typing import Callable, Dict, List, NamedTuple, Tuple

from ..foundation.errors import MessageError
from .cdr_decoder import (
    BYTE_ORDERS,
    ENCAPSULATION_BYTES,
    MAX_PADDING_BYTES,
    MAX_SECONDS,
    NegativeTimeError,
    aligned_offset,
    not_plain_cdr,
)
from .type_definition import SerializationFormat

TRANSFORM_TYPES = ("tf2_msgs/TFMessage", "tf/tfMessage")

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
_CDR_LAYOUTS = {
    order: tuple(Struct(order + codes).unpack_from for codes in ("I", "3I", "7d")) for order in "<>"
}
"""Functions that read a length, a stamp with the length of the frame's name, and the numbers, by byte order."""
_LENGTH_BYTES, _STAMP_BYTES, _NUMBERS_BYTES = 4, 12, 56


class TransformReader:
    """Reads messages with transforms.

    Args:
        is_static: whether they hold at every instant.

    Attributes:
        read: function from a serialized message to its transforms. It raises `MessageError` if the bytes are not such
            a message.
    """

    def __init__(self, is_static: bool, serialization_format: SerializationFormat = SerializationFormat.ROS1):
        self._is_static = is_static
        self.read: Callable[[bytes], TransformMessage] = (
            self._read_ros1 if serialization_format is SerializationFormat.ROS1 else self._read_cdr
        )
        # Names of parent and child by the bytes of both strings: one lookup for two names.
        self._names_by_bytes: Dict[bytes, Tuple[str, str]] = {}

    def _read_ros1(self, data: bytes) -> TransformMessage:
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
                    if len(names) != 2 * _LENGTH_BYTES + parent_length + child_length:
                        raise StructError
                    child_start = 2 * _LENGTH_BYTES + parent_length
                    frames = self._cache_frames(names, names[4 : 4 + parent_length], names[child_start:])
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

    def _read_cdr(self, data: bytes) -> TransformMessage:
        byte_order = BYTE_ORDERS.get(data[:2])
        if byte_order is None:
            raise MessageError(not_plain_cdr(TRANSFORM_TYPES[0], data))
        unpack_length, unpack_stamp, unpack_numbers = _CDR_LAYOUTS[byte_order]
        transforms: List[Tuple[str, str, int, Pose]] = []
        names_by_bytes = self._names_by_bytes
        try:
            (count,) = unpack_length(data, ENCAPSULATION_BYTES)
            offset = ENCAPSULATION_BYTES + _LENGTH_BYTES
            for _ in range(count):
                seconds, nanoseconds, parent_length = unpack_stamp(data, offset)
                start = offset + _STAMP_BYTES - _LENGTH_BYTES
                parent_end = start + _LENGTH_BYTES + parent_length
                child_start = (parent_end + 3 & -4) + _LENGTH_BYTES
                (child_length,) = unpack_length(data, child_start - _LENGTH_BYTES)
                offset = child_start + child_length
                # Without the padding between them, which some implementations do not clear.
                names = data[start:parent_end] + data[child_start - _LENGTH_BYTES : offset]
                frames = names_by_bytes.get(names)
                if frames is None:
                    if offset > len(data):
                        raise StructError
                    frames = self._cache_frames(
                        names,
                        data[start + _LENGTH_BYTES : parent_end].rstrip(b"\0"),
                        data[child_start:offset].rstrip(b"\0"),
                    )
                offset = aligned_offset(offset, 8)
                if seconds > MAX_SECONDS:
                    raise MessageError(f"the message has {NegativeTimeError(seconds)}")
                instant = seconds * 1_000_000_000 + nanoseconds
                transforms.append((*frames, instant, unpack_numbers(data, offset)))
                offset += _NUMBERS_BYTES
        except StructError:
            raise MessageError(f"{len(data)} bytes are too few for the transforms of the message") from None
        if not 0 <= len(data) - offset <= MAX_PADDING_BYTES:
            raise MessageError(f"the message has {len(data)} bytes, but its transforms take {offset}")
        return TransformMessage(transforms, self._is_static)

    def _cache_frames(self, names: bytes, parent: bytes, child: bytes) -> Tuple[str, str]:
        """Return the names of two frames, and cache them by their bytes in a message."""
        frames = (_decode_name(parent), _decode_name(child))
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
