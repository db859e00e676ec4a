"""Encoding of event terms into CDR."""

from typing import Optional

import pytest

from messages.ros2_types import cdr, decode_text
from messages.ros2_types import read_type as read
from retalis import Definition, MessageError, Operators
from retalis.messages.cdr_encoder import CdrEncoder
from retalis.prolog.syntax.term_reader import read_term


def encode(definition: Definition, text: str) -> bytes:
    return CdrEncoder(definition).encode(read_term(text, Operators.prolog()).term, "topic")


@pytest.mark.parametrize(
    ("slots", "arguments", "message"),
    [
        ("string s\nint8 a\nfloat64 b", "'\"hi\"',-1,0.5", cdr("I3sb d", 3, b"hi\0", -1, 0.5)),
        ("int8 a\nfloat64[] b\nint32 c", "1,[],2", cdr("bxxxIi", 1, 0, 2)),
        ("int8 a\nfloat64[] b\nint16 c", "1,[0.5,1],2", cdr("bxxxI2dh", 1, 2, 0.5, 1.0, 2)),
        ("uint8[] a\nuint16 b", "'\"abc\"',7", cdr("I3sxH", 3, b"abc", 7)),
        ("uint8[3] a\nuint16 b", "'\"abc\"',7", cdr("3sxH", b"abc", 7)),
        (
            "bool[2] a\nstring[] b",
            "[true,false],['\"x\"','\"\"']",
            cdr("??xxII2sxxI1s", 1, 0, 2, 2, b"x\0", 1, b"\0"),
        ),
        ("Header h", "std_msgs__0__Header(9,[4,5],'\"m\"')", cdr("iII2s", 4, 5, 2, b"m\0")),
        ("string s\nstd_msgs/Empty e", "'\"a\"',std_msgs__0__Empty", cdr("I2sx", 2, b"a\0")),
        ("std_msgs/Empty e\nint8 a", "std_msgs__0__Empty,7", cdr("xb", 7)),
        ("std_msgs/Empty[] e\nint8 a", "[std_msgs__0__Empty,std_msgs__0__Empty],7", cdr("I2xb", 2, 7)),
        ("wstring w\nint8 a", "'\"aü\"',7", cdr("I2Ib", 2, ord("a"), ord("ü"), 7)),
        ("builtin_interfaces/Time t", "[2147483647,999999999]", cdr("iI", 2**31 - 1, 999_999_999)),
        ("builtin_interfaces/Duration t", "[-5,0]", cdr("iI", -5, 0)),
    ],
)
def test_slots_are_aligned(slots: str, arguments: str, message: bytes) -> None:
    definition = read(slots)
    assert encode(definition, f"my_msgs__0__Kind({arguments})") == message
    assert encode(definition, decode_text(definition, message)) == message


@pytest.mark.parametrize(
    ("slots", "unusual", "usual"),
    [
        ("string s\nint8 a", '"text",1', "'\"text\"',1"),
        ("bool b\nfloat64 x", "1,inf", "true,inf"),
        ("builtin_interfaces/Time t", "datime(1970,1,1,0,0,5,1)", "[5,1]"),
        ("uint8[] a\nint8 b", "[1,2,3],4", None),
    ],
)
def test_unusual_forms_are_encoded(slots: str, unusual: str, usual: Optional[str]) -> None:
    definition = read(slots)
    message = encode(definition, f"my_msgs__0__Kind({unusual})")
    if usual is not None:
        assert message == encode(definition, f"my_msgs__0__Kind({usual})")
    assert encode(definition, decode_text(definition, message)) == message


@pytest.mark.parametrize(
    ("slots", "arguments", "reason"),
    [
        ("int8 a", "200", "topic topic, my_msgs/Kind, slot a: expected int8 from -128 to 127, got 200"),
        ("string s", "f(x)", "slot s: expected a string, got f/1"),
        ("float64[2] a", "[1]", r"slot a: expected 2 elements \(float64\[2\]\), got 1"),
        ("Header h", "7", "slot h: expected std_msgs__0__Header/3, got 7"),
        (
            "builtin_interfaces/Time t",
            "[2147483648,0]",
            "topic topic, my_msgs/Kind: expected a time before 2038-01-19, the last one of ROS 2",
        ),
        ("wstring w", "'\"FFFFFFFFFF/w==////\"'", "topic topic, my_msgs/Kind: a wide string is not UTF-8"),
    ],
)
def test_error_names_topic_and_slot(slots: str, arguments: str, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        encode(read(slots), f"my_msgs__0__Kind({arguments})")
