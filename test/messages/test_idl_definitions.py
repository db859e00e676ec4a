"""Definitions in IDL, converted to the syntax of ``.msg`` files."""

from typing import Any, List, Sequence

import pytest
from asserting_accessors import place_of
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("lark")

from retalis import MessageError  # noqa: E402
from retalis.messages.idl_definitions import convert_idl  # noqa: E402
from retalis.messages.type_registry import parse_ros2_type  # noqa: E402


def convert(slots: str, before: str = "", name: str = "X") -> List[str]:
    """Return the lines of type ``p/X`` with some slots, after other definitions in its module."""
    text = f"module p {{ module msg {{ {before} struct {name} {{ {slots} }}; }}; }};"
    return convert_idl("p/X", text, ["p/X"])["p/X"].splitlines()


@pytest.mark.parametrize(
    ("slots", "expected"),
    [
        ("boolean a; octet b; char c;", ["bool a", "byte b", "char c"]),
        ("short a; unsigned short b;", ["int16 a", "uint16 b"]),
        ("long a; unsigned long b;", ["int32 a", "uint32 b"]),
        ("long long a; unsigned long long b;", ["int64 a", "uint64 b"]),
        ("int8 a; uint8 b; int64 c; uint64 d;", ["int8 a", "uint8 b", "int64 c", "uint64 d"]),
        ("float a; double b;", ["float32 a", "float64 b"]),
        (
            "string a; string<5> b; wstring c; wstring<2 + 3> d;",
            ["string a", "string b", "wstring c", "wstring d"],
        ),
        ("sequence<double> a; sequence<string<3>, 4> b;", ["float64[] a", "string[] b"]),
        ("sequence<string<3>> a;", ["string[] a"]),
        ("double a[3]; long b[2], c;", ["float64[3] a", "int32[2] b", "int32 c"]),
        ("double a[3][2 * 4];", ["float64[24] a"]),
        ("std_msgs::msg::Header a;", ["std_msgs/msg/Header a"]),
        ("sequence<std_msgs::msg::Header> a;", ["std_msgs/msg/Header[] a"]),
        ("uint8 structure_needs_at_least_one_member;", []),
        ('@unit("m") @default (value=5) @key long a;', ["int32 a"]),
        ('@verbatim (language="comment", text="a { b;" "\\"c\\"") long a;', ["int32 a"]),
        ("long a; // double b;\n/* float c; */ long d;", ["int32 a", "int32 d"]),
        ("\n#pragma a \\\n b\nlong a;", ["int32 a"]),
        (
            "long module_name; long doubled; long uint8_;",
            ["int32 module_name", "int32 doubled", "int32 uint8_"],
        ),
    ],
)
def test_slots_are_converted(slots: str, expected: List[str]) -> None:
    assert convert(slots) == expected


@pytest.mark.parametrize(
    ("before", "slots", "expected"),
    [
        ("typedef double double__9[9];", "double__9 a;", ["float64[9] a"]),
        ("typedef double Row[3];", "Row a[2];", ["float64[6] a"]),
        ("typedef sequence<long> Longs; typedef Longs Others;", "Others a;", ["int32[] a"]),
        ("typedef string Name, Names[2];", "Name a; Names b;", ["string a", "string[2] b"]),
        ("const long N = 1 + 2 * 3;", "double a[N];", ["float64[7] a"]),
        ("const long N = (1 << 4 | 3) % 10 - -2;", "double a[N];", ["float64[11] a"]),
        ("module Sizes { const long N = 0x10; };", "double a[Sizes::N]; double b[msg::Sizes::N];",
         ["float64[16] a", "float64[16] b"]),
        ("enum E { A, B };", "E e; sequence<E> f;", ["uint32 A=0", "uint32 B=1", "uint32 e", "uint32[] f"]),
        ("enum E { @value(5) A, B, };", "E e; double x[B];",
         ["uint32 A=5", "uint32 B=6", "uint32 e", "float64[6] x"]),
        ("@bit_bound(8) enum E { A };", "E e;", ["uint8 A=0", "uint8 e"]),
        ("struct Base { long id; };", "long a;", ["int32 a"]),
        ("union U switch (long) { case 1: case 2: long a; default: double b; };", "long a;", ["int32 a"]),
        ("bitmask M { @position(2) A, B }; bitset S { bitfield<3> a; bitfield<1, long> b; };", "long a;",
         ["int32 a"]),
        ("module X_Constants { const int32 C = -5; };", "long a;", ["int32 C=-5", "int32 a"]),
        ('module X_Constants { const string C = "a\\"b" "c\\\\"; };', "long a;",
         ['string C="a\\"bc\\\\"', "int32 a"]),
        ("module X_Constants { const boolean C = TRUE; const double D = 1.5e3; const long O = 010; };", "long a;",
         ["bool C=True", "float64 D=1500.0", "int32 O=8", "int32 a"]),
        ("module X_Constants { const long C = 1 / 0; };", "long a;", ["int32 a"]),
    ],
)  # fmt: skip
def test_preceding_definitions_are_used(before: str, slots: str, expected: List[str]) -> None:
    assert convert(slots, before) == expected


def test_names_are_searched_from_innermost_scope() -> None:
    text = """
    struct T { long outermost; };
    module p { struct T { long outer; };
      module msg { struct T { long inner; }; struct X { T a; ::p::T b; ::T c; }; }; };
    """
    types = convert_idl("p/X", text, ["p/X"])
    assert types["p/X"].splitlines()[0].startswith("p/T")
    assert parse_ros2_type("p/msg/X", text.replace("::p::T b; ::T c;", ""), lambda name: None, is_idl=True)


def test_slots_of_base_type_are_first() -> None:
    text = "module p { module msg { struct B { long id; }; struct C : B { long x; }; struct X : C { long y; }; }; };"
    assert convert_idl("p/X", text, ["p/X"]) == {"p/X": "int32 id\nint32 x\nint32 y\n"}


def test_only_used_types_are_converted() -> None:
    text = """module p { module msg {
    struct Used { wstring w; }; union Unused switch (long) { case 1: long a; };
    struct Other { Unused u; }; struct X { sequence<Used> used; }; }; };"""
    assert convert_idl("p/X", text, ["p/X"]) == {"p/X": "p/Used[] used\n", "p/Used": "wstring w\n"}


@pytest.mark.parametrize(
    ("slots", "before", "problem"),
    [
        ("U u;", "union U switch (long) { case 1: long a; };", "a slot whose type is a union cannot be read"),
        ("M m;", "bitmask M { A };", "a slot whose type is a bit mask cannot be read"),
        ("F f;", "struct F;", "a slot whose type is a type that is declared but not defined cannot be read"),
        ("map<long, string> m;", "", "a slot whose type is a map cannot be read"),
        ("fixed<5, 2> m;", "", "a slot whose type is a fixed-point number cannot be read"),
        ("long double a;", "", "a slot of type 'long double' cannot be read"),
        ("wchar a;", "", "a slot of type 'wchar' cannot be read"),
        ("sequence<sequence<long>> a;", "", "a sequence of arrays or sequences cannot be read"),
        ("L a[3];", "typedef sequence<long> L;", "an array of sequences cannot be read"),
        ("long a[N];", "", "N is not a constant that the text defines"),
        ("long a[0];", "", "an array has a length that is not a positive integer"),
        ("long a[1.5];", "", "an array has a length that is not a positive integer"),
        ("long a[1 / 0];", "", "the value of an expression is not a number of 64 bits"),
        ("long a[1 << 1000000000];", "", "the value of an expression is not a number of 64 bits"),
        ('long a["b" * 3];', "", "the value of an expression is not a number of 64 bits"),
        ("long a[N];", "const long N = N;", "types and expressions cannot be nested more than 50 deep"),
        ("A a;", "typedef B A; typedef A B;", "types and expressions cannot be nested more than 50 deep"),
        ("long a", "", "its definition in IDL cannot be parsed: expected ',' or ';' or '[', found '}'"),
        ("long a$;", "", "its definition in IDL cannot be parsed: expected ',' or ';' or '[', found '$'"),
        ('@x("a', "", "its definition in IDL cannot be parsed: expected "),
    ],
)  # fmt: skip
def test_unsupported_definition_is_reported_with_place(slots: str, before: str, problem: str) -> None:
    with pytest.raises(MessageError) as error:
        convert(slots, before)
    assert problem in error.value.message
    assert place_of(error.value).line == 1


def test_missing_type_is_reported() -> None:
    with pytest.raises(MessageError, match="its definition in IDL does not define p/X"):
        convert("long a;", name="Y")


def test_incomplete_text_is_reported_at_its_end() -> None:
    with pytest.raises(MessageError, match="found the end") as error:
        convert_idl("p/X", "module p {\n struct X { long a; }", ["p/X"])
    assert place_of(error.value).line == 2


@pytest.mark.parametrize(
    "text",
    [
        "module p { struct X { long a" + "[2]" * 5000 + "; }; };",
        "module p { " + "module p { " * 5000 + "};" * 5001,
        "module p { struct X { " + "sequence<" * 5000 + "long" + ">" * 5000 + " a; }; };",
        "module p { struct X { long a[" + "-(" * 5000 + "1" + ")" * 5000 + "]; }; };",
        "module p { struct X { long a[" + "1+" * 5000 + "1]; }; };",
        "module p { enum E { " + ",".join(f"E{n}" for n in range(3000)) + "};"
        + "".join(f"struct S{n} {{ E e; S{n + 1} s; }};" for n in range(300)) + "struct X { S0 s; }; };",
    ],
    ids=["dimensions", "modules", "sequences", "signs", "sums", "enumerators"],
)  # fmt: skip
def test_deep_and_long_texts_are_refused(text: str) -> None:
    with pytest.raises(MessageError):
        parse_ros2_type("p/X", text, lambda name: None, is_idl=True)


# ---- any definitions ---------------------------------------------------------------------------------

NUMBERS = {
    "long": "int32",
    "unsigned long long": "uint64",
    "double": "float64",
    "octet": "byte",
    "boolean": "bool",
}
ELEMENTS = st.one_of(
    st.sampled_from(sorted(NUMBERS.items())),
    st.integers(1, 9).map(lambda bound: (f"string<{bound}>", "string")),
    st.just(("wstring", "wstring")),
    st.just(("q::msg::Far", "q/msg/Far")),
    st.just(("Near", "p/Near")),
)


def product(lengths: Sequence[int]) -> int:
    return lengths[0] * product(lengths[1:]) if lengths else 1


def with_array(element: Any) -> Any:
    """Return strategies for a slot of an element type: alone, in a sequence, or in an array of any dimensions."""
    idl, msg = element
    dimensions = st.lists(st.integers(1, 4), min_size=1, max_size=3)
    return st.one_of(
        st.just((f"{idl} {{}}", msg)),
        st.sampled_from(["", ", 5"]).map(lambda bound: (f"sequence<{idl}{bound}> {{}}", f"{msg}[]")),
        dimensions.map(
            lambda lengths: (f"{idl} {{}}" + "".join(f"[{n}]" for n in lengths), f"{msg}[{product(lengths)}]")
        ),
    )


@given(st.lists(ELEMENTS.flatmap(with_array), max_size=6), st.sampled_from([" ", "\n", "/* c */", "// d\n"]))
def test_any_slots_are_converted(slots: List[Any], space: Any) -> None:
    members = "".join(f"{idl.format(f'x{number}')};" for number, (idl, _) in enumerate(slots))
    text = f"module p {{ module msg {{ struct Near {{ long a; }}; struct X {{ {members} }}; }}; }};"
    text = text.replace(" ", space)
    lines = convert_idl("p/X", text, ["p/X"])["p/X"].splitlines()
    assert lines == [f"{msg} x{number}" for number, (_, msg) in enumerate(slots)]


@given(st.text(st.sampled_from("ab12 \n{}[]<>();:,=@\"'/*#|+-.\\"), max_size=60))
def test_any_text_is_converted_or_an_error(text: str) -> None:
    message = ""
    try:
        convert(text)
    except MessageError as error:
        message = error.message
    assert len(message) < 1000


# ---- the types of rosbags ----------------------------------------------------------------------------

IDL_NAMES = {"bool": "boolean", "float32": "float", "float64": "double", "byte": "octet"}


def write_idl(name: str, constants: Any, slots: Any) -> str:
    """Return the definition of a type of rosbags in IDL, in the form that ROS 2 generates."""
    package, _, short_name = name.split("/")
    lines = [f'#include "{package}/msg/Other.idl"', f"module {package} {{", "module msg {"]
    lines.append(f"module {short_name}_Constants {{")
    for constant, type_name, value in constants:
        text = (
            f'"{value}"' if isinstance(value, str) else str(value).upper() if value is True else repr(value)
        )
        lines.append(f"const {IDL_NAMES.get(type_name, type_name)} {constant} = {text};")
    lines.append("};")
    members: List[Any] = []
    for slot, (kind, detail) in slots:
        element, length = detail if kind.name in ("ARRAY", "SEQUENCE") else ((kind, detail), 0)
        element_name = element[1] if element[0].name == "NAME" else element[1][0]
        element_name = IDL_NAMES.get(element_name, element_name).replace("/", "::")
        if kind.name == "ARRAY":
            lines.append(f"typedef {element_name} array_of_{slot}[{length}];")
            members.append(f"array_of_{slot} {slot};")
        elif kind.name == "SEQUENCE":
            members.append(f"sequence<{element_name}{f', {length}' if length else ''}> {slot};")
        else:
            members.append(f"{element_name} {slot};")
    lines += [f"struct {short_name} {{", *members, "};", "};", "};"]
    return "\n".join(lines)


@pytest.mark.slow
def test_types_of_rosbags_are_equal_in_idl_and_msg() -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    definitions = getattr(store, "fielddefs", None) or store.FIELDDEFS

    def find(type_name: str) -> Any:
        name = type_name.replace("/", "/msg/")
        return store.generate_msgdef(name, ros_version=2)[0] if name in store.types else None

    count = 0
    for name, (constants, slots) in definitions.items():
        if slots and name.count("/msg/") == 1:
            expected = parse_ros2_type(name, find(name.replace("/msg/", "/")), find)
            converted = parse_ros2_type(name, write_idl(name, constants, slots), find, is_idl=True)
            assert [slot.describe() for slot in converted.fields] == [
                slot.describe() for slot in expected.fields
            ], name
            assert [slot.name for slot in converted.fields] == [slot.name for slot in expected.fields], name
            values = [
                [(item.name, item.value) for item in definition.constants]
                for definition in (converted, expected)
            ]
            assert values[0] == values[1], name
            count += 1
    assert count > 100
