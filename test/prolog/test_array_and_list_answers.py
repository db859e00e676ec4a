"""Array terms and the lists that they stand for: goals have the same answers for both."""

import math
from typing import Any, List, Tuple

import numpy as np
import pytest
from asserting_accessors import lazy
from hypothesis import given, settings
from hypothesis import strategies as st
from prolog.goal_answers import prolog, show

from retalis import PrologError, Var, functor, make_list
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms.array_terms import CODES, array_term
from retalis.prolog.terms.types import deref

PROGRAM = """
first([X|_], X).
rest([_|T], T).
sum([], 0).
sum([X|T], S) :- sum(T, R), S is R + X.
kind([], empty) :- !.
kind([_], single) :- !.
kind([_|_], list) :- !.
kind(_, other).
apply_all(G, L) :- forall(member(X, L), call(G, X)).
add(X, Y, Z) :- Z is X + Y.
even_place([], []).
even_place([X], [X]).
even_place([X,_|T], [X|R]) :- even_place(T, R).
:- dynamic stored/1.
"""

GOALS = """
first(L, X)
rest(L, X)
sum(L, X)
kind(L, X)
even_place(L, X)
L = [X|_]
L = [_,X|_]
L = [X,Y,Z|T]
[X|T] = L, X = Y
L = M, M == L
L = []
L \\= []
L = f(X)
L == M
L = M
M = L
L \\== M
L @< M
M @< L
compare(X, L, M)
compare(X, M, L)
L =@= M
f(L, X) =@= f(M, Y)
unify_with_occurs_check(L, M)
?=(L, M)
subsumes_term(L, M)
subsumes_term([_|_], L)
term_variables(f(L, X), Y)
ground(L)
is_list(L)
compound(L)
callable(L)
atomic(L)
atom(L)
nonvar(L)
number(L)
functor(L, X, Y)
L =.. X
arg(1, L, X)
arg(N, L, X)
compound_name_arguments(L, X, Y)
copy_term(L, X)
copy_term(f(L, A, A), X)
length(L, X)
length(L, 5)
length(L, N)
N = 7, length(L, N)
proper_length(L, X)
nth0(0, L, X)
nth0(3, L, X)
nth0(100, L, X)
nth0(-1, L, X)
nth0(I, L, X)
nth1(0, L, X)
nth1(1, L, X)
nth1(5, L, X)
nth1(I, L, X)
nth1(I, L, 1)
nth0(2, L, 1.0)
nth0(I, L, X, R)
member(X, L)
member(1, L)
memberchk(X, L)
memberchk(1.0, L)
memberchk(-7, L)
append(L, [end], X)
append(X, Y, L)
append(X, [Y], L)
append([L, M], X)
last(L, X)
reverse(L, X)
msort(L, X)
sort(L, X)
sort(0, @>=, L, X)
predsort(compare, L, X)
list_to_set(L, X)
sum_list(L, X)
sumlist(L, X)
min_list(L, X)
max_list(L, X)
max_member(X, L)
min_member(X, L)
exclude([X]>>(X > 0), L, Y)
maplist(add(1), L, X)
maplist([X,Y]>>(Y = X), L, Z)
foldl(add, L, 0, X)
apply_all(number, L)
forall(member(X, L), number(X))
findall(X, member(X, L), Y)
findall(L, member(_, [1,2]), Y)
aggregate_all(max(X), member(X, L), Y)
aggregate_all(count, member(_, L), Y)
delete(L, 1, X)
subtract(L, [1, 1.0], X)
exclude([X]>>(X =:= 0), L, Y)
partition([X]>>(X > 1), L, Y, Z)
select(X, L, Y)
selectchk(1, L, Y)
permutation(X, Y), X = L
sumlist(L, X), X > 0
X is sum(L)
X is L
L > 1
L =:= M
write_canonical(L)
print(L)
write(L)
format("~w and ~q~n", [L, L])
format(atom(X), "~p", [L])
with_output_to(string(X), write(L))
term_to_atom(L, X)
term_to_atom(f(L), X)
sformat(X, "~w", L)
atomic_list_concat(L, X)
atomic_list_concat(L, '-', X)
assertz(stored(L)), stored(X), retract(stored(Y))
assertz(stored(L)), clause(stored([X|_]), true), retractall(stored(_))
assertz(stored(f(L))), (stored(f(M)) -> X = same ; X = other), retractall(stored(_))
b_setval(v, L), b_getval(v, X)
nb_setval(v, L), nb_getval(v, X)
term_hash(L, X)
catch(throw(L), [X|_], true)
catch(throw(oops(L)), oops(X), true)
numbervars(f(L, A), 0, X)
setof(X, member(X, L), Y)
bagof(X, member(X, L), Y)
list_to_assoc([k-L], A), get_assoc(k, A, X)
list_to_assoc([L-v], A), get_assoc(M, A, X)
empty_assoc(A), put_assoc(L, A, 1, B), get_assoc(M, B, X)
must_be(list, L)
must_be(list(number), L)
must_be(integer, L)
is_set(L)
pairs_keys_values(X, L, L)
sumlist([1|L], X)
X = [0|L], length(X, Y)
X = [0|L], nth0(3, X, Y)
X = [0|L], min_list(X, Y)
(L = [A,B|_], A =\\= B -> X = different ; X = alike)
transform_quaternion(L, X)
array_min(L, X)
array_max(L, X)
array_sum(L, X)
array_mean(L, X)
array_median(L, X)
array_std(L, X)
array_percentile(L, 20, X)
array_argmin(L, X)
array_argmax(L, X)
array_min(L, X, [skip(nan)])
array_max(L, X, [skip(inf), skip(nan), skipped(Y)])
array_mean(L, X, [within(0, 3), skipped(Y)])
array_argmax(L, X, [within(-1.5, 1.5)])
array_count(L, <(1.5), X)
array_count(L, =:=(1), X)
array_count(L, nan, X)
array_where(L, >=(0), X)
array_where(L, between(0, 1), X)
array_where(L, finite, X)
array_where(L, =<(M), X)
array_get(L, 2, X)
array_get(L, 200, X)
array_slice(L, 1, 4, X)
array_slice(L, 1, 40, X)
array_slice(L, 4, 2, X)
array_add(L, 1, X)
array_add(L, M, X)
array_add(L, 0.5, X)
array_subtract(M, L, X)
array_subtract(1, L, X)
array_multiply(L, L, X)
array_multiply(L, 3, X)
array_divide(L, 4, X)
array_divide(1, L, X)
array_divide(L, M, X)
""".strip().splitlines()

LOGIC = prolog(PROGRAM)

FLOATS = st.floats(width=32) | st.sampled_from([0.0, -0.0, 1.0, math.nan, math.inf, -math.inf])
ARRAYS = st.one_of(
    st.tuples(st.sampled_from(["<f4", "<f8"]), st.lists(FLOATS, min_size=5, max_size=9)),
    st.tuples(
        st.sampled_from(["|i1", "<i2", "<i8"]), st.lists(st.integers(-128, 127), min_size=5, max_size=9)
    ),
    st.tuples(st.just("<u8"), st.lists(st.integers(0, 255) | st.just(2**64 - 1), min_size=5, max_size=9)),
    st.tuples(st.just("<i8"), st.lists(st.integers(-(2**63), 2**63 - 1), min_size=5, max_size=9)),
)


def answers_of(text: Any, values: Any) -> Tuple[Any, ...]:
    """Return the solutions and the output of a goal with values for its variables L and M."""
    logic = LOGIC
    read = read_term(text, logic.operators)
    names = dict(read.names)
    for name, value in values.items():
        if name in names:
            names.pop(name).ref = value
    solutions: List[Any] = []
    output: List[Any] = []
    logic.output = output.append
    goals = logic.solutions(read.term)
    try:
        for _ in goals:
            solutions.append({name: show(value) for name, value in names.items()})
            if len(solutions) == 15:
                break
    except PrologError as error:
        solutions.append(
            show(error.term[1] if error.term.__class__ is tuple and len(error.term) == 3 else error.term)
        )
    finally:
        goals.close()
    return solutions, output


def check_same_answers(goal: Any, dtype: str, items: Any, make: Any) -> None:
    numbers = np.array(items, dtype)
    as_list = make_list(numbers.tolist())
    other = make_list([*numbers.tolist()[:3], *numbers.tolist()[3:][::-1]])
    expected = answers_of(goal, {"L": as_list, "M": other})
    assert answers_of(goal, {"L": make(numbers), "M": other}) == expected
    both = {"L": make(numbers), "M": make(np.array(items[:3] + items[3:][::-1], dtype))}
    assert answers_of(goal, both) == expected


def decoded_array_term(numbers: Any) -> Any:
    """Return an array term whose list has been built."""
    term = array_term(numbers)
    deref(term)
    return term


@settings(max_examples=4, deadline=None)
@given(st.sampled_from([array_term, decoded_array_term]), ARRAYS)
@pytest.mark.parametrize("goal", GOALS)
def test_goals_have_answers_of_lists(goal: Any, make: Any, array: Any) -> None:
    dtype, items = array
    check_same_answers(goal, dtype, items, make)


@pytest.mark.parametrize("dtype", CODES)
@pytest.mark.parametrize(
    "goal", ["L = M", "sum_list(L, X)", "min_list(L, X)", "max_list(L, X)", "length(L, X)", "nth0(3, L, X)"]
)
def test_numbers_of_any_type_have_answers_of_lists(goal: str, dtype: Any) -> None:
    check_same_answers(goal, dtype, [3, 1, 1, 7, 5, 1, 4], array_term)


@pytest.mark.parametrize(
    "items",
    [
        [0.1] * 1080,
        [-0.0] * 9,
        [0.0, -0.0] * 4,
        [-0.0, 0.0] * 4,
        [1e308, 1e308, -1e308, 1.0, 1.0],
        [math.nan] * 9,
        [1.0, math.nan, -math.inf, math.inf, 0.5],
        [0.1 * number for number in range(2000)],
        [1e16, 1.0, -1e16] * 5,
    ],
)
@pytest.mark.parametrize("goal", ["sum_list(L, X)", "min_list(L, X)", "max_list(L, X)"])
def test_sums_and_extremes_equal_those_of_list(goal: str, items: Any) -> None:
    check_same_answers(goal, "<f8", items, array_term)


@pytest.mark.parametrize(
    "goal",
    ["length(L, _)", "nth0(3, L, _)", "nth1(3, L, _)", "sum_list(L, _)", "min_list(L, _)", "max_list(L, _)"],
)
def test_direct_access_does_not_decode_array(goal: str) -> None:
    term = array_term(np.arange(20.0))
    assert len(answers_of(goal, {"L": term})[0]) == 1
    assert lazy(term).decoded_term is None


def test_bound_variable_does_not_decode_array() -> None:
    logic = prolog("smallest(L, X) :- M = L, min_list(M, X).")
    term = array_term(np.arange(1.0, 20.0))
    result = Var()
    assert [deref(result) for _ in logic.solutions((functor("smallest", 2), term, result))] == [1.0]
    assert lazy(term).decoded_term is None
