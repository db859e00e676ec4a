"""Association lists, compared with dictionaries."""

import random
from typing import Any, Dict

import pytest
from prolog.goal_answers import answers, first, prolog

from retalis import Term, functor
from retalis.prolog.terms.types import NIL


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
    deep: Term = NIL
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
