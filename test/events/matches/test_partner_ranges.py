"""Time ranges of the search for partners: complete, and as narrow as possible for each operator."""

from itertools import product

import pytest

from retalis.events.language.event_operators import PAIR_OPERATORS
from retalis.events.matches.interval_index import BEFORE, BETWEEN, MAX_VALUE, MIN_VALUE, interval_bounds

INTERVALS = [(start, end) for start, end in product(range(6), repeat=2) if start <= end]


def within(limits, interval):
    """Tell whether an interval is within limits."""
    least_start, most_start, least_end, most_end = limits
    return least_start <= interval[0] <= most_start and least_end <= interval[1] <= most_end


def fits(operator, span, one, other):
    """Tell whether a pair fits, and its result is not too long."""
    names = {"s1": one[0], "e1": one[1], "s2": other[0], "e2": other[1]}
    length = eval(f"({operator.end}) - ({operator.start})", {}, names)
    return eval(operator.interval_condition, {}, names) and (span is None or length <= span)


@pytest.mark.parametrize("span", [None, 0, 3])
@pytest.mark.parametrize("name", list(PAIR_OPERATORS))
def test_all_partners_that_fit_are_within_reach(name, span):
    operator = PAIR_OPERATORS[name]
    for one, other in product(INTERVALS, repeat=2):
        if fits(operator, span, one, other):
            for left, mine, partner in ((True, one, other), (False, other, one)):
                reach = interval_bounds(name, span, left)
                assert reach is None or within(reach.limits(*mine), partner)


@pytest.mark.parametrize("name", ["seq", "forall_seq", "equals", "meets", "during", "starts", "finishes"])
@pytest.mark.parametrize("left", [False, True])
def test_what_is_within_reach_of_an_operator_fits_it(name, left):
    for mine, partner in product(INTERVALS, repeat=2):
        if within(interval_bounds(name, None, left).limits(*mine), partner):
            assert fits(PAIR_OPERATORS[name], None, *((mine, partner) if left else (partner, mine)))


def test_partners_of_and_are_anywhere_unless_the_result_is_bounded():
    assert interval_bounds("and", None, True) is None
    assert interval_bounds("and", 10, True).limits(5, 7) == (-3, MAX_VALUE, MIN_VALUE, 15)


@pytest.mark.parametrize(
    "name, left, by_end",
    [
        ("seq", False, True),
        ("seq", True, False),
        ("meets", False, True),
        ("starts", False, False),
        ("finishes", True, True),
    ],
)
def test_the_instant_that_is_limited_most_is_looked_up_first(name, left, by_end):
    assert interval_bounds(name, None, left).by_end is by_end


def test_absences():
    assert [one for one in INTERVALS if within(BETWEEN.limits(1, 4), one)] == [(2, 2), (2, 3), (3, 3)]
    assert [one for one in INTERVALS if within(BEFORE.limits(2, 2), one)] == [(0, 0), (0, 1), (1, 1)]
