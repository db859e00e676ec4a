"""Windows that are given on by their items: which of these are measured together, and when.

Items are in groups. Each window class says which of them are in, when they leave, and when a group is given on; what
is measured is the same for all of them.
"""

import heapq
from collections import OrderedDict, deque
from typing import Callable, Deque, Hashable, List, Optional, Sequence, Tuple

from ...prolog.machine import Meter
from .groups import WindowGroup
from .items import KnownState, StreamItem, StreamOutput
from .measures import WindowMeasure

Make = Callable[[], Sequence[WindowMeasure]]


class Window:
    """What all windows have in common: groups, and the newest end. See `StreamOperator`.

    Args:
        make: makes the measures of a group.

    Attributes:
        clock: the newest end of the items so far.
        number: how many items are in groups.
    """

    def __init__(self, make: Make):
        self.make = make
        self.groups: OrderedDict[Hashable, WindowGroup] = OrderedDict()  # whose oldest is found at once
        self.tracked = False
        self.meter: Optional[Meter] = None
        self._lists = any(measure.lists for measure in make())
        self.allowed: Callable[[], int] = lambda: 1 << 64
        self.clock = self._until = -(1 << 63)
        self.next: Optional[int] = None
        self.late = self.crowded = 0
        self.number = 0
        self._order = 0

    def __len__(self) -> int:
        return self.number

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`: of the group that is there for the longest time."""
        group = next(iter(self.groups.values()))
        self._leave(next(one for one in group.members if not one.gone))
        self._tidy()
        return []

    def _tidy(self) -> None:
        """Drop what has gone before its time from where it is filed, if that is the larger part."""

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`."""
        return []

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        raise NotImplementedError

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        groups = [
            (group.begin, [one for one in group.members if not one.gone]) for group in self.groups.values()
        ]
        return (self.clock, self.next, self.late, self._order, groups)

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        self.clock, self.next, self.late, self._order, groups = kept[:5]
        self.groups, self.number = OrderedDict(), 0
        for begin, members in groups:
            group = WindowGroup(self.make(), begin)
            for item in members:
                item.file()
                self._enter(item, group)
                self._note(item)

    def _note(self, item: StreamItem) -> None:
        """File an item that has entered by when it is to leave."""

    def _group_of(self, item: StreamItem) -> WindowGroup:
        """Return the group of an item, made where there is none; nothing is changed where a value is refused."""
        group = self.groups.get(item.key)
        if group is None:
            group = WindowGroup(self.make())
        for check in group.checks:
            check(item)
        return group

    def _came(self, item: StreamItem) -> None:
        self._order += 1
        item.order = self._order

    def _enter(self, item: StreamItem, group: WindowGroup) -> None:
        self.groups[item.key] = group
        self.number += 1
        group.add(item)

    def _leave(self, item: StreamItem) -> None:
        group = self.groups[item.key]
        group.remove(item)
        self.number -= 1
        if not group.number:
            del self.groups[item.key]

    def _empty(self, group: WindowGroup, key: Hashable) -> None:
        """Have all items of a group leave at once, also where an interrupt comes meanwhile."""
        del self.groups[key]
        self.number -= group.number
        for item in group.members:
            item.gone = True

    def _move_on(self, end: int) -> None:
        if self.clock < end:
            if end > self._until:
                self._until = self.allowed()  # which rises: it is asked where it may matter
            if end <= self._until:
                self.clock = end

    def _given(
        self, group: WindowGroup, start: Optional[int] = None, end: Optional[int] = None
    ) -> List[StreamOutput]:
        meter = self.meter
        if meter is not None and meter(group.number if self._lists else 1):
            return []
        output = group.output(self.tracked, start, end)
        return [] if output is None else [output]


class Sliding(Window):
    """The items that began less than ``span`` ns before the newest end; given on at each item."""

    def __init__(self, make: Make, span: int):
        super().__init__(make)
        self.span = span
        self._queue: Deque[StreamItem] = deque()
        self._heap: List[Tuple[int, int, StreamItem]] = []

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        group = self._group_of(item)
        self._move_on(item.end)
        before = self.clock - self.span
        self._leave_before(before)
        if item.start <= before:
            self.late += 1
            return []
        self._came(item)
        self._enter(item, group)
        self._note(item)
        return self._given(group)

    def _note(self, item: StreamItem) -> None:
        queue = self._queue
        if not queue or queue[-1].start <= item.start:
            queue.append(item)
        else:
            heapq.heappush(self._heap, (item.start, item.order, item))

    def _tidy(self) -> None:
        if len(self._queue) + len(self._heap) > 2 * self.number + 64:
            self._queue = deque([one for one in self._queue if not one.gone])
            self._heap = without_gone(self._heap)

    def _leave_before(self, before: int) -> None:
        queue, heap = self._queue, self._heap
        while queue and queue[0].start <= before:
            item = queue.popleft()
            if not item.gone:
                self._leave(item)
        while heap and heap[0][0] <= before:
            item = heapq.heappop(heap)[2]
            if not item.gone:
                self._leave(item)


class Newest(Window):
    """The last ``most`` items of each group; given on at each item."""

    def __init__(self, make: Make, most: int):
        super().__init__(make)
        self.most = most

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        group = self._group_of(item)
        self._came(item)
        self._enter(item, group)
        while group.number > self.most:  # more than one where an interrupt came before it left
            self._leave(group.members[0])
        return self._given(group)


class Batches(Window):
    """The items of each group, ``most`` at a time; given on when there are so many, or ``running`` at each item."""

    def __init__(self, make: Make, most: int, running: bool):
        super().__init__(make)
        self.most = most
        self.running = running

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        group = self._group_of(item)
        if group.number >= self.most:  # it was full when an interrupt came
            self._empty(group, item.key)
            group = self._group_of(item)
        self._came(item)
        self._enter(item, group)
        full = group.number >= self.most
        outputs = self._given(group) if full or self.running else []
        if full:
            self._empty(group, item.key)
        return outputs


def without_gone(heap: List[Tuple[int, int, StreamItem]]) -> List[Tuple[int, int, StreamItem]]:
    """Return a heap of items without those that are gone."""
    left = [entry for entry in heap if not entry[2].gone]
    heapq.heapify(left)
    return left
