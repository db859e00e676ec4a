"""Copies of terms."""

import random
from typing import Any, Dict

import pytest
from prolog.random_terms import random_term

from retalis import Var
from retalis.prolog.terms.term_traversal import copy, rebuild, variables
from retalis.prolog.terms.types import NIL
from retalis.prolog.terms.unification import compare


@pytest.mark.parametrize("seed", range(40))
def test_copies_are_variants(seed: int) -> None:
    """Small ground terms without bound variables are shared; all others are copied."""
    choose = random.Random(seed)
    for _ in range(50):
        term = random_term(choose, choose.randint(0, 5), [Var() for _ in range(2)] if seed % 2 else [1, NIL])
        new: Dict[Any, Any] = {}
        assert compare(copy(term, new), rebuild(term, new.__getitem__)) == 0
        assert set(new) == set(variables(term))
