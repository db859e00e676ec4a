"""Windows over keyed streams: sliding, tumbling and hopping, by time or by count.

Each key has a `KeyedWindow` with its elements and accumulators. A window class decides which elements are in, when
they are removed, and when a result is emitted:

* `SlidingTimeWindow` and `SlidingCountWindow` emit at each element.
* `TumblingCountWindow` emits when it is full, or at each element (``running``).
* `AnchoredTumblingWindow` starts at the first element of a key and emits when its time has passed.
* `SessionWindow` in `session_window` ends when no element has followed for some time.
* `AlignedTumblingWindow` and `HoppingWindow` are aligned to multiples of a time since 1970; the first one emits at
  each element, the second one when the clock reaches the end of a window.

Elements are removed by lazy deletion: `StreamElement.is_removed` is set, and queues and heaps that index the element
skip it. `_SingleWindow._compact` compacts them when more than half of their entries were removed.
"""

import heapq
from collections import OrderedDict, deque
from operator import itemgetter
from typing import Callable, Deque, Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS
from ...prolog.terms.types import Values
from ...serialization.state_fields import StateFields, constraint, field, rows_of
from ...serialization.stored_field_types import COUNT, INSTANT, NOTHING, State, optional, sequence_of
from .aggregates import Accumulator, present_elements, value_error
from .running_statistics import LazyMinHeap
from .stream_operators import (
    ELEMENT,
    ELEMENTS,
    StreamElement,
    StreamOperator,
    StreamOutput,
    have_distinct_orders,
)

MAX_TRACKED_ELEMENTS = 100
"""Maximum number of elements in a tracked output, the newest ones, so that long windows stay cheap."""


def results_or_error(
    compute_results: Callable[[], Optional[Values]],
) -> Tuple[Optional[Values], Optional[RuleError]]:
    """Return the results of measures, or an empty result with the error if a measure raises one."""
    try:
        return compute_results(), None
    except RuleError as error:
        return (), error
    except OverflowError:
        return (), RuleError("aggregate: the result is too large for a float")


class KeyedWindow:
    """Elements of one key in a window, with their accumulators.

    Attributes:
        elements: the elements in order of arrival; those that were removed may remain between others.
        removed_count: number of these that were removed; 0 as long as elements arrive in order.
        checked_measures: the accumulators that reject some values, see `Accumulator.check`.
        reference_time: instant from which its time counts: the clock at the last element, or the end of the first
            element for windows that start with an element.
        starts: starts of the elements; None as long as elements arrive in the order of their starts and ends.
        ends: negated ends of the elements; None under the same condition.
        has_arrays: whether an element has had an array as a measured value.
    """

    __slots__ = (
        "elements",
        "removed_count",
        "measures",
        "checked_measures",
        "reference_time",
        "starts",
        "ends",
        "has_arrays",
    )

    def __init__(self, measures: Sequence[Accumulator], reference_time: int = 0):
        self.elements: Deque[StreamElement] = deque()
        self.removed_count = 0
        self.measures = measures
        self.checked_measures = [measure for measure in measures if measure.checks_values]
        self.reference_time = reference_time
        self.starts: Optional[LazyMinHeap] = None
        self.ends: Optional[LazyMinHeap] = None
        self.has_arrays = False

    @property
    def element_count(self) -> int:
        """Number of elements."""
        return len(self.elements) - self.removed_count

    def add(self, element: StreamElement) -> None:
        """Add an element."""
        elements = self.elements
        if self.starts is not None and self.ends is not None:
            self.starts.add(element.start, element)
            self.ends.add(-element.end, element)
        # In order, the interval of the window is given by its first and last element. The heaps are needed only from
        # the first element out of order on.
        elif elements and (element.start < elements[-1].start or element.end < elements[-1].end):
            self._build_heaps([element for element in elements if not element.is_removed] + [element])
        elements.append(element)
        for measure in self.measures:
            if measure.add(element):
                self.has_arrays = True
                # The fused window supports only numbers; it calls this method for windows that have heaps.
                if self.starts is None:
                    self._build_heaps([element for element in elements if not element.is_removed])

    def _build_heaps(self, elements: Sequence[StreamElement]) -> None:
        """Create the heaps of starts and ends."""
        self.starts, self.ends = LazyMinHeap(), LazyMinHeap()
        for element in elements:
            self.starts.add(element.start, element)
            self.ends.add(-element.end, element)

    def remove(self, element: StreamElement) -> None:
        """Remove an element."""
        element.is_removed = True
        elements = self.elements
        self.removed_count += 1
        # Removed elements at both ends are discarded, so that the interval and the measures `first` and `last` take
        # constant time.
        while elements and elements[0].is_removed:
            elements.popleft()
            self.removed_count -= 1
        while elements and elements[-1].is_removed:
            elements.pop()
            self.removed_count -= 1
        if len(elements) > 2 * self.element_count + 64:
            self.elements = deque([element for element in elements if not element.is_removed])
            self.removed_count = 0
        if self.starts is not None and self.ends is not None:
            self.starts.remove()
            self.ends.remove()
        for measure in self.measures:
            measure.remove(element)

    def output(
        self, with_elements: bool, start: Optional[int] = None, end: Optional[int] = None
    ) -> Optional[StreamOutput]:
        """Return the results, by default for the interval of the elements; None if a measure has no result."""
        results, error = results_or_error(self._results)
        if results is None:
            return None
        # Windows between instants state their own interval, also if their elements cover less.
        if start is None or end is None:
            start, end = self.interval()
        elements = self.elements
        if not with_elements:
            return StreamOutput((elements[-1],), start, end, results, error)
        contributors = self._newest_elements()
        omitted_count = self.element_count - len(contributors)
        return StreamOutput(contributors, start, end, results, error, omitted_count)

    def _results(self) -> Optional[Values]:
        """Return the results of the measures, or None if one has no result."""
        results = []
        elements, element_count = self.elements, self.element_count
        for measure in self.measures:
            result = measure.result(elements, element_count)
            if result is None:
                return None
            results.append(result)
        return tuple(results)

    def _newest_elements(self) -> Tuple[StreamElement, ...]:
        """Return the newest elements in order of arrival."""
        newest_elements: List[StreamElement] = []
        for element in reversed(self.elements):
            if not element.is_removed:
                newest_elements.append(element)
                if len(newest_elements) == MAX_TRACKED_ELEMENTS:
                    break
        return tuple(reversed(newest_elements))

    def interval(self) -> Tuple[int, int]:
        """Return the first start and the last end of the elements."""
        if self.starts is None or self.ends is None:
            return self.elements[0].start, self.elements[-1].end
        first_entry, last_entry = self.starts.top(), self.ends.top()
        # The window is not empty.
        assert first_entry is not None and last_entry is not None
        return first_entry[2].start, last_entry[2].end


class OpenWindow(NamedTuple):
    """A window of a key that has elements and has not ended.

    Attributes:
        element_count: number of its elements.
        start: start of the window, or of its elements if it has no fixed interval, in ns.
        end: end of the window in ns; None if its number of elements ends it.
    """

    key_values: Values
    element_count: int
    start: int
    end: Optional[int]


class StoredWindow(NamedTuple):
    """Stored form of a `KeyedWindow`, whose accumulators follow from its elements.

    Attributes:
        reference_time: see `KeyedWindow`.
        elements: the elements in order of arrival.
    """

    reference_time: int
    elements: List[StreamElement]


def elements_of_windows(state: State) -> List[StreamElement]:
    """Return the elements in the state of a window."""
    return [
        *(element for stored_window in state["keyed_windows"] for element in stored_window.elements),
        *state.get("future_elements", ()),
    ]


def have_distinct_keys(partitions: Sequence[Sequence[StreamElement]]) -> bool:
    """Return whether the elements of a partition have one key, and those of two partitions have different ones."""
    keys = [{element.key for element in elements} for elements in partitions]
    return all(len(partition_keys) == 1 for partition_keys in keys) and len(set().union(*keys)) == len(keys)


AccumulatorFactory = Callable[[], Sequence[Accumulator]]


class Window(StreamOperator):
    """Base class of windows: their elements, measures and stored form. See `StreamOperator`.

    Args:
        make_accumulators: creates the accumulators of a key.

    Attributes:
        element_count: number of elements in all keyed windows.
        last_order: order of the newest element.
    """

    STATE = StateFields(
        field("clock", INSTANT),
        # Only some windows emit when the clock reaches an instant.
        field("next_deadline", lambda window: optional(INSTANT) if window.emits_at_deadlines else NOTHING),
        field("late_count", COUNT),
        field("last_order", COUNT),
        field(
            "keyed_windows",
            rows_of(
                StoredWindow,
                reference_time=INSTANT,
                elements=sequence_of(ELEMENT, min_count=1),
            ),
        ),
        constraint(
            "elements with distinct orders",
            lambda window, state: have_distinct_orders(elements_of_windows(state), state["last_order"]),
        ),
        constraint(
            "distinct partitions, each with one key",
            lambda window, state: have_distinct_keys(
                [stored_window.elements for stored_window in state["keyed_windows"]]
            ),
        ),
        constraint(
            "values that the aggregates accept",
            lambda window, state: window.accepts_values(elements_of_windows(state)),
        ),
    )

    KEY_BYTES, ELEMENT_BYTES = 1350, 800
    emits_at_deadlines = False
    """True if the window emits results when the clock reaches `next_deadline`."""

    def __init__(self, make_accumulators: AccumulatorFactory):
        super().__init__()
        self.make_accumulators = make_accumulators
        accumulators = make_accumulators()
        self._scans_window = any(measure.scans_window for measure in accumulators)
        self._measures_of_new_window = KeyedWindow(accumulators).checked_measures
        self.element_count = 0
        self.last_order = 0

    def __len__(self) -> int:
        return self.element_count

    def open_windows(self, now: int) -> List[OpenWindow]:
        """Return the windows that have elements and end after an instant; sliding windows have no end."""
        return []

    def accepts_values(self, elements: Sequence[StreamElement]) -> bool:
        """Return True if the aggregates accept the values of elements.

        Raises:
            RuleError: if one does not.
        """
        for measure in self._measures_of_new_window:
            for element in elements:
                measure.check(element)
        return True

    def _check_alone(self, element: StreamElement) -> None:
        """Reject an element with a value that does not fit into an empty window."""
        for measure in self._measures_of_new_window:
            measure.check(element)

    def _number_element(self, element: StreamElement) -> None:
        self.last_order += 1
        element.order = self.last_order

    def _emit(
        self, keyed_window: KeyedWindow, start: Optional[int] = None, end: Optional[int] = None
    ) -> List[StreamOutput]:
        meter = self.meter
        if meter is not None and meter(
            keyed_window.element_count if self._scans_window or keyed_window.has_arrays else 1
        ):
            return []
        output = keyed_window.output(self.tracks_elements, start, end)
        return [] if output is None else [output]


class _SingleWindow(Window):
    """Base class of windows with one window per key at a time."""

    def __init__(self, make_accumulators: AccumulatorFactory):
        super().__init__(make_accumulators)
        self.states: OrderedDict[Hashable, KeyedWindow] = OrderedDict()

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`; drops an element of the least recently used key."""
        keyed_window = next(iter(self.states.values()))
        self.remove(next(element for element in keyed_window.elements if not element.is_removed))
        self._compact()
        return []

    def _compact(self) -> None:
        """Compact the containers that index elements by time, if most of their entries were removed."""

    @property
    def keyed_windows(self) -> List[StoredWindow]:
        """The windows of all keys, the least recently used one first."""
        return [
            StoredWindow(
                keyed_window.reference_time,
                [element for element in keyed_window.elements if not element.is_removed],
            )
            for keyed_window in self.states.values()
        ]

    @keyed_windows.setter
    def keyed_windows(self, stored_windows: Sequence[StoredWindow]) -> None:
        self.states.clear()
        self.element_count = 0
        for reference_time, elements in stored_windows:
            keyed_window = KeyedWindow(self.make_accumulators(), reference_time)
            for element in elements:
                self._insert(element, keyed_window)
                self._schedule_removal(element)

    def _schedule_removal(self, element: StreamElement) -> None:
        """Index a new element by the time at which it is to be removed."""

    def _keyed_window_of(self, element: StreamElement) -> KeyedWindow:
        """Return the keyed window of an element, possibly a new one; a rejected value changes nothing.

        Raises:
            RuleError: if a measure cannot process the value.
        """
        keyed_window = self.states.get(element.key)
        if keyed_window is None:
            keyed_window = KeyedWindow(self.make_accumulators())
        try:
            # All checks run before the element is added to any accumulator.
            for measure in keyed_window.checked_measures:
                if measure.check(element) and not measure.array_count and keyed_window.element_count:
                    # The elements of the window have numbers.
                    raise value_error(measure.name, element.values[measure.index])
        except RuleError:
            # Values need to fit only those of elements that are in a window together.
            if not self._is_obsolete(keyed_window, element):
                raise
            self._check_alone(element)
        return keyed_window

    def _is_obsolete(self, keyed_window: KeyedWindow, element: StreamElement) -> bool:
        """Return whether all elements of a window are removed before a new element is inserted."""
        return False

    def _check_values(self, element: StreamElement) -> None:
        """Reject an element with an unsuitable value, before anything changes; see `_keyed_window_of`."""
        if element.key in self.states:
            self._keyed_window_of(element)
        else:
            self._check_alone(element)

    def _clock_after(self, end: int) -> int:
        return self.clock if end <= self.clock or self._is_too_far_ahead(end) else end

    def _is_idle(self, keyed_window: KeyedWindow, element: StreamElement) -> bool:
        """Return whether `_most_recent_window` drops the key of an element before it returns a new window."""
        idle_time = self._max_idle_time
        return (
            idle_time is not None and keyed_window.reference_time < self._clock_after(element.end) - idle_time
        )

    def _most_recent_window(self, element: StreamElement) -> KeyedWindow:
        """Return the keyed window of an element as the most recently used one, after idle keys are dropped."""
        keyed_window = self._keyed_window_of(element)
        end = element.end
        if self.clock < end and (end <= self.max_timestamp or not self._is_too_far_ahead(end)):
            self.clock = end
        if self._max_idle_time is not None:
            self._drop_idle_keys()
            # The idle keys that were dropped may include the key of this element.
            if keyed_window.element_count and element.key not in self.states:
                keyed_window = KeyedWindow(self.make_accumulators())
        keyed_window.reference_time = self.clock
        return keyed_window

    def _insert(self, element: StreamElement, keyed_window: KeyedWindow) -> None:
        states = self.states
        if keyed_window.element_count:
            states.move_to_end(element.key)
        else:
            states[element.key] = keyed_window
            if len(states) > self._max_keys:
                self._evict_keys()
        self.element_count += 1
        keyed_window.add(element)

    def _drop_key(self, key: Hashable) -> None:
        """Drop a key with its elements."""
        self._clear_key(self.states[key], key)
        self._compact()

    def remove(self, element: StreamElement) -> None:
        """Remove an element, and its key if it was the last one."""
        keyed_window = self.states[element.key]
        keyed_window.remove(element)
        self.element_count -= 1
        if not keyed_window.element_count:
            del self.states[element.key]

    def _clear_key(self, keyed_window: KeyedWindow, key: Hashable) -> None:
        """Remove all elements of a key at once."""
        del self.states[key]
        self.element_count -= keyed_window.element_count
        for element in keyed_window.elements:
            element.is_removed = True


class SlidingTimeWindow(_SingleWindow):
    """Window of the elements that started less than ``span`` ns before the newest end; emits at each element.

    Attributes:
        queue: elements that arrived in the order of their starts, the oldest first. None ends after the clock.
        out_of_order: heap of the other elements, by their starts: those that started before the end of the queue when
            they arrived, and those that are too far in the future to advance the clock.
    """

    def __init__(self, make_accumulators: AccumulatorFactory, span: int):
        super().__init__(make_accumulators)
        self.span = span
        self.queue: Deque[StreamElement] = deque()
        self.out_of_order: List[Tuple[int, int, StreamElement]] = []

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        keyed_window = self._keyed_window_of(element)
        end = element.end
        if self.clock < end:
            if end <= self.max_timestamp or not self._is_too_far_ahead(end):
                self.clock = end
            # It would be in all windows until the clock reaches it. If the window has no time of its own, all of its
            # elements may be that far ahead, because their clock is wrong.
            elif self.clock > BEFORE_ALL_INSTANTS:
                return []
        min_start = self.clock - self.span
        self._remove_before(min_start)
        if element.start <= min_start:
            self.late_count += 1
            return []
        self._number_element(element)
        self._insert(element, keyed_window)
        self._schedule_removal(element)
        return self._emit(keyed_window)

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        for element in [*self.queue, *(entry[2] for entry in self.out_of_order)]:
            if not element.is_removed and element.start > self.max_timestamp:
                self.remove(element)
        # Removed elements at the end of the queue would send all later ones to the heap.
        self.queue = deque([element for element in self.queue if not element.is_removed])
        self.out_of_order = compacted_heap(self.out_of_order)

    def _is_obsolete(self, keyed_window: KeyedWindow, element: StreamElement) -> bool:
        min_start = self._clock_after(element.end) - self.span
        return all(present.start <= min_start for present in present_elements(keyed_window.elements))

    def _schedule_removal(self, element: StreamElement) -> None:
        queue = self.queue
        # Most elements arrive in order, and a queue is cheaper than a heap.
        if element.end <= self.clock and (not queue or queue[-1].start <= element.start):
            queue.append(element)
        else:
            heapq.heappush(self.out_of_order, (element.start, element.order, element))

    def _compact(self) -> None:
        if len(self.queue) + len(self.out_of_order) > 2 * self.element_count + 64:
            self.queue = deque([element for element in self.queue if not element.is_removed])
            self.out_of_order = compacted_heap(self.out_of_order)

    def _remove_before(self, min_start: int) -> None:
        queue, heap = self.queue, self.out_of_order
        while queue and queue[0].start <= min_start:
            element = queue.popleft()
            if not element.is_removed:
                self.remove(element)
        while heap and heap[0][0] <= min_start:
            element = heapq.heappop(heap)[2]
            if not element.is_removed:
                self.remove(element)


class _CountWindow(_SingleWindow):
    """Window of a number of elements of each key."""

    def __init__(self, make_accumulators: AccumulatorFactory, size: int):
        super().__init__(make_accumulators)
        self.size = size

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._limit_reference_times()

    def _is_obsolete(self, keyed_window: KeyedWindow, element: StreamElement) -> bool:
        return self._is_idle(keyed_window, element)


class SlidingCountWindow(_CountWindow):
    """Window of the last ``size`` elements of each key; emits at each element."""

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        keyed_window = self._most_recent_window(element)
        self._number_element(element)
        self._insert(element, keyed_window)
        if keyed_window.element_count > self.size:
            self.remove(keyed_window.elements[0])
        return self._emit(keyed_window)


class TumblingCountWindow(_CountWindow):
    """Window of ``size`` elements of each key at a time; emits when it is full, or if ``running`` at each element."""

    def __init__(self, make_accumulators: AccumulatorFactory, size: int, running: bool):
        super().__init__(make_accumulators, size)
        self.running = running

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        keyed_window = self._most_recent_window(element)
        self._number_element(element)
        self._insert(element, keyed_window)
        is_full = keyed_window.element_count >= self.size
        outputs = self._emit(keyed_window) if is_full or self.running else []
        if is_full:
            self._clear_key(keyed_window, element.key)
        return outputs

    def open_windows(self, now: int) -> List[OpenWindow]:
        """See `Window.open_windows`."""
        return [
            OpenWindow(window.elements[0].key_values, window.element_count, window.interval()[0], None)
            for window in self.states.values()
        ]


def compacted_heap(heap: List[Tuple[int, int, StreamElement]]) -> List[Tuple[int, int, StreamElement]]:
    """Return a heap without the elements that were removed."""
    present_entries = [entry for entry in heap if not entry[2].is_removed]
    heapq.heapify(present_entries)
    return present_entries


class AnchoredTumblingWindow(_SingleWindow):
    """Window of the elements that end less than ``span`` ns after the first element of their key.

    A window closes when the clock or the newest end reaches its end. It emits at that time, or if ``running`` at each
    element.
    """

    STATE = StateFields(*Window.STATE.extended(field("_latest_now", INSTANT)))

    emits_at_deadlines = True

    def __init__(self, make_accumulators: AccumulatorFactory, span: int, running: bool):
        super().__init__(make_accumulators)
        self.span = span
        self.running = running
        self._latest_now = BEFORE_ALL_INSTANTS
        self._open: List[Tuple[int, int, Hashable, KeyedWindow]] = []

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._check_values(element)
        # Too far in the future: it would keep a window open forever.
        if element.end > self.max_timestamp and self._is_too_far_ahead(element.end):
            self.late_count += 1
            return []
        self._advance(element.end)
        if now > self._latest_now:
            self._latest_now = now
        keyed_window = self.states.get(element.key)
        outputs: List[StreamOutput] = []
        # The window of the key is closed first if it ends before this element. Those of other keys may still get
        # elements with earlier ends; the clock closes them.
        if keyed_window is not None and keyed_window.reference_time + self.span <= element.end:
            outputs = self._close_window(element.key, keyed_window)
            self._compact()
            keyed_window = None
        if keyed_window is None:
            # Its window has ended already.
            if element.end + self.span <= self._latest_now:
                self.late_count += 1
                return outputs
            keyed_window = KeyedWindow(self.make_accumulators(), element.end)
        elif not keyed_window.reference_time <= element.end < keyed_window.reference_time + self.span:
            self.late_count += 1
            return outputs
        self._number_element(element)
        if not keyed_window.element_count:
            heapq.heappush(
                self._open, (keyed_window.reference_time, element.order, element.key, keyed_window)
            )
        self._insert(element, keyed_window)
        self._update_deadline()
        return [*outputs, *self._emit(keyed_window)] if self.running else outputs

    def _is_obsolete(self, keyed_window: KeyedWindow, element: StreamElement) -> bool:
        # Not the clock: it may have been moved by another key, which does not close the window of this one.
        return keyed_window.reference_time + self.span <= element.end

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._latest_now = min(self._latest_now, instant)
        # A window that begins ahead would refuse the elements of its key until then.
        for key, keyed_window in list(self.states.items()):
            if keyed_window.reference_time > self.max_timestamp:
                self._clear_key(keyed_window, key)
        self._index_open_windows()

    def restore(self, saved: State) -> None:
        """See `StateOwner.restore`."""
        super().restore(saved)
        self._index_open_windows()

    def _index_open_windows(self) -> None:
        """Create the heap of open windows again."""
        self._open = [
            (keyed_window.reference_time, keyed_window.elements[0].order, key, keyed_window)
            for key, keyed_window in self.states.items()
        ]
        heapq.heapify(self._open)
        self._update_deadline()

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        return self._close(instant)

    def open_windows(self, now: int) -> List[OpenWindow]:
        """See `Window.open_windows`."""
        return [
            OpenWindow(
                window.elements[0].key_values,
                window.element_count,
                window.reference_time,
                window.reference_time + self.span,
            )
            for window in self.states.values()
        ]

    def _compact(self) -> None:
        if len(self._open) > 2 * len(self.states) + 64:
            self._open = [entry for entry in self._open if self.states.get(entry[2]) is entry[3]]
            heapq.heapify(self._open)

    def _close(self, instant: int) -> List[StreamOutput]:
        outputs: List[StreamOutput] = []
        open_windows = self._open
        while open_windows and open_windows[0][0] + self.span <= instant:
            _, _, key, keyed_window = heapq.heappop(open_windows)
            if self.states.get(key) is keyed_window:
                outputs += self._close_window(key, keyed_window)
        self._update_deadline()
        return outputs

    def _close_window(self, key: Hashable, keyed_window: KeyedWindow) -> List[StreamOutput]:
        start = keyed_window.reference_time
        outputs = [] if self.running else self._emit(keyed_window, start, start + self.span)
        self._clear_key(keyed_window, key)
        return outputs

    def _update_deadline(self) -> None:
        self.next_deadline = self._open[0][0] + self.span if self._open else None


class AlignedTumblingWindow(_SingleWindow):
    """Current window of ``span`` ns since 1970, by the ends of elements; emits at each element."""

    def __init__(self, make_accumulators: AccumulatorFactory, span: int):
        super().__init__(make_accumulators)
        self.span = span

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._check_values(element)
        index = element.end // self.span
        current_index = self.clock // self.span
        if index < current_index or self._is_too_far_ahead(element.end):
            self.late_count += 1
            return []
        if index > current_index:
            # All keys change to the next window together, because windows are aligned to the clock.
            for key, keyed_window in list(self.states.items()):
                self._clear_key(keyed_window, key)
        self._advance(element.end)
        keyed_window = self._keyed_window_of(element)
        self._number_element(element)
        self._insert(element, keyed_window)
        return self._emit(keyed_window)

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        index = self.clock // self.span
        super().return_to(instant)
        # All elements are in the window of the time that was wrong.
        if index > self.clock // self.span:
            for key, keyed_window in list(self.states.items()):
                self._clear_key(keyed_window, key)

    def _is_obsolete(self, keyed_window: KeyedWindow, element: StreamElement) -> bool:
        return element.end // self.span > self.clock // self.span

    def open_windows(self, now: int) -> List[OpenWindow]:
        """See `Window.open_windows`."""
        start = self.clock // self.span * self.span
        # The elements are removed by the first element of the next window.
        if start + self.span <= now:
            return []
        return [
            OpenWindow(window.elements[0].key_values, window.element_count, start, start + self.span)
            for window in self.states.values()
        ]


class SteppedWindow(Window):
    """Part of the windows that end at the multiples of a step: elements that no window has contained yet.

    An element waits until the first window ends that contains it, because its end may lie ahead of the clock. A
    subclass creates the heap of these elements, by their ends.
    """

    span: int
    slide: int
    _future_elements: List[Tuple[int, int, StreamElement]]

    def __len__(self) -> int:
        return self.element_count + len(self._future_elements)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        if self.states:
            return super().drop_oldest()
        heapq.heappop(self._future_elements)
        return []

    @property
    def future_elements(self) -> List[StreamElement]:
        """The elements that no window has contained yet, by their ends."""
        return [element for _, _, element in sorted(self._future_elements, key=lambda entry: entry[:2])]

    @future_elements.setter
    def future_elements(self, elements: Sequence[StreamElement]) -> None:
        self._future_elements = [(element.end, element.order, element) for element in elements]
        heapq.heapify(self._future_elements)

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        outputs: List[StreamOutput] = []
        while self.next_deadline is not None and self.next_deadline <= instant:
            outputs += self._emit_at(self.next_deadline)
        return outputs

    def _emit_at(self, instant: int) -> List[StreamOutput]:
        """Return the results of the windows that end at an instant, and set the next deadline."""
        raise NotImplementedError

    def _schedule_after(self, next_end: int) -> None:
        """Set the next deadline, at ``next_end`` or later.

        While elements remain, every multiple has a result; otherwise windows without elements are skipped.
        """
        if self.states:
            self.next_deadline = next_end
        elif self._future_elements:
            self.next_deadline = max(next_end, (self._future_elements[0][0] // self.slide + 1) * self.slide)
        else:
            self.next_deadline = None

    def _group_by_window(self, elements: Sequence[StreamElement]) -> List[OpenWindow]:
        """Return the open windows; of overlapping windows, an element counts in the one that ends first."""
        windows: Dict[Tuple[int, Hashable], List[StreamElement]] = {}
        for element in elements:
            first_end = (element.end // self.slide + 1) * self.slide
            window_end = first_end if self.next_deadline is None else max(first_end, self.next_deadline)
            windows.setdefault((window_end, element.key), []).append(element)
        return [
            OpenWindow(group[0].key_values, len(group), end - self.span, end)
            for (end, _), group in sorted(windows.items(), key=lambda window: window[0][0])
        ]


class HoppingWindow(SteppedWindow, _SingleWindow):
    """Window of the elements that ended in the last ``span`` ns; emits at multiples of ``slide`` ns since 1970."""

    STATE = StateFields(
        *Window.STATE.extended(
            field("_latest_now", INSTANT),
            field("future_elements", ELEMENTS),
            constraint("the end of the next window", lambda window, state: window.can_end_next(state)),
        )
    )

    emits_at_deadlines = True

    def __init__(self, make_accumulators: AccumulatorFactory, span: int, slide: int):
        super().__init__(make_accumulators)
        self.span = span
        self.slide = slide
        self._latest_now = BEFORE_ALL_INSTANTS
        self._future_elements: List[Tuple[int, int, StreamElement]] = []
        self._by_end: List[Tuple[int, int, StreamElement]] = []

    def can_end_next(self, state: State) -> bool:
        """Return whether the end of the next window in a state is a multiple of the step and follows its elements.

        If the window is empty, the first element of a later window must end before it. Otherwise the clock would have
        to close many empty windows.
        """
        next_end, future_elements = state["next_deadline"], state["future_elements"]
        elements = [element for stored_window in state["keyed_windows"] for element in stored_window.elements]
        if next_end is None:
            return not elements and not future_elements
        if next_end % self.slide:
            return False
        if elements:
            return all(element.end < next_end for element in elements)
        return not future_elements or min(element.end for element in future_elements) < next_end

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        end, slide = element.end, self.slide
        if now > self._latest_now:
            # The maximum, because ``now`` goes back when an alarm raises an event with a past timestamp.
            self._latest_now = now
        first_window_end = (end // slide + 1) * slide
        # If windows do not touch, no window contains an element between two of them, whenever it arrives.
        if end < first_window_end - self.span:
            return []
        self._check_values(element)
        # An element is late if all windows that contain it have been emitted.
        last_emitted = self._latest_now // slide * slide
        if (end + self.span) // slide * slide <= last_emitted:
            self.late_count += 1
            return []
        self._number_element(element)
        heapq.heappush(self._future_elements, (end, element.order, element))
        if first_window_end <= last_emitted:
            first_window_end = last_emitted + slide
        if self.next_deadline is None or first_window_end < self.next_deadline:
            self.next_deadline = first_window_end
        return []

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._latest_now = min(self._latest_now, instant)
        self._future_elements = [entry for entry in self._future_elements if entry[0] <= self.max_timestamp]
        heapq.heapify(self._future_elements)
        for end, _, element in self._by_end:
            if end > self.max_timestamp and not element.is_removed:
                self.remove(element)
        self._by_end = compacted_heap(self._by_end)
        if self.next_deadline is not None:
            next_end = (instant // self.slide + 1) * self.slide
            is_empty = not self.states and not self._future_elements
            self.next_deadline = None if is_empty else min(self.next_deadline, next_end)

    def _is_obsolete(self, keyed_window: KeyedWindow, element: StreamElement) -> bool:
        # The first window that contains the element and has not been emitted begins at this instant.
        min_end = (max(element.end, self._latest_now) // self.slide + 1) * self.slide - self.span
        return all(present.end < min_end for present in present_elements(keyed_window.elements))

    def open_windows(self, now: int) -> List[OpenWindow]:
        """See `Window.open_windows`."""
        present = [
            element for window in self.states.values() for element in present_elements(window.elements)
        ]
        future = (element for _, _, element in sorted(self._future_elements, key=itemgetter(1)))
        return self._group_by_window([*present, *future])

    def _emit_at(self, instant: int) -> List[StreamOutput]:
        self._remove_before(instant - self.span)
        outputs: List[StreamOutput] = []
        entering = []
        # Elements are added when a window ends after them: their end may lie ahead of the clock.
        while self._future_elements and self._future_elements[0][0] < instant:
            entering.append(heapq.heappop(self._future_elements)[2])
        # The heap is ordered by ends; the elements of a window must be in order of arrival.
        for element in sorted(entering, key=lambda new_element: new_element.order):
            try:
                keyed_window = self._keyed_window_of(element)
            except RuleError as error:
                # Its value was suitable alone, but an earlier element of this window has another kind of value.
                outputs.append(StreamOutput((element,), element.start, element.end, (), error))
                continue
            self._insert(element, keyed_window)
            self._schedule_removal(element)
        outputs += [
            output
            for keyed_window in sorted(
                self.states.values(), key=lambda keyed_window: keyed_window.elements[0].order
            )
            for output in self._emit(keyed_window, instant - self.span, instant)
        ]
        next_end = instant + self.slide
        self._remove_before(next_end - self.span)
        self._schedule_after(next_end)
        return outputs

    def _schedule_removal(self, element: StreamElement) -> None:
        heapq.heappush(self._by_end, (element.end, element.order, element))

    def _compact(self) -> None:
        if len(self._by_end) > 2 * self.element_count + 64:
            self._by_end = compacted_heap(self._by_end)

    def _remove_before(self, min_start: int) -> None:
        while self._by_end and self._by_end[0][0] < min_start:
            element = heapq.heappop(self._by_end)[2]
            if not element.is_removed:
                self.remove(element)
