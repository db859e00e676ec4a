"""Long steps of built-ins: they count as inferences and end with a resource error, as endless goals do."""

import random
from typing import Any, Iterator, List

import pytest
from asserting_accessors import compound
from prolog.goal_answers import prolog

from retalis import Limits, PrologError, String, Term, Var, atom, functor, make_list
from retalis.foundation.limit_checks import set_limit_check
from retalis.prolog.builtins import list_predicates
from retalis.prolog.builtins.atoms_and_strings import _split, _split_words
from retalis.prolog.builtins.list_predicates import sorted_positions
from retalis.prolog.builtins.text_arguments import convert_each
from retalis.prolog.compiler.clause_nodes import CALL
from retalis.prolog.machine.errors import type_error
from retalis.prolog.machine.resource_limits import NO_LIMITS
from retalis.prolog.syntax.literals import integer, integer_text
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import writeq
from retalis.prolog.system.prolog_system import PrologSystem
from retalis.prolog.terms.term_traversal import copy, is_ground
from retalis.prolog.terms.unification import compare, unify

PROGRAM = """
wide(T, N) :- length(L, 60), foldl([_,A,f(A,A)]>>true, L, N, T).
sum(T) :- length(L, 60), foldl([_,A,A + A]>>true, L, 1, T).
pair(A, B) :- wide(A, _), wide(B, _).
same(A, B) :- wide(A, a), wide(B, a).
cells(L) :- numlist(1, 90000, L).
again(G) :- repeat, call(G), fail.
concat(A) :- atom_concat(A, A, B), concat(B).
strings(A) :- string_concat(A, A, B), strings(B).
texts(A) :- text_concat(A, A, B), texts(B).
lists(A) :- atomic_list_concat([A, A], B), lists(B).
formats(A) :- format(atom(B), "~w~w", [A, A]), formats(B).
outputs(A) :- with_output_to(string(B), (write(A), write(A))), outputs(B).
square(N) :- M is N * N, square(M).
power(N) :- M is N ** 2, power(M).
shift(N) :- M is N << 1000, shift(M).
copies(T) :- copy_term(T, U), copies(f(T, U)).
kept(T) :- nb_setval(k, T), nb_getval(k, U), kept(f(T, U)).
store(N) :- assertz(item(N)), M is N + 1, store(M).
"""

MAX_INFERENCES = 200_000


@pytest.fixture(scope="module")
def shared_logic() -> PrologSystem:
    return prolog(PROGRAM)


@pytest.fixture
def logic(shared_logic: PrologSystem) -> Iterator[Any]:
    """A Prolog system with the program, whose limits and output each test may set."""
    output = shared_logic.output
    yield shared_logic
    shared_logic.limits, shared_logic.output = NO_LIMITS, output


def error_of(logic: Any, goal: str, **limits: Any) -> str:
    logic.limits = Limits(**limits)
    with pytest.raises(PrologError) as error:
        logic.once(read_term(goal, logic.operators).term)
    return writeq(compound(error.value.term)[1])


@pytest.mark.parametrize("goal", ["X = [a|X], length(X, _)", "X = [a|X], memberchk(b, X)"])
def test_cyclic_list_is_refused(logic: Any, goal: str) -> None:
    assert error_of(logic, goal, inferences=MAX_INFERENCES) == "resource_error(term_size)"


def test_ground_visits_cyclic_term_once(logic: Any) -> None:
    assert logic.once(read_term("X = f(X), ground(X)", logic.operators).term)


@pytest.mark.slow
@pytest.mark.parametrize(
    "goal",
    [
        "wide(T, a), ground(T)",
        "wide(T, _), copy_term(T, _)",
        "wide(T, _), term_variables(T, _)",
        "wide(T, _), numbervars(T, 0, _)",
        "wide(T, _), assertz(t(T))",
        "wide(T, _), findall(T, true, _)",
        "wide(T, a), term_hash(T, _)",
        "wide(T, _), write(T)",
        "wide(T, _), term_to_atom(T, _)",
        "wide(T, _), T =@= T",
        "wide(T, _), catch(throw(T), never, true)",
        "wide(T, _), nb_setval(k, T)",
        "pair(A, B), A = B",
        "same(A, B), A == B",
        "same(A, B), compare(_, A, B)",
        "pair(A, B), unify_with_occurs_check(A, B)",
        "sum(T), _ is T",
        "X = [a|X], nth1(_, X, b)",
        "numlist(1, 4000000, _)",
        "length(_, 4000000)",
        "functor(_, f, 900000)",
        "length(L, N), N < 0",
        "cells(L), again(length(L, _))",
        "cells(L), again(memberchk(a, L))",
        "cells(L), again(msort(L, _))",
        "cells(L), again(sort(0, @>=, [a|L], _))",
        "cells(L), again(last(L, _))",
        "cells(L), again(nth1(90000, L, _))",
        "cells(L), again(sum_list(L, _))",
        "cells(L), again(copy_term(L, _))",
        "cells(L), subtract(L, L, _)",
        "cells(L), again(atomic_list_concat(L, _))",
        "X = [a|X], ord_union(X, X, _)",
        "cells(L), again(ord_union(L, L, _))",
        "cells(L), again(sort(0, @>, L, _))",
        "cells(L), again(list_to_set(L, _))",
        "cells(L), again(random_permutation(L, _))",
        "cells(L), again(must_be(list(integer), L))",
        "nth0(I, _, _), I < 0",
        "nth1(4000000, _, _)",
        "wide(T, _), write_canonical(T)",
        'again(format(atom(_), "~`-t~30|", []))',
        "same(A, B), A \\= B",
        "pair(A, B), A \\= B",
        "cells(L), atomic_list_concat(L, A), sub_atom(A, N, N, M, _), M < 0",
        "cells(L), atomic_list_concat(L, ' ', A), term_to_atom(_, A)",
        "shift(1)",
        "copies(a)",
        "kept(a)",
    ],
)
def test_long_step_exceeds_limit(logic: Any, goal: str) -> None:
    assert error_of(logic, goal, inferences=MAX_INFERENCES) in (
        "resource_error(inferences)",
        "resource_error(memory)",
    )
    logic.limits = Limits()
    assert logic.once(read_term("true", logic.operators).term)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "resource"),
    [
        ("concat(a)", "memory"),
        ("strings(a)", "memory"),
        ("texts(a)", "memory"),
        ("lists(a)", "memory"),
        ("formats(a)", "memory"),
        ("outputs(a)", "memory"),
        ("square(3)", "memory"),
        ("power(3)", "memory"),
        ("X is 1 << 60000000", "memory"),
        ("X is 1 << 1048576", "memory"),
        ("X is 3 ** 60000000", "memory"),
        ("functor(_, f, 90000000)", "memory"),
        ("X is gcd((1 << 1000000) - 1, (1 << 999999) - 1)", "integer_size"),
        ("X is lcm((1 << 1000000) - 1, (1 << 999999) - 1)", "integer_size"),
        ("X is ((1 << 1000000) - 1) // ((1 << 500000) - 1)", "integer_size"),
        ("X is ((1 << 1000000) - 1) mod ((1 << 500000) - 1)", "integer_size"),
        ("X is ((1 << 1000000) - 1) / ((1 << 500000) - 1)", "integer_size"),
        ("X is powm(3, (1 << 10000) - 1, (1 << 10000) - 1)", "integer_size"),
        ("X is powm(3, (1 << 1000000) - 1, 5)", "integer_size"),
        ("length(L, 5000), maplist(=(0'9), L), atom_codes(A, [0'~|L]), format(A)", "memory"),
        ("X is (1 << 1000000) - 1, format(atom(_), '~8r', [X])", "integer_size"),
    ],
)
def test_huge_result_is_refused_without_limits(logic: Any, goal: str, resource: str) -> None:
    assert error_of(logic, goal) == f"resource_error({resource})"


@pytest.mark.parametrize(
    ("goal", "value"),
    [
        ("X is (7 ** 70000) mod 1000", 7**70000 % 1000),
        ("X is gcd(2 ** 5000 * 3, 2 ** 4000 * 5)", 2**4000),
        ("X is lcm(4, 6) + lcm(-4, 6)", 24),
        ("X is (3 ** 40000) // (3 ** 39999)", 3),
        ("X is -(7 // 2) + (-7) rem 2 + (-7) mod 2 + (-7) div 2", -3 - 1 + 1 - 4),
    ],
)
def test_large_integers_are_exact(logic: Any, goal: str, value: int) -> None:
    logic.limits = Limits()
    read = read_term(goal, logic.operators)
    assert logic.once(read.term)
    assert read.names["X"].ref == value


@pytest.mark.slow
def test_limit_in_long_step_is_caught(logic: Any) -> None:
    logic.limits = Limits(inferences=MAX_INFERENCES)
    goal = "wide(T, _), catch(copy_term(T, _), error(resource_error(R), _), true), R == inferences"
    assert logic.once(read_term(goal, logic.operators).term)


@pytest.mark.slow
def test_limit_error_names_goal(logic: Any) -> None:
    logic.limits = Limits(inferences=MAX_INFERENCES)
    with pytest.raises(PrologError) as error:
        logic.once(read_term("wide(T, _), copy_term(T, _)", logic.operators).term)
    assert "copy_term/2" in error.value.message
    with pytest.raises(PrologError) as error:
        logic.once(read_term("repeat, atom(b), fail", logic.operators).term)
    assert any(name in error.value.message for name in ("repeat/0", "atom/1", "fail/0"))


def test_work_outside_goal_is_not_limited(logic: Any) -> None:
    logic.limits = Limits(inferences=1000)
    assert not logic.once(read_term("fail", logic.operators).term)
    assert len(writeq(make_list([atom("a")] * 5000))) == 10001


def test_limit_stops_loop_between_iterations(logic: Any) -> None:
    assert error_of(logic, "store(0)", inferences=10_000) == "resource_error(inferences)"
    assert 10_000 <= len(logic.database.predicates[functor("item", 1)]) < 15_000


@pytest.mark.parametrize(
    "work",
    [
        lambda converted: convert_each(converted.append, "a" * 100_000),
        lambda converted: list(map(converted.append, _split("a," * 50_000, ",", ""))),
        lambda converted: integer_text(7**200_000),
        lambda converted: integer("7" * 200_000),
    ],
)
def test_conversion_is_checked_while_it_runs(work: Any) -> None:
    """The number of items converted between two checks is bounded."""
    converted: List[Any] = []
    largest = [0]
    checks = [0]

    def check(pieces: Any, size: Any) -> None:
        largest[0] = max(largest[0], len(converted))
        checks[0] += 1
        converted.clear()

    before = set_limit_check(check)
    try:
        work(converted)
    finally:
        set_limit_check(before)
    assert largest[0] <= 2048
    assert checks[0] >= 5


@pytest.mark.parametrize(
    "walk",
    [copy, is_ground, lambda term: unify(term, copy(term), []), lambda term: compare(term, copy(term))],
)
def test_arguments_of_wide_term_are_counted(walk: Any) -> None:
    counts: List[Any] = []
    before = set_limit_check(lambda work, size: counts.append(work))
    try:
        walk((functor("wide", 5000), *[Var() for _ in range(5000)]))
    finally:
        set_limit_check(before)
    assert 5000 <= sum(counts) < 11_000


@pytest.mark.parametrize(
    "goal",
    [
        "cells(L), msort(L, _)",
        "cells(L), sort(0, @>=, L, _)",
        "atom_codes(A, C)",
        "atom_chars(A, C)",
        "atom_concat(A, A, _)",
        "atomic_list_concat([A, A, A], _)",
        "atomic_list_concat(L, a, A)",
        "upcase_atom(A, _)",
        "writeq(A)",
        "writeq(f(A, A))",
        'format(atom(_), "~*c", [90000, 0\'a])',
        'format(atom(_), "~t~90000|", [])',
        "tab(90000)",
        "functor(_, f, 90000)",
        "numlist(1, 90000, L), T =.. [f|L]",
    ],
)
def test_large_allocation_is_checked_first(logic: Any, goal: str) -> None:
    """A limit of memory can refuse an allocation before it is made."""
    logic.limits = NO_LIMITS
    sizes: List[Any] = []
    read = read_term(goal, logic.operators)
    if "A" in read.names:
        read.names["A"].ref = atom("a" * 300_000)
    work = read.term

    before = set_limit_check(lambda pieces, size: sizes.append(size))
    try:
        logic.output = lambda text: None
        assert logic.machine.run((logic.control.code, (CALL, work), 0, logic.machine.done))
    finally:
        set_limit_check(before)
    assert max(sizes) >= 90_000


@pytest.mark.parametrize("make", [int, str])
@pytest.mark.parametrize("distinct", [1, 7, 10**9])
def test_long_list_is_sorted_in_chunks(monkeypatch: pytest.MonkeyPatch, make: Any, distinct: int) -> None:
    monkeypatch.setattr(list_predicates, "_CHUNK_ITEMS", 64)
    chance = random.Random(distinct)
    for size in (0, 1, 63, 64, 65, 640, 3000):
        keys = [make(chance.randrange(distinct)) for _ in range(size)]
        for reverse in (False, True):
            assert sorted_positions(keys, reverse) == sorted(
                range(size), key=keys.__getitem__, reverse=reverse
            )


def test_sorting_is_checked_while_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(list_predicates, "_CHUNK_ITEMS", 64)
    counts: List[Any] = []
    before = set_limit_check(lambda work, size: counts.append(work))
    try:
        sorted_positions(random.Random(1).sample(range(6400), 6400))
    finally:
        set_limit_check(before)
    assert len(counts) > 200


def test_error_text_of_large_term_is_short(logic: Any) -> None:
    deep: Term = atom("x")
    for _ in range(100_000):
        deep = (functor("f", 1), deep)
    terms = [deep, make_list(range(100_000)), (functor("f", 100_000), *range(100_000)), 3**600_000]
    terms += [atom("a" * 100_000), String("é" * 100_000)]
    counts: List[Any] = []
    before = set_limit_check(lambda work, size: counts.append(work))
    try:
        for term in terms:
            text = type_error("list", term).message
            assert text.startswith("Type error: `list' expected, found `")
            assert len(text) <= 4003
    finally:
        set_limit_check(before)
    assert not counts
    assert type_error("list", 3**600_000).message.endswith("found `an integer of 950978 bits'")


def test_words_are_split_across_chunks() -> None:
    for size in range(1015, 1030):
        text = " " + "a" * size + " b  " + "c" * size + "\t\n"
        assert _split_words(text) == text.split()


def test_empty_text_has_no_words() -> None:
    assert _split_words("") == []
