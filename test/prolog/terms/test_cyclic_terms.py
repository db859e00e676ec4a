"""Cyclic terms: comparison and unification as infinite terms, and early errors elsewhere."""

from typing import Any, List

import pytest
from prolog.goal_answers import answers, prolog

from retalis import Limits, Var, functor, make_list
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import contains_itself
from retalis.prolog.terms.types import CONS
from retalis.prolog.terms.unification import unify

REFUSED = ["resource_error(term_size)"]


@pytest.fixture(scope="module")
def logic() -> PrologSystem:
    system = prolog(compile_after=1 << 60)
    system.limits = Limits(seconds=20)
    system.output = lambda text: None
    return system


@pytest.mark.parametrize(
    ("goal", "holds"),
    [
        ("X = f(X), Y = f(Y), X = Y", True),
        ("X = f(X), Y = f(f(Y)), X == Y", True),
        ("X = [X|X], Y = [Y|Y], X = Y", True),
        ("X = f(X,a), Y = f(Y,b), X = Y", False),
        ("X = f(X,A), Y = f(Y,b), X = Y, A == b", True),
        ("X = f(X), Y = f(Y), X \\= Y", False),
        ("X = [a,b|X], Y = [a,b,a,b|Y], compare(=, X, Y)", True),
        ("X = f(X), Y = g(Y), X @< Y", True),
        ("X = f(X,Y,X), term_variables(X, L), L == [Y]", True),
        ("X = f(X), ground(X)", True),
        ("X = f(X,_), ground(X)", False),
        ("X = f(X), sort([X,a], [a,Y]), Y == X", True),
        ("unify_with_occurs_check(f(A,B,A,1), f(a(A),a(B),B,2))", False),
    ],
)
def test_cyclic_terms_compare_as_infinite_terms(logic: PrologSystem, goal: str, holds: bool) -> None:
    assert bool(answers(logic, f"\\+ \\+ ({goal})")) is holds


@pytest.mark.parametrize(
    "goal",
    [
        "X = f(X), copy_term(X, _)",
        "X = [a|X], write(X)",
        "X = f(X), assertz(p(X))",
        "X = f(X), findall(X, true, _)",
        "X = f(X), throw(X)",
        "X = [a|X], length(X, _)",
        "X = [a|X], memberchk(b, X)",
        "X = [a|X], msort(X, _)",
        "X = 1 + X, _ is X",
        "X = (true, X), call(X)",
        "X = f(X), Y = f(Y), X =@= Y",
        "X = f(X), term_hash(X, _)",
    ],
)
def test_traversal_of_cyclic_term_is_refused(logic: PrologSystem, goal: str) -> None:
    assert answers(logic, goal) == REFUSED


def test_shared_subterm_is_not_cyclic() -> None:
    part = (functor("f", 1), 1)
    term = (functor("g", 2), part, part)
    assert not contains_itself(term)
    var = Var()
    var.ref = (CONS, part, var)
    assert contains_itself((functor("g", 2), term, var))


@pytest.mark.slow
def test_long_lists_are_unified() -> None:
    trail: List[Any] = []
    last = Var()
    assert unify(make_list(range(200_000)), make_list([*range(199_999), last]), trail)
    assert last.ref == 199_999
    assert not unify(make_list(range(200_000)), make_list([*range(199_999), 0]), trail)
