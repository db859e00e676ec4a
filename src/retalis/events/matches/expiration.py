"""Expiry of waiting matches: queues ordered by the instants after which the matches go.

Matches that have left their buffers stay in these queues and heaps until they are the larger part. They are then
removed in slices, one for each match that is added, so that no event waits while all of them are visited.
"""

import heapq
from collections import deque
from typing import Callable, Deque, Dict, List, Optional, Tuple, TypeVar

from .partial_matches import PartialMatch

_SPARE = 1000

SLICE = 5000
"""Entries of a queue that are visited at once: about half a millisecond."""

HEAP_SLICE = SLICE // 10
"""Entries of a heap that are visited at once: each of them takes longer, as it is moved to another heap."""

VISITED_SLICE = 2000
"""Matches that are visited at once by a function of the caller."""

_EntryT = TypeVar("_EntryT")
_HeapEntry = Tuple[int, int, PartialMatch]


class _LateMatches:
    """Matches that were added out of order: a heap, which is replaced in slices when most of it has left.

    Attributes:
        heap: instant, order and match of those that were added since the replacement began, or were moved.
        rest: those of the former heap that were not moved yet; empty if no replacement is under way.
    """

    __slots__ = ("heap", "rest")

    def __init__(self) -> None:
        self.heap: List[_HeapEntry] = []
        self.rest: List[_HeapEntry] = []

    def __len__(self) -> int:
        return len(self.heap) + len(self.rest)

    def add(self, instant: int, match: PartialMatch) -> None:
        heapq.heappush(self.heap, (instant, match.order, match))

    def forget_gone(self, waiting: int) -> None:
        """Drop some of those that have left, if there are more of these than of the ``waiting`` ones."""
        rest = self.rest
        if not rest and len(self.heap) > waiting + _SPARE:
            self.heap, self.rest = rest, self.heap
            rest = self.rest
        for _ in range(min(HEAP_SLICE, len(rest))):
            entry = rest.pop()  # a heap without its last entry is a heap
            if entry[2].buffer is not None:
                heapq.heappush(self.heap, entry)

    def pop_before(self, clock: int) -> List[PartialMatch]:
        """Take out the matches whose instant is before ``clock``."""
        found = []
        for heap in (self.heap, self.rest):
            while heap and heap[0][0] < clock:
                found.append(heapq.heappop(heap)[2])
        return found

    def clear(self) -> None:
        self.heap.clear()
        self.rest.clear()


class ExpirationQueue:
    """Matches by the instants after which they go.

    Most are added in the order of their instants: those are a queue, and cost the same however many wait. The others
    are a heap.
    """

    __slots__ = ("_late", "_queue", "_visited")

    def __init__(self) -> None:
        self._queue: Deque[Tuple[int, PartialMatch]] = deque()
        self._visited = 0
        self._late = _LateMatches()

    def __len__(self) -> int:
        return len(self._queue) + len(self._late)

    def add(self, instant: int, match: PartialMatch, waiting: int) -> None:
        """Add a match.

        Args:
            instant: the last instant, in ns, at which it is to be there.
            match: the match, which waits.
            waiting: how many matches wait altogether; those that have left are dropped when they are the larger part.
        """
        queue = self._queue
        if not queue or queue[-1][0] <= instant:
            queue.append((instant, match))
        else:
            self._late.add(instant, match)
        if len(self) > 2 * waiting + _SPARE:
            start, entries = _take_slice(queue, self._visited, SLICE)
            left = [entry for entry in entries if entry[1].buffer is not None]
            self._visited = _put_slice(queue, start, left) or 0
            self._late.forget_gone(waiting)

    def expire(self, clock: int) -> None:
        """Let all leave whose instant is before ``clock``."""
        queue = self._queue
        while queue and queue[0][0] < clock:
            queue.popleft()[1].leave()
        for match in self._late.pop_before(clock):
            match.leave()

    def take(self, clock: int) -> List[PartialMatch]:
        """Take out all whose instant is before ``clock``; return those of them that still wait."""
        found = []
        queue = self._queue
        while queue and queue[0][0] < clock:
            found.append(queue.popleft()[1])
        found += self._late.pop_before(clock)
        return [match for match in found if match.buffer is not None]


class ByStart:
    """Matches that wait, by how long after their start they go.

    Most are added in the order of their starts: those of one span are a queue of nothing but the matches, and cost
    the same however many wait. The others are a heap.

    Its ``queue`` and its ``late`` stay the same objects: code has bound them.

    Attributes:
        span: how long after its start a match goes, for most of them, in ns; None where none goes.
        queue: the matches of that span.
        others: by other spans, the matches of those.
        late: those that were added out of order.
    """

    __slots__ = ("span", "queue", "others", "late", "_visited")

    def __init__(self, span: Optional[int]) -> None:
        self.span = span
        self.queue: Deque[PartialMatch] = deque()
        self.others: Dict[int, Deque[PartialMatch]] = {}
        self.late = _LateMatches()
        self._visited: Dict[Optional[int], int] = {}
        """By span: how many matches of its queue have been visited by `forget_gone`."""

    def __len__(self) -> int:
        return len(self.queue) + sum(len(queue) for queue in self.others.values()) + len(self.late)

    def reset(self, span: Optional[int]) -> None:
        """Begin anew, with another span for most."""
        self.span = span
        self.queue.clear()
        self.others.clear()
        self.late.clear()
        self._visited.clear()

    def of(self, span: int) -> Deque[PartialMatch]:
        """Return the queue of a span."""
        if span == self.span:
            return self.queue
        queue = self.others.get(span)
        if queue is None:
            queue = self.others[span] = deque()
        return queue

    def add(self, span: int, match: PartialMatch, waiting: int) -> None:
        """Add a match that waits; ``waiting`` is how many do altogether, see `ExpirationQueue.add`."""
        queue = self.of(span)
        if not queue or queue[-1].start <= match.start:
            queue.append(match)
        else:
            self.late.add(match.start + span, match)
        if len(self) > 2 * waiting + _SPARE:
            self.forget_gone(waiting)

    def forget_gone(self, waiting: int) -> None:
        """Drop some of those that have left; ``waiting`` is how many have not, altogether."""
        for span, queue in [(self.span, self.queue), *self.others.items()]:
            self._visited[span] = drop_gone(queue, self._visited.get(span, 0)) or 0
        self.late.forget_gone(waiting)

    def expire(self, clock: int) -> None:
        """Let all leave that go before ``clock``."""
        for span, queue in [(self.span, self.queue), *self.others.items()]:
            while queue and queue[0].start + (span or 0) < clock:
                queue.popleft().leave()
        for match in self.late.pop_before(clock):
            match.leave()


def drop_gone(
    matches: Deque[PartialMatch], start: int, visit: Optional[Callable[[PartialMatch], None]] = None
) -> Optional[int]:
    """Remove the matches that do not wait any more from a slice of a queue.

    Args:
        matches: the queue, whose order stays.
        start: where the slice begins.
        visit: called with each match of the slice that waits; the slice is a smaller one then.

    Returns:
        Where the next slice begins; None after the last one.
    """
    start, found = _take_slice(matches, start, SLICE if visit is None else VISITED_SLICE)
    waiting = [match for match in found if match.buffer is not None]
    following = _put_slice(matches, start, waiting)
    if visit is not None:
        for match in waiting:
            visit(match)
    return following


def _take_slice(entries: Deque[_EntryT], start: int, most: int) -> Tuple[int, List[_EntryT]]:
    """Rotate a queue so that it begins at ``start``, or at 0 past its end, and take entries out; see `_put_slice`."""
    if start >= len(entries):
        start = 0
    number = min(most, len(entries) - start)
    entries.rotate(-start)
    return start, [entries.popleft() for _ in range(number)]


def _put_slice(entries: Deque[_EntryT], start: int, left: List[_EntryT]) -> Optional[int]:
    """Put back what is left of a slice, and undo the rotation; return where the next one begins, None at the end."""
    is_last = len(entries) == start
    entries.extendleft(reversed(left))
    entries.rotate(start)
    return None if is_last else start + len(left)
