"""Predicates compiled to functions: same answers, errors and bindings as with frames."""

import random
from typing import Any, Iterator, List, Tuple

import pytest
from asserting_accessors import required
from prolog.compiler.test_predicate_code import term
from prolog.goal_answers import NEVER, prolog, show

from retalis import PrologError, Var, functor
from retalis.prolog.compiler.semidet_functions import BAIL
from retalis.prolog.syntax.term_reader import read_term

PROGRAM = """
inc(X, Y) :- Y is X + 1.
big(X) :- X > 5, !.
big(X) :- X < -5.
twice(X, Y) :- inc(X, Z), inc(Z, Y).
color(a, 1). color(b, 2). color(c, 3).
any(X) :- color(_, X).
key(K, V) :- color(K, W), V is W * 10.
two(X) :- X = 1.
two(X) :- X = 2.
later(X) :- two(X), X > 1.
cut(X, Y) :- two(X), !, Y = X.
kind(X, K) :- ( big(X) -> K = big ; color(_, X) -> K = color ; K = none ).
not_big(X) :- \\+ big(X).
max(X, Y, X) :- X >= Y.
max(X, Y, Y) :- X < Y.
wrong(X) :- inc(X, _).
len([], 0).
len([_|T], N) :- len(T, M), N is M + 1.
even(0).
even(X) :- X > 0, Y is X - 1, odd(Y).
odd(X) :- X > 0, Y is X - 1, even(Y).
pair(f(X, Y), Y, X).
says(X) :- big(X), write(X).
same(X, X).
bound(X) :- X = g(_), X = g(1).
"""


def compiled(logic: Any, text: str, inputs: Any, outputs: Any) -> Any:
    read = read_term(text, logic.operators)
    return logic.compile_goal(
        read.term, [read.names[name] for name in inputs], [read.names[name] for name in outputs]
    )


def result_of(goal: Any, values: Any) -> Any:
    """Return the outputs of a goal as texts, the text of its error, or None."""
    try:
        outputs = goal.first_solution(values)
    except PrologError as error:
        return show(error.term)
    return None if outputs is None else tuple(map(show, outputs))


def result_by_both(logic: Any, text: str, inputs: Any, outputs: Any, values: Any) -> Tuple[Any, ...]:
    """Return the result of a goal, equal by function and by frames, and whether a function returned it."""
    with_function = compiled(logic, text, inputs, outputs)
    by_frames = compiled(logic, text, inputs, outputs)
    by_frames.function = None
    expected = result_of(by_frames, values)
    for _ in range(2):
        assert result_of(with_function, values) == expected
        assert logic.machine.trail == [] == logic.machine.choices
    return expected, with_function.function is not None and with_function.function(*values) is not BAIL


CASES = [
    ("inc(X, Y)", (3,), ("4",), True),
    ("twice(X, Y)", (3,), ("5",), True),
    ("big(X)", (7,), (), True),
    ("big(X)", (-7,), (), True),
    ("big(X)", (1,), None, True),
    ("key(b, Y)", (), ("20",), True),
    ("any(X)", (3,), (), True),
    ("color(Y, X), X > 1", (2,), ("b",), True),
    ("color(_, Y), Y > 1", (), ("2",), False),
    ("later(Y)", (), ("2",), False),
    ("later(X)", (2,), (), True),
    ("cut(Y, Z)", (), ("1", "1"), True),
    ("cut(Y, Z), Y > 1", (), None, True),
    ("kind(X, Y)", (9,), ("big",), True),
    ("kind(X, Y)", (2,), ("color",), True),
    ("kind(X, Y)", (4,), ("none",), True),
    ("not_big(X)", (4,), (), True),
    ("max(X, 3, Y)", (4,), ("4",), True),
    ("max(X, 3, Y), Y > 3", (4,), ("4",), False),
    ("max(X, 3, Y)", (2,), ("3",), True),
    ("len([a,b], Y)", (), ("2",), False),
    ("even(X)", (4,), (), False),
    ("pair(f(1, X), Y, Z)", (2,), ("2", "1"), True),
    ("same(f(Y, X), f(1, Z))", (2,), ("1", "2"), True),
    ("bound(Y)", (), ("g(1)",), True),
    ("says(X)", (1,), None, False),
    ("two(Y), !, Y > 1", (), None, True),
    ("\\+ two(X), Y = no", (3,), ("no",), True),
    ("( two(X) -> Y = yes ; Y = no )", (2,), ("yes",), True),
]


@pytest.mark.parametrize(("text", "values", "expected", "is_function"), CASES)
def test_functions_return_answers_of_frames(text: str, values: Any, expected: Any, is_function: bool) -> None:
    logic = prolog(PROGRAM)
    outputs = [name for name in "YZ" if name in text]
    inputs = ["X"] if values else []
    result, function = result_by_both(logic, text, inputs, outputs, values)
    assert result == expected
    assert function == is_function


def test_errors_have_context_of_predicate() -> None:
    logic = prolog(PROGRAM)
    result, function = result_by_both(logic, "wrong(X)", ["X"], [], (functor("f", 1)(1),))
    assert result == "error(type_error(evaluable,f/1),context(inc/2,A))"
    assert not function
    assert result_by_both(logic, "wrong(X)", ["X"], [], (Var(),))[0].startswith(
        "error(instantiation_error,context(inc/2"
    )


def test_error_outside_predicates_has_no_context() -> None:
    logic = prolog(PROGRAM)
    for _ in range(3):
        result, _ = result_by_both(logic, "two(Z), Y is X + 1, Y > Z", ["X"], ["Y"], (functor("f", 1)(1),))
        assert result == "error(type_error(evaluable,f/1),A)"


def test_input_variables_are_unbound_after_call() -> None:
    logic = prolog(PROGRAM)
    var = Var()
    goal = compiled(logic, "two(X)", ["X"], ["X"])
    assert goal.first_solution((var,)) == (1,)
    assert var.ref is None
    failing = compiled(logic, "X = 1, !, X = 2", ["X"], [])
    assert failing.first_solution((var,)) is None
    assert var.ref is None
    assert logic.machine.trail == []


def test_changed_facts_change_answers() -> None:
    logic = prolog(":- dynamic state/2. is_on(X) :- state(X, on).")
    goal = compiled(logic, "is_on(X)", ["X"], [])
    lamp = read_term("lamp", logic.operators).term
    change = {True: "assertz(state(lamp, on))", False: "retract(state(lamp, on))"}
    for on in [True, False] * 3:
        assert logic.once(read_term(change[on], logic.operators).term)
        assert (goal.first_solution((lamp,)) is not None) is on
    assert logic.once(read_term("assertz((state(X, on) :- X == lamp))", logic.operators).term)
    assert goal.first_solution((lamp,)) == ()


def test_function_uses_index_of_facts() -> None:
    logic = prolog(" ".join(f"p({n}, {n * n})." for n in range(200)) + " q(X, Y) :- p(X, Y), Y > 0.")
    assert result_by_both(logic, "q(X, Y)", ["X"], ["Y"], (12,)) == (("144",), True)
    assert result_by_both(logic, "q(X, Y)", ["X"], ["Y"], (0,)) == (None, True)
    assert result_by_both(logic, "p(_, Y), Y > 3", [], ["Y"], ()) == (("4",), False)
    assert result_by_both(logic, "p(_, Y)", [], ["Y"], ()) == (("0",), True)


def test_added_clauses_are_called() -> None:
    logic = prolog("p(1). q(X) :- p(X).")
    goal = compiled(logic, "q(X)", ["X"], [])
    assert goal.first_solution((2,)) is None
    logic.add_clause(read_term("p(2)", logic.operators).term)
    assert goal.first_solution((2,)) == ()
    logic.add_clause(read_term("p(X) :- q(X)", logic.operators).term)
    assert goal.first_solution((1,)) == ()
    assert goal.function(1) is BAIL


def test_predicate_is_defined_after_goal() -> None:
    logic = prolog()
    goal = compiled(logic, "inc(X, Y)", ["X"], ["Y"])
    logic.add_clause(read_term("inc(X, Y) :- Y is X + 1", logic.operators).term)
    assert goal.first_solution((1,)) == (2,)
    assert goal.function(1) == (2,)


def test_function_that_bails_out_is_dropped() -> None:
    logic = prolog(PROGRAM)
    goal = compiled(logic, "later(Y)", [], ["Y"])
    for _ in range(30):
        assert goal.first_solution(()) == (2,)
    assert goal.function is None


def test_attempts_use_functions_or_frames() -> None:
    logic = prolog(PROGRAM)
    machine = logic.machine
    for text, values, expected in (
        ("inc(X, Y)", (3,), (4,)),
        ("later(Y)", (), (2,)),
        ("max(X, 3, Y), Y > 3", (4,), (4,)),
    ):
        goal = compiled(logic, text, ["X"] if values else [], ["Y"])
        results: List[Any] = []

        def record(outputs: Any, results: Any = results) -> Any:
            results.append(outputs)
            return machine.done

        assert machine.run(required(goal.attempt(values, record, machine.done, results.append)))
        assert results == [expected]


def body(rng: Any, names: Any) -> str:
    goals: List[Any] = []
    for _ in range(rng.randint(0, 3)):
        kind = rng.random()
        call = f"{rng.choice(names)}({term(rng)}, {term(rng)})"
        if kind < 0.5:
            goals.append(call)
        elif kind < 0.6:
            goals.append(f"{term(rng)} = {term(rng)}")
        elif kind < 0.7:
            goals.append(f"( {call} -> {term(rng)} = {term(rng)} ; {term(rng)} \\= {term(rng)} )")
        elif kind < 0.8:
            goals.append(f"\\+ {call}")
        elif kind < 0.9:
            goals.append("!")
        else:
            goals.append(f"{rng.choice('XYZ')} is {rng.choice('XYU')} + 1")
    return ", ".join(goals) or "true"


def program(rng: Any) -> str:
    """Return clauses of p, q and r; each calls only those after it."""
    names = ["p", "q", "r", "s"]
    lines = ["s(1, a). s(2, b). s([a], X) :- X = 1."]
    for index, name in enumerate(names[:3]):
        for _ in range(rng.randint(1, 3)):
            lines.append(f"{name}({term(rng)}, {term(rng)}) :- {body(rng, names[index + 1 :])}.")
    return "\n".join(lines)


@pytest.mark.slow
def test_random_goals_have_answers_of_frames() -> None:
    results, functions = zip(*[outcome for seed in range(60) for outcome in random_outcomes(seed)])
    assert sum(result is not None for result in results) > 50
    assert sum(functions) > 50


def random_outcomes(seed: Any) -> Iterator[Any]:
    """Yield the results of random goals, and whether functions returned them."""
    rng = random.Random(seed)
    text = program(rng)
    logic = prolog(text, rng.choice([0, NEVER]))
    for _ in range(4):
        value = read_term(term(rng), logic.operators).term
        goal = f"p(X, Y), {body(rng, ['q', 'r'])}, Z = Y"
        yield result_by_both(logic, goal, ["X"], ["Z"], (value,))
    assert logic.machine.choices == []
