"""Definitions of messages, read by this package and by genmsg. Needs genmsg, no master."""

from typing import Any, Tuple

import pytest

genmsg = pytest.importorskip("genmsg", reason="ROS is not installed")

from genmsg.gentools import compute_md5_text  # noqa: E402
from genmsg.msg_loader import MsgContext, load_msg_from_string  # noqa: E402

from retalis import Definitions, MessageError  # noqa: E402
from retalis.messages.type_registry import InstalledTypes  # noqa: E402


def read(text: Any) -> Tuple[Any, ...]:
    definition = Definitions(InstalledTypes([], [], include_rosbags=False)).add("pkg/Type", text)
    return definition, [(constant.name, constant.value) for constant in definition.constants]


def read_by_genmsg(text: str) -> Tuple[Any, ...]:
    context = MsgContext.create_default()
    specification = load_msg_from_string(context, text, "pkg/Type")
    return specification, compute_md5_text(context, specification)


@pytest.mark.parametrize(
    "text",
    [
        "uint8 mode_on=1",
        "int32 X=010",
        "int32 X = -5 # a comment",
        "float32 X=0.50\nfloat64 Y = 1e-3",
        'string S="a"',
        "string S='x",
        "string V=1.5.2",
        "string S=",
        "string S=a # no comment ",
        "string  NAME  =  x y  ",
        "bool B=True\nbool C=0",
        "int32 x\r\nint32 y\r\n",
        "float64 lambda\nint8 from\nint8 self",
        "byte[] b\nchar[3] c\ntime t\nduration[] d\nstring[2] s",
    ],
)
def test_definition_is_read_as_by_genmsg(text: str) -> None:
    specification, checksum_text = read_by_genmsg(text)
    definition, constants = read(text)
    assert [slot.name for slot in definition.fields] == specification.names
    assert [slot.describe() for slot in definition.fields] == specification.types
    assert constants == [(constant.name, constant.val) for constant in specification.constants]
    lines = [f"{constant.type} {constant.name}={constant.text}" for constant in definition.constants]
    lines += [f"{slot.describe()} {slot.name}" for slot in definition.fields]
    assert "\n".join(lines).strip() == checksum_text


NO_FIELD = "1:1: expected 'type name' or 'type NAME=value', found "


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("int32 x 5", NO_FIELD),
        ("string<=5 x", NO_FIELD),
        ("int32[<=3] x", NO_FIELD),
        ("uint8[-3] x", NO_FIELD),
        ("uint8[0x3] x", NO_FIELD),
        ("int32 x\nint32 x", "2:7: x is defined twice"),
        ("int32 _x", "1:7: expected a name of ASCII letters, "),
        ("@optional\nint32 x", NO_FIELD),
    ],
)
def test_definition_is_rejected_as_by_genmsg(text: str, error: str) -> None:
    with pytest.raises(genmsg.InvalidMsgSpec):
        read_by_genmsg(text)
    with pytest.raises(MessageError) as raised:
        read(text)
    assert str(raised.value).startswith(f"pkg/Type:{error}")


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("uint8 X=256", "2:9: '256' is not a value of type uint8"),
        ("int8 X=-129", "2:8: '-129' is not a value of type int8"),
        ("int32 X=1.5", "2:9: '1.5' is not a value of type int32"),
        ("bool B=maybe", "2:8: 'maybe' is not a value of type bool"),
    ],
)
def test_invalid_constant_is_ignored_with_warning(
    caplog: pytest.LogCaptureFixture, line: str, problem: str
) -> None:
    text = f"int8 OK=1\n{line}\nint32 x\nstring[] names"
    with pytest.raises(genmsg.InvalidMsgSpec):
        read_by_genmsg(text)
    definition, constants = read(text)
    specification, _ = read_by_genmsg(text.replace(f"{line}\n", ""))
    assert [slot.describe() for slot in definition.fields] == specification.types
    assert [slot.name for slot in definition.fields] == specification.names
    assert constants == [(constant.name, constant.val) for constant in specification.constants] == [("OK", 1)]
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    assert record.getMessage().startswith(f"pkg/Type:{problem}: ")
    assert record.getMessage().endswith(": the constant is ignored")
