"""Clause indexes: candidates for a key, in order of addition."""

from random import Random

import pytest
from prolog.support import NEVER, answers, prolog

from retalis.prolog.database import clause_index
from retalis.prolog.database.clause_index import Index


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("most", [3, 1_000_000])
def test_gives_what_may_match_in_its_order(seed, most, monkeypatch):
    monkeypatch.setattr(clause_index, "_MAX_MERGED_COPIES", most)
    random = Random(seed)
    found, added = Index(), []
    for number in range(60):
        key = random.choice([None, "a", "a", "b", "c"] if number > 5 else ["a", "b"])
        found.add(key, number)
        added.append((key, number))
        if found.unkeyed_clauses and random.random() < 0.5:
            asked = random.choice("abcd")
            assert found.merged_clauses(asked) == [clause for key, clause in added if key in (None, asked)]


def test_what_has_a_variable_is_not_entered_under_keys_that_nobody_asks_for():
    found = Index()
    for number in range(1000):
        found.add(number, number)
    for number in range(1000):
        found.add(None, 1000 + number)
        found.add(1000 + number, 2000 + number)
        assert len(found.merged_clauses(7)) == number + 2
    assert len(found) - len(found.unkeyed_clauses) < 5000


PROGRAM = """
:- dynamic p/2.
fill(0) :- !.
fill(N) :- assertz(p(N, N)), M is N - 1, fill(M).
go(0) :- !.
go(N) :- assertz(p(_, v(N))), p(7, _), !, M is N - 1, go(M).
"""


def test_clauses_with_a_variable_that_are_asserted_between_calls():
    logic = prolog(PROGRAM)
    assert answers(logic, "fill(50), p(7, 7), go(50)")
    assert answers(logic, "findall(X, p(7, X), [7, v(50), v(49) | Rest]), length(Rest, 48)")
    assert answers(logic, "findall(X, p(51, X), [v(50) | Rest]), length(Rest, 49)")


FACTS = "p(7, X, X). p(8, X, f(X, _)). p(_, none, none). " + " ".join(
    f"p({at}, {at}, a)." for at in range(10, 60)
)
CALLS = [
    "p(7, 1, X)",
    "p(7, 1, 2)",
    "p(8, 1, f(X, Y))",
    "p(8, 1, 2)",
    "p(7, none, X)",
    "p(10, X, b)",
    "p(X, 12, Y)",
]


@pytest.mark.parametrize("call", CALLS)
def test_facts_with_variables_among_many_are_the_same_compiled(call):
    found = [answers(prolog(FACTS, after), call) for after in (0, NEVER)]
    assert found[0] == found[1]


@pytest.mark.parametrize("call", ["p(7, 7)", "p(7, 8)", "p(7, X)", "p(X, 7)", "p(70, X)", "p(7, f(X))"])
def test_a_fact_that_is_alone_under_its_key_is_compared_whole(call):
    many = prolog(" ".join(f"p({at}, {at})." for at in range(40)))
    few = prolog("p(7, 7).")
    assert answers(many, call) == answers(few, call)
