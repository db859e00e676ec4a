"""Stream operators: elements, outputs, and the base classes with their keyed states.

An operator partitions its elements by key and holds one state per key. `StreamOperator` bounds these states by time
and by number. Keys are ordered by their last use, so idle keys are found at the front. Dropping them takes constant
time per event on average, because each key is dropped once.

Time is the time of the events (their ends), not the time of their arrival, so the result does not depend on the speed
of processing. Rate operators, windows, row patterns and timeouts for absent events have modules of their own.
"""

import heapq
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Callable, Hashable, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import SELF_KEYED, term_key
from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS
from ...prolog.terms.types import Values
from ...serialization.state_fields import ObjectFields, StateOwner, constraint, field
from ...serialization.stored_field_types import (
    COUNT,
    INSTANT,
    MATCH_VALUE,
    TERM,
    FieldType,
    ReadContext,
    ValueCheck,
    optional,
    reference,
    sequence_of,
)

if TYPE_CHECKING:
    from ...prolog.machine.resource_limits import Meter

MATCH_KINDS = ("event match", "match", "run", "run cursor")
"""Kinds of stored matches, see `ObjectFields`."""


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
        deadline: instant, in ns, at which an `AbsenceTimeout` emits it; unset in other operators.
        is_removed: whether the element has left its operator; containers with lazy deletion skip it.
    """

    __slots__ = ("match", "start", "end", "key_values", "key", "values", "order", "deadline", "is_removed")

    STATE = ObjectFields(
        "element",
        # A subscription's elements have the event itself.
        field("match", reference(*MATCH_KINDS, accepts=optional(TERM))),
        field("start", INSTANT),
        field("end", INSTANT, same_as="start"),
        field("key_values", sequence_of(MATCH_VALUE, tuple)),
        field("values", sequence_of(optional(TERM), tuple)),
        field("order", COUNT),
        constraint("a start before the end", lambda element: element.start <= element.end),
    )

    deadline: int

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

    def after_restore(self) -> None:
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
        omitted_count: number of older elements that contributed and are omitted, if elements are tracked.
    """

    elements: Tuple[StreamElement, ...]
    start: int
    end: int
    results: Values = ()
    error: Optional[RuleError] = None
    omitted_count: int = 0


def _element_type(channel: int) -> FieldType[StreamElement]:
    """Return the type of elements in the state of an operator."""
    reference_type = reference("element")

    def checker(context: ReadContext) -> ValueCheck[StreamElement]:
        check_reference, check_item = reference_type.checker(context), context.check_item
        objects = context.objects

        def check(value: object) -> StreamElement:
            element = check_reference(value)
            assert isinstance(element, StreamElement)
            # The owner of the operator knows the patterns that its elements match.
            check_item(element, channel)
            # Operators number and remove their elements.
            if objects is not None:
                objects.claim(element, check_item)
            return element

        return check

    return FieldType(f"an element of channel {channel}", checker, reference_type.encoder)


ELEMENT = _element_type(0)
ELEMENTS = sequence_of(ELEMENT)
FORBIDDEN_ELEMENTS = sequence_of(_element_type(1))


def have_distinct_orders(elements: Sequence[StreamElement], last_order: int) -> bool:
    """Return whether elements are distinct and have distinct orders from 1."""
    orders = {element.order for element in elements}
    return len(orders) == len(elements) and all(1 <= order <= last_order for order in orders)


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


def _no_time_limit() -> int:
    return 1 << 64


class StreamOperator(StateOwner):
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
        endless_skip_count: number of matches of a row pattern after which the search would begin at their own start.
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

    emits_stored_elements = True
    """True if an element that is stored may be emitted later, so that it has its match."""
    KEY_BYTES = 450
    """Memory of a key without its elements; measured with tracemalloc on CPython 3.11."""
    ELEMENT_BYTES = 450
    """Memory of an element with two small arguments; measured with tracemalloc on CPython 3.11."""

    def __init__(self) -> None:
        self.next_deadline: Optional[int] = None
        self.late_count = self.ahead_count = self.pruned_count = self.evicted_count = 0
        self.endless_skip_count = 0
        self.tracks_elements = False
        self.meter: Optional[Meter] = None
        self.compute_max_timestamp: Callable[[], int] = _no_time_limit
        self.set_bounds(KeyBounds())
        self.clock = self.max_timestamp = BEFORE_ALL_INSTANTS
        # Finding the first key of a plain dict takes time linear in the number of keys deleted before it.
        self.states: OrderedDict[Hashable, Any] = OrderedDict()

    def limit_time(self, compute_max_timestamp: Callable[[], int]) -> None:
        """Limit the ends that may advance the time of the stream; by default there is no limit."""
        self.compute_max_timestamp = compute_max_timestamp

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
        """Limit the last uses of keys to the clock; otherwise keys with later ones would never become idle."""
        for state in self.states.values():
            state.reference_time = min(state.reference_time, self.clock)

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
