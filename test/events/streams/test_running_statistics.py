"""Accumulators of windows: exact sums, deviations, minima and quantiles of added and removed numbers."""

import math
from fractions import Fraction
from itertools import count

import pytest
from events.streams.stream_feeder import entries
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis.events.streams.running_statistics import ExactSum, LazyMinHeap, QuantileHeaps, standard_deviation
from retalis.events.streams.stream_operators import StreamElement

FINITE = st.one_of(st.integers(-(10**30), 10**30), st.floats(allow_nan=False, allow_infinity=False, width=32))
STEPS = st.lists(st.tuples(FINITE, st.booleans(), st.integers(0, 100)), max_size=40)
some = example_settings(max_examples=30)


@some
@given(STEPS, st.integers(1, 7))
def test_a_sum_is_exact_however_many_have_gone(steps, number):
    total, inside = ExactSum(), []
    for value, goes, which in steps:
        total.add_multiple(value, 1)
        inside.append(value)
        if goes:
            total.add_multiple(inside.pop(which % len(inside)), -1)
        expected = Fraction(sum(map(Fraction, inside))) / number
        found = total.quotient(number, len(inside))
        assert found == (expected if isinstance(found, int) else float(expected))
        whole = all(isinstance(one, int) for one in inside) and expected.denominator == 1
        assert isinstance(found, int) == whole


def test_floats_that_have_gone_leave_an_integer():
    total = ExactSum()
    for value, by in ((3, 1), (0.1, 1), (1e300, 1), (0.1, -1), (1e300, -1)):
        total.add_multiple(value, by)
    assert repr(total.quotient(1, 1)) == "3"


@some
@given(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=10), st.floats(-1e12, 1e12))
def test_the_deviation_does_not_suffer_from_a_large_mean(values, mean):
    total, squares = ExactSum(), ExactSum()
    exact = [Fraction(value + mean) for value in values]
    for value in exact:
        total.add_multiple(float(value), 1)
        over, under = float(value).as_integer_ratio()
        squares.add_fraction(over * over, 2 * (under.bit_length() - 1), 1)
    middle = sum(exact) / len(exact)
    spread = sum((one - middle) ** 2 for one in exact) / (len(exact) - 1)
    assert standard_deviation(total, squares, len(values)) == pytest.approx(
        math.sqrt(spread), rel=1e-15, abs=1e-140
    )


@pytest.mark.parametrize("size", [1e-200, 5e-324, 1e200, 8e307])
def test_the_deviation_of_very_small_and_very_large_numbers(size):
    """The squares of these are beyond what a float can be."""
    total, squares = ExactSum(), ExactSum()
    for value in (size, -size, size, -size):
        total.add_multiple(value, 1)
        over, under = value.as_integer_ratio()
        squares.add_fraction(over * over, 2 * (under.bit_length() - 1), 1)
    assert standard_deviation(total, squares, 4) == pytest.approx(
        size * math.sqrt(4 / 3), rel=1e-15, abs=5e-324
    )


def entering(steps):
    """Yield for each step the items that are in, and the one that goes, as the steps say."""
    orders = count()
    inside = []
    for value, goes, which in steps:
        item = StreamElement(None, 0, 0, (), (value,))
        item.order = next(orders)
        inside.append(item)
        yield inside, item, None
        if goes:
            removed = inside.pop(which % len(inside))
            removed.is_removed = True
            yield inside, None, removed


@some
@given(STEPS)
def test_the_lowest_is_the_first_of_equal_ones(steps):
    lowest = LazyMinHeap()
    for inside, came, removed in entering(steps):
        if came is not None:
            lowest.add(came.values[0], came)
        if removed is not None:
            lowest.remove()
        top = lowest.top()
        wanted = min(inside, key=lambda item: item.values[0], default=None)
        assert (None if top is None else top[2]) is wanted


@some
@given(STEPS, st.sampled_from([0, 0.1, 0.25, 0.5, 0.75, 0.99, 1]))
def test_a_quantile_is_linear_between_two(steps, part):
    ranked = QuantileHeaps(part)
    for inside, came, removed in entering(steps):
        if came is not None:
            ranked.add(came.values[0], came)
        if removed is not None:
            ranked.remove(removed)
        ordered = sorted(item.values[0] for item in inside)
        if not ordered:
            assert ranked.value() is None
            continue
        place = part * (len(ordered) - 1)
        low, rest = ordered[int(place)], place - int(place)
        assert ranked.value() == (low if not rest else low + (ordered[int(place) + 1] - low) * rest)


def test_quantiles_are_those_of_numpy():
    numpy = pytest.importorskip("numpy")
    values = [(7 * at * at) % 101 / 3 for at in range(50)]
    for part in (0, 0.1, 0.33, 0.5, 0.875, 1):
        ranked = QuantileHeaps(part)
        for at, value in enumerate(values):
            item = StreamElement(None, 0, 0, (), (value,))
            item.order = at
            ranked.add(value, item)
        assert ranked.value() == pytest.approx(numpy.quantile(values, part), rel=1e-12)


@pytest.mark.parametrize("kind", ["rising", "falling"])
def test_what_has_gone_is_not_held(kind):
    """Of a long stream through a short window the heaps hold little more than the window."""
    lowest, ranked = LazyMinHeap(), QuantileHeaps(0.5)
    inside = []
    for at in range(1500):
        item = StreamElement(None, 0, 0, (), (at if kind == "rising" else -at,))
        item.order = at
        inside.append(item)
        lowest.add(item.values[0], item)
        ranked.add(item.values[0], item)
        if len(inside) > 10:
            removed = inside.pop(0)
            removed.is_removed = True
            lowest.remove()
            ranked.remove(removed)
        assert max(len(one.entries) for one in (lowest, ranked.below, ranked.above)) <= 90
    assert entries(ranked) == 10
