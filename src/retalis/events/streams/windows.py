"""The items of one group that are in a window: over which interval they lie, and what is measured of them.

Windows that are given on by their items: which of these are measured together, and when.

Items are in groups. Each window class says which of them are in, when they leave, and when a group is given on; what
is measured is the same for all of them.

Windows between instants: they begin with an item, or at multiples of a time since 1970, and end by the clock.
"""

import heapq
from collections import OrderedDict, deque
from typing import Callable, Deque, Hashable, List, Optional, Sequence, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.types import Values
from .accumulators import Accumulator, Lowest
from .stream_elements import KeyedOperator, KnownState, StreamElement, StreamOutput

MAX_TRACKED_ITEMS = 100
"""How many items an output names where they are tracked: the newest, so that long windows take no more for each."""


def measured(results: Callable[[], Optional[Values]]) -> Tuple[Optional[Values], Optional[RuleError]]:
    """Return the results of measures, and what is reported in their place where something cannot be measured."""
    try:
        return results(), None
    except RuleError as error:
        return (), error
    except OverflowError:
        return (), RuleError("aggregate: what is measured is too large for a float")


class KeyedWindow:
    """The items of one group that are in a window, and their measures.

    Attributes:
        since: the instant from which its time counts: the clock at its last item, or for windows that begin with an
            item the end of that item.
        starts: the starts of the items; None while the items have come in the order of their starts and ends.
        ends: the ends of the items, negated; None under the same condition.
    """

    __slots__ = ("members", "number", "measures", "checks", "since", "starts", "ends")

    def __init__(self, measures: Sequence[Accumulator], since: int = 0):
        self.members: Deque[StreamElement] = deque()
        self.number = 0
        self.measures = measures
        self.checks = [measure.check for measure in measures if measure.picky]
        self.since = since
        self.starts: Optional[Lowest] = None
        self.ends: Optional[Lowest] = None

    def add(self, item: StreamElement) -> None:
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

    def remove(self, item: StreamElement) -> None:
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

    def _newest(self) -> Tuple[StreamElement, ...]:
        """Return the newest items, in the order in which they came."""
        found: List[StreamElement] = []
        for item in reversed(self.members):
            if not item.gone:
                found.append(item)
                if len(found) == MAX_TRACKED_ITEMS:
                    break
        return tuple(reversed(found))

    def _interval(self) -> Tuple[int, int]:
        if self.starts is None or self.ends is None:
            return self.members[0].start, self.members[-1].end
        low, high = self.starts.top(), self.ends.top()
        assert low is not None and high is not None  # it is asked where there are items
        return low[2].start, high[2].end


Make = Callable[[], Sequence[Accumulator]]


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
        self.states: OrderedDict[Hashable, KeyedWindow] = OrderedDict()
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

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
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
            group = KeyedWindow(self.make(), since)
            for item in members:
                item.file()
                self._enter(item, group)
                self._note(item)

    def _note(self, item: StreamElement) -> None:
        """File an item that has entered by when it is to leave."""

    def _group_of(self, item: StreamElement) -> KeyedWindow:
        """Return the group of an item, made where there is none; nothing is changed where a value is refused."""
        group = self.states.get(item.key)
        if group is None:
            group = KeyedWindow(self.make())
        for check in group.checks:
            check(item)
        return group

    def _came(self, item: StreamElement) -> None:
        self.last_order += 1
        item.order = self.last_order

    def _used_group(self, item: StreamElement) -> KeyedWindow:
        """Return the group of an item that uses it now, after idle groups were dropped."""
        group = self._group_of(item)
        end = item.end
        if self.clock < end and (end <= self.newest_allowed or not self._is_ahead(end)):
            self.clock = end
        if self._idle is not None:
            self._forget_idle()
            if group.number and item.key not in self.states:
                group = KeyedWindow(self.make())
        group.since = self.clock
        return group

    def _enter(self, item: StreamElement, group: KeyedWindow) -> None:
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

    def remove(self, item: StreamElement) -> None:
        """Remove an item from its group, and the group if it was the last."""
        group = self.states[item.key]
        group.remove(item)
        self.number -= 1
        if not group.number:
            del self.states[item.key]

    def _empty(self, group: KeyedWindow, key: Hashable) -> None:
        """Have all items of a group leave at once, also where an interrupt comes meanwhile."""
        del self.states[key]
        self.number -= group.number
        for item in group.members:
            item.gone = True

    def _given(
        self, group: KeyedWindow, start: Optional[int] = None, end: Optional[int] = None
    ) -> List[StreamOutput]:
        meter = self.meter
        if meter is not None and meter(group.number if self._lists else 1):
            return []
        output = group.output(self.tracked, start, end)
        return [] if output is None else [output]


class SlidingTimeWindow(Window):
    """The items that began less than ``span`` ns before the newest end; given on at each item.

    Attributes:
        queue: the items that began in the order in which they came, oldest first.
        disordered: heap of the items that began before the newest of the queue when they came, by their start.
    """

    def __init__(self, make: Make, span: int):
        super().__init__(make)
        self.span = span
        self.queue: Deque[StreamElement] = deque()
        self.disordered: List[Tuple[int, int, StreamElement]] = []

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
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

    def _note(self, item: StreamElement) -> None:
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


class SlidingCountWindow(Window):
    """The last ``most`` items of each group; given on at each item."""

    def __init__(self, make: Make, most: int):
        super().__init__(make)
        self.most = most

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        group = self._used_group(item)
        self._came(item)
        self._enter(item, group)
        while group.number > self.most:  # more than one where an interrupt came before it left
            self.remove(group.members[0])
        return self._given(group)


class TumblingCountWindow(Window):
    """The items of each group, ``most`` at a time; given on when there are so many, or ``running`` at each item."""

    def __init__(self, make: Make, most: int, running: bool):
        super().__init__(make)
        self.most = most
        self.running = running

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
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


def without_gone(heap: List[Tuple[int, int, StreamElement]]) -> List[Tuple[int, int, StreamElement]]:
    """Return a heap of items without those that are gone."""
    left = [entry for entry in heap if not entry[2].gone]
    heapq.heapify(left)
    return left


class AnchoredTumblingWindow(Window):
    """The items that end less than ``span`` ns after the first of them in their group did.

    A window is over when the clock, or the newest end, has come to its end: it is given on then, or while it is
    ``running`` at each item.
    """

    def __init__(self, make: Make, span: int, running: bool):
        super().__init__(make)
        self.span = span
        self.running = running
        self._reached = -(1 << 63)
        self._open: List[Tuple[int, int, Hashable, KeyedWindow]] = []

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.take`."""
        group: Optional[KeyedWindow] = self._group_of(item)
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
            group = KeyedWindow(self.make(), item.end)
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


class EagerTumblingWindow(Window):
    """The items of the present window of ``span`` ns since 1970, by their ends; given on at each item."""

    def __init__(self, make: Make, span: int):
        super().__init__(make)
        self.span = span

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
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


class HoppingWindow(Window):
    """The items that ended in ``span`` ns before an instant: given on at each multiple of ``every`` ns since 1970."""

    def __init__(self, make: Make, span: int, every: int):
        super().__init__(make)
        self.span = span
        self.every = every
        self._reached = -(1 << 63)
        self._ahead: List[Tuple[int, int, StreamElement]] = []
        self._by_end: List[Tuple[int, int, StreamElement]] = []

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

    def take(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
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

    def _note(self, item: StreamElement) -> None:
        heapq.heappush(self._by_end, (item.end, item.order, item))

    def _tidy(self) -> None:
        if len(self._by_end) > 2 * self.number + 64:
            self._by_end = without_gone(self._by_end)

    def _leave_before(self, before: int) -> None:
        while self._by_end and self._by_end[0][0] < before:
            item = heapq.heappop(self._by_end)[2]
            if not item.gone:
                self.remove(item)
