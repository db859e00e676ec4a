"""Decoding of CDR, compared with rosbags for the types that it supports."""

import struct
from contextlib import suppress
from typing import Any, List, Tuple

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from messages.reference_wire_format import messages, serialize
from messages.ros2_types import STORE, cdr, decode_text, find_text, to_ros1
from messages.ros2_types import read_type as read
from retalis import Definitions, MessageError
from retalis.messages.cdr_decoder import CdrDecoder
from retalis.messages.cdr_encoder import CdrEncoder
from retalis.prolog.syntax.event_text import to_text
from retalis.prolog.terms.types import Lazy


def test_numbers_are_aligned() -> None:
    message_type = read(
        "string s\nint8 a\nfloat64 b\nint8 c\nint16 d\nint8 e\nint32 f\nint64[] g\nint16[<=3] h\nint8 i\n"
    )
    for text in ("", "a", "ab", "abc", "abcd", "abcde", "abcdef", "abcdefg"):
        raw = bytearray(struct.pack("<I", len(text) + 1) + text.encode() + b"\0")
        for code, value in (*zip("bdbhbi", (1, 2.5, -3, -4, 5, -6)), ("I", 2), ("q", -7), ("q", 8)):
            size = struct.calcsize(code)
            raw += bytes(-len(raw) % size) + struct.pack(f"<{code}", value)
        raw += struct.pack("<Ib", 0, 9)
        assert (
            decode_text(message_type, b"\0\1\0\0" + raw)
            == f"my_msgs__0__Kind('\"{text}\"',1,2.5,-3,-4,5,-6,[-7,8],[],9)"
        )


def test_empty_array_has_no_alignment_of_elements() -> None:
    message_type = read("int32 a\nfloat64[] b\nint32 c\n")
    assert decode_text(message_type, cdr("iIi", 1, 0, 2)) == "my_msgs__0__Kind(1,[],2)"


def test_byte_is_unsigned() -> None:
    message_type = read("byte a\nchar b\nbyte[3] c\n")
    assert decode_text(message_type, cdr("BB3s", 200, 201, b"abc")) == "my_msgs__0__Kind(200,201,'\"abc\"')"


def test_type_without_slots_has_a_byte() -> None:
    message_type = read("int8 X=1\n", "my_msgs/msg/Nothing")
    assert to_ros1(message_type, cdr("B", 0)) == b""
    text = f"Nothing one\nNothing[] more\nint8 x\n{'=' * 80}\nMSG: my_msgs/Nothing\n"
    assert decode_text(read(text), cdr("BxxxIBBb", 0, 2, 0, 0, 7)) == (
        "my_msgs__0__Kind(my_msgs__0__Nothing,[my_msgs__0__Nothing,my_msgs__0__Nothing],7)"
    )


@pytest.mark.parametrize("text", ["", "Jürgen", "日本", "🤖 two units", "a" * 30])
@pytest.mark.parametrize("width", [2, 4])
@pytest.mark.parametrize("order", ["<", ">"])
def test_wide_strings_are_converted(text: str, width: int, order: str) -> None:
    message_type = read("int8 a\nwstring<=30 b\nint8 c\n")
    coded = text.encode("utf-16-le")
    units = struct.unpack(f"<{len(coded) // 2}H", coded)
    raw = cdr(f"bxxxI{len(units)}{'H' if width == 2 else 'I'}b", 1, len(units), *units, 2, order=order)
    assert decode_text(message_type, raw) == f"my_msgs__0__Kind(1,'\"{text}\"',2)"


def test_lone_surrogate_in_wide_string_is_binary() -> None:
    message_type = read("wstring a\n")
    assert decode_text(message_type, cdr("II", 1, 0xD800)) == "my_msgs__0__Kind('\"FFFFFFFFFF7aCA////\"')"


def test_big_endian_is_converted() -> None:
    message_type = read("int8 a\nfloat64 b\nstring c\nuint16[] d\nuint8[] e\nfloat64[10] f\n")
    values = (1, 2.5, 3, b"hi\0", 2, 0x102, 0x304, 1, b"x")
    raw = bytearray(cdr("b7xdI3sxIHHI1s", *values, order=">"))
    raw += bytes(-(len(raw) - 4) % 8) + struct.pack(">10d", *range(10))
    floats = ",".join(str(float(number)) for number in range(10))
    assert (
        decode_text(message_type, bytes(raw))
        == f"my_msgs__0__Kind(1,2.5,'\"hi\"',[258,772],'\"x\"',[{floats}])"
    )


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", "is not plain CDR: expected 00 00 or 00 01 at its beginning, found nothing"),
        (b"\0\1\0", "is not plain CDR"),
        (b"\0\3\0\0" + bytes(9), "found 00 03"),
        (cdr(""), "0 bytes of CDR are not a my_msgs/Kind"),
        (cdr("I", 2), "4 bytes of CDR are not a my_msgs/Kind"),
        (cdr("I2sxxI", 3, b"hi", 1), "are not a"),
        (cdr("I3sxI", 3, b"hi\0", 2**32 - 1), "are not a"),
        (cdr("I3sxIi", 3, b"hi\0", 0, 7), "are not a"),
        (cdr("I", 2**32 - 1), "are not a"),
    ],
)
def test_invalid_message_is_an_error(raw: Any, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        CdrDecoder(read("string a\nint32[] b\n")).decode(raw)


def test_padding_of_three_bytes_is_accepted() -> None:
    message_type = read("int8 a\n")
    assert [to_ros1(message_type, cdr(f"b{number}x", 5)) for number in range(4)] == [b"\5"] * 4
    with pytest.raises(MessageError):
        to_ros1(message_type, cdr("b4x", 5))


def test_bytes_reserved_for_empty_arrays_are_ignored() -> None:
    message_type = read("int32 a\nfloat64[] b\nfloat64[] c\nint32 d\n")
    message = cdr("iIIi", 1, 0, 0, 2)
    assert [decode_text(message_type, message + size * b"x") for size in (0, 8)] == [
        "my_msgs__0__Kind(1,[],[],2)"
    ] * 2
    with pytest.raises(MessageError, match="100 bytes of CDR are not a"):
        decode_text(message_type, message + 84 * b"x")


KINDS = sorted(STORE.types)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_messages_of_all_types_equal_those_of_rosbags(name: Any) -> None:
    check_type(name)


@pytest.mark.parametrize(
    "name",
    [
        "std_msgs/msg/Header",
        "std_msgs/msg/Empty",
        "tf2_msgs/msg/TFMessage",
        "sensor_msgs/msg/PointCloud2",
        "shape_msgs/msg/SolidPrimitive",
        "visualization_msgs/msg/Marker",
        "diagnostic_msgs/msg/DiagnosticArray",
        "nav_msgs/msg/Odometry",
        "builtin_interfaces/msg/Time",
    ],
)
def test_messages_of_common_types_equal_those_of_rosbags(name: str) -> None:
    check_type(name)


def check_type(name: Any) -> None:
    message_type = read(find_text(name.replace("/msg/", "/")) or "", name)

    @settings(
        deadline=None,
        derandomize=True,
        max_examples=15,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(
        messages(
            message_type,
            st.text(st.characters(blacklist_categories=["Cs", "Cc"]), max_size=9).map(str.encode),
        )
    )
    def every_message(values: Any) -> None:
        raw = serialize(message_type, without_numbers(message_type, values))
        data = bytes(STORE.ros1_to_cdr(raw, name))
        assert to_ros1(message_type, data) == raw
        decoder = CdrDecoder(message_type)
        stamp = Definitions().decoder(message_type).stamp
        assert decoder.stamp(data) == stamp(raw)
        # The byte of a type without slots has any value.
        if message_type.fields:
            assert CdrEncoder(message_type).encode(decoder.decode(data)) == data

    every_message()


def without_numbers(definition: Any, values: Any) -> Any:
    """Return values with 0 as the number in headers, which ROS 2 does not have, and with times before 2038."""
    values = list(values)
    for index, slot in enumerate(definition.fields):
        if slot.type == "time" and slot.length is None:
            values[index] = [values[index][0] % 2**31, values[index][1]]
        elif slot.type == "time":
            values[index] = [[seconds % 2**31, nanoseconds] for seconds, nanoseconds in values[index]]
        elif slot.definition is not None and slot.length is None:
            values[index] = without_numbers(slot.definition, values[index])
        elif slot.definition is not None:
            values[index] = [without_numbers(slot.definition, value) for value in values[index]]
    if definition.name == "std_msgs/Header":
        values[0] = 0
    return values


ARRAYS = ("", "", "[]", "[<=3]", "[2]", "[9]")
SLOTS = (
    "bool",
    "int8",
    "uint16",
    "int32",
    "float32",
    "int64",
    "float64",
    "string",
    "Pair",
    "Mixed",
    "Empty",
    "Header",
)
PARTS = f"""
{"=" * 80}
MSG: my_msgs/Pair
int16 a
int16[2] b
{"=" * 80}
MSG: my_msgs/Mixed
string a
Pair[] b
int8 c
"""


@pytest.mark.slow
@settings(
    deadline=None, derandomize=True, max_examples=12, suppress_health_check=[HealthCheck.data_too_large]
)
@given(st.lists(st.tuples(st.sampled_from(SLOTS), st.sampled_from(ARRAYS)), max_size=5), st.data())
def test_messages_of_random_types_equal_those_of_rosbags(slots: List[Any], data: st.DataObject) -> None:
    full = {"Empty": "std_msgs/Empty", "Header": "std_msgs/Header"}
    text = "".join(
        f"{full.get(kind, kind)}{array} slot{number}\n" for number, (kind, array) in enumerate(slots)
    )
    message_type = read(text + PARTS)
    store = get_typestore(Stores.LATEST)
    store.register(get_types_from_msg(text + PARTS, "my_msgs/msg/Kind"))
    values = data.draw(
        messages(message_type, st.text(st.characters(whitelist_categories=["L"])).map(str.encode))
    )
    raw = serialize(message_type, without_numbers(message_type, values))
    converted = bytes(store.ros1_to_cdr(raw, "my_msgs/msg/Kind"))
    assert to_ros1(message_type, converted) == raw
    for end in range(len(converted)):
        with pytest.raises(MessageError):
            to_ros1(message_type, converted[:end])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("text", "layout", "values"),
    [
        ("builtin_interfaces/Time t\nint8 x\n", "iIb", [(-5, 0, 1), (5, 0, 1)]),
        ("int8 x\nint64 y\nbuiltin_interfaces/Time t\n", "b7xqiI", [(1, -1, -5, 9), (1, -1, 5, 9)]),
        ("builtin_interfaces/Time[2] t\n", "iIiI", [(1, 0, -5, 0), (1, 0, 5, 0)]),
        ("builtin_interfaces/Time[] t\n", "IiIiI", [(2, 1, 0, -5, 0), (2, 1, 0, 5, 0)]),
        ("wstring w\nbuiltin_interfaces/Time t\n", "IiI", [(0, -5, 0), (0, 5, 0)]),
    ],
)
def test_negative_seconds_of_time_are_an_error(
    order: str, text: str, layout: str, values: List[Tuple[Any, ...]]
) -> None:
    message_type = read(text)
    negative, positive = (cdr(layout, *numbers, order=order) for numbers in values)
    assert len(to_ros1(message_type, positive)) > 4
    with pytest.raises(MessageError, match="a my_msgs/Kind has a time of -5 s: expected at least 0 s"):
        to_ros1(message_type, negative)


def test_negative_seconds_of_stamp_and_duration() -> None:
    message_type = read("Header header\nbuiltin_interfaces/Duration d\n")
    message = cdr("iIIBxxxiI", 4, 0, 1, 0, -5, 0)
    assert (
        decode_text(message_type, message) == "my_msgs__0__Kind(std_msgs__0__Header(0,[4,0],'\"\"'),[-5,0])"
    )
    with pytest.raises(MessageError, match="has a time of -4 s"):
        to_ros1(message_type, cdr("iIIBxxxiI", -4, 0, 1, 0, -5, 0))


@pytest.mark.parametrize("tail", ["float64 x\nint8 y", "int8 y\nfloat64 x", "int8 y", "string z", ""])
@pytest.mark.parametrize("order", ["<", ">"])
def test_layouts_with_cached_strings_are_decoded(tail: str, order: str) -> None:
    """Types of numbers, then strings, then numbers have a function of their own."""
    message_type = read(f"int16 n\nstring a\nstring b\n{tail}\n")
    for first in ("", "a", "abc", "abcdefgh"):
        for second in ("", "xy", "xyz"):
            raw = bytearray(struct.pack(order + "h2x", 7))
            texts = [first, second, *(["zz"] if "string z" in tail else [])]
            for text in texts:
                raw += bytes(-len(raw) % 4)
                raw += struct.pack(f"{order}I", len(text) + 1) + text.encode() + b"\0"
            values = []
            for line in tail.splitlines():
                code, value = {"float64 x": ("d", 0.5), "int8 y": ("b", -3)}.get(line, ("", 0))
                if code:
                    size = struct.calcsize(code)
                    raw += bytes(-len(raw) % size) + struct.pack(order + code, value)
                    values.append(str(value))
            quoted = [f"'\"{text}\"'" for text in texts]
            message = cdr("", order=order) + bytes(raw)
            expected = f"my_msgs__0__Kind({','.join(['7', *quoted, *values])})"
            # The second time from the cache.
            assert [decode_text(message_type, message) for _ in range(2)] == [expected] * 2
            for end in range(len(message)):
                with pytest.raises(MessageError):
                    CdrDecoder(message_type).decode(message[:end])


def test_message_is_decoded_on_first_access() -> None:
    message_type = read("std_msgs/Header header\nuint8[] data\n", name="my_msgs/msg/Image")
    message = cdr("iIIBxxxI4s", 5, 6, 1, 0, 4, b"data")
    term = CdrDecoder(message_type).lazy(message)
    assert isinstance(term, Lazy)
    assert to_text(term) == "my_msgs__0__Image(std_msgs__0__Header(0,[5,6],'\"\"'),'\"data\"')"
    truncated = CdrDecoder(message_type).lazy(message[:-1])
    with pytest.raises(MessageError, match="23 bytes of CDR are not a my_msgs/Image"):
        to_text(truncated)


@settings(deadline=None)
@given(st.binary(max_size=120))
def test_any_bytes_are_a_message_or_an_error(data: bytes) -> None:
    message_type = read("Header header\nstring[] names\nfloat64[] values\nwstring[2] wide\nHeader[] more\n")
    for message in (data, b"\0\1\0\0" + data, b"\0\0\0\0" + data):
        with suppress(MessageError):
            assert decode_text(message_type, message).startswith("my_msgs__0__Kind(")
