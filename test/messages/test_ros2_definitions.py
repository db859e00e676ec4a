"""Definitions of ROS 2 in ROS 1 form."""

import struct
from typing import Any, List, Tuple

import pytest
from asserting_accessors import compound, place_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from messages.reference_wire_format import messages, serialize
from messages.ros2_types import cdr, decode_text
from messages.ros2_types import read_type as read
from retalis import Definition, Definitions, MessageError
from retalis.messages.cdr_decoder import CdrDecoder
from retalis.messages.cdr_encoder import CdrEncoder
from retalis.messages.ros2_definitions import ACTION_SYNTAX, Interface, format_ros2_text, ros2_type_name
from retalis.messages.type_definition import HEADER, PRIMITIVES
from retalis.messages.type_registry import InstalledTypes
from retalis.prolog.syntax.event_text import to_text


def slots(definition: Definition) -> List[str]:
    return [f"{slot.describe()} {slot.name}" for slot in definition.fields]


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
    (converted,) = read(line).constants
    assert (converted.type, converted.name, converted.value) == constant


def test_constant_out_of_range_is_omitted() -> None:
    message_type = read("int32 X=5 + 5\nint8 Y=128\nint32 x\n")
    assert (message_type.constants, slots(message_type)) == ((), ["int32 x"])


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
    assert message_type.name == "my_msgs/Go_Event"
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


def test_service_with_two_separators_is_an_error() -> None:
    with pytest.raises(MessageError, match="service my_msgs/Go has 2 lines '---': expected one, between"):
        read("---\n---\n", "my_msgs/srv/Go_Event")


@pytest.mark.parametrize("suffix", ["Request", "Response"])
def test_request_and_response_are_types_of_service(suffix: str) -> None:
    slots_by_suffix = {"Request": ["int8 x"], "Response": ["bool ok"]}
    assert slots(read("int8 x\n---\nbool ok\n", f"my_msgs/srv/Go_{suffix}")) == slots_by_suffix[suffix]


def test_definition_of_event_itself_is_read() -> None:
    """Some recorders store the derived definition in place of the file of the service."""
    text = (
        "service_msgs/msg/ServiceEventInfo info\nmy_msgs/srv/Go_Request[<=1] request\n"
        f"my_msgs/srv/Go_Response[<=1] response\n{'=' * 80}\nMSG: my_msgs/srv/Go_Request\nint8 x\n"
        f"{'=' * 80}\nMSG: my_msgs/srv/Go_Response\nbool ok\n"
    )
    message_type = read(text, "my_msgs/srv/Go_Event")
    assert slots(message_type) == slots(read("int8 x\n---\nbool ok\n", "my_msgs/srv/Go_Event"))


# ---- types of actions --------------------------------------------------------------------------------

ACTION = "int32 order\n---\nint32[] sequence\n---\nint32[] partial_sequence\n"


@pytest.mark.parametrize(
    ("suffix", "expected"),
    [
        ("Goal", ["int32 order"]),
        ("Result", ["int32[] sequence"]),
        ("Feedback", ["int32[] partial_sequence"]),
        ("FeedbackMessage", ["unique_identifier_msgs/UUID goal_id", "my_msgs/Fib_Feedback feedback"]),
        ("SendGoal_Request", ["unique_identifier_msgs/UUID goal_id", "my_msgs/Fib_Goal goal"]),
        ("SendGoal_Response", ["bool accepted", "time stamp"]),
        ("GetResult_Request", ["unique_identifier_msgs/UUID goal_id"]),
        ("GetResult_Response", ["int8 status", "my_msgs/Fib_Result result"]),
        (
            "GetResult_Event",
            [
                "service_msgs/ServiceEventInfo info",
                "my_msgs/Fib_GetResult_Request[] request",
                "my_msgs/Fib_GetResult_Response[] response",
            ],
        ),
    ],
)
@pytest.mark.parametrize("heading", ["", f"{'=' * 80}\nACTION: my_msgs/action/Fib\n"])
def test_types_of_action_are_derived(heading: str, suffix: str, expected: List[str]) -> None:
    message_type = read(heading + ACTION, f"my_msgs/action/Fib_{suffix}")
    assert (message_type.name, slots(message_type)) == (f"my_msgs/Fib_{suffix}", expected)


def test_feedback_of_action_is_decoded() -> None:
    message_type = read(ACTION, "my_msgs/action/Fib_FeedbackMessage")
    raw = b"\0\1\0\0" + b"0123456789abcdef" + struct.pack("<Iii", 2, 1, 1)
    assert decode_text(message_type, raw) == (
        "my_msgs__0__Fib_FeedbackMessage(unique_identifier_msgs__0__UUID('\"0123456789abcdef\"'),"
        "my_msgs__0__Fib_Feedback([1,1]))"
    )


@given(st.lists(st.text(alphabet="ab- #\n\t"), min_size=1, max_size=5))
def test_definition_of_action_has_three_parts(parts: List[str]) -> None:
    has_other_separators = any(line.strip() == "---" for part in parts for line in part.splitlines())
    assume(not has_other_separators)
    action = Interface("lab/Dock", ACTION_SYNTAX)
    text = "\n---\n".join(parts)
    if len(parts) != 3:
        with pytest.raises(MessageError, match=f"has {len(parts) - 1} lines '---'"):
            action.split(text)
        return
    texts = action.split(text)
    definitions = [texts[f"lab/Dock_{name}"].rstrip("\n") for name in ("Goal", "Result", "Feedback")]
    assert definitions == [part.rstrip("\n") for part in parts]


def test_action_without_two_separators_is_an_error() -> None:
    with pytest.raises(
        MessageError, match="action my_msgs/Fib has 1 lines '---': expected two, between goal,"
    ):
        read("---\n", "my_msgs/action/Fib_Feedback")


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
    (request,) = [nested for nested in message_type.dependencies() if nested.name == "p/Go_Request"]
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


# ---- writing -----------------------------------------------------------------------------------------


def test_definition_is_written_in_syntax_of_ros2() -> None:
    text = (
        'string QUOTED=say "hi"\nbyte LOW=-1\nbool ON=True\nfloat32 RATE=010.50\nint8 lower=1\n'
        "Header header\ntime at\nduration[] waits\nfloat64[9] K\nstring D\nstring d\n"
    )
    definition = Definitions().add("my_msgs/Kind", text)
    line = "=" * 80
    assert format_ros2_text(definition) == (
        'string QUOTED="say \\"hi\\""\nbyte LOW=255\nbool ON=true\nfloat32 RATE=10.5\n'
        "std_msgs/Header header\nbuiltin_interfaces/Time at\nbuiltin_interfaces/Duration[] waits\n"
        "float64[9] k\nstring D\nstring d\n"
        f"{line}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        f"{line}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        f"{line}\nMSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
    )


def test_wide_strings_are_written() -> None:
    assert format_ros2_text(read("wstring[] names\n")) == "wstring[] names\n"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("std_msgs/String", "std_msgs/msg/String"),
        ("tf/tfMessage", "tf2_msgs/msg/TFMessage"),
        ("lab/Go_Event", "lab/srv/Go_Event"),
        ("lab/Dock_SendGoal_Request", "lab/action/Dock_SendGoal_Request"),
    ],
)
def test_names_are_those_of_ros2(name: str, expected: str) -> None:
    assert ros2_type_name(name) == expected


PARTS = f"""
{"=" * 80}
MSG: my_msgs/Inner
Header header
uint8 x
string[] names
Nothing[2] nothings
float64 K
{"=" * 80}
MSG: my_msgs/Nothing
{"=" * 80}
MSG: {HEADER}
uint32 seq
time stamp
string frame_id
"""


# A `byte` of ROS 2 has no sign, so arrays of it are texts.
SLOT_TYPES = st.tuples(
    st.sampled_from(
        [*sorted({*PRIMITIVES} - {"byte"}), "string", "time", "duration", "Header", "Inner", "Nothing"]
    ),
    st.sampled_from(["", "", "[]", "[3]"]),
).map("".join)


def limit_values(definition: Definition, values: List[Any]) -> List[Any]:
    """Replace the values that a message of ROS 2 cannot have: times after 2038, and `seq`."""

    def limit(slot: Any, value: Any) -> Any:
        if slot.definition is not None:
            return limit_values(slot.definition, value)
        return [value[0] % 2**31, value[1]] if slot.type == "time" else value

    limited = [
        limit(slot, value) if slot.length is None or slot.is_bytes else [limit(slot, item) for item in value]
        for slot, value in zip(definition.fields, values)
    ]
    return [0, *limited[1:]] if definition.name == HEADER else limited


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.lists(SLOT_TYPES, max_size=6), st.data())
def test_random_types_survive_round_trip(slot_types: List[str], data: st.DataObject) -> None:
    text = "".join(f"{slot_type} slot{number}\n" for number, slot_type in enumerate(slot_types))
    registry = Definitions(InstalledTypes([], [], include_rosbags=False))
    definition = registry.add("my_msgs/Kind", f"{text}{PARTS}")
    message = serialize(definition, limit_values(definition, data.draw(messages(definition))))
    converted = read(format_ros2_text(definition), ros2_type_name(definition.name), lambda name: None)
    cdr_message = CdrEncoder(definition).encode(registry.decoder(definition).decode(message))
    term = CdrDecoder(converted).decode(cdr_message)
    assert registry.encoder(definition).encode(term) == message
    assert CdrEncoder(converted).encode(term) == cdr_message
