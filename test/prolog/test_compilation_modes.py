"""Independence of answers from compilation; ``compilation_modes.py`` compares those of all suites."""

import pytest
from prolog.compilation_modes import compare
from prolog.test_recorded_swi_answers import recorded

PROGRAM = """
:- dynamic(fact/2).
:- table path/2, like/2.
order(V, A, R) :- compare(R, V, A).
other(V, A, R) :- compare(R, V, A).
other(_, _, none).
first(X) :- new(Y), Y @< X.
first(_).
new(_).
same(X, X).
pair(X, Y, X-Y).
equal(X, Y) :- X == Y.
equal(_, _).
sorted(X, Y, Z, L) :- sort([X, Y, Z], L).
fact(X, X).
fact(f(Y), Y).
fact(_, b).
many(1). many(2). many(f(X, X)). many(_). many(5). many(6). many(7). many(8). many(9).
edge(X, g(X)). edge(a, b). edge(b, _).
path(X, Y) :- path(X, Z), edge(Z, Y), Y \\= g(g(_)).
path(X, Y) :- edge(X, Y).
like(X, X).
like(_, _).
down(0, _) :- !.
down(N, X) :- M is N - 1, down(M, X).
down(_, lost).
item(N, T, A) :- arg(N, T, A), A \\== b.
item(_, _, none).
items(N, T, [A|L]) :- N > 0, !, arg(N, T, A), M is N - 1, items(M, T, L).
items(_, _, []).
pick(N, T, A) :- ( T = f(_, _) -> arg(N, T, A), ! ; arg(N, T, A) ), \\+ A == c.
pick(_, _, _).
third(T, A) :- arg(3, T, A).
third(_, none).
sum(N, T, A) :- N >= 1, K is N mod 3 + 1, arg(K, T, A), nonvar(A).
sum(_, _, none).
inside(N, X, A) :- N > 0, arg(N, f(X, g(X), A), g(A)), arg(N, f(A, A, X), A), A = 1.
inside(_, _, none).
new(N, A) :- N > 0, arg(N, T, A), T = f(a).
new(_, none).
"""

GOALS = [
    "X = f(A, C), order(C, A, R), order(A, C, S)",
    "X = f(A, C), other(C, A, R), other(A, C, S)",
    "order(A, B, R), same(A, C), order(C, B, S), order(B, C, T)",
    "order(A, B, R), same(C, A), order(B, C, S)",
    "order(A, B, R), pair(C, D, A-E), order(B, C, S), order(D, E, T), order(E, D, U)",
    "first(X), first(Y), order(X, Y, R)",
    "equal(A, B), order(B, A, R), order(A, B, S)",
    "sorted(C, A, B, L), order(A, C, R), sorted(A, B, C, M)",
    "order(A, B, R), fact(A, X), order(B, X, S), order(X, A, T)",
    "order(A, B, R), many(A), many(B), order(B, A, S)",
    "order(A, B, R), like(C, A), order(B, C, S), order(C, A, T)",
    "path(X, Y), order(Y, X, R), order(X, Y, S)",
    "item(2, f(a, b, c), X)",
    "item(N, f(a, b, c, X), X)",
    "item(-1, f(a), X)",
    "item(a, f(a), X)",
    "item(N, X, Y)",
    "items(3, f(A, B, C), L), items(3, g(C, A, B), L)",
    "pick(N, f(a, b), A)",
    "pick(1, f(a, b), A)",
    "pick(N, g(a, b, c), A)",
    "third(f(a, b, A), A), third(f(C, b, A), C), order(A, C, R)",
    "third(f(A, B, C), X), order(X, A, R), order(B, X, S)",
    "third(f(a, b), A)",
    "third(T, A)",
    "third(a, A)",
    "sum(1, f(A, B, c), X)",
    "sum(2, f(A, B, c), X), X = B",
    "sum(2.0, f(a, b, c), X)",
    "item(1 + 1, f(a, b, c), X)",
    "sum(1 + 1, f(a, b, c), X)",
    "inside(2, X, A)",
    "inside(1, g(Y), A)",
    "inside(1 + 1, X, A)",
    "inside(N, X, A)",
    "new(1, A)",
    "down(30, X), down(2, Y), order(Y, X, R), down(3, X), order(X, Y, S)",
    "order(A, B, _), \\+ \\+ A = B, findall(A-B, order(B, A, _), L), copy_term(B-A, C-D), order(D, C, R)",
    "order(A, B, _), assertz(fact(A, B)), fact(X, Y), order(Y, X, R), order(A, X, S)",
    "order(A, B, _), setof(X-Y, member(X-Y, [B-A, A-B, A-A]), L)",
    "order(A, B, _), length(L, 2), L = [B, A], msort(L, M), same(M, [_, C]), order(C, A, R)",
]


@pytest.mark.slow
@pytest.mark.parametrize("goal", GOALS)
def test_answers_are_independent_of_mode(goal: str) -> None:
    assert compare(PROGRAM, [goal]) == {}


@pytest.mark.slow
def test_recorded_goals_are_independent_of_mode() -> None:
    """Every 25th goal over the built-ins is the body of a clause."""
    goals = [goal for goal in list(recorded())[::25] if "time" not in goal and "random" not in goal]
    assert len(goals) > 30
    assert compare("", goals) == {}
