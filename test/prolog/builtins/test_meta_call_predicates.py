"""Meta-calls: limits, lambdas, distinct solutions, and goals of deep terms."""

from typing import List

import pytest
from prolog.goal_answers import answers, first, nested_goal, prolog

from retalis import Limits
from retalis.prolog.system.prolog_system import PrologSystem


@pytest.fixture
def logic() -> PrologSystem:
    return prolog("count(0) :- !.\ncount(N) :- M is N - 1, count(M).")


@pytest.mark.parametrize(
    ("goal", "values"),
    [
        ("call_with_inference_limit(true, 10000, R)", ["!"]),
        ("call_with_inference_limit(member(_, [1,2]), 10000, R)", ["true", "!"]),
        ("call_with_inference_limit(count(100), 10000, R)", ["!"]),
        ("call_with_inference_limit(count(100000), 10000, R)", ["inference_limit_exceeded"]),
        (
            "length(L, 50000), maplist(=(a), L), call_with_inference_limit(meta_predicate(L), 10000, R)",
            ["inference_limit_exceeded"],
        ),
        (
            "H is 1 << 1_000_000, call_with_inference_limit(randset(5, H, _), 50000, R)",
            ["inference_limit_exceeded"],
        ),
        ("call_with_inference_limit(fail, 10000, R)", []),
        ("call_with_inference_limit(throw(x), 10000, R)", ["x"]),
        (
            "call_with_inference_limit(call_with_inference_limit(count(100000), 10000, R), 1000000, _)",
            ["inference_limit_exceeded"],
        ),
        (
            "call_with_inference_limit(call_with_inference_limit(count(100000), 1000000, _), 10000, R)",
            ["inference_limit_exceeded"],
        ),
        ("call_with_inference_limit(true, 1000, _), once(count(100000)), R = on", ["on"]),
        ("call_with_inference_limit(a, _, R)", ["instantiation_error"]),
        ("findall(L, findnsols(2, X, member(X, [a,b,c]), L), R)", ["[[a,b],[c]]"]),
        ("findall(L, findnsols(2, X, (member(X, [a,b]) ; fail), L), R)", ["[[a,b],[]]"]),
        ("findall(L, findnsols(2, X, fail, L), R)", ["[[]]"]),
        ("findnsols(2, X, member(X, [a,b,c]), R, [z])", ["[a,b,z]", "[c,z]"]),
        ("aggregate_all(count, X, member(X, [a,b,a]), R)", ["2"]),
        ("aggregate_all(sum(Y), X, member(X-Y, [a-1,b-1,a-1]), R)", ["2"]),
        ("aggregate_all(bag(Y), X, member(X-Y, [b-1,b-3,a-1]), R)", ["[1,1,3]"]),
        ("aggregate_all(max(Y), X, member(X-Y, [b-1,b-3,a-1]), R)", ["3"]),
        ("aggregate_all(nonsense, X, true, R)", ["domain_error(aggregate_template,nonsense)"]),
    ],
)
def test_meta_call_has_results(logic: PrologSystem, goal: str, values: List[str]) -> None:
    solutions = answers(logic, goal)
    shown = [answer["R"] if isinstance(answer, dict) else answer for answer in solutions]
    assert shown == values
    assert logic.machine.budget.ceilings == {}


@pytest.mark.parametrize("step", ["\\+ A", "(A -> true)", "((A, _) , true)"])
def test_goal_beyond_depth_limit_is_an_error(logic: PrologSystem, step: str) -> None:
    answer = first(logic, f"{nested_goal(step, 'true')}, catch(G, error(E, _), true)")
    assert answer["E"] == "resource_error(term_size)"
    assert logic.machine.choices == []


def test_loading_library_uses_no_inferences(logic: PrologSystem) -> None:
    logic.limits = Limits(inferences=2000)
    assert answers(logic, "append([1], [2], L), list_to_assoc([], _)") == [{"L": "[1,2]"}]


def test_caret_outside_bagof_calls_goal(logic: PrologSystem) -> None:
    assert answers(logic, "X^member(X, [1,2])") == [{"X": "1"}, {"X": "2"}]
    assert answers(logic, "_^G") == ["instantiation_error"]


def test_distinct_solutions_occur_once(logic: PrologSystem) -> None:
    assert answers(logic, "distinct(X, member(X-_, [1-a,1-b,2-c]))") == [{"X": "1"}, {"X": "2"}]
    assert answers(logic, "distinct(member(X, [b,b,a]))") == [{"X": "b"}, {"X": "a"}]


@pytest.mark.parametrize(
    ("goal", "values"),
    [
        ("maplist([X,Y]>>(Y is X * 2), [1,2], L)", ["[2,4]"]),
        ("N = 3, maplist([X,Y]>>(Y is X * N), [1,2], L)", ["[3,6]"]),
        ("maplist([X-Y,Y]>>true, [1-a,2-b], L)", ["[a,b]"]),
        ("maplist([X,X]>>true, [1,2], L)", ["[1,2]"]),
        ("maplist([X]>>(X = f(Z)), [A,B]), A == B", []),
        ("maplist(Z/[X]>>(X = f(Z)), [A,B]), A == B, Z = 1, L = A", ["f(1)"]),
        ("call([X]>>plus(X), 1, 2, L)", ["3"]),
        ("call([X,Y]>>(Y = X), L, 1)", ["1"]),
        ("maplist(X/[X]>>true, [1,1]), L = X", ["1"]),
    ],
)
def test_lambda_shares_free_variables_only(logic: PrologSystem, goal: str, values: List[str]) -> None:
    solutions = answers(logic, goal)
    assert [solution["L"] if isinstance(solution, dict) else solution for solution in solutions] == values
