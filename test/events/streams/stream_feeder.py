"""Feeder of items for tests of stream operators, with a clock that runs due deadlines before each item."""

from collections import deque
from typing import NamedTuple

from hypothesis import strategies as st

from retalis.events.streams.aggregates import AGGREGATES
from retalis.events.streams.stream_operators import StreamElement


class Came(NamedTuple):
    """What came: its group or key, its interval, what is looked at, the channel, and what the clock said."""

    at: int
    key: str
    start: int
    end: int
    value: object
    channel: int
    now: int


def stream(values, late=12, channels=(0,), most=25):
    """Return a strategy for lists of items that come up to so late; the clock is at the newest end."""
    one = st.tuples(
        st.sampled_from("aab"),
        st.integers(0, 3),
        st.sampled_from([0, 0, 0, min(1, late), min(2, late), late]),
        st.integers(0, 3),
        values,
        st.sampled_from(channels),
    )
    return st.lists(one, max_size=most).map(_placed)


def _placed(rows):
    found, now = [], 20
    for at, (key, step, back, length, value, channel) in enumerate(rows):
        now += step
        end = now - back
        found.append(Came(at, key, end - length, end, value, channel, now))
    return found


def item_of(came):
    """Return the item of what came, whose match is its number."""
    return StreamElement(came.at, came.start, came.end, (came.key,), (came.value,))


def listing():
    """Make the measure that gives all values."""
    return [AGGREGATES["list"].make_accumulator(0, None)]


class Fed:
    """An operator, and what it gave on: the numbers of the items, start, end.

    Args:
        make: makes the operator.
        cut: after how many items another one goes on with what is known.
    """

    def __init__(self, make, cut=None):
        self.make = make
        self.cut = cut
        self.stream = self._begin()
        self.said = []

    def _begin(self):
        made = self.make()
        made.tracks_elements = True
        return made

    def feed(self, arrivals):
        """Give items, ringing what is due before each of them, and what is due at last."""
        for number, came in enumerate(arrivals):
            self.ring(came.now)
            if number == self.cut:
                other = self._begin()
                other.restore(self.stream.snapshot())
                self.stream = other
            self.said += map(_shown, self.stream.process(item_of(came), came.now, came.channel))
        self.ring(1 << 40)
        return self.said

    def ring(self, now):
        """Let the operator ring at each instant for which it asks, up to now."""
        while self.stream.next_deadline is not None and self.stream.next_deadline <= now:
            before = self.stream.next_deadline
            self.said += sorted(map(_shown, self.stream.advance_to(before)))
            assert self.stream.next_deadline is None or self.stream.next_deadline > before


def entries(one):
    """Return how many entries all lists, queues and dictionaries of an object have."""
    known = [getattr(one, name) for name in getattr(one, "__slots__", ())] or vars(one).values()
    return sum(len(value) for value in known if isinstance(value, (list, deque, dict)))


def _shown(output):
    return tuple([item.match for item in output.elements]), output.start, output.end


def spanning(found):
    """Return what is said of items that are measured together: numbers, first start, last end."""
    return tuple([one.at for one in found]), min(one.start for one in found), max(one.end for one in found)
