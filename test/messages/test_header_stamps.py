"""Stamps and frames in serialized messages."""

import struct
from typing import Any, Dict, List, Tuple

import pytest
from asserting_accessors import required
from hypothesis import given, settings
from hypothesis import strategies as st
from message_registries import empty_registry

from retalis import Definitions, MessageError, Operators
from retalis.messages.header_stamps import (
    format_frame_key,
    make_observed_decoder,
    make_stamp_reader,
    shift_header_stamp,
)
from retalis.messages.message_to_event_text import make_text_writer
from retalis.messages.type_definition import SerializationFormat
from retalis.prolog.syntax.event_text import to_text
from retalis.prolog.syntax.term_reader import read_term

SECOND = 10**9
FORMATS = list(SerializationFormat)
BAR = "\n" + "=" * 80 + "\n"
HEADER = BAR + "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
TRANSFORM = BAR + "MSG: t/T\nHeader header\nstring child_frame_id\nfloat64[7] values\n" + HEADER
TYPES = {
    "t/Plain": "float64 x",
    "t/Own": "Header header\nfloat64 x" + HEADER,
    "t/Odometry": "Header header\nstring child_frame_id\nfloat64 x" + HEADER,
    "t/Named": "Header header\nstring name\nfloat64 x" + HEADER,
    "t/Frames": "t/T[] transforms" + TRANSFORM,
    "t/Two": "string name\nt/T[2] transforms\nint8 rest" + TRANSFORM,
    "t/Markers": "Header header\nstring[] names\nt/M[] markers"
    + BAR
    + "MSG: t/M\nHeader header\nstring name\n"
    + HEADER,
}


DEFINITIONS = Definitions()
for _name, _text in TYPES.items():
    DEFINITIONS.add(_name, _text)


def encode(
    kind: str, text: str, serialization_format: SerializationFormat = SerializationFormat.ROS1
) -> bytes:
    encoder = DEFINITIONS.encoder(DEFINITIONS.find(kind), serialization_format)
    return encoder.encode(read_term(text, Operators.prolog()).term)


def header(second: int, nanosecond: int, frame: str) -> str:
    return f"std_msgs__0__Header(0,[{second},{nanosecond}],'\"{frame}\"')"


def transform(second: int, nanosecond: int, frame: str, child: str) -> str:
    return f"t__0__T({header(second, nanosecond, frame)},'\"{child}\"',[0,0,0,0,0,0,1])"


def read(kind: str, text: str, serialization_format: SerializationFormat) -> List[Tuple[Any, ...]]:
    read_stamps = required(make_stamp_reader(DEFINITIONS.find(kind), serialization_format))
    stamps = read_stamps(encode(kind, text, serialization_format))
    return [(format_frame_key(key), instant / SECOND) for key, instant in stamps]


def test_type_without_stamps_has_no_reader() -> None:
    assert make_stamp_reader(DEFINITIONS.find("t/Plain")) is None


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [
        ("t/Own", f"t__0__Own({header(5, 500000000, 'map')},1.0)", [("map", 5.5)]),
        ("t/Own", f"t__0__Own({header(0, 0, 'map')},1.0)", []),
        ("t/Odometry", f"t__0__Odometry({header(5, 0, 'map')},'\"base\"',1.0)", [("map > base", 5)]),
        ("t/Frames", "t__0__Frames([])", []),
        (
            "t/Frames",
            f"t__0__Frames([{transform(1, 0, 'a', 'b')},{transform(2, 0, 'b', 'c')}])",
            [("a > b", 1), ("b > c", 2)],
        ),
        (
            "t/Two",
            f"t__0__Two('\"x\"',[{transform(1, 0, 'a', 'b')},{transform(2, 0, '', 'c')}],1)",
            [("a > b", 1), (" > c", 2)],
        ),
        (
            "t/Markers",
            f"t__0__Markers({header(1, 0, 'a')},['\"x\"','\"yy\"'],"
            f"[t__0__M({header(2, 0, 'a')},'\"n\"'),t__0__M({header(3, 0, 'b')},'\"nn\"')])",
            [("a", 1), ("a", 2), ("b", 3)],
        ),
    ],
)
@pytest.mark.parametrize("serialization_format", FORMATS)
def test_stamps_of_all_frames_are_read(
    kind: str, text: str, expected: Any, serialization_format: SerializationFormat
) -> None:
    assert read(kind, text, serialization_format) == expected


def test_big_endian_stamps_are_read() -> None:
    read_stamps = required(make_stamp_reader(DEFINITIONS.find("t/Own"), SerializationFormat.CDR))
    message = struct.pack(">4xiII4s4xd", 5, 6, 4, b"map\0", 1.0)
    assert read_stamps(message) == [(message[12:20], 5 * SECOND + 6)]


def test_negative_stamp_in_cdr_is_omitted() -> None:
    read_stamps = required(make_stamp_reader(DEFINITIONS.find("t/Own"), SerializationFormat.CDR))
    stamps = {
        second: len(read_stamps(struct.pack("<HHiII4s4xd", 256, 0, second, 6, 4, b"map\0", 1.0)))
        for second in (5, -5)
    }
    assert stamps == {5: 1, -5: 0}


def test_slots_have_separate_frame_keys() -> None:
    text = f"t__0__Markers({header(1, 0, 'a')},[],[t__0__M({header(2, 0, 'a')},'\"n\"')])"
    keys = [
        key
        for key, _ in required(make_stamp_reader(DEFINITIONS.find("t/Markers")))(encode("t/Markers", text))
    ]
    assert len(set(keys)) == 2


@given(st.sampled_from(sorted(TYPES)), st.binary(max_size=200), st.sampled_from(FORMATS))
def test_stamps_of_any_bytes_are_bounded(
    kind: str, data: bytes, serialization_format: SerializationFormat
) -> None:
    read = make_stamp_reader(DEFINITIONS.find(kind), serialization_format)
    if read is not None:
        if serialization_format is SerializationFormat.CDR:
            data = b"\0\1\0\0" + data
        assert len(read(data)) <= len(data) // 12


class LastSecond:
    """The last second in which a frame was reported."""

    def __init__(self, second: Any) -> None:
        self.second = second


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(["t/Own", "t/Odometry", "t/Named", "t/Frames", "t/Markers"]),
    st.lists(
        st.tuples(st.integers(0, 5), st.integers(0, 3), st.sampled_from(["", "map", "odom"])), max_size=20
    ),
    st.sampled_from(FORMATS),
)
def test_observer_reports_each_new_second_once(
    kind: str, messages: List[Any], serialization_format: SerializationFormat
) -> None:
    """The observer reports each new second of a frame and no other stamp."""
    decoder = DEFINITIONS.decoder(DEFINITIONS.find(kind), serialization_format)
    reader = make_stamp_reader(DEFINITIONS.find(kind), serialization_format)
    reports: List[Any] = []
    last_seconds: Dict[Any, Any] = {}
    expected: List[Any] = []
    seconds: Dict[Any, Any] = {}

    def report(stamps: Any) -> None:
        reports.append(stamps)
        for key, _ in stamps:  # the replaced object may still be referenced
            last_seconds.get(key, LastSecond(0)).second = -1
        last_seconds.update((key, LastSecond(instant // SECOND)) for key, instant in stamps)

    observed = make_observed_decoder(decoder, last_seconds, report)
    reads = [lambda data: to_text(observed.decode(data)), make_text_writer(observed)]
    for second, nanosecond, frame in messages:
        text = {
            "t/Own": f"t__0__Own({header(second, nanosecond, frame)},1.0)",
            "t/Odometry": f"t__0__Odometry({header(second, nanosecond, frame)},'\"b\"',1.0)",
            "t/Named": f"t__0__Named({header(second, nanosecond, frame)},'\"b\"',1.0)",
            "t/Frames": f"t__0__Frames([{transform(second, nanosecond, frame, 'b')}])",
            "t/Markers": f"t__0__Markers({header(second, nanosecond, frame)},[],[])",
        }[kind]
        data = encode(kind, text, serialization_format)
        assert reads[nanosecond % 2](data) == make_text_writer(decoder)(data)
        assert observed.stamp(data) == decoder.stamp(data)
        stamps = required(reader)(data)
        if any(seconds.get(key) != instant // SECOND for key, instant in stamps):
            expected.append(stamps)
        seconds.update((key, instant // SECOND) for key, instant in stamps)
    assert reports == expected


def test_message_written_again_is_not_reported_again() -> None:
    reports: List[Any] = []
    observed = make_observed_decoder(DEFINITIONS.decoder(DEFINITIONS.find("t/Frames")), {}, reports.append)
    data = encode("t/Frames", f"t__0__Frames([{transform(5, 0, 'a', 'b')}])")
    assert make_text_writer(observed)(data) == make_text_writer(required(observed.plain))(data)
    assert len(reports) == 1


@pytest.mark.parametrize("child", ["", "b"])
@pytest.mark.parametrize("frame", ["", "a"])
def test_unnamed_frames_are_shown_as_empty(frame: str, child: str) -> None:
    text = f"t__0__Frames([{transform(5, 0, frame, child)}])"
    for serialization_format in FORMATS:
        assert read("t/Frames", text, serialization_format) == [(f"{frame} > {child}", 5)]


def test_observed_decoder_limits_empty_elements() -> None:
    parts = BAR + "MSG: t/Nothing" + HEADER
    definitions = empty_registry(max_empty_elements=3)
    for number in (3, 4):
        definition = definitions.add(f"t/Type{number}", f"Header header\nNothing[{number}] x{parts}")
        observed = make_observed_decoder(definitions.decoder(definition), {}, lambda definition: None)
        for read in (observed.decode, make_text_writer(observed)):
            data = struct.pack("<IIII", 1, 2, 3, 0)
            if number == 3:
                assert read(data)
            else:
                with pytest.raises(MessageError, match="4 zero-byte elements in its arrays: at most 3"):
                    read(data)


@pytest.mark.parametrize("serialization_format", FORMATS)
@pytest.mark.parametrize(
    ("shift", "expected"),
    [(1, (5, 600_000_001)), (-600_000_001, (4, 999_999_999)), (-(10**12), (0, 0)), (10**20, (2147483647, 0))],
)
def test_stamp_of_header_is_shifted(
    serialization_format: SerializationFormat, shift: int, expected: Tuple[int, int]
) -> None:
    message, shifted = (
        encode("t/Own", f"t__0__Own({header(*stamp, 'map')},1.0)", serialization_format)
        for stamp in ((5, 600_000_000), expected)
    )
    assert shift_header_stamp(message, serialization_format, shift) == shifted


def test_unset_or_unreadable_stamp_is_not_shifted() -> None:
    unset = encode("t/Own", f"t__0__Own({header(0, 0, 'map')},1.0)")
    negative = struct.pack("<HHiII4s4xd", 256, 0, -5, 6, 4, b"map\0", 1.0)
    assert shift_header_stamp(unset, SerializationFormat.ROS1, 5) == unset
    assert shift_header_stamp(negative, SerializationFormat.CDR, 5) == negative
    assert shift_header_stamp(b"\0\1\0", SerializationFormat.CDR, 5) == b"\0\1\0"
