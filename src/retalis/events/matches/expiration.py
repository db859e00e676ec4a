"""Expiration of stored matches: retention times, and queues of matches ordered by the instant of their removal.

Drools Fusion calls this inferred event expiration: a match leaves its buffer when the rule's clock shows that no
result can contain it. A rule such as ``(a seq b) within 10`` can discard an ``a`` ten seconds after its start,
because no later ``b`` completes the pattern in time. The compiler derives one `Retention` per operand from the
``within`` bounds above it.

Two cases differ. If events arrive in order, a bound on the whole pattern is also a bound on the time for which an
operand is stored. If ``out_of_order`` is on, the first operand of a sequence may arrive after the second one. Negated
matches (``cnot``, ``fnot``) must then be stored longer than positive ones: they may still rule out a pair whose first
operand is late.

Matches usually arrive in the order of their expiration, so a deque is enough: appending and
expiring cost the same for any number of stored matches. Matches that arrive out of order go to a heap.

A match may leave its buffer earlier, for example because it is consumed. Removing it from the middle of a queue
would be slow, so its entry stays, and is skipped when it expires. If such stale entries are the larger part of a
queue, they are removed in slices, one slice for each match that is added. No event therefore has to wait until a
queue of a million entries has been visited.
"""

import heapq
from collections import deque
from typing import Callable, Deque, Dict, List, NamedTuple, Optional, Tuple, TypeVar

from .match_types import PartialMatch


class Retention(NamedTuple):
    """Retention times of one operand, in ns: the smallest interval bounds above it; None for no bound.

    Attributes:
        in_order: if the first operands of sequences never arrive late.
        out_of_order: if they may arrive late.
        max_interval: the longest interval of a useful match, for a pattern that is a part of the rule's match; None
            also for a negated pattern.
    """

    in_order: Optional[int] = None
    out_of_order: Optional[int] = None
    max_interval: Optional[int] = None

    def within(self, span: Optional[int]) -> "Retention":
        """Return the retention below a ``within`` of ``span`` nanoseconds, or this one if there is no bound."""
        if span is None:
            return self
        return Retention(
            smaller_bound(self.in_order, span),
            smaller_bound(self.out_of_order, span),
            smaller_bound(self.max_interval, span),
        )

    def of_negated(self, span: Optional[int]) -> "Retention":
        """Return the retention of a pattern that is negated between two operands.

        Args:
            span: the longest time in ns that the two operands can span together; None if unbounded.
        """
        return Retention(self.in_order, retention_for_late(span, self.out_of_order))


UNLIMITED = Retention()


def smaller_bound(first: Optional[int], second: Optional[int]) -> Optional[int]:
    """Return the smaller of two bounds; None counts as infinity."""
    if first is None:
        return second
    return first if second is None else min(first, second)


def retention_for_late(span: Optional[int], retention: Optional[int]) -> Optional[int]:
    """Return the retention of a negated match if the first operand may arrive late; None means forever.

    Args:
        span: the longest time in ns that the two operands can span together; None if unbounded.
        retention: retention time of the second operand in ns; None if unbounded.
    """
    # The second operand may be stored for `retention` until the late first operand arrives and opens the gap. The gap
    # then reaches back up to `span` from the end of the second operand.
    return None if span is None or retention is None else span + retention


_STALE_TOLERANCE = 1000
"""Stale entries that are tolerated in addition to the number of stored matches."""

SLICE_ENTRIES = 5000
"""Entries of a queue that are visited at a time: about half a millisecond."""

HEAP_SLICE_ENTRIES = SLICE_ENTRIES // 10
"""Entries of a heap that are visited at a time; each takes longer, because it is moved to another heap."""

VISITED_SLICE_ENTRIES = 2000
"""Matches that are visited at a time by a function of the caller."""

_EntryT = TypeVar("_EntryT")
_HeapEntry = Tuple[int, int, PartialMatch]


class _LateHeap:
    """Matches that were added out of order: a heap, which is rebuilt in slices when most of its entries are stale.

    Attributes:
        heap: instant, order and match of the entries that were added or moved since the rebuild began.
        unmoved: entries of the former heap that have not been moved yet; empty if no rebuild is in progress.
    """

    __slots__ = ("heap", "unmoved")

    def __init__(self) -> None:
        self.heap: List[_HeapEntry] = []
        self.unmoved: List[_HeapEntry] = []

    def __len__(self) -> int:
        return len(self.heap) + len(self.unmoved)

    def add(self, instant: int, match: PartialMatch) -> None:
        heapq.heappush(self.heap, (instant, match.order, match))

    def remove_stale(self, stored_count: int) -> None:
        """Remove some stale entries if there are more entries than ``stored_count`` matches and the tolerance."""
        unmoved = self.unmoved
        if not unmoved and len(self.heap) > stored_count + _STALE_TOLERANCE:
            self.heap, self.unmoved = unmoved, self.heap
            unmoved = self.unmoved
        for _ in range(min(HEAP_SLICE_ENTRIES, len(unmoved))):
            # A heap without its last entry is still a heap, so `pop_before` may read `unmoved` between two slices.
            entry = unmoved.pop()
            if entry[2].buffer is not None:
                heapq.heappush(self.heap, entry)

    def pop_before(self, clock: int) -> List[PartialMatch]:
        """Remove and return the matches whose instant is before ``clock``."""
        expired = []
        for heap in (self.heap, self.unmoved):
            while heap and heap[0][0] < clock:
                expired.append(heapq.heappop(heap)[2])
        return expired

    def clear(self) -> None:
        self.heap.clear()
        self.unmoved.clear()


class ExpirationQueue:
    """Matches ordered by the instants after which they are removed.

    Matches that are added in the order of their instants form a queue; the others form a heap.
    """

    __slots__ = ("_late_heap", "_queue", "_next_slice_start")

    def __init__(self) -> None:
        self._queue: Deque[Tuple[int, PartialMatch]] = deque()
        self._next_slice_start = 0
        self._late_heap = _LateHeap()

    def __len__(self) -> int:
        return len(self._queue) + len(self._late_heap)

    def add(self, instant: int, match: PartialMatch, stored_count: int) -> None:
        """Add a match.

        Args:
            instant: the last instant, in ns, at which the match is stored.
            match: the match, which is in a buffer.
            stored_count: number of stored matches in total; stale entries are removed if they outnumber these by
                more than `_STALE_TOLERANCE`.
        """
        queue = self._queue
        if not queue or queue[-1][0] <= instant:
            queue.append((instant, match))
        else:
            self._late_heap.add(instant, match)
        if len(self) > 2 * stored_count + _STALE_TOLERANCE:
            start, entries = _remove_slice(queue, self._next_slice_start, SLICE_ENTRIES)
            stored = [entry for entry in entries if entry[1].buffer is not None]
            self._next_slice_start = _insert_slice(queue, start, stored) or 0
            self._late_heap.remove_stale(stored_count)

    def expire(self, clock: int) -> None:
        """Remove all matches whose instant is before ``clock`` from their buffers."""
        queue = self._queue
        while queue and queue[0][0] < clock:
            queue.popleft()[1].discard()
        for match in self._late_heap.pop_before(clock):
            match.discard()

    def pop_expired(self, clock: int) -> List[PartialMatch]:
        """Remove the entries whose instant is before ``clock``; return those matches that are still stored."""
        expired = []
        queue = self._queue
        while queue and queue[0][0] < clock:
            expired.append(queue.popleft()[1])
        expired += self._late_heap.pop_before(clock)
        return [match for match in expired if match.buffer is not None]


class StartExpirationQueue:
    """Stored matches ordered by start and retention time.

    Most matches of a rule have one retention time, and arrive in the order of their starts. These form a queue that
    contains only the matches: the instant of expiration follows from the start. Matches with another retention time
    have a queue of their own, and matches that are added out of order go to a heap.

    Generated code binds ``queue`` and ``late_heap``, so these attributes are never assigned again.

    Attributes:
        retention: retention time of most matches after their start, in ns; None if none expire.
        other_queues: the matches with other retention times, by retention time.
        late_heap: the matches that were added out of order.
    """

    __slots__ = ("retention", "queue", "other_queues", "late_heap", "_next_slice_start")

    def __init__(self, retention: Optional[int]) -> None:
        self.retention = retention
        self.queue: Deque[PartialMatch] = deque()
        self.other_queues: Dict[int, Deque[PartialMatch]] = {}
        self.late_heap = _LateHeap()
        self._next_slice_start: Dict[Optional[int], int] = {}
        """By retention time: the position in the queue at which the next slice begins."""

    def __len__(self) -> int:
        return len(self.queue) + sum(len(queue) for queue in self.other_queues.values()) + len(self.late_heap)

    def reset(self, retention: Optional[int]) -> None:
        """Remove all entries and set the retention time of most matches."""
        self.retention = retention
        self.queue.clear()
        self.other_queues.clear()
        self.late_heap.clear()
        self._next_slice_start.clear()

    def queue_for(self, retention: int) -> Deque[PartialMatch]:
        """Return the queue of a retention time."""
        if retention == self.retention:
            return self.queue
        queue = self.other_queues.get(retention)
        if queue is None:
            queue = self.other_queues[retention] = deque()
        return queue

    def add(self, retention: int, match: PartialMatch, stored_count: int) -> None:
        """Add a stored match.

        Args:
            retention: its retention time after its start, in ns.
            match: the match.
            stored_count: number of stored matches in total; see `ExpirationQueue.add`.
        """
        queue = self.queue_for(retention)
        if not queue or queue[-1].start <= match.start:
            queue.append(match)
        else:
            self.late_heap.add(match.start + retention, match)
        if len(self) > 2 * stored_count + _STALE_TOLERANCE:
            self.remove_stale(stored_count)

    def remove_stale(self, stored_count: int) -> None:
        """Remove some stale entries; ``stored_count`` is the number of stored matches in total."""
        for retention, queue in [(self.retention, self.queue), *self.other_queues.items()]:
            self._next_slice_start[retention] = (
                remove_stale_entries(queue, self._next_slice_start.get(retention, 0)) or 0
            )
        self.late_heap.remove_stale(stored_count)

    def expire(self, clock: int) -> None:
        """Remove all matches that expire before ``clock`` from their buffers."""
        for retention, queue in [(self.retention, self.queue), *self.other_queues.items()]:
            while queue and queue[0].start + (retention or 0) < clock:
                queue.popleft().discard()
        for match in self.late_heap.pop_before(clock):
            match.discard()


def remove_stale_entries(
    matches: Deque[PartialMatch], start: int, visit: Optional[Callable[[PartialMatch], None]] = None
) -> Optional[int]:
    """Remove the entries whose matches are not stored any more from a slice of a queue.

    Args:
        matches: the queue; its order does not change.
        start: position at which the slice begins.
        visit: called with each stored match of the slice; the slice then has `VISITED_SLICE_ENTRIES` entries instead
            of `SLICE_ENTRIES`.

    Returns:
        The position at which the next slice begins; None after the last slice.
    """
    start, entries = _remove_slice(matches, start, SLICE_ENTRIES if visit is None else VISITED_SLICE_ENTRIES)
    stored = [match for match in entries if match.buffer is not None]
    next_start = _insert_slice(matches, start, stored)
    if visit is not None:
        # The queue is complete again before the calls: they may remove matches, which must find a consistent queue.
        for match in stored:
            visit(match)
    return next_start


def _remove_slice(entries: Deque[_EntryT], start: int, max_count: int) -> Tuple[int, List[_EntryT]]:
    """Rotate a queue so that it begins at ``start`` and remove up to ``max_count`` entries; see `_insert_slice`.

    A ``start`` past the end of the queue means its beginning.
    """
    if start >= len(entries):
        start = 0
    count = min(max_count, len(entries) - start)
    # A deque cannot be sliced; rotating it moves pointers only, and costs much less than building a new queue.
    entries.rotate(-start)
    return start, [entries.popleft() for _ in range(count)]


def _insert_slice(entries: Deque[_EntryT], start: int, remaining: List[_EntryT]) -> Optional[int]:
    """Put the remaining entries of a slice back and undo the rotation; return the next position, None at the end."""
    is_last = len(entries) == start
    entries.extendleft(reversed(remaining))
    entries.rotate(start)
    return None if is_last else start + len(remaining)
