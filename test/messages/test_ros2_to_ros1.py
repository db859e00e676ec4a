"""ROS 2 definitions and CDR messages, compared with the conversion by ``rosbags`` for the types that it supports."""

import struct
from typing import Any, List, Tuple

import pytest
from checked_access import compound, place_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from messages.wire import messages, serialize
from retalis import Definitions, MessageError
from retalis.messages.ros2_to_ros1 import parse_ros2_type
from retalis.prolog.syntax.event_text import to_text

STORE = get_typestore(Stores.LATEST)


def find(kind: str) -> Any:
    name = kind.replace("/", "/msg/")
    return STORE.generate_msgdef(name, ros_version=2)[0] if name in STORE.types else None


def read(text: str, name: str = "my_msgs/msg/Kind", find: Any = find, is_idl: bool = False) -> Any:
    return parse_ros2_type(name, text, find, is_idl)


def slots(message_type: Any) -> List[str]:
    return [f"{slot.describe()} {slot.name}" for slot in message_type.definition.fields]


def decode_text(message_type: Any, raw: bytes) -> Any:
    definitions = Definitions()
    return to_text(definitions.decoder(message_type.definition).decode(message_type.to_ros1(raw)))


def cdr(layout: str, *values: Any, order: str = "<") -> Any:
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + struct.pack(order + layout, *values)


@pytest.mark.parametrize(
    ("line", "slot"),
    [
        ("float64[<=3] dimensions", "float64[] dimensions"),
        ("string<=10 name", "string name"),
        ("string<=10[<=5] names", "string[] names"),
        ("string<=10[5] names", "string[5] names"),
        ("string<=10[] names", "string[] names"),
        ("wstring text", "string text"),
        ("wstring<=4[<=2] texts", "string[] texts"),
        ("byte b", "uint8 b"),
        ("byte[<=9] b", "uint8[] b"),
        ("char c", "char c"),
        ("int32 x 5", "int32 x"),
        ("  int32\tx\t-5  # of them", "int32 x"),
        ("int32 x 5# of them", "int32 x"),
        ('string s "abc"', "string s"),
        ("string s 'it''s # = not'", "string s"),
        ('string s "a=b"', "string s"),
        ("string s abc # def", "string s"),
        ("int32[] x [1, 2, 3]", "int32[] x"),
        ("int32[] x []", "int32[] x"),
        ("float32[<=3] x [1.0, 2]", "float32[] x"),
        ("bool x true", "bool x"),
        ("builtin_interfaces/Time t", "time t"),
        ("builtin_interfaces/msg/Duration[<=2] t", "duration[] t"),
        ("geometry_msgs/msg/Point p", "geometry_msgs/Point p"),
        ("geometry_msgs/Point[<=7] p", "geometry_msgs/Point[] p"),
        ("Header header", "std_msgs/Header header"),
        ("std_msgs/msg/Header header", "std_msgs/Header header"),
    ],
)
def test_slots_are_converted(line: str, slot: str) -> None:
    assert slots(read(f"# a comment\n\n{line}\n")) == [slot]


@pytest.mark.parametrize(
    ("line", "constant"),
    [
        ("int32 X=5", ("int32", "X", 5)),
        ("int32 X = -0x5  # of them", ("int32", "X", -5)),
        ("byte B=200", ("uint8", "B", 200)),
        ("char C = 65", ("char", "C", 65)),
        ("float64 F=1e-3", ("float64", "F", 0.001)),
        ("bool T=true", ("bool", "T", True)),
        ('string S="a # \\"b\\"" # a comment', ("string", "S", 'a # "b"')),
        ("string S='it\\'s'", ("string", "S", "it's")),
        ("string S=plain # a comment", ("string", "S", "plain")),
        ('wstring S="ü"', ("string", "S", "ü")),
    ],
)
def test_constants_are_converted(line: str, constant: Tuple[Any, ...]) -> None:
    (converted,) = read(line).definition.constants
    assert (converted.type, converted.name, converted.value) == constant


def test_constant_out_of_range_is_omitted() -> None:
    message_type = read("int32 X=5 + 5\nint8 Y=128\nint32 x\n")
    assert (message_type.definition.constants, slots(message_type)) == ((), ["int32 x"])


@pytest.mark.parametrize(
    "text",
    [
        "float64<=3 x",
        "int32",
        "int32 x)",
        "int32 5",
        "string<10 x",
        "float64[<3] x",
        "int32[<=] x; y",
        "-",
        "time T=5",
    ],
)
def test_error_in_definition_has_line(text: str) -> None:
    with pytest.raises(MessageError) as error:
        read(f"int32 good\n{text}\n")
    assert place_of(error.value).line == 2


def test_undefined_and_recursive_types_are_errors() -> None:
    with pytest.raises(
        MessageError, match="the type my_msgs/Gone is not defined in the bag or on this system"
    ):
        read("Gone gone")
    with pytest.raises(MessageError, match="my_msgs/Kind contains itself"):
        read("Kind[<=3] kinds")
    with pytest.raises(MessageError, match="x is defined twice"):
        read("int32 x\nint32 x")
    with pytest.raises(MessageError, match="at most 1000000 are allowed"):
        read("#" * (1 << 20) + "\n")


def test_nested_types_are_read_from_text() -> None:
    line = "=" * 80
    text = f"Own[<=2] own\nother_msgs/msg/Own far\n{line}\nMSG: my_msgs/msg/Own\nLone lone\n{line}\n"
    text += f"MSG: other_msgs/Own\nint8 x 1\n{line}\nMSG: third_msgs/Lone\nwstring<=3 w\n"
    message_type = read(text, find=lambda kind: None)
    assert slots(message_type) == ["my_msgs/Own[] own", "other_msgs/Own far"]
    assert decode_text(message_type, cdr("IIIIbxxx", 1, 2, ord("ü"), ord("2"), 7)) == (
        "my_msgs__0__Kind([my_msgs__0__Own(third_msgs__0__Lone('\"ü2\"'))],other_msgs__0__Own(7))"
    )


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
    assert message_type.to_ros1(cdr("B", 0)) == b""
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
        read("string a\nint32[] b\n").to_ros1(raw)


def test_padding_of_three_bytes_is_accepted() -> None:
    message_type = read("int8 a\n")
    assert [message_type.to_ros1(cdr(f"b{number}x", 5)) for number in range(4)] == [b"\5"] * 4
    with pytest.raises(MessageError):
        message_type.to_ros1(cdr("b4x", 5))


KINDS = sorted(STORE.types)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_all_common_types_are_converted_as_by_rosbags(name: Any) -> None:
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
def test_common_types_are_converted_as_by_rosbags(name: str) -> None:
    check_type(name)


def check_type(name: Any) -> None:
    message_type = read(find(name.replace("/msg/", "/")), name)

    @settings(
        deadline=None,
        derandomize=True,
        max_examples=15,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(
        messages(
            message_type.definition,
            st.text(st.characters(blacklist_categories=["Cs", "Cc"]), max_size=9).map(str.encode),
        )
    )
    def every_message(values: Any) -> None:
        raw = serialize(message_type.definition, without_numbers(message_type.definition, values))
        data = bytes(STORE.ros1_to_cdr(raw, name))
        assert message_type.to_ros1(data) == raw
        assert bytes(STORE.cdr_to_ros1(data, name)) == raw

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
    deadline=None, derandomize=True, max_examples=40, suppress_health_check=[HealthCheck.data_too_large]
)
@given(st.lists(st.tuples(st.sampled_from(SLOTS), st.sampled_from(ARRAYS)), max_size=5), st.data())
def test_random_types_are_converted_as_by_rosbags(slots: List[Any], data: st.DataObject) -> None:
    full = {"Empty": "std_msgs/Empty", "Header": "std_msgs/Header"}
    text = "".join(
        f"{full.get(kind, kind)}{array} slot{number}\n" for number, (kind, array) in enumerate(slots)
    )
    message_type = read(text + PARTS)
    store = get_typestore(Stores.LATEST)
    store.register(get_types_from_msg(text + PARTS, "my_msgs/msg/Kind"))
    values = data.draw(
        messages(message_type.definition, st.text(st.characters(whitelist_categories=["L"])).map(str.encode))
    )
    raw = serialize(message_type.definition, without_numbers(message_type.definition, values))
    converted = bytes(store.ros1_to_cdr(raw, "my_msgs/msg/Kind"))
    assert message_type.to_ros1(converted) == raw
    for end in range(len(converted)):
        with pytest.raises(MessageError):
            message_type.to_ros1(converted[:end])


# ---- times before 1970 -------------------------------------------------------------------------------


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
    assert len(message_type.to_ros1(positive)) > 4
    with pytest.raises(MessageError, match="a my_msgs/Kind has a time of -5 s: expected at least 0 s"):
        message_type.to_ros1(negative)


def test_negative_seconds_of_stamp_and_duration() -> None:
    message_type = read("Header header\nbuiltin_interfaces/Duration d\n")
    message = cdr("iIIBxxxiI", 4, 0, 1, 0, -5, 0)
    assert (
        decode_text(message_type, message) == "my_msgs__0__Kind(std_msgs__0__Header(0,[4,0],'\"\"'),[-5,0])"
    )
    with pytest.raises(MessageError, match="has a time of -4 s"):
        message_type.to_ros1(cdr("iIIBxxxiI", -4, 0, 1, 0, -5, 0))


# ---- events of services ------------------------------------------------------------------------------

SERVICE = f"""\
{"=" * 80}
SRV: my_msgs/srv/Go
# where
geometry_msgs/Point goal
Pace pace
---
bool ok
string<=9 reason
{"=" * 80}
MSG: my_msgs/Pace
uint8 FAST=1
uint8 pace
"""


@pytest.mark.parametrize("text", [SERVICE, SERVICE.split("srv/Go\n")[1]])
def test_service_event_has_info_request_and_response(text: Any) -> None:
    message_type = read(text, "my_msgs/srv/Go_Event")
    assert message_type.definition.name == "my_msgs/Go_Event"
    assert slots(message_type) == [
        "service_msgs/ServiceEventInfo info",
        "my_msgs/Go_Request[] request",
        "my_msgs/Go_Response[] response",
    ]
    info = struct.pack("<BxxxiI16s4xq", 2, 4, 5, bytes(range(16)), 7)
    request = decode_text(
        message_type, b"\0\1\0\0" + info + struct.pack("<I4x3dBxxxI", 1, 1.0, 2.0, 3.0, 1, 0)
    )
    gid = to_text(decode_gid(bytes(range(16))))
    head = f"my_msgs__0__Go_Event(service_msgs__0__ServiceEventInfo(2,[4,5],{gid},7)"
    assert request == (
        f"{head},[my_msgs__0__Go_Request(geometry_msgs__0__Point(1.0,2.0,3.0),my_msgs__0__Pace(1))],[])"
    )
    response = decode_text(message_type, b"\0\1\0\0" + info + struct.pack("<IIBxxxI3s", 0, 1, 1, 3, b"no\0"))
    assert response == f"{head},[],[my_msgs__0__Go_Response(true,'\"no\"')])"


def decode_gid(gid: bytes) -> Any:
    """Return the term of a byte array."""
    definitions = Definitions()
    array = definitions.add("my_msgs/Gid", "char[16] gid")
    return compound(definitions.decoder(array).decode(gid))[1]


def test_empty_request_of_service_has_a_byte() -> None:
    message_type = read("---\nbool ok\n", "my_msgs/srv/Stop_Event")
    info = struct.pack("<BxxxiI16s4xq", 0, 4, 5, bytes(16), 7)
    raw = b"\0\1\0\0" + info + struct.pack("<IBxxxI", 1, 0, 0)
    assert decode_text(message_type, raw).endswith(",[my_msgs__0__Stop_Request],[])")


@pytest.mark.parametrize("text", ["int8 x\n", "---\n---\n"])
def test_service_without_one_separator_is_an_error(text: str) -> None:
    with pytest.raises(MessageError, match="service my_msgs/Go has [02] lines '---': expected one, between"):
        read(text, "my_msgs/srv/Go_Event")


# ---- IDL ---------------------------------------------------------------------------------------------


def test_nested_types_in_idl_are_read_from_text() -> None:
    line = "=" * 80
    text = (
        f'{line}\nIDL: p/msg/A\n// generated\n#include "p/msg/B.idl"\n'
        "module p { module msg { struct A { p::msg::B b; std_msgs::msg::Header header; }; }; };\n"
        f"\n{line}\nIDL: p/msg/B\nmodule p {{ module msg {{ struct B {{ double x; }}; }}; }};\n"
    )
    message_type = read(text, "p/msg/A", is_idl=True)
    assert slots(message_type) == ["p/B b", "std_msgs/Header header"]
    assert decode_text(message_type, cdr("diIIs", 1.5, 4, 5, 1, b"\0")) == (
        "p__0__A(p__0__B(1.5),std_msgs__0__Header(0,[4,5],'\"\"'))"
    )


def test_service_event_has_types_in_idl() -> None:
    line = "=" * 80
    text = (
        f"{line}\nSRV: p/srv/Go\np/B b\n---\n{line}\nIDL: p/msg/B\n"
        "module p { module msg { struct B { double x; }; }; };\n"
    )
    message_type = read(text, "p/srv/Go_Event")
    assert slots(message_type)[1] == "p/Go_Request[] request"
    (request,) = [
        nested for nested in message_type.definition.dependencies() if nested.name == "p/Go_Request"
    ]
    assert request.fields[0].type == "p/B"


def test_error_in_idl_names_line_of_whole_text() -> None:
    line = "=" * 80
    text = (
        f"{line}\nSRV: p/srv/Go\np/B b\n---\n{line}\nIDL: p/msg/B\nmodule p {{ struct B {{ double }}; }};\n"
    )
    with pytest.raises(MessageError) as error:
        read(text, "p/srv/Go_Event")
    assert (place_of(error.value).line, place_of(error.value).column) == (7, 30)


def test_odd_constant_of_ros2_is_ignored_with_warning(caplog: pytest.LogCaptureFixture) -> None:
    message_type = read("uint8 K=0\nuint8 K=0\nint8 x\n")
    assert slots(message_type) == ["int8 x"]
    (record,) = caplog.records
    assert record.getMessage() == "my_msgs/Kind: 'K' is defined twice: the constant is ignored"
