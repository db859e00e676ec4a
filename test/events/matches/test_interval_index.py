"""Interval index, compared with linear search."""

import random
from weakref import ref

import pytest

from retalis.events.matches.interval_index import MAX_VALUE, MIN_VALUE, IntervalIndex


class Interval:
    """What the index wants to know of a match."""

    def __init__(self, order, start, end):
        self.order, self.start, self.end = order, start, end


def plainly(matches, limits, newest, beyond):
    """Return the orders of the matches within limits that are older, or newer, than ``beyond``."""
    least_start, most_start, least_end, most_end = limits
    found = [
        one.order
        for one in matches
        if least_start <= one.start <= most_start
        and least_end <= one.end <= most_end
        and (one.order < beyond if newest else one.order > beyond)
    ]
    return sorted(found, reverse=newest)


def limits_at_random(source, width):
    """Return limits of any kind: open, one-sided, of one instant."""
    limits = []
    for _ in range(2):
        low = source.randrange(width)
        high = low + source.choice((0, 1, width // 4))
        limits += [source.choice((MIN_VALUE, low)), source.choice((MAX_VALUE, high))]
    return tuple(limits)


@pytest.mark.parametrize("by_end", [False, True])
@pytest.mark.parametrize("in_order", [False, True])
@pytest.mark.parametrize("width", [6, 1000])
def test_it_finds_what_a_plain_search_finds(by_end, in_order, width):
    source = random.Random(width + by_end)

    def interval(order):
        start = order if in_order else source.randrange(width)
        return start, start + source.randrange(width // 3)

    waiting = [Interval(order, *interval(order)) for order in range(300)]
    index = IntervalIndex(waiting, by_end)
    for order in range(300, 1500):
        if source.random() < (0.6 if order < 900 else 0.3) or len(waiting) < 2:
            waiting.append(Interval(order, *interval(order)))
            index.add(waiting[-1])
        else:
            index.remove(waiting.pop(source.choice((0, -1, source.randrange(len(waiting))))))
        if order % 5:
            continue
        limits = limits_at_random(source, order if in_order else width)
        newest = source.random() < 0.5
        beyond = source.choice((MAX_VALUE if newest else MIN_VALUE, source.randrange(order)))
        found = [one.order for one in index.search(limits, newest, beyond)]
        assert found == plainly(waiting, limits, newest, beyond)
    assert index.size == len(waiting)


@pytest.mark.parametrize("newest", [False, True])
def test_matches_may_come_and_go_during_a_search(newest):
    waiting = [Interval(order, order % 7, order % 7 + 1) for order in range(200)]
    index = IntervalIndex(waiting, False)
    limits = (3, 3, MIN_VALUE, MAX_VALUE)
    expected = plainly(waiting, limits, newest, MAX_VALUE if newest else MIN_VALUE)
    found = []
    for one in index.search(limits, newest, MAX_VALUE if newest else MIN_VALUE):
        found.append(one.order)
        if len(found) == 2:
            index.add(Interval(200, 3, 4))
            index.remove(waiting[expected[2]])
    assert found == expected[:2] + expected[3:]


class Counted(int):
    """A time; counts how often any is compared."""

    compared = 0

    def __le__(self, other):
        Counted.compared += 1
        return int(self) <= other

    def __ge__(self, other):
        Counted.compared += 1
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
def test_a_search_looks_at_few_matches_beside_those_that_it_finds(by_end, limits, newest, beyond):
    waiting = [Interval(order, Counted(order), Counted(order)) for order in range(5000)]
    index = IntervalIndex(waiting, by_end)
    Counted.compared = 0
    found = [one.order for one in index.search(limits, newest, beyond)]
    assert Counted.compared < 250
    assert found == plainly(waiting, limits, newest, beyond) and len(found) == 3


@pytest.mark.parametrize("first", [1, 1000, 2000])
def test_what_has_been_removed_is_not_kept(first):
    waiting = [Interval(order, order, order) for order in range(2000)]
    index = IntervalIndex(waiting[:first], False)
    for number in range(first, 2000):
        index.add(waiting[number])
    gone = [ref(one) for one in waiting if one.order % 25 != 7]
    for number in range(len(waiting) - 1, -1, -1):
        if number % 25 != 7:
            index.remove(waiting.pop(number))
    assert not [one for one in gone if one() is not None]
    assert [
        one.order for one in index.search((MIN_VALUE, MAX_VALUE, MIN_VALUE, MAX_VALUE), False, MIN_VALUE)
    ] == [*range(7, 2000, 25)]


def test_it_is_idle_when_it_was_only_kept_up_to_date():
    waiting = [Interval(order, order, order) for order in range(10)]
    index = IntervalIndex(waiting, False)
    for order in range(10, 30):
        assert not index.is_idle
        waiting.append(Interval(order, order, order))
        index.add(waiting[-1])
        assert [one.order for one in index.search((order, order, order, order), True, MAX_VALUE)] == [order]
    for _ in range(15):
        index.remove(waiting.pop())
    assert index.size == 15 and index.is_idle
