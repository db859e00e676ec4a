"""Checks of limits within long steps: work and allocations are reported to the check."""

import sys
from threading import Barrier
from typing import Any, Iterator, List

import pytest
from checked_threads import CheckedThread

from retalis.foundation.limit_checks import (
    STEPS_PER_ROUND,
    check_limits,
    in_checked_slices,
    register_check,
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


class WorkCounter:
    """An owner of a check that counts the work of every thread."""

    def __init__(self) -> None:
        self.work = 0

    def count(self, work: int, size: int) -> None:
        self.work += work


def test_checks_registered_by_all_threads_are_called() -> None:
    counters = [[WorkCounter() for _ in range(500)] for _ in range(4)]
    barrier = Barrier(len(counters))

    def register(number: int) -> None:
        barrier.wait(10)
        for counter in counters[number]:
            register_check(counter.count)

    interval = sys.getswitchinterval()
    # Threads take turns so often that they meet within a registration.
    sys.setswitchinterval(1e-6)
    try:
        threads = [CheckedThread(register, number) for number in range(len(counters))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.end()
    finally:
        sys.setswitchinterval(interval)
    check_limits(1)
    assert {counter.work for group in counters for counter in group} == {1}
