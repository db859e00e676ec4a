"""Sorting by keys against comparing pair by pair, and association lists against dictionaries."""

import random
from functools import cmp_to_key

import pytest
from prolog.support import answers, first, prolog

from retalis.prolog.builtins.ordering import sort_by, sort_terms, sort_unique
from retalis.prolog.terms import NIL, String, Var, atom, compare, copy, functor, make_list, rebuild, variables

CONSTANTS = [
    *(0, 1, -1, 2**53 + 1, 10**30, -(10**400), 0.0, -0.0, 1.0, -1.0, 2.0**53, 1.0e30, 0.5),
    *(float("inf"), float("-inf"), atom("a"), atom("b"), atom(""), atom("é"), NIL, String("a"), String("")),
]


def random_term(choose, depth, variables):
    kind = choose.random()
    if kind < 0.15:
        return choose.choice(variables)
    if kind < 0.6 or not depth:
        return choose.choice(CONSTANTS)
    arguments = [random_term(choose, depth - 1, variables) for _ in range(choose.randint(1, 3))]
    if kind < 0.7:
        return make_list(arguments, choose.choice([NIL, choose.choice(variables)]))
    bound = Var()
    bound.ref = (functor(choose.choice("fgh"), len(arguments)), *arguments)
    return choose.choice([bound, bound.ref])


@pytest.mark.parametrize("seed", range(40))
def test_keys_give_the_standard_order(seed):
    choose = random.Random(seed)
    names = [Var() for _ in range(4)]
    terms = [random_term(choose, 3, names) for _ in range(choose.randint(0, 60))]
    if seed % 4 == 0:
        terms.append(float("nan"))  # has no key
    if seed % 4 == 1:
        terms.append(make_list(range(200)))  # neither have long terms
    found = sort_terms(terms)
    expected = sorted(terms, key=cmp_to_key(compare))
    assert len(found) == len(terms)
    assert all(compare(one, two) == 0 for one, two in zip(found, expected))
    single = sort_unique(terms)
    assert all(compare(one, two) < 0 for one, two in zip(single, single[1:]))
    assert all(any(compare(one, two) == 0 for two in single) for one in terms)
    for reverse in (False, True):
        places = [at for _, at in sort_by(range(len(terms)), terms, reverse)]
        assert places == sorted(
            range(len(terms)), key=lambda at: cmp_to_key(compare)(terms[at]), reverse=reverse
        )


@pytest.mark.parametrize("seed", range(40))
def test_copies_are_variants(seed):
    """Of small ground terms, which are shared where they have no bound variable, and of all others."""
    choose = random.Random(seed)
    for _ in range(50):
        term = random_term(choose, choose.randint(0, 5), [Var() for _ in range(2)] if seed % 2 else [1, NIL])
        new = {}
        assert compare(copy(term, new), rebuild(term, new.__getitem__)) == 0
        assert set(new) == set(variables(term))


@pytest.mark.parametrize("seed", range(10))
def test_association_lists_stay_balanced(seed):
    choose = random.Random(seed)
    logic = prolog("put([], A, A). put([K-V|T], A0, A) :- put_assoc(K, A0, V, A1), put(T, A1, A).")
    keys = ["1", "1.0", "a", '"a"', "f(1)", "f(a)", "-3", "b", "[]", "g(X)", *map(str, range(20, 60))]
    pairs = [f"{choose.choice(keys)}-{at}" for at in range(choose.randint(0, 80))]
    expected = {}
    for key, value in (pair.rsplit("-", 1) for pair in pairs):
        expected[key] = value
    listed = ",".join(f"{key}-{value}" for key, value in expected.items())
    goal = f"empty_assoc(E), put([{','.join(pairs)}], E, A), is_assoc(A), assoc_to_list(A, L), msort([{listed}], L)"
    assert len(answers(logic, goal)) == 1
    assert (
        len(
            answers(
                logic, f"list_to_assoc([{listed}], A), is_assoc(A), assoc_to_list(A, L), msort([{listed}], L)"
            )
        )
        == 1
    )
    for key, value in expected.items():
        assert (
            first(logic, f"list_to_assoc([{listed}], A), get_assoc({key}, A, Found), Found == {value}")
            is not None
        )
    assert first(logic, f"list_to_assoc([{listed}], A), get_assoc(none, A, _)") is None


def test_trees_that_are_none():
    logic = prolog()
    assert answers(logic, "put_assoc(a, t(b,1,x,t,t), 2, A)") == []
    assert answers(logic, "put_assoc(a, t(b,1,>,t,t(c,1,<,t,t)), 2, A)") == [
        {"A": "t(b,1,-,t(a,2,-,t,t),t(c,1,<,t,t))"}
    ]
    assert answers(logic, "get_assoc(a, t(b,1,<,X,t), V)") == []
    assert answers(logic, "get_assoc(K, t(b,1,<,t,t), V)") == []
    assert answers(logic, "list_to_assoc([a-1,a-2], A)") == ["domain_error(unique_key_pairs,[a-1,a-2])"]
    assert answers(logic, "ord_list_to_assoc([b-1,a-2], A)") == ["domain_error(key_ordered_pairs,[b-1,a-2])"]
