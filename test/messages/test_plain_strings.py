"""Strings of messages as atoms without double quotes: codecs, dictionaries, registries, and ``message_text/2``."""

import gc
import weakref
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Definitions, Engine, MessageError, atom, functor
from retalis.messages.action_events import ActionEvent, ActionMessages
from retalis.messages.decoder import MAX_EAGER_BYTES
from retalis.messages.message_dictionaries import make_message_term, read_message_term
from retalis.messages.message_slots import SlotNames
from retalis.messages.message_to_event_text import make_text_writer
from retalis.messages.type_definition import SerializationFormat
from retalis.prolog.syntax.event_text import EventReader, to_text
from retalis.prolog.terms.types import NIL, String, deref

FORMATS = list(SerializationFormat)
TEXT = "std_msgs/String"
TEXT_FUNCTOR = functor("std_msgs__0__String", 1)
PEOPLE = "Header header\nstring name\nstring[] tags\nuint8[] data\nint32 age"


@pytest.fixture(scope="module")
def plain() -> Definitions:
    definitions = Definitions().with_strings("plain")
    definitions.add("my_robot/People", PEOPLE)
    return definitions


def encode(definitions: Definitions, text: str, serialization_format: Any) -> bytes:
    term = make_message_term(definitions.find(TEXT), {"data": text})
    return definitions.encoder(TEXT, serialization_format).encode(term)


@pytest.mark.parametrize("serialization_format", FORMATS)
def test_string_is_atom_without_quotes(plain: Definitions, serialization_format: Any) -> None:
    data = encode(plain, "anna", serialization_format)
    assert plain.decoder(TEXT, serialization_format).decode(data) == (TEXT_FUNCTOR, atom("anna"))


@pytest.mark.parametrize("serialization_format", FORMATS)
@given(text=st.text(st.characters(exclude_categories=["Cs"])))
def test_text_round_trips(plain: Definitions, serialization_format: Any, text: str) -> None:
    data = encode(plain, text, serialization_format)
    term = plain.decoder(TEXT, serialization_format).decode(data)
    assert data == encode(Definitions(), text, serialization_format)
    assert plain.encoder(TEXT, serialization_format).encode(term) == data
    assert plain.encoder(TEXT, serialization_format).encode(EventReader().read(to_text(term))) == data
    assert read_message_term(plain.find(TEXT), term) == {"data": text}


@pytest.mark.parametrize("serialization_format", FORMATS)
@pytest.mark.parametrize("text", ['"', '"map"', "[]", "true", "12", "", "FFFFFFFFFF", "a\0b"])
def test_unusual_text_round_trips(plain: Definitions, serialization_format: Any, text: str) -> None:
    data = encode(plain, text, serialization_format)
    term = plain.decoder(TEXT, serialization_format).decode(data)
    assert plain.encoder(TEXT, serialization_format).encode(term) == data
    assert read_message_term(plain.find(TEXT), term) == {"data": text}


@pytest.mark.parametrize("serialization_format", FORMATS)
def test_nested_strings_and_arrays_are_plain(plain: Definitions, serialization_format: Any) -> None:
    message = {"header": {"frame_id": "map"}, "name": "Jürgen", "tags": ["a", '"b"'], "data": b"ab", "age": 3}
    definition = plain.find("my_robot/People")
    data = plain.encoder(definition, serialization_format).encode(make_message_term(definition, message))
    term: Any = plain.decoder(definition, serialization_format).decode(data)
    assert term[1][3] is atom("map")
    assert term[2] is atom("Jürgen")
    assert term[3][1] is atom("a")
    # An array of bytes has its quotes in both forms.
    assert term[4] is atom('"ab"')
    assert read_message_term(definition, term)["tags"] == ["a", '"b"']


@pytest.mark.parametrize("serialization_format", FORMATS)
def test_long_string_is_plain(plain: Definitions, serialization_format: Any) -> None:
    text = "x" * (MAX_EAGER_BYTES + 1)
    data = encode(plain, text, serialization_format)
    term: Any = plain.decoder(TEXT, serialization_format).decode(data)
    assert plain.encoder(TEXT, serialization_format).encode(term) == data
    assert deref(term[1]) is atom(text)


@pytest.mark.parametrize("serialization_format", FORMATS)
@pytest.mark.parametrize("value", [atom("anna"), String("anna")])
def test_atom_and_string_are_encoded(plain: Definitions, serialization_format: Any, value: Any) -> None:
    data = plain.encoder(TEXT, serialization_format).encode((TEXT_FUNCTOR, value))
    assert data == encode(plain, "anna", serialization_format)


def test_number_in_text_is_refused(plain: Definitions) -> None:
    with pytest.raises(MessageError, match="topic t, std_msgs/String, slot data: expected a text, got 5"):
        plain.encoder(TEXT).encode((TEXT_FUNCTOR, 5), "t")


def test_list_is_text_of_its_characters_only_if_empty(plain: Definitions) -> None:
    assert plain.encoder(TEXT).encode((TEXT_FUNCTOR, NIL))[4:] == b"[]"
    with pytest.raises(MessageError, match="expected a string, got an empty list"):
        Definitions().encoder(TEXT).encode((TEXT_FUNCTOR, NIL))


def test_texts_of_messages_are_forgotten(plain: Definitions) -> None:
    text = "y" * 1000 + "z" * 100
    term: Any = plain.decoder(TEXT).decode(encode(Definitions(), text, SerializationFormat.ROS1))
    reference = weakref.ref(deref(term[1]))
    del term
    gc.collect()
    assert reference() is None


def test_registries_of_both_forms_share_types() -> None:
    quoted = Definitions()
    plain = quoted.with_strings("plain")
    added = plain.add("my_robot/Name", "string name")
    assert quoted.find("my_robot/Name").md5sum == added.md5sum
    assert quoted.decoder("my_robot/Name").decode(b"\1\0\0\0a")[1] is atom('"a"')  # type: ignore[index]
    assert plain.decoder("my_robot/Name").decode(b"\1\0\0\0a")[1] is atom("a")  # type: ignore[index]
    assert plain.with_strings("quoted").find("my_robot/Name") is quoted.find("my_robot/Name")


def test_learned_type_of_publisher_is_plain() -> None:
    plain = Definitions().with_strings("plain")
    learned = plain.learn("my_robot/Name", "other/Name", "string name", "*", event="name")
    assert learned.decoder.decode(b"\1\0\0\0a") == (functor("name", 1), atom("a"))


def test_text_of_message_has_no_quotes_inside(plain: Definitions) -> None:
    data = encode(plain, "kitchen table", SerializationFormat.ROS1)
    assert make_text_writer(plain.decoder(TEXT))(data) == "std_msgs__0__String('kitchen table')"


def test_action_events_are_plain(plain: Definitions) -> None:
    plain.add("my_robot/Dock_Goal", "string place")
    source = plain.add(
        "my_robot/DockActionGoal",
        "actionlib_msgs/GoalID goal_id\nDockGoal goal\n"
        f"{'=' * 80}\nMSG: actionlib_msgs/GoalID\ntime stamp\nstring id\n"
        f"{'=' * 80}\nMSG: my_robot/DockGoal\nstring place\n",
    )
    messages = ActionMessages(ActionEvent("my_robot/Dock", "goal"), source, SerializationFormat.ROS1)
    goal = {"goal_id": {"id": "g1"}, "goal": {"place": "hall"}}
    (event,) = messages.convert(plain.encoder(source).encode(make_message_term(source, goal)))
    term: Any = plain.decoder(messages.definition).decode(event)
    assert (term[1], term[2][1]) == (atom("g1"), atom("hall"))


def test_default_of_unnamed_slot_is_plain() -> None:
    slots = SlotNames(Definitions(), "plain").find("std_msgs__0__String")
    assert slots is not None
    assert slots[0].default is atom("")


@pytest.mark.parametrize("text", ['event(f("a b",1),[1,2])', 'event(f("a\\nb","c"),[1,2])', 'f(x, "y")'])
def test_double_quoted_event_text_is_plain_atom(text: str) -> None:
    reader = EventReader(has_plain_strings=True)
    expected = EventReader().read(text.replace('"', "'"))
    for _ in range(3):
        assert reader.read(text) == expected


@pytest.mark.parametrize(
    ("goal", "variable", "expected"),
    [
        ("message_text('\"hall\"', T)", "T", "hall"),
        ("message_text('\"\"', T)", "T", ""),
        ('message_text(\'"a"b"\', T)', "T", 'a"b'),
        ("message_text(Q, hall)", "Q", '"hall"'),
        ('message_text(Q, "two words")', "Q", '"two words"'),
        ("message_text(Q, 12)", "Q", '"12"'),
    ],
)
def test_message_text_is_converted(goal: str, variable: str, expected: str) -> None:
    (answer,) = Engine().query(goal)
    assert answer[variable] is atom(expected)


@pytest.mark.parametrize(
    ("goal", "holds"),
    [
        ("message_text('\"hall\"', hall)", True),
        ('message_text(\'"hall"\', "hall")', True),
        ("message_text('\"hall\"', kitchen)", False),
        ("catch(message_text(hall, _), error(type_error(message_text, hall), _), true)", True),
        ("catch(message_text('\"', _), error(type_error(message_text, '\"'), _), true)", True),
        ("catch(message_text(_, _), error(instantiation_error, _), true)", True),
        ("catch(message_text(_, f(x)), error(type_error(_, _), _), true)", True),
    ],
)
def test_bound_message_texts_are_compared(goal: str, holds: bool) -> None:
    assert bool(Engine().query(goal)) is holds
