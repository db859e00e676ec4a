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

    Attributes:
        queue: instants and matches, in the order of both.
        heap: those that were added out of order.
    """

    __slots__ = ("queue", "heap")

    def __init__(self) -> None:
        self.queue: Deque[Tuple[int, Match]] = deque()
        self.heap: List[Tuple[int, int, Match]] = []

    def __len__(self) -> int:
        return len(self.queue) + len(self.heap)

    def add(self, instant: int, match: Match, waiting: int) -> None:
        """Add a match.

        Args:
            instant: the last instant, in ns, at which it is to be there.
            match: the match, which waits.
            waiting: how many matches wait altogether; those that have left are dropped when they are the larger part.
        """
        queue = self.queue
        if not queue or queue[-1][0] <= instant:
            queue.append((instant, match))
        else:
            heapq.heappush(self.heap, (instant, match.order, match))
        if len(self) > 2 * waiting + _SPARE:
            self.forget_gone()

    def forget_gone(self) -> None:
        """Drop those that have left."""
        self.queue = deque(entry for entry in self.queue if entry[1].buffer is not None)
        self.heap = [entry for entry in self.heap if entry[2].buffer is not None]
        heapq.heapify(self.heap)

    def expire(self, clock: int) -> None:
        """Let all leave whose instant is before ``clock``."""
        queue = self.queue
        while queue and queue[0][0] < clock:
            queue.popleft()[1].leave()
        heap = self.heap
        while heap and heap[0][0] < clock:
            heapq.heappop(heap)[2].leave()

    def take(self, clock: int) -> List[Match]:
        """Take out all whose instant is before ``clock``; return those of them that still wait."""
        found = []
        queue, heap = self.queue, self.heap
        while queue and queue[0][0] < clock:
            found.append(queue.popleft()[1])
        while heap and heap[0][0] < clock:
            found.append(heapq.heappop(heap)[2])
        return [match for match in found if match.buffer is not None]
