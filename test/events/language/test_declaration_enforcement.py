"""Declared events at run time: refused events, and lifetime of declarations."""

from pathlib import Path
from typing import Any, List

import pytest
from recorded_calls import recording
from recording_engine import RecordingEngine

from retalis import Engine, ProgramErrors, PrologError, UsageError
from retalis.engine.client_requests import add_rule
from retalis.events.language import event_declarations

DECLARATION = ":- event temperature(motor:atom, value:number).\n"
FORM = "temperature(motor:atom,value:number)"
ARITY = f"temperature/1 does not match its declaration: {FORM} has 2 arguments"
VALUE = f"value of temperature/2 is a number, found hot; declared as {FORM}"


@pytest.fixture
def engine() -> RecordingEngine:
    return RecordingEngine(DECLARATION)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ("memorize(temperature(_), [], _, m, 5)", ARITY),
        ("memorize(temperature(_, hot), [], _, m, 5, 1)", VALUE),
        ("memorize_diactive(temperature(_), [], _, m, 5)", ARITY),
        ("subscribe(temperature(_), [], _, t, i)", ARITY),
        ("state(on, from(temperature(_)), until(off))", ARITY),
        ("event(temperature(left, hot))", VALUE),
        ("event(temperature(1), [1, 2])", ARITY),
        ("fire_event_list([event(temperature(1))])", ""),
        ("declare_event(temperature(a:atom))", f"temperature is declared already, as {FORM}"),
        ("declare_event((a(x:atom), temperature(a:atom)))", f"temperature is declared already, as {FORM}"),
        ("declare_event((a(x:atom), a(x:number)))", "a is declared already, as a(x:atom)"),
        ("declare_event((a(x:atom), b(x:nothing)))", "there is no type nothing"),
        ("declare_event(_)", "a declaration names an event"),
        ("ins_event_rule(a <- temperature(_))", "a <- temperature(_): " + ARITY),
    ],
)
def test_goal_against_declaration_is_refused(engine: RecordingEngine, goal: str, message: str) -> None:
    if message:
        with pytest.raises(Exception, match="declared|declaration") as caught:
            engine.call(goal)
        assert message.replace("a <- temperature(_): ", "") in str(caught.value)
    else:
        engine.call(goal)
    assert engine.event_texts == []
    assert not list(engine.knowledge.memories)
    assert not list(engine.knowledge.subscriptions)
    # A goal whose second declaration is wrong has not added the first one.
    engine.event("a(1)", 1)


def test_event_against_declaration_is_refused(engine: RecordingEngine) -> None:
    with pytest.raises(UsageError, match="event refused: value of temperature/2 is a number"):
        engine.event("temperature(left, hot)", 1)
    engine.event("temperature(left, 3)", 1)
    engine.event("temperatures(left)", 1)
    assert engine.event_texts == ["temperature(left,3)", "temperatures(left)"]


def test_text_against_declaration_is_refused(
    engine: RecordingEngine, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(4):
        engine.post_text("event(temperature(left,hot),[1,1])")
    engine.post_text("event(temperature(left,90.5),[1,1])")
    assert engine.event_texts == ["temperature(left,90.5)"]
    message = f"event refused: event(temperature(left,hot),[1,1]): {VALUE}"
    assert [record.getMessage().partition("\n")[0] for record in caplog.records] == [message] * 3


def test_added_rule_is_checked(engine: RecordingEngine) -> None:
    with pytest.raises(ProgramErrors, match="value of temperature/2 is a number"):
        add_rule(engine, "a <- temperature(_, hot)")


def test_undeclared_event_is_refused_if_flag_is_set(engine: RecordingEngine) -> None:
    engine.call("set_etalis_flag(undeclared_events, error)")
    with pytest.raises(UsageError, match="smoke/1 is not declared; write :- event smoke"):
        engine.event("smoke(hall)", 1)
    with pytest.raises(PrologError, match="smoke/1 is not declared"):
        engine.call("memorize(smoke(_), [], _, m, 5)")
    engine.call("memorize(temperature(_, _), [], _, m, 5), memorize(memory_deleted(_), [], _, n, 5)")
    engine.call("set_etalis_flag(undeclared_events, allowed)")
    engine.event("smoke(hall)", 1)
    assert engine.event_texts[-1] == "smoke(hall)"


def test_reset_removes_declarations(engine: RecordingEngine) -> None:
    engine.call("reset_etalis")
    engine.event("temperature(1)", 1)
    engine.load(rules=":- event temperature(value:number).")
    engine.event("temperature(2)", 2)
    assert engine.event_texts == ["temperature(1)", "temperature(2)"]


def test_file_with_error_declares_nothing(engine: RecordingEngine) -> None:
    with pytest.raises(ProgramErrors):
        engine.load(rules=":- event smoke(room:atom).\na <- .")
    with pytest.raises(ProgramErrors):
        engine.load(rules=":- event smoke(room:atom).\n:- throw(no).")
    engine.event("smoke(1)", 1)
    assert engine.event_texts == ["smoke(1)"]


def test_invalid_asserted_declaration_is_ignored(engine: RecordingEngine) -> None:
    engine.call("assertz('$declared_event'(3))")
    engine.event("temperature(left, 3)", 1)
    assert engine.event_texts == ["temperature(left,3)"]


def test_declarations_are_restored(engine: RecordingEngine) -> None:
    restored = Engine.restore(engine.snapshot())
    with pytest.raises(UsageError, match="event refused"):
        restored.event("temperature(left, hot)", 1)
    with pytest.raises(ProgramErrors, match="has 2 arguments"):
        restored.load(rules="a <- temperature(_).")


def test_reload_replaces_declarations(tmp_path: Path) -> None:
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\nevent smoke(room:atom)")
    rules = tmp_path / "rules.txt"
    rules.write_text(":- event heat(value:number).\na <- heat(3).")
    engine = Engine()
    engine.load_program(tmp_path)
    engine.reload(tmp_path)
    with pytest.raises(UsageError, match="event refused"):
        engine.event("heat(left, 3)", 1)
    rules.write_text(":- event heat(motor:atom, value:number).\na <- heat(left, 3).")
    engine.reload(tmp_path)
    engine.event("heat(left, 3)", 1)
    rules.write_text(":- event heat(motor:atom, value:number).\na <- heat(3).")
    with pytest.raises(ProgramErrors, match="has 2 arguments"):
        engine.reload(tmp_path)
    engine.event("heat(left, 3)", 2)
    with pytest.raises(UsageError, match="room of smoke/1 is an atom"):
        engine.event("smoke(3)", 3)


def test_declaration_is_parsed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    parsed: List[Any] = []
    lookups: List[Any] = []
    parse_clause = event_declarations._parse_clause  # noqa: SLF001
    parse_clauses = event_declarations.DeclaredEvents._parse_clauses  # noqa: SLF001
    monkeypatch.setattr(event_declarations, "_parse_clause", recording(parsed, parse_clause))
    monkeypatch.setattr(
        event_declarations.DeclaredEvents, "_parse_clauses", recording(lookups, parse_clauses)
    )
    engine = Engine()
    for number in range(30):
        engine.load(rules=f":- event e{number}(x:integer).")
    engine.event("e7(1)", 1)
    assert len(parsed) == 30
    lookups.clear()
    for number in range(100):
        engine.event(f"e{number % 30}(1)", number + 1)
    assert not lookups
    engine.load(rules=":- event more.")
    engine.event("more", 200)
    assert len(parsed) == 31


def test_further_declaration_visits_no_earlier_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program of many declarations is loaded in linear time."""
    engine = Engine()
    lookups: List[Any] = []
    parse_clauses = event_declarations.DeclaredEvents._parse_clauses  # noqa: SLF001
    monkeypatch.setattr(
        event_declarations.DeclaredEvents, "_parse_clauses", recording(lookups, parse_clauses)
    )
    for number in range(30):
        engine.call(f"declare_event(e{number}(x:number))")
        with pytest.raises(UsageError, match=f"x of e{number}/1 is a number"):
            engine.event(f"e{number}(a)")
    assert len(lookups) == 1
