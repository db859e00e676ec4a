"""Predicates on arrays against numpy, for array terms and for lists."""

import math
from typing import Any, List

import numpy as np
import pytest
from asserting_accessors import lazy
from hypothesis import given
from hypothesis import strategies as st
from prolog.goal_answers import prolog

from retalis import PrologError, Var, atom, deref, functor, make_list
from retalis.prolog.terms.array_terms import array_term

LOGIC = prolog()

NUMBERS = st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=40)


def value_of(name: str, *arguments: Any, following: Any = ()) -> Any:
    """Return the value of the argument between two groups of arguments, None for failure."""
    result = Var()
    goal = functor(name, len(arguments) + 1 + len(following))(*arguments, result, *following)
    for _ in LOGIC.solutions(goal):
        return deref(result)
    return None


def both(numbers: Any, dtype: str = "f4") -> List[Any]:
    """Return an array term and the list that it stands for."""
    array = np.array(numbers, dtype)
    return [array_term(array), make_list(array.tolist())]


@given(NUMBERS)
def test_extremes_and_mean_equal_those_of_numpy(numbers: Any) -> None:
    array = np.array(numbers, "f4")
    for term in both(numbers):
        assert value_of("array_min", term) == array.min()
        assert value_of("array_max", term) == array.max()
        assert value_of("array_mean", term) == pytest.approx(array.mean(dtype="f8"))


@given(NUMBERS, st.integers(0, 100) | st.floats(0, 100))
def test_percentile_equals_that_of_numpy(numbers: Any, percent: Any) -> None:
    expected = np.percentile(np.array(numbers, "f8"), percent)
    for term in both(numbers):
        assert value_of("array_percentile", term, percent) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("dtype", ["f4", "f8", "i4", "u1"])
def test_minimum_has_type_of_list_items(dtype: str) -> None:
    for term in both(range(10), dtype):
        minimum = value_of("array_min", term)
        assert minimum.__class__ is (float if dtype[0] == "f" else int)


@pytest.mark.parametrize("name", ["array_min", "array_max", "array_mean"])
def test_empty_array_has_no_extremes_and_mean(name: str) -> None:
    assert value_of(name, make_list([])) is None
    assert value_of(name, atom('""')) is None


def test_empty_array_has_no_percentile() -> None:
    assert value_of("array_percentile", make_list([]), 50) is None


@pytest.mark.parametrize("numbers", [[math.nan] * 9, [1.0, math.nan, 2.0, 3.0, math.inf]])
def test_nan_is_an_evaluation_error(numbers: Any) -> None:
    for term in both(numbers):
        for name, more in [
            ("array_min", ()),
            ("array_max", ()),
            ("array_mean", ()),
            ("array_percentile", (5,)),
        ]:
            with pytest.raises(PrologError, match="undefined"):
                value_of(name, term, *more)


def test_infinity_is_ordered_but_has_no_mean() -> None:
    for term in both([1.0, math.inf, math.inf, 2.0, 3.0]):
        assert value_of("array_max", term) == math.inf
        assert value_of("array_percentile", term, 90) == math.inf
        assert value_of("array_percentile", term, 50) == 3
        with pytest.raises(PrologError, match="float_overflow"):
            value_of("array_mean", term)


@pytest.mark.parametrize(
    ("numbers", "percent", "expected"),
    [
        ([5.0, -math.inf], 50, -math.inf),
        ([5.0, math.inf], 50, math.inf),
        ([-1.5e308, 1.5e308], 50, 0.0),
        ([-1.5e308, 1.5e308], 75, 7.5e307),
    ],
)
def test_percentile_of_infinite_difference(numbers: Any, percent: Any, expected: float) -> None:
    for term in both(numbers, "f8"):
        assert value_of("array_percentile", term, percent) == expected


def test_percentile_between_opposite_infinities_is_undefined() -> None:
    for term in both([math.inf, -math.inf]):
        with pytest.raises(PrologError, match="undefined"):
            value_of("array_median", term)


LARGE = 2**53
"""Above this, doubles represent only even integers."""


@pytest.mark.parametrize(
    ("left", "dtype", "right", "right_dtype"),
    [
        (LARGE + 1, "i8", float(LARGE), ""),
        (LARGE + 1, "u8", float(LARGE), "f8"),
        (float(LARGE), "f8", LARGE + 1, ""),
        (float(LARGE), "f8", -(10**400), ""),
        (float(LARGE), "f8", LARGE + 1, "i8"),
        (LARGE, "i8", LARGE + 1, "u8"),
        (LARGE + 1, "u8", LARGE, "i8"),
    ],
)
@pytest.mark.parametrize("name", ["<", "=<", ">", ">=", "=:=", "=\\="])
def test_integers_are_compared_without_rounding(
    left: Any, dtype: str, right: Any, right_dtype: str, name: str
) -> None:
    is_true = any(True for _ in LOGIC.solutions(functor(name, 2)(left, right)))
    # So many elements are an array term, not a list.
    for term in both([left] * 20, dtype):
        for operand in both([right] * 20, right_dtype) if right_dtype else [right]:
            assert value_of("array_count", term, functor(name, 1)(operand)) == 20 * is_true


@pytest.mark.parametrize("percent", [-1, 100.5, math.nan])
def test_percentage_out_of_range_is_refused(percent: Any) -> None:
    with pytest.raises(PrologError, match="percentage"):
        value_of("array_percentile", make_list([1]), percent)


def test_array_terms_are_not_decoded() -> None:
    term = array_term(np.arange(20.0))
    assert value_of("array_min", term) == 0
    assert value_of("array_percentile", term, 5) == pytest.approx(0.95)
    assert lazy(term).decoded_term is None
