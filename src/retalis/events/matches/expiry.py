"""When waiting matches are to go."""

import heapq
from collections import deque
from typing import Deque, List, Tuple

from .matches import Match

_SPARE = 1000


class Expiries:
    """Matches by the instants after which they go.

    Most are added in the order of their instants: those are a queue, and cost the same however many wait. The others
    are a heap.
    """

    __slots__ = ("_queue", "_heap")

    def __init__(self) -> None:
        self._queue: Deque[Tuple[int, Match]] = deque()
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
            self._queue = deque(entry for entry in queue if entry[1].buffer is not None)
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
