"""Operators that let some matches of a stream through: not too many, those that last, or where something changed."""

import heapq
from collections import OrderedDict
from typing import Callable, Dict, Hashable, List, Optional, Tuple

from ...prolog.machine import Meter
from ...prolog.terms import term_key
from .items import KnownState, StreamItem, StreamOutput


class StreamShape:
    """What these operators have in common; see `StreamOperator`."""

    def __init__(self) -> None:
        self.next: Optional[int] = None
        self.late = self.crowded = 0
        self.tracked = False
        self.meter: Optional[Meter] = None
        self.allowed: Callable[[], int] = lambda: 1 << 64
        self.clock = self._until = -(1 << 63)

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`."""
        return []

    def _is_ahead(self, end: int) -> bool:
        """Tell whether an end is further in the future than stamps may be: others do not wait for its time."""
        if end > self._until:
            self._until = self.allowed()  # which rises: it is asked where it may matter
        return end > self._until

    def _move_on(self, end: int) -> None:
        if self.clock < end and not self._is_ahead(end):
            self.clock = end


class Spaced(StreamShape):
    """Lets an item through where the last one of its key is ``span`` ns back and more, by the newest end.

    Args:
        span: how far.
        every: whether the last one is any that came, so that the first of each burst is let through; else the last
            that was let through.
    """

    def __init__(self, span: int, every: bool):
        super().__init__()
        self.span = span
        self.every = every
        self.last: Dict[Hashable, StreamItem] = {}
        self._by_end: List[Tuple[int, int, StreamItem]] = []
        self._order = 0

    def __len__(self) -> int:
        return len(self.last)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        while True:
            item = heapq.heappop(self._by_end)[2]
            if self.last.get(item.key) is item:
                del self.last[item.key]
                return []

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        if self._is_ahead(item.end):
            return [StreamOutput((item,), item.start, item.end)]
        self._move_on(item.end)
        self._forget()
        before = self.last.get(item.key)
        if before is None or (self.every and item.end > before.end):
            self._note(item)
        return [StreamOutput((item,), item.start, item.end)] if before is None else []

    def _note(self, item: StreamItem) -> None:
        noted = StreamItem(None, item.start, item.end, item.by, ())  # the match itself is not held
        self._order += 1
        noted.order = self._order
        self.last[noted.key] = noted
        heapq.heappush(self._by_end, (noted.end, noted.order, noted))
        if len(self._by_end) > 2 * len(self.last) + 64:
            self._by_end = [(one.end, one.order, one) for one in self.last.values()]
            heapq.heapify(self._by_end)

    def _forget(self) -> None:
        before = self.clock - self.span
        while self._by_end and self._by_end[0][0] <= before:
            item = heapq.heappop(self._by_end)[2]
            if self.last.get(item.key) is item:
                del self.last[item.key]

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        return (self.clock, list(self.last.values()))

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        self.clock, noted = kept
        self.last, self._by_end = {}, []
        for item in noted:
            item.file()
            self._note(item)


class Changing(StreamShape):
    """Lets an item through where what is looked at is another term than in the last one of its key, or the first."""

    def __init__(self) -> None:
        super().__init__()
        # the first key of a plain dict is looked for among all that have been dropped before it
        self.last: OrderedDict[Hashable, Tuple[Hashable, StreamItem]] = OrderedDict()

    def __len__(self) -> int:
        return len(self.last)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`: the key that was first there."""
        self.last.popitem(last=False)
        return []

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        value = term_key(item.values[0])
        before = self.last.get(item.key)
        if before is not None and before[0] == value:
            return []
        self.last[item.key] = (value, StreamItem(None, item.start, item.end, item.by, item.values))
        return [StreamOutput((item,), item.start, item.end)]

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        return ([item for _, item in self.last.values()],)

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        for item in kept[0]:
            item.file()
        self.last = OrderedDict((item.key, (term_key(item.values[0]), item)) for item in kept[0])


class Settled(StreamShape):
    """Gives an item on ``span`` ns after its end, if none of its key has come that ends as late, within these ns.

    Of one key more than one may wait where ends are ahead of the clock, each ``span`` after the other at least.
    """

    def __init__(self, span: int):
        super().__init__()
        self.span = span
        self._reached = -(1 << 63)
        self.waiting: Dict[Hashable, List[StreamItem]] = {}
        self._number = 0
        self._due: List[Tuple[int, int, StreamItem]] = []
        self._order = 0

    def __len__(self) -> int:
        return self._number

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        self._settle()
        self._leave(self._due[0][2])
        self._settle()
        return []

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        if now > self._reached:
            self._reached = now
        end, span = item.end, self.span
        if end + span <= self._reached or self._is_ahead(end):
            self.late += 1
            return []
        overtaken = False
        for one in list(self.waiting.get(item.key, ())):
            if one.end <= end < one.end + span:
                self._leave(one)
            elif end < one.end < end + span:
                overtaken = True
        if not overtaken:
            self._order += 1
            item.order = self._order
            self._wait(item)
        self._settle()
        return []

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`."""
        outputs = []
        while self.next is not None and self.next <= instant:
            due, _, item = self._due[0]
            self._leave(item)
            outputs.append(StreamOutput((item,), item.start, due))
            self._settle()
        return outputs

    def _wait(self, item: StreamItem) -> None:
        self.waiting.setdefault(item.key, []).append(item)
        self._number += 1
        heapq.heappush(self._due, (item.end + self.span, item.order, item))
        if len(self._due) > 2 * self._number + 64:
            self._due = [entry for entry in self._due if not entry[2].gone]
            heapq.heapify(self._due)

    def _leave(self, item: StreamItem) -> None:
        item.gone = True
        self._number -= 1
        same = self.waiting[item.key]
        same.remove(item)
        if not same:
            del self.waiting[item.key]

    def _settle(self) -> None:
        """Drop what has left from the top, and say when the next one is due."""
        while self._due and self._due[0][2].gone:
            heapq.heappop(self._due)
        self.next = self._due[0][0] if self._due else None

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        waiting = [item for same in self.waiting.values() for item in same]
        return (self._order, self._reached, sorted(waiting, key=lambda one: one.order))

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        self._order, self._reached, waiting = kept
        self.waiting, self._due, self._number = {}, [], 0
        for item in waiting:
            item.file()
            self._wait(item)
        self._settle()
