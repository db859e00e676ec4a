"""Inspection of generated message classes. Needs genpy, no master."""

import sys
from pathlib import Path
from typing import Any, Iterator, Optional

import pytest

pytest.importorskip("genpy", reason="ROS is not installed")

from roslib.message import get_message_class  # noqa: E402

from retalis import Definitions, MessageError  # noqa: E402
from retalis.messages.type_registry import InstalledTypes  # noqa: E402
from retalis.ros1.installed_message_classes import inspect_class, installed_types  # noqa: E402

MODULE = """
class {name}:
    _full_text = "int8 lambda\\n"
    _md5sum = "{md5sum}"
    _type = "made_msgs/{name}"
    __slots__ = ["lambda_"]
    _slot_types = ["int8"]
"""
MD5SUM = (
    Definitions(InstalledTypes([], [], include_rosbags=False)).add("made_msgs/Made", "int8 lambda\n").md5sum
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the folder of modules of a package on the module path."""
    folder = tmp_path / "made_msgs" / "msg"
    folder.mkdir(parents=True)
    (tmp_path / "made_msgs" / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "made_msgs"]:
        del sys.modules[name]


def write(folder: Path, name: str, source: str, init: Any = None) -> None:
    (folder / f"_{name}.py").write_text(source)
    (folder / "__init__.py").write_text(f"from ._{name} import {name}\n" if init is None else init)


def registry() -> Definitions:
    return Definitions(installed_types(include_rosbags=False))


def test_installed_type_is_defined_by_its_class() -> None:
    generated = inspect_class("std_msgs/Header")
    message_class = get_message_class("std_msgs/Header")
    assert generated.md5sum == message_class._md5sum == registry().find("std_msgs/Header").md5sum
    assert (generated.slots, generated.slot_types) == (
        ("seq", "stamp", "frame_id"),
        ("uint32", "time", "string"),
    )
    assert generated.source.endswith("/std_msgs/msg/_Header.py")


def test_slot_named_by_keyword_is_read(folder: Path) -> None:
    write(folder, "Made", MODULE.format(name="Made", md5sum=MD5SUM))
    assert registry().find("made_msgs/Made").fields[0].name == "lambda"


@pytest.mark.parametrize(
    ("name", "source", "init", "reason"),
    [
        ("Gone", "import no_such_module\n", None, "No module named 'no_such_module'"),
        ("Old", "print 'for Python 2'\n", None, "Missing parentheses in call to 'print'"),
        ("Raising", "raise RuntimeError('not today')\n", None, "not today"),
        ("Unlisted", "", "", "/made_msgs/msg/__init__.py has no class Unlisted"),
    ],
)
def test_failed_import_is_an_error_with_reason(
    folder: Path, name: str, source: str, init: Optional[str], reason: str
) -> None:
    write(folder, name, source, init)
    with pytest.raises(MessageError) as raised:
        registry().find(f"made_msgs/{name}")
    message = raised.value.message
    assert f"made_msgs/{name}: the generated Python class of this message type cannot be imported" in message
    assert reason in message.replace('"', "'").replace("\\'", "'")
    assert "build its package" in message


def test_names_of_other_modules_are_not_imported() -> None:
    for name in ("antigravity/Type", "this/Zen", "idlelib/String", "std_msgs.msg/String", "os/path"):
        assert name not in registry()
    assert not {"antigravity", "this", "idlelib"} & set(sys.modules)
