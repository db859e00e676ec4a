"""Expiration of partial matches: in time, for any order of arrival, in bounded memory."""

import random
from collections import deque

import pytest

from retalis.events.matches.expiration import (
    HEAP_SLICE_ENTRIES,
    SLICE_ENTRIES,
    ExpirationQueue,
    StartExpirationQueue,
    remove_stale_entries,
)


class Waiting:
    """What a match is to the expiries."""

    def __init__(self, order):
        self.order = order
        self.buffer = self

    def discard(self):
        """Leave."""
        self.buffer = None


@pytest.mark.parametrize("late", [0, 3, 100])
def test_all_go_after_their_instant_and_none_before(late):
    source = random.Random(late)
    expiries = ExpirationQueue()
    matches = []
    for order in range(500):
        instant = order + source.randint(0, late)
        matches.append((instant, Waiting(order)))
        expiries.add(*matches[-1], stored_count=500)
        expiries.expire(order - 50)
        assert all((match.buffer is None) == (instant < order - 50) for instant, match in matches)
    assert len(expiries) == sum(match.buffer is not None for _, match in matches)


class Counted(Waiting):
    """Counts how often any of them is asked whether it waits."""

    asked = 0

    @property
    def buffer(self):
        Counted.asked += 1
        return self.waits

    @buffer.setter
    def buffer(self, buffer):
        self.waits = buffer


def add_to_expiries(expiries, match, waiting):
    expiries.add(match.order, match, waiting)


def add_by_start(expiries, match, waiting):
    match.start = match.order
    expiries.add(10, match, waiting)


def fill(expiries, add, number):
    """Add so many matches, of which a quarter stays, and return them all."""
    matches = [Counted(order) for order in range(number)]
    for match in matches:
        add(expiries, match, number)
    for match in matches[::2] + matches[1::4]:  # those that stay lie among them
        match.discard()
    return matches


@pytest.mark.parametrize(
    ("expiries", "add"), [(ExpirationQueue(), add_to_expiries), (StartExpirationQueue(10), add_by_start)]
)
def test_those_that_left_are_dropped_a_part_at_a_time(expiries, add):
    number = 20 * SLICE_ENTRIES
    matches = fill(expiries, add, number)
    waiting = len(matches) // 4
    Counted.asked = 0
    for order in range(number, number + 100):
        before = Counted.asked
        waiting += 1
        add(expiries, Counted(order), waiting)
        assert Counted.asked - before <= SLICE_ENTRIES
    assert len(expiries) <= 2 * waiting + 1000
    expiries.expire(number // 2 + 11)
    assert [match.order for match in matches if match.waits][0] == pytest.approx(number // 2, abs=12)
    expiries.expire(number * 2)
    assert len(expiries) == 0
    assert not any(match.waits for match in matches)


def add_to_expiries_late(expiries, match, waiting):
    expiries.add(-match.order, match, waiting)


def add_by_start_late(expiries, match, waiting):
    match.start = -match.order
    expiries.add(10, match, waiting)


@pytest.mark.parametrize(
    "expiries, add",
    [(ExpirationQueue(), add_to_expiries_late), (StartExpirationQueue(10), add_by_start_late)],
)
def test_those_that_came_out_of_order_and_left_are_dropped_a_part_at_a_time(expiries, add):
    number = 40 * HEAP_SLICE_ENTRIES
    matches = fill(expiries, add, number)
    waiting = number // 4
    for order in range(number, number + 60):
        before = Counted.asked
        waiting += 1
        matches.append(Counted(order))
        add(expiries, matches[-1], waiting)
        assert Counted.asked - before <= HEAP_SLICE_ENTRIES + 1
    assert len(expiries) <= 2 * waiting + 1000
    expiries.expire(-number // 2 + 11)
    assert [match.order for match in matches if match.waits][-1] == pytest.approx(number // 2, abs=15)
    expiries.expire(100)
    assert len(expiries) == 0
    assert not any(match.waits for match in matches)


def test_the_next_slice_begins_at_the_start_after_a_slice_with_nothing_left():
    matches = deque(Waiting(order) for order in range(2 * SLICE_ENTRIES))
    for match in list(matches)[:SLICE_ENTRIES]:
        match.discard()
    assert remove_stale_entries(matches, 0) == 0
    assert remove_stale_entries(matches, 0) is None


@pytest.mark.parametrize(
    "number", [0, 1, SLICE_ENTRIES - 1, SLICE_ENTRIES, SLICE_ENTRIES + 1, 3 * SLICE_ENTRIES + 7]
)
def test_slices_keep_the_order_and_reach_all(number):
    matches = deque(Waiting(order) for order in range(number))
    for match in list(matches)[::3]:
        match.discard()
    start = 0
    for _ in range(number // SLICE_ENTRIES + 1):
        start = remove_stale_entries(matches, start) or 0
    assert [match.order for match in matches] == [order for order in range(number) if order % 3]


@pytest.mark.parametrize("step", [1, -1])
def test_what_has_left_is_dropped(step):
    expiries = ExpirationQueue()
    for order in range(20_000):
        match = Waiting(order)
        expiries.add(order * step, match, stored_count=1)
        if order:
            match.discard()
    assert len(expiries) < 2000
    expiries.expire(20_000)
    assert len(expiries) == 0


@pytest.mark.parametrize(
    "expiries, add", [(ExpirationQueue(), add_to_expiries), (StartExpirationQueue(10), add_by_start)]
)
def test_matches_that_leave_after_their_visit_are_dropped(expiries, add):
    waiting = deque()
    for order in range(20_000):
        waiting.append(Waiting(order))
        add(expiries, waiting[-1], len(waiting))
        if len(waiting) > 100:
            waiting.popleft().discard()
    assert len(expiries) < 2000


def test_matches_go_after_their_span_whatever_the_order_of_their_starts():
    source = random.Random(1)
    waiting = StartExpirationQueue(10)
    matches = []
    for order in range(300):
        span = source.choice((10, 10, 25))
        matches.append((order + source.randint(-20, 0), span, Waiting(order)))
        start, _, match = matches[-1]
        match.start = start
        waiting.add(span, match, stored_count=300)
        waiting.expire(order)
        # A match that comes out of order may be late already; it goes at the next look.
        assert [match.buffer is None for _, _, match in matches] == [
            start + span < order for start, span, _ in matches
        ]
