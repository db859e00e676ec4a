"""The index by time against a plain search through all that is in it."""

import random
from types import SimpleNamespace

import pytest

from retalis.events.matches.timeindex import LEAST, MOST, TimeIndex


def match(order, start, end):
    """Return what the index wants to know of a match."""
    return SimpleNamespace(order=order, start=start, end=end)


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
        limits += [source.choice((LEAST, low)), source.choice((MOST, high))]
    return tuple(limits)


@pytest.mark.parametrize("by_end", [False, True])
@pytest.mark.parametrize("in_order", [False, True])
@pytest.mark.parametrize("width", [6, 1000])
def test_it_finds_what_a_plain_search_finds(by_end, in_order, width):
    source = random.Random(width + by_end)

    def interval(order):
        start = order if in_order else source.randrange(width)
        return start, start + source.randrange(width // 3)

    waiting = [match(order, *interval(order)) for order in range(300)]
    index = TimeIndex(waiting, by_end)
    for order in range(300, 1500):
        if source.random() < (0.6 if order < 900 else 0.3) or len(waiting) < 2:
            waiting.append(match(order, *interval(order)))
            index.add(waiting[-1])
        else:
            index.remove(waiting.pop(source.choice((0, -1, source.randrange(len(waiting))))))
        if order % 5:
            continue
        limits = limits_at_random(source, order if in_order else width)
        newest = source.random() < 0.5
        beyond = source.choice((MOST if newest else LEAST, source.randrange(order)))
        found = [one.order for one in index.search(limits, newest, beyond)]
        assert found == plainly(waiting, limits, newest, beyond)
    assert index.size == len(waiting)


@pytest.mark.parametrize("newest", [False, True])
def test_matches_may_come_and_go_during_a_search(newest):
    waiting = [match(order, order % 7, order % 7 + 1) for order in range(200)]
    index = TimeIndex(waiting, False)
    limits = (3, 3, LEAST, MOST)
    expected = plainly(waiting, limits, newest, MOST if newest else LEAST)
    found = []
    for one in index.search(limits, newest, MOST if newest else LEAST):
        found.append(one.order)
        if len(found) == 2:
            index.add(match(200, 3, 4))
            index.remove(waiting[expected[2]])
    assert found == expected[:2] + expected[3:]


def test_it_is_idle_when_it_was_only_kept_up_to_date():
    waiting = [match(order, order, order) for order in range(10)]
    index = TimeIndex(waiting, False)
    for order in range(10, 30):
        assert not index.idle
        waiting.append(match(order, order, order))
        index.add(waiting[-1])
        assert [one.order for one in index.search((order, order, order, order), True, MOST)] == [order]
    for _ in range(15):
        index.remove(waiting.pop())
    assert index.size == 15 and index.idle
