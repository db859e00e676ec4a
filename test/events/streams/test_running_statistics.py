"""Accumulators of windows: exact sums, deviations, minima and quantiles of added and removed numbers."""

import math
from fractions import Fraction
from itertools import count
from typing import Any, Iterator, List

import pytest
from events.streams.operator_driver import entry_count
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis.events.streams.running_statistics import ExactSum, LazyMinHeap, QuantileHeaps, standard_deviation
from retalis.events.streams.stream_operators import StreamElement

FINITE = st.one_of(st.integers(-(10**30), 10**30), st.floats(allow_nan=False, allow_infinity=False, width=32))
STEPS = st.lists(st.tuples(FINITE, st.booleans(), st.integers(0, 100)), max_size=40)
few_examples = example_settings(max_examples=30)


@few_examples
@given(STEPS, st.integers(1, 7))
def test_sum_is_exact_after_removals(steps: Any, divisor: int) -> None:
    total, inside = ExactSum(), []
    for value, is_removed, choice in steps:
        total.add_multiple(value, 1)
        inside.append(value)
        if is_removed:
            total.add_multiple(inside.pop(choice % len(inside)), -1)
        expected = Fraction(sum(map(Fraction, inside))) / divisor
        quotient = total.quotient(divisor, len(inside))
        assert quotient == (expected if isinstance(quotient, int) else float(expected))
        is_whole = all(isinstance(value, int) for value in inside) and expected.denominator == 1
        assert isinstance(quotient, int) == is_whole


def test_sum_without_its_floats_is_integer() -> None:
    total = ExactSum()
    for value, multiplier in ((3, 1), (0.1, 1), (1e300, 1), (0.1, -1), (1e300, -1)):
        total.add_multiple(value, multiplier)
    assert repr(total.quotient(1, 1)) == "3"


@few_examples
@given(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=10), st.floats(-1e12, 1e12))
def test_deviation_with_large_mean_is_exact(values: List[Any], mean: float) -> None:
    total, squares = ExactSum(), ExactSum()
    exact = [Fraction(value + mean) for value in values]
    for value in exact:
        total.add_multiple(float(value), 1)
        numerator, denominator = float(value).as_integer_ratio()
        squares.add_fraction(numerator * numerator, 2 * (denominator.bit_length() - 1), 1)
    exact_mean = sum(exact) / len(exact)
    variance = sum((number - exact_mean) ** 2 for number in exact) / (len(exact) - 1)
    assert standard_deviation(total, squares, len(values)) == pytest.approx(
        math.sqrt(variance), rel=1e-15, abs=1e-140
    )


@pytest.mark.parametrize("size", [1e-200, 5e-324, 1e200, 8e307])
def test_deviation_of_extreme_numbers(size: float) -> None:
    """The squares of these numbers underflow or overflow as floats."""
    total, squares = ExactSum(), ExactSum()
    for value in (size, -size, size, -size):
        total.add_multiple(value, 1)
        numerator, denominator = value.as_integer_ratio()
        squares.add_fraction(numerator * numerator, 2 * (denominator.bit_length() - 1), 1)
    assert standard_deviation(total, squares, 4) == pytest.approx(
        size * math.sqrt(4 / 3), rel=1e-15, abs=5e-324
    )


def changes_of_window(steps: Any) -> Iterator[Any]:
    """Yield the elements inside, and the added or the removed element, after each change."""
    orders = count()
    inside: List[Any] = []
    for value, is_removed, choice in steps:
        element = StreamElement(None, 0, 0, (), (value,))
        element.order = next(orders)
        inside.append(element)
        yield inside, element, None
        if is_removed:
            removed = inside.pop(choice % len(inside))
            removed.is_removed = True
            yield inside, None, removed


@few_examples
@given(STEPS)
def test_minimum_is_first_of_equal_elements(steps: Any) -> None:
    minimum = LazyMinHeap()
    for inside, added, removed in changes_of_window(steps):
        if added is not None:
            minimum.add(added.values[0], added)
        if removed is not None:
            minimum.remove()
        top = minimum.top()
        expected = min(inside, key=lambda element: element.values[0], default=None)
        assert (None if top is None else top[2]) is expected


@few_examples
@given(STEPS, st.sampled_from([0, 0.1, 0.25, 0.5, 0.75, 0.99, 1]))
def test_quantile_interpolates_linearly(steps: Any, fraction: Any) -> None:
    quantiles = QuantileHeaps(fraction)
    for inside, added, removed in changes_of_window(steps):
        if added is not None:
            quantiles.add(added.values[0], added)
        if removed is not None:
            quantiles.remove(removed)
        ordered = sorted(element.values[0] for element in inside)
        if not ordered:
            assert quantiles.value() is None
            continue
        position = fraction * (len(ordered) - 1)
        lower, remainder = ordered[int(position)], position - int(position)
        assert quantiles.value() == (
            lower if not remainder else lower + (ordered[int(position) + 1] - lower) * remainder
        )


def test_quantiles_equal_numpy() -> None:
    numpy = pytest.importorskip("numpy")
    values = [(7 * position * position) % 101 / 3 for position in range(50)]
    for fraction in (0, 0.1, 0.33, 0.5, 0.875, 1):
        quantiles = QuantileHeaps(fraction)
        for position, value in enumerate(values):
            element = StreamElement(None, 0, 0, (), (value,))
            element.order = position
            quantiles.add(value, element)
        assert quantiles.value() == pytest.approx(numpy.quantile(values, fraction), rel=1e-12)


@pytest.mark.parametrize("direction", ["rising", "falling"])
def test_removed_numbers_leave_heaps(direction: str) -> None:
    """The heaps of a short window over a long stream contain little more than the window."""
    minimum, quantiles = LazyMinHeap(), QuantileHeaps(0.5)
    inside: List[Any] = []
    for number in range(1500):
        element = StreamElement(None, 0, 0, (), (number if direction == "rising" else -number,))
        element.order = number
        inside.append(element)
        minimum.add(element.values[0], element)
        quantiles.add(element.values[0], element)
        if len(inside) > 10:
            removed = inside.pop(0)
            removed.is_removed = True
            minimum.remove()
            quantiles.remove(removed)
        assert max(len(heap.entries) for heap in (minimum, quantiles.below, quantiles.above)) <= 90
    assert entry_count(quantiles) == 10
