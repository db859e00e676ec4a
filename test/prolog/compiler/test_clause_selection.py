"""Clause selection by the distinguishing argument: same answers, and no choice point for the last clause."""

from random import Random
from typing import Any, Iterator, List

import pytest
from prolog.goal_answers import NEVER, answers, prolog

from retalis.prolog.machine.machine import Machine

VALUES = ["a", "b", "c", "1", "2", "1.0", "f(a)", "f(b)", "g(a,b)", "[]", "[a]", '"s"', "_", "_"]


def table(random: Any, size: Any, with_bodies: Any) -> str:
    clauses: List[Any] = []
    for number in range(size):
        values = [random.choice([*VALUES, str(number), f"k{number}", f"t{number}(x)"]) for _ in range(3)]
        head = f"p({', '.join(values)}, {number})"
        clauses.append(f"{head} :- q({number})." if with_bodies and random.random() < 0.7 else f"{head}.")
    return "\n".join([*clauses, *[f"q({number})." for number in range(size) if number % 3]])


def calls(random: Any, size: Any) -> Iterator[str]:
    for _ in range(25):
        known = [*VALUES, "X", "Y", str(random.randrange(size)), f"k{random.randrange(size)}", "f(X)", "zzz"]
        yield f"p({', '.join(random.choice(known) for _ in range(3))}, N)"
    yield f"p(X, Y, Z, {random.randrange(size)})"
    yield from ("p(X, X, Z, N)", "p(X, Y, X, N)", "p(X, Y, Y, N)", "p(X, X, X, N)", "X = Y, p(X, Y, Z, N)")


@pytest.mark.parametrize("with_bodies", [False, True], ids=["facts", "rules"])
@pytest.mark.parametrize("size", [3, 6, 12, 40])
@pytest.mark.parametrize("seed", range(4))
def test_known_arguments_do_not_change_answers(seed: int, size: int, with_bodies: bool) -> None:
    random = Random(f"{seed} {size}")
    text = table(random, size, with_bodies)
    compiled, interpreted = prolog(text), prolog(text, NEVER)
    solutions = 0
    for call in calls(random, size):
        bound = f"[X, Y, Z] = [{', '.join(random.choice(['a', 'f(b)', '1', '_']) for _ in range(3))}], {call}"
        for goal in (call, bound):
            expected = answers(interpreted, goal, 60)
            solutions += len(expected)
            for _ in range(2):  # from the second call on, clauses are selected by their keys
                assert answers(compiled, goal, 60) == expected, f"{goal}\n{text}"
    assert solutions > 0


SMALL = "p(a, x, 1). p(a, y, 2). p(a, z, 3). p(b, x, 4). p(_, w, 5)."
MANY = " ".join(f"m({number}, k{number % 20}, n{number})." for number in range(40))
RULES = " ".join(f"r(k{number}(X), {number}, X) :- true." for number in range(40))


@pytest.mark.parametrize(
    "goal",
    [
        "p(b, x, N)",
        "p(_, y, N)",
        "p(a, z, N)",
        "p(X, Y, 2)",
        "m(7, k7, N)",
        "m(X, Y, n7)",
        "r(k3(a), N, X)",
        "r(T, 3, X)",
        "X = Y, m(7, Z, N)",
    ],
)
def test_last_candidate_leaves_no_choice_point(goal: str) -> None:
    logic = prolog(f"{SMALL}\n{MANY}\n{RULES}\ncheck :- {goal}, '$left'.")
    heights: List[int] = []

    def record_height(machine: Machine) -> bool:
        heights.append(len(machine.choices))
        return True

    logic.define("$left", 0, record_height)
    for _ in range(20):
        assert answers(logic, "check") == [{}]
    assert len(set(heights[-5:])) == 1
    baseline = prolog("check :- '$left'.")
    baseline.define("$left", 0, record_height)
    assert answers(baseline, "check") == [{}]
    assert heights[-2] == heights[-1]


def test_changed_predicate_is_indexed_again() -> None:
    logic = prolog(
        ":- dynamic m/3, r/2.\n"
        + MANY
        + "\n"
        + " ".join(f"r({number}, N) :- N = {number}." for number in range(40))
    )
    for _ in range(20):
        assert answers(logic, "m(7, X, Y), r(7, N)") == [{"X": "k7", "Y": "n7", "N": "7"}]
    assert answers(logic, "retract(m(7, _, _)), assertz(m(99, new, new)), assertz((r(7, N) :- N = more))")
    for _ in range(20):
        assert answers(logic, "m(7, X, Y)") == []
        assert answers(logic, "m(99, X, Y), r(7, N)") == [
            {"X": "new", "Y": "new", "N": "7"},
            {"X": "new", "Y": "new", "N": "more"},
        ]


INLINE_GOALS = {
    "functor(f(a, b), N, A)": [{"A": "2", "N": "f"}],
    "functor(f(a, b), f, 2)": [{}],
    "functor(f(a, b), f, A), A = 3": [],
    "functor(f(a, b), N, 3)": [],
    "functor(a, N, A)": [{"A": "0", "N": "a"}],
    "functor(1.5, N, A)": [{"A": "0", "N": "1.5"}],
    "functor([], N, 0)": [{"N": "[]"}],
    "functor(T, f, 3)": [{"T": "f(A,B,C)"}],
    "functor(T, f, 0)": [{"T": "f"}],
    "functor(T, 7, 0)": [{"T": "7"}],
    "functor(T, N, 2)": ["instantiation_error"],
    "functor(T, f, A)": ["instantiation_error"],
    "functor(T, f, x)": ["type_error(integer,x)"],
    "functor(T, g(x), 1)": ["type_error(atomic,g(x))"],
    "functor(T, f, -1)": ["domain_error(not_less_than_zero,-1)"],
    "T = U, functor(U, f, 1), functor(T, N, A)": [{"A": "1", "N": "f", "T": "f(A)", "U": "f(A)"}],
    "U = h(x, y, z), T = U, functor(T, N, A)": [{"A": "3", "N": "h", "T": "h(x,y,z)", "U": "h(x,y,z)"}],
    "functor(T, f, 1), T = f(x), functor(T, N, A)": [{"A": "1", "N": "f", "T": "f(x)"}],
    "functor(T, T, 0)": ["instantiation_error"],
    "N = f, A = 2, functor(T, N, A)": [{"A": "2", "N": "f", "T": "f(A,B)"}],
    "X = f(Y), X == Z": [],
    "X = f(Y), Z = f(Y), X == Z": [{"X": "f(A)", "Y": "A", "Z": "f(A)"}],
    "X == Y": [],
    "X = Y, X == Y": [{"X": "A", "Y": "A"}],
    "X = 1, Y = 1.0, X == Y": [],
    "X = a, Y = b, X \\== Y": [{"X": "a", "Y": "b"}],
    'X = "s", Y = "s", X == Y': [{"X": '"s"', "Y": '"s"'}],
    "X = f(A, B), Y = f(A, C), X \\== Y": [{"A": "A", "B": "A", "C": "A", "X": "f(A,B)", "Y": "f(A,B)"}],
    "X = 3, Y = X, Z is Y + X, Z =:= 6, X < Z": [{"X": "3", "Y": "3", "Z": "6"}],
    "X = Y, Y = 2.5, Z is X * 2": [{"X": "2.5", "Y": "2.5", "Z": "5.0"}],
    "X = Y, Z is X * 2": ["instantiation_error"],
    "X = a, Z is X * 2": ["type_error(evaluable,a/0)"],
}


@pytest.mark.parametrize("compile_after", [0, NEVER], ids=["compiled", "interpreted"])
@pytest.mark.parametrize("goal", INLINE_GOALS)
def test_inline_goals_have_answers_of_builtins(goal: str, compile_after: Any) -> None:
    names = sorted(set("ABCNTUXYZ") & set(goal))
    call = f"go({', '.join(names)})" if names else "go"
    text = f"{call} :- {goal}."
    assert answers(prolog(text, compile_after), call) == INLINE_GOALS[goal]
