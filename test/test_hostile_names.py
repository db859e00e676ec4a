"""Names from outside that would do harm if they were ever written into Python source.

Each stands wherever a name can come in. Nothing of it may be found in any source that is generated, and where names
are free it has to come back as it was; where ROS says what a name is, it is refused.
"""

import re

import pytest
from reachability import reachable

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
from retalis.foundation.errors import printable
from retalis.messages.event_text_writer import make_text_writer
from retalis.messages.ros2_to_ros1 import parse_ros2_type
from retalis.messages.type_registry import InstalledTypes
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
"""Each has "harm" in it, which no source of ours has."""

ids = [ascii(name)[:30] for name in NAMES]
every_name = pytest.mark.parametrize("name", NAMES, ids=ids)


@pytest.fixture(autouse=True)
def sources(monkeypatch):
    """Collect all sources that are generated; none may have anything of the names in it."""
    found = []
    define = codegen.define

    def collecting(source, names, title):
        found.append(source)
        assert "harm" not in source
        assert not any("harm" in key for key in names)
        return define(source, names, title)

    monkeypatch.setattr(codegen, "define", collecting)
    for cache in reachable(list(vars(codegen).values()), Cache):
        cache.clear()
    yield found
    assert "harm" not in "".join(found)


def quoted(name):
    return writeq(atom(name))


# ---- names of messages: as ROS says -----------------------------------------------------------------


@every_name
@pytest.mark.parametrize("form", ["{}/Type", "pkg/{}", "{}", "a/b:={}"])
def test_types_are_refused_at_every_door(name, form, tmp_path):
    kind = form.format(name)
    definitions = Definitions()
    with pytest.raises(MessageError):
        definitions.find(kind)
    with pytest.raises(MessageError):
        definitions.add(kind, "int32 x\n")
    with pytest.raises(MessageError):
        definitions.received("pkg/Type", kind, "int32 x\n", "")
    with pytest.raises(MessageError):
        definitions.received(kind, "pkg/Type", "int32 x\n", "")
    assert kind not in definitions
    with pytest.raises(UsageError):
        topic_type("topic", kind)


@every_name
def test_topics_are_refused(name, tmp_path):
    with pytest.raises(UsageError, match="expected a topic name"):
        topic_type(name, "std_msgs/String")


@every_name
@pytest.mark.parametrize("attribute", ["name", "msg_type"])
def test_xml_is_refused_with_a_place(name, attribute, tmp_path):
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
    with pytest.raises(ProgramErrors) as caught:
        read_topics(path)
    assert caught.value.errors[0].place.line == 2


@every_name
@pytest.mark.parametrize("line", ["int32 {}", "{} x", "int32 {}=1", "{} X=1", "int32[{}] x", "int32 X={}"])
def test_definitions_are_refused_with_a_place(name, line, caplog):
    try:
        definition = Definitions().add("pkg/Type", "int8 first\n" + line.format(name) + "\n")
    except MessageError as error:
        assert error.place.source.startswith("pkg/Type")
        assert len(error.message) < 1000
    else:
        # An invalid constant is ignored.
        assert "=" in line
        assert definition.constants == ()
        (record,) = caplog.records
        assert record.getMessage().startswith("pkg/Type:2:")
        assert len(record.getMessage()) < 1000


@every_name
def test_nested_types_are_refused(name):
    for text in (f"{name}/Other x\n", f"{name} x\n", f"Other x\n{'=' * 80}\nMSG: {name}\nint8 x\n"):
        with pytest.raises(MessageError):
            Definitions(InstalledTypes(packages=(), modules=(), include_rosbags=False)).add("pkg/Type", text)
        with pytest.raises(MessageError):
            parse_ros2_type("pkg/msg/Type", text, lambda kind: None)


@every_name
@pytest.mark.parametrize("line", ["int32 {}", "{} x", "{} X=1", "int32[<={}] x", "string<={} x"])
def test_definitions_of_ros_2_are_refused(name, line):
    with pytest.raises(MessageError) as caught:
        parse_ros2_type("pkg/msg/Type", "int8 first\n" + line.format(name) + "\n", lambda kind: None)
    assert len(caught.value.message) < 1000


@every_name
@pytest.mark.parametrize("kind", ["{}", "{}/msg/Type", "pkg/msg/{}"])
def test_types_of_ros_2_are_refused(name, kind):
    with pytest.raises(MessageError):
        parse_ros2_type(kind.format(name), "int8 x\n", lambda kind: None)


@every_name
def test_values_of_constants_stay_values(name):
    line = name.split("\n")[0].split("\u2028")[0]
    definition = Definitions().add("pkg/Type", f"string X={line}\nint32 x\n")
    assert definition.constants[0].value == line.strip()
    decoder = Definitions().decoder(definition)
    assert writeq(decoder.decode(b"\1\0\0\0")) == "pkg__0__Type(1)"


def test_names_of_slots_that_python_gives_a_meaning():
    words = ["import", "None", "def", "data", "o", "k1", "v1", "S1", "trail", "__class__"[2:7], "term"]
    definitions = Definitions()
    text = "".join(f"int8 {word}\n" for word in dict.fromkeys(words))
    definition = definitions.add("pkg/Type", text)
    data = bytes(range(len(definition.fields)))
    term = definitions.decoder(definition).decode(data)
    assert definitions.encoder(definition).encode(term) == data
    assert make_text_writer(definitions.decoder(definition))(data) == writeq(term)


@every_name
def test_texts_of_messages_stay_texts(name):
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
def test_names_in_rules_and_memories_come_back(name):
    it = quoted(name)
    engine = Engine()
    events = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    outputs = []
    engine.on_output(lambda term, topic, key: outputs.append((engine.show(term), topic, engine.show(key))))
    rules = f"""
        {it}(X, {it}) <- ({it}(X) seq other({it}, X)) where ({it}(X, Y), Y == {it}).
        l([label({it})]) : labelled({it}, X) <- {it}(X, {it}).
        {it}(_, {it}).
        {it} --> [{it}], "x".
        found(X, Y) :- {it}(X, Y), \\+ \\+ Y = {it}.
    """
    goals = f"""
        memorize({it}(X, {it}), [{it}(X, _)], {it}(X), {it}, 10).
        subscribe(labelled({it}, X), [], {it}(X), {it}, {it}).
        assertz({it}(1, 2, 3)), nb_setval({it}, {it}).
    """
    engine.load(rules=rules.replace(f"l([label({it})]) :", f"{it} :"), goals=goals)
    for at in range(3):  # more than once: code is generated for what is called again
        engine.event(f"{it}({at})", at * 10)
        engine.event(f"other({it}, {at})", at * 10 + 1)
    assert events.count(f"{it}(0,{it})") == 1
    assert f"labelled({it},2)" in events
    assert outputs == [(f"{it}({at})", name, it) for at in range(3)]
    assert engine.query(f"prev({it}, R, _, _, 100), R == {it}(2), found(_, {it}), nb_getval({it}, {it})")
    (parsed,) = engine.query(f"phrase({it}, L)")  # a text in a grammar is its codes
    assert list_items(parsed["L"]) == [atom(name), ord("x")]
    assert engine.query(f"{it}(A, B, C), A + B =:= C")
    assert engine.query(f"catch(throw({it}), E, true), E == {it}")


@every_name
def test_operators(name):
    engine = Engine()
    it = quoted(name)
    engine.load(rules=f":- op(700, xfx, {it}).\nlikes(a {it} b).\np(X) :- X = (1 {it} 2).\n")
    (one,) = engine.query("likes(X), X =.. [F | L], p(Y), p(Y), Y =.. [F | _]")
    assert one["F"] is atom(name)


REFUSED = {
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
@pytest.mark.parametrize("goal", REFUSED)
def test_flags_modules_and_files_of_such_names_are_refused(name, goal):
    engine = Engine()
    with pytest.raises(PrologError) as caught:
        engine.query(goal.format(it=quoted(name)))
    assert re.match(REFUSED[goal], caught.value.message)
    assert len(caught.value.message) < 5000
    assert engine.query("X = 1") == [{"X": 1}]


@every_name
def test_goals_that_take_any_name_give_it_back(name, capsys):
    engine = Engine()
    it = quoted(name)
    assert engine.query(f"set_prolog_flag({it}, on), current_prolog_flag({it}, X)") == [{"X": atom("on")}]
    assert engine.query(f"format({it.replace('~', '~~')}, [])") == [{}]
    assert capsys.readouterr().out == printable(name)


@every_name
@pytest.mark.parametrize(
    "goal", ["read_term_from_atom({it}, T, [])", "term_to_atom(T, {it})", "T = (\n{name}\n)"]
)
def test_names_that_are_read_as_text_are_terms_or_syntax_errors(name, goal):
    engine = Engine()
    try:
        expected = writeq(read_term(name, Operators.prolog()).term)
    except SyntaxFault:
        with pytest.raises((PrologError, SyntaxFault)) as caught:
            engine.query(goal.format(it=quoted(name), name=name))
        assert isinstance(caught.value, SyntaxFault) or caught.value.message.startswith("Syntax error: ")
        return
    found = engine.query(goal.format(it=quoted(name), name=name))
    assert [re.sub("_G?[0-9]+|__builtins__harm|None", "_", writeq(one["T"])) for one in found] == [
        re.sub("_G?[0-9]+|__builtins__harm|None", "_", expected)
    ]


@every_name
def test_foreign_predicates(name):
    engine = Engine()

    @foreign(name=name)
    def twice(number: int) -> int:
        return 2 * number

    engine.add_foreign(twice)
    engine.load(rules=f"p(X, Y) :- {quoted(name)}(X, Y).")
    for _ in range(3):
        (one,) = engine.query("p(2, Y)")
        assert one["Y"] == 4


@every_name
def test_goals_with_the_same_name_everywhere(name):
    engine = Engine()
    key = functor(name, 2)
    goal = (functor("=", 2), (key, atom(name), Var()), (key, Var(), make_list([atom(name)])))
    assert engine.call(goal)
