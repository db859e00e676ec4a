"""Installed message types of ROS 2: their definitions in prefixes, and their generated classes."""

from pathlib import Path
from typing import Any

import pytest

from retalis.foundation.errors import MessageError
from retalis.messages.type_definition import SerializationFormat
from retalis.messages.type_registry import Definitions
from retalis.ros2.installed_interfaces import InstalledInterfaces


def add_type(prefix: Path, name: str, text: str) -> None:
    package, _, type_name = name.partition("/")
    folder = prefix / "share" / package / "msg"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{type_name}.msg").write_text(text)


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    add_type(tmp_path, "std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n")
    add_type(
        tmp_path,
        "robot/Bumper",
        "std_msgs/Header header\nstring<=10[<=2] names\nint8 LEFT=1\nint8 side 1\n",
    )
    return tmp_path


def test_definition_has_form_of_ros1(prefix: Path) -> None:
    definition = Definitions(InstalledInterfaces()).find("robot/Bumper")
    assert [(slot.name, slot.describe()) for slot in definition.fields] == [
        ("header", "std_msgs/Header"),
        ("names", "string[]"),
        ("side", "int8"),
    ]


def test_message_is_decoded(prefix: Path) -> None:
    decoder = Definitions(InstalledInterfaces()).decoder("robot/Bumper", SerializationFormat.CDR)
    header = (5).to_bytes(4, "little") + (7).to_bytes(4, "little") + b"\x02\0\0\0a\0\0\0"
    term: Any = decoder.decode(b"\0\1\0\0" + header + bytes(4) + b"\x01")
    assert str(term[0]) == "robot__0__Bumper/3"
    assert term[3] == 1


def test_earlier_prefix_takes_precedence(
    prefix: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    overlay = tmp_path / "overlay"
    add_type(overlay, "robot/Bumper", "bool pressed\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{overlay}:{prefix}")
    definition = Definitions(InstalledInterfaces()).find("robot/Bumper")
    assert [slot.name for slot in definition.fields] == ["pressed"]


def test_packages_are_listed(prefix: Path) -> None:
    interfaces = InstalledInterfaces()
    assert {"robot", "std_msgs"} <= set(interfaces.packages())
    assert interfaces.types("robot") == ["Bumper"]


def test_unknown_nested_type_is_reported_with_file(prefix: Path) -> None:
    add_type(prefix, "robot/Arm", "other/Joint joint\n")
    with pytest.raises(MessageError, match=r"Arm\.msg: .*other/Joint"):
        InstalledInterfaces().find("robot/Arm")


def test_unknown_type_is_not_found(prefix: Path) -> None:
    assert InstalledInterfaces().find("robot/Gripper") is None


def test_class_of_unknown_type_is_refused(prefix: Path) -> None:
    with pytest.raises(MessageError, match="robot/Gripper is not installed"):
        InstalledInterfaces().message_class("robot/Gripper")


def test_class_that_cannot_be_imported_is_refused(prefix: Path) -> None:
    with pytest.raises(MessageError, match="robot/Bumper: the generated Python class"):
        InstalledInterfaces().message_class("robot/Bumper")


def test_module_without_installed_definition_is_not_imported(
    prefix: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "evil").mkdir()
    (tmp_path / "evil" / "__init__.py").write_text("raise SystemExit('imported')")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(MessageError, match="not installed"):
        InstalledInterfaces().message_class("evil/Type")


def test_name_of_ros1_means_type_of_ros2(prefix: Path) -> None:
    with pytest.raises(MessageError, match="tf2_msgs/TFMessage is not installed"):
        InstalledInterfaces().message_class("tf/tfMessage")


# ---- services and actions ----------------------------------------------------------------------------


def test_types_of_action_are_found(prefix: Path) -> None:
    folder = prefix / "share" / "robot" / "action"
    folder.mkdir(parents=True)
    (folder / "Dock.action").write_text("---\n---\nfloat32 distance 1.0\nbuiltin_interfaces/Duration left\n")
    definition = Definitions(InstalledInterfaces()).find("robot/Dock_FeedbackMessage")
    feedback = definition.fields[1].definition
    assert feedback is not None
    assert [slot.describe() for slot in feedback.fields] == ["float32", "duration"]


def test_service_without_events_is_named(
    prefix: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In ROS 2 Humble, services have no events."""
    folder = prefix / "share" / "robot3" / "srv"
    folder.mkdir(parents=True)
    (folder / "Go.srv").write_text("---\n")
    module = tmp_path / "modules" / "robot3" / "srv"
    module.mkdir(parents=True)
    (module.parent / "__init__.py").write_text("")
    (module / "__init__.py").write_text("class Go:\n    Request = 'request'\n")
    monkeypatch.syspath_prepend(str(tmp_path / "modules"))
    assert InstalledInterfaces().message_class("robot3/Go_Request") == "request"
    with pytest.raises(MessageError, match="robot3/Go_Event: services have events in ROS 2 Iron and later"):
        InstalledInterfaces().message_class("robot3/Go_Event")


@pytest.mark.parametrize(
    ("type_name", "expected"),
    [
        ("Dock_Goal", "goal"),
        ("Dock_FeedbackMessage", "feedback message"),
        ("Dock_GetResult_Event", "event of the result"),
        ("Dock_SendGoal_Request", "request"),
    ],
)
def test_class_of_derived_type_is_found(
    prefix: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, type_name: str, expected: str
) -> None:
    folder = prefix / "share" / "robot2" / "action"
    folder.mkdir(parents=True)
    (folder / "Dock.action").write_text("---\n---\n")
    module = tmp_path / "modules" / "robot2" / "action"
    module.mkdir(parents=True)
    (module.parent / "__init__.py").write_text("")
    (module / "__init__.py").write_text(
        "class Dock:\n"
        "    Goal = 'goal'\n"
        "    class Impl:\n"
        "        FeedbackMessage = 'feedback message'\n"
        "        class SendGoalService:\n"
        "            Request = 'request'\n"
        "        class GetResultService:\n"
        "            Event = 'event of the result'\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path / "modules"))
    assert InstalledInterfaces().message_class(f"robot2/{type_name}") == expected
