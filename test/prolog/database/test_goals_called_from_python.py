"""Goals called from Python: solutions, nested attempts, limits, and tracebacks."""

import traceback
from typing import Any, List

import pytest
from prolog.goal_answers import answers, first, prolog

from retalis import Limits, PrologError, Var, atom, deref, functor
from retalis.prolog.machine.machine import Code
from retalis.prolog.syntax.term_reader import read_term


def goal(logic: Any, text: str, inputs: Any, outputs: Any) -> Any:
    read = read_term(text, logic.operators)
    return logic.compile_goal(
        read.term, [read.names[name] for name in inputs], [read.names[name] for name in outputs], name="test"
    )


FACTS = "p(1). p(2). p(3). q(X, Y) :- p(X), Y is X * 2."


def test_inline_goal_is_compiled_to_function() -> None:
    logic = prolog()
    compiled = goal(logic, "Z is Sec + NSec * 1.0e-9", ["Sec", "NSec"], ["Z"])
    assert compiled.function is not None
    assert compiled.first_solution((5, 500_000_000)) == (5.5,)
    with pytest.raises(PrologError, match="Arguments are not sufficiently instantiated"):
        compiled.first_solution((Var(), 1))


def test_goal_returns_first_or_all_solutions() -> None:
    logic = prolog(FACTS)
    compiled = goal(logic, "q(X, Y), Y > A", ["A"], ["X", "Y"])
    assert compiled.first_solution((2,)) == (2, 4)
    assert compiled.first_solution((10,)) is None
    assert compiled.all_solutions((0,)) == [(1, 2), (2, 4), (3, 6)]
    assert logic.machine.trail == [] == logic.machine.choices


def test_first_solution_undoes_bindings() -> None:
    logic = prolog()
    compiled = goal(logic, "X = f(Y, Z), Y = 3", ["X"], ["Y", "Z", "X"])
    point = functor("f", 2)
    assert compiled.first_solution(((point, 3, 4),)) == (3, 4, (point, 3, 4))
    variable = Var()
    y, z, x = compiled.first_solution((variable,))
    assert y == 3
    assert z.__class__ is Var
    assert x == (point, 3, z)
    assert variable.ref is None
    assert compiled.first_solution((4,)) is None
    assert logic.machine.trail == []


def test_goal_that_is_not_callable_is_refused() -> None:
    logic = prolog()
    with pytest.raises(PrologError, match="callable"):
        logic.compile_goal((functor(",", 2), atom("a"), 1))


def run(logic: Any, frame: Any) -> Any:
    return logic.machine.run((Code("test", lambda _: frame()),))


def test_attempt_continues_fails_or_reports_error() -> None:
    logic = prolog(FACTS)
    machine = logic.machine
    results: List[Any] = []

    def record(outputs: Any) -> Any:
        results.append(outputs)
        return machine.done

    find = goal(logic, "q(X, Y), Y > A", ["A"], ["X", "Y"])
    assert run(logic, lambda: find.attempt((2,), record, machine.done, results.append))
    assert results == [(2, 4)]
    assert run(logic, lambda: find.attempt((9,), record, machine.done, results.append))
    assert results == [(2, 4)]
    fails = goal(logic, "q(X, Y), Y > A, throw(ball(X))", ["A"], [])
    assert run(
        logic,
        lambda: fails.attempt((2,), record, machine.done, lambda error: results.append(error.term)),
    )
    assert results[1:] == [(functor("ball", 1), 2)]
    inline = goal(logic, "Y is X / 0", ["X"], ["Y"])
    assert run(
        logic,
        lambda: inline.attempt((2,), record, machine.done, lambda error: results.append(error.message)),
    )
    assert "zero_divisor" in results[2]
    assert machine.trail == [] == machine.choices


def test_nested_attempts_use_no_recursion() -> None:
    logic = prolog("step(0, 1).")
    machine = logic.machine
    find = goal(logic, "step(0, X)", [], ["X"])
    depth = 0

    def repeat(outputs: Any) -> Any:
        nonlocal depth
        depth += 1
        return machine.done if depth == 5000 else find.attempt((), repeat, None, print)

    assert run(logic, lambda: find.attempt((), repeat, None, print))
    assert depth == 5000


LOOPS = "loop :- loop. grow(X) :- grow(f(X)). pile(N) :- M is N + 1, pile(M), true."


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", ["loop", "grow(a)", "pile(0), true", "repeat, fail", "between(1, inf, X), X < 0"]
)
def test_goal_without_end_exceeds_inferences(text: str) -> None:
    logic = prolog(LOOPS)
    logic.limits = Limits(inferences=200_000)
    assert answers(logic, text) == ["resource_error(inferences)"]
    assert first(logic, f"catch(({text}), error(resource_error(W), _), true)") in (
        "inferences",
        {"X": "A", "W": "inferences"},
    )
    assert answers(logic, "X = 1") == [{"X": "1"}]


def test_goal_without_end_exceeds_seconds() -> None:
    logic = prolog(LOOPS)
    logic.limits = Limits(seconds=0.05)
    assert answers(logic, "loop") == ["resource_error(seconds)"]


@pytest.mark.slow
def test_growing_stack_exceeds_memory() -> None:
    logic = prolog("pile(T) :- pile([T,T,T,T,T,T|_]), true. piles(N) :- q(N), piles(N), q(N). q(_).")
    logic.limits = Limits(megabytes=50)
    assert answers(logic, "piles(1)") == ["resource_error(memory)"]


def test_bindings_of_solutions_last_until_next() -> None:
    logic = prolog(FACTS)
    read = read_term("p(X)", logic.operators)
    outer = logic.solutions(read.term)
    next(outer)
    assert deref(read.names["X"]) == 1
    assert answers(logic, "p(Y), Y > 1", 1) == [{"Y": "2"}]
    next(outer)
    assert deref(read.names["X"]) == 2
    outer.close()
    assert deref(read.names["X"]).__class__ is Var
    assert logic.machine.trail == [] == logic.machine.choices


def test_traceback_shows_generated_code_and_rule() -> None:
    logic = prolog("broken(X) :- oops(X).")

    def oops(machine: Any, value: Any) -> bool:
        raise KeyError("bug")

    logic.define("oops", 1, oops)
    with pytest.raises(KeyError) as error:
        logic.once(read_term("broken(1)", logic.operators).term)
    text = "".join(traceback.format_exception(KeyError, error.value, error.tb))
    assert "program.pl:1 broken/1" in text
    assert "(M, " in text


def test_changed_facts_are_called() -> None:
    logic = prolog("a(X) :- b(X). b(1). :- dynamic(b/1).")
    assert answers(logic, "a(X)") == [{"X": "1"}]
    assert answers(logic, "assertz(b(2)), a(X)") == [{"X": "1"}, {"X": "2"}]
    assert answers(logic, "retract(b(1)), a(X)") == [{"X": "2"}]


def test_program_overrides_library_for_itself() -> None:
    logic = prolog("append(mine, _, _). last(own, _). u(X) :- append(X, _, _).")
    assert answers(logic, "u(X)") == [{"X": "mine"}]
    assert first(logic, "append([[1], [2]], X)") == "[1,2]"
    with pytest.raises(PrologError, match="modify"):
        logic.add_clause(read_term("atom(a)", logic.operators).term)
