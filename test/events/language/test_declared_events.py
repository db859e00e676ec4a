"""Declared events at run time: refused events, and lifetime of declarations."""

import pytest

from retalis import Engine, ProgramErrors, PrologError, UsageError
from retalis.engine.client_requests import add_rule
from retalis.events.language import event_declarations

DECLARED = ":- event temperature(motor:atom, value:number).\n"
FORM = "temperature(motor:atom,value:number)"
ARITY = f"temperature/1 does not match its declaration: {FORM} has 2 arguments"
VALUE = f"value of temperature/2 is a number, found hot; declared as {FORM}"


@pytest.fixture
def engine():
    found = Engine()
    found.load(rules=DECLARED)
    found.seen = []
    found.on_event(lambda term, start, end: found.seen.append(found.show(term)))
    return found


@pytest.mark.parametrize(
    "goal, said",
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
        ("declare_event(_)", "a declaration names an event"),
        ("ins_event_rule(a <- temperature(_))", "a <- temperature(_): " + ARITY),
    ],
)
def test_a_goal_that_does_not_fit_does_nothing(engine, goal, said):
    if said:
        with pytest.raises(Exception, match="declared|declaration") as caught:
            engine.call(goal)
        assert said.replace("a <- temperature(_): ", "") in str(caught.value)
    else:
        engine.call(goal)
    assert (
        engine.seen == [] and not list(engine.knowledge.memories) and not list(engine.knowledge.subscriptions)
    )


def test_an_event_that_does_not_fit_is_refused(engine):
    with pytest.raises(UsageError, match="event refused: value of temperature/2 is a number"):
        engine.event("temperature(left, hot)", 1)
    engine.event("temperature(left, 3)", 1)
    engine.event("temperatures(left)", 1)
    assert engine.seen == ["temperature(left,3)", "temperatures(left)"]


def test_texts_that_do_not_fit_are_refused_as_others(engine, caplog):
    for _ in range(4):
        engine.post_text("event(temperature(left,hot),[1,1])")
    engine.post_text("event(temperature(left,90.5),[1,1])")
    assert engine.seen == ["temperature(left,90.5)"]
    said = f"event refused: event(temperature(left,hot),[1,1]): {VALUE}"
    assert [one.getMessage().partition("\n")[0] for one in caplog.records] == [said] * 3


def test_a_rule_that_is_added_fits(engine):
    with pytest.raises(ProgramErrors, match="value of temperature/2 is a number"):
        add_rule(engine, "a <- temperature(_, hot)")


def test_every_event_may_have_to_be_declared(engine):
    engine.call("set_etalis_flag(undeclared_events, error)")
    with pytest.raises(UsageError, match="smoke/1 is not declared; write :- event smoke"):
        engine.event("smoke(hall)", 1)
    with pytest.raises(PrologError, match="smoke/1 is not declared"):
        engine.call("memorize(smoke(_), [], _, m, 5)")
    engine.call("memorize(temperature(_, _), [], _, m, 5), memorize(memory_deleted(_), [], _, n, 5)")
    engine.call("set_etalis_flag(undeclared_events, allowed)")
    engine.event("smoke(hall)", 1)
    assert engine.seen[-1] == "smoke(hall)"


def test_it_is_gone_with_the_rules(engine):
    engine.call("reset_etalis")
    engine.event("temperature(1)", 1)
    engine.load(rules=":- event temperature(value:number).")
    engine.event("temperature(2)", 2)
    assert engine.seen == ["temperature(1)", "temperature(2)"]


def test_a_file_with_an_error_declares_nothing(engine):
    with pytest.raises(ProgramErrors):
        engine.load(rules=":- event smoke(room:atom).\na <- .")
    with pytest.raises(ProgramErrors):
        engine.load(rules=":- event smoke(room:atom).\n:- throw(no).")
    engine.event("smoke(1)", 1)
    assert engine.seen == ["smoke(1)"]


def test_what_a_program_asserts_and_is_no_declaration_is_none(engine):
    engine.call("assertz('$declared_event'(3))")
    engine.event("temperature(left, 3)", 1)
    assert engine.seen == ["temperature(left,3)"]


def test_it_is_kept_with_the_state(engine):
    other = Engine.restore(engine.snapshot())
    with pytest.raises(UsageError, match="event refused"):
        other.event("temperature(left, hot)", 1)
    with pytest.raises(ProgramErrors, match="has 2 arguments"):
        other.load(rules="a <- temperature(_).")


def test_it_is_exchanged_where_the_program_is_read_again(engine, tmp_path):
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


def test_a_declaration_is_read_once_and_none_is_looked_at_for_an_event(monkeypatch):
    read, looked = [], []
    reading = event_declarations._parse_clause  # noqa: SLF001
    found = event_declarations.DeclaredEvents._parse_clauses  # noqa: SLF001
    monkeypatch.setattr(event_declarations, "_parse_clause", lambda clause: read.append(1) or reading(clause))
    monkeypatch.setattr(
        event_declarations.DeclaredEvents, "_parse_clauses", lambda self: looked.append(1) or found(self)
    )
    engine = Engine()
    for number in range(30):
        engine.load(rules=f":- event e{number}(x:integer).")
    engine.event("e7(1)", 1)
    assert len(read) == 30
    looked.clear()
    for number in range(100):
        engine.event(f"e{number % 30}(1)", number + 1)
    assert not looked
    engine.load(rules=":- event more.")
    engine.event("more", 200)
    assert len(read) == 31
