"""Rate operators: stream operators that pass some of the matches of a pattern.

They correspond to operators of ReactiveX: `Throttle` to throttleFirst, with ``is_debounce`` to a debounce on the
leading edge, `Debounce` to debounce, and `DistinctUntilChanged` to the operator of that name. `RATE_OPERATORS` is the
table of those that the event language has.
"""

import heapq
from collections import OrderedDict
from typing import Callable, Dict, Hashable, List, NamedTuple, Sequence, Tuple

from ...prolog.terms.term_traversal import SELF_KEYED, term_key
from ...serialization.state_fields import StateFields, constraint, field, rows_of
from ...serialization.stored_field_types import COUNT, INSTANT
from .stream_operators import (
    ELEMENT,
    ELEMENTS,
    DeadlineOperator,
    StreamElement,
    StreamOperator,
    StreamOutput,
    have_distinct_orders,
    push_element,
)


class Throttle(StreamOperator):
    """Operator that passes an element if the previous one of its key ended at least ``span`` ns earlier.

    Args:
        span: the time in ns.
        is_debounce: whether blocked elements extend the time, so that only the first element of each burst passes.
    """

    STATE = StateFields(
        field("clock", INSTANT),
        field("stored_elements", ELEMENTS),
    )

    emits_stored_elements = False

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

    @property
    def stored_elements(self) -> List[StreamElement]:
        """The last element of each key."""
        return list(self.states.values())

    @stored_elements.setter
    def stored_elements(self, elements: Sequence[StreamElement]) -> None:
        self.states.clear()
        self._by_end = []
        for element in elements:
            self._store(element)


class _LastValue:
    """Last value of a key, the element that introduced it, and the clock at the last element."""

    __slots__ = ("value", "element", "reference_time")

    def __init__(self, value: Hashable, element: StreamElement, reference_time: int):
        self.value = value
        self.element = element
        self.reference_time = reference_time


class LastElement(NamedTuple):
    """Stored form of a `_LastValue`.

    Attributes:
        reference_time: clock at the last element of the key.
        element: the element that introduced the value.
    """

    reference_time: int
    element: StreamElement


class DistinctUntilChanged(StreamOperator):
    """Operator that passes the elements of a key whose value differs from the previous one.

    Args:
        passes_first: whether it passes the first element of a key.
    """

    STATE = StateFields(
        field(
            "last_elements",
            rows_of(
                LastElement,
                reference_time=INSTANT,
                element=ELEMENT,
            ),
        ),
    )

    emits_stored_elements = False
    KEY_BYTES, ELEMENT_BYTES = 950, 0

    def __init__(self, passes_first: bool = True):
        super().__init__()
        self.passes_first = passes_first

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
        if state is None and not self.passes_first:
            return []
        return [StreamOutput((element,), element.start, element.end)]

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._limit_reference_times()

    def _store(self, value: Hashable, element: StreamElement) -> None:
        self.states[element.key] = _LastValue(value, element, self.clock)
        if len(self.states) > self._max_keys:
            self._evict_keys()

    @property
    def last_elements(self) -> List[LastElement]:
        """The last value of each key, the least recently used key first."""
        return [LastElement(state.reference_time, state.element) for state in self.states.values()]

    @last_elements.setter
    def last_elements(self, last_elements: Sequence[LastElement]) -> None:
        self.states.clear()
        for self.clock, element in last_elements:
            self._store(term_key(element.values[0]), element)


class Debounce(DeadlineOperator):
    """Operator that emits an element ``span`` ns after its end if no later element of its key has arrived by then.

    Several elements of one key can be pending if their ends are ahead of the clock and at least ``span`` ns apart.
    """

    STATE = StateFields(
        field("_order", COUNT),
        field("_latest_now", INSTANT),
        field("pending_elements", ELEMENTS),
        constraint(
            "elements with distinct orders",
            lambda operator, state: have_distinct_orders(state["pending_elements"], state["order"]),
        ),
    )

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

    @property
    def pending_elements(self) -> List[StreamElement]:
        """The pending elements in order of arrival."""
        pending = [element for elements in self.pending.values() for element in elements]
        return sorted(pending, key=lambda element: element.order)

    @pending_elements.setter
    def pending_elements(self, elements: Sequence[StreamElement]) -> None:
        self.pending, self._deadlines, self._pending_count = {}, [], 0
        for element in elements:
            self._add_pending(element)
        self._update_deadline()


class RateOperator(NamedTuple):
    """A rate operator of the event language.

    Attributes:
        notation: its notations in words, with and without a key.
        takes_seconds: whether the first argument is a number of seconds; if not, it is the value that must change.
        create: creates the operator, given its time in ns, which is 0 without seconds.
        is_delayed: whether it emits matches when a time is over, and not when they arrive.
        block_reason: why it passes no match, with a place for its time in seconds.
    """

    notation: str
    takes_seconds: bool
    create: Callable[[int], StreamOperator]
    is_delayed: bool
    block_reason: str


RATE_OPERATORS: Dict[str, RateOperator] = {
    "throttle": RateOperator(
        notation="throttle(Seconds) or throttle(Seconds, Key)",
        takes_seconds=True,
        create=lambda span: Throttle(span, False),
        is_delayed=False,
        block_reason="the last one was let through less than {0} seconds before",
    ),
    "burst": RateOperator(
        notation="burst(Seconds) or burst(Seconds, Key)",
        takes_seconds=True,
        create=lambda span: Throttle(span, True),
        is_delayed=False,
        block_reason="there was another one less than {0} seconds before",
    ),
    "debounce": RateOperator(
        notation="debounce(Seconds) or debounce(Seconds, Key)",
        takes_seconds=True,
        create=Debounce,
        is_delayed=True,
        block_reason="the {0} seconds after the last one are not over",
    ),
    "change": RateOperator(
        notation="change(Value) or change(Value, Key)",
        takes_seconds=False,
        create=lambda span: DistinctUntilChanged(),
        is_delayed=False,
        block_reason="nothing changed",
    ),
    "change_after_first": RateOperator(
        notation="change_after_first(Value) or change_after_first(Value, Key)",
        takes_seconds=False,
        create=lambda span: DistinctUntilChanged(passes_first=False),
        is_delayed=False,
        block_reason="nothing changed since the first one",
    ),
}
"""Rate operators by name. The parser, the compiler and explanations read this table."""
