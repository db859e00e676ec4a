"""Sorting by keys, compared with pairwise comparison, and by goals."""

import random
from functools import cmp_to_key
from typing import List

import pytest
from prolog.goal_answers import answers, first, prolog
from prolog.random_terms import random_term

from retalis import Var, make_list
from retalis.prolog.builtins.list_predicates import sort_by, sort_terms, sort_unique
from retalis.prolog.terms.unification import compare


@pytest.mark.parametrize("seed", range(40))
def test_sorting_follows_standard_order(seed: int) -> None:
    choose = random.Random(seed)
    names = [Var() for _ in range(4)]
    terms = [random_term(choose, 3, names) for _ in range(choose.randint(0, 60))]
    if seed % 4 == 0:
        terms.append(float("nan"))  # has no key
    if seed % 4 == 1:
        terms.append(make_list(range(200)))  # long terms have no key either
    ordered = sort_terms(terms)
    expected = sorted(terms, key=cmp_to_key(compare))
    assert len(ordered) == len(terms)
    assert all(compare(left, right) == 0 for left, right in zip(ordered, expected))
    unique = sort_unique(terms)
    assert all(compare(left, right) < 0 for left, right in zip(unique, unique[1:]))
    assert all(any(compare(left, right) == 0 for right in unique) for left in terms)
    for reverse in (False, True):
        positions = [index for _, index in sort_by(range(len(terms)), terms, reverse)]
        assert positions == sorted(
            range(len(terms)), key=lambda index: cmp_to_key(compare)(terms[index]), reverse=reverse
        )


PREDSORT = """
by_key(O, K-_, L-_) :- compare(O, K, L).
either(O, _, _) :- member(O, [<, >]).
any_order(_, _, _).
equal(=, _, _).
other(foo, _, _).
downwards(O, A, B) :- compare(O, B, A).
"""


@pytest.mark.parametrize(
    ("goal", "lists"),
    [  # as SWI-Prolog 9.0.4 answers, except for the order in the fourth one
        ("predsort(by_key, [3-a,1-b,2-c,1-d,0-e,3-f], L)", ["[0-e,1-b,2-c,3-a]"]),
        ("predsort(equal, [c,a,b], L)", ["[c]"]),
        ("predsort(other, [c,a,b], L)", []),
        ("predsort(any_order, [a,b], L)", ["[a,b]", "[a]", "[b,a]"]),
        ("predsort(either, [c,a,b], L)", ["[c,a,b]", "[c,b,a]"]),
        ("predsort(compare, [], L)", ["[]"]),
        ("predsort(user:by_key, [2-a,1-b,0-c], L)", ["[0-c,1-b,2-a]"]),
    ],
)
def test_predsort_follows_order_of_goal(goal: str, lists: List[str]) -> None:
    assert [answer["L"] for answer in answers(prolog(PREDSORT), goal)] == lists


def test_predsort_backtracks_over_unspecified_order() -> None:
    lists = [answer["L"] for answer in answers(prolog(PREDSORT), "predsort(any_order, [a,b,c], L)")]
    expected = "[a,b,c] [a,c] [b,a,c] [b,a] [b,c,a] [a,b] [a] [b,a] [a,c,b] [a,b] [c,a,b] [c,a] [c,b,a]"
    assert lists == expected.split()


def test_predsort_sorts_downwards() -> None:
    choose = random.Random(7)
    numbers = [choose.randrange(50) for _ in range(100)]
    goal = f"predsort(downwards, {numbers}, L)"
    assert first(prolog(PREDSORT), goal) == str(sorted(set(numbers), reverse=True)).replace(" ", "")
