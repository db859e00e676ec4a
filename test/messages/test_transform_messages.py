"""Transforms read directly from serialized messages."""

from struct import pack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Definitions, MessageError, Operators
from retalis.messages.transform_messages import TransformReader
from retalis.prolog.syntax.term_reader import read_term

TERM = (
    "tf2_msgs__0__TFMessage([geometry_msgs__0__TransformStamped(std_msgs__0__Header(7,[5,6],'\"map\"'),"
    "'\"//base link\"',geometry_msgs__0__Transform(geometry_msgs__0__Vector3(1.5,2.0,3.0),"
    "geometry_msgs__0__Quaternion(0.0,0.0,0.6,0.8))),"
    "geometry_msgs__0__TransformStamped(std_msgs__0__Header(0,[0,0],'\"\"'),"
    "'\"Jürgen\"',geometry_msgs__0__Transform(geometry_msgs__0__Vector3(0.0,0.0,0.0),"
    "geometry_msgs__0__Quaternion(0.0,0.0,0.0,1.0)))])"
)
TRANSFORMS = [
    ("map", "/base link", 5_000_000_006, (1.5, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8)),
    ("", "Jürgen", 0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)),
]


@pytest.fixture(scope="module")
def data() -> bytes:
    pytest.importorskip("rosbags")
    return Definitions().encoder("tf2_msgs/TFMessage").encode(read_term(TERM, Operators.prolog()).term, "tf")


def test_transforms_of_message_are_read(data: bytes) -> None:
    for is_static in (False, True):
        reader = TransformReader(is_static)
        for _ in range(2):  # the second time from the cache of names
            assert reader.read(data) == (TRANSFORMS, is_static)
    assert TransformReader(False).read(pack("<I", 0)) == ([], False)


def test_truncated_message_is_an_error(data: bytes) -> None:
    reader = TransformReader(False)
    for length in range(len(data)):
        with pytest.raises(MessageError, match="too few"):
            reader.read(data[:length])
    with pytest.raises(MessageError, match="its transforms take"):
        reader.read(data + b"\0")


@given(st.binary(max_size=300))
def test_any_bytes_are_transforms_or_an_error(data: bytes) -> None:
    try:
        TransformReader(False).read(data)
    except MessageError:
        pass


def test_frame_that_is_no_utf8_is_an_error(data: bytes) -> None:
    with pytest.raises(MessageError, match="not UTF-8"):
        TransformReader(False).read(data.replace(b"map", b"\xff\xfe\xfd"))


def test_cache_of_frame_names_is_bounded() -> None:
    reader = TransformReader(False)
    for number in range(10_050):
        name = b"%d" % number
        reader.read(
            pack("<I", 1)
            + pack("<4I", 0, 1, 2, len(name))
            + name
            + pack("<I", 1)
            + b"a"
            + pack("<7d", *range(7))
        )
    assert 0 < len(reader._names_by_bytes) < 10_002  # noqa: SLF001
