"""Compiled builders of the heads of rules, compared with copying; large terms are not compiled."""

from typing import Any, List

import pytest
from events.program_runner import term_text
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import String, Var, atom, functor, make_list
from retalis.events.dispatch import matcher_compiler
from retalis.events.dispatch.matcher_compiler import compile_builder
from retalis.foundation.codegen import MAX_TERM_ARGUMENTS
from retalis.prolog.terms.term_traversal import copy, variables

F, G = functor("f", 1), functor("g", 2)
VARS = [Var() for _ in range(4)]
TERMS = st.recursive(
    st.sampled_from([*VARS, *VARS, atom("x"), 1, 1.5, String("x")]),
    lambda inner: st.tuples(st.just(F), inner) | st.tuples(st.just(G), inner, inner),
    max_leaves=8,
)


@pytest.mark.slow
@settings(deadline=None, derandomize=True, max_examples=200)
@given(TERMS, st.lists(TERMS, max_size=4))
def test_built_term_equals_copy(term: Any, values: List[Any]) -> None:
    order = VARS[: len(values)]
    copies = tuple(copy(value) for value in values)
    build = compile_builder(term, order, "term")
    first, second = build(copies), build(copies)
    assert term_text((G, first, make_list(copies))) == term_text(
        (G, copy(term, dict(zip(order, copies))), make_list(copies))
    )
    new_variables = set(variables(first)) - set(variables(make_list(copies)))
    assert not new_variables & set(variables(second))


@pytest.mark.parametrize("number", [0, 1, 3])
def test_large_terms_are_not_compiled(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    term = make_list([*VARS, *[(F, 1)] * MAX_TERM_ARGUMENTS])
    monkeypatch.setattr(matcher_compiler, "shared_function", lambda *_: pytest.fail("compiled"))
    built = compile_builder(term, VARS[:number], "term")((1,) * number)
    assert term_text(built) == term_text(copy(term, dict(zip(VARS, (1,) * number))))
