"""Conditions that never hold, and arithmetic that is not evaluated."""

from typing import Any, List

import pytest

from retalis import Definitions, Engine
from retalis.events.checks.condition_checks import find_impossible_conditions
from retalis.events.checks.program_model import ProgramModel
from retalis.events.program.topic_configuration import Topics


def findings_of(rules: str) -> List[Any]:
    engine = Engine()
    engine.load(rules=rules)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    return [error.message for error in find_impossible_conditions(program)]


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ("T > T", "T>T never holds: both sides are the same"),
        ("f(T) \\== f(T)", "f(T)\\==f(T) never holds: both sides are the same"),
        ("X = T * 1.8", "= does not evaluate T*1.8: write X is T*1.8"),
        ("X = T - 1", "= does not evaluate T-1: write X is T-1"),
        ("D == E - T", "== does not evaluate E-T: write D =:= E-T"),
        ("X \\== T + 1", "\\== does not evaluate T+1: write X =\\= T+1"),
        ("40 = T + 1", "= does not evaluate T+1: write 40 =:= T+1"),
        (
            "M > bob",
            "bob is not a number: a variable begins with a capital letter, and names are compared with == or @<",
        ),
        ("X is t * 2", "t is not a number: did you mean the variable T?"),
    ],
)
def test_condition_is_reported(condition: str, message: str) -> None:
    assert findings_of(f"a(D, E, M, X) <- temp(M, T, X, D, E) where {condition}.") == [message]


@pytest.mark.parametrize(
    "condition", ["T > 40, T < 30", "T > 40, 40 >= T", "T =:= 4, T =:= 5", "\\+ (T > 4, T < 3)"]
)
def test_empty_interval_is_reported(condition: str) -> None:
    (message,) = findings_of(f"a <- temp(T) where ({condition}).")
    assert message.endswith(
        "never holds together with the comparisons of T before it; alternatives are joined with ;"
    )


@pytest.mark.parametrize(
    "pattern",
    [
        "(temp(T) where T > 40) where T < 30",
        "(temp(T) where T > 40) seq (temp(T) where T < 30)",
        "((temp(T) where T > 40) within 5) where T < 30",
        "((temp(T) where T > 40) cnot b) where T < 30",
        "((temp(T) where T > 40) with throttle(3)) where T < 30",
    ],
)
def test_bounds_of_several_conditions_are_intersected(pattern: str) -> None:
    (message,) = findings_of(f"a <- {pattern}.")
    assert message.startswith(
        "T<30 never holds together with the comparisons of T before it; T has one value"
    )


@pytest.mark.parametrize(
    "pattern",
    [
        "(temp(T) where T > 40) or (temp(T) where T < 30)",
        "(temp(T) where T > 40) seq (temp(U) where U < 30)",
        "b cnot (temp(T) where T > 40) where T < 30",
        "(temp(T) where (T > 40 ; T < 10)) where T < 30",
        "(temp(T) where \\+ T > 40) where T < 30",
        "b seq aggregate(count, (temp(T) where T > 40), T) where T < 30",
        "(temp(T) where T > 40) do T < 30",
    ],
)
def test_bounds_of_alternatives_are_separate(pattern: str) -> None:
    assert findings_of(f"a <- {pattern}.") == []


def test_assignment_is_reported() -> None:
    (message,) = findings_of("a(N) <- count(N) where N is N + 1.")
    assert message.startswith("N is N+1 never changes N: a variable keeps its value")


@pytest.mark.parametrize(
    "condition",
    [
        "T > X",
        "T =\\= T",
        "X = M - T",
        "X == a - b",
        "F = T * 2, F > 80",
        "T >= 40, T =< 40",
        "T > 40 ; T < 30",
        "T > 30, T < 40",
        "T is round(T)",
        "T < inf",
        "T > pi",
        "member(X, [1, 2]), X > T",
    ],
)
def test_possible_condition_is_not_reported(condition: str) -> None:
    assert findings_of(f"a(M, X) <- temp(M, T, X) where {condition}.") == []


def test_pair_in_clause_is_not_reported() -> None:
    assert findings_of("pair(X) :- count(N), X = N-1. a <- b where pair(_).") == []
    (message,) = findings_of("twice(X) :- count(N), X = N*2. a <- b where twice(_).")
    assert message.startswith("= does not evaluate")


@pytest.mark.parametrize(
    ("rule", "count"),
    [
        ("c(M) do (assertz(seen(M)), fail) <- temp(M).", 1),
        ("c(M) <- temp(M) do (assertz(seen(M)), false).", 1),
        ("null do (assertz(seen(M)), fail) <- temp(M).", 0),
        ("c(M) do (seen(M), fail ; assertz(seen(M))) <- temp(M).", 0),
        ("c(M) do (seen(M) -> fail ; assertz(seen(M))) <- temp(M).", 0),
        ("c(M) <- temp(M) where fail.", 0),
    ],
)
def test_goal_of_do_that_always_fails_is_reported(rule: str, count: int) -> None:
    messages = findings_of(rule)
    assert len(messages) == count
    assert all("so that c/1 never happens" in message for message in messages)
