"""Rules, goals, queries, errors and warnings with named slots."""

import struct
from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import place_of
from message_registries import empty_registry
from recording_reports import RecordingReports

from retalis import Definitions, Engine, ProgramErrors, explain, record_origins
from retalis.events.program.topic_configuration import read_topics

POINT = "my_msgs__0__Point"
RULES = f"""
right(X) <- {POINT}{{x: X}} where X > 0.
{POINT}{{y: X}} <- right(X).
seen(X) :- prev(points, {POINT}{{x: X}}, _, _, now).
"""
GOALS = f"""
memorize({POINT}{{x: X}}, [X > 0], _, points, 5)
subscribe({POINT}{{y: Y}}, [Y > 0], my_msgs__0__Named{{point: {{x: Y}}}}, out, o)
"""
INVALID_GOALS = f"""\
subscribe({POINT}{{z: Y}}, [], _, out, p)
subscribe(others__0__Thing{{z: Y}}, [], _, out, q)
"""


@pytest.fixture
def definitions() -> Definitions:
    types = empty_registry()
    types.add("my_msgs/Point", "float64 x\nfloat64 y\n")
    types.add("my_msgs/Named", "string name\nPoint point\n")
    return types


@pytest.fixture
def engine(definitions: Definitions) -> Engine:
    return Engine(definitions=definitions)


def test_goals_with_unknown_slots_are_refused(engine: Engine) -> None:
    with pytest.raises(ProgramErrors) as caught_errors:
        engine.call_goals(GOALS + INVALID_GOALS, "goals")
    assert [str(error).split(";")[0] for error in caught_errors.value.errors] == [
        f"goals:4:29: {POINT} has no slot z",
        "goals:5:11: the slots of others/Thing are not known when this is read: no definition of the message type "
        "others/Thing is installed or has been received",
    ]
    status = engine.status()
    assert ([memory.id for memory in status.memories], [s.id for s in status.subscriptions]) == (
        ["points"],
        ["o"],
    )


def test_rules_memories_and_outputs_have_named_slots(engine: Engine) -> None:
    outputs: List[Any] = []
    engine.on_output(lambda term, topic, name: outputs.append(engine.show(term)))
    engine.load(rules=RULES, goals=GOALS)
    engine.event(f"{POINT}{{x: 2}}", 1)
    engine.event(f"{POINT}(-2, 3)", 2)
    assert outputs == [
        f"my_msgs__0__Named('\"\"',{POINT}(2.0,0.0))",
        f"my_msgs__0__Named('\"\"',{POINT}(3,0.0))",
    ]
    assert engine.query("access_mem(points, P, _)") == engine.query(f"P = {POINT}(2.0, 0.0)")
    assert [str(answer["X"]) for answer in engine.query(f"access_mem(points, {POINT}{{x: X}}, _)")] == ["2.0"]


def test_listing_shows_named_slots_as_written(engine: Engine, capsys: pytest.CaptureFixture[str]) -> None:
    engine.load(rules=RULES)
    engine.call("listing(seen/1)")
    assert capsys.readouterr().out == f"seen(A) :-\n    prev(points, {POINT}{{x: A}}, _, _, now).\n\n"


def test_status_shows_named_slots_as_written(engine: Engine) -> None:
    engine.load(rules=RULES, goals=GOALS)
    status = engine.status()
    assert [rule.text for rule in status.rules] == [
        f"right(X)<-{POINT}{{x: X}}where X>0",
        f"{POINT}{{y: X}}<-right(X)",
    ]
    assert [memory.event for memory in status.memories] == [f"{POINT}{{x: _}}"]


def test_explanation_shows_named_slots_as_written(engine: Engine) -> None:
    record_origins(engine)
    engine.load(rules=RULES)
    engine.event(f"{POINT}(2, 1)", 1)
    has_happened, lines = explain(engine, f"{POINT}(0.0, 2)")
    assert has_happened
    assert lines[0].text == f"{POINT}(0.0,2) at 1 by rule {POINT}{{y: X}} <- right(X) (text:3)"
    assert f"right(X) <- {POINT}{{x: X}} where X > 0" in lines[0].below[0].text
    has_happened, lines = explain(engine, "right(3)")
    assert not has_happened
    assert lines[0].below[0].below[0].text == f"- {POINT}{{x: 3}}: did not happen"


def test_integer_for_float_slot_matches_message(
    engine: Engine, definitions: Definitions, capsys: pytest.CaptureFixture[str]
) -> None:
    events: List[Any] = []
    engine.load(rules=f"zero <- {POINT}{{x: 0, y: -2}}.\np :- q({POINT}{{x: 0}}).")
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event(definitions.decoder("my_msgs/Point").decode(struct.pack("<dd", 0, -2)), 1)
    assert events[1:] == ["zero"]
    engine.call("listing(p/0)")
    assert capsys.readouterr().out == f"p :-\n    q({POINT}{{x: 0}}).\n\n"


def test_error_shows_named_slots(definitions: Definitions) -> None:
    reports = RecordingReports()
    engine = Engine(reports=reports, definitions=definitions)
    engine.load(rules=f"{POINT}{{x: X}} <- a(X) where atom_length({POINT}{{y: X}}, 5).")
    engine.event("a(1)", 1)
    (error,) = reports.texts
    assert f"rule {POINT}{{x: X}}, at event a(1): goal atom_length({POINT}{{y: X}},5)" in error


def test_unknown_slot_of_rule_is_refused_with_place(engine: Engine) -> None:
    with pytest.raises(ProgramErrors) as caught_errors:
        engine.load(
            rules=f"a <- b.\nc <- {POINT}{{xx: 1}}.\nd <- my_msgs__0__Named{{point: {{yy: 1}}}}.",
            source="rules",
        )
    assert [str(error).split("\n")[0] for error in caught_errors.value.errors] == [
        f"rules:2:24: {POINT} has no slot xx; did you mean x?",
        f"rules:3:32: {POINT} has no slot yy; did you mean y?",
    ]
    assert engine.status().rules == ()


TOPICS = """<publish_subscribe>
  <subscribe_to name="left" msg_type="my_msgs/Point" event="left_point"/>
  <subscribe_to name="right" msg_type="my_msgs/Point" event="right_point"/>
</publish_subscribe>"""


NAMED_EVENT_RULES = """a(X) <- left_point{x: X}.
b <- left_point(_).
c <- right_point{y: 1}.
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """The folder of a program with named events."""
    (tmp_path / "pub_sub.xml").write_text(TOPICS)
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('rules.txt')")
    (tmp_path / "rules.txt").write_text(NAMED_EVENT_RULES)
    return tmp_path


def test_named_event_with_too_few_slots_is_reported(
    engine: Engine, definitions: Definitions, program: Path
) -> None:
    engine.load_program(program)
    warnings = engine.warnings(program, definitions, read_topics(program / "pub_sub.xml"))
    (warning,) = [problem for problem in warnings if "its type" in problem.message]
    assert warning.message == (
        "left_point/1 does not match its type: my_msgs/Point has 2 slots: x, y; "
        "write all of them, or some by name: left_point{x: ...}"
    )
    assert place_of(warning).line == 2


def test_named_events_have_named_slots(engine: Engine, program: Path) -> None:
    engine.load_program(program)
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    engine.event("left_point{x: 5}", 1)
    assert events == ["left_point(5.0,0.0)", "a(5.0)"]


def test_reloaded_rules_have_named_slots_of_events(engine: Engine, program: Path) -> None:
    engine.load_program(program)
    (program / "rules.txt").write_text(NAMED_EVENT_RULES.replace("left_point(_)", "left_point{}"))
    assert engine.reload(program)[0] == "rules: 1 new, 1 gone, 2 kept"
    (program / "rules.txt").write_text(NAMED_EVENT_RULES.replace("y: 1", "z: 1"))
    with pytest.raises(ProgramErrors, match="right_point has no slot z"):
        engine.reload(program)
