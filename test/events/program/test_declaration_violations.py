"""Violations of a file's event declarations, with their places."""

from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
from events.load_problems import errors_of

from retalis import Engine, ProgramErrors

DECLARATION = ":- event temperature(motor:atom, value:number).\n"
FORM = "temperature(motor:atom,value:number)"
ARITY = f"temperature/1 does not match its declaration: {FORM} has 2 arguments"
VALUE = f"value of temperature/2 is a number, found hot; declared as {FORM}"
CONFLICT = "V is a number (value of temperature/2) and, here, an atom (motor of temperature/2): these are never equal"


@pytest.mark.parametrize(
    ("rule", "column", "message"),
    [
        ("a <- b seq temperature(X).", 12, ARITY),
        ("temperature(X) <- b(X).", 1, ARITY),
        ("l : temperature(X) do true <- b(X).", 5, ARITY),
        ("a <- temperature or b.", 6, ARITY.replace("/1", "/0")),
        ("a <- (b seq c) cnot temperature(_, hot).", 36, VALUE),
        ("a <- b seq (temperature(_, hot) star_times).", 28, VALUE),
        ("a <- b seq aggregate(count, temperature(_, hot), N).", 44, VALUE),
        ("a <- temperature(_, hot) ntimes 3.", 21, VALUE),
        ("a <- b seq absent(temperature(_, hot), 3).", 34, VALUE),
        ("a <- temperature(_, hot) with throttle(3).", 21, VALUE),
        ("a(N) <- aggregate(count, temperature(_, hot), N, last(60)).", 41, VALUE),
        ("a <- state_of(M) seq (b or temperature(_, hot)).", 43, VALUE),
        ("a <- (s <- temperature(_, hot)) seq b.", 27, VALUE),
        ("a <- rev(temperature(_, hot)).", 25, VALUE),
        ("exceptionAlarm(temperature(_, hot), 3) <- b.", 31, VALUE),
        ("synchronized(temperature(_, hot), true, []) <- b.", 29, VALUE),
        ("synchronized(a, new_event(temperature(_, hot), 1, 2), []) <- b.", 42, VALUE),
        ("a do (true, new_event(temperature(_, hot), 1, 2)) <- b.", 38, VALUE),
        ("a <- b where (true ; event(temperature(_, hot))).", 43, VALUE),
        ("b do event(event(temperature(_, hot), [1, 2])).", 33, VALUE),
        ("go :- \\+ new_event(temperature(_, hot), [1, 2]).", 35, VALUE),
        ("go :- timer(temperature(_, hot), after(5)).", 28, VALUE),
        (":- true, new_event(temperature(_, hot), 1, 2, 3, 4).", 35, VALUE),
        ("a <- temperature(M, V) seq temperature(V, _).", 40, CONFLICT),
        (
            "temperature(V, 3) <- temperature(M, V).",
            37,
            "V is an atom (motor of temperature/2) and, here, a number (value of temperature/2): these are never "
            "equal",
        ),
        ("go(V) :- event(temperature(a, V)), event(temperature(V, 1)).", 54, CONFLICT),
    ],
)
def test_violation_is_reported_at_position(rule: str, column: int, message: str) -> None:
    assert errors_of(f"{DECLARATION}{rule}") == [(2, column, message)]


@pytest.mark.parametrize("pattern", list(permutations(("p(X)", "q(X)", "r(X)"))))
def test_types_without_common_value_are_reported_in_any_order(pattern: Any) -> None:
    """A time may be a number or a list, but a number is no list."""
    text = f":- event p(x:time), q(x:number), r(x:list).\na <- {' seq '.join(pattern)}."
    ((_, _, message),) = errors_of(text)
    assert message.endswith("these are never equal")
    assert "a time" not in message


def test_all_violations_are_reported() -> None:
    text = f"{DECLARATION}a <- temperature(X).\nb <- c.\nd <- temperature(3, hot)."
    assert [(line, column) for line, column, _ in errors_of(text)] == [(2, 6), (4, 18), (4, 21)]


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("a <- temperature(X).\n" + DECLARATION, 1),
        (DECLARATION + "a <- temperature(M, V) where (M == left, temperature(V)).\ntemperature(3).", 1),
        (DECLARATION + "a <- temperature(V, _) or temperature(_, V).", 1),
        (DECLARATION + "a <- b(V) do (number(V) -> event(temperature(m, V)) ; event(temperature(V, 1))).", 1),
        (DECLARATION + "go(X) :- event(X), new_event(X, 1, 2).", 0),
        (DECLARATION + DECLARATION, 0),
        (DECLARATION + "X <- a(X).", 1),
        (DECLARATION + "a <- temprature(X).", 1),
    ],
)
def test_earlier_or_uncertain_events_are_no_errors(text: str, number: int) -> None:
    engine = Engine()
    engine.load_rules(text)
    assert len(engine.rules.rules) == number
    with pytest.raises(ProgramErrors, match="does not match its declaration"):  # later rules are checked
        engine.load_rules("late <- temperature(X).")
    assert len(engine.rules.rules) == number


def test_declaration_may_be_earlier_or_included(tmp_path: Path) -> None:
    (tmp_path / "events.txt").write_text(DECLARATION)
    engine = Engine()
    engine.load(goals="event temperature(motor:atom, value:number)")
    other_engine = Engine()
    with pytest.raises(ProgramErrors, match="does not match its declaration"):
        engine.load_rules("a <- temperature(X).")
    with pytest.raises(ProgramErrors, match="does not match its declaration"):
        other_engine.load_rules(":- include('events.txt').\na <- temperature(X).", folder=tmp_path)
    assert engine.rules.rules == other_engine.rules.rules == []


@pytest.mark.parametrize(
    ("text", "line", "column", "message"),
    [
        (":- event t(a:nubmer).", 1, 12, "there is no type nubmer; did you mean number?"),
        (":- event t(a:atom).\n:- event t(b:atom).", 2, 10, "t is declared already, as t(a:atom)"),
        (
            ":- event t(a:atom), u(3).",
            1,
            23,
            "an argument is declared by its name and type, as in temperature(motor:atom, value:number)",
        ),
        (
            "event t(a:atom).",
            1,
            1,
            "a fact of declare_event/1 would replace the built-in predicate: write :- before a goal; "
            "to define a predicate of that name, declare it (:- dynamic declare_event/1.)",
        ),
    ],
)
def test_invalid_declaration_is_refused(text: str, line: int, column: int, message: str) -> None:
    assert errors_of(text) == [(line, column, message)]


def test_undeclared_event_is_refused_if_flag_is_set() -> None:
    lines = (
        "a <- b.",
        ":- set_etalis_flag(undeclared_events, error).",
        ":- event t(a:atom).",
        "null <- std_msgs__0__Bool(_).",
        "c <- memory_deleted(_).",
        ":- set_etalis_flag(undeclared_events, allowed).",
        "d <- e.",
    )
    assert errors_of("\n".join(lines)) == [(5, 1, "c/0 is not declared; write :- event c.")]
