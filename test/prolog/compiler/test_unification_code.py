"""Compiled unification, compared with general unification."""

from typing import Any, List

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retalis import Var, atom, functor
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import copy, resolve, variables
from retalis.prolog.terms.unification import compare, undo, unify

ATOMS = st.sampled_from([atom("a"), atom("[]"), atom("b")])
SHARED = [Var() for _ in range(4)]


def terms(leaves: Any) -> Any:
    return st.recursive(
        leaves,
        lambda inner: st.one_of(
            st.builds(lambda x, y: functor("f", 2)(x, y), inner, inner),
            st.builds(lambda x: functor("g", 1)(x), inner),
            st.builds(lambda x, y, z: functor("f", 3)(x, y, z), inner, inner, inner),
        ),
        max_leaves=12,
    )


PATTERNS = terms(st.one_of(ATOMS, st.sampled_from(SHARED)))
VALUES = terms(st.one_of(ATOMS, st.integers(0, 3), st.sampled_from(SHARED)))


@pytest.mark.slow
@given(PATTERNS, VALUES)
def test_compiled_pattern_unifies_as_terms(pattern: Any, value: Any) -> None:
    pattern, value = copy(pattern), copy(value)
    trail: List[Any] = []
    expected = None
    inputs = tuple(variables(functor("p", 1)(pattern)))
    both = functor("p", 2)(functor("v", len(inputs))(*inputs) if inputs else atom("none"), value)
    if unify(pattern, value, trail):
        expected = copy(resolve(both))
    undo(trail, 0)

    logic = PrologSystem(compile_after=0)
    argument = Var()
    known = functor("v", len(inputs))(*inputs) if inputs else atom("none")
    clause = functor(":-", 2)(functor("p", 2)(argument, known), functor("=", 2)(argument, pattern))
    logic.add_clause(clause)
    bindings = Var()
    result = None
    for _ in logic.solutions(functor("p", 2)(value, bindings)):
        result = copy(resolve(functor("p", 2)(bindings, value)))
    assert (result is None) == (expected is None)
    if result is not None:
        assert is_variant(result, expected)


def is_variant(left: Any, right: Any) -> bool:
    """Return whether two terms differ in the names of variables only."""
    numbered: List[Any] = []
    for term in (left, right):
        term = copy(term)
        trail: List[Any] = []
        for number, var in enumerate(variables(term)):
            unify(var, functor("$", 1)(number), trail)
        numbered.append(resolve(term))
    return compare(*numbered) == 0
