"""Work inside one step: pieces of it are counted, and large allocations are announced."""

import pytest

from retalis.foundation.cancellation import (
    STEPS_PER_ROUND,
    check_limits,
    in_checked_slices,
    set_limit_check,
    with_limit_checks,
)


@pytest.fixture
def asked():
    """Return the pairs of pieces of work and bytes that are asked about."""
    pairs = []
    before = set_limit_check(lambda work, size: pairs.append((work, size)))
    yield pairs
    set_limit_check(before)


def test_who_watches_is_told_of_work_and_bytes(asked):
    check_limits()
    check_limits(5, 1 << 20)
    assert asked == [(len(STEPS_PER_ROUND), 0), (5, 1 << 20)]


@pytest.mark.parametrize("parts", ["ab" * 1500, list(range(3000))])
def test_there_is_a_look_between_bulks(asked, parts):
    bulks = list(in_checked_slices(parts))
    assert [len(bulk) for bulk in bulks] == [1024, 1024, 952]
    assert type(parts)().join(bulks) == parts if isinstance(parts, str) else sum(bulks, []) == parts
    assert len(asked) == 2


def test_few_items_are_not_watched(asked):
    assert list(with_limit_checks([1, 2, 3])) == [1, 2, 3]
    assert list(with_limit_checks([])) == []
    assert asked == []
