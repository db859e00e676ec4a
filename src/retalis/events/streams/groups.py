"""The items of one group that are in a window: over which interval they lie, and what is measured of them."""

from collections import deque
from typing import Callable, Deque, List, Optional, Sequence, Tuple

from ...foundation import RuleError
from ...prolog.terms import Values
from .items import StreamItem, StreamOutput
from .measures import WindowMeasure
from .numbers import Lowest

MOST_NAMED = 100
"""How many items an output names where they are tracked: the newest, so that long windows take no more for each."""


def measured(results: Callable[[], Optional[Values]]) -> Tuple[Optional[Values], Optional[RuleError]]:
    """Return the results of measures, and what is reported in their place where something cannot be measured."""
    try:
        return results(), None
    except RuleError as error:
        return (), error
    except OverflowError:
        return (), RuleError("aggregate: what is measured is too large for a float")


class WindowGroup:
    """The items of one group that are in a window, and their measures.

    Attributes:
        since: the instant from which its time counts: the clock at its last item, or for windows that begin with an
            item the end of that item.
        starts: the starts of the items; None while the items have come in the order of their starts and ends.
        ends: the ends of the items, negated; None under the same condition.
    """

    __slots__ = ("members", "number", "measures", "checks", "since", "starts", "ends")

    def __init__(self, measures: Sequence[WindowMeasure], since: int = 0):
        self.members: Deque[StreamItem] = deque()
        self.number = 0
        self.measures = measures
        self.checks = [measure.check for measure in measures if measure.picky]
        self.since = since
        self.starts: Optional[Lowest] = None
        self.ends: Optional[Lowest] = None

    def add(self, item: StreamItem) -> None:
        """Take an item in."""
        members = self.members
        if self.starts is not None and self.ends is not None:
            self.starts.add(item.start, item)
            self.ends.add(-item.end, item)
        elif members and (item.start < members[-1].start or item.end < members[-1].end):
            self.starts, self.ends = Lowest(), Lowest()  # from here on the first and last do not say it
            for one in [one for one in members if not one.gone] + [item]:
                self.starts.add(one.start, one)
                self.ends.add(-one.end, one)
        members.append(item)
        self.number += 1
        for measure in self.measures:
            measure.add(item)

    def remove(self, item: StreamItem) -> None:
        """Take an item out."""
        item.gone = True
        self.number -= 1
        members = self.members
        while members and members[0].gone:
            members.popleft()
        while members and members[-1].gone:
            members.pop()
        if len(members) > 2 * self.number + 64:
            self.members = deque([one for one in members if not one.gone])
        if self.starts is not None and self.ends is not None:
            self.starts.remove()
            self.ends.remove()
        for measure in self.measures:
            measure.remove(item)

    def output(
        self, with_items: bool, start: Optional[int] = None, end: Optional[int] = None
    ) -> Optional[StreamOutput]:
        """Return what is measured, by default over the interval of the items; None where a measure has no result."""
        found, error = measured(self._results)
        if found is None:
            return None
        if start is None or end is None:
            start, end = self._interval()
        members = self.members
        items = self._newest() if with_items else (members[-1],)
        return StreamOutput(items, start, end, found, error)

    def _results(self) -> Optional[Values]:
        """Return the results of the measures; None where one has none."""
        found = []
        members, number = self.members, self.number
        for measure in self.measures:
            result = measure.result(members, number)
            if result is None:
                return None
            found.append(result)
        return tuple(found)

    def _newest(self) -> Tuple[StreamItem, ...]:
        """Return the newest items, in the order in which they came."""
        found: List[StreamItem] = []
        for item in reversed(self.members):
            if not item.gone:
                found.append(item)
                if len(found) == MOST_NAMED:
                    break
        return tuple(reversed(found))

    def _interval(self) -> Tuple[int, int]:
        if self.starts is None or self.ends is None:
            return self.members[0].start, self.members[-1].end
        low, high = self.starts.top(), self.ends.top()
        assert low is not None and high is not None  # it is asked where there are items
        return low[2].start, high[2].end
