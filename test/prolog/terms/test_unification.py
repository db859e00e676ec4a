"""Unification of large terms up to the first difference."""

from typing import Any, List

from retalis import Var, atom, functor, make_list
from retalis.prolog.terms.unification import unify

F = functor("f", 1)


def test_early_difference_binds_no_variables() -> None:
    trail: List[Any] = []
    left = make_list([F(atom("a")), *[Var() for _ in range(100)]])
    assert not unify(left, make_list([F(atom("b")), *range(100)]), trail)
    assert trail == []


def test_arguments_of_compound_are_unified() -> None:
    first, second, third = Var(), Var(), Var()
    key = functor("g", 4)
    trail: List[Any] = []
    assert unify(key(F(first), F(second), 1, F(third)), key(F(7), F(8), 1, F(9)), trail)
    assert (first.ref, second.ref, third.ref, len(trail)) == (7, 8, 9, 3)
    assert not unify(key(F(7), F(8), 1, F(9)), key(F(7), F(8), 1, F(10)), [])
