"""When waiting matches go: in time, whatever the order in which they came, and without hoarding those that left."""

import random

import pytest

from retalis.events.matches import Expiries
from retalis.events.matches.expiry import ByStart


class Waiting:
    """What a match is to the expiries."""

    def __init__(self, order):
        self.order = order
        self.buffer = self

    def leave(self):
        """Leave."""
        self.buffer = None


@pytest.mark.parametrize("late", [0, 3, 100])
def test_all_go_after_their_instant_and_none_before(late):
    source = random.Random(late)
    expiries = Expiries()
    matches = []
    for order in range(500):
        instant = order + source.randint(0, late)
        matches.append((instant, Waiting(order)))
        expiries.add(*matches[-1], waiting=500)
        expiries.expire(order - 50)
        assert all((match.buffer is None) == (instant < order - 50) for instant, match in matches)
    assert len(expiries) == sum(match.buffer is not None for _, match in matches)


@pytest.mark.parametrize("step", [1, -1])
def test_what_has_left_is_dropped(step):
    expiries = Expiries()
    for order in range(20_000):
        match = Waiting(order)
        expiries.add(order * step, match, waiting=1)
        if order:
            match.leave()
    assert len(expiries) < 2000
    expiries.expire(20_000)
    assert len(expiries) == 0


def test_matches_go_after_their_span_whatever_the_order_of_their_starts():
    source = random.Random(1)
    waiting = ByStart(10)
    matches = []
    for order in range(300):
        span = source.choice((10, 10, 25))
        matches.append((order + source.randint(-20, 0), span, Waiting(order)))
        start, _, match = matches[-1]
        match.start = start
        waiting.add(span, match, waiting=300)
        waiting.expire(order)
        # A match that comes out of order may be late already; it goes at the next look.
        assert [match.buffer is None for _, _, match in matches] == [
            start + span < order for start, span, _ in matches
        ]
