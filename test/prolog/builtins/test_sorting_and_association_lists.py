"""Sorting by keys compared with pairwise comparison, and association lists compared with dictionaries."""

import random
from functools import cmp_to_key
from typing import Any, Dict

import pytest
from prolog.support import answers, first, prolog

from retalis import String, Var, atom, functor, make_list
from retalis.prolog.builtins.list_predicates import sort_by, sort_terms, sort_unique
from retalis.prolog.terms.term_traversal import copy, rebuild, variables
from retalis.prolog.terms.types import NIL
from retalis.prolog.terms.unification import compare

CONSTANTS = [
    *(0, 1, -1, 2**53 + 1, 10**30, -(10**400), 0.0, -0.0, 1.0, -1.0, 2.0**53, 1.0e30, 0.5),
    *(float("inf"), float("-inf"), atom("a"), atom("b"), atom(""), atom("é"), NIL, String("a"), String("")),
]


def random_term(choose: Any, depth: int, variables: Any) -> Any:
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


@pytest.mark.parametrize("seed", range(40))
def test_copies_are_variants(seed: int) -> None:
    """Small ground terms without bound variables are shared; all others are copied."""
    choose = random.Random(seed)
    for _ in range(50):
        term = random_term(choose, choose.randint(0, 5), [Var() for _ in range(2)] if seed % 2 else [1, NIL])
        new: Dict[Any, Any] = {}
        assert compare(copy(term, new), rebuild(term, new.__getitem__)) == 0
        assert set(new) == set(variables(term))


@pytest.mark.parametrize("seed", range(10))
def test_insertion_keeps_association_list_balanced(seed: int) -> None:
    choose = random.Random(seed)
    logic = prolog("put([], A, A). put([K-V|T], A0, A) :- put_assoc(K, A0, V, A1), put(T, A1, A).")
    keys = ["1", "1.0", "a", '"a"', "f(1)", "f(a)", "-3", "b", "[]", "g(X)", *map(str, range(20, 60))]
    pairs = [f"{choose.choice(keys)}-{index}" for index in range(choose.randint(0, 80))]
    expected: Dict[Any, Any] = {}
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


@pytest.mark.parametrize("seed", range(10))
def test_deletion_keeps_association_list_balanced(seed: int) -> None:
    choose = random.Random(seed)
    rules = """
    del([], A, A).
    del([K|Ks], A0, A) :- del_assoc(K, A0, x(K), A1), !, is_assoc(A1), del(Ks, A1, A).
    del([K|Ks], A0, A) :- \\+ get_assoc(K, A0, _), del(Ks, A0, A).
    """
    logic = prolog(rules)
    keys = choose.sample(range(60), choose.randint(1, 50))
    removed = [choose.randrange(60) for _ in range(40)]
    remaining = sorted(set(keys) - set(removed))
    (answer,) = answers(
        logic,
        f"findall(K-x(K), member(K, {keys}), Ps), list_to_assoc(Ps, A0), del({removed}, A0, A),"
        "assoc_to_keys(A, Keys), assoc_to_values(A, Values), assoc_to_list(A, Pairs)",
    )
    assert answer["Keys"] == "[" + ",".join(map(str, remaining)) + "]"
    assert answer["Values"] == "[" + ",".join(f"x({key})" for key in remaining) + "]"
    assert answer["Pairs"] == "[" + ",".join(f"{key}-x({key})" for key in remaining) + "]"


@pytest.mark.parametrize(
    ("before", "key", "after"),
    [  # as SWI-Prolog 9.0.4 answers
        ("t(b,2,-,t(a,1,-,t,t),t(c,3,-,t,t))", "b", "t(a,1,>,t,t(c,3,-,t,t))"),
        (
            "t(b,2,>,t(a,1,-,t,t),t(d,4,-,t(c,3,-,t,t),t(e,5,-,t,t)))",
            "b",
            "t(c,3,>,t(a,1,-,t,t),t(d,4,>,t,t(e,5,-,t,t)))",
        ),
        (
            "t(b,2,>,t(a,1,-,t,t),t(d,4,-,t(c,3,-,t,t),t(e,5,-,t,t)))",
            "a",
            "t(d,4,<,t(b,2,>,t,t(c,3,-,t,t)),t(e,5,-,t,t))",
        ),
        (
            "t(d,4,<,t(b,2,-,t(a,1,-,t,t),t(c,3,-,t,t)),t(e,5,-,t,t))",
            "e",
            "t(b,2,>,t(a,1,-,t,t),t(d,4,<,t(c,3,-,t,t),t))",
        ),
        ("t(a,1,>,t,t(b,2,-,t,t))", "a", "t(b,2,-,t,t)"),
    ],
)
def test_deletion_builds_tree_of_swi_prolog(before: str, key: str, after: str) -> None:
    assert answers(prolog(), f"del_assoc({key}, {before}, _, A)") == [{"A": after}]


def test_deletion_visits_one_path_of_large_tree() -> None:
    creation = "findall(K-x, between(1, 10000, K), _Pairs), list_to_assoc(_Pairs, _A)"
    deletions = "call_with_inference_limit(forall(between(1, 100, K), del_assoc(K, _A, x, _)), 50000, Left)"
    (answer,) = answers(prolog(), f"{creation}, {deletions}")
    assert answer["Left"] == "!"


def test_balance_may_be_bound_variable() -> None:
    tree = "t(d,1,<,t(b,2,X,t,t(c,3,Y,t,t)),t(e,4,-,t,t))"
    (answer,) = answers(prolog(), f"X = (>), Y = (-), del_assoc(e, {tree}, _, A)")
    assert answer["A"] == "t(c,3,-,t(b,2,-,t,t),t(d,1,-,t,t))"
    (answer,) = answers(
        prolog(), "X = (<), del_assoc(c, t(b,1,<,t(a,1,X,t(0,1,-,t,t),t),t(c,1,-,t,t)), _, A)"
    )
    assert answer["A"] == "t(a,1,-,t(0,1,-,t,t),t(b,1,-,t,t))"


def test_deep_term_as_balance_does_not_crash() -> None:
    """Python hashes tuples by recursion in C: hashing a tuple that is deep enough crashes the process."""
    deep = NIL
    for _ in range(300_000):
        deep = (functor("f", 1), deep)
    logic = prolog()
    logic.globals["deep"] = deep
    tree = "t(d,1,<,t(b,2,>,t,t(c,3,X,t,t)),t(e,4,<,t,t))"
    assert first(logic, f"nb_getval(deep, X), copy_term({tree}, T), del_assoc(e, T, _, _)") is None


@pytest.mark.slow
def test_malformed_tree_fails_or_is_an_error() -> None:
    logic = prolog()
    assert answers(logic, "put_assoc(a, t(b,1,x,t,t), 2, A)") == []
    assert answers(logic, "put_assoc(a, t(b,1,>,t,t(c,1,<,t,t)), 2, A)") == [
        {"A": "t(b,1,-,t(a,2,-,t,t),t(c,1,<,t,t))"}
    ]
    assert answers(logic, "get_assoc(a, t(b,1,<,X,t), V)") == []
    assert answers(logic, "get_assoc(K, t(b,1,<,t,t), V)") == []
    assert answers(logic, "del_assoc(a, t(a,1,<,foo,bar), 1, A)") == []
    assert answers(logic, "del_assoc(a, t(b,1,>,t(a,1,-,t,t),foo), 1, A)") == []
    assert answers(logic, "del_assoc(a, t(b,1,>,t(a,1,-,t,t),t(c,1,<,t,t)), 1, A)") == []
    assert answers(logic, "del_assoc(b, t(b,1,x,t(a,1,-,t,t),t(c,1,-,t,t)), 1, A)") == []
    assert answers(logic, "del_assoc(c, t(b,1,<,t(a,1,x,t,t),t(c,1,-,t,t)), 1, A)") == []
    assert answers(logic, "put_assoc(a, t(b,1,<,t,t), 2, A)") == []
    assert answers(logic, "assoc_to_list(t(b,1,<,foo,t), L)") == []
    assert answers(logic, "assoc_to_list(t(b,1,<,X,t), L)") == ["instantiation_error"]
    assert answers(logic, "A = t(b,1,<,A,t), assoc_to_list(A, L)") == ["resource_error(term_size)"]
    assert answers(logic, "list_to_assoc([a-1,a-2], A)") == ["domain_error(unique_key_pairs,[a-1,a-2])"]
    assert answers(logic, "ord_list_to_assoc([b-1,a-2], A)") == ["domain_error(key_ordered_pairs,[b-1,a-2])"]


@pytest.mark.parametrize("name", ["assoc_to_list", "assoc_to_keys", "assoc_to_values"])
def test_first_malformed_node_decides_result(name: str) -> None:
    logic = prolog("")
    assert first(logic, f"Side = t, {name}(t(k,v,<,t,Side), L), length(L, 1)") is not None
    assert answers(logic, f"{name}(t(k,v,<,foo,_), L)") == []
    assert answers(logic, f"{name}(t(k,v,<,t,foo), L)") == []
    for tree in ("t(k,v,<,_,foo)", "t(k,v,<,t,_)", "_"):
        assert first(logic, f"catch({name}({tree}, _), error(E, _), true)") == "instantiation_error"


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
def test_predsort_follows_order_of_goal(goal: str, lists: Any) -> None:
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
