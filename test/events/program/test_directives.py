"""Errors of directives, reported at the goal that failed."""

import pytest
from events.load_problems import errors_of, warnings_of
from events.program_runner import ProgramRunner


@pytest.mark.parametrize(
    ("directive", "column", "part"),
    [
        (":- no_such(1).", 4, "no_such/1"),
        (":- true, no_such(1), true.", 10, "no_such/1"),
        (":- member(X, [1, 2]), X > 1, no_such(X).", 30, "no_such/1"),
        (":- (true ; fail), !, atom_length(_, _), true.", 22, "instantiated"),
        (":- true, (fail, 5), true.", 17, "callable"),
        ("?- true, atom_length(_, _).", 10, "instantiated"),
        (":- d do no_such.", 4, "an event rule is written without :- before it"),
        (":- use_module(no_such_file).", 4, "No such file"),
        (":- include(no_such_file).", 4, "No such file"),
    ],
)
def test_error_is_reported_at_goal(directive: str, column: int, part: str) -> None:
    ((line, actual_column, message),) = errors_of(f"% first\n{directive}")
    assert (line, actual_column) == (2, column)
    assert part in message


@pytest.mark.parametrize(
    ("directive", "column"),
    [
        (":- fail.", 4),
        (":- true, fail, true.", 10),
        (":- member(X, [1, 2]), X > 5, true.", 23),
        (":- true, (fail).", 10),
    ],
)
def test_failure_is_reported_at_last_goal(directive: str, column: int) -> None:
    assert warnings_of(directive) == [(1, column, "this directive fails")]


def test_cut_is_local_to_directive() -> None:
    program = ProgramRunner(":- assertz(f(1)), assertz(f(2)), f(X), !, assertz(g(X)).")
    assert [answer["X"] for answer in program.engine.query("g(X)")] == [1]
    assert warnings_of(":- member(X, [1, 2]), !, X > 1.") == [(1, 26, "this directive fails")]


def test_nested_directives_keep_positions() -> None:
    inner = "compile_event_rules([(:- (true, true, true)), (:- (true, fail))])"
    warnings = ProgramRunner(f":- true, {inner}, fail.").warnings
    assert [warning.place.column if warning.place else None for warning in warnings] == [
        None,
        10 + len(inner) + 2,
    ]


@pytest.mark.parametrize("goal", ["'$goal'(b)", "'$goal'(_)", "'$goal'(99)", "'$goal'(-1)"])
def test_goal_marker_refuses_other_numbers(goal: str) -> None:
    assert warnings_of(f":- true, {goal}.") == [(1, 10, "this directive fails")]
    assert list(ProgramRunner("").engine.query(goal)) == []
