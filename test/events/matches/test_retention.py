"""Retention times: the smallest bound applies, and None is infinite."""

import pytest

from retalis.events.matches.expiration import UNLIMITED, Retention, retention_for_late, smaller_bound


@pytest.mark.parametrize(
    ("one", "other", "found"), [(None, None, None), (None, 3, 3), (3, None, 3), (3, 5, 3), (5, 3, 3)]
)
def test_the_smaller_bound(one, other, found):
    assert smaller_bound(one, other) == found


@pytest.mark.parametrize(
    ("span", "limit", "found"), [(None, None, None), (None, 3, None), (3, None, None), (3, 5, 8)]
)
def test_what_lies_between_sides_is_kept_for_both(span, limit, found):
    assert retention_for_late(span, limit) == found


def test_a_bound_holds_for_all_that_stands_below_it():
    assert UNLIMITED.within(None) == UNLIMITED == Retention(None, None, None)
    assert UNLIMITED.within(5) == Retention(5, 5, 5)
    assert Retention(1, None, 9).within(5) == Retention(1, 5, 5)
    assert Retention(1, 2, 3).within(None) == Retention(1, 2, 3)


def test_what_is_negated_is_kept_for_late_sides_and_is_no_part():
    assert Retention(1, 2, 3).of_negated(4) == Retention(1, 6, None)
    assert Retention(1, 2, 3).of_negated(None) == Retention(1, None, None)
