"""Expiration of partial matches: at their instants, for any order of arrival, in bounded memory."""

import random
from collections import deque
from typing import Any, Deque, List, Optional

import pytest

from retalis.events.matches.expiration import (
    HEAP_SLICE_ENTRIES,
    SLICE_ENTRIES,
    ExpirationQueue,
    StartExpirationQueue,
    remove_stale_entries,
)


class StoredMatch:
    """The attributes of a match that an expiration queue reads."""

    def __init__(self, order: Any) -> None:
        self.order = order
        self.buffer: Optional[StoredMatch] = self

    def discard(self) -> None:
        """Remove the match from its buffer."""
        self.buffer = None


@pytest.mark.parametrize("max_delay", [0, 3, 100])
def test_matches_expire_after_their_instant(max_delay: int) -> None:
    generator = random.Random(max_delay)
    queue = ExpirationQueue()
    matches: List[Any] = []
    for order in range(500):
        instant = order + generator.randint(0, max_delay)
        matches.append((instant, StoredMatch(order)))
        queue.add(instant, matches[-1][1], stored_count=500)
        queue.expire(order - 50)
        assert all((match.buffer is None) == (instant < order - 50) for instant, match in matches)
    assert len(queue) == sum(match.buffer is not None for _, match in matches)


class CountingMatch(StoredMatch):
    """Counts the reads of the buffers of all matches."""

    read_count = 0

    @property
    def buffer(self) -> Any:
        CountingMatch.read_count += 1
        return self.current_buffer

    @buffer.setter
    def buffer(self, buffer: Any) -> None:
        self.current_buffer = buffer


def add_by_instant(queue: Any, match: Any, waiting: Any) -> None:
    queue.add(match.order, match, waiting)


def add_by_start(queue: Any, match: Any, waiting: Any) -> None:
    match.start = match.order
    queue.add(10, match, waiting)


def fill(queue: Any, add: Any, match_count: Any) -> List[CountingMatch]:
    """Add matches, remove three quarters of them, and return all."""
    matches = [CountingMatch(order) for order in range(match_count)]
    for match in matches:
        add(queue, match, match_count)
    for match in matches[::2] + matches[1::4]:  # the stored matches lie among the removed ones
        match.discard()
    return matches


@pytest.mark.parametrize(
    ("queue", "add"), [(ExpirationQueue(), add_by_instant), (StartExpirationQueue(10), add_by_start)]
)
def test_unordered_matches_are_dropped_in_slices(queue: Any, add: Any) -> None:
    match_count = 20 * SLICE_ENTRIES
    matches = fill(queue, add, match_count)
    waiting = len(matches) // 4
    CountingMatch.read_count = 0
    for order in range(match_count, match_count + 100):
        before = CountingMatch.read_count
        waiting += 1
        add(queue, CountingMatch(order), waiting)
        assert CountingMatch.read_count - before <= SLICE_ENTRIES
    assert len(queue) <= 2 * waiting + 1000
    queue.expire(match_count // 2 + 11)
    assert [match.order for match in matches if match.current_buffer][0] == pytest.approx(
        match_count // 2, abs=12
    )
    queue.expire(match_count * 2)
    assert len(queue) == 0
    assert not any(match.current_buffer for match in matches)


def add_by_instant_out_of_order(queue: Any, match: Any, waiting: Any) -> None:
    queue.add(-match.order, match, waiting)


def add_by_start_out_of_order(queue: Any, match: Any, waiting: Any) -> None:
    match.start = -match.order
    queue.add(10, match, waiting)


@pytest.mark.parametrize(
    ("queue", "add"),
    [(ExpirationQueue(), add_by_instant_out_of_order), (StartExpirationQueue(10), add_by_start_out_of_order)],
)
def test_removed_matches_are_dropped_in_slices(queue: Any, add: Any) -> None:
    match_count = 40 * HEAP_SLICE_ENTRIES
    matches = fill(queue, add, match_count)
    waiting = match_count // 4
    for order in range(match_count, match_count + 60):
        before = CountingMatch.read_count
        waiting += 1
        matches.append(CountingMatch(order))
        add(queue, matches[-1], waiting)
        assert CountingMatch.read_count - before <= HEAP_SLICE_ENTRIES + 1
    assert len(queue) <= 2 * waiting + 1000
    queue.expire(-match_count // 2 + 11)
    assert [match.order for match in matches if match.current_buffer][-1] == pytest.approx(
        match_count // 2, abs=15
    )
    queue.expire(100)
    assert len(queue) == 0
    assert not any(match.current_buffer for match in matches)


def test_slices_restart_after_last_entry() -> None:
    matches: Deque[Any] = deque(StoredMatch(order) for order in range(2 * SLICE_ENTRIES))
    for match in list(matches)[:SLICE_ENTRIES]:
        match.discard()
    assert remove_stale_entries(matches, 0) == 0
    assert remove_stale_entries(matches, 0) is None


@pytest.mark.parametrize(
    "match_count", [0, 1, SLICE_ENTRIES - 1, SLICE_ENTRIES, SLICE_ENTRIES + 1, 3 * SLICE_ENTRIES + 7]
)
def test_slices_keep_order_and_reach_all_entries(match_count: Any) -> None:
    matches: Deque[Any] = deque(StoredMatch(order) for order in range(match_count))
    for match in list(matches)[::3]:
        match.discard()
    start = 0
    for _ in range(match_count // SLICE_ENTRIES + 1):
        start = remove_stale_entries(matches, start) or 0
    assert [match.order for match in matches] == [order for order in range(match_count) if order % 3]


@pytest.mark.parametrize("step", [1, -1])
def test_removed_matches_are_dropped(step: int) -> None:
    queue = ExpirationQueue()
    for order in range(20_000):
        match: Any = StoredMatch(order)
        queue.add(order * step, match, stored_count=1)
        if order:
            match.discard()
    assert len(queue) < 2000
    queue.expire(20_000)
    assert len(queue) == 0


@pytest.mark.parametrize(
    ("queue", "add"), [(ExpirationQueue(), add_by_instant), (StartExpirationQueue(10), add_by_start)]
)
def test_matches_removed_after_visit_are_dropped(queue: Any, add: Any) -> None:
    stored: Deque[Any] = deque()
    for order in range(20_000):
        stored.append(StoredMatch(order))
        add(queue, stored[-1], len(stored))
        if len(stored) > 100:
            stored.popleft().discard()
    assert len(queue) < 2000


def test_matches_expire_by_start_in_any_order() -> None:
    generator = random.Random(1)
    start_queue = StartExpirationQueue(10)
    matches: List[Any] = []
    for order in range(300):
        span = generator.choice((10, 10, 25))
        matches.append((order + generator.randint(-20, 0), span, StoredMatch(order)))
        start, _, match = matches[-1]
        match.start = start
        start_queue.add(span, match, stored_count=300)
        start_queue.expire(order)
        # A match that comes out of order may be late already; it expires at the next call.
        assert [match.buffer is None for _, _, match in matches] == [
            start + span < order for start, span, _ in matches
        ]
