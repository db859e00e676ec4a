"""Control constructs: cut, if-then-else, negation, exceptions, and deep nesting."""

from typing import Any

import pytest
from prolog.goal_answers import NEVER, answers, first, prolog

from retalis.prolog.syntax.term_reader import read_term

PROGRAM = """
p(1). p(2). p(3).
once_p(X) :- p(X), X >= 2, !.
cut_first(X) :- !, p(X).
cut_first(9).
cut_in_branch(X, Y) :- ( X > 1, !, Y = big ; Y = small ).
cut_in_branch(_, other).
cut_then(X, Y) :- ( p(X) -> ! , Y = one ; Y = two ).
cut_then(_, three).
local_cut(X) :- call((p(X), !)).
local_cut(4).
not_cut(X) :- \\+ (p(Y), !, Y = X).
test_cut(Y) :- ( (p(X), !, X > 1) -> Y = yes ; Y = no ).
soft(X, Y) :- ( p(X) *-> Y = X ; Y = none ).
soft_none(Y) :- ( fail *-> Y = some ; Y = none ).
chain(X, Y) :- ( X < 0 -> Y = minus ; X =:= 0 -> Y = zero ; X < 10 -> Y = digit ; Y = large ).
no_else(X) :- ( X > 0 -> true ), X < 5.
bind(X, Z) :- ( X = a -> Y = 1 ; X = b, Y = 2 ), Z = Y.
nested(L) :- findall(X-Y, (p(X), ( X > 1, p(Y), Y > 1 -> true ; Y = none )), L).
alternatives(X) :- ( X = 1 ; X = 2 ; fail ; X = 3 ).
after_or(X, Y) :- ( X = 1 ; X = 2 ), Y is X * 10, Y > 10.
loop(N) :- N > 0, !, M is N - 1, loop(M).
loop(0).
"""

CASES = [
    ("once_p(X)", ["2"]),
    ("cut_first(X)", ["1", "2", "3"]),
    ("cut_in_branch(2,Y)", ["big"]),
    ("cut_in_branch(1,Y)", ["small", "other"]),
    ("cut_then(X,Y)", [{"X": "1", "Y": "one"}]),
    ("local_cut(X)", ["1", "4"]),
    ("not_cut(1)", []),
    ("not_cut(2)", [{}]),
    ("test_cut(Y)", ["no"]),
    ("soft(X,Y)", [{"X": "1", "Y": "1"}, {"X": "2", "Y": "2"}, {"X": "3", "Y": "3"}]),
    ("soft_none(Y)", ["none"]),
    ("chain(-1,Y)", ["minus"]),
    ("chain(0,Y)", ["zero"]),
    ("chain(0.5,Y)", ["digit"]),
    ("chain(10,Y)", ["large"]),
    ("no_else(3)", [{}]),
    ("no_else(7)", []),
    ("no_else(0)", []),
    ("bind(X,Z)", [{"X": "a", "Z": "1"}]),
    ("bind(b,Z)", ["2"]),
    ("bind(c,Z)", []),
    ("nested(L)", ["[1-none,2-2,3-2]"]),
    ("alternatives(X)", ["1", "2", "3"]),
    ("after_or(X,Y)", [{"X": "2", "Y": "20"}]),
    ("loop(10000)", [{}]),
    ("G = (p(X), X > 1, !), call(G)", [{"G": "p(2),2>1,!", "X": "2"}]),
    ("forall(p(X), X > 0), \\+ forall(p(X), X > 1)", ["A"]),
    ("once(p(X))", ["1"]),
    ("ignore((p(X), X > 2))", ["3"]),
    ("ignore(fail)", [{}]),
    ("call(p, X)", ["1", "2", "3"]),
    ("call(1)", ["type_error(callable,1)"]),
    ("call((p(1), 1))", ["type_error(callable,(p(1),1))"]),
    ("call(_)", ["instantiation_error"]),
    ("X = 1 ; X = 2", ["1", "2"]),
    ("repeat, !", [{}]),
    ("between(1, 3, X), \\+ X = 2", ["1", "3"]),
]


@pytest.mark.slow
@pytest.mark.parametrize("compile_after", [0, 1, NEVER])
def test_control_constructs_follow_standard(compile_after: Any) -> None:
    logic = prolog(PROGRAM, compile_after)
    for _ in range(3):
        for goal, expected in CASES:
            solutions = answers(logic, goal)
            solutions = [
                next(iter(solution.values()))
                if isinstance(solution, dict) and len(solution) == 1
                else solution
                for solution in solutions
            ]
            assert solutions == expected, goal


CATCHES = """
thrower(X) :- X > 2, throw(too_big(X)).
thrower(X) :- X =< 2.
gen(1). gen(2). gen(3).
late(X) :- catch(gen(X), _, X = caught), check(X).
check(X) :- X < 2, throw(small).
check(_).
outer(X) :- catch(late(_), small, X = outer).
undo(X, Y) :- catch((X = 1, throw(oops)), oops, Y = X).
rethrow(X) :- catch(catch(throw(a), b, X = inner), a, X = outer).
"""


@pytest.mark.parametrize("compile_after", [0, NEVER])
def test_catch_follows_standard(compile_after: Any) -> None:
    logic = prolog(CATCHES, compile_after)
    assert first(logic, "catch(thrower(3), too_big(X), true)") == "3"
    assert answers(logic, "catch(thrower(1), _, fail)") == [{}]
    # A catch whose goal has exited is over: it does not catch later errors.
    assert answers(logic, "outer(X)") == [{"X": "outer"}]
    assert first(logic, "undo(X, Y)") == {"X": "A", "Y": "A"}
    assert first(logic, "rethrow(X)") == "outer"
    assert answers(logic, "throw(ball(_))") == ["ball(A)"]
    assert answers(logic, "throw(_)") == ["instantiation_error"]
    # Backtracking into its goal makes it active again.
    logic = prolog("g(1). g(2) :- throw(x). h(Y) :- catch(g(X), x, X = c), Y = X, Y \\== 1.", compile_after)
    assert answers(logic, "h(Y)") == [{"Y": "c"}]


def first_goal(logic: Any, text: str) -> Any:
    return read_term(text, logic.operators).term


DEEP = """
app([], L, L).
app([H|T], L, [H|R]) :- app(T, L, R).
len([], 0).
len([_|T], N) :- len(T, M), N is M + 1.
count(N, N) :- !.
count(I, N) :- I < N, J is I + 1, count(J, N).
state(S, 0, S) :- !.
state(S0, N, S) :- swap(S0, S1), M is N - 1, state(S1, M, S).
swap(s(A, B), s(B, A)).
wrap(0, z) :- !.
wrap(N, s(T)) :- M is N - 1, wrap(M, T).
guarded(0) :- !.
guarded(N) :- M is N - 1, catch(guarded(M), never, true).
pick(0).
pick(N) :- N > 0, M is N - 1, ( pick(M) ; fail ).
"""

N = 300_000


@pytest.mark.slow
@pytest.mark.parametrize(
    "goal",
    [
        f"numlist(1, {N}, L), app(L, [a], R), length(R, {N + 1})",
        f"numlist(1, {N}, L), len(L, {N})",
        f"count(0, {N})",
        f"wrap({N}, T), copy_term(T, U), T == U, T = U, ground(T)",
        "guarded(50000)",
        "pick(50000)",
        f"numlist(1, {N}, L), findall(X, member(X, L), M), L == M, msort(M, L)",
        f"length(L, {N}), maplist(=(1), L), sum_list(L, {N})",
    ],
)
def test_deep_recursion_overflows_no_stack(goal: str) -> None:
    logic = prolog(DEEP)
    assert logic.once(first_goal(logic, goal))


def test_deterministic_loop_does_not_fill_trail(monkeypatch: pytest.MonkeyPatch) -> None:
    logic = prolog(DEEP)
    highest = 0
    count_slice = logic.machine.budget.count_slice

    def record_height() -> None:
        nonlocal highest
        count_slice()
        highest = max(highest, len(logic.machine.trail))

    monkeypatch.setattr(logic.machine.budget, "count_slice", record_height)
    assert logic.once(first_goal(logic, "state(s(a, b), 100000, S), S = s(_, _)"))
    assert 0 < highest < 50_000
