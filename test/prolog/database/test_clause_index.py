"""Clause indexes: candidates for a key, in order of addition."""

from random import Random
from typing import Any, Dict, List, Optional, Tuple

import pytest
from prolog.goal_answers import NEVER, answers, prolog

from retalis.prolog.database import clause_index
from retalis.prolog.database.clause_index import Index


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("max_copies", [3, 1_000_000])
def test_candidates_keep_order_of_addition(
    seed: int, max_copies: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clause_index, "_MAX_MERGED_COPIES", max_copies)
    random = Random(seed)
    # The index does not read the clauses, so numbers stand in.
    index: Any = Index()
    added: List[Tuple[Optional[str], int]] = []
    comparisons = 0
    for number in range(60):
        key = random.choice([None, "a", "a", "b", "c"] if number > 5 else ["a", "b"])
        index.add(key, number)
        added.append((key, number))
        if index.unkeyed_clauses and random.random() < 0.5:
            sought = random.choice("abcd")
            assert index.merged_clauses(sought) == [clause for key, clause in added if key in (None, sought)]
            comparisons += 1
    assert comparisons > 10


def test_unkeyed_clauses_are_merged_on_demand() -> None:
    index: Any = Index()
    for number in range(1000):
        index.add(number, number)
    for number in range(1000):
        index.add(None, 1000 + number)
        index.add(1000 + number, 2000 + number)
        assert len(index.merged_clauses(7)) == number + 2
    assert len(index) - len(index.unkeyed_clauses) < 5000


PROGRAM = """
:- dynamic p/2.
fill(0) :- !.
fill(N) :- assertz(p(N, N)), M is N - 1, fill(M).
go(0) :- !.
go(N) :- assertz(p(_, v(N))), p(7, _), !, M is N - 1, go(M).
"""


def test_unkeyed_clauses_asserted_between_calls_match() -> None:
    logic = prolog(PROGRAM)
    assert answers(logic, "fill(50), p(7, 7), go(50)")
    assert answers(logic, "findall(X, p(7, X), [7, v(50), v(49) | Rest]), length(Rest, 48)")
    assert answers(logic, "findall(X, p(51, X), [v(50) | Rest]), length(Rest, 49)")


FACTS = "p(7, X, X). p(8, X, f(X, _)). p(_, none, none). " + " ".join(
    f"p({number}, {number}, a)." for number in range(10, 60)
)


@pytest.mark.parametrize("compile_after", [0, NEVER], ids=["compiled", "interpreted"])
@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("p(7, 1, X)", [{"X": "1"}]),
        ("p(7, 1, 2)", []),
        ("p(8, 1, f(X, Y))", [{"X": "1", "Y": "A"}]),
        ("p(8, 1, 2)", []),
        ("p(7, none, X)", [{"X": "none"}, {"X": "none"}]),
        ("p(10, X, b)", []),
        ("p(X, 12, Y)", [{"X": "7", "Y": "12"}, {"X": "8", "Y": "f(12,A)"}, {"X": "12", "Y": "a"}]),
    ],
)
def test_facts_with_variables_match_in_both_modes(
    call: str, expected: List[Dict[str, str]], compile_after: Any
) -> None:
    assert answers(prolog(FACTS, compile_after), call) == expected


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("p(7, 7)", [{}]),
        ("p(7, 8)", []),
        ("p(7, X)", [{"X": "7"}]),
        ("p(X, 7)", [{"X": "7"}]),
        ("p(70, X)", []),
        ("p(7, f(X))", []),
    ],
)
def test_only_candidate_is_unified_completely(call: str, expected: Any) -> None:
    logic = prolog(" ".join(f"p({number}, {number})." for number in range(40)))
    assert answers(logic, call) == expected
