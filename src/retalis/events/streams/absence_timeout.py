"""Absence with a timeout: an element is emitted if no forbidden element follows within a span of time.

This operator implements ``P seq absent(Q, Seconds)``. Each match of P becomes a pending element with a deadline
``span`` ns after its end. A match of Q cancels the pending elements that it correlates with and lies after. If the
deadline passes first, the pending element is emitted.

Events may arrive out of order, so forbidden elements are stored as well: one that arrived before the pending element
may still lie after it in time. They are dropped when their start lies more than ``span`` ns before the clock. For the
common case of complete correlation by a key, a forbidden element is dropped earlier if its neighbours in time cancel
every pending element that it would cancel (see `_ForbiddenElements`).
"""

import heapq
from typing import Any, Callable, Dict, Hashable, Iterator, List, NamedTuple, Optional, Tuple

from .stream_operator import NEVER, KeyedOperator, OperatorState, StreamElement, StreamOutput

_SMALL_QUEUE = 32
"""Length up to which a list is compacted at every removal."""


class Correlation(NamedTuple):
    """Correlation of pending and forbidden elements.

    Attributes:
        key: returns the values that a match shares with the other channel, given the match and its channel; None if
            these contain variables, so that all elements must be compared.
        cancels: returns whether a forbidden match that lies in the span cancels a pending match.
        key_is_sufficient: whether equal keys without variables are sufficient to cancel.
        replacement_key: returns a key under which a new match replaces a pending one; None if no match replaces
            another.
    """

    key: Callable[[Any, int], Hashable]
    cancels: Callable[[Any, Any], bool]
    key_is_sufficient: bool
    replacement_key: Optional[Callable[[Any], Hashable]]


class _ForbiddenElements:
    """Forbidden elements of one key, without those that are made redundant by their neighbours."""

    __slots__ = ("items", "number", "newest")

    def __init__(self) -> None:
        # The list may contain dropped elements, see `count_removal`.
        self.items: List[StreamElement] = []
        self.number = 0
        self.newest = NEVER

    def add(self, item: StreamElement, span: int, may_thin: bool) -> List[StreamElement]:
        """Add an element, and return the elements that it makes redundant."""
        items = self.items
        # A bound for quick rejection; it need not shrink when elements are dropped.
        self.newest = max(self.newest, item.start)
        if may_thin and len(items) > 1:
            first, middle = items[-2], items[-1]
            rising = first.start <= middle.start <= item.start and first.end <= middle.end <= item.end
            # Three elements with rising starts and ends, within one span: every pending element that the middle one
            # cancels is also cancelled by the first or the last one.
            if rising and item.end - first.start < span and not (first.is_removed or middle.is_removed):
                items[-1] = item
                return [middle]
        items.append(item)
        self.number += 1
        return []

    def count_removal(self) -> None:
        """Count an element that was dropped; long lists are compacted only if half of them was dropped."""
        self.number -= 1
        if self.number < _SMALL_QUEUE or len(self.items) > 2 * self.number:
            self.items = [item for item in self.items if not item.is_removed]


class AbsenceTimeout(KeyedOperator):
    """Operator that emits an element ``span`` ns after its end unless a forbidden element lies wholly in between.

    The `StreamElement.key` of a pending element is a pair: its correlation key, and its name among the pending
    elements of that key. For a forbidden element it is the correlation key alone.

    Args:
        span: time in ns without a forbidden element.
        correlation: correlation of pending and forbidden elements.
    """

    def __init__(self, span: int, correlation: Correlation):
        super().__init__()
        self.span = span
        self.correlation = correlation
        self._pending: Dict[Hashable, Dict[Hashable, StreamElement]] = {}
        self._forbidden: Dict[Hashable, _ForbiddenElements] = {}
        self._number = 0
        self._latest_now = NEVER
        self._deadlines: List[Tuple[int, int, StreamElement]] = []
        self._by_start: List[Tuple[int, int, StreamElement]] = []
        self._order = 0

    KEY_BYTES, ITEM_BYTES = 300, 1100

    def __len__(self) -> int:
        return self._number

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
            while self._by_start[0][2].is_removed:
                heapq.heappop(self._by_start)
            self._drop_forbidden_before(self._by_start[0][0])
        return []

    def process(self, item: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        if now > self._latest_now:
            # The maximum, because an alarm may raise an event in the past, after elements of that time were dropped.
            self._latest_now = now
        # A pending element ends after ``reached - span``, or its deadline has passed. A forbidden element must start
        # after that end, so older ones are useless.
        self._drop_forbidden_before(self._latest_now - self.span)
        self._order += 1
        item.order = self._order
        key = self.correlation.key(item.match, channel)
        if channel:
            self._cancel_pending(item, key)
            self._store_forbidden(item, key)
        # The deadline has passed: forbidden elements that would cancel this element may have been dropped already.
        elif item.end + self.span <= self._latest_now:
            self.late_count += 1
        else:
            self._replace(item, key)
            if not self._is_cancelled(item, key):
                self._add_pending(item)
        self._update_deadline()
        return []

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        outputs = []
        while self.next_deadline is not None and self.next_deadline <= instant:
            due, _, item = self._deadlines[0]
            self._drop_pending(item)
            outputs.append(StreamOutput((item,), item.start, due))
            self._update_deadline()
        return outputs

    def snapshot(self) -> OperatorState:
        """See `StreamOperator.snapshot`."""
        pending = [item for _, _, item in self._deadlines if not item.is_removed]
        forbidden = [item for _, _, item in self._by_start if not item.is_removed]
        return (self._order, self._latest_now, sorted(pending, key=_order), sorted(forbidden, key=_order))

    def restore(self, saved: OperatorState) -> None:
        """See `StreamOperator.restore`."""
        self._order, self._latest_now, pending, forbidden = saved
        self._pending, self._forbidden, self._deadlines, self._by_start, self._number = {}, {}, [], [], 0
        for item in [*pending, *forbidden]:
            # Keys are not part of the saved state: they follow from the values.
            item.restore_key()
        for item in pending:
            self._replace(item, self.correlation.key(item.match, 0))
            self._add_pending(item)
        for item in forbidden:
            self._store_forbidden(item, self.correlation.key(item.match, 1))
        self._update_deadline()

    def _replace(self, item: StreamElement, key: Hashable) -> None:
        """Set the key of an element, and drop the pending element that it replaces."""
        make_key = self.correlation.replacement_key
        replacement_key = item.order if make_key is None else make_key(item.match)
        item.key = (key, replacement_key)
        replaced = self._pending.get(key, {}).get(replacement_key)
        if replaced is not None:
            self._drop_pending(replaced)

    def _add_pending(self, item: StreamElement) -> None:
        key: Any = item.key
        self._pending.setdefault(key[0], {})[key[1]] = item
        self._number += 1
        _push(self._deadlines, item.end + self.span, item, self._number)

    def _drop_pending(self, item: StreamElement) -> None:
        item.is_removed = True
        key: Any = item.key
        pending = self._pending[key[0]]
        del pending[key[1]]
        if not pending:
            del self._pending[key[0]]
        self._number -= 1

    def _update_deadline(self) -> None:
        """Remove dropped elements from the top of the heap, and set the next deadline."""
        while self._deadlines and self._deadlines[0][2].is_removed:
            heapq.heappop(self._deadlines)
        self.next_deadline = self._deadlines[0][0] if self._deadlines else None

    def _cancel_pending(self, forbidden: StreamElement, key: Hashable) -> None:
        """Drop all pending elements that a forbidden one cancels."""
        pending = list(self._candidates(key))
        if self.meter is not None:
            # The work is counted before the loop: an interrupt within it would leave cancelled elements pending.
            self.meter(len(pending))
        for item in pending:
            if self._lies_after(forbidden, item):
                self._drop_pending(item)

    def _candidates(self, key: Hashable) -> Iterator[StreamElement]:
        # A key of None may correlate with every key, so elements without a key are candidates for each search.
        for candidate_key in list(self._pending) if key is None else [key, None]:
            yield from self._pending.get(candidate_key, {}).values()

    def _is_cancelled(self, item: StreamElement, key: Hashable) -> bool:
        """Return whether a forbidden element that has arrived earlier cancels an element."""
        keys = list(self._forbidden) if key is None else [key, None]
        forbidden_groups = [
            self._forbidden[candidate_key] for candidate_key in keys if candidate_key in self._forbidden
        ]
        if self.meter is not None:
            self.meter(sum(len(group.items) for group in forbidden_groups))
        return any(
            self._lies_after(forbidden, item)
            for group in forbidden_groups
            if group.newest > item.end
            for forbidden in group.items
            if not forbidden.is_removed
        )

    def _lies_after(self, forbidden: StreamElement, item: StreamElement) -> bool:
        if not (item.end < forbidden.start and forbidden.end < item.end + self.span):
            return False
        correlation = self.correlation
        key: Any = item.key
        # The candidates were found by their key, so equality needs no further test.
        if correlation.key_is_sufficient and key is not None and forbidden.key is not None:
            return True
        return correlation.cancels(item.match, forbidden.match)

    def _store_forbidden(self, item: StreamElement, key: Hashable) -> None:
        item.key = key
        group = self._forbidden.setdefault(key, _ForbiddenElements())
        may_thin = self.correlation.key_is_sufficient and key is not None
        self._number += 1
        for redundant in group.add(item, self.span, may_thin):
            redundant.is_removed = True
            self._number -= 1
        _push(self._by_start, item.start, item, self._number)

    def _drop_forbidden_before(self, limit: int) -> None:
        """Drop the forbidden elements that started too long ago to cancel a pending one."""
        while self._by_start and self._by_start[0][0] <= limit:
            item = heapq.heappop(self._by_start)[2]
            if not item.is_removed:
                item.is_removed = True
                self._number -= 1
                group = self._forbidden[item.key]
                group.count_removal()
                if not group.number:
                    del self._forbidden[item.key]


def _order(item: StreamElement) -> int:
    return item.order


def _push(heap: List[Tuple[int, int, StreamElement]], instant: int, item: StreamElement, number: int) -> None:
    """Push an element on a heap, and compact the heap if more than half of it was dropped."""
    heapq.heappush(heap, (instant, item.order, item))
    if len(heap) > 2 * number + 64:
        heap[:] = [entry for entry in heap if not entry[2].is_removed]
        heapq.heapify(heap)
