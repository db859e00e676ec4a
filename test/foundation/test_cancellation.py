"""Checks of limits within long steps: work and allocations are reported to the check."""

from typing import Any, Iterator, List

import pytest

from retalis.foundation.cancellation import (
    STEPS_PER_ROUND,
    check_limits,
    in_checked_slices,
    set_limit_check,
    with_limit_checks,
)


@pytest.fixture
def checks() -> Iterator[Any]:
    """Return the list of reported pairs of work and bytes."""
    pairs: List[Any] = []
    before = set_limit_check(lambda work, size: pairs.append((work, size)))
    yield pairs
    set_limit_check(before)


def test_check_receives_work_and_bytes(checks: Any) -> None:
    check_limits()
    check_limits(5, 1 << 20)
    assert checks == [(len(STEPS_PER_ROUND), 0), (5, 1 << 20)]


@pytest.mark.parametrize("parts", ["ab" * 1500, list(range(3000))])
def test_limits_are_checked_between_slices(checks: Any, parts: Any) -> None:
    slices = list(in_checked_slices(parts))
    assert [len(bulk) for bulk in slices] == [1024, 1024, 952]
    assert [item for checked_slice in slices for item in checked_slice] == list(parts)
    assert len(checks) == 2


def test_few_items_are_not_checked(checks: Any) -> None:
    assert list(with_limit_checks([1, 2, 3])) == [1, 2, 3]
    assert list(with_limit_checks([])) == []
    assert checks == []
