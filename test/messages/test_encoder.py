"""Encoding of terms to serialized messages, and errors of terms that do not match the type."""

import struct
from functools import partial
from typing import Any, Dict, Iterator, List, Optional, Tuple

import numpy as np
import pytest
from asserting_accessors import compound, required
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from message_registries import empty_registry

from messages.reference_wire_format import messages, serialize
from retalis import (
    Decoder,
    Definition,
    Definitions,
    Encoder,
    MessageError,
    Operators,
    String,
    Var,
    atom,
    deref,
    functor,
    make_list,
)
from retalis.messages.encoder import encode_slot_by_slot, find_fault
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms import timestamps
from retalis.prolog.terms.array_terms import array_term
from retalis.prolog.terms.term_traversal import copy
from retalis.prolog.terms.types import CONS, NIL, Lazy

STAMPED = """\
Header header
Pose pose
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Pose
Point position
float64[4] orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
"""
TYPE = functor("pkg__0__Type", 1)


def encoder(text: str, name: str = "pkg/Type") -> Any:
    registry = empty_registry()
    return registry.encoder(registry.add(name, text)).encode


def encode_slot(kind: str, value: Any, topic: str = "") -> Any:
    return encoder(f"{kind} x\n")((TYPE, value), topic)


def error_of(kind: str, value: Any) -> str:
    with pytest.raises(MessageError) as error:
        encode_slot(kind, value)
    return error.value.message


def pose(**parts: Any) -> Any:
    values: Dict[str, Any] = {
        "seq": 1,
        "stamp": make_list([2, 3]),
        "frame": atom('"odom"'),
        "x": 1.0,
        "y": 2,
        "q": [0.0, 0.0, 0.0, 1.0],
    }
    values.update(parts)
    header = functor("std_msgs__0__Header", 3)(values["seq"], values["stamp"], values["frame"])
    point = functor("geometry_msgs__0__Point", 3)(values["x"], values["y"], 3.0)
    pose = functor("geometry_msgs__0__Pose", 2)(point, make_list(values["q"]))
    return functor("geometry_msgs__0__PoseStamped", 2)(header, pose)


POSE = struct.pack("<IIII4s3d4d", 1, 2, 3, 4, b"odom", 1, 2, 3, 0, 0, 0, 1)


def test_nested_message_is_encoded() -> None:
    assert encoder(STAMPED, "geometry_msgs/PoseStamped")(pose()) == POSE


def test_bound_variables_and_lazy_terms_are_encoded() -> None:
    encode = encoder(STAMPED, "geometry_msgs/PoseStamped")
    var, frame = Var(), Var()
    var.ref = 1.0
    frame.ref = atom('"odom"')
    assert encode(pose(x=var, frame=frame)) == POSE
    whole = Lazy(functor("geometry_msgs__0__PoseStamped", 2), lambda source: pose(), None)
    assert encode(whole) == POSE
    assert encode(pose(stamp=Lazy(CONS, make_list, [2, 3]))) == POSE


@pytest.mark.parametrize("frame", [atom("odom"), String("odom"), atom('"odom"')])
def test_texts_with_and_without_quotes_are_equal(frame: Any) -> None:
    assert encoder(STAMPED, "geometry_msgs/PoseStamped")(pose(frame=frame)) == POSE


@pytest.mark.parametrize(
    ("value", "flag"), [("true", 1), ("false", 0), ("True", 1), ("False", 0), (1, 1), (0, 0)]
)
def test_boolean_is_encoded(value: Any, flag: int) -> None:
    assert encode_slot("bool", atom(value) if isinstance(value, str) else value) == bytes([flag])


def test_floats_are_encoded() -> None:
    assert encode_slot("float64", 3) == struct.pack("<d", 3.0)
    assert encode_slot("float32", 0.1) == struct.pack("<f", 0.1)
    assert encode_slot("float64", float("inf")) == struct.pack("<d", float("inf"))
    assert encode_slot("float64", atom("inf")) == struct.pack("<d", float("inf"))
    assert encode_slot("float64", (functor("-", 1), atom("inf"))) == struct.pack("<d", float("-inf"))
    assert (
        encode_slot("float32", atom("nan"))
        == encode_slot("float32", float("nan"))
        == struct.pack("<f", float("nan"))
    )


def test_times_and_durations_are_encoded() -> None:
    assert encode_slot("time", make_list([2**32 - 1, 0])) == struct.pack("<II", 2**32 - 1, 0)
    assert encode_slot("duration", make_list([-1, 500])) == struct.pack("<ii", -1, 500)
    assert encode_slot("time", timestamps.datime(10**18 + 5)) == struct.pack("<II", 10**9, 5)
    assert encode_slot("time", timestamps.datime6(10**18)) == struct.pack("<II", 10**9, 0)
    assert encode_slot("time[]", make_list([timestamps.lazy_term(7)])) == struct.pack("<III", 1, 0, 7)


def test_arrays_are_encoded() -> None:
    numbers = make_list([1.0, 2.0])
    assert encode_slot("float64[]", numbers) == struct.pack("<I2d", 2, 1, 2)
    assert encode_slot("float64[2]", numbers) == struct.pack("<2d", 1, 2)
    assert encode_slot("float64[6]", make_list(range(6))) == struct.pack("<6d", *range(6))
    assert encode_slot("int8[]", NIL) == struct.pack("<I", 0)
    assert encode_slot("bool[]", make_list([atom("true"), 1, atom("false")])) == struct.pack(
        "<I3?", 3, 1, 1, 0
    )
    assert encode_slot("string[]", make_list([atom('"a"'), String("bc")])) == struct.pack(
        "<II1sI2s", 2, 1, b"a", 2, b"bc"
    )
    assert encode_slot("time[1]", make_list([make_list([1, 2])])) == struct.pack("<II", 1, 2)


def test_byte_array_may_be_text_or_list() -> None:
    assert encode_slot("uint8[]", atom('"abc"')) == struct.pack("<I3s", 3, b"abc")
    assert encode_slot("uint8[]", atom('"FFFFFFFFFFAAEC////"')) == struct.pack("<I3s", 3, b"\0\1\2")
    assert encode_slot("uint8[]", make_list([0, 255])) == struct.pack("<I2B", 2, 0, 255)
    assert encode_slot("uint8[]", NIL) == struct.pack("<I", 0)
    assert encode_slot("uint8[3]", atom('"abc"')) == b"abc"
    assert encode_slot("uint8[2]", make_list([1, 2])) == b"\1\2"


def test_type_without_slots_is_encoded_as_no_bytes() -> None:
    encode = encoder("", "std_msgs/Empty")
    assert encode(atom("std_msgs__0__Empty")) == b""
    with pytest.raises(MessageError, match="expected the atom std_msgs__0__Empty, got the atom other"):
        encode(atom("other"))


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        ("uint8", 256, "slot x: expected uint8 from 0 to 255, got 256"),
        ("int8", -129, "slot x: expected int8 from -128 to 127, got -129"),
        ("char", -1, "slot x: expected char from 0 to 255, got -1"),
        ("int32", 1.5, "slot x: expected int32, got 1.5"),
        ("int64", 2**63, "slot x: expected int64 from"),
        ("int32", atom("a"), "slot x: expected int32, got the atom a"),
        ("float64", atom("a"), "slot x: expected float64, got the atom a"),
        ("float64", String("1"), 'slot x: expected float64, got the string "1"'),
        ("float32", 1e39, "slot x: 1e+39 is too large for float32"),
        ("float64", 10**400, "is too large for float64"),
        ("bool", 2, "slot x: expected bool (true or false), got 2"),
        ("bool", 1.0, "slot x: expected bool (true or false), got 1.0"),
        ("bool", atom("yes"), "slot x: expected bool (true or false), got the atom yes"),
        ("string", 3, "slot x: expected a string, got 3"),
        ("string", NIL, "slot x: expected a string, got an empty list"),
        ("string", atom('"FFFFFFFFFFabc"'), "slot x: expected base64 in lines"),
        ("time", make_list([1]), "slot x: expected time as [Sec,NSec], got a list of 1"),
        ("time", make_list([-1, 0]), "slot x: expected time as [Sec,NSec], Sec from 0 to 4294967295, got -1"),
        ("duration", make_list([1, 2.5]), "slot x: expected duration as [Sec,NSec], got a list of 2"),
        (
            "time",
            timestamps.datime(-1),
            "slot x: expected time as [Sec,NSec], Sec from 0 to 4294967295, got -1",
        ),
        ("duration", timestamps.datime(5), "slot x: expected duration as [Sec,NSec], got datime/7"),
        ("time", 5, "slot x: expected time as [Sec,NSec], got 5"),
        ("float64[3]", make_list([1.0]), "slot x: expected 3 elements (float64[3]), got 1"),
        ("float64[9]", make_list([1.0]), "slot x: expected 9 elements (float64[9]), got 1"),
        ("float64[]", make_list([1.0, atom("b")]), "slot x[1]: expected float64, got the atom b"),
        ("float64[]", 3, "slot x: expected a list (float64[]), got 3"),
        ("string[]", make_list([atom("a"), 3]), "slot x[1]: expected a string, got 3"),
        ("uint8[2]", atom('"abc"'), "slot x: expected 2 elements (uint8[2]), got 3"),
        ("uint8[]", make_list([300]), "slot x[0]: expected uint8 from 0 to 255, got 300"),
        ("uint8[]", 3, "slot x: expected a string or a list (uint8[]), got 3"),
        ("int8", Var(), "slot x: expected int8, got an unbound variable"),
        ("int8", (functor("f", 2), 1, 2), "slot x: expected int8, got f/2"),
    ],
)
def test_value_of_other_type_is_refused(kind: str, value: Any, message: str) -> None:
    assert message in error_of(kind, value)


def test_long_string_is_encoded() -> None:
    assert encode_slot("string", String("x" * 100)) == struct.pack("<I", 100) + b"x" * 100


def test_error_names_topic_type_and_slot() -> None:
    encode = encoder(STAMPED, "geometry_msgs/PoseStamped")
    with pytest.raises(MessageError) as error:
        encode(pose(x=atom("here")), "marker1")
    assert error.value.message == (
        "topic marker1, geometry_msgs/PoseStamped, slot pose.position.x: expected float64, got the atom here"
    )
    with pytest.raises(MessageError) as error:
        encode(pose(q=[0.0, 0.0, Var(), 1.0]))
    assert error.value.message == (
        "geometry_msgs/PoseStamped, slot pose.orientation[2]: expected float64, got an unbound variable"
    )


@pytest.mark.parametrize(
    "term",
    [
        atom("a"),
        3,
        Var(),
        functor("geometry_msgs__0__PoseStamped", 1)(1),
        functor("geometry_msgs__0__Pose", 2)(1, 2),
        make_list([1, 2]),
    ],
)
def test_term_of_other_type_is_refused(term: Any) -> None:
    with pytest.raises(MessageError, match="expected geometry_msgs__0__PoseStamped/2, got"):
        encoder(STAMPED, "geometry_msgs/PoseStamped")(term)


def test_partial_list_is_refused() -> None:
    assert "expected a list (int8[])" in error_of("int8[]", (CONS, 1, Var()))
    assert "expected a list (int8[])" in error_of("int8[]", (CONS, 1, 2))
    tail = Var()
    tail.ref = make_list([2])
    assert encode_slot("int8[]", (CONS, 1, tail)) == struct.pack("<I2b", 2, 1, 2)


PAIR = functor("f", 2)


def conses(end: Any, *items: Any, cell_functor: Any = CONS) -> Any:
    """Return a list with another end than ``[]``, or with cells of another functor."""
    for item in reversed(items):
        end = (cell_functor, item, end)
    return end


@pytest.mark.parametrize(
    ("kind", "values", "expected"),
    [
        ("float64[2]", (1.0, 2.0), "slot x: expected a list (float64[2])"),
        ("int8[1]", (1,), "slot x: expected a list (int8[1])"),
        ("bool[2]", (atom("true"), atom("false")), "slot x: expected a list (bool[2])"),
        ("float64[6]", (1, 2, 3, 4, 5, 6), "slot x: expected a list (float64[6])"),
        ("float64[]", (1.0, 2.0), "slot x: expected a list (float64[])"),
        ("string[]", (atom("a"),), "slot x: expected a list (string[])"),
        ("string[2]", (atom("a"), atom("b")), "slot x: expected a list (string[2])"),
        ("time", (1, 2), "slot x: expected time as [Sec,NSec]"),
        ("duration", (1, 2), "slot x: expected duration as [Sec,NSec]"),
        ("time[1]", (conses(NIL, 1, 2),), "slot x: expected a list (time[1])"),
        ("time[]", (conses(NIL, 1, 2),), "slot x: expected a list (time[])"),
    ],
)
def test_malformed_list_is_refused(kind: str, values: Tuple[Any, ...], expected: str) -> None:
    assert encode_slot(kind, conses(NIL, *values)) != b""
    for end in (atom("end"), 0, Var(), (PAIR, values[0], NIL), String("")):
        assert expected in error_of(kind, conses(end, *values))
    assert expected in error_of(kind, conses(NIL, *values, cell_functor=PAIR))
    assert expected in error_of(
        kind, (CONS, values[0], conses(NIL, *values[1:], values[-1], cell_functor=PAIR))
    )
    longer, shorter = conses(NIL, *values, values[-1]), conses(NIL, *values[:-1])
    if kind.endswith("[]"):
        assert encode_slot(kind, longer)
        assert encode_slot(kind, shorter)
    else:
        expected_length = expected if "[Sec" in expected else f"slot x: expected {len(values)} element"
        assert expected_length in error_of(kind, longer)
        assert expected_length in error_of(kind, shorter)


@pytest.mark.parametrize(
    ("kind", "value", "size"),
    [
        ("uint8[3]", '"abc"', 3),
        ("uint8[2000]", '"' + "a" * 2000 + '"', 2000),
        ("char[1]", '"a"', 1),
        ("uint8[0]", '""', 0),
    ],
)
def test_text_of_other_length_is_refused(kind: str, value: str, size: int) -> None:
    assert encode_slot(kind, atom(value)) == value[1:-1].encode()
    assert f"({kind}), got {size + 1}" in error_of(kind, atom(value[:-1] + 'a"'))
    if size:
        assert f"({kind}), got {size - 1}" in error_of(kind, atom(value[1:-2]))


def test_lazy_array_of_other_type_is_converted() -> None:
    registry = empty_registry()
    names = ("float64[6]", "float64[7]", "float32[6]", "float64[]", "int64[6]")
    types = [registry.add(f"pkg/Type{index}", f"{kind} x\n") for index, kind in enumerate(names)]
    six = compound(registry.decoder(types[0]).decode(struct.pack("<6d", *range(6))))[1]
    terms = [(functor(f"pkg__0__Type{index}", 1), six) for index in range(5)]
    assert isinstance(six, Lazy)
    encode = [registry.encoder(kind).encode for kind in types]
    with pytest.raises(MessageError, match="expected 7 elements"):
        encode[1](terms[1])
    assert encode[2](terms[2]) == struct.pack("<6f", *range(6))
    assert encode[3](terms[3]) == struct.pack("<I6d", 6, *range(6))
    with pytest.raises(MessageError, match=r"slot x\[0\]: expected int64, got 0.0"):
        encode[4](terms[4])
    assert encode[0](terms[0]) == struct.pack("<6d", *range(6))


MIXED = """\
bool flag
int8 small
uint64 large
float32 real
string text
time stamp
duration span
float64[3] three
time[2] two_times
bool[] flags
int16[6] six
string[] names
uint8[] raw
uint8[3] code
Inner inner
Inner[] inners
Nothing nothing
Nothing[2] nothings
================================================================================
MSG: pkg/Inner
int32 x
string[1] name
================================================================================
MSG: pkg/Nothing
"""
MIXED_TYPE = empty_registry().add("pkg/Mixed", MIXED)
DECODE = Decoder(MIXED_TYPE).decode
ENCODE, CHECK = Encoder(MIXED_TYPE).encode, partial(encode_slot_by_slot, MIXED_TYPE)

odd_terms = st.one_of(
    st.sampled_from(
        [NIL, atom("end"), atom("true"), atom("nan"), atom('"FFFFFFFFFF?"'), atom("pkg__0__Nothing")]
    ),
    st.sampled_from([0, 1, -1, 255, 256, -129, 2**31, 2**64, 2**1100, 1.0, 1e39, float("inf")]),
    st.builds(Var),
    st.builds(String, st.text(max_size=4)),
    st.just(conses(NIL, 1, 2)),
    st.just((functor("pkg__0__Inner", 2), 1, conses(NIL, atom("a")))),
    st.just((functor("pkg__0__Nothing", 1), 1)),
)


def paths(term: Any, path: Any = ()) -> Iterator[Any]:
    """Yield the path of argument positions to each part of a term."""
    yield path
    if term.__class__ is tuple:
        for index, part in enumerate(term[1:], 1):
            yield from paths(part, (*path, index))


def replaced(term: Any, path: Any, part: Any) -> Any:
    if not path:
        return part
    return (*term[: path[0]], replaced(term[path[0]], path[1:], part), *term[path[0] + 1 :])


def with_functor(term: Any, path: Any, other: Any) -> Any:
    if not path:
        return (other, *term[1:]) if term.__class__ is tuple else term
    return (*term[: path[0]], with_functor(term[path[0]], path[1:], other), *term[path[0] + 1 :])


def outcome(encode: Any, term: Any) -> Any:
    try:
        return encode(term, "out")
    except MessageError as error:
        return error.message


@pytest.mark.slow
@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_fast_encoder_agrees_with_checking_one(data: st.DataObject) -> None:
    values = data.draw(messages(MIXED_TYPE, st.text("abü", max_size=3).map(str.encode)))
    raw = serialize(MIXED_TYPE, values)
    term = copy(DECODE(raw))
    assert ENCODE(term, "out") == CHECK(term, "out") == raw
    for _ in range(data.draw(st.integers(1, 2))):
        path = data.draw(st.sampled_from(list(paths(term))))
        if data.draw(st.booleans()):
            term = replaced(term, path, data.draw(odd_terms))
        else:
            term = with_functor(
                term, path, data.draw(st.sampled_from([CONS, PAIR, functor("pkg__0__Inner", 2)]))
            )
    assert outcome(ENCODE, term) == outcome(CHECK, term)


def test_undecoded_parts_are_copied() -> None:
    text = "float32[9] a\nfloat64[] b\nuint8[] c\nstring d\n"
    registry = empty_registry()
    definition = registry.add("pkg/Type", text)
    signalling = b"\1\0\xa0\x7f"  # a NaN that no conversion to float preserves
    data = signalling * 9 + struct.pack(
        "<I6dI2000sI2000s", 6, *range(6), 2000, b"c" * 2000, 2000, b"d" * 2000
    )
    term = registry.decoder(definition).decode(data)
    assert registry.encoder(definition).encode(term) == data
    assert all(part.decoded_term is None for part in compound(term)[1:])


ARRAYS = empty_registry().add("pkg/Arrays", "float32[] a\nint16[6] b\nuint8[] c\n")


def fields(array: Any, dtype: str) -> List[Any]:
    """Return an array term and its list."""
    numbers = np.array(array, dtype)
    return [array_term(numbers), make_list(numbers.tolist())]


@pytest.mark.parametrize("encode", [Encoder(ARRAYS).encode, partial(encode_slot_by_slot, ARRAYS)])
@pytest.mark.parametrize("build", [False, True])
def test_array_terms_are_encoded_as_their_lists(encode: Any, build: bool) -> None:
    head = functor("pkg__0__Arrays", 3)
    row, short, data = fields(range(1080), "<f4"), fields(range(6), "<i2"), fields(range(9), "|u1")
    other = fields(range(1080), "<f8"), fields(range(6), "<i8"), fields(range(9), "<i4")
    expected = encode(head(row[1], short[1], data[1]))
    assert expected == struct.pack("<I1080f6hI9B", 1080, *range(1080), *range(6), 9, *range(9))
    for arrays in ((row, short, data), other):
        term = head(*[array for array, _ in arrays])
        if build:
            deref(term[1])
        assert encode(term) == expected
    assert row[0].decoded_term is None or build


def test_array_term_of_other_length_is_refused() -> None:
    term = functor("pkg__0__Arrays", 3)(NIL, array_term(np.arange(7, dtype="<i2")), NIL)
    for encode in (Encoder(ARRAYS).encode, partial(encode_slot_by_slot, ARRAYS)):
        with pytest.raises(MessageError, match="expected 6 elements"):
            encode(term)


def define(text: str) -> Definition:
    """Return the definition of a type with slots."""
    definitions = Definitions()
    return definitions.decoder(definitions.add("my_robot/Thing", text)).definition


PARTS = """\
================================================================================
MSG: my_robot/Part
Nothing[2] n
int8 a
================================================================================
MSG: my_robot/Nothing
"""


@pytest.mark.parametrize(
    ("text", "term", "mismatch"),
    [
        ("uint8 a\nstring b", "my_robot__0__Thing(A, _)", None),
        ("uint8 a\nstring b", "my_robot__0__Thing(256, _)", "expected uint8 from 0 to 255, got 256"),
        ("float64[] a", "my_robot__0__Thing([1.0|_])", None),
        ("float64[2] a", "my_robot__0__Thing([_, x])", "expected float64, got the atom x"),
        ("float64[2] a", "my_robot__0__Thing([_])", "expected 2 elements"),
        ("float64[2] a", "my_robot__0__Thing([_|_])", None),
        ("time t\nduration[] d", "my_robot__0__Thing([_, 1], [[_, 2], _|_])", None),
        ("time t", "my_robot__0__Thing([-1, _])", "Sec from 0 to 4294967295, got -1"),
        (f"Part p\nPart[] q\n{PARTS}", "my_robot__0__Thing(_, [_, my_robot__0__Part(_, A)|_])", None),
        (f"Part p\n{PARTS}", "my_robot__0__Thing(my_robot__0__Part(_, x))", "expected int8, got the atom x"),
        (f"Part p\n{PARTS}", "my_robot__0__Thing(my_robot__0__Part(_))", "Part"),
        ("", "A", None),
        ("", "my_robot__0__Other", "Other"),
    ],
)
def test_mismatch_of_term_with_variables_is_found(text: str, term: str, mismatch: Optional[str]) -> None:
    found_mismatch = find_fault(define(text), read_term(term, Operators.prolog()).term)
    assert found_mismatch is None if mismatch is None else mismatch in required(found_mismatch)


def test_huge_message_is_not_filled() -> None:
    huge = define("uint8[4000000000] a\nuint8 b")
    assert find_fault(huge, (functor("my_robot__0__Thing", 2), Var(), 256)) is None


SLOT_TYPES = ("bool", "int8", "float32", "string", "time", "duration", "Part", "Nothing")


@pytest.mark.parametrize("array", ["", "[]", "[2]"])
@pytest.mark.parametrize("slot_type", SLOT_TYPES)
def test_variable_matches_any_message(slot_type: str, array: str) -> None:
    definition = define(f"{slot_type}{array} a\n{PARTS}")
    assert find_fault(definition, Var()) is None
    assert find_fault(definition, (functor("my_robot__0__Thing", 1), Var())) is None
    assert "Thing" in required(find_fault(definition, (functor("my_robot__0__Thing", 2), Var(), Var())))
    wrong_slot = (functor("my_robot__0__Thing", 1), (functor("f", 1), Var()))
    assert "expected" in required(find_fault(definition, wrong_slot))
