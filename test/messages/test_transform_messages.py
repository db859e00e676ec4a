"""Transforms read directly from serialized messages."""

from contextlib import suppress
from struct import pack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Definitions, MessageError, Operators, Term
from retalis.messages.transform_messages import TransformReader
from retalis.messages.type_definition import SerializationFormat
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
def term() -> Term:
    pytest.importorskip("rosbags")
    return read_term(TERM, Operators.prolog()).term


@pytest.fixture(scope="module")
def data(term: Term) -> bytes:
    return Definitions().encoder("tf2_msgs/TFMessage").encode(term, "tf")


@pytest.mark.parametrize("serialization_format", SerializationFormat)
def test_transforms_of_message_are_read(term: Term, serialization_format: SerializationFormat) -> None:
    data = Definitions().encoder("tf2_msgs/TFMessage", serialization_format).encode(term, "tf")
    for is_static in (False, True):
        reader = TransformReader(is_static, serialization_format)
        for _ in range(2):  # the second time from the cache of names
            assert reader.read(data) == (TRANSFORMS, is_static)


def test_message_may_have_no_transforms() -> None:
    assert TransformReader(False).read(pack("<I", 0)) == ([], False)
    assert TransformReader(False, SerializationFormat.CDR).read(b"\0\1\0\0" + pack("<I", 0)) == ([], False)


def test_big_endian_transforms_are_read() -> None:
    message = pack(">IIiII2sxxI2s6x7d", 0, 1, 5, 6, 2, b"a\0", 2, b"b\0", *range(7))
    expected = [("a", "b", 5_000_000_006, (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0))]
    assert TransformReader(False, SerializationFormat.CDR).read(message) == (expected, False)


@pytest.mark.parametrize(("serialization_format", "padding"), list(zip(SerializationFormat, (1, 4))))
def test_truncated_message_is_an_error(
    term: Term, serialization_format: SerializationFormat, padding: int
) -> None:
    data = Definitions().encoder("tf2_msgs/TFMessage", serialization_format).encode(term, "tf")
    reader = TransformReader(False, serialization_format)
    for length in range(len(data)):
        with pytest.raises(MessageError, match="too few|is not plain CDR"):
            reader.read(data[:length])
    with pytest.raises(MessageError, match="its transforms take"):
        reader.read(data + bytes(padding))


def test_negative_time_of_transform_is_an_error() -> None:
    message = pack("<HHIiII2sxxI2s6x7d", 256, 0, 1, -5, 6, 2, b"a\0", 2, b"b\0", *range(7))
    with pytest.raises(MessageError, match="a time of -5 s: expected at least 0 s"):
        TransformReader(False, SerializationFormat.CDR).read(message)


@given(st.binary(max_size=300))
def test_any_bytes_are_transforms_or_an_error(data: bytes) -> None:
    for serialization_format, message in zip(SerializationFormat, (data, b"\0\1\0\0" + data)):
        with suppress(MessageError):
            assert not TransformReader(False, serialization_format).read(message).is_static


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
