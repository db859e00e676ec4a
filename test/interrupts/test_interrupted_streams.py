"""Operators on streams that are interrupted between any two lines, and mended: they go on as if all was well."""

import contextlib
from pathlib import Path

import pytest
from events.streams.operator_driver import Arrival, element_of, list_accumulators

from retalis.events.streams import stream_operators
from retalis.events.streams.rate_operators import Debounce, DistinctUntilChanged, Throttle
from retalis.events.streams.row_pattern import RowPatternNFA, RowPatternVariable, RowPatternWindow, StepTest
from retalis.events.streams.windows import (
    AlignedTumblingWindow,
    AnchoredTumblingWindow,
    SlidingCountWindow,
    SlidingTimeWindow,
    TumblingCountWindow,
)

from .injection import Interrupt, Traced

_SOURCE = str(Path(stream_operators.__file__).parent)


class AtLine(Traced):
    """Raises an interrupt before the n-th line of operators on streams."""

    def __init__(self, at):
        self.left = at

    def _call(self, frame, event, argument):
        return self._line if frame.f_code.co_filename.startswith(_SOURCE) else None

    def _line(self, frame, event, argument):
        if event == "line":
            self.left -= 1
            if not self.left:
                self.interrupt()
        return self._line


def at_instant(instant):
    """Return the tests of a step that takes, or ends at, the item of an instant."""
    return (StepTest((), lambda item, asked: item.end == instant),)


def stepped():
    """Return a window of steps in which matches wait for one that is preferred."""
    optional = RowPatternVariable(0, 1, False, True, at_instant(15), at_instant(19))
    plan = RowPatternNFA([RowPatternVariable(1, 1, False, False, (), ()), optional], [])
    return RowPatternWindow(list_accumulators, [None], plan)


OPERATORS = {
    "steps": stepped,
    "last seconds": lambda: SlidingTimeWindow(list_accumulators, 5),
    "last items": lambda: SlidingCountWindow(list_accumulators, 2),
    "batches": lambda: TumblingCountWindow(list_accumulators, 3, False),
    "from the first": lambda: AnchoredTumblingWindow(list_accumulators, 4, False),
    "present": lambda: AlignedTumblingWindow(list_accumulators, 6),
    "throttle": lambda: Throttle(4, False),
    "burst": lambda: Throttle(2, True),
    "debounce": lambda: Debounce(4),
    "change": DistinctUntilChanged,
}
BEFORE = [(10, "a"), (11, "b"), (12, "a")]
AFTER = [(16, "a"), (17, "b"), (19, "a"), (30, "b")]


def taken(stream, rows):
    """Return what is given on at each of these instants, and of which items."""
    found = []
    for at, key in rows:
        outputs = stream.advance_to(at) + stream.process(
            element_of(Arrival(at, key, at, at, at, 0, at)), at, 0
        )
        found += [(one.start, one.end, repr(one.results)) for one in outputs]
    return found


def one_more(make, ring, take):
    """Return an operator that has taken some items, what is to be interrupted, and how to go on."""
    stream = make()
    taken(stream, BEFORE)

    def work():
        stream.advance_to(ring)
        if take:
            stream.process(element_of(Arrival(15, "a", 15, 15, 15, 0, 15)), 15, 0)

    return stream, work


@pytest.mark.parametrize("kind", OPERATORS)
def test_what_was_interrupted_is_taken_whole_or_not_at_all(kind):
    make = OPERATORS[kind]
    allowed = []
    for ring, take in ((13, False), (14, False), (15, False), (15, True)):
        stream, work = one_more(make, ring, take)
        work()
        allowed.append(taken(stream, AFTER))
    at = 0
    while True:
        at += 1
        stream, work = one_more(make, 15, True)
        with contextlib.suppress(Interrupt), AtLine(at) as injected:
            work()
        mended = make()
        mended.restore(stream.snapshot())
        groups = [group for group in mended.states.values() if hasattr(group, "members")]
        members = [item for group in groups for item in group.elements]
        assert getattr(mended, "number", len(members)) == len(members)
        assert taken(mended, AFTER) in allowed, at
        if injected.left > 0:
            break
    assert at > 5
