"""Windows between instants: they begin with an item, or at multiples of a time since 1970, and end by the clock."""

import heapq
from typing import Hashable, List, Optional, Tuple

from .groups import WindowGroup
from .items import KnownState, StreamItem, StreamOutput
from .windows import Make, Window, without_gone


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
        if item.end > self.newest_allowed:
            self.newest_allowed = self.allowed()
        if item.end > self.newest_allowed:  # nothing else may wait for its time
            self.late += 1
            return []
        self._move_on(item.end)
        if now > self._reached:
            self._reached = now
        outputs = self._close(self.clock)
        group = self.states.get(item.key)
        if group is None:
            if item.end + self.span <= max(self.clock, self._reached):  # its window is over before it begins
                self.late += 1
                return outputs
            group = WindowGroup(self.make(), item.end)
        elif not group.since <= item.end < group.since + self.span:
            self.late += 1
            return outputs
        self._came(item)
        if not group.number:
            heapq.heappush(self._open, (group.since, item.order, item.key, group))
        self._enter(item, group)
        self._set_next()
        return [*outputs, *self._given(group)] if self.running else outputs

    def restore(self, kept: KnownState) -> None:
        """See `StreamOperator.restore`."""
        super().restore(kept)
        (self._reached,) = kept[5:]
        self._open = [(group.since, group.members[0].order, key, group) for key, group in self.states.items()]
        heapq.heapify(self._open)

    def kept(self) -> KnownState:
        """See `StreamOperator.kept`."""
        return (*super().kept(), self._reached)

    def ring(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.ring`."""
        return self._close(instant)

    def _tidy(self) -> None:
        if len(self._open) > 2 * len(self.states) + 64:
            self._open = [one for one in self._open if self.states.get(one[2]) is one[3]]
            heapq.heapify(self._open)

    def _close(self, instant: int) -> List[StreamOutput]:
        outputs: List[StreamOutput] = []
        opened = self._open
        while opened and opened[0][0] + self.span <= instant:
            begin, _, key, group = heapq.heappop(opened)
            if self.states.get(key) is group:
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
            for key, group in list(self.states.items()):
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

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        if self.states:
            return super().drop_oldest()
        heapq.heappop(self._ahead)
        return []

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
            for group in sorted(self.states.values(), key=lambda one: one.members[0].order)
            for output in self._given(group, instant - self.span, instant)
        ]
        after = instant + self.every
        self._leave_before(after - self.span)
        if self.states:
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
            self._by_end = without_gone(self._by_end)

    def _leave_before(self, before: int) -> None:
        while self._by_end and self._by_end[0][0] < before:
            item = heapq.heappop(self._by_end)[2]
            if not item.gone:
                self.remove(item)
