"""Round trip of terms through SWI-Prolog."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import String, Term, Var, atom, deref, functor, make_list
from retalis.prolog.swi.use_swi import SwiFile, use_swi
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import variant_key
from retalis.prolog.terms.types import NIL

TEXTS = st.text(max_size=12)
CONSTANTS = st.one_of(
    st.integers(min_value=-(1 << 200), max_value=1 << 200),
    st.sampled_from([(1 << 63) - 1, 1 << 63, -(1 << 63), -(1 << 63) - 1, 0]),
    st.floats(),
    TEXTS.map(atom),
    TEXTS.map(String),
    st.just(NIL),
    st.sampled_from([Var() for _ in range(3)]),
)
TERMS = st.recursive(
    CONSTANTS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4).map(make_list),
        st.tuples(st.lists(inner, min_size=1, max_size=3), inner).map(lambda both: make_list(*both)),
        st.tuples(TEXTS, st.lists(inner, min_size=1, max_size=3)).map(
            lambda both: (functor(both[0], len(both[1])), *both[1])
        ),
    ),
    max_leaves=12,
)
ECHO = functor("echo", 2)
PAIR = functor("-", 2)


@pytest.fixture(scope="module")
def logic(folder: Path) -> PrologSystem:
    system = PrologSystem()
    path = str(folder / "kb.pl")
    use_swi(system, SwiFile(path, atom(path), NIL), warn=print)
    return system


def echo(logic: Any, term: Any) -> Any:
    """Return a term after its conversion to SWI-Prolog and back."""
    result = Var()
    assert logic.once((ECHO, term, result))
    return deref(result)


@pytest.mark.slow
@settings(max_examples=50)
@given(term=TERMS)
def test_terms_are_converted_both_ways(logic: PrologSystem, term: Any) -> None:
    back = echo(logic, term)
    assert variant_key((PAIR, term, back)) == variant_key((PAIR, term, term))


@pytest.mark.slow
def test_large_terms_are_converted_both_ways(logic: PrologSystem) -> None:
    nested: Term = 0
    for _ in range(30_000):
        nested = (functor("f", 1), nested)
    long = make_list([(PAIR, number, String("text")) for number in range(3_000)])
    wide = (functor("wide", 1_000), *range(1_000))
    digits = 10**20_000
    for term in (nested, long, wide, digits, atom("x" * 100_000), String("\0\u0430\U0001f600")):
        assert variant_key(echo(logic, term)) == variant_key(term)


@pytest.mark.slow
def test_thousands_of_atoms_are_converted(logic: PrologSystem) -> None:
    for number in range(4_500):
        assert echo(logic, atom(f"atom {number}")).name == f"atom {number}"
