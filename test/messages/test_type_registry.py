"""Registry of message types: added, installed, generated and received definitions."""

import sys
from pathlib import Path
from typing import Any, Dict, List

import pytest
from message_registries import empty_registry

from retalis import Definitions, MessageError
from retalis.messages.type_registry import GeneratedClass, InstalledTypes

STAMPED = """Header header
Inner inner
================================================================================
MSG: pkg/Inner
int8 x
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""


def write_package(root: Any, name: str, **messages: Any) -> None:
    folder = root / name / "msg"
    folder.mkdir(parents=True)
    (root / name / "package.xml").write_text("<package/>")
    for kind, text in messages.items():
        (folder / f"{kind}.msg").write_text(text)


def test_received_definition_does_not_replace_installed_one() -> None:
    definitions = Definitions()
    installed = definitions.find("tf/tfMessage").md5sum
    forged = Definitions().add("tf/tfMessage", "int32 x\n").md5sum
    received = definitions.received("tf/tfMessage", "tf/tfMessage", "int32 x\n", forged)
    assert received.md5sum == forged
    definitions.received("unknown_msgs/Kind", "tf/tfMessage", "int32 x\n", forged)
    assert definitions.find("tf/tfMessage").md5sum == installed
    assert definitions.received("tf/tfMessage", "tf2_msgs/TFMessage", "", installed).md5sum == installed


def test_received_type_unlike_expected_one_is_refused() -> None:
    definitions = Definitions()
    installed = definitions.find("std_msgs/String").md5sum
    for number in range(1100):  # more than the registry stores
        with pytest.raises(MessageError, match=f"expected std_msgs/String, found my_pkg/Type{number}"):
            definitions.received("std_msgs/String", f"my_pkg/Type{number}", f"int32 x{number}\n", "*")
    assert definitions.find("std_msgs/String").md5sum == installed
    assert "my_pkg/Type1" not in definitions


def test_received_type_is_registered() -> None:
    definitions = Definitions()
    assert definitions.received("my_own/Kind", "my_own/Kind", "int32 x\n", "").name == "my_own/Kind"
    assert "my_own/Kind" in definitions


def test_added_type_is_found_with_nested_types() -> None:
    registry = empty_registry()
    definition = registry.add("pkg/Stamped", STAMPED)
    assert registry.find("pkg/Stamped") is definition
    assert registry.add("pkg/Stamped", STAMPED) is definition
    assert registry.find("pkg/Inner").fields[0].name == "x"
    assert "pkg/Stamped" in registry
    assert "pkg/Other" not in registry


def test_types_are_found_by_ros2_names() -> None:
    registry = empty_registry()
    definition = registry.add("pkg/msg/Stamped", STAMPED.replace("Inner inner", "pkg/msg/Inner inner"))
    assert definition.name == "pkg/Stamped"
    assert definition.md5sum == registry.add("pkg/Stamped", STAMPED).md5sum
    assert registry.find("pkg/msg/Stamped") is registry.find("pkg/Stamped") is definition
    assert registry.encoder("pkg/msg/Inner") is registry.encoder("pkg/Inner")
    assert "pkg/msg/Inner" in registry
    assert registry.known("pkg/msg/Inner") is registry.known("pkg/Inner")


def test_ros2_name_of_received_type_is_shortened() -> None:
    registry = empty_registry()
    assert registry.received("pkg/msg/Stamped", "pkg/Stamped", STAMPED, "*").name == "pkg/Stamped"
    learned = registry.learn("pkg/msg/Other", "pkg/msg/Inner", "int8 x", "*")
    assert (learned.decoder.definition.name, learned.is_replacement) == ("pkg/Other", True)


def test_installed_type_is_found_by_ros2_name() -> None:
    definitions = Definitions()
    assert definitions.misspelt("std_msgs/msg/Strng") == "std_msgs/String"
    assert definitions.find("std_msgs/msg/String") == definitions.find("std_msgs/String")


def test_other_text_for_known_name_is_not_registered() -> None:
    registry = empty_registry()
    first = registry.add("pkg/Type", "int8 x\n")
    second = registry.add("pkg/Type", "int16 x\n")
    assert registry.find("pkg/Type") is first
    assert first.md5sum != second.md5sum
    assert registry.decoder(second).decode(b"\1\0") == registry.decoder(first).decode(b"\1")
    assert registry.decoder("pkg/Type") is registry.decoder(first)
    assert registry.encoder("pkg/Type").definition is first


def test_definition_with_other_checksum_is_refused() -> None:
    registry = empty_registry()
    with pytest.raises(
        MessageError, match="the definition of pkg/Type does not match the messages: its checksum is"
    ):
        registry.add("pkg/Type", "", "123")
    assert "pkg/Type" not in registry
    definition = registry.add("pkg/Type", "int8 x\n", "*")
    assert registry.add("pkg/Type", "int8 x\n", definition.md5sum) is definition


def test_unknown_type_is_an_error() -> None:
    with pytest.raises(MessageError, match="no definition of the message type pkg/Missing"):
        empty_registry().find("pkg/Missing")


def test_installed_types_are_read_once(tmp_path: Path) -> None:
    write_package(tmp_path, "pkg", Outer="other/Inner inner\nOwn own\n", Own="int8 x\n")
    write_package(tmp_path, "other", Inner="float64 y\n")
    registry = Definitions(InstalledTypes([str(tmp_path)], [], include_rosbags=False))
    outer = registry.find("pkg/Outer")
    assert [slot.type for slot in outer.fields] == ["other/Inner", "pkg/Own"]
    assert registry.find("pkg/Outer") is outer


def test_error_in_installed_type_names_file(tmp_path: Path) -> None:
    write_package(tmp_path, "pkg", Bad="int8 x\nint8 x\n")
    with pytest.raises(MessageError) as error:
        Definitions(InstalledTypes([str(tmp_path)], [], include_rosbags=False)).find("pkg/Bad")
    assert str(error.value.place) == f"{tmp_path}/pkg/msg/Bad.msg:2:6"


def test_installed_texts_of_ros2_are_converted(tmp_path: Path) -> None:
    write_package(tmp_path, "builtin_interfaces", Time="int32 sec\nuint32 nanosec\n")
    write_package(tmp_path, "std_msgs", Header="builtin_interfaces/Time stamp\nstring frame_id\n")
    write_package(
        tmp_path, "pkg", Door="std_msgs/Header header\nbool open\n", Wide="string<=5 name\nint8 x -1\n"
    )
    registry = Definitions(InstalledTypes([str(tmp_path)], [], include_rosbags=False))
    header = registry.find("pkg/Door").fields[0].definition
    assert header is not None
    assert [slot.describe() for slot in header.fields] == ["uint32", "time", "string"]
    assert [slot.describe() for slot in registry.find("pkg/Wide").fields] == ["string", "int8"]


def test_error_in_text_of_ros2_names_file(tmp_path: Path) -> None:
    write_package(tmp_path, "pkg", Bad="wstring x\nmissing_msgs/Type y\n")
    with pytest.raises(MessageError, match=r"Bad\.msg: the type missing_msgs/Type is not defined"):
        Definitions(InstalledTypes([str(tmp_path)], [], include_rosbags=False)).find("pkg/Bad")


def test_nested_packages_are_found(tmp_path: Path) -> None:
    write_package(tmp_path / "src" / "stack", "pkg", Type="int8 x\n")
    (tmp_path / "src" / ".hidden").mkdir()
    registry = Definitions(
        InstalledTypes([str(tmp_path / "src"), str(tmp_path / "missing")], [], include_rosbags=False)
    )
    assert registry.find("pkg/Type").fields[0].type == "int8"


def test_folder_of_one_package_is_searched(tmp_path: Path) -> None:
    write_package(tmp_path, "pkg", Type="int8 x\n")
    assert "pkg/Type" in Definitions(InstalledTypes([str(tmp_path / "pkg")], [], include_rosbags=False))


def test_environment_variables_name_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_package(tmp_path / "path", "one", Type="int8 x\n")
    write_package(tmp_path / "prefix" / "share", "two", Type="int16 x\n")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "path"))
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(tmp_path / "prefix"))
    registry = Definitions()
    assert registry.find("one/Type").fields[0].type == "int8"
    assert registry.find("two/Type").fields[0].type == "int16"


def generated_class(text: str, **changes: Any) -> Any:
    """Return the attributes of the class that genpy generates for ``pkg/Type``."""
    definition = empty_registry().add("pkg/Type", text)
    generated = GeneratedClass(
        text,
        definition.md5sum,
        tuple(slot.name for slot in definition.fields),
        tuple(slot.describe() for slot in definition.fields),
        "/somewhere/pkg/msg/_Type.py",
    )
    return generated._replace(**changes)


def types_with_class(
    tmp_path: Path, inspect_class: Any, packages: Any = (), **options: Any
) -> InstalledTypes:
    """Return the installed types, among which ``pkg/Type`` has a generated module."""
    folder = tmp_path / "modules" / "pkg" / "msg"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "_Type.py").write_text("raise SystemExit\n")
    return InstalledTypes(
        packages, [str(tmp_path / "modules")], include_rosbags=False, inspect_class=inspect_class, **options
    )


def test_generated_class_with_module_is_inspected(tmp_path: Path) -> None:
    inspected: List[Any] = []

    def inspect_class(name: Any) -> Any:
        inspected.append(name)
        return generated_class(STAMPED)

    installed = types_with_class(tmp_path, inspect_class)
    registry = Definitions(installed)
    assert registry.find("pkg/Type").fields[1].type == "pkg/Inner"
    assert installed.text("pkg/Type") == (STAMPED, "/somewhere/pkg/msg/_Type.py")
    assert "pkg/Other" not in registry
    assert "antigravity/Type" not in registry
    assert set(inspected) == {"pkg/Type"}
    assert (installed.packages(), installed.types("pkg")) == (["pkg"], ["Type"])
    assert "pkg" not in sys.modules


def test_generated_modules_are_ignored_without_ros(tmp_path: Path) -> None:
    installed = types_with_class(tmp_path, None)
    assert installed.text("pkg/Type") is None
    assert (installed.packages(), installed.types("pkg")) == ([], [])


def test_class_precedes_files_except_extra_folders(tmp_path: Path) -> None:
    write_package(tmp_path / "files", "pkg", Type="int8 file\n")
    write_package(tmp_path / "extra" / "nested", "pkg", Type="int8 extra\n")
    files, extra = str(tmp_path / "files"), str(tmp_path / "extra")

    def slot(*packages: Any, **options: Any) -> str:
        installed = types_with_class(
            tmp_path, lambda name: generated_class("int8 generated\n"), packages, **options
        )
        return Definitions(installed).find("pkg/Type").fields[0].name

    assert slot(files) == "generated"
    assert slot(files, extra_folders=[extra]) == "extra"
    assert slot(files, extra_folders=[str(tmp_path / "files" / "pkg")]) == "file"


def test_failed_import_is_an_error_without_file(tmp_path: Path) -> None:
    def inspect_class(name: Any) -> None:
        raise MessageError(f"{name}: cannot be imported")

    registry = Definitions(types_with_class(tmp_path, inspect_class))
    with pytest.raises(MessageError, match="pkg/Type: cannot be imported"):
        registry.find("pkg/Type")
    assert "pkg/Type" not in registry
    write_package(tmp_path / "files", "pkg", Type="int8 file\n")
    installed = types_with_class(tmp_path, inspect_class, [str(tmp_path / "files")])
    assert Definitions(installed).find("pkg/Type").fields[0].name == "file"


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"md5sum": "0" * 32}, "its checksum is 00000000000000000000000000000000, that of its definition is"),
        ({"slots": ("x", "z")}, "its slots are not those of its definition"),
        ({"slots": ("x",)}, "its slots are not those of its definition"),
        ({"slot_types": ("int8", "uint8[4]")}, "its slots are not those of its definition"),
    ],
)
def test_class_with_other_definition_is_refused(
    tmp_path: Path, changes: Dict[str, Any], problem: str
) -> None:
    generated = generated_class("int8 x\nuint8[3] y\n", **changes)
    with pytest.raises(MessageError, match=problem) as error:
        Definitions(types_with_class(tmp_path, lambda name: generated)).find("pkg/Type")
    assert "/somewhere/pkg/msg/_Type.py: the generated class of pkg/Type" in error.value.message


def test_keyword_slots_and_old_headers_match_class(tmp_path: Path) -> None:
    text = "roslib/Header header\nint8 lambda\nint8 from_\n" + STAMPED[STAMPED.index("=") :]
    generated = generated_class(text)
    changed = {"slots": ("header", "lambda_", "from_"), "slot_types": ("roslib/Header", "int8", "int8")}
    for inspected in (generated, generated._replace(**changed)):
        definition = Definitions(types_with_class(tmp_path, lambda name, it=inspected: it)).find("pkg/Type")
        assert [slot.name for slot in definition.fields] == ["header", "lambda", "from_"]


def test_types_of_rosbags_are_found() -> None:
    pytest.importorskip("rosbags")
    registry = Definitions(InstalledTypes([], []))
    assert registry.find("geometry_msgs/PoseStamped").md5sum == "d3812c3cbc69362b77dc0b19b345f8f5"
    assert registry.find("sensor_msgs/NavSatStatus").md5sum == "331cdbddfa4bc96ffc3b9ad98900a54c"
    assert "pkg/Type" not in registry


def test_type_that_only_ros2_has_is_not_misspelt() -> None:
    pytest.importorskip("rosbags")
    definitions = Definitions(InstalledTypes([], []))
    names = ["geometry_msgs/VelocityStamped", "geometry_msgs/TwistStampd", "geometry_mgs/TwistStamped"]
    similar = "geometry_msgs/TwistStamped"
    assert [definitions.misspelt(name) for name in names] == ["", similar, similar]


def test_types_of_installed_package_are_complete(tmp_path: Path) -> None:
    (tmp_path / "geometry_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "geometry_msgs" / "msg" / "Vector3Stamped.msg").write_text("int32 x\n")
    definitions = Definitions(InstalledTypes([str(tmp_path)], []))
    assert definitions.misspelt("geometry_msgs/VelocityStamped") == "geometry_msgs/Vector3Stamped"


def test_types_of_rosbags_are_listed() -> None:
    pytest.importorskip("rosbags")
    installed = InstalledTypes([], [])
    assert {"geometry_msgs", "sensor_msgs", "std_msgs"} <= set(installed.packages())
    assert {"Point", "Pose"} <= set(installed.types("geometry_msgs"))


@pytest.mark.parametrize("name", ["tf/tfMessage", "tf2_msgs/TFMessage"])
def test_tf_message_is_found_by_both_names(name: str) -> None:
    pytest.importorskip("rosbags")
    definition = Definitions(InstalledTypes([], [])).find(name)
    assert definition.name == name
    assert definition.md5sum == "94810edda583a504dfda3829e70d7eec"


def test_added_types_precede_installed_and_nested_ones(tmp_path: Path) -> None:
    write_package(tmp_path, "pkg", Inner="int64 installed\n", Stamped="int64 installed\n")
    registry = Definitions(InstalledTypes([str(tmp_path)], [], include_rosbags=False))
    registry.add("pkg/Stamped", STAMPED)
    assert registry.find("pkg/Stamped").fields[0].name == "header"
    assert registry.find("pkg/Inner").fields[0].name == "installed"


def test_type_name_with_path_is_not_found(tmp_path: Path) -> None:
    write_package(tmp_path, "pkg", Type="int8 x\n")
    assert InstalledTypes([str(tmp_path / "other")], [], include_rosbags=False).text("../pkg/Type") is None


def test_received_type_uses_matching_definition() -> None:
    registry = empty_registry()
    known = registry.add("pkg/A", "int8 x\n")
    assert registry.received("pkg/A", "pkg/A", "", known.md5sum) is known
    assert registry.received("pkg/A", "other/B", "", known.md5sum) is known
    newer = registry.received("pkg/A", "pkg/A", "int8 x\nint8 y\n", "*")
    assert [slot.name for slot in newer.fields] == ["x", "y"]
    renamed = registry.received("new/C", "other/C", "int8 z\n", "*")
    assert (renamed.name, renamed.fields[0].name) == ("new/C", "z")
    with pytest.raises(MessageError, match="expected pkg/A, found other/D"):
        registry.received("pkg/A", "other/D", "int16 x\n", "*")


# ---- types of services and actions -------------------------------------------------------------------


def add_interface(folder: Path, name: str, text: str) -> None:
    path = folder / "robot" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("robot/Go_Request", ["string target"]),
        ("robot/Go_Event", ["service_msgs/ServiceEventInfo info", "robot/Go_Request[] request"]),
        ("robot/action/Dock_Feedback", ["float32 distance"]),
        (
            "robot/Dock_FeedbackMessage",
            ["unique_identifier_msgs/UUID goal_id", "robot/Dock_Feedback feedback"],
        ),
        ("robot/Dock_SendGoal_Request", ["unique_identifier_msgs/UUID goal_id", "robot/Dock_Goal goal"]),
    ],
)
def test_types_of_installed_interfaces_are_found(tmp_path: Path, name: str, expected: List[str]) -> None:
    add_interface(tmp_path, "srv/Go.srv", "string<=5 target\n---\nbool ok true\n")
    add_interface(tmp_path, "action/Dock.action", "builtin_interfaces/Time at\n---\n---\nfloat32 distance\n")
    definition = Definitions(InstalledTypes([str(tmp_path)], include_rosbags=False)).find(name)
    slots = [f"{slot.describe()} {slot.name}" for slot in definition.fields]
    assert slots[: len(expected)] == expected


def test_error_in_action_names_file(tmp_path: Path) -> None:
    add_interface(tmp_path, "action/Dock.action", "---\n")
    with pytest.raises(
        MessageError, match=r"Dock\.action: the definition of action robot/Dock has 1 lines '---'"
    ):
        InstalledTypes([str(tmp_path)], include_rosbags=False).find("robot/Dock_Feedback")


def test_message_file_precedes_derived_type(tmp_path: Path) -> None:
    add_interface(tmp_path, "action/Dock.action", "---\n---\nfloat32 distance\n")
    add_interface(tmp_path, "msg/Dock_Feedback.msg", "bool near\n")
    installed = InstalledTypes([str(tmp_path)], include_rosbags=False)
    assert Definitions(installed).find("robot/Dock_Feedback").fields[0].name == "near"
