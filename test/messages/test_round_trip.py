"""Round trip from bytes to terms and text, for all installed types and for artificial ones."""

import importlib
import io
from pathlib import Path
from typing import Any, List
from unittest.mock import patch

import pytest
from asserting_accessors import compound
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from message_registries import empty_registry

from messages.reference_wire_format import CODES, messages, serialize, to_term
from retalis import Definitions, Operators
from retalis.messages import encoder
from retalis.messages.message_to_event_text import make_text_writer
from retalis.prolog.syntax.event_text import EventReader, to_text
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.tokenizer import ReadFlags
from retalis.prolog.terms.term_traversal import freeze

INSTALLED = sorted(
    f"{path.parts[-3]}/{path.stem}"
    for root in ("/usr/share", "/opt/ros/noetic/share")
    for path in Path(root).glob("*/msg/*.msg")
)
EVERYTHING = """\
bool flag
int8 a
uint8 b
byte c
char d
int16 e
uint16 f
int32 g
uint32 h
int64 i
uint64 j
float32 k
float64 l
string m
time n
duration o
bool[] flags
bool[2] two_flags
bool[7] seven_flags
uint8[] bytes
uint8[16] sixteen_bytes
char[] chars
byte[] numbers
int64[3] three
float64[36] matrix
float32[] floats
string[] names
string[2] two_names
time[] times
duration[3] durations
Inner inner
Inner[] inners
Inner[2] two_inners
Fixed fixed
Fixed[] fixeds
Fixed[3] three_fixeds
Nothing nothing
Nothing[] nothings
Nothing[2] two_nothings
string last
================================================================================
MSG: test_msgs/Inner
Header header
string[] names
Fixed[] deep
================================================================================
MSG: test_msgs/Fixed
int16 x
time t
float32[9] rotation
uint8[5] code
Nothing nothing
bool b
================================================================================
MSG: test_msgs/Nothing
# no slots
uint8 CONSTANT=1
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""
SHAPES = {
    "texts_at_end": "float64 x\nstring a\nstring b\n",
    "texts_first": "string a\nstring b\nfloat64 x\nduration d\n",
    "one_text": "string a\n",
    "text_between": "uint8 x\nstring a\nfloat64[36] matrix\nbool b\n",
    "numbers": "uint8 x\nfloat64[36] matrix\nbool b\n",
    "texts_apart": "string a\nuint8 x\nstring b\n",
    "stamped": "Header header\nint32 x\n",
    "stamped_array": "Stamped[] all\n",
    "array_then_more": "Stamped[] all\nint8 more\n",
    "array_of_arrays": "Arrays[] all\n",
    "nothing": "",
}
_PARTS = """
================================================================================
MSG: test_msgs/Stamped
Header header
string child
float64 x
================================================================================
MSG: test_msgs/Arrays
Stamped[] all
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""
REGISTRY = Definitions()
WITHOUT_ROS = empty_registry()

brief = settings(
    max_examples=8,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
unicode = st.text(max_size=20).map(str.encode)  # genpy replaces bytes that are no UTF-8
printable = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=12).map(str.encode)


def check_round_trip(definition: Any, registry: Any, raw: Any) -> None:
    """Check that the bytes of a message survive the conversion to a term and to event text."""
    decode, encode = registry.decoder(definition).decode, registry.encoder(definition).encode
    assert encode(decode(raw)) == raw
    term = decode(raw)
    text = to_text(term)
    assert encode(EventReader().read(text)) == raw
    assert encode(term) == raw  # all lazy parts are decoded
    decoded_again = decode(raw)  # its texts are cached
    assert to_text(decoded_again) == text


TEXTS = """\
uint8 number
string one
string two
uint8[] raw
string[] several
"""
SHORT = {"short texts": "int32 number\nstring one\nstring two\n", "all texts": TEXTS}
any_bytes = st.binary(max_size=20) | st.text(max_size=12).map(str.encode)
printable_texts = st.text(st.characters(min_codepoint=0xA0, blacklist_categories=["Cs"]), max_size=12).map(
    str.encode
)
odd_texts = st.sampled_from(
    ["Jürgen", "'", '"', "\\", "\n", "\r", "\t", "\u2028", "\u0085", "ü'\\\n\"", "日本", "🤖"]
)


@pytest.mark.parametrize("shape", SHORT)
def test_texts_agree_for_all_readers_and_writers(shape: str) -> None:
    definition = WITHOUT_ROS.add(f"test_msgs/{shape.title().replace(' ', '')}", SHORT[shape])
    decoder, encode = WITHOUT_ROS.decoder(definition), WITHOUT_ROS.encoder(definition).encode
    write = make_text_writer(decoder)
    reader = EventReader()  # shared, so that texts of known and of new shapes occur
    operators = Operators.prolog()

    @settings(deadline=None, derandomize=True, max_examples=150)
    @given(messages(definition, any_bytes | printable_texts | odd_texts.map(str.encode)))
    def every_message(values: Any) -> None:
        raw = serialize(definition, values)
        term = freeze(decoder.decode(raw))
        text = f"event({write(raw)})"
        assert text == f"event({to_text(decoder.decode(raw))})"
        read_completely = compound(read_term(text, operators, flags=ReadFlags(event_text=True)).term)[1]
        assert freeze(read_completely) == term
        for _ in range(3):
            (_, read) = compound(reader.read(text))
            assert freeze(read) == term
            assert encode(read) == raw
        assert encode(read_completely) == encode(decoder.decode(raw)) == raw

    every_message()


def genpy_class(name: str) -> Any:
    package, kind = name.split("/")
    try:
        return getattr(importlib.import_module(package + ".msg"), kind)
    except (ImportError, AttributeError):
        return None


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", INSTALLED or [pytest.param("", marks=pytest.mark.skip(reason="no ROS messages installed"))]
)
def test_installed_type_survives_round_trip(name: Any) -> None:
    definition = REGISTRY.find(name)
    generated = genpy_class(name)

    @brief
    @given(messages(definition, unicode))
    def every_message(values: Any) -> None:
        raw = serialize(definition, values)
        if generated is not None:
            assert generated._md5sum == definition.md5sum
            buffer = io.BytesIO()
            generated().deserialize(raw).serialize(buffer)
            assert buffer.getvalue() == raw
        check_round_trip(definition, REGISTRY, raw)

    every_message()


@settings(brief, max_examples=5)
@given(st.data())
def test_type_of_all_slots_survives_round_trip(data: st.DataObject) -> None:
    definition = WITHOUT_ROS.add("test_msgs/Everything", EVERYTHING)
    check_round_trip(definition, WITHOUT_ROS, serialize(definition, data.draw(messages(definition))))


@settings(brief, max_examples=5)
@given(st.data())
def test_decoded_term_equals_reference_term(data: st.DataObject) -> None:
    definition = WITHOUT_ROS.add("test_msgs/Everything", EVERYTHING)
    values = data.draw(messages(definition, printable))
    for index, slot in enumerate(definition.fields):
        if slot.is_bytes:
            values[index] = b"x" * len(values[index])
    values = _without_codes(definition, values)
    term = WITHOUT_ROS.decoder(definition).decode(serialize(definition, values))
    assert freeze(term) == freeze(to_term(definition, values))


def _without_codes(definition: Any, values: Any) -> Any:
    """Replace byte arrays, which may not be printable."""
    replaced: List[Any] = []
    for slot, value in zip(definition.fields, values):
        if slot.is_bytes:
            value = b"x" * len(value)
        elif slot.definition is not None and slot.length is None:
            value = _without_codes(slot.definition, value)
        elif slot.definition is not None:
            value = [_without_codes(slot.definition, item) for item in value]
        replaced.append(value)
    return replaced


@pytest.mark.parametrize("shape", SHAPES)
def test_message_layout_survives_round_trip(shape: str) -> None:
    definition = WITHOUT_ROS.add(f"test_msgs/{shape}", SHAPES[shape] + _PARTS)

    @settings(brief, max_examples=20)
    @given(messages(definition, printable | st.binary(max_size=5)))
    def every_message(values: Any) -> None:
        check_round_trip(definition, WITHOUT_ROS, serialize(definition, values))

    every_message()


numbers = st.sampled_from([*CODES, "time", "duration"])
structs = st.sampled_from(["string", "Inner", "Fixed", "Nothing", "Header"])
slots = st.tuples(numbers | structs, st.sampled_from(["", "", "", "[]", "[0]", "[1]", "[3]", "[9]"]))


@pytest.mark.slow
@settings(brief, max_examples=100)
@given(st.lists(slots, max_size=5), st.data())
def test_random_type_survives_round_trip(slots: List[Any], data: st.DataObject) -> None:
    definitions = empty_registry()
    text = "".join(f"{kind}{array} slot{number}\n" for number, (kind, array) in enumerate(slots))
    definition = definitions.add("test_msgs/Any", text + EVERYTHING[EVERYTHING.index("=") :])
    decoder = definitions.decoder(definition)
    write = make_text_writer(decoder)
    with patch.object(encoder, "encode_slot_by_slot", _refuse):
        encode = encoder.Encoder(definition).encode
    for values in data.draw(st.lists(messages(definition, printable), min_size=1, max_size=3)):
        values = _without_codes(definition, values)
        raw = serialize(definition, values)
        check_round_trip(definition, definitions, raw)
        assert encode(decoder.decode(raw)) == raw
        assert freeze(decoder.decode(raw)) == freeze(to_term(definition, values))
        assert write(raw) == to_text(decoder.decode(raw))


def _refuse(definition: Any, term: Any, topic: Any) -> None:
    """Replace the slot-by-slot encoding, which decoded messages must not need."""
    raise AssertionError("a decoded message is encoded slot by slot")
