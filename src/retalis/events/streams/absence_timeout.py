"""Absence with a timeout: an element is emitted if no forbidden element follows within a span of time.

This operator implements ``P seq absent(Q, Seconds)``. Each match of P becomes a pending element with a deadline
``span`` ns after its end. A match of Q cancels the pending elements that it correlates with and lies after. If the
deadline passes first, the pending element is emitted. `ComputedAbsenceTimeout` takes the time from each match of P.

Events may arrive out of order, so forbidden elements are stored as well: one that arrived before the pending element
may still lie after it in time. They are dropped when their start lies ``span`` ns or more before the latest
``now`` of `AbsenceTimeout.process`. For the common case of complete correlation by a key, a forbidden element is
dropped earlier if its neighbours in time cancel every pending element that it would cancel (see
`_ForbiddenElements`).

`NotPrecededFilter` implements ``P with not_preceded(Q, Seconds)``, the absence before an element.
"""

import heapq
from bisect import bisect_left, insort
from operator import attrgetter
from typing import Any, Callable, Dict, Hashable, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS, SECOND
from ...serialization.state_fields import StateFields, constraint, field
from ...serialization.stored_field_types import COUNT, INSTANT
from .stream_operators import (
    ELEMENTS,
    FORBIDDEN_ELEMENTS,
    DeadlineOperator,
    ElementHeap,
    StreamElement,
    StreamOperator,
    StreamOutput,
    have_distinct_orders,
    push_element,
)

_MAX_ALWAYS_COMPACTED = 32
"""Length up to which a list is compacted at every removal."""


COMPUTED_TIMEOUT_RETENTION_NANOSECONDS = 10 * SECOND
"""Time for which forbidden elements are stored for late elements, if each element has its own timeout."""


class Correlation(NamedTuple):
    """Correlation of pending and forbidden elements.

    Attributes:
        key_of: returns the values that a match of a channel shares with the other channel, given the match and the
            channel; None if these contain variables, so that all elements must be compared.
        cancels: returns whether a forbidden match that lies in the span cancels a pending match.
        key_is_sufficient: whether equal keys without variables are sufficient to cancel.
        replacement_key_of: returns a key under which a later match replaces an earlier one; None if no match
            replaces another.
    """

    key_of: Callable[[Any, int], Hashable]
    cancels: Callable[[Any, Any], bool]
    key_is_sufficient: bool
    replacement_key_of: Optional[Callable[[Any], Hashable]]


class _ForbiddenElements:
    """Forbidden elements of one key in order of arrival, without those that their neighbours make redundant."""

    __slots__ = ("elements", "element_count", "latest_start")

    def __init__(self) -> None:
        # The list may contain dropped elements, see `count_removal`.
        self.elements: List[StreamElement] = []
        self.element_count = 0
        self.latest_start = BEFORE_ALL_INSTANTS

    def add(self, element: StreamElement, span: int, drops_redundant: bool) -> List[StreamElement]:
        """Add an element, and return the elements that it makes redundant."""
        elements = self.elements
        # An upper bound, by which `_is_cancelled` skips the key; it need not shrink when elements are dropped.
        self.latest_start = max(self.latest_start, element.start)
        if drops_redundant and len(elements) > 1:
            first, middle = elements[-2], elements[-1]
            is_in_order = (
                first.start <= middle.start <= element.start and first.end <= middle.end <= element.end
            )
            # Three elements with increasing starts and ends, within one span: every pending element that the middle
            # one cancels is also cancelled by the first or the last one.
            if (
                is_in_order
                and element.end - first.start < span
                and not (first.is_removed or middle.is_removed)
            ):
                elements[-1] = element
                return [middle]
        elements.append(element)
        self.element_count += 1
        return []

    def count_removal(self) -> None:
        """Count an element that was dropped; compact a long list only if half of its elements were dropped."""
        self.element_count -= 1
        if self.element_count < _MAX_ALWAYS_COMPACTED or len(self.elements) > 2 * self.element_count:
            self.elements = [element for element in self.elements if not element.is_removed]


class AbsenceTimeout(DeadlineOperator):
    """Operator that emits an element ``span`` ns after its end unless a forbidden element lies strictly in between.

    The `StreamElement.key` of a pending element is a pair: its correlation key, and either its replacement key with
    the number of its slot of time or its arrival number. For a forbidden element it is the correlation key alone.

    Of two elements with one replacement key that end less than ``span`` ns apart, the later one replaces the earlier
    one, in whichever order they arrive. An element whose deadline the other does not precede is complete, and only
    waits for forbidden elements that arrive late.

    Args:
        span: time in ns without a forbidden element.
        correlation: correlation of pending and forbidden elements.
    """

    STATE = StateFields(
        field("_order", COUNT),
        field("_latest_now", INSTANT),
        field("pending_elements", ELEMENTS),
        field("forbidden_elements", FORBIDDEN_ELEMENTS),
        constraint(
            "elements with distinct orders",
            lambda operator, state: have_distinct_orders(
                [*state["pending_elements"], *state["forbidden_elements"]], state["order"]
            ),
        ),
    )

    # Measured as in `StreamOperator`.
    KEY_BYTES, ELEMENT_BYTES = 300, 1100

    def __init__(self, span: int, correlation: Correlation):
        super().__init__(span)
        self.correlation = correlation
        self._min_span = self._forbidden_retention = span
        self._pending: Dict[Hashable, Dict[Hashable, StreamElement]] = {}
        self._forbidden: Dict[Hashable, _ForbiddenElements] = {}
        self._stored_count = 0
        self._forbidden_by_start: ElementHeap = []

    def _span_of(self, element: StreamElement) -> int:
        """Return the time in ns from the end of an element to its deadline."""
        return self.span

    def __len__(self) -> int:
        return self._stored_count

    @property
    def keys(self) -> int:
        """See `StreamOperator.keys`."""
        return len(self._pending) + len(self._forbidden)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`; pending elements are dropped before forbidden ones."""
        self._update_deadline()
        if self._deadlines:
            self._drop_pending(self._deadlines[0][2])
            self._update_deadline()
        else:
            while self._forbidden_by_start[0][2].is_removed:
                heapq.heappop(self._forbidden_by_start)
            self._drop_forbidden_before(self._forbidden_by_start[0][0])
        return []

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        if not channel:
            # May raise an error, so it precedes all changes of the state.
            element.deadline = element.end + self._span_of(element)
        if now > self._latest_now:
            # The maximum, because an alarm may raise an event in the past, after elements of that time were dropped.
            self._latest_now = now
        # A pending element ends after `_latest_now - span`; otherwise its deadline has passed. A forbidden element
        # must start after that end, so older ones are useless.
        self._drop_forbidden_before(self._latest_now - self._forbidden_retention)
        self._order += 1
        element.order = self._order
        key = self.correlation.key_of(element.match, channel)
        if channel:
            element.key = key
            self._cancel_pending(element, key)
            self._store_forbidden(element, key)
        # The deadline has passed: forbidden elements that would cancel this element may have been dropped already.
        elif element.deadline <= self._latest_now:
            self.late_count += 1
        else:
            is_replaced = self._set_pending_key(element, key)
            if not is_replaced and not self._is_cancelled(element, key):
                self._add_pending(element)
        self._update_deadline()
        return []

    @property
    def pending_elements(self) -> List[StreamElement]:
        """The pending elements in order of arrival."""
        return sorted(
            [element for _, _, element in self._deadlines if not element.is_removed], key=attrgetter("order")
        )

    @pending_elements.setter
    def pending_elements(self, elements: Sequence[StreamElement]) -> None:
        self._pending, self._deadlines = {}, []
        self._stored_count = sum(forbidden.element_count for forbidden in self._forbidden.values())
        for element in elements:
            element.deadline = element.end + self._span_of(element)
            self._set_pending_key(element, self.correlation.key_of(element.match, 0))
            self._add_pending(element)
        self._update_deadline()

    @property
    def forbidden_elements(self) -> List[StreamElement]:
        """The forbidden elements in order of arrival."""
        return sorted(
            [element for _, _, element in self._forbidden_by_start if not element.is_removed],
            key=attrgetter("order"),
        )

    @forbidden_elements.setter
    def forbidden_elements(self, elements: Sequence[StreamElement]) -> None:
        self._forbidden, self._forbidden_by_start = {}, []
        self._stored_count = sum(map(len, self._pending.values()))
        for element in elements:
            element.key = self.correlation.key_of(element.match, 1)
            self._store_forbidden(element, element.key)

    def _set_pending_key(self, element: StreamElement, key: Hashable) -> bool:
        """Set the key of an element and drop the pending ones that it replaces.

        Returns:
            Whether a pending element that ends later replaces it.
        """
        replacement_key_of = self.correlation.replacement_key_of
        if replacement_key_of is None:
            element.key = (key, element.order)
            return False
        # Pending elements of one replacement key are at least a span apart, so each has a slot of that length of its
        # own, and all that replace each other lie in neighbouring slots.
        span = element.deadline - element.end
        replacement_key, slot = replacement_key_of(element.match), element.end // span
        element.key = (key, (replacement_key, slot))
        pending = self._pending.get(key, {})
        is_replaced = False
        for neighbour_slot in (slot - 1, slot, slot + 1):
            neighbour = pending.get((replacement_key, neighbour_slot))
            if neighbour is None or abs(neighbour.end - element.end) >= span:
                continue
            # The order of the ends decides, not that of arrival.
            if neighbour.end <= element.end:
                self._drop_pending(neighbour)
            else:
                is_replaced = True
        return is_replaced

    def _add_pending(self, element: StreamElement) -> None:
        key: Any = element.key
        self._pending.setdefault(key[0], {})[key[1]] = element
        self._stored_count += 1
        push_element(self._deadlines, element.deadline, element, self._stored_count)

    def _drop_pending(self, element: StreamElement) -> None:
        element.is_removed = True
        key: Any = element.key
        pending = self._pending[key[0]]
        del pending[key[1]]
        if not pending:
            del self._pending[key[0]]
        self._stored_count -= 1

    def _cancel_pending(self, forbidden: StreamElement, key: Hashable) -> None:
        """Drop all pending elements that a forbidden one cancels."""
        pending = list(self._find_candidates(key))
        if self.meter is not None:
            # Counted before the loop: a limit that stopped it would leave cancelled elements pending.
            self.meter(len(pending))
        for element in pending:
            if self._cancels(forbidden, element):
                self._drop_pending(element)

    def _find_candidates(self, key: Hashable) -> Iterator[StreamElement]:
        # A key of None may correlate with every key, so elements without a key are candidates for each search.
        for candidate_key in list(self._pending) if key is None else [key, None]:
            yield from self._pending.get(candidate_key, {}).values()

    def _is_cancelled(self, element: StreamElement, key: Hashable) -> bool:
        """Return whether a forbidden element that has arrived earlier cancels an element."""
        keys = list(self._forbidden) if key is None else [key, None]
        forbidden_groups = [
            self._forbidden[candidate_key] for candidate_key in keys if candidate_key in self._forbidden
        ]
        if self.meter is not None:
            self.meter(sum(len(forbidden_elements.elements) for forbidden_elements in forbidden_groups))
        return any(
            self._cancels(forbidden, element)
            for forbidden_elements in forbidden_groups
            if forbidden_elements.latest_start > element.end
            for forbidden in forbidden_elements.elements
            if not forbidden.is_removed
        )

    def _cancels(self, forbidden: StreamElement, element: StreamElement) -> bool:
        """Return whether a forbidden element lies in the span after another element and correlates with it."""
        if not (element.end < forbidden.start and forbidden.end < element.deadline):
            return False
        correlation = self.correlation
        pending_key: Any = element.key
        # The candidates were found by their key, so equal keys need no further test. A key of None is no such key: it
        # stands for values with variables.
        if correlation.key_is_sufficient and pending_key[0] is not None and forbidden.key is not None:
            return True
        return correlation.cancels(element.match, forbidden.match)

    def _store_forbidden(self, element: StreamElement, key: Hashable) -> None:
        forbidden_elements = self._forbidden.setdefault(key, _ForbiddenElements())
        drops_redundant = self.correlation.key_is_sufficient and key is not None
        self._stored_count += 1
        for redundant in forbidden_elements.add(element, self._min_span, drops_redundant):
            redundant.is_removed = True
            self._stored_count -= 1
        push_element(self._forbidden_by_start, element.start, element, self._stored_count)

    def _drop_forbidden_before(self, min_start: int) -> None:
        """Drop the forbidden elements that started too long ago to cancel a pending one."""
        while self._forbidden_by_start and self._forbidden_by_start[0][0] <= min_start:
            element = heapq.heappop(self._forbidden_by_start)[2]
            if not element.is_removed:
                element.is_removed = True
                self._stored_count -= 1
                forbidden_elements = self._forbidden[element.key]
                forbidden_elements.count_removal()
                if not forbidden_elements.element_count:
                    del self._forbidden[element.key]


class ComputedAbsenceTimeout(AbsenceTimeout):
    """Absence with a timeout that each element determines.

    The longest time of later elements is unknown, so forbidden elements are stored for
    `COMPUTED_TIMEOUT_RETENTION_NANOSECONDS`, and none of them makes others redundant.

    Args:
        correlation: correlation of pending and forbidden elements.
        span_of: returns the time of a match in ns.

    Raises:
        RuleError: by ``span_of``, if the match has no valid time.
    """

    def __init__(self, correlation: Correlation, span_of: Callable[[Any], int]):
        super().__init__(0, correlation)
        self._forbidden_retention = COMPUTED_TIMEOUT_RETENTION_NANOSECONDS
        self._span_of_match = span_of

    def _span_of(self, element: StreamElement) -> int:
        return self._span_of_match(element.match)


MIN_FORBIDDEN_RETENTION_NANOSECONDS = 60 * SECOND
"""Time for which `NotPrecededFilter` stores elements longer than its span, for elements that last or arrive late."""

_StoredElement = Tuple[int, int, StreamElement]


class NotPrecededFilter(StreamOperator):
    """Operator that passes an element if no forbidden one has ended less than ``span`` ns before its start.

    Forbidden elements are stored until no element that may still arrive starts within the span after them: for the
    span and the longest useful element, at least for `MIN_FORBIDDEN_RETENTION_NANOSECONDS`.

    Args:
        span: the time in ns.
        max_length: longest element, in ns; 0 if unknown.
    """

    STATE = StateFields(
        field("_order", COUNT),
        field("clock", INSTANT),
        field("forbidden_elements", FORBIDDEN_ELEMENTS),
        constraint(
            "elements with distinct orders",
            lambda operator, state: have_distinct_orders(state["forbidden_elements"], state["order"]),
        ),
    )

    # Measured as in `StreamOperator`.
    KEY_BYTES, ELEMENT_BYTES = 300, 1000

    def __init__(self, span: int, max_length: int, correlation: Correlation):
        super().__init__()
        self.span = span
        self.max_length = max_length
        self.correlation = correlation
        self._order = 0
        self._by_end: List[_StoredElement] = []
        self._by_key: Dict[Hashable, List[_StoredElement]] = {}

    def __len__(self) -> int:
        return len(self._by_end)

    @property
    def keys(self) -> int:
        """See `StreamOperator.keys`."""
        return len(self._by_key)

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`."""
        self._drop_first()
        return []

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        self._advance(element.end)
        useful_length = max(self.max_length, self._max_span or 0, MIN_FORBIDDEN_RETENTION_NANOSECONDS)
        max_end = self.clock - self.span - useful_length
        while self._by_end and self._by_end[0][0] <= max_end:
            self._drop_first()
        key = self.correlation.key_of(element.match, channel)
        if channel:
            self._order += 1
            element.order = self._order
            self._store(element, key)
            return []
        return (
            [] if self._is_preceded(element, key) else [StreamOutput((element,), element.start, element.end)]
        )

    @property
    def forbidden_elements(self) -> List[StreamElement]:
        """The forbidden elements in order of arrival."""
        return sorted([element for _, _, element in self._by_end], key=attrgetter("order"))

    @forbidden_elements.setter
    def forbidden_elements(self, elements: Sequence[StreamElement]) -> None:
        self._by_end, self._by_key = [], {}
        for element in elements:
            self._store(element, self.correlation.key_of(element.match, 1))

    def _store(self, element: StreamElement, key: Hashable) -> None:
        element.key = key
        entry = (element.end, element.order, element)
        heapq.heappush(self._by_end, entry)
        insort(self._by_key.setdefault(key, []), entry)

    def _drop_first(self) -> None:
        """Drop the forbidden element that ended first, which is also the first one of its key."""
        key = heapq.heappop(self._by_end)[2].key
        entries = self._by_key[key]
        del entries[0]
        if not entries:
            del self._by_key[key]

    def _is_preceded(self, element: StreamElement, key: Hashable) -> bool:
        # A key of None may correlate with every key.
        keys = list(self._by_key) if key is None else [key, None]
        start, min_end = element.start, element.start - self.span
        for candidate_key in keys:
            entries = self._by_key.get(candidate_key, [])
            position = bisect_left(entries, (start,)) - 1
            is_sufficient = (
                self.correlation.key_is_sufficient and key is not None and candidate_key is not None
            )
            while position >= 0 and entries[position][0] > min_end:
                if self.meter is not None and self.meter(1):
                    # Pattern work is stopped: an element that may be preceded must not pass.
                    return True
                if is_sufficient or self.correlation.cancels(element.match, entries[position][2].match):
                    return True
                position -= 1
        return False
