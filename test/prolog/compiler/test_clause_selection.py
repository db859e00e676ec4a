"""Clause selection by the distinguishing argument: same answers, and no choice point for the last clause."""

from random import Random

import pytest
from prolog.support import NEVER, answers, prolog

VALUES = ["a", "b", "c", "1", "2", "1.0", "f(a)", "f(b)", "g(a,b)", "[]", "[a]", '"s"', "_", "_"]


def table(random, size, with_bodies):
    clauses = []
    for number in range(size):
        values = [random.choice([*VALUES, str(number), f"k{number}", f"t{number}(x)"]) for _ in range(3)]
        head = f"p({', '.join(values)}, {number})"
        clauses.append(f"{head} :- q({number})." if with_bodies and random.random() < 0.7 else f"{head}.")
    return "\n".join([*clauses, *[f"q({number})." for number in range(size) if number % 3]])


def calls(random, size):
    for _ in range(25):
        known = [*VALUES, "X", "Y", str(random.randrange(size)), f"k{random.randrange(size)}", "f(X)", "zzz"]
        yield f"p({', '.join(random.choice(known) for _ in range(3))}, N)"
    yield f"p(X, Y, Z, {random.randrange(size)})"
    yield from ("p(X, X, Z, N)", "p(X, Y, X, N)", "p(X, Y, Y, N)", "p(X, X, X, N)", "X = Y, p(X, Y, Z, N)")


@pytest.mark.parametrize("with_bodies", [False, True], ids=["facts", "rules"])
@pytest.mark.parametrize("size", [3, 6, 12, 40])
@pytest.mark.parametrize("seed", range(4))
def test_any_argument_may_be_known(seed, size, with_bodies):
    random = Random(f"{seed} {size}")
    text = table(random, size, with_bodies)
    compiled, interpreted = prolog(text), prolog(text, NEVER)
    for call in calls(random, size):
        bound = f"[X, Y, Z] = [{', '.join(random.choice(['a', 'f(b)', '1', '_']) for _ in range(3))}], {call}"
        for goal in (call, bound):
            expected = answers(interpreted, goal, 60)
            for _ in range(2):  # what goes by a key does so from the second call on
                assert answers(compiled, goal, 60) == expected, f"{goal}\n{text}"


SMALL = "p(a, x, 1). p(a, y, 2). p(a, z, 3). p(b, x, 4). p(_, w, 5)."
MANY = " ".join(f"m({at}, k{at % 20}, n{at})." for at in range(40))
RULES = " ".join(f"r(k{at}(X), {at}, X) :- true." for at in range(40))


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
def test_where_one_clause_is_left_there_is_no_choice_point(goal):
    logic = prolog(f"{SMALL}\n{MANY}\n{RULES}\ncheck :- {goal}, '$left'.")
    left = []
    logic.define("$left", 0, lambda machine: left.append(len(machine.choices)) is None)
    for _ in range(20):
        assert answers(logic, "check") == [{}]
    assert len(set(left[-5:])) == 1
    none = prolog("check :- '$left'.")
    none.define("$left", 0, lambda machine: left.append(len(machine.choices)) is None)
    assert answers(none, "check") == [{}]
    assert left[-2] == left[-1]


def test_a_predicate_that_changes_is_looked_up_anew():
    logic = prolog(
        ":- dynamic m/3, r/2.\n" + MANY + "\n" + " ".join(f"r({at}, N) :- N = {at}." for at in range(40))
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


TAKEN_APART = [
    "functor(f(a, b), N, A)",
    "functor(f(a, b), f, 2)",
    "functor(f(a, b), f, A), A = 3",
    "functor(f(a, b), N, 3)",
    "functor(a, N, A)",
    "functor(1.5, N, A)",
    "functor([], N, 0)",
    "functor(T, f, 3)",
    "functor(T, f, 0)",
    "functor(T, 7, 0)",
    "functor(T, N, 2)",
    "functor(T, f, A)",
    "functor(T, f, x)",
    "functor(T, g(x), 1)",
    "functor(T, f, -1)",
    "T = U, functor(U, f, 1), functor(T, N, A)",
    "U = h(x, y, z), T = U, functor(T, N, A)",
    "functor(T, f, 1), T = f(x), functor(T, N, A)",
    "functor(T, T, 0)",
    "N = f, A = 2, functor(T, N, A)",
    "X = f(Y), X == Z",
    "X = f(Y), Z = f(Y), X == Z",
    "X == Y",
    "X = Y, X == Y",
    "X = 1, Y = 1.0, X == Y",
    "X = a, Y = b, X \\== Y",
    'X = "s", Y = "s", X == Y',
    "X = f(A, B), Y = f(A, C), X \\== Y",
    "X = 3, Y = X, Z is Y + X, Z =:= 6, X < Z",
    "X = Y, Y = 2.5, Z is X * 2",
    "X = Y, Z is X * 2",
    "X = a, Z is X * 2",
]


@pytest.mark.parametrize("goal", TAKEN_APART)
def test_goals_written_in_line_are_what_they_are_from_their_terms(goal):
    names = sorted(set("ABCNTUXYZ") & set(goal))
    call = f"go({', '.join(names)})" if names else "go"
    text = f"{call} :- {goal}."
    assert answers(prolog(text), call) == answers(prolog(text, NEVER), call)
