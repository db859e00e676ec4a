"""Message definitions: slots, constants, checksums, errors, and limits."""

import re
from hashlib import md5
from keyword import iskeyword
from pathlib import Path
from typing import Any, Callable, List, Tuple

import pytest
from asserting_accessors import fail
from message_registries import empty_registry, section
from reachable_objects import reachable

from retalis import Definitions, MessageError
from retalis.messages.type_definition import (
    MAX_MESSAGE_BYTES,
    MAX_SLOTS,
    MAX_TYPE_DEPTH,
    VARIABLE_LENGTH,
    Measure,
    functor_name,
    parse,
    split_sections,
    type_name,
)
from retalis.messages.type_registry import InstalledTypes

HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"


def read(text: str, name: str = "pkg/Type") -> Any:
    return empty_registry().add(name, text)


def error_of(text: str) -> Any:
    with pytest.raises(MessageError) as error:
        read(text)
    return error.value


def test_slots_have_name_type_and_length() -> None:
    definition = read("# a comment\n\nfloat64 x # metres\nint32[]  many\nuint8[4] four\r\n\tstring name\n")
    assert [(slot.name, slot.type, slot.length) for slot in definition.fields] == [
        ("x", "float64", None),
        ("many", "int32", VARIABLE_LENGTH),
        ("four", "uint8", 4),
        ("name", "string", None),
    ]
    assert [slot.describe() for slot in definition.fields] == ["float64", "int32[]", "uint8[4]", "string"]


def test_constants_have_name_and_value() -> None:
    definition = read(
        "int8 LOW=-128\nuint8 MASK = 0x1F # bits\nfloat32 HALF=0.5\nbool YES=True\n"
        "string NAME= it's # not a comment \n"
    )
    assert [(c.name, c.value) for c in definition.constants] == [
        ("LOW", -128),
        ("MASK", 31),
        ("HALF", 0.5),
        ("YES", True),
        ("NAME", "it's # not a comment"),
    ]
    assert definition.fields == ()


def test_checksum_is_that_of_ros() -> None:
    assert read(HEADER, "std_msgs/Header").md5sum == "2176decaecbce78abc3b96ef049fabed"
    assert read("string data\n", "std_msgs/String").md5sum == "992ce8a1687cec8c8bd883ec73ca41d1"
    assert read("", "std_msgs/Empty").md5sum == "d41d8cd98f00b204e9800998ecf8427e"
    text = "geometry_msgs/Vector3  linear\ngeometry_msgs/Vector3  angular\n"
    vector = "=" * 80 + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
    assert read(text + vector, "geometry_msgs/Twist").md5sum == "9f195f881246fdfa2798d1d3eebca84a"


def test_checksum_includes_constants_but_no_comments() -> None:
    plain = read("int32 x\nint32 Y=1\n")
    assert read("# why\nint32   x # what\n int32 Y = 1 # how\n").md5sum == plain.md5sum
    assert read("int32 x\nint32 Y=2\n").md5sum != plain.md5sum


def test_header_is_type_of_std_msgs() -> None:
    text = "Header header\n" + "=" * 80 + "\nMSG: std_msgs/Header\n" + HEADER
    assert read(text).fields[0].type == "std_msgs/Header"
    assert read(text.replace("Header header", "roslib/Header header")).md5sum == read(text).md5sum


def test_nested_type_of_own_package_is_preferred() -> None:
    text = "Point p\n" + "=" * 80 + "\nMSG: pkg/Point\nint8 x\n" + "=" * 80 + "\nMSG: other/Point\nint16 x\n"
    assert read(text).fields[0].type == "pkg/Point"


def test_nested_type_of_other_package_is_found() -> None:
    text = "Point p\n" + "=" * 80 + "\nMSG: geometry_msgs/Point\nfloat64 x\n"
    assert read(text).fields[0].type == "geometry_msgs/Point"


def test_full_text_has_same_definition() -> None:
    text = "Header header\nInner[] all\n" + "=" * 80 + "\nMSG: pkg/Inner\nHeader header\n" + "=" * 80
    definition = read(text + "\nMSG: std_msgs/Header\n" + HEADER)
    again = read(definition.full_text)
    assert again.md5sum == definition.md5sum
    assert [nested.name for nested in again.dependencies()] == ["std_msgs/Header", "pkg/Inner"]


@pytest.mark.parametrize(
    ("text", "message", "line", "column"),
    [
        ("int32 x\nnonsense\n", "expected 'type name' or 'type NAME=value', found 'nonsense'", 2, 1),
        ("int32 x y\n", "expected 'type name' or 'type NAME=value', found 'int32 x y'", 1, 1),
        ("int32 x\n  int32 x\n", "x is defined twice", 2, 9),
        ("int32 1x\n", "expected a name of ASCII letters", 1, 7),
        ("int32 x\nother/Thing thing\n", "no definition of the message type other/Thing", 2, 1),
        ("Thing[] things\n", "no definition of the message type pkg/Thing", 1, 1),
        ("int32[x] y\n", "expected 'type name'", 1, 1),
    ],
)
def test_error_has_place(text: str, message: str, line: int, column: int) -> None:
    error = error_of(text)
    assert message in error.message
    assert (error.place.source, error.place.line, error.place.column) == ("pkg/Type", line, column)


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("uint8 K=256", "2:9: '256' is not a value of type uint8: expected an integer from 0 to 255"),
        ("float32 F=one", "2:11: 'one' is not a value of type float32: expected a number"),
        ("bool K=2", "2:8: '2' is not a value of type bool: expected True, False, 1 or 0"),
        ("time T=3", "2:1: a constant cannot be of type time: expected bool, string, or a type of integers"),
        ("uint8 OK=1", "2:7: OK is defined twice"),
        ("uint8 _K=1", "2:7: expected a name of ASCII letters"),
        (f"uint8 X={'9' * 100_000}", "2:9: '9999"),
    ],
)
def test_odd_constant_is_ignored_with_warning(
    caplog: pytest.LogCaptureFixture, line: str, problem: str
) -> None:
    definition = read(f"uint8 OK=0\n{line}\nint8 x\n")
    assert [constant.name for constant in definition.constants] == ["OK"]
    assert [slot.name for slot in definition.fields] == ["x"]
    (record,) = caplog.records
    assert record.getMessage().startswith(f"pkg/Type:{problem}")
    assert record.getMessage().endswith(": the constant is ignored")
    assert len(record.getMessage()) < 1000


def test_ignored_constants_count_for_checksum() -> None:
    definition = read("uint8 K = 0\nuint8 K = 0  # again\nfloat64 x\n")
    # md5 of the lines "uint8 K=0", "uint8 K=0", "float64 x", as genmsg computes it.
    assert definition.md5sum == md5(b"uint8 K=0\nuint8 K=0\nfloat64 x").hexdigest()
    assert definition.renamed("pkg/Other").md5sum == definition.md5sum
    assert definition.as_event("name").md5sum == definition.md5sum
    assert read(definition.full_text).md5sum == definition.md5sum


def test_odd_constants_of_type_give_one_warning(caplog: pytest.LogCaptureFixture) -> None:
    section = "=" * 80 + "\nMSG: pkg/Inner\nbool B=2\nint8 y\n"
    read(f"uint8 _K=1\nuint8 _L=1\nInner inner\n{section}")
    (record,) = caplog.records
    assert record.getMessage().endswith(": this and 2 more constants are ignored")


def test_error_in_nested_type_names_it() -> None:
    error = error_of("Inner inner\n" + "=" * 80 + "\nMSG: pkg/Inner\nint32 x\nfloat y\n")
    assert str(error.place) == "pkg/Inner:2:1"


def test_recursive_type_is_refused() -> None:
    assert "pkg/Type contains itself" in error_of("Type inner\n").message


def test_lone_surrogate_is_refused() -> None:
    error = error_of("int32 x\nstring X=a\ud800")
    assert (error.place.line, error.place.column) == (2, 11)


def test_malformed_section_is_refused() -> None:
    assert "expected 'MSG: pkg/Type'" in error_of("int32 x\n" + "=" * 80 + "\nint32 y\n").message
    assert "expected 'MSG: pkg/Type'" in error_of("int32 x\n" + "=" * 80 + "\n").message
    both = "int32 x\n" + ("=" * 80 + "\nMSG: a/B\nint8 {}\n") * 2
    assert "a/B is defined twice with different contents" in error_of(both.format("x", "y")).message
    assert len(split_sections("pkg/Type", both.format("x", "x"))) == 2


@pytest.mark.parametrize("name", ["Type", "pkg/", "pkg/a/b", "1pkg/Type", ""])
def test_invalid_type_name_is_refused(name: str) -> None:
    with pytest.raises(MessageError, match="expected a message type"):
        parse(name, "int8 x\n", lambda written, package: fail(written))


def test_functor_name_denotes_type() -> None:
    assert functor_name("geometry_msgs/Pose") == "geometry_msgs__0__Pose"
    assert type_name("geometry_msgs__0__Pose") == "geometry_msgs/Pose"
    assert type_name("tf") is None


TOO_LARGE = {
    "digits": ("uint8[" + "9" * 5000 + "] x\n", "an array cannot have more than 4294967295 elements"),
    "length": ("uint8 y\nuint8[4294967295] x\n", "a message cannot have more than 4294967295 bytes"),
    "product": (
        "pkg/A[100000] a\n" + section("pkg/A", "pkg/B[100000] b\n") + section("pkg/B", "float64 x\n"),
        "a message cannot have more than 4294967295 bytes",
    ),
    "slots": ("".join(f"int8 x{n}\n" for n in range(80_000)), "more than 10000 slots"),
    "constants": ("".join(f"int8 X{n}=1\n" for n in range(60_000)), "more than 10000 constants"),
    "doubled": (
        "pkg/T0 t\n" + "".join(section(f"pkg/T{n}", f"pkg/T{n + 1} a\npkg/T{n + 1} b\n") for n in range(40))
        + section("pkg/T40", "int8 x\n"),
        "more than 10000 slots",
    ),
    "deep": (
        "pkg/T0 t\n" + "".join(section(f"pkg/T{n}", f"pkg/T{n + 1} a\n") for n in range(900))
        + section("pkg/T900", "int8 x\n"),
        "types cannot be nested more than 50 deep",
    ),
    "itself": ("pkg/A a\n" + section("pkg/A", "pkg/B b\n") + section("pkg/B", "pkg/A[] a\n"), "contains itself"),
    "types": ("".join(section(f"pkg/T{n}", "int8 x\n") for n in range(2000)), "more than 1000 types"),
    "text": ("# " + "x" * 1_000_000, "has 1000002 characters: at most 1000000 are allowed"),
    "name": ("int8 " + "x" * 1000 + "\n", "longer than 255 characters"),
    "line": ("? " * 100_000, "expected 'type name'"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "reason"), TOO_LARGE.values(), ids=TOO_LARGE)
def test_definition_beyond_limit_is_refused(text: Any, reason: Any) -> None:
    error = error_of(text)
    assert reason in str(error)
    assert len(str(error)) < 1000


def test_recursive_installed_types_are_refused(tmp_path: Path) -> None:
    for name, other in (("A", "B"), ("B", "A")):
        folder = tmp_path / "pkg" / "msg"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.msg").write_text(f"C c\n{section('pkg/C', f'pkg/{other} x')}\n")
    definitions = Definitions(InstalledTypes([str(tmp_path)], [], include_rosbags=False))
    for _ in range(2):
        with pytest.raises(MessageError, match="contains itself"):
            definitions.find("pkg/A")


def test_sibling_types_add_no_depth() -> None:
    names = [f"pkg/Part{number}" for number in range(MAX_TYPE_DEPTH + 5)]
    text = "".join(f"{name} slot{number}\n" for number, name in enumerate(names))
    definition = read(text + "".join(section(name, "int8 x\n") for name in names))
    assert (len(definition.fields), definition.measure.depth) == (MAX_TYPE_DEPTH + 5, 2)


@pytest.mark.slow
def test_largest_types_are_decoded_and_encoded() -> None:
    definitions = empty_registry()
    wide = definitions.add("pkg/Wide", "".join(f"int8 x{n}\n" for n in range(10_000)))
    deep = definitions.add(
        "pkg/T0",
        "pkg/T1 a\n"
        + "".join(section(f"pkg/T{n}", f"pkg/T{n + 1} a\n") for n in range(1, 49))
        + section("pkg/T49", "int8[4] x\n"),
    )
    for definition, data in ((wide, bytes(10_000)), (deep, bytes(4))):
        term = definitions.decoder(definition).decode(data)
        assert definitions.encoder(definition).encode(term) == data


@pytest.mark.slow
def test_number_of_stored_definitions_is_bounded() -> None:
    definitions = empty_registry()
    for number in range(3000):
        definitions.decoder(
            definitions.add("pkg/Type", f"int8 x{number}\npkg/N{number} n\n" + section(f"pkg/N{number}", ""))
        )
    assert max(map(len, reachable(definitions, dict))) <= 1000
    assert definitions.known("pkg/N0") is not None
    assert [number for number in range(1, 3000) if definitions.known(f"pkg/N{number}") is not None] == []
    for number in range(999):
        definitions.add(f"pkg/T{number}", "int8 x\n")
    with pytest.raises(MessageError, match="pkg/More is not added: 1000 message types"):
        definitions.add("pkg/More", "int8 x\n")
    assert definitions.add("pkg/T5", "int8 x\n") is definitions.find("pkg/T5")


@pytest.mark.parametrize(
    ("text", "column", "part"),
    [
        (f"uint8[{' ' * 100_000}", 1, "expected 'type name'"),
        (f"{' ' * 100_000}uint8 1x", 100_007, "expected a name"),
    ],
    ids=["array", "indent"],
)
def test_long_blanks_are_scanned_once(text: str, column: int, part: str) -> None:
    error = error_of(text)
    assert error.place.column == column
    assert part in error.message


def test_measure_beyond_limit_is_reported() -> None:
    cases: List[Tuple[Callable[[int], Measure], int]] = [
        (lambda count: Measure(slot_count=count), MAX_SLOTS),
        (lambda depth: Measure(depth=depth), MAX_TYPE_DEPTH),
        (lambda size: Measure(min_size=size), MAX_MESSAGE_BYTES),
    ]
    for create, limit in cases:
        assert create(limit).exceeded_limit() == ""
        assert str(limit) in create(limit + 1).exceeded_limit()


@pytest.mark.parametrize(
    ("text", "measure"),
    [
        ("", Measure()),
        ("int8 a\nfloat64 b", Measure(min_size=9, slot_count=2, depth=1)),
        ("time t\nduration[2] d", Measure(min_size=24, slot_count=2, depth=1)),
        ("string s", Measure(min_size=4, is_fixed_size=False, slot_count=1, depth=1)),
        ("string[3] s", Measure(min_size=12, is_fixed_size=False, slot_count=1, depth=1)),
        ("int16[] a\nint8[3] b", Measure(min_size=7, is_fixed_size=False, slot_count=2, depth=1)),
        ("Part p", Measure(min_size=3, slot_count=4, depth=2)),
        ("Part[2] p", Measure(min_size=6, slot_count=4, depth=2)),
        ("Part[] p", Measure(min_size=4, is_fixed_size=False, slot_count=4, depth=2)),
        ("Nothing n", Measure(slot_count=1, depth=1)),
        (
            "Nothing[5] n\nNothing[2] m",
            Measure(slot_count=2, depth=1, empty_element_count=7, may_have_empty_elements=True),
        ),
        (
            "Nothing[] n",
            Measure(min_size=4, is_fixed_size=False, slot_count=1, depth=1, may_have_empty_elements=True),
        ),
        (
            "Bare[2] b",
            Measure(min_size=2, slot_count=3, depth=2, empty_element_count=6, may_have_empty_elements=True),
        ),
        ("int8[0] a", Measure(slot_count=1, depth=1)),
    ],
)
def test_measure_counts_sizes_slots_and_depth(text: str, measure: Any) -> None:
    parts = {"Part": "int16 a\nint8 b\nNothing n", "Nothing": "", "Bare": "Nothing[3] n\nint8 a"}
    more = "".join(f"\n{'=' * 80}\nMSG: my_robot/{name}\n{part}" for name, part in parts.items())
    definitions = Definitions()
    definition = definitions.decoder(definitions.add("my_robot/Thing", text + more)).definition
    assert definition.measure == measure


def slots_of_rosbags(text: Any) -> Any:
    """Return the slots that rosbags reads from the definition of ``pkg/Type``; None if it rejects the text."""
    from rosbags.interfaces import Nodetype  # noqa: PLC0415
    from rosbags.typesys import TypesysError, get_types_from_msg  # noqa: PLC0415

    try:
        _, fields = get_types_from_msg(text, "pkg/msg/Type")["pkg/msg/Type"]
    except TypesysError:
        return None
    slots: List[Any] = []
    node: Any
    content: Any
    for name, (node, content) in fields:
        length = None
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            length = content[1] if node == Nodetype.ARRAY else VARIABLE_LENGTH
            node, content = content[0]
        slot_type = content[0] if node == Nodetype.BASE else content.replace("/msg/", "/")
        # The names of bytes and of slots that are keywords depend on the version of rosbags.
        slot_type = {"octet": "byte", "char": "uint8"}.get(slot_type, slot_type)
        slot_type = re.sub("builtin_interfaces/(Time|Duration)", lambda match: match[1].lower(), slot_type)
        slots.append((name[:-1] if name.endswith("_") and iskeyword(name[:-1]) else name, slot_type, length))
    return slots


def slots_of(definition: Any) -> List[Tuple[Any, ...]]:
    return [
        (slot.name, slot.type.replace("char", "uint8") if slot.definition is None else slot.type, slot.length)
        for slot in definition.fields
    ]


def test_slots_agree_with_rosbags() -> None:
    pytest.importorskip("rosbags")
    from messages.codec_comparison import rosbags_types  # noqa: PLC0415

    types = 0
    for _, _, definition in rosbags_types():
        assert slots_of(definition) == slots_of_rosbags(definition.text), definition.name
        types += 1
    assert types > 200


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("int32 x 5", "expected 'type name'"),
        ("string<=5 x", "expected 'type name'"),
        ("int32[<=3] x", "expected 'type name'"),
        ("uint8[-3] x", "expected 'type name'"),
        ("int32 x\nint32 x", "x is defined twice"),
    ],
)
def test_definition_refused_by_ros_is_refused(text: str, reason: str) -> None:
    pytest.importorskip("rosbags")
    assert reason in error_of(text).message
    assert slots_of_rosbags(text) is not None


@pytest.mark.parametrize("text", ["float32 X=0.50", "int32 X=010"])
def test_checksum_of_rosbags_differs_for_numerals(text: str) -> None:
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, "pkg/msg/Type"))
    assert store.generate_msgdef("pkg/msg/Type", ros_version=1)[1] != read(text).md5sum
