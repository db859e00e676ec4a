"""Windows that are given on by their items: which of these are measured together, and when.

Items are in groups. Each window class says which of them are in, when they leave, and when a group is given on; what
is measured is the same for all of them.
"""

import heapq
from collections import OrderedDict, deque
from typing import Callable, Deque, Hashable, List, Optional, Sequence, Tuple

from .groups import WindowGroup
from .items import KeyedOperator, KnownState, StreamItem, StreamOutput
from .measures import WindowMeasure

Make = Callable[[], Sequence[WindowMeasure]]


class Window(KeyedOperator):
    """The common part of all windows: groups of items, by their keys. See `StreamOperator`.

    Args:
        make: makes the measures of a group.

    Attributes:
        number: how many items are in groups.
        last_order: order of the newest item.
    """

    KEY_BYTES, ITEM_BYTES = 1350, 800

    def __init__(self, make: Make):
        super().__init__()
        self.make = make
        self.states: OrderedDict[Hashable, WindowGroup] = OrderedDict()
        self._lists = any(measure.lists for measure in make())
        self.number = 0
        self.last_order = 0

    def __len__(self) -> int:
        return self.number

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`: of the group that was least recently used."""
        group = next(iter(self.states.values()))
        self.remove(next(one for one in group.members if not one.gone))
        self._tidy()
        return []

    def _tidy(self) -> None:
        """Drop what has gone before its time from where it is filed, if that is the larger part."""

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        raise NotImplementedError

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        groups = [
            (group.since, [one for one in group.members if not one.gone]) for group in self.states.values()
        ]
        return (self.clock, self.next, self.late, self.last_order, groups)

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        self.clock, self.next, self.late, self.last_order, groups = kept[:5]
        self.states.clear()
        self.number = 0
        for since, members in groups:
            group = WindowGroup(self.make(), since)
            for item in members:
                item.file()
                self._enter(item, group)
                self._note(item)

    def _note(self, item: StreamItem) -> None:
        """File an item that has entered by when it is to leave."""

    def _group_of(self, item: StreamItem) -> WindowGroup:
        """Return the group of an item, made where there is none; nothing is changed where a value is refused."""
        group = self.states.get(item.key)
        if group is None:
            group = WindowGroup(self.make())
        for check in group.checks:
            check(item)
        return group

    def _came(self, item: StreamItem) -> None:
        self.last_order += 1
        item.order = self.last_order

    def _used_group(self, item: StreamItem) -> WindowGroup:
        """Return the group of an item that uses it now, after idle groups were dropped."""
        group = self._group_of(item)
        end = item.end
        if self.clock < end and (end <= self.newest_allowed or not self._is_ahead(end)):
            self.clock = end
        if self._idle is not None:
            self._forget_idle()
            if group.number and item.key not in self.states:
                group = WindowGroup(self.make())
        group.since = self.clock
        return group

    def _enter(self, item: StreamItem, group: WindowGroup) -> None:
        states = self.states
        if group.number:
            states.move_to_end(item.key)
        else:
            states[item.key] = group
            if len(states) > self._most_keys:
                self._make_room()
        self.number += 1
        group.add(item)

    def _forget(self, key: Hashable) -> None:
        """Drop a group with its items."""
        self._empty(self.states[key], key)
        self._tidy()

    def remove(self, item: StreamItem) -> None:
        """Remove an item from its group, and the group if it was the last."""
        group = self.states[item.key]
        group.remove(item)
        self.number -= 1
        if not group.number:
            del self.states[item.key]

    def _empty(self, group: WindowGroup, key: Hashable) -> None:
        """Have all items of a group leave at once, also where an interrupt comes meanwhile."""
        del self.states[key]
        self.number -= group.number
        for item in group.members:
            item.gone = True

    def _given(
        self, group: WindowGroup, start: Optional[int] = None, end: Optional[int] = None
    ) -> List[StreamOutput]:
        meter = self.meter
        if meter is not None and meter(group.number if self._lists else 1):
            return []
        output = group.output(self.tracked, start, end)
        return [] if output is None else [output]


class Sliding(Window):
    """The items that began less than ``span`` ns before the newest end; given on at each item.

    Attributes:
        queue: the items that began in the order in which they came, oldest first.
        disordered: heap of the items that began before the newest of the queue when they came, by their start.
    """

    def __init__(self, make: Make, span: int):
        super().__init__(make)
        self.span = span
        self.queue: Deque[StreamItem] = deque()
        self.disordered: List[Tuple[int, int, StreamItem]] = []

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
        queue = self.queue
        if not queue or queue[-1].start <= item.start:
            queue.append(item)
        else:
            heapq.heappush(self.disordered, (item.start, item.order, item))

    def _tidy(self) -> None:
        if len(self.queue) + len(self.disordered) > 2 * self.number + 64:
            self.queue = deque([one for one in self.queue if not one.gone])
            self.disordered = without_gone(self.disordered)

    def _leave_before(self, before: int) -> None:
        queue, heap = self.queue, self.disordered
        while queue and queue[0].start <= before:
            item = queue.popleft()
            if not item.gone:
                self.remove(item)
        while heap and heap[0][0] <= before:
            item = heapq.heappop(heap)[2]
            if not item.gone:
                self.remove(item)


class Newest(Window):
    """The last ``most`` items of each group; given on at each item."""

    def __init__(self, make: Make, most: int):
        super().__init__(make)
        self.most = most

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        group = self._used_group(item)
        self._came(item)
        self._enter(item, group)
        while group.number > self.most:  # more than one where an interrupt came before it left
            self.remove(group.members[0])
        return self._given(group)


class Batches(Window):
    """The items of each group, ``most`` at a time; given on when there are so many, or ``running`` at each item."""

    def __init__(self, make: Make, most: int, running: bool):
        super().__init__(make)
        self.most = most
        self.running = running

    def take(self, item: StreamItem, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        group = self._used_group(item)
        if group.number >= self.most:  # it was full when an interrupt came
            self._empty(group, item.key)
            group = self._used_group(item)
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
