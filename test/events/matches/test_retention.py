"""Retention times: the smallest bound applies, and None is infinite."""

from typing import Optional

import pytest

from retalis.events.matches.expiration import UNLIMITED, Retention, retention_for_late, smaller_bound


@pytest.mark.parametrize(
    ("first", "second", "expected"), [(None, None, None), (None, 3, 3), (3, None, 3), (3, 5, 3), (5, 3, 3)]
)
def test_smaller_bound_applies(first: Optional[int], second: Optional[int], expected: Optional[int]) -> None:
    assert smaller_bound(first, second) == expected


@pytest.mark.parametrize(
    ("span", "limit", "expected"), [(None, None, None), (None, 3, None), (3, None, None), (3, 5, 8)]
)
def test_retention_for_late_adds_bounds(
    span: Optional[int], limit: Optional[int], expected: Optional[int]
) -> None:
    assert retention_for_late(span, limit) == expected


def test_bound_limits_inner_retentions() -> None:
    assert UNLIMITED.within(None) == UNLIMITED == Retention(None, None, None)
    assert UNLIMITED.within(5) == Retention(5, 5, 5)
    assert Retention(1, None, 9).within(5) == Retention(1, 5, 5)
    assert Retention(1, 2, 3).within(None) == Retention(1, 2, 3)


def test_negated_pattern_is_kept_for_late_sides() -> None:
    assert Retention(1, 2, 3).of_negated(4) == Retention(1, 6, None)
    assert Retention(1, 2, 3).of_negated(None) == Retention(1, None, None)
