"""Elements, outputs and the common protocol of stream operators, and the keyed state that they share.

An operator partitions its elements by key and holds one state per key. `KeyedOperator` bounds these states by time
and by number. Keys are ordered by their last use, so idle keys are found at the front. Dropping them takes
constant time per event on average, because each key is dropped once.
"""

from collections import OrderedDict
from typing import Any, Callable, Hashable, List, NamedTuple, Optional, Protocol, Tuple

from ...foundation.errors import RuleError
from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.term_traversal import SELF_KEYED, term_key
from ...prolog.terms.types import Values


class StreamElement:
    """Match in a stream.

    Attributes:
        match: the match, if it is emitted or tracked.
        start: start of its interval in ns.
        end: end of its interval in ns.
        by: values of the key terms.
        key: hashable form of ``by``.
        values: processed values: one per measure of a window, or the value that may change.
        order: number in the order of arrival.
        is_removed: whether the element has left its operator; containers with lazy deletion skip it.
    """

    __slots__ = ("match", "start", "end", "by", "key", "values", "order", "is_removed")

    def __init__(self, match: Any, start: int, end: int, by: Values, values: Tuple[Any, ...]):
        self.match = match
        self.start = start
        self.end = end
        self.by = by
        self.values = values
        self.order = 0
        self.is_removed = False
        if len(by) == 1:
            # Plain terms are their own keys, which saves a call for the most frequent case, one key term.
            single = by[0]
            self.key: Hashable = single if single.__class__ in SELF_KEYED else term_key(single)
        else:
            self.key = tuple([term_key(value) for value in by])

    def restore_key(self) -> None:
        """Mark the element as present, and compute its key from ``by``."""
        self.is_removed = False
        by = self.by
        self.key = term_key(by[0]) if len(by) == 1 else tuple([term_key(value) for value in by])


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
"""State of an operator as numbers, terms, elements and lists of them."""
NEVER = -(1 << 63)
"""Instant before all others."""


class KeyBounds(NamedTuple):
    """Bounds for the states of keys.

    Attributes:
        span: longest interval of an output that can be used, in ns; None for no bound.
        idle: time in ns after which a key without a new element is dropped; None for no bound.
        keys: maximum number of keys.
    """

    span: Optional[int] = None
    idle: Optional[int] = None
    keys: int = 1 << 62


class StreamOperator(Protocol):
    """Stream operator: a state machine that takes elements and instants, and returns outputs.

    An operator has no access to rules, events and their dispatch. It is deterministic: the same elements and instants
    give the same outputs. Revision relies on this: when an event is retracted, the operator is run again without it.

    Attributes:
        next_deadline: instant at which `advance_to` has an output; None if only elements cause outputs.
        late_count: number of elements that arrived too late.
        pruned_count: number of partial matches of a row pattern that were discarded because too many had the same
            start.
        evicted_count: number of keys that were dropped because there were too many.
        bounds: bounds for the states of keys.
        keys: number of keys with a state.
        bytes: estimated memory of the states, in bytes: numbers of keys and elements times measured constants.
        tracked: whether outputs contain up to 100 of the elements that they are made of, not only the newest one.
        meter: counts visited elements as pattern work; None if nothing is counted.
        compute_max_timestamp: returns the latest end that may advance the time of the stream.
    """

    next_deadline: Optional[int]
    late_count: int
    pruned_count: int
    evicted_count: int
    bounds: KeyBounds
    tracked: bool
    meter: Optional[Meter]
    compute_max_timestamp: Callable[[], int]

    @property
    def keys(self) -> int:
        """Number of keys with a state."""

    @property
    def bytes(self) -> int:
        """Estimated memory of the states, in bytes."""

    def set_bounds(self, bounds: KeyBounds, /) -> None:
        """Set the bounds for the states of keys from the next element on."""

    def process(self, element: StreamElement, now: int, channel: int, /) -> List[StreamOutput]:
        """Process an element and return the outputs.

        Args:
            element: the element.
            now: the present time of the clock in ns.
            channel: 0, or 1 for elements that must not occur.

        Raises:
            RuleError: if a value cannot be measured; the state is unchanged in this case.
        """

    def advance_to(self, instant: int, /) -> List[StreamOutput]:
        """Return the outputs that are due when the clock reaches an instant."""

    def __len__(self) -> int:
        """Return the number of stored elements or keys."""

    def drop_oldest(self) -> List[StreamOutput]:
        """Drop the oldest element or key, and return the outputs that this causes."""

    def snapshot(self) -> OperatorState:
        """Return the state; see `restore`."""

    def restore(self, saved: OperatorState, /) -> None:
        """Set the state to one that an equal operator returned from `snapshot`."""


class KeyedOperator:
    """Base class of stream operators: the stream clock, and the states of keys with their bounds.

    See `StreamOperator`.

    Attributes:
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
        self.late_count = self.pruned_count = self.evicted_count = 0
        self.tracked = False
        self.meter: Optional[Meter] = None
        self.compute_max_timestamp: Callable[[], int] = lambda: 1 << 64
        self.set_bounds(KeyBounds())
        self.clock = self.max_timestamp = NEVER
        # Finding the first key of a plain dict takes time linear in the number of keys deleted before it.
        self.states: OrderedDict[Hashable, Any] = OrderedDict()

    def set_bounds(self, bounds: KeyBounds) -> None:
        """See `StreamOperator.set_bounds`."""
        self.bounds = bounds
        # Local copies, read for each element.
        self._max_span, self._idle, self._max_keys = bounds

    def __len__(self) -> int:
        return len(self.states)

    @property
    def keys(self) -> int:
        """See `StreamOperator.keys`."""
        return len(self.states)

    @property
    def bytes(self) -> int:
        """See `StreamOperator.bytes`."""
        return self.keys * self.KEY_BYTES + len(self) * self.ELEMENT_BYTES

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        return []

    def _is_too_far_ahead(self, end: int) -> bool:
        """Return whether an end is too far in the future to advance the time of the stream."""
        # ``compute_max_timestamp`` reads the clock and only rises, so it is called only if its last result is not
        # sufficient.
        if end > self.max_timestamp:
            self.max_timestamp = self.compute_max_timestamp()
        return end > self.max_timestamp

    def _advance(self, end: int) -> None:
        # `max_timestamp` is tested first, which avoids a call in the usual case.
        if self.clock < end and (end <= self.max_timestamp or not self._is_too_far_ahead(end)):
            self.clock = end

    def _drop_idle_keys(self) -> None:
        """Drop the keys whose last use is too long ago."""
        if self._idle is None:
            return
        states, min_reference_time = self.states, self.clock - self._idle
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
