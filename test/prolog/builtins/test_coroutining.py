"""Goals that would wait for a variable: ``dif``, ``freeze`` and ``when``."""

from typing import Any

import pytest
from prolog.goal_answers import answers, nested_goal, prolog

from retalis import PrologError
from retalis.prolog.syntax.term_reader import read_term


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("dif(a, b)", [{}]),
        ("dif(a, a)", []),
        ("dif(f(X, a), f(X, b))", [{"X": "A"}]),
        ("dif(f(X), f(X))", []),
        ("dif(X, a)", ["instantiation_error"]),
        ("dif(f(X), f(Y))", ["instantiation_error"]),
        ("X = 1, freeze(X, Y = 2)", [{"X": "1", "Y": "2"}]),
        ("freeze(X, true)", ["instantiation_error"]),
        ("when(ground(f(a)), X = 1)", [{"X": "1"}]),
        ("when((nonvar(a), ground(b)), X = 1)", [{"X": "1"}]),
        ("when((nonvar(X) ; nonvar(b)), X = 1)", [{"X": "1"}]),
        ("when(?=(X, X), X = 1)", [{"X": "1"}]),
        ("when(nonvar(X), true)", ["instantiation_error"]),
        ("when(X, true)", ["instantiation_error"]),
        ("when(foo, true)", ["domain_error(when_condition,foo)"]),
    ],
)
def test_blocking_goals_run_or_are_errors(goal: str, expected: Any) -> None:
    assert answers(prolog(), goal) == expected


@pytest.mark.parametrize(
    "condition", ["(A, nonvar(a))", "(nonvar(a), A)", "(A ; nonvar(a))", "(nonvar(_) ; A)"]
)
def test_deep_condition_of_when_is_checked(condition: str) -> None:
    assert answers(prolog(), f"{nested_goal(condition, 'nonvar(a)')}, when(G, X = 1)")[0]["X"] == "1"


@pytest.mark.parametrize(
    "goal", ["dif(X, a)", "freeze(X, true)", "when(ground(f(X)), true)", "dif(f(X), f(Y))"]
)
def test_error_of_blocking_goal_names_alternative(goal: str) -> None:
    logic = prolog()
    with pytest.raises(PrologError) as error:
        logic.once(read_term(goal, logic.operators).term)
    name = goal[: goal.index("(")]
    assert f"(in {name}/2): goals cannot wait for a variable" in error.value.message
    assert "use_swi" in error.value.message
