"""Interval index, compared with linear search."""

import random
from typing import Any, List, Tuple
from weakref import ref

import pytest

from retalis.events.matches.interval_index import MAX_VALUE, MIN_VALUE, IntervalIndex


class Interval:
    """The attributes of a match that the index reads."""

    def __init__(self, order: Any, start: Any, end: Any) -> None:
        self.order, self.start, self.end = order, start, end


def linear_search(matches: Any, limits: Any, newest: Any, beyond: Any) -> List[Any]:
    """Return the orders of the matches within limits that are older, or newer, than ``beyond``."""
    min_start, max_start, min_end, max_end = limits
    orders = [
        match.order
        for match in matches
        if min_start <= match.start <= max_start
        and min_end <= match.end <= max_end
        and (match.order < beyond if newest else match.order > beyond)
    ]
    return sorted(orders, reverse=newest)


def random_limits(generator: Any, width: Any) -> Any:
    """Return limits of a random form: open, one-sided, or of one instant."""
    limits: List[Any] = []
    for _ in range(2):
        low = generator.randrange(width)
        high = low + generator.choice((0, 1, width // 4))
        limits += [generator.choice((MIN_VALUE, low)), generator.choice((MAX_VALUE, high))]
    return tuple(limits)


@pytest.mark.parametrize("by_end", [False, True])
@pytest.mark.parametrize("in_order", [False, True])
@pytest.mark.parametrize("width", [6, 1000])
def test_index_equals_linear_search(by_end: bool, in_order: bool, width: int) -> None:
    generator = random.Random(width + by_end)

    def interval(order: Any) -> Tuple[Any, ...]:
        start = order if in_order else generator.randrange(width)
        return start, start + generator.randrange(width // 3)

    matches: List[Any] = [Interval(order, *interval(order)) for order in range(300)]
    index = IntervalIndex(matches, by_end)
    for order in range(300, 1500):
        if generator.random() < (0.6 if order < 900 else 0.3) or len(matches) < 2:
            matches.append(Interval(order, *interval(order)))
            index.add(matches[-1])
        else:
            index.remove(matches.pop(generator.choice((0, -1, generator.randrange(len(matches))))))
        if order % 5:
            continue
        limits = random_limits(generator, order if in_order else width)
        newest = generator.random() < 0.5
        beyond = generator.choice((MAX_VALUE if newest else MIN_VALUE, generator.randrange(order)))
        orders = [match.order for match in index.search(limits, newest, beyond)]
        assert orders == linear_search(matches, limits, newest, beyond)
    assert index.size == len(matches)


@pytest.mark.parametrize("newest", [False, True])
def test_index_may_change_during_search(newest: bool) -> None:
    matches: List[Any] = [Interval(order, order % 7, order % 7 + 1) for order in range(200)]
    index = IntervalIndex(matches, False)
    limits = (3, 3, MIN_VALUE, MAX_VALUE)
    expected = linear_search(matches, limits, newest, MAX_VALUE if newest else MIN_VALUE)
    orders: List[Any] = []
    for match in index.search(limits, newest, MAX_VALUE if newest else MIN_VALUE):
        orders.append(match.order)
        if len(orders) == 2:
            matches.append(Interval(200, 3, 4))
            index.add(matches.pop())
            index.remove(matches[expected[2]])
    assert orders == expected[:2] + expected[3:]


class CountingInt(int):
    """A timestamp; counts the comparisons of all timestamps."""

    comparison_count = 0

    def __le__(self, other: Any) -> bool:
        CountingInt.comparison_count += 1
        return int(self) <= other

    def __ge__(self, other: Any) -> bool:
        CountingInt.comparison_count += 1
        return int(self) >= other


@pytest.mark.parametrize("by_end", [False, True])
@pytest.mark.parametrize(
    ("limits", "newest", "beyond"),
    [
        ((700, 702, MIN_VALUE, MAX_VALUE), True, MAX_VALUE),
        ((MIN_VALUE, MAX_VALUE, 700, 702), False, MIN_VALUE),
        ((MIN_VALUE, 2, MIN_VALUE, MAX_VALUE), True, MAX_VALUE),
        ((4997, MAX_VALUE, MIN_VALUE, MAX_VALUE), True, MAX_VALUE),
        ((MIN_VALUE, MAX_VALUE, MIN_VALUE, 2), False, MIN_VALUE),
        ((MIN_VALUE, MAX_VALUE, 4997, MAX_VALUE), False, MIN_VALUE),
        ((MIN_VALUE, MAX_VALUE, MIN_VALUE, MAX_VALUE), True, 3),
        ((MIN_VALUE, MAX_VALUE, MIN_VALUE, MAX_VALUE), False, 4996),
    ],
)
def test_search_compares_few_matches(
    by_end: bool, limits: Tuple[Any, ...], newest: bool, beyond: Any
) -> None:
    matches: List[Any] = [Interval(order, CountingInt(order), CountingInt(order)) for order in range(5000)]
    index = IntervalIndex(matches, by_end)
    CountingInt.comparison_count = 0
    orders = [match.order for match in index.search(limits, newest, beyond)]
    assert CountingInt.comparison_count < 250
    assert orders == linear_search(matches, limits, newest, beyond)
    assert len(orders) == 3


@pytest.mark.parametrize("initial_count", [1, 1000, 2000])
def test_removed_matches_are_not_referenced(initial_count: int) -> None:
    matches: List[Any] = [Interval(order, order, order) for order in range(2000)]
    index = IntervalIndex(matches[:initial_count], False)
    for number in range(initial_count, 2000):
        index.add(matches[number])
    removed = [ref(match) for match in matches if match.order % 25 != 7]
    for number in range(len(matches) - 1, -1, -1):
        if number % 25 != 7:
            index.remove(matches.pop(number))
    assert not [reference for reference in removed if reference() is not None]
    assert [
        match.order for match in index.search((MIN_VALUE, MAX_VALUE, MIN_VALUE, MAX_VALUE), False, MIN_VALUE)
    ] == [*range(7, 2000, 25)]


def test_index_without_searches_is_idle() -> None:
    matches: List[Any] = [Interval(order, order, order) for order in range(10)]
    index = IntervalIndex(matches, False)
    for order in range(10, 30):
        assert not index.is_idle
        matches.append(Interval(order, order, order))
        index.add(matches[-1])
        assert [match.order for match in index.search((order, order, order, order), True, MAX_VALUE)] == [
            order
        ]
    for _ in range(15):
        index.remove(matches.pop())
    assert index.size == 15
    assert index.is_idle
