"""Names from outside that would execute code if they were part of generated Python source.

Each is used at every place that takes a name. No generated source may contain any part of it. Where names are free,
it must be returned unchanged; where ROS defines the form of names, it must be refused.
"""

import re
from pathlib import Path
from typing import Any, Dict, Iterator, List

import pytest
from asserting_accessors import place_of
from message_registries import empty_registry
from reachable_objects import reachable

from retalis import (
    Definitions,
    Engine,
    MessageError,
    Operators,
    ProgramErrors,
    PrologError,
    SyntaxFault,
    UsageError,
    Var,
    atom,
    foreign,
    functor,
    list_items,
    make_list,
)
from retalis.events.program.topic_configuration import read_topics, topic_type
from retalis.foundation import codegen
from retalis.foundation.bounded_caches import Cache
from retalis.foundation.displayed_text import printable
from retalis.messages.message_to_event_text import make_text_writer
from retalis.messages.type_registry import parse_ros2_type
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import writeq

NAMES = [
    '__import__("os").system("harm")',
    "x:=__import__('os').system('harm')",
    "harm'); import os; os.system('harm",
    'harm"+__import__("os").system("harm")+"',
    "{__import__('os').system('harm')}",
    "harm\n    import os\n    os.system('harm')\n#",
    "harm\\",
    "harm'''",
    'harm"""',
    "harm\0",
    "harm²",
    "ﬁharm",
    "harm\u2028x",
    "harm\u202e",
    "harm%s{0}",
    "__builtins__harm",
    "harm(#",
    "None, harm",
    "harm" * 300,
]
"""Names that contain "harm", which no generated source contains."""

ids = [ascii(name)[:30] for name in NAMES]
every_name = pytest.mark.parametrize("name", NAMES, ids=ids)


@pytest.fixture(autouse=True)
def sources(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Collect all generated sources; none may contain a part of the names."""
    generated: List[Any] = []
    define = codegen.define

    def collect(source: Any, names: Any, title: Any) -> Dict[str, Any]:
        generated.append(source)
        assert "harm" not in source
        assert not any("harm" in key for key in names)
        return define(source, names, title)

    monkeypatch.setattr(codegen, "define", collect)
    for cache in reachable(list(vars(codegen).values()), Cache):
        cache.clear()
    yield generated
    assert "harm" not in "".join(generated)


def quote(name: Any) -> str:
    return writeq(atom(name))


# ---- names of messages: as ROS says -----------------------------------------------------------------


@every_name
@pytest.mark.parametrize("form", ["{}/Type", "pkg/{}", "{}", "a/b:={}"])
def test_hostile_type_is_refused(name: Any, form: str, tmp_path: Path) -> None:
    type_name = form.format(name)
    definitions = Definitions()
    with pytest.raises(MessageError):
        definitions.find(type_name)
    with pytest.raises(MessageError):
        definitions.add(type_name, "int32 x\n")
    with pytest.raises(MessageError):
        definitions.received("pkg/Type", type_name, "int32 x\n", "")
    with pytest.raises(MessageError):
        definitions.received(type_name, "pkg/Type", "int32 x\n", "")
    assert type_name not in definitions
    with pytest.raises(UsageError):
        topic_type("topic", type_name)


@every_name
def test_hostile_topic_is_refused(name: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="expected a topic name"):
        topic_type(name, "std_msgs/String")


@every_name
@pytest.mark.parametrize("attribute", ["name", "msg_type"])
def test_hostile_xml_is_refused_with_position(name: Any, attribute: str, tmp_path: Path) -> None:
    values = {"name": "topic", "msg_type": "std_msgs/String", attribute: name}
    attributes = " ".join(
        '{}="{}"'.format(
            key,
            value.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;").replace("\n", "&#10;"),
        )
        for key, value in values.items()
    )
    path = tmp_path / "pub_sub.xml"
    path.write_text(f"<publish_subscribe>\n <subscribe_to {attributes}/>\n</publish_subscribe>", "utf-8")
    with pytest.raises(ProgramErrors) as raised:
        read_topics(path)
    assert place_of(raised.value.errors[0]).line == 2


@every_name
@pytest.mark.parametrize("line", ["int32 {}", "{} x", "int32 {}=1", "{} X=1", "int32[{}] x", "int32 X={}"])
def test_hostile_definition_is_refused_with_position(
    name: Any, line: str, caplog: pytest.LogCaptureFixture
) -> None:
    definitions = Definitions()
    text = "int8 first\n" + line.format(name) + "\n"
    try:
        definition = definitions.add("pkg/Type", text)
    except MessageError as raised:
        error = raised
    else:
        # An invalid constant is ignored.
        assert "=" in line
        assert definition.constants == ()
        (record,) = caplog.records
        assert record.getMessage().startswith("pkg/Type:2:")
        assert len(record.getMessage()) < 1000
        return
    assert place_of(error).source.startswith("pkg/Type")
    assert len(error.message) < 1000


@every_name
def test_hostile_nested_type_is_refused(name: Any) -> None:
    for text in (f"{name}/Other x\n", f"{name} x\n", f"Other x\n{'=' * 80}\nMSG: {name}\nint8 x\n"):
        with pytest.raises(MessageError):
            empty_registry().add("pkg/Type", text)
        with pytest.raises(MessageError):
            parse_ros2_type("pkg/msg/Type", text, lambda type_name: None)


@every_name
@pytest.mark.parametrize("line", ["int32 {}", "{} x", "{} X=1", "int32[<={}] x", "string<={} x"])
def test_hostile_ros2_definition_is_refused(name: Any, line: str) -> None:
    with pytest.raises(MessageError) as raised:
        parse_ros2_type("pkg/msg/Type", "int8 first\n" + line.format(name) + "\n", lambda type_name: None)
    assert len(raised.value.message) < 1000


@every_name
@pytest.mark.parametrize("type_name", ["{}", "{}/msg/Type", "pkg/msg/{}"])
def test_hostile_ros2_type_is_refused(name: Any, type_name: str) -> None:
    with pytest.raises(MessageError):
        parse_ros2_type(type_name.format(name), "int8 x\n", lambda type_name: None)


@every_name
def test_value_of_constant_is_unchanged(name: str) -> None:
    line = name.split("\n")[0].split("\u2028")[0]
    definition = Definitions().add("pkg/Type", f"string X={line}\nint32 x\n")
    assert definition.constants[0].value == line.strip()
    decoder = Definitions().decoder(definition)
    assert writeq(decoder.decode(b"\1\0\0\0")) == "pkg__0__Type(1)"


def test_slots_may_have_names_of_python() -> None:
    words = ["import", "None", "def", "data", "o", "k1", "v1", "S1", "trail", "__class__"[2:7], "term"]
    definitions = Definitions()
    text = "".join(f"int8 {word}\n" for word in dict.fromkeys(words))
    definition = definitions.add("pkg/Type", text)
    data = bytes(range(len(definition.fields)))
    term = definitions.decoder(definition).decode(data)
    assert definitions.encoder(definition).encode(term) == data
    assert make_text_writer(definitions.decoder(definition))(data) == writeq(term)


@every_name
def test_text_of_message_is_unchanged(name: Any) -> None:
    raw = name.encode("utf-8")
    definitions = Definitions()
    definition = definitions.add("pkg/Type", "int32 x\nstring text\nint32 y\n")
    data = b"\1\0\0\0" + len(raw).to_bytes(4, "little") + raw + b"\2\0\0\0"
    decoder = definitions.decoder(definition)
    assert definitions.encoder(definition).encode(decoder.decode(data)) == data
    text = make_text_writer(decoder)(data)
    assert definitions.encoder(definition).encode(read_term(text, Operators.prolog()).term) == data


# ---- names of programs: free -------------------------------------------------------------------------


@every_name
def test_names_in_rules_and_memories_are_unchanged(name: Any) -> None:
    quoted = quote(name)
    engine = Engine()
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    outputs: List[Any] = []
    engine.on_output(lambda term, topic, key: outputs.append((engine.show(term), topic, engine.show(key))))
    rules = f"""
        {quoted}(X, {quoted}) <- ({quoted}(X) seq other({quoted}, X)) where ({quoted}(X, Y), Y == {quoted}).
        l([label({quoted})]) : labelled({quoted}, X) <- {quoted}(X, {quoted}).
        {quoted}(_, {quoted}).
        {quoted} --> [{quoted}], "x".
        pair(X, Y) :- {quoted}(X, Y), \\+ \\+ Y = {quoted}.
    """
    goals = f"""
        memorize({quoted}(X, {quoted}), [{quoted}(X, _)], {quoted}(X), {quoted}, 10).
        subscribe(labelled({quoted}, X), [], {quoted}(X), {quoted}, {quoted}).
        assertz({quoted}(1, 2, 3)), nb_setval({quoted}, {quoted}).
    """
    engine.load(rules=rules.replace(f"l([label({quoted})]) :", f"{quoted} :"), goals=goals)
    for number in range(3):  # code is generated at repeated calls
        engine.event(f"{quoted}({number})", number * 10)
        engine.event(f"other({quoted}, {number})", number * 10 + 1)
    assert events.count(f"{quoted}(0,{quoted})") == 1
    assert f"labelled({quoted},2)" in events
    assert outputs == [(f"{quoted}({number})", name, quoted) for number in range(3)]
    assert engine.query(
        f"prev({quoted}, R, _, _, 100), R == {quoted}(2), pair(_, {quoted}), nb_getval({quoted}, {quoted})"
    )
    (parsed,) = engine.query(f"phrase({quoted}, L)")  # a text in a grammar is a list of codes
    assert list_items(parsed["L"]) == [atom(name), ord("x")]
    assert engine.query(f"{quoted}(A, B, C), A + B =:= C")
    assert engine.query(f"catch(throw({quoted}), E, true), E == {quoted}")


@every_name
def test_hostile_operator_is_applied(name: Any) -> None:
    engine = Engine()
    quoted = quote(name)
    engine.load(rules=f":- op(700, xfx, {quoted}).\nlikes(a {quoted} b).\np(X) :- X = (1 {quoted} 2).\n")
    (solution,) = engine.query("likes(X), X =.. [F | L], p(Y), p(Y), Y =.. [F | _]")
    assert solution["F"] is atom(name)


ERRORS_BY_GOAL = {
    "set_etalis_flag({it}, on)": "Domain error: `etalis_flag' expected, found",
    "use_module(library({it}))": "Unknown library: ",
    "{it}:foo(1)": "Unknown procedure: foo/1",
    "use_foreign({it})": "No permission to load foreign_module ",
    "use_swi({it})": "No permission to load swi_file ",
    "use_swi({it}, [{it}/1])": "No permission to load swi_file ",
    "{it}": "Unknown procedure: ",
    "consult({it})": "No permission to open source_sink |Domain error: `source_sink'|Cannot represent due to ",
}


@every_name
@pytest.mark.parametrize("goal", ERRORS_BY_GOAL)
def test_hostile_flag_module_or_file_is_refused(name: Any, goal: str) -> None:
    engine = Engine()
    with pytest.raises(PrologError) as raised:
        engine.query(goal.format(it=quote(name)))
    assert re.match(ERRORS_BY_GOAL[goal], raised.value.message)
    assert len(raised.value.message) < 5000
    assert engine.query("X = 1") == [{"X": 1}]


@every_name
def test_goal_returns_hostile_name(name: Any, capsys: pytest.CaptureFixture[str]) -> None:
    engine = Engine()
    quoted = quote(name)
    assert engine.query(f"set_prolog_flag({quoted}, on), current_prolog_flag({quoted}, X)") == [
        {"X": atom("on")}
    ]
    assert engine.query(f"format({quoted.replace('~', '~~')}, [])") == [{}]
    assert capsys.readouterr().out == printable(name)


@every_name
@pytest.mark.parametrize(
    "goal", ["read_term_from_atom({it}, T, [])", "term_to_atom(T, {it})", "T = (\n{name}\n)"]
)
def test_text_with_hostile_name_is_term_or_error(name: Any, goal: str) -> None:
    engine = Engine()
    try:
        expected = writeq(read_term(name, Operators.prolog()).term)
    except SyntaxFault:
        with pytest.raises((PrologError, SyntaxFault)) as raised:
            engine.query(goal.format(it=quote(name), name=name))
        assert isinstance(raised.value, SyntaxFault) or raised.value.message.startswith("Syntax error: ")
        return
    solutions = engine.query(goal.format(it=quote(name), name=name))
    assert [
        re.sub("_G?[0-9]+|__builtins__harm|None", "_", writeq(solution["T"])) for solution in solutions
    ] == [re.sub("_G?[0-9]+|__builtins__harm|None", "_", expected)]


@every_name
def test_foreign_predicate_may_have_hostile_name(name: Any) -> None:
    engine = Engine()

    @foreign(name=name)
    def twice(number: int) -> int:
        return 2 * number

    engine.add_foreign(twice)
    engine.load(rules=f"p(X, Y) :- {quote(name)}(X, Y).")
    for _ in range(3):
        (solution,) = engine.query("p(2, Y)")
        assert solution["Y"] == 4


@every_name
def test_goal_unifies_terms_of_hostile_name(name: Any) -> None:
    engine = Engine()
    key = functor(name, 2)
    goal = (functor("=", 2), (key, atom(name), Var()), (key, Var(), make_list([atom(name)])))
    assert engine.call(goal)
