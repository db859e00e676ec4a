"""Decoding of serialized messages to terms: values, lazy parts, and limits."""

import struct
from typing import Any, List

import pytest
from asserting_accessors import compound, items, lazy, name_of
from message_registries import decoder_of, empty_registry, section
from reachable_objects import reachable

from retalis import MessageError, Term, atom, deref, functor, list_items, make_list
from retalis.foundation.bounded_caches import Cache
from retalis.messages.decoder import cached_texts
from retalis.prolog.terms.types import Lazy

HEADER = "\n".join(["=" * 80, "MSG: std_msgs/Header", "uint32 seq", "time stamp", "string frame_id", ""])


def args(term: Term) -> List[Term]:
    return [deref(part) for part in compound(term)[1:]]


def header(sequence: int, seconds: int, nanoseconds: int, frame: bytes) -> bytes:
    return struct.pack("<IIII", sequence, seconds, nanoseconds, len(frame)) + frame


def test_message_with_header_is_decoded() -> None:
    message_decoder = decoder_of("Header header\nfloat64 x\n" + HEADER)
    term = message_decoder.decode(header(7, 1413748205, 981209993, b"/odom") + struct.pack("<d", 0.5))
    stamp = make_list([1413748205, 981209993])
    assert term == (
        functor("pkg__0__Type", 2),
        (functor("std_msgs__0__Header", 3), 7, stamp, atom('"/odom"')),
        0.5,
    )
    assert message_decoder.functor is functor("pkg__0__Type", 2)


def test_message_without_slots_is_an_atom() -> None:
    message_decoder = decoder_of("uint8 X=1\n", "std_msgs/Empty")
    assert message_decoder.decode(b"") is atom("std_msgs__0__Empty")
    assert message_decoder.lazy(b"") is atom("std_msgs__0__Empty")
    assert message_decoder.functor is functor("std_msgs__0__Empty", 0)
    with pytest.raises(MessageError, match="1 byte is not a std_msgs/Empty: 1 left over"):
        message_decoder.decode(b"x")


def test_limits_of_numbers_are_decoded() -> None:
    text = "int8 a\nuint8 b\nint64 c\nuint64 d\nbyte e\nchar f\nbool g\nbool h\ntime t\nduration u\n"
    data = struct.pack(
        "<bBqQbB??IIii", -128, 255, -(2**63), 2**64 - 1, -1, 255, True, False, 2**32 - 1, 5, -1, -2
    )
    assert args(decoder_of(text).decode(data)) == [
        -128,
        255,
        -(2**63),
        2**64 - 1,
        -1,
        255,
        atom("true"),
        atom("false"),
        make_list([2**32 - 1, 5]),
        make_list([-1, -2]),
    ]


def test_special_floats_are_decoded() -> None:
    first, second, third = args(
        decoder_of("float32 a\nfloat64 b\nfloat64 c\n").decode(
            struct.pack("<fdd", float("nan"), float("inf"), -0.0)
        )
    )
    assert first != first
    assert second == float("inf")
    assert str(third) == "-0.0"


def test_byte_arrays_are_decoded_as_strings() -> None:
    term = decoder_of("uint8[] a\nuint8[3] b\nchar[] c\nbyte[] d\n").decode(
        struct.pack("<I3s3sI2sI2b", 3, b"abc", b"\0\1\2", 2, b"hi", 2, 1, -1)
    )
    assert args(term) == [atom('"abc"'), atom('"FFFFFFFFFFAAEC////"'), atom('"hi"'), make_list([1, -1])]


def test_long_arrays_are_decoded_lazily() -> None:
    message_decoder = decoder_of("float64[] short\nfloat64[] long\nfloat64[3] three\nfloat64[36] matrix\n")
    values = [float(value) for value in range(36)]
    data = struct.pack("<I2dI9d3d36d", 2, 1.0, 2.0, 9, *values[:9], *values[:3], *values)
    parts = compound(message_decoder.decode(data))[1:]
    assert [part.__class__ is Lazy for part in parts] == [False, True, False, True]
    assert [list_items(part) for part in parts] == [[1.0, 2.0], values[:9], values[:3], values]


def test_unread_arrays_are_not_decoded() -> None:
    message_decoder = decoder_of("uint8[] image\nfloat32[] ranges\n")
    size = 1 << 20
    term = message_decoder.decode(struct.pack("<I", size) + bytes(size) + struct.pack("<I", 5) + bytes(20))
    image, ranges = compound(term)[1:]
    for part in (image, ranges):
        assert part.__class__ is Lazy
        assert part.decoded_term is None
    assert name_of(image).startswith('"FFFFFFFFFFAAAA')


def test_lazy_message_is_decoded_on_access() -> None:
    message_decoder = decoder_of("int8 x\n")
    term = lazy(message_decoder.lazy(b"\5"))
    assert term.functor is functor("pkg__0__Type", 1)
    assert term.decoded_term is None
    assert deref(term) == (functor("pkg__0__Type", 1), 5)
    with pytest.raises(MessageError):
        deref(message_decoder.lazy(b""))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "0 bytes are not a pkg/Type: they end inside slot all"),
        (struct.pack("<I", 1), "4 bytes are not a pkg/Type: they end inside slot all"),
        (
            struct.pack("<I", 2) + header(1, 2, 3, b"ab") + bytes(8) + header(1, 2, 3, b"abc")[:-1],
            "end inside slot all[1].header.frame_id",
        ),
        (struct.pack("<I", 1) + header(1, 2, 3, b"ab"), "end inside slot all[0].x"),
        (
            struct.pack("<I", 1) + header(1, 2, 3, b"ab") + b"123456789",
            "31 bytes are not a pkg/Type: 1 left over",
        ),
        (struct.pack("<I", 2**32 - 1) + header(1, 2, 3, b"ab") + b"12345678", "end inside slot all"),
        (
            struct.pack("<IIIII", 1, 1, 2, 3, 2**32 - 1) + b"12345678",
            "end inside slot all[0].header.frame_id",
        ),
    ],
)
def test_error_names_slot_of_incomplete_message(data: Any, message: str) -> None:
    text = "Inner[] all\n" + "=" * 80 + "\nMSG: pkg/Inner\nHeader header\nfloat64 x\n" + HEADER
    with pytest.raises(MessageError) as error:
        decoder_of(text).decode(data)
    assert message in error.value.message


def test_truncated_message_is_an_error() -> None:
    text = "string[] names\nInner[] all\nuint8[] raw\nfloat32[9] m\nfloat64[] many\n"
    message_decoder = decoder_of(text + "=" * 80 + "\nMSG: pkg/Inner\nbool x\nstring[2] y\n")
    data = struct.pack("<II2sI3s", 2, 2, b"ab", 3, b"abc")
    data += struct.pack("<I?I1sI0s", 1, True, 1, b"x", 0, b"")
    data += struct.pack("<I3s9fI6d", 3, b"abc", *range(9), 6, *range(6))
    assert len(compound(message_decoder.decode(data))) == 6
    for size in range(len(data)):
        with pytest.raises(MessageError, match="they end inside slot|left over"):
            message_decoder.decode(data[:size])
    with pytest.raises(MessageError, match="1 left over"):
        message_decoder.decode(data + b"\0")


def test_array_of_empty_messages_is_limited() -> None:
    message_decoder = decoder_of("Nothing[] all\n" + "=" * 80 + "\nMSG: pkg/Nothing\n")
    assert items(args(message_decoder.decode(struct.pack("<I", 3)))[0]) == [atom("pkg__0__Nothing")] * 3
    with pytest.raises(MessageError):
        message_decoder.decode(struct.pack("<I", 2**32 - 1))


def test_stamp_is_read_from_leading_header() -> None:
    message_decoder = decoder_of("Header header\nint8 x\n" + HEADER)
    assert message_decoder.stamp(header(1, 3, 4, b"frame") + b"\0") == 3_000_000_004
    assert message_decoder.stamp(header(1, 0, 0, b"frame") + b"\0") is None
    with pytest.raises(MessageError):
        message_decoder.stamp(b"123")
    assert decoder_of("int8 x\nHeader header\n" + HEADER).stamp(b"") is None
    assert decoder_of("Header other\n" + HEADER).stamp(header(1, 3, 4, b"")) is None
    assert decoder_of("int8 x\n").stamp(b"\0") is None


def test_cache_of_strings_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cached_texts, "max_entries", 10)
    cached_texts.clear()
    message_decoder = decoder_of("string[] names\n")
    for number in range(50):
        name = b"name%d" % number
        data = struct.pack("<II", 1, len(name)) + name
        first, second = (items(args(message_decoder.decode(data))[0])[0] for _ in range(2))
        assert first is second is cached_texts[name] is atom(f'"name{number}"')
        assert len(cached_texts) <= 10


def test_caches_of_adjacent_strings_are_bounded() -> None:
    message_decoder = decoder_of("Header header\nstring child\nfloat64 x\n" + HEADER)
    for number in range(5000):
        child = b"child%d" % number
        data = header(1, 2, 3, b"base") + struct.pack("<I", len(child)) + child + struct.pack("<d", 1.0)
        message = message_decoder.decode(data)
        assert args(args(message)[0])[2] is atom('"base"')
        assert args(message)[1] is atom(f'"child{number}"')
    assert 0 < max(map(len, reachable(message_decoder.decode.__globals__, Cache))) <= 2048


EMPTY = section("pkg/Empty", "")


@pytest.mark.parametrize(
    ("text", "data"),
    [
        ("pkg/Empty[] x\n" + EMPTY, struct.pack("<I", 1 << 20)),
        ("pkg/Empty[4000000000] x\n" + EMPTY, b""),
        ("pkg/Empty[4000] x\npkg/Empty[] y\n" + EMPTY, struct.pack("<I", 6001)),
        ("".join(f"pkg/Empty[] x{n}\n" for n in range(17)) + EMPTY, struct.pack("<I", 1000) * 17),
        ("pkg/Outer[] x\n" + section("pkg/Outer", "pkg/Empty[1000] e\n") + EMPTY, struct.pack("<I", 11)),
        ("pkg/Outer[11] x\n" + section("pkg/Outer", "pkg/Empty[1000] e\n") + EMPTY, b""),
        ("pkg/Outer[] x\n" + section("pkg/Outer", "int8 y\npkg/Empty[6000] e\n") + EMPTY,
         struct.pack("<I", 2) + bytes(2)),
        ("pkg/Outer[] x\n" + section("pkg/Outer", "pkg/Empty[] e\n") + EMPTY, struct.pack("<III", 2, 6000, 6000)),
    ],
)  # fmt: skip
def test_number_of_empty_elements_is_limited(text: Any, data: Any) -> None:
    with pytest.raises(MessageError, match="zero-byte elements in its arrays: at most 10000 are allowed"):
        decoder_of(text).decode(data)


def test_limit_of_empty_elements_is_configurable() -> None:
    definitions = empty_registry(max_empty_elements=3)
    message_decoder = definitions.decoder(definitions.add("pkg/Type", "pkg/Empty[] x\n" + EMPTY))
    assert len(items(args(message_decoder.decode(struct.pack("<I", 3)))[0])) == 3
    with pytest.raises(MessageError, match="a pkg/Type has 4 zero-byte elements in its arrays: at most 3"):
        message_decoder.decode(struct.pack("<I", 4))
    with pytest.raises(MessageError, match="they end inside slot x"):
        message_decoder.decode(b"12")


def test_length_beyond_end_of_message_is_an_error() -> None:
    text = "pkg/Text[] x\n" + section("pkg/Text", "string s\n")
    with pytest.raises(MessageError, match="they end inside slot"):
        decoder_of(text).decode(struct.pack("<I", 0xFFFFFFFF) + bytes(64))
