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

TRANSFORM_TOPICS = ("/tf", "/tf_static")
"""Topics of transforms that hold at an instant, and of transforms that hold at every instant."""

_MAX_CACHED_NAMES = 10_000
_MAX_CACHED_LENGTH = 256

Numbers = Tuple[float, float, float, float, float, float, float]


class TransformMessage(NamedTuple):
    """The transforms of a message.

    Attributes:
        transforms: parent and child without a leading slash, instant in nanoseconds, and position and rotation of the
            child in the parent.
        is_static: whether they hold at every instant.
    """

    transforms: List[Tuple[str, str, int, Numbers]]
    is_static: bool


_count = Struct("<I").unpack_from
_header = Struct("<4I").unpack_from
_numbers = Struct("<7d").unpack_from
_COUNT_BYTES, _HEADER_BYTES, _NUMBERS_BYTES = 4, 16, 56


class TransformReader:
    """Reads messages with transforms.

    Args:
        is_static: whether they hold at every instant.
    """

    def __init__(self, is_static: bool):
        self._is_static = is_static
        self._names: Dict[bytes, str] = {}

    def read(self, data: bytes) -> TransformMessage:
        """Return the transforms of a serialized message.

        Raises:
            MessageError: if the bytes are not such a message.
        """
        transforms: List[Tuple[str, str, int, Numbers]] = []
        names = self._names
        try:
            (count,) = _count(data)
            offset = _COUNT_BYTES
            # A message without transforms for a large count ends the loop by an error.
            for _ in range(count):
                _, seconds, nanoseconds, length = _header(data, offset)
                offset += _HEADER_BYTES
                text = data[offset : offset + length]
                offset += length
                parent = names.get(text)
                if parent is None:
                    parent = self._read_name(text, length)
                (length,) = _count(data, offset)
                offset += _COUNT_BYTES
                text = data[offset : offset + length]
                offset += length
                child = names.get(text)
                if child is None:
                    child = self._read_name(text, length)
                transforms.append(
                    (parent, child, seconds * 1_000_000_000 + nanoseconds, _numbers(data, offset))
                )
                offset += _NUMBERS_BYTES
        except StructError:
            raise MessageError(f"{len(data)} bytes are too few for the transforms of the message") from None
        if offset != len(data):
            raise MessageError(f"the message has {len(data)} bytes, but its transforms take {offset}")
        return TransformMessage(transforms, self._is_static)

    def _read_name(self, text: bytes, length: int) -> str:
        if len(text) != length:
            raise StructError
        try:
            # tf2 removes one leading slash.
            name = text[text[:1] == b"/" :].decode("utf-8")
        except UnicodeDecodeError:
            raise MessageError("the name of a frame is not UTF-8") from None
        if len(text) <= _MAX_CACHED_LENGTH:
            if len(self._names) >= _MAX_CACHED_NAMES:
                self._names.clear()
            self._names[text] = name
        return name
