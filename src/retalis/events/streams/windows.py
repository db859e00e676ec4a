"""Windows over keyed streams: sliding, tumbling and hopping, by time or by count.

Each key has a `KeyedWindow` with its elements and accumulators. A window class decides which elements are in, when
they leave, and when a result is emitted:

* `SlidingTimeWindow` and `SlidingCountWindow` emit at each element.
* `TumblingCountWindow` emits when it is full, or at each element (``running``).
* `AnchoredTumblingWindow` starts at the first element of a key and emits when its time has passed.
* `EagerTumblingWindow` and `HoppingWindow` are aligned to multiples of a time since 1970; the first one emits at each
  element, the second one when the clock reaches the end of a window.

Elements leave through lazy deletion: `StreamElement.is_removed` is set, and queues and heaps that file the element
skip it. `Window._compact` compacts them when more than half of their entries were removed.

An interrupt may stop a method between two statements. Counts are changed before or after a loop such that the next
call repairs what was not finished.
"""

import heapq
from collections import OrderedDict, deque
from typing import Callable, Deque, Hashable, List, Optional, Sequence, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.types import Values
from .aggregates import Accumulator, unsuitable_value
from .running_statistics import LazyMinHeap
from .stream_operator import KeyedOperator, OperatorState, StreamElement, StreamOutput

MAX_TRACKED_ITEMS = 100
"""Maximum number of elements in a tracked output, the newest ones, so that long windows stay cheap."""


def results_or_error(results: Callable[[], Optional[Values]]) -> Tuple[Optional[Values], Optional[RuleError]]:
    """Return the results of measures, or an empty result with the error if something cannot be measured."""
    try:
        return results(), None
    except RuleError as error:
        return (), error
    except OverflowError:
        return (), RuleError("aggregate: the result is too large for a float")


class KeyedWindow:
    """Elements of one key in a window, with their accumulators.

    Attributes:
        members: the elements in order of arrival; those that were removed may remain between others.
        holes: number of members that were removed; 0 as long as elements arrive in order.
        reference_time: instant from which its time counts: the clock at the last element, or the end of the first
            element for windows that start with an element.
        starts: starts of the elements; None as long as elements arrive in the order of their starts and ends.
        ends: negated ends of the elements; None under the same condition.
        has_arrays: whether an element has had an array as a measured value.
    """

    __slots__ = ("members", "holes", "measures", "checks", "reference_time", "starts", "ends", "has_arrays")

    def __init__(self, measures: Sequence[Accumulator], reference_time: int = 0):
        self.members: Deque[StreamElement] = deque()
        self.holes = 0
        self.measures = measures
        self.checks = [measure.check for measure in measures if measure.checks_values]
        self.reference_time = reference_time
        self.starts: Optional[LazyMinHeap] = None
        self.ends: Optional[LazyMinHeap] = None
        self.has_arrays = False

    @property
    def number(self) -> int:
        """Number of elements."""
        return len(self.members) - self.holes

    def add(self, item: StreamElement) -> None:
        """Add an element."""
        members = self.members
        if self.starts is not None and self.ends is not None:
            self.starts.add(item.start, item)
            self.ends.add(-item.end, item)
        # In order, the interval of the window is given by its first and last element. The heaps are needed only from
        # the first element out of order on.
        elif members and (item.start < members[-1].start or item.end < members[-1].end):
            self._file_elements([member for member in members if not member.is_removed] + [item])
        members.append(item)
        for measure in self.measures:
            if measure.add(item):
                self.has_arrays = True
                # The fused window, which knows numbers only, leaves windows with heaps to this path.
                if self.starts is None:
                    self._file_elements([member for member in members if not member.is_removed])

    def array_refusal(self, item: StreamElement) -> RuleError:
        """Return the error for an element with an array, if the elements before it have numbers."""
        measure = next(measure for measure in self.measures if measure.check(item))
        return unsuitable_value(measure.name, item.values[measure.index])

    def _file_elements(self, elements: Sequence[StreamElement]) -> None:
        """Create the heaps of starts and ends."""
        self.starts, self.ends = LazyMinHeap(), LazyMinHeap()
        for element in elements:
            self.starts.add(element.start, element)
            self.ends.add(-element.end, element)

    def remove(self, item: StreamElement) -> None:
        """Remove an element."""
        item.is_removed = True
        members = self.members
        self.holes += 1
        # Both ends are kept clean, so that the interval and `first` and `last` can be read off in constant time.
        while members and members[0].is_removed:
            members.popleft()
            self.holes -= 1
        while members and members[-1].is_removed:
            members.pop()
            self.holes -= 1
        if len(members) > 2 * self.number + 64:
            self.members = deque([member for member in members if not member.is_removed])
            self.holes = 0
        if self.starts is not None and self.ends is not None:
            self.starts.remove()
            self.ends.remove()
        for measure in self.measures:
            measure.remove(item)

    def output(
        self, with_items: bool, start: Optional[int] = None, end: Optional[int] = None
    ) -> Optional[StreamOutput]:
        """Return the results, by default for the interval of the elements; None if a measure has no result."""
        results, error = results_or_error(self._results)
        if results is None:
            return None
        # Windows between instants state their own interval, also if their elements cover less.
        if start is None or end is None:
            start, end = self._interval()
        members = self.members
        items = self._newest() if with_items else (members[-1],)
        return StreamOutput(items, start, end, results, error)

    def _results(self) -> Optional[Values]:
        """Return the results of the measures, or None if one has no result."""
        results = []
        members, number = self.members, self.number
        for measure in self.measures:
            result = measure.result(members, number)
            if result is None:
                return None
            results.append(result)
        return tuple(results)

    def _newest(self) -> Tuple[StreamElement, ...]:
        """Return the newest elements in order of arrival."""
        newest: List[StreamElement] = []
        for item in reversed(self.members):
            if not item.is_removed:
                newest.append(item)
                if len(newest) == MAX_TRACKED_ITEMS:
                    break
        return tuple(reversed(newest))

    def _interval(self) -> Tuple[int, int]:
        if self.starts is None or self.ends is None:
            return self.members[0].start, self.members[-1].end
        first_entry, last_entry = self.starts.top(), self.ends.top()
        # The window is not empty.
        assert first_entry is not None and last_entry is not None
        return first_entry[2].start, last_entry[2].end


AccumulatorFactory = Callable[[], Sequence[Accumulator]]


class Window(KeyedOperator):
    """Base class of windows: keyed windows and their elements. See `StreamOperator`.

    Args:
        make: creates the accumulators of a key.

    Attributes:
        number: number of elements in all keyed windows.
        last_order: order of the newest element.
    """

    KEY_BYTES, ITEM_BYTES = 1350, 800

    def __init__(self, make: AccumulatorFactory):
        super().__init__()
        self.make = make
        self.states: OrderedDict[Hashable, KeyedWindow] = OrderedDict()
        self._visits_all = any(measure.visits_all for measure in make())
        self.number = 0
        self.last_order = 0

    def __len__(self) -> int:
        return self.number

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`; drops an element of the least recently used key."""
        group = next(iter(self.states.values()))
        self.remove(next(member for member in group.members if not member.is_removed))
        self._compact()
        return []

    def _compact(self) -> None:
        """Compact the containers that file elements by time, if most of their entries were removed."""

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        raise NotImplementedError

    def snapshot(self) -> OperatorState:
        """See `StreamOperator.snapshot`."""
        groups = [
            (group.reference_time, [member for member in group.members if not member.is_removed])
            for group in self.states.values()
        ]
        return (self.clock, self.next_deadline, self.late_count, self.last_order, groups)

    def restore(self, saved: OperatorState) -> None:
        """See `StreamOperator.restore`."""
        # Subclasses append their own fields.
        self.clock, self.next_deadline, self.late_count, self.last_order, groups = saved[:5]
        self.states.clear()
        self.number = 0
        for reference_time, members in groups:
            group = KeyedWindow(self.make(), reference_time)
            for item in members:
                item.restore_key()
                self._insert(item, group)
                self._enqueue(item)

    def _enqueue(self, item: StreamElement) -> None:
        """File an element that has entered by the time at which it leaves."""

    def _keyed_window_of(self, item: StreamElement) -> KeyedWindow:
        """Return the keyed window of an element, possibly a new one; a rejected value changes nothing."""
        group = self.states.get(item.key)
        if group is None:
            group = KeyedWindow(self.make())
        # All checks run before the element is added to any accumulator.
        for check in group.checks:
            if check(item) and group.number and not group.has_arrays:
                raise group.array_refusal(item)
        return group

    def _number_element(self, item: StreamElement) -> None:
        self.last_order += 1
        item.order = self.last_order

    def _most_recent_window(self, item: StreamElement) -> KeyedWindow:
        """Return the keyed window of an element as the most recently used one, after idle keys are dropped."""
        group = self._keyed_window_of(item)
        end = item.end
        if self.clock < end and (end <= self.newest_allowed or not self._is_too_far_ahead(end)):
            self.clock = end
        if self._idle is not None:
            self._drop_idle_keys()
            # The idle keys that were dropped may include the key of this element.
            if group.number and item.key not in self.states:
                group = KeyedWindow(self.make())
        group.reference_time = self.clock
        return group

    def _insert(self, item: StreamElement, group: KeyedWindow) -> None:
        states = self.states
        if group.number:
            states.move_to_end(item.key)
        else:
            states[item.key] = group
            if len(states) > self._max_keys:
                self._evict_keys()
        self.number += 1
        group.add(item)

    def _drop_key(self, key: Hashable) -> None:
        """Drop a key with its elements."""
        self._clear_key(self.states[key], key)
        self._compact()

    def remove(self, item: StreamElement) -> None:
        """Remove an element, and its key if it was the last one."""
        group = self.states[item.key]
        group.remove(item)
        self.number -= 1
        if not group.number:
            del self.states[item.key]

    def _clear_key(self, group: KeyedWindow, key: Hashable) -> None:
        """Remove all elements of a key at once, in an order that is safe against interrupts."""
        del self.states[key]
        self.number -= group.number
        # The key is removed and the count adjusted first: an interrupt in this loop then leaves unmarked elements of
        # a window that nothing refers to.
        for item in group.members:
            item.is_removed = True

    def _emit(
        self, group: KeyedWindow, start: Optional[int] = None, end: Optional[int] = None
    ) -> List[StreamOutput]:
        meter = self.meter
        if meter is not None and meter(group.number if self._visits_all or group.has_arrays else 1):
            return []
        output = group.output(self.tracked, start, end)
        return [] if output is None else [output]


class SlidingTimeWindow(Window):
    """Window of the elements that started less than ``span`` ns before the newest end; emits at each element.

    Attributes:
        queue: elements that arrived in the order of their starts, the oldest first. None ends after the clock.
        disordered: heap of the other elements, by their starts: those that started before the end of the queue when
            they arrived, and those that are too far in the future to advance the clock.
    """

    def __init__(self, make: AccumulatorFactory, span: int):
        super().__init__(make)
        self.span = span
        self.queue: Deque[StreamElement] = deque()
        self.disordered: List[Tuple[int, int, StreamElement]] = []

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        group = self._keyed_window_of(item)
        self._advance(item.end)
        limit = self.clock - self.span
        self._remove_before(limit)
        if item.start <= limit:
            self.late_count += 1
            return []
        self._number_element(item)
        self._insert(item, group)
        self._enqueue(item)
        return self._emit(group)

    def _enqueue(self, item: StreamElement) -> None:
        queue = self.queue
        # Most elements arrive in order, and a queue is cheaper than a heap.
        if item.end <= self.clock and (not queue or queue[-1].start <= item.start):
            queue.append(item)
        else:
            heapq.heappush(self.disordered, (item.start, item.order, item))

    def _compact(self) -> None:
        if len(self.queue) + len(self.disordered) > 2 * self.number + 64:
            self.queue = deque([element for element in self.queue if not element.is_removed])
            self.disordered = compacted_heap(self.disordered)

    def _remove_before(self, limit: int) -> None:
        queue, heap = self.queue, self.disordered
        while queue and queue[0].start <= limit:
            item = queue.popleft()
            if not item.is_removed:
                self.remove(item)
        while heap and heap[0][0] <= limit:
            item = heapq.heappop(heap)[2]
            if not item.is_removed:
                self.remove(item)


class SlidingCountWindow(Window):
    """Window of the last ``size`` elements of each key; emits at each element."""

    def __init__(self, make: AccumulatorFactory, size: int):
        super().__init__(make)
        self.size = size

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        group = self._most_recent_window(item)
        self._number_element(item)
        self._insert(item, group)
        # More than one if an interrupt came before the removal.
        while group.number > self.size:
            self.remove(group.members[0])
        return self._emit(group)


class TumblingCountWindow(Window):
    """Window of ``size`` elements of each key at a time; emits when it is full, or if ``running`` at each element."""

    def __init__(self, make: AccumulatorFactory, size: int, running: bool):
        super().__init__(make)
        self.size = size
        self.running = running

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        group = self._most_recent_window(item)
        # An interrupt came when it was full.
        if group.number >= self.size:
            self._clear_key(group, item.key)
            group = self._most_recent_window(item)
        self._number_element(item)
        self._insert(item, group)
        full = group.number >= self.size
        outputs = self._emit(group) if full or self.running else []
        if full:
            self._clear_key(group, item.key)
        return outputs


def compacted_heap(heap: List[Tuple[int, int, StreamElement]]) -> List[Tuple[int, int, StreamElement]]:
    """Return a heap without the elements that were removed."""
    present_entries = [entry for entry in heap if not entry[2].is_removed]
    heapq.heapify(present_entries)
    return present_entries


class AnchoredTumblingWindow(Window):
    """Window of the elements that end less than ``span`` ns after the first element of their key.

    A window closes when the clock or the newest end reaches its end. It emits at that time, or if ``running`` at each
    element.
    """

    def __init__(self, make: AccumulatorFactory, span: int, running: bool):
        super().__init__(make)
        self.span = span
        self.running = running
        self._latest_now = -(1 << 63)
        self._open: List[Tuple[int, int, Hashable, KeyedWindow]] = []

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._keyed_window_of(item)  # rejects unsuitable values before anything changes
        # Too far in the future: no window may wait for it.
        if item.end > self.newest_allowed and self._is_too_far_ahead(item.end):
            self.late_count += 1
            return []
        self._advance(item.end)
        if now > self._latest_now:
            self._latest_now = now
        # Windows that end before this element are closed first, so the element cannot enter one of them.
        outputs = self._close(self.clock)
        group = self.states.get(item.key)
        if group is None:
            # Its window has ended already.
            if item.end + self.span <= max(self.clock, self._latest_now):
                self.late_count += 1
                return outputs
            group = KeyedWindow(self.make(), item.end)
        elif not group.reference_time <= item.end < group.reference_time + self.span:
            self.late_count += 1
            return outputs
        self._number_element(item)
        if not group.number:
            heapq.heappush(self._open, (group.reference_time, item.order, item.key, group))
        self._insert(item, group)
        self._update_deadline()
        return [*outputs, *self._emit(group)] if self.running else outputs

    def restore(self, saved: OperatorState) -> None:
        """See `StreamOperator.restore`."""
        super().restore(saved)
        (self._latest_now,) = saved[5:]
        self._open = [
            (group.reference_time, group.members[0].order, key, group) for key, group in self.states.items()
        ]
        heapq.heapify(self._open)
        self._update_deadline()

    def snapshot(self) -> OperatorState:
        """See `StreamOperator.snapshot`."""
        return (*super().snapshot(), self._latest_now)

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        return self._close(instant)

    def _compact(self) -> None:
        if len(self._open) > 2 * len(self.states) + 64:
            self._open = [entry for entry in self._open if self.states.get(entry[2]) is entry[3]]
            heapq.heapify(self._open)

    def _close(self, instant: int) -> List[StreamOutput]:
        outputs: List[StreamOutput] = []
        opened = self._open
        while opened and opened[0][0] + self.span <= instant:
            begin, _, key, group = heapq.heappop(opened)
            if self.states.get(key) is group:
                if not self.running:
                    outputs += self._emit(group, begin, begin + self.span)
                self._clear_key(group, key)
        self._update_deadline()
        return outputs

    def _update_deadline(self) -> None:
        self.next_deadline = self._open[0][0] + self.span if self._open else None


class EagerTumblingWindow(Window):
    """Current window of ``span`` ns since 1970, by the ends of elements; emits at each element."""

    def __init__(self, make: AccumulatorFactory, span: int):
        super().__init__(make)
        self.span = span

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._keyed_window_of(item)
        index = item.end // self.span
        present = self.clock // self.span
        if index < present or item.end > self.latest_allowed_end():
            self.late_count += 1
            return []
        if index > present:
            # All keys change to the next window together, because windows are aligned to the clock.
            for key, group in list(self.states.items()):
                self._clear_key(group, key)
        self._advance(item.end)
        group = self._keyed_window_of(item)
        self._number_element(item)
        self._insert(item, group)
        return self._emit(group)


class HoppingWindow(Window):
    """Window of the elements that ended in the last ``span`` ns; emits at multiples of ``every`` ns since 1970."""

    def __init__(self, make: AccumulatorFactory, span: int, every: int):
        super().__init__(make)
        self.span = span
        self.every = every
        self._latest_now = -(1 << 63)
        self._future_elements: List[Tuple[int, int, StreamElement]] = []
        self._by_end: List[Tuple[int, int, StreamElement]] = []

    def __len__(self) -> int:
        return self.number + len(self._future_elements)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        if self.states:
            return super().drop_oldest()
        heapq.heappop(self._future_elements)
        return []

    def snapshot(self) -> OperatorState:
        """See `StreamOperator.snapshot`."""
        return (
            *super().snapshot(),
            self._latest_now,
            [item for _, _, item in sorted(self._future_elements, key=lambda entry: entry[:2])],
        )

    def restore(self, saved: OperatorState) -> None:
        """See `StreamOperator.restore`."""
        super().restore(saved)
        self._latest_now, future_elements = saved[5:]
        for item in future_elements:
            item.restore_key()
        self._future_elements = [(item.end, item.order, item) for item in future_elements]
        heapq.heapify(self._future_elements)

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._keyed_window_of(item)  # rejects unsuitable values before anything changes
        every = self.every
        if now > self._latest_now:
            # Alarms may raise events in the past.
            self._latest_now = now
        # The last window end that was emitted. An element that belongs only to windows up to it is late.
        last_emitted = self._latest_now // every * every
        if (item.end + self.span) // every * every <= last_emitted:
            self.late_count += 1
            return []
        self._number_element(item)
        heapq.heappush(self._future_elements, (item.end, item.order, item))
        first = max((item.end // every + 1) * every, last_emitted + every)
        if self.next_deadline is None or first < self.next_deadline:
            self.next_deadline = first
        return []

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        outputs: List[StreamOutput] = []
        while self.next_deadline is not None and self.next_deadline <= instant:
            outputs += self._emit_at(self.next_deadline)
        return outputs

    def _emit_at(self, instant: int) -> List[StreamOutput]:
        self._remove_before(instant - self.span)
        entering = []
        # Elements wait until a window ends after them: an end may lie ahead of the clock.
        while self._future_elements and self._future_elements[0][0] < instant:
            entering.append(heapq.heappop(self._future_elements)[2])
        # The heap is ordered by ends; members must be in order of arrival.
        for item in sorted(entering, key=lambda element: element.order):
            self._insert(item, self._keyed_window_of(item))
            self._enqueue(item)
        outputs = [
            output
            for group in sorted(self.states.values(), key=lambda keyed_window: keyed_window.members[0].order)
            for output in self._emit(group, instant - self.span, instant)
        ]
        # While elements remain, every multiple has a result; otherwise windows without elements are skipped.
        next_end = instant + self.every
        self._remove_before(next_end - self.span)
        if self.states:
            self.next_deadline = next_end
        elif self._future_elements:
            self.next_deadline = max(next_end, (self._future_elements[0][0] // self.every + 1) * self.every)
        else:
            self.next_deadline = None
        return outputs

    def _enqueue(self, item: StreamElement) -> None:
        heapq.heappush(self._by_end, (item.end, item.order, item))

    def _compact(self) -> None:
        if len(self._by_end) > 2 * self.number + 64:
            self._by_end = compacted_heap(self._by_end)

    def _remove_before(self, limit: int) -> None:
        while self._by_end and self._by_end[0][0] < limit:
            item = heapq.heappop(self._by_end)[2]
            if not item.is_removed:
                self.remove(item)
