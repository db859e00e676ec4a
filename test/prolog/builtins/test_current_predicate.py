"""Enumeration of predicates by ``current_predicate``."""

import pytest
from prolog.goal_answers import prolog

from retalis.prolog.syntax.term_reader import read_term


@pytest.mark.parametrize(
    ("goal", "is_current"),
    [("succ/2", True), ("(=)/2", True), ("no_such/2", False), ("p/1", True), ("p/2", False)],
)
def test_current_predicate_includes_builtins_by_flag(goal: str, is_current: bool) -> None:
    logic = prolog("p(1). :- dynamic(p/2).")
    assert logic.once(read_term(f"current_predicate({goal})", logic.operators).term) == is_current
    assert logic.once(read_term("current_predicate(succ/N)", logic.operators).term) is False
    assert logic.once(read_term("set_prolog_flag(iso, true)", logic.operators).term)
    assert logic.once(read_term(f"current_predicate({goal})", logic.operators).term) == (goal == "p/1")
