"""Event texts written directly from serialized messages, compared with the texts of their terms."""

import struct
from typing import Any, List

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_registries import decoder_of

from retalis import MessageError, atom
from retalis.messages.message_to_event_text import make_text_writer, write_without_unread
from retalis.prolog.syntax.event_text import EventReader, event_text, to_text
from retalis.prolog.terms.term_traversal import freeze
from retalis.prolog.terms.timestamps import datime

HEADER = "\n".join(["=" * 80, "MSG: std_msgs/Header", "uint32 seq", "time stamp", "string frame_id", ""])
POSE = "Header header\nstring name\nfloat64 x\nfloat32 y\nint64 n\n" + HEADER
ODD = [
    b"",
    b"/odom",
    b"it's",
    b'say "x"',
    b"a\\b",
    b"{x}",
    b"100%d",
    b"\xff",
    b"FFFFFFFFFF",
    b"a\nb",
    b"[1,2]",
]


def packed(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


def pose(frame: bytes, name: bytes, x: float = 0.5, y: float = 0.25, number: int = 7) -> Any:
    return struct.pack("<III", 1, 2, 3) + packed(frame) + packed(name) + struct.pack("<dfq", x, y, number)


@pytest.mark.parametrize("frame", ODD)
def test_strings_have_text_of_their_terms(frame: bytes) -> None:
    message_decoder = decoder_of(POSE)
    data = pose(frame, frame[::-1])
    for _ in range(2):  # texts before and after they are cached
        assert make_text_writer(message_decoder)(data) == to_text(message_decoder.decode(data))


@settings(deadline=None)
@given(st.floats(), st.floats(width=32), st.integers(-(2**63), 2**63 - 1))
def test_numbers_have_text_of_their_terms(x: float, y: float, number: int) -> None:
    data = pose(b"f", b"n", x, y, number)
    text = _writer(data)
    assert text == to_text(_decoder.decode(data))
    assert freeze(EventReader().read(text)) == freeze(_decoder.decode(data))


TWISTED = (
    "Header header\nstring name\nfloat64 x\nfloat64 y\nfloat32 z\nint8 n\nfloat64[3] t\nfloat64 w\n" + HEADER
)
FLOATS = [0.0, -0.0, 1.0, 1e-7, -1e22, 1.5e-9, 123456.789, float("inf"), float("-inf"), float("nan")]


def twisted(x: Any, y: Any, z: Any, t: Any, w: Any) -> Any:
    cached_texts = packed(b"map") + packed(b"one")
    return struct.pack("<III", 1, 2, 3) + cached_texts + struct.pack("<ddfb3dd", x, y, z, 7, *t, w)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.lists(st.sampled_from(FLOATS), min_size=7, max_size=7), min_size=2, max_size=4))
def test_changed_floats_have_text_of_their_terms(rows: List[Any]) -> None:
    message_decoder = decoder_of(TWISTED)
    write = make_text_writer(message_decoder)
    for row in rows:
        for _ in range(2):
            x, y, z, *t, w = row
            data = twisted(x, y, z, t, w)
            assert write(data) == to_text(message_decoder.decode(data))


def test_leading_floats_have_text_of_their_terms() -> None:
    for text, data in (
        (
            "float64 x\nfloat64 y\nstring name\n",
            [struct.pack("<dd", number, 1e-9) + packed(b"n") for number in (1.5, 1e30)],
        ),
        ("string name\nfloat64[0] x\nint8 n\n", [packed(b"n") + b"\x05"]),
    ):
        message_decoder = decoder_of(text)
        write = make_text_writer(message_decoder)
        for message in data * 2:
            assert write(message) == to_text(message_decoder.decode(message))


_decoder = decoder_of(POSE)
_writer = make_text_writer(_decoder)


@pytest.mark.parametrize(
    ("text", "data"),
    [
        ("bool on\nstring name\n", b"\1" + packed(b"x")),
        ("string name\nuint8[3] code\n", packed(b"x") + b"abc"),
        ("string name\nint16[3] counts\n", packed(b"x") + struct.pack("<3h", -1, 0, 300)),
        ("string name\nfloat64[6] values\n", packed(b"x") + struct.pack("<6d", *range(6))),
        ("string[] names\n", struct.pack("<I", 2) + packed(b"x") + packed(b"y")),
        ("Part[] parts\n" + "=" * 80 + "\nMSG: pkg/Part\nstring name\nfloat64 x\n", struct.pack("<I", 0)),
        ("float64 x\nfloat64 y\n", struct.pack("<2d", 1e-5, float("inf"))),
        ("", b""),
    ],
)
def test_message_of_each_form_has_text_of_its_term(text: str, data: Any) -> None:
    message_decoder = decoder_of(text)
    assert make_text_writer(message_decoder)(data) == to_text(message_decoder.decode(data))


def test_array_of_any_length_has_text_of_its_term() -> None:
    message_decoder = decoder_of("Part[] parts\n" + "=" * 80 + "\nMSG: pkg/Part\nstring name\nfloat64 x\n")
    part = packed(b"x") + struct.pack("<d", 2.0)
    for number in range(3):
        data = struct.pack("<I", number) + part * number
        assert make_text_writer(message_decoder)(data) == to_text(message_decoder.decode(data))


def test_incomplete_message_is_an_error() -> None:
    with pytest.raises(MessageError, match="pkg/Type"):
        _writer(pose(b"f", b"n")[:-1])


def test_event_text_has_instant_as_interval() -> None:
    instant = 1413748205_000000007
    stamp = to_text(datime(instant))
    assert event_text("e(1)", instant) == f"event(e(1),[{stamp},{stamp}])"


def test_long_unread_arguments_are_replaced() -> None:
    message_decoder = decoder_of(
        "Header header\nuint8[] data\nfloat64[] numbers\nstring[] names\nstring text\nint32 size\n" + HEADER
    )
    data = struct.pack("<III", 1, 2, 3) + packed(b"cam") + packed(b"x" * 5000)
    data += struct.pack("<I100d", 100, *range(100)) + struct.pack("<I", 1) + packed(b"joint")
    data += packed(b"y" * 5000) + struct.pack("<i", 7)
    mark = atom("gone")
    whole = make_text_writer(message_decoder)(data)
    assert write_without_unread(message_decoder, data, set(), mark) == whole
    short = write_without_unread(message_decoder, data, {1, 2, 3, 4, 5, 6}, mark)
    assert short == "pkg__0__Type(std_msgs__0__Header(1,[2,3],'\"cam\"'),gone,gone,gone,gone,7)"
    some = write_without_unread(message_decoder, data, {2, 5}, mark)
    assert "xxx" not in some
    assert "yyy" not in some
    assert "99.0" in some
    assert "joint" in some


def test_short_unread_arguments_are_kept() -> None:
    message_decoder = decoder_of("string a\nuint8[] b\nint32[] c\n")
    data = packed(b"short") + packed(b"data") + struct.pack("<I", 0)
    assert write_without_unread(message_decoder, data, {1, 2, 3}, atom("gone")) == make_text_writer(
        message_decoder
    )(data)
    with pytest.raises(MessageError):
        write_without_unread(message_decoder, data[:-1], {1, 2, 3}, atom("gone"))
