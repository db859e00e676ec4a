"""Compilation before the first call, and equal behaviour without it."""

from typing import Any

import pytest
from prolog.goal_answers import answers, first, prolog

from retalis import Var, functor
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.system.prolog_system import PrologSystem

PROGRAM = """
go(X) :- helper(X, Y), facts(Y).
helper(X, Y) :- Y is X + 1.
facts(2). facts(3).
other(X) :- helper(X, _).
:- dynamic counted/1.
counted(0).
"""
GO, HELPER, OTHER, COUNTED = (
    functor(name, arity) for name, arity in (("go", 1), ("helper", 2), ("other", 1), ("counted", 1))
)


def compiled(logic: Any, key: Any) -> Any:
    return logic.database.predicate(key).is_compiled


def test_reachable_predicates_are_compiled() -> None:
    logic = prolog(PROGRAM, 12)
    logic.database.compile_reachable([read_term("go(X), counted(_)", logic.operators).term])
    assert [compiled(logic, key) for key in (GO, HELPER, OTHER, COUNTED)] == [True, True, False, False]
    assert answers(logic, "go(1)") == answers(prolog(PROGRAM, 12), "go(1)") == [{}]


def test_precompiled_goal_equals_later_one() -> None:
    logic = prolog(PROGRAM, 12)
    x = Var()
    with logic.precompiling_goals(list):
        ready = logic.compile_goal((GO, x), [x])
    later = logic.compile_goal((GO, x), [x])
    for goal in (ready, later):
        assert goal.first_solution((1,)) == ()
        assert goal.first_solution((5,)) is None
    assert (
        ready.function is later.function or ready.function.__code__.co_code == later.function.__code__.co_code
    )


def test_goal_without_predicates_is_compiled_later() -> None:
    logic = PrologSystem()
    x = Var()
    with logic.precompiling_goals(lambda: [(GO, x)]):
        goal = logic.compile_goal((GO, x), [x])
    for text in ("go(1)", "go(2)"):
        logic.add_clause(read_term(text, logic.operators).term)
    assert goal.first_solution((2,)) == ()
    assert goal.first_solution((3,)) is None


def test_precompiled_goal_follows_added_facts() -> None:
    logic = prolog(PROGRAM, 12)
    x = Var()
    with logic.precompiling_goals(lambda: [(GO, x)]):
        goal = logic.compile_goal((GO, x), [x])
    assert goal.first_solution((9,)) is None
    logic.add_clause(read_term("facts(10)", logic.operators).term)
    assert goal.first_solution((9,)) == ()
    assert first(logic, "go(9)") == {}


def test_failed_precompilation_compiles_nothing() -> None:
    logic = prolog(PROGRAM, 12)
    with pytest.raises(KeyError), logic.precompiling_goals(lambda: [(GO, Var())]):
        raise KeyError
    assert not compiled(logic, GO)


def test_list_recursion_stops_at_end_of_list() -> None:
    logic = prolog(
        "walk([], _). walk([_|Rest], N) :- M is N + 1, walk(Rest, M).\n"
        "sum([], 0). sum([X|R], S) :- sum(R, T), S is T + X."
    )
    assert answers(logic, "walk([a, b], 0)") == [{}]
    assert answers(logic, "walk([a|b], 0)") == []
    assert answers(logic, "T = [], walk([a|T], 0)") == [{"T": "[]"}]
    assert answers(logic, "sum([1, 2, 3], S)") == [{"S": "6"}]
    assert len(answers(logic, "walk(L, 0)", 3)) == 3
