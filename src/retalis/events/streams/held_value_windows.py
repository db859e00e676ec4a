"""Windows over held values: the value of each element lasts until the next element of its key (zero-order hold).

The elements of a key, ordered by their ends, are a signal that is constant between them. A value begins at the end of
its element. It ends where the next one begins, or after a maximum time. A window measures the signal in an interval,
also the part of a value that began before the interval. Of elements with one end, the last to arrive counts.

* `HeldSlidingWindow` emits at each element, for the last ``span`` ns.
* `HeldHoppingWindow` emits at multiples of ``slide`` ns since 1970, also for keys without a new element.

A `HeldSignal` stores the values of one key that reach into the window. It keeps the sums over all values but the last
one; a result corrects them for the part of the first value before the interval, and for the last value. So the cost
of a result does not depend on the number of elements.
"""

import heapq
from bisect import bisect_right
from collections import OrderedDict
from typing import Callable, Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple, Type

from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS, MAX_TIMESTAMP, SECOND
from ...prolog.terms.types import Term, Values
from ...serialization.state_fields import StateFields, constraint, field
from ...serialization.stored_field_types import INSTANT, State
from .aggregates import COMPARABLE_NUMBER, FINITE_NUMBER, Accumulator
from .running_statistics import ExactSum, LazyMinHeap
from .stream_operators import ELEMENTS, KeyBounds, StreamElement, StreamOutput
from .windows import (
    MAX_TRACKED_ELEMENTS,
    OpenWindow,
    SteppedWindow,
    StoredWindow,
    Window,
    elements_of_windows,
    results_or_error,
)

MAX_HELD_STEPS = 100_000
"""Maximum time for which a value lasts in hopping windows, in steps: a jump of the clock emits no more windows."""

_NO_LIMIT = 4 * MAX_TIMESTAMP
"""Time in ns that is longer than that between any two instants."""


class HeldMeasure(Accumulator):
    """Incremental state of one aggregate over a `HeldSignal`; see `Accumulator`.

    `add` and `remove` are called for values that enter and leave the signal.
    """

    def add_time(self, element: StreamElement, nanoseconds: int) -> None:
        """Add a time, which may be negative, to that for which the value of an element lasts."""

    def result_of(self, signal: "HeldSignal", before: int, after: int) -> Optional[Term]:
        """Return the result, or None if there is none.

        Args:
            signal: the signal, which is not empty.
            before: time in ns by which the first value began before the interval.
            after: time in ns from the begin of the last value to its end, or to that of the interval.
        """
        raise NotImplementedError


class _HeldMinimum(HeldMeasure):
    value_rule = COMPARABLE_NUMBER
    sign = 1

    def __init__(self, index: int, name: str, setting: object):
        super().__init__(index, name, setting)
        self._heap = LazyMinHeap()

    def add(self, element: StreamElement) -> None:
        self._heap.add(self.sign * element.values[self.index], element)

    def remove(self, element: StreamElement) -> None:
        self._heap.remove()

    def result_of(self, signal: "HeldSignal", before: int, after: int) -> Optional[Term]:
        top = self._heap.top()
        return None if top is None else top[2].values[self.index]


class _HeldMaximum(_HeldMinimum):
    sign = -1


class _TimeAverage(HeldMeasure):
    """Integral of the values over time, divided by the time in which there is a value."""

    value_rule = FINITE_NUMBER

    def __init__(self, index: int, name: str, setting: object):
        super().__init__(index, name, setting)
        self._integral = ExactSum()

    def add_time(self, element: StreamElement, nanoseconds: int) -> None:
        self._integral.add_multiple(element.values[self.index], nanoseconds)

    def result_of(self, signal: "HeldSignal", before: int, after: int) -> Optional[Term]:
        time = signal.time - before + after
        if not time:
            return None
        first, last = signal.elements[0], signal.elements[-1]
        self.add_time(first, -before)
        self.add_time(last, after)
        average = self._integral.quotient(time, time)
        self.add_time(first, before)
        self.add_time(last, -after)
        return average


class _TimeOfGoal(HeldMeasure):
    """Seconds for which a condition holds; the value of an element is 1 if it does, else 0."""

    def __init__(self, index: int, name: str, setting: object):
        super().__init__(index, name, setting)
        self._time = 0

    def add_time(self, element: StreamElement, nanoseconds: int) -> None:
        self._time += nanoseconds * int(bool(element.values[self.index]))

    def result_of(self, signal: "HeldSignal", before: int, after: int) -> Optional[Term]:
        first, last = (
            int(bool(element.values[self.index])) for element in (signal.elements[0], signal.elements[-1])
        )
        return (self._time - before * first + after * last) / SECOND


class _FirstHeld(HeldMeasure):
    def result_of(self, signal: "HeldSignal", before: int, after: int) -> Optional[Term]:
        value: Term = signal.elements[0].values[self.index]
        return value


class _LastHeld(HeldMeasure):
    def result_of(self, signal: "HeldSignal", before: int, after: int) -> Optional[Term]:
        value: Term = signal.elements[-1].values[self.index]
        return value


class HeldAggregate(NamedTuple):
    """Aggregate function of held values.

    Attributes:
        notation: notation in rules.
        words: the result in words, with the variables of the notation.
        measure: its implementation.
    """

    notation: str
    words: str
    measure: Type[HeldMeasure]


HELD_AGGREGATES: Dict[str, HeldAggregate] = {
    "avg": HeldAggregate("avg(X)", "the average of X over time", _TimeAverage),
    "duration": HeldAggregate("duration(Goal)", "the number of seconds for which Goal holds", _TimeOfGoal),
    "min": HeldAggregate("min(X)", "the smallest X", _HeldMinimum),
    "max": HeldAggregate("max(X)", "the largest X", _HeldMaximum),
    "first": HeldAggregate("first(X)", "the first X", _FirstHeld),
    "last": HeldAggregate("last(X)", "the last X", _LastHeld),
}
"""All aggregate functions of held values by name."""

MeasureFactory = Callable[[], Sequence[HeldMeasure]]


class HeldSignal:
    """Values of one key that reach into a window, ordered by their begins.

    Args:
        measures: the measures, without values.
        limit: longest time in ns for which a value lasts.
        reference_time: the clock at its last element.

    Attributes:
        elements: the elements with these values.
        time: time in ns for which all values but the last one last.
    """

    __slots__ = ("elements", "time", "reference_time", "_ends", "_measures", "_limit")

    def __init__(self, measures: Sequence[HeldMeasure], limit: int, reference_time: int = 0):
        self.elements: List[StreamElement] = []
        self.time = 0
        self.reference_time = reference_time
        self._ends: List[int] = []
        self._measures = measures
        self._limit = limit

    def __len__(self) -> int:
        return len(self.elements)

    def insert(self, element: StreamElement) -> None:
        """Add an element; it replaces one with the same end."""
        position = bisect_right(self._ends, element.end)
        if position and self._ends[position - 1] == element.end:
            position -= 1
            self._remove(position, position + 1)
        self._add_time_of(position - 1, -1)
        self._ends.insert(position, element.end)
        self.elements.insert(position, element)
        for measure in self._measures:
            measure.add(element)
        self._add_time_of(position - 1, 1)
        self._add_time_of(position, 1)

    def _remove(self, start: int, stop: int) -> None:
        """Remove the elements from a position on up to another one."""
        for position in range(start - 1, stop):
            self._add_time_of(position, -1)
        removed_elements = self.elements[start:stop]
        # Together, because each removal at the front moves all later elements.
        del self.elements[start:stop], self._ends[start:stop]
        for element in removed_elements:
            element.is_removed = True
            for measure in self._measures:
                measure.remove(element)
        self._add_time_of(start - 1, 1)

    def _add_time_of(self, position: int, sign: int) -> None:
        """Add the time for which a value lasts, unless there is no such value or it is the last one."""
        if not 0 <= position < len(self._ends) - 1:
            return
        nanoseconds = sign * min(self._ends[position + 1] - self._ends[position], self._limit)
        self.time += nanoseconds
        element = self.elements[position]
        for measure in self._measures:
            measure.add_time(element, nanoseconds)

    def remove_before(self, begin: int) -> None:
        """Remove the values that have ended at an instant."""
        # Values end at their limit, and all but the last one at the begin of the next one.
        ended = bisect_right(self._ends, begin - self._limit)
        replaced = bisect_right(self._ends, begin) - 1
        count = max(ended, replaced)
        if count > 0:
            self._remove(0, count)

    def remove_oldest(self) -> None:
        """Remove the first value."""
        self._remove(0, 1)

    def is_replaced_before(self, end: int, begin: int) -> bool:
        """Return whether another value than that of an element with this end lasts at a later instant."""
        position = bisect_right(self._ends, end)
        return position < len(self._ends) and self._ends[position] <= begin

    def output(self, with_elements: bool, interval: Tuple[int, int], end: int) -> Optional[StreamOutput]:
        """Return the results up to an instant; None if a measure has no result.

        Args:
            with_elements: whether the output has the newest elements, not only the last one.
            interval: the interval of the output; the results are those from its start.
            end: the instant.
        """
        before, after = max(0, interval[0] - self._ends[0]), min(end - self._ends[-1], self._limit)
        results, error = results_or_error(lambda: self._results(before, after))
        if results is None:
            return None
        if not with_elements:
            return StreamOutput((self.elements[-1],), *interval, results, error)
        elements = tuple(self.elements[-MAX_TRACKED_ELEMENTS:])
        return StreamOutput(elements, *interval, results, error, len(self.elements) - len(elements))

    def _results(self, before: int, after: int) -> Optional[Values]:
        results = []
        for measure in self._measures:
            result = measure.result_of(self, before, after)
            if result is None:
                return None
            results.append(result)
        return tuple(results)


def _have_increasing_ends(stored_windows: Sequence[StoredWindow]) -> bool:
    """Return whether the elements of each window have increasing ends."""
    return all(
        first.end < second.end
        for stored in stored_windows
        for first, second in zip(stored.elements, stored.elements[1:])
    )


class HeldWindow(Window):
    """Base class of windows over held values.

    Args:
        make_measures: creates the measures of a key.
        span: length of the window in ns.
        limit: longest time in ns for which a value lasts; None for no limit.
    """

    STATE = StateFields(
        *Window.STATE.extended(
            constraint(
                "values in the order of their begins",
                lambda window, state: _have_increasing_ends(state["keyed_windows"]),
            )
        )
    )

    def __init__(self, make_measures: MeasureFactory, span: int, limit: Optional[int]):
        self.span = span
        self.limit = _NO_LIMIT if limit is None else limit
        self._make_measures = make_measures
        super().__init__(make_measures)
        self.states: OrderedDict[Hashable, HeldSignal] = OrderedDict()

    def _insert(self, element: StreamElement) -> HeldSignal:
        """Insert an element into the signal of its key, which is the most recently used one then."""
        signal = self.states.get(element.key)
        if signal is None:
            signal = self.states[element.key] = HeldSignal(self._make_measures(), self.limit)
            self._evict_keys()
        self.states.move_to_end(element.key)
        self.element_count -= len(signal)
        signal.insert(element)
        self.element_count += len(signal)
        return signal

    def _remove_before(self, key: Hashable, begin: int) -> None:
        """Remove the values of a key that have ended at an instant."""
        signal = self.states[key]
        self.element_count -= len(signal)
        signal.remove_before(begin)
        self.element_count += len(signal)
        if not signal:
            del self.states[key]

    def _drop_key(self, key: Hashable) -> None:
        self.element_count -= len(self.states.pop(key))

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`; drops the first value of the least recently used key."""
        key, signal = next(iter(self.states.items()))
        signal.remove_oldest()
        self.element_count -= 1
        if not signal:
            del self.states[key]
        return []

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._keep_elements_before(self.max_timestamp + 1)

    def _keep_elements_before(self, instant: int) -> None:
        """Keep only the values that begin before an instant."""
        self.keyed_windows = [
            StoredWindow(stored.reference_time, elements)
            for stored in self.keyed_windows
            for elements in [[element for element in stored.elements if element.end < instant]]
            if elements
        ]

    def _emit_signal(self, signal: HeldSignal, interval: Tuple[int, int], end: int) -> List[StreamOutput]:
        if self.meter is not None and self.meter(1):
            return []
        output = signal.output(self.tracks_elements, interval, end)
        return [] if output is None else [output]

    @property
    def keyed_windows(self) -> List[StoredWindow]:
        """The signals of all keys, the least recently used one first."""
        return [StoredWindow(signal.reference_time, list(signal.elements)) for signal in self.states.values()]

    @keyed_windows.setter
    def keyed_windows(self, stored_windows: Sequence[StoredWindow]) -> None:
        self.states.clear()
        self.element_count = 0
        for reference_time, elements in stored_windows:
            for element in elements:
                self._insert(element).reference_time = reference_time


class HeldSlidingWindow(HeldWindow):
    """Window over the values of the last ``span`` ns up to the newest end; emits at each element."""

    def set_bounds(self, bounds: KeyBounds) -> None:
        """See `StreamOperator.set_bounds`."""
        super().set_bounds(bounds)
        # A value that has ended before the window is not measured again.
        if self.limit != _NO_LIMIT:
            idle_time = self.limit + self.span
            self._max_idle_time = (
                idle_time if self._max_idle_time is None else min(idle_time, self._max_idle_time)
            )

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._check_alone(element)
        # Too far in the future: it would be the last value until the clock reaches it.
        if element.end > self.max_timestamp and self._is_too_far_ahead(element.end):
            self.late_count += 1
            return []
        self._advance(element.end)
        self._drop_idle_keys()
        begin = self.clock - self.span
        signal = self.states.get(element.key)
        if element.end + self.limit <= begin or (
            signal is not None and signal.is_replaced_before(element.end, begin)
        ):
            self.late_count += 1
            return []
        self._number_element(element)
        signal = self._insert(element)
        signal.reference_time = self.clock
        self._remove_before(element.key, begin)
        return self._emit_signal(signal, (max(begin, signal.elements[0].end), self.clock), self.clock)

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        # The window ends at the newest end of the values that remain: none begins after it.
        ends = [signal.elements[-1].end for signal in self.states.values()]
        self.clock = max([self.clock, *ends])
        self._limit_reference_times()


class HeldHoppingWindow(SteppedWindow, HeldWindow):
    """Window over the values of ``span`` ns; emits at multiples of ``slide`` ns since 1970 while a value lasts.

    Args:
        make_measures: see `HeldWindow`.
        span: see `HeldWindow`.
        slide: time in ns from one result to the next one.
        limit: see `HeldWindow`; it is at most `MAX_HELD_STEPS` times ``slide``, which is also the default.
    """

    STATE = StateFields(
        *HeldWindow.STATE.extended(
            field("_latest_now", INSTANT),
            field("future_elements", ELEMENTS),
            constraint("the end of the next window", lambda window, state: window.can_end_next(state)),
        )
    )

    emits_at_deadlines = True

    def __init__(self, make_measures: MeasureFactory, span: int, slide: int, limit: Optional[int]):
        super().__init__(make_measures, span, MAX_HELD_STEPS * slide if limit is None else limit)
        self.slide = slide
        self._latest_now = BEFORE_ALL_INSTANTS
        self._future_elements: List[Tuple[int, int, StreamElement]] = []
        """Heap of the elements that no window has contained yet, by their ends."""

    def can_end_next(self, state: State) -> bool:
        """Return whether the end of the next window in a state is a multiple of the step and follows its values.

        It may precede all future elements, if the element that it was set for has been dropped.
        """
        next_end = state["next_deadline"]
        if next_end is None:
            return not elements_of_windows(state)
        held_elements = [element for stored in state["keyed_windows"] for element in stored.elements]
        return not next_end % self.slide and all(element.end < next_end for element in held_elements)

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._check_alone(element)
        end, slide = element.end, self.slide
        if now > self._latest_now:
            # The maximum, because ``now`` goes back when an alarm raises an event with a past timestamp.
            self._latest_now = now
        last_emitted = self._latest_now // slide * slide
        first_window_end = (end // slide + 1) * slide
        # All windows that begin with its value or before have been emitted; the value may last in later ones.
        if max(first_window_end, (end + self.span) // slide * slide) <= last_emitted:
            self.late_count += 1
            if end + self.limit <= last_emitted + slide - self.span:
                return []
        self._number_element(element)
        heapq.heappush(self._future_elements, (end, element.order, element))
        window_end = max(first_window_end, last_emitted + slide)
        if self.next_deadline is None or window_end < self.next_deadline:
            self.next_deadline = window_end
        return []

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._latest_now = min(self._latest_now, instant)
        self.future_elements = [
            element for element in self.future_elements if element.end <= self.max_timestamp
        ]
        if self.next_deadline is not None:
            next_end = min(self.next_deadline, (instant // self.slide + 1) * self.slide)
            # A value that begins after the window that ends next is not measured in it.
            self.future_elements += [
                element
                for stored in self.keyed_windows
                for element in stored.elements
                if element.end >= next_end
            ]
            self._keep_elements_before(next_end)
            self.next_deadline = next_end if self.states or self._future_elements else None

    def _emit_at(self, instant: int) -> List[StreamOutput]:
        while self._future_elements and self._future_elements[0][0] < instant:
            self._insert(heapq.heappop(self._future_elements)[2])
        begin = instant - self.span
        self._remove_all_before(begin)
        outputs = [
            output
            for signal in sorted(self.states.values(), key=_first_order)
            for output in self._emit_signal(signal, (begin, instant), instant)
        ]
        next_end = instant + self.slide
        self._remove_all_before(next_end - self.span)
        self._schedule_after(next_end)
        return outputs

    def _remove_all_before(self, begin: int) -> None:
        for key in list(self.states):
            self._remove_before(key, begin)

    def open_windows(self, now: int) -> List[OpenWindow]:
        """See `Window.open_windows`."""
        held_elements = [element for signal in self.states.values() for element in signal.elements]
        return self._group_by_window([*held_elements, *self.future_elements])


def _first_order(signal: HeldSignal) -> int:
    """Return the order of arrival of the first value."""
    return signal.elements[0].order
