"""Expiry of waiting matches: queues ordered by the instants after which the matches go.

Matches that have left their buffers stay in these queues until they are the larger part. They are then removed in
slices, one for each match that is added, so that no event waits while a long queue is searched.
"""

import heapq
from collections import deque
from typing import Deque, Dict, List, Optional, Tuple, TypeVar

from .matches import Match

_SPARE = 1000

SLICE = 5000
"""Entries of a queue that are visited at once: about half a millisecond."""

_EntryT = TypeVar("_EntryT")


class Expiries:
    """Matches by the instants after which they go.

    Most are added in the order of their instants: those are a queue, and cost the same however many wait. The others
    are a heap.
    """

    __slots__ = ("_queue", "_heap", "_visited")

    def __init__(self) -> None:
        self._queue: Deque[Tuple[int, Match]] = deque()
        self._visited = 0
        self._heap: List[Tuple[int, int, Match]] = []

    def __len__(self) -> int:
        return len(self._queue) + len(self._heap)

    def add(self, instant: int, match: Match, waiting: int) -> None:
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
            heapq.heappush(self._heap, (instant, match.order, match))
        if len(self) > 2 * waiting + _SPARE:
            start, entries = _take_slice(queue, self._visited)
            left = [entry for entry in entries if entry[1].buffer is not None]
            self._visited = _put_slice(queue, start, left)
            if len(self._heap) > waiting + _SPARE:
                self._heap = [entry for entry in self._heap if entry[2].buffer is not None]
                heapq.heapify(self._heap)

    def expire(self, clock: int) -> None:
        """Let all leave whose instant is before ``clock``."""
        queue = self._queue
        while queue and queue[0][0] < clock:
            queue.popleft()[1].leave()
        heap = self._heap
        while heap and heap[0][0] < clock:
            heapq.heappop(heap)[2].leave()

    def take(self, clock: int) -> List[Match]:
        """Take out all whose instant is before ``clock``; return those of them that still wait."""
        found = []
        queue, heap = self._queue, self._heap
        while queue and queue[0][0] < clock:
            found.append(queue.popleft()[1])
        while heap and heap[0][0] < clock:
            found.append(heapq.heappop(heap)[2])
        return [match for match in found if match.buffer is not None]


class ByStart:
    """Matches that wait, by how long after their start they go.

    Most are added in the order of their starts: those of one span are a queue of nothing but the matches, and cost
    the same however many wait. The others are a heap.

    Its ``queue`` stays the same object: code has bound it.

    Attributes:
        span: how long after its start a match goes, for most of them, in ns; None where none goes.
        queue: the matches of that span.
        others: by other spans, the matches of those.
        heap: those that were added out of order, with their instants.
    """

    __slots__ = ("span", "queue", "others", "heap", "_visited")

    def __init__(self, span: Optional[int]) -> None:
        self.span = span
        self.queue: Deque[Match] = deque()
        self.others: Dict[int, Deque[Match]] = {}
        self.heap: List[Tuple[int, int, Match]] = []
        self._visited: Dict[Optional[int], int] = {}
        """By span: how many matches of its queue have been visited by `forget_gone`."""

    def __len__(self) -> int:
        return len(self.queue) + sum(len(queue) for queue in self.others.values()) + len(self.heap)

    def reset(self, span: Optional[int]) -> None:
        """Begin anew, with another span for most."""
        self.span = span
        self.queue.clear()
        self.others.clear()
        self.heap.clear()
        self._visited.clear()

    def of(self, span: int) -> Deque[Match]:
        """Return the queue of a span."""
        if span == self.span:
            return self.queue
        queue = self.others.get(span)
        if queue is None:
            queue = self.others[span] = deque()
        return queue

    def add(self, span: int, match: Match, waiting: int) -> None:
        """Add a match that waits; ``waiting`` is how many do altogether, see `Expiries.add`."""
        queue = self.of(span)
        if not queue or queue[-1].start <= match.start:
            queue.append(match)
        else:
            heapq.heappush(self.heap, (match.start + span, match.order, match))
        if len(self) > 2 * waiting + _SPARE:
            self.forget_gone(waiting)

    def forget_gone(self, waiting: int) -> None:
        """Drop some of those that have left; ``waiting`` is how many have not, altogether."""
        for span, queue in [(self.span, self.queue), *self.others.items()]:
            self._visited[span] = drop_gone(queue, self._visited.get(span, 0))
        if len(self.heap) > waiting + _SPARE:
            self.heap = [entry for entry in self.heap if entry[2].buffer is not None]
            heapq.heapify(self.heap)

    def expire(self, clock: int) -> None:
        """Let all leave that go before ``clock``."""
        for span, queue in [(self.span, self.queue), *self.others.items()]:
            while queue and queue[0].start + (span or 0) < clock:
                queue.popleft().leave()
        heap = self.heap
        while heap and heap[0][0] < clock:
            heapq.heappop(heap)[2].leave()


def drop_gone(matches: Deque[Match], start: int) -> int:
    """Remove the matches that do not wait any more from a slice of a queue.

    Args:
        matches: the queue, whose order stays.
        start: where the slice begins; the queue begins anew at its end.

    Returns:
        Where the next slice begins.
    """
    start, found = _take_slice(matches, start)
    return _put_slice(matches, start, [match for match in found if match.buffer is not None])


def _take_slice(entries: Deque[_EntryT], start: int) -> Tuple[int, List[_EntryT]]:
    """Rotate a queue so that it begins at ``start``, or at 0 past its end, and take entries out; see `_put_slice`."""
    if start >= len(entries):
        start = 0
    number = min(SLICE, len(entries) - start)
    entries.rotate(-start)
    return start, [entries.popleft() for _ in range(number)]


def _put_slice(entries: Deque[_EntryT], start: int, left: List[_EntryT]) -> int:
    """Put back what is left of a slice, and undo the rotation; return where the next slice begins."""
    is_last = len(entries) == start
    entries.extendleft(reversed(left))
    entries.rotate(start)
    return (
        0 if is_last else start + len(left)
    )  # entries before the last slice may have left since their visit
