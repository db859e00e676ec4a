"""Windows over streams: which items are measured together, and when the measures are given on.

Items are in groups. Each window class says which of them are in, when they leave, and when a group is given on; what
is measured is the same for all of them.
"""

import heapq
from collections import OrderedDict, deque
from typing import Callable, Deque, Hashable, List, Optional, Sequence, Tuple

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
        self.allowed: Callable[[], int] = lambda: 1 << 64
        self.clock = self._until = -(1 << 63)
        self.next: Optional[int] = None
        self.late = 0
        self.number = 0
        self._order = 0

    def __len__(self) -> int:
        return self.number

    def drop_oldest(self) -> None:
        """See `StreamOperator.drop_oldest`: of the group that is there for the longest time."""
        group = next(iter(self.groups.values()))
        self._leave(next(one for one in group.members if not one.gone))
        self._tidy()

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
            self._heap = _without_gone(self._heap)

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


class FromFirst(Window):
    """The items that end less than ``span`` ns after the first of them in their group did.

    A window is over when the clock, or the newest end, has come to its end: it is given on then, or while it is
    ``running`` at each item.
    """

    def __init__(self, make: Make, span: int, running: bool):
        super().__init__(make)
        self.span = span
        self.running = running
        self._reached = -(1 << 63)
        self._open: List[Tuple[int, int, Hashable, WindowGroup]] = []

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        group: Optional[WindowGroup] = self._group_of(item)
        if item.end > self._until:
            self._until = self.allowed()
        if item.end > self._until:  # nothing else may wait for its time
            self.late += 1
            return []
        self._move_on(item.end)
        if now > self._reached:
            self._reached = now
        outputs = self._close(self.clock)
        group = self.groups.get(item.key)
        if group is None:
            if item.end + self.span <= max(self.clock, self._reached):  # its window is over before it begins
                self.late += 1
                return outputs
            group = WindowGroup(self.make(), item.end)
        elif not group.begin <= item.end < group.begin + self.span:
            self.late += 1
            return outputs
        self._came(item)
        if not group.number:
            heapq.heappush(self._open, (group.begin, item.order, item.key, group))
        self._enter(item, group)
        self._set_next()
        return [*outputs, *self._given(group)] if self.running else outputs

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        super().restore(kept)
        (self._reached,) = kept[5:]
        self._open = [(group.begin, group.members[0].order, key, group) for key, group in self.groups.items()]
        heapq.heapify(self._open)

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        return (*super().kept(), self._reached)

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`."""
        return self._close(instant)

    def _tidy(self) -> None:
        if len(self._open) > 2 * len(self.groups) + 64:
            self._open = [one for one in self._open if self.groups.get(one[2]) is one[3]]
            heapq.heapify(self._open)

    def _close(self, instant: int) -> List[StreamOutput]:
        outputs: List[StreamOutput] = []
        opened = self._open
        while opened and opened[0][0] + self.span <= instant:
            begin, _, key, group = heapq.heappop(opened)
            if self.groups.get(key) is group:
                if not self.running:
                    outputs += self._given(group, begin, begin + self.span)
                self._empty(group, key)
        self._set_next()
        return outputs

    def _set_next(self) -> None:
        self.next = self._open[0][0] + self.span if self._open else None


class RunningWindow(Window):
    """The items of the present window of ``span`` ns since 1970, by their ends; given on at each item."""

    def __init__(self, make: Make, span: int):
        super().__init__(make)
        self.span = span

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        self._group_of(item)
        index = item.end // self.span
        present = self.clock // self.span
        if index < present or item.end > self.allowed():
            self.late += 1
            return []
        if index > present:
            for key, group in list(self.groups.items()):
                self._empty(group, key)
        self._move_on(item.end)
        group = self._group_of(item)
        self._came(item)
        self._enter(item, group)
        return self._given(group)


class Hopping(Window):
    """The items that ended in ``span`` ns before an instant: given on at each multiple of ``every`` ns since 1970."""

    def __init__(self, make: Make, span: int, every: int):
        super().__init__(make)
        self.span = span
        self.every = every
        self._reached = -(1 << 63)
        self._ahead: List[Tuple[int, int, StreamItem]] = []
        self._by_end: List[Tuple[int, int, StreamItem]] = []

    def __len__(self) -> int:
        return self.number + len(self._ahead)

    def drop_oldest(self) -> None:
        """See `StreamOperator.drop_oldest`."""
        if self.groups:
            super().drop_oldest()
        else:
            heapq.heappop(self._ahead)

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        return (
            *super().kept(),
            self._reached,
            [item for _, _, item in sorted(self._ahead, key=lambda one: one[:2])],
        )

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        super().restore(kept)
        self._reached, ahead = kept[5:]
        for item in ahead:
            item.file()
        self._ahead = [(item.end, item.order, item) for item in ahead]

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        self._group_of(item)
        every = self.every
        if now > self._reached:
            self._reached = now  # an alarm of the past may make an event when this has been reached
        rung = self._reached // every * every
        if (item.end + self.span) // every * every <= rung:
            self.late += 1
            return []
        self._came(item)
        heapq.heappush(self._ahead, (item.end, item.order, item))
        first = max((item.end // every + 1) * every, rung + every)
        if self.next is None or first < self.next:
            self.next = first
        return []

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`."""
        outputs: List[StreamOutput] = []
        while self.next is not None and self.next <= instant:
            outputs += self._ring_at(self.next)
        return outputs

    def _ring_at(self, instant: int) -> List[StreamOutput]:
        self._leave_before(instant - self.span)
        entering = []
        while self._ahead and self._ahead[0][0] < instant:
            entering.append(heapq.heappop(self._ahead)[2])
        for item in sorted(entering, key=lambda one: one.order):
            self._enter(item, self._group_of(item))
            self._note(item)
        outputs = [
            output
            for group in sorted(self.groups.values(), key=lambda one: one.members[0].order)
            for output in self._given(group, instant - self.span, instant)
        ]
        after = instant + self.every
        self._leave_before(after - self.span)
        if self.groups:
            self.next = after
        elif self._ahead:
            self.next = max(after, (self._ahead[0][0] // self.every + 1) * self.every)
        else:
            self.next = None
        return outputs

    def _note(self, item: StreamItem) -> None:
        heapq.heappush(self._by_end, (item.end, item.order, item))

    def _tidy(self) -> None:
        if len(self._by_end) > 2 * self.number + 64:
            self._by_end = _without_gone(self._by_end)

    def _leave_before(self, before: int) -> None:
        while self._by_end and self._by_end[0][0] < before:
            item = heapq.heappop(self._by_end)[2]
            if not item.gone:
                self._leave(item)


def _without_gone(heap: List[Tuple[int, int, StreamItem]]) -> List[Tuple[int, int, StreamItem]]:
    left = [entry for entry in heap if not entry[2].gone]
    heapq.heapify(left)
    return left
