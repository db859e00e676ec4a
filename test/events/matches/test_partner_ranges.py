"""Time ranges of the search for partners: complete, and as narrow as possible for each operator."""

from itertools import product
from typing import Any, Optional

import pytest
from asserting_accessors import required

from retalis.events.language.event_operators import PAIR_OPERATORS
from retalis.events.matches.interval_index import BEFORE, BETWEEN, MAX_VALUE, MIN_VALUE, interval_bounds

INTERVALS = [(start, end) for start, end in product(range(6), repeat=2) if start <= end]


def within(limits: Any, interval: Any) -> Any:
    """Return whether an interval is within limits."""
    min_start, max_start, min_end, max_end = limits
    return min_start <= interval[0] <= max_start and min_end <= interval[1] <= max_end


def fits(operator: Any, span: Any, first: Any, second: Any) -> Any:
    """Return whether a pair satisfies an operator, and its result is not longer than the span."""
    names = {"s1": first[0], "e1": first[1], "s2": second[0], "e2": second[1]}
    length = eval(f"({operator.end}) - ({operator.start})", {}, names)
    return eval(operator.interval_condition, {}, names) and (span is None or length <= span)


@pytest.mark.parametrize("span", [None, 0, 3])
@pytest.mark.parametrize("name", list(PAIR_OPERATORS))
def test_matching_partners_are_within_bounds(name: Any, span: Optional[int]) -> None:
    operator = PAIR_OPERATORS[name]
    for first, second in product(INTERVALS, repeat=2):
        if fits(operator, span, first, second):
            for is_left, interval, partner in ((True, first, second), (False, second, first)):
                bounds = interval_bounds(name, span, is_left)
                assert bounds is None or within(bounds.limits(*interval), partner)


@pytest.mark.parametrize("name", ["seq", "forall_seq", "equals", "meets", "during", "starts", "finishes"])
@pytest.mark.parametrize("left", [False, True])
def test_partners_within_bounds_match(name: str, left: bool) -> None:
    for interval, partner in product(INTERVALS, repeat=2):
        if within(required(interval_bounds(name, None, left)).limits(*interval), partner):
            assert fits(PAIR_OPERATORS[name], None, *((interval, partner) if left else (partner, interval)))


def test_partners_of_and_are_bounded_by_window_only() -> None:
    assert interval_bounds("and", None, True) is None
    assert required(interval_bounds("and", 10, True)).limits(5, 7) == (-3, MAX_VALUE, MIN_VALUE, 15)


@pytest.mark.parametrize(
    ("name", "left", "by_end"),
    [
        ("seq", False, True),
        ("seq", True, False),
        ("meets", False, True),
        ("starts", False, False),
        ("finishes", True, True),
    ],
)
def test_most_limited_instant_is_indexed(name: str, left: bool, by_end: bool) -> None:
    assert required(interval_bounds(name, None, left)).by_end is by_end


def test_bounds_of_negated_events() -> None:
    assert [interval for interval in INTERVALS if within(BETWEEN.limits(1, 4), interval)] == [
        (2, 2),
        (2, 3),
        (3, 3),
    ]
    assert [interval for interval in INTERVALS if within(BEFORE.limits(2, 2), interval)] == [
        (0, 0),
        (0, 1),
        (1, 1),
    ]
