"""Work inside one step: pieces of it are counted, and large allocations are announced."""

import pytest

from retalis.foundation.cancellation import BULK, check_limits, in_bulks, watched, watched_by


@pytest.fixture
def asked():
    """Return the pairs of pieces of work and bytes that are asked about."""
    pairs = []
    before = watched_by(lambda work, size: pairs.append((work, size)))
    yield pairs
    watched_by(before)


def test_who_watches_is_told_of_work_and_bytes(asked):
    check_limits()
    check_limits(5, 1 << 20)
    assert asked == [(len(BULK), 0), (5, 1 << 20)]


@pytest.mark.parametrize("parts", ["ab" * 1500, list(range(3000))])
def test_there_is_a_look_between_bulks(asked, parts):
    bulks = list(in_bulks(parts))
    assert [len(bulk) for bulk in bulks] == [1024, 1024, 952]
    assert type(parts)().join(bulks) == parts if isinstance(parts, str) else sum(bulks, []) == parts
    assert len(asked) == 2


def test_few_items_are_not_watched(asked):
    assert list(watched([1, 2, 3])) == [1, 2, 3]
    assert list(watched([])) == []
    assert asked == []
