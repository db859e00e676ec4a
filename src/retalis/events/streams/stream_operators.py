"""Stream operators: elements, outputs, the base class with its keyed states, and the rate operators.

An operator partitions its elements by key and holds one state per key. `StreamOperator` bounds these states by time
and by number. Keys are ordered by their last use, so idle keys are found at the front. Dropping them takes constant
time per event on average, because each key is dropped once.

The rate operators correspond to operators of ReactiveX: `Throttle` to throttleFirst, with ``is_debounce`` to a
debounce on the leading edge, `Debounce` to debounce, and `DistinctUntilChanged` to the operator of that name. Time is
the time of the events (their ends), not the time of their arrival, so the result does not depend on the speed of
processing. Windows, row patterns and timeouts for absent events are operators with modules of their own.
"""

import heapq
from collections import OrderedDict
from typing import Any, Callable, Dict, Hashable, List, NamedTuple, Optional, Tuple

from ...foundation.errors import RuleError
from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.term_traversal import SELF_KEYED, term_key
from ...prolog.terms.types import Values


class StreamElement:
    """Element of a stream: a match, with its key and the values that the operator processes.

    Attributes:
        match: the match; None if the operator does not emit it and events are not tracked.
        start: start of its interval in ns.
        end: end of its interval in ns.
        key_values: values of the key terms.
        key: hashable form of ``key_values``.
        values: processed values: one per measure of a window, or the value that may change.
        order: number in the order of arrival.
        is_removed: whether the element has left its operator; containers with lazy deletion skip it.
    """

    __slots__ = ("match", "start", "end", "key_values", "key", "values", "order", "is_removed")

    def __init__(self, match: Any, start: int, end: int, key_values: Values, values: Tuple[Any, ...]):
        self.match = match
        self.start = start
        self.end = end
        self.key_values = key_values
        self.values = values
        self.order = 0
        self.is_removed = False
        if len(key_values) == 1:
            # Plain terms are their own keys, which saves a call for the most frequent case, one key term.
            single = key_values[0]
            self.key: Hashable = single if single.__class__ in SELF_KEYED else term_key(single)
        else:
            self.key = tuple([term_key(value) for value in key_values])

    def restore_key(self) -> None:
        """Mark the element as present, and compute its key from ``key_values``."""
        self.is_removed = False
        key_values = self.key_values
        self.key = (
            term_key(key_values[0])
            if len(key_values) == 1
            else tuple([term_key(value) for value in key_values])
        )


class StreamOutput(NamedTuple):
    """Output of a stream operator.

    Attributes:
        elements: the elements that contributed, in order of arrival; only the newest one unless elements are tracked.
        start: start of the interval in ns.
        end: end of the interval in ns.
        results: results of the measures of a window; empty for other operators.
        error: the error that prevented the results; in this case nothing is emitted.
    """

    elements: Tuple[StreamElement, ...]
    start: int
    end: int
    results: Values = ()
    error: Optional[RuleError] = None


OperatorState = Tuple[Any, ...]
"""State of an operator: a tuple of numbers, terms, elements and lists of these."""
BEFORE_ALL_INSTANTS = -(1 << 63)
"""Instant before all others."""


class KeyBounds(NamedTuple):
    """Bounds for the states of keys.

    Attributes:
        max_span: longest interval of an output that can be used, in ns; None for no bound.
        max_idle_time: time in ns after which a key without a new element is dropped; None for no bound.
        max_keys: maximum number of keys.
    """

    max_span: Optional[int] = None
    max_idle_time: Optional[int] = None
    max_keys: int = 1 << 62


class StreamOperator:
    """Base class of stream operators: state machines that take elements and instants, and return outputs.

    An operator has no access to rules, events and their dispatch. It is deterministic: the same elements and instants
    give the same outputs. Revision relies on this: when an event is retracted, the operator is run again without it.

    Attributes:
        next_deadline: next instant at which `advance_to` may have an output; None if only elements cause outputs.
        late_count: number of elements that arrived too late.
        ahead_count: number of times that an element was too far in the future to advance the time of the stream.
        pruned_count: number of partial matches of a row pattern that were discarded because too many had the same
            start.
        evicted_count: number of keys that were dropped because there were too many.
        bounds: bounds for the states of keys.
        tracks_elements: whether outputs contain up to 100 of the elements that they are made of, not only the newest
            one.
        meter: counts visited elements as pattern work; None if nothing is counted.
        compute_max_timestamp: returns the latest end that may advance the time of the stream.
        clock: the newest end of the elements so far, without ends that are too far in the future, in ns.
        max_timestamp: last result of ``compute_max_timestamp``, in ns.
        states: state of each key. In operators that drop idle keys, the order is that of the last use, and the
            attribute ``reference_time`` of a state is the clock at that use.
    """

    KEY_BYTES = 450
    """Memory of a key without its elements; measured with tracemalloc on CPython 3.11."""
    ELEMENT_BYTES = 450
    """Memory of an element with two small arguments; measured with tracemalloc on CPython 3.11."""

    def __init__(self) -> None:
        self.next_deadline: Optional[int] = None
        self.late_count = self.ahead_count = self.pruned_count = self.evicted_count = 0
        self.tracks_elements = False
        self.meter: Optional[Meter] = None
        self.compute_max_timestamp: Callable[[], int] = lambda: 1 << 64
        self.set_bounds(KeyBounds())
        self.clock = self.max_timestamp = BEFORE_ALL_INSTANTS
        # Finding the first key of a plain dict takes time linear in the number of keys deleted before it.
        self.states: OrderedDict[Hashable, Any] = OrderedDict()

    def set_bounds(self, bounds: KeyBounds) -> None:
        """Set the bounds for the states of keys from the next element on."""
        self.bounds = bounds
        # Local copies, read for each element.
        self._max_span, self._max_idle_time, self._max_keys = bounds

    def __len__(self) -> int:
        """Return the number of stored elements or keys."""
        return len(self.states)

    @property
    def keys(self) -> int:
        """Number of keys with a state."""
        return len(self.states)

    @property
    def bytes(self) -> int:
        """Estimated memory of the states, in bytes: numbers of keys and elements times measured constants."""
        return self.keys * self.KEY_BYTES + len(self) * self.ELEMENT_BYTES

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """Process an element and return the outputs.

        Args:
            element: the element.
            now: the present time of the clock in ns.
            channel: 0, or 1 for elements that must not occur.

        Raises:
            RuleError: if a value cannot be measured; the state is unchanged in this case.
        """
        raise NotImplementedError

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """Return the outputs that are due when the clock reaches an instant."""
        return []

    def drop_oldest(self) -> List[StreamOutput]:
        """Drop the oldest element or key, and return the outputs that this causes."""
        raise NotImplementedError

    def return_to(self, instant: int) -> None:
        """Set the time back to an instant, because the clock had followed a wrong timestamp.

        Elements that the new time may not reach for long are dropped if later results would contain or await them.
        """
        self.clock = min(self.clock, instant)
        self.max_timestamp = self.compute_max_timestamp()

    def _limit_reference_times(self) -> None:
        """Let no key be used later than now; otherwise it, and the keys after it, would never become idle."""
        for state in self.states.values():
            state.reference_time = min(state.reference_time, self.clock)

    def snapshot(self) -> OperatorState:
        """Return the state; see `restore`."""
        raise NotImplementedError

    def restore(self, saved: OperatorState) -> None:
        """Set the state to one that an equal operator returned from `snapshot`."""
        raise NotImplementedError

    def _is_too_far_ahead(self, end: int) -> bool:
        """Return whether an end is too far in the future to advance the time of the stream."""
        # ``compute_max_timestamp`` reads the clock and only rises, so it is called only if its last result is not
        # sufficient.
        if end > self.max_timestamp:
            self.max_timestamp = self.compute_max_timestamp()
        if end <= self.max_timestamp:
            return False
        self.ahead_count += 1
        return True

    def _advance(self, end: int) -> None:
        # `max_timestamp` is tested first, which avoids a call in the usual case.
        if self.clock < end and (end <= self.max_timestamp or not self._is_too_far_ahead(end)):
            self.clock = end

    def _drop_idle_keys(self) -> None:
        """Drop the keys whose last use is too long ago."""
        if self._max_idle_time is None:
            return
        states, min_reference_time = self.states, self.clock - self._max_idle_time
        while states:
            key = next(iter(states))
            # Keys are ordered by last use, so the first key in use ends the search.
            if states[key].reference_time >= min_reference_time:
                return
            self._drop_key(key)

    def _evict_keys(self) -> None:
        """Drop the least recently used keys if there are too many."""
        while len(self.states) > self._max_keys:
            self._drop_key(next(iter(self.states)))
            self.evicted_count += 1

    def _drop_key(self, key: Hashable) -> None:
        """Drop the state of a key."""
        del self.states[key]


class Throttle(StreamOperator):
    """Operator that passes an element if the previous one of its key ended at least ``span`` ns earlier.

    Args:
        span: the time in ns.
        is_debounce: whether blocked elements extend the time, so that only the first element of each burst passes.
    """

    def __init__(self, span: int, is_debounce: bool):
        super().__init__()
        self.span = span
        self.is_debounce = is_debounce
        self.states: OrderedDict[Hashable, StreamElement] = OrderedDict()
        self._by_end: List[Tuple[int, int, StreamElement]] = []
        self._order = 0

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        while True:
            element = heapq.heappop(self._by_end)[2]
            if self.states.get(element.key) is element:
                del self.states[element.key]
                return []

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        # A timestamp too far in the future passes, but does not block the elements that follow with a correct one.
        if self._is_too_far_ahead(element.end):
            return [StreamOutput((element,), element.start, element.end)]
        self._advance(element.end)
        self._drop_expired()
        previous = self.states.get(element.key)
        # States older than ``span`` were dropped, so an element passes if and only if its key has no state.
        if previous is None or (self.is_debounce and element.end > previous.end):
            self._store(element)
        return [StreamOutput((element,), element.start, element.end)] if previous is None else []

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        # An element ahead would block all others of its key until then.
        for key in [key for key, element in self.states.items() if element.end > self.max_timestamp]:
            del self.states[key]

    def _store(self, element: StreamElement) -> None:
        # Without the match, which would keep its events alive.
        stored = StreamElement(None, element.start, element.end, element.key_values, ())
        self._order += 1
        stored.order = self._order
        self.states[stored.key] = stored
        if len(self.states) > self._max_keys:
            self.drop_oldest()
            self.evicted_count += 1
        heapq.heappush(self._by_end, (stored.end, stored.order, stored))
        # With ``is_debounce``, each element replaces the state of its key and leaves an outdated heap entry.
        if len(self._by_end) > 2 * len(self.states) + 64:
            self._by_end = [(element.end, element.order, element) for element in self.states.values()]
            heapq.heapify(self._by_end)

    def _drop_expired(self) -> None:
        max_end = self.clock - self.span
        while self._by_end and self._by_end[0][0] <= max_end:
            element = heapq.heappop(self._by_end)[2]
            if self.states.get(element.key) is element:
                del self.states[element.key]

    def snapshot(self) -> OperatorState:
        """See `StreamOperator.snapshot`."""
        return (self.clock, list(self.states.values()))

    def restore(self, saved: OperatorState) -> None:
        """See `StreamOperator.restore`."""
        self.clock, stored_elements = saved
        self.states.clear()
        self._by_end = []
        for element in stored_elements:
            element.restore_key()
            self._store(element)


class _LastValue:
    """Last value of a key, the element that introduced it, and the clock at the last element."""

    __slots__ = ("value", "element", "reference_time")

    def __init__(self, value: Hashable, element: StreamElement, reference_time: int):
        self.value = value
        self.element = element
        self.reference_time = reference_time


class DistinctUntilChanged(StreamOperator):
    """Operator that passes the first element of a key, and each element whose value differs from the previous one."""

    KEY_BYTES, ELEMENT_BYTES = 950, 0

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`; drops the least recently used key."""
        self.states.popitem(last=False)
        return []

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        term = element.values[0]
        value: Hashable = term if term.__class__ in SELF_KEYED else term_key(term)
        end, key, states = element.end, element.key, self.states
        if self.clock < end and (end <= self.max_timestamp or not self._is_too_far_ahead(end)):
            self.clock = end
        if self._max_idle_time is not None:
            self._drop_idle_keys()
        state = states.get(key)
        # The use of a key is recorded even if the value is unchanged, so that it does not become idle.
        if state is not None:
            states.move_to_end(key)
            state.reference_time = self.clock
            if state.value == value:
                return []
        self._store(
            value, StreamElement(None, element.start, element.end, element.key_values, element.values)
        )
        return [StreamOutput((element,), element.start, element.end)]

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._limit_reference_times()

    def _store(self, value: Hashable, element: StreamElement) -> None:
        self.states[element.key] = _LastValue(value, element, self.clock)
        if len(self.states) > self._max_keys:
            self._evict_keys()

    def snapshot(self) -> OperatorState:
        """See `StreamOperator.snapshot`: clocks of the last uses and elements, the least recently used key first."""
        last_values = self.states.values()
        return ([state.reference_time for state in last_values], [state.element for state in last_values])

    def restore(self, saved: OperatorState) -> None:
        """See `StreamOperator.restore`."""
        self.states.clear()
        for self.clock, element in zip(*saved):
            element.restore_key()
            self._store(term_key(element.values[0]), element)


ElementHeap = List[Tuple[int, int, StreamElement]]
"""Heap of elements: instant, order of arrival, element. It may contain elements that were dropped."""


def push_element(heap: ElementHeap, instant: int, element: StreamElement, element_count: int) -> None:
    """Push an element on a heap; compact the heap if more than half of its elements were dropped.

    Args:
        heap: the heap.
        instant: the instant by which the heap is ordered.
        element: the element.
        element_count: number of elements that were not dropped, or an upper bound.
    """
    heapq.heappush(heap, (instant, element.order, element))
    if len(heap) > 2 * element_count + 64:
        heap[:] = [entry for entry in heap if not entry[2].is_removed]
        heapq.heapify(heap)


class DeadlineOperator(StreamOperator):
    """Operator that emits each pending element ``span`` ns after its end, unless it is dropped before.

    Args:
        span: time in ns from the end of an element to its deadline.
    """

    def __init__(self, span: int):
        super().__init__()
        self.span = span
        self._latest_now = BEFORE_ALL_INSTANTS
        self._deadlines: ElementHeap = []
        self._order = 0

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        outputs = []
        while self.next_deadline is not None and self.next_deadline <= instant:
            deadline, _, element = self._deadlines[0]
            self._drop_pending(element)
            outputs.append(StreamOutput((element,), element.start, deadline))
            self._update_deadline()
        return outputs

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._latest_now = min(self._latest_now, instant)

    def _drop_pending(self, element: StreamElement) -> None:
        """Drop a pending element; its entry in the heap of deadlines is removed later."""
        raise NotImplementedError

    def _update_deadline(self) -> None:
        """Remove dropped elements from the top of the heap, and set the next deadline."""
        while self._deadlines and self._deadlines[0][2].is_removed:
            heapq.heappop(self._deadlines)
        self.next_deadline = self._deadlines[0][0] if self._deadlines else None


class Debounce(DeadlineOperator):
    """Operator that emits an element ``span`` ns after its end if no later element of its key has arrived by then.

    Several elements of one key can be pending if their ends are ahead of the clock and at least ``span`` ns apart.
    """

    def __init__(self, span: int):
        super().__init__(span)
        self.pending: Dict[Hashable, List[StreamElement]] = {}
        self._pending_count = 0

    def __len__(self) -> int:
        return self._pending_count

    @property
    def keys(self) -> int:
        """See `StreamOperator.keys`."""
        return len(self.pending)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        self._update_deadline()
        self._drop_pending(self._deadlines[0][2])
        self._update_deadline()
        return []

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        if now > self._latest_now:
            self._latest_now = now
        end, span = element.end, self.span
        # The deadline has passed already, or lies in a future that the stream must not wait for.
        if end + span <= self._latest_now or self._is_too_far_ahead(end):
            self.late_count += 1
            return []
        is_superseded = False
        for pending in list(self.pending.get(element.key, ())):
            # Elements may arrive out of order. The later of two elements replaces the other one, whichever of them is
            # pending.
            if pending.end <= end < pending.end + span:
                self._drop_pending(pending)
            elif end < pending.end < end + span:
                is_superseded = True
        if not is_superseded:
            self._order += 1
            element.order = self._order
            self._add_pending(element)
        self._update_deadline()
        return []

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        pending = [element for elements in self.pending.values() for element in elements]
        for element in pending:
            if element.end > self.max_timestamp:
                self._drop_pending(element)
        self._update_deadline()

    def _add_pending(self, element: StreamElement) -> None:
        self.pending.setdefault(element.key, []).append(element)
        self._pending_count += 1
        push_element(self._deadlines, element.end + self.span, element, self._pending_count)

    def _drop_pending(self, element: StreamElement) -> None:
        element.is_removed = True
        self._pending_count -= 1
        pending = self.pending[element.key]
        pending.remove(element)
        if not pending:
            del self.pending[element.key]

    def snapshot(self) -> OperatorState:
        """See `StreamOperator.snapshot`."""
        pending = [element for elements in self.pending.values() for element in elements]
        return (self._order, self._latest_now, sorted(pending, key=lambda element: element.order))

    def restore(self, saved: OperatorState) -> None:
        """See `StreamOperator.restore`."""
        self._order, self._latest_now, pending = saved
        self.pending, self._deadlines, self._pending_count = {}, [], 0
        for element in pending:
            element.restore_key()
            self._add_pending(element)
        self._update_deadline()
