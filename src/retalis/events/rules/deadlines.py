"""When nodes are to be woken: one alarm of the clock for all of them, at the earliest of their instants."""

import heapq
from itertools import count
from typing import Any, List, Tuple

from ..network import Woken

_FEW = 64
_BEFORE_ALL = -1
"""The order of its alarm among those of the same instant."""

_Deadline = Tuple[int, int, int, int, Woken]
"""An instant, which rule and which of its nodes, the order in which it was asked for, and the node."""


class Deadlines:
    """The instants for which nodes have asked.

    At one instant the nodes of older rules ring first, and of one rule those that stand further right or below. Each
    rings by itself: where the limits of one are met, or its goals raise an error, the others ring all the same.

    Args:
        rules: of the program.
    """

    def __init__(self, rules: Any):
        self._rules = rules
        self._heap: List[_Deadline] = []
        self._numbers = count()
        self._most = _FEW
        self._armed: List[int] = []

    def clear(self) -> None:
        """Forget all: the clock has begun anew, without the alarm that was set."""
        self._heap = []
        self._armed = []

    def __len__(self) -> int:
        """Return how many instants are remembered, those that nobody asks for any more included.

        They are never more than twice as many as nodes wait, and some.
        """
        return len(self._heap)

    def add(self, node: Woken, instant: int) -> None:
        """Have a node ring at an instant."""
        heapq.heappush(self._heap, (instant, node.rule.serial, node.place, next(self._numbers), node))
        if len(self._heap) > self._most:
            self._drop_all_not_wanted()
        self._arm()

    def _arm(self) -> None:
        """Have the clock call at the earliest instant, before all alarms that are set for it.

        An alarm that was set for a later one stays and is not set again.
        """
        self._drop_those_not_wanted()
        heap, armed = self._heap, self._armed
        if heap and (not armed or heap[0][0] < armed[0]):
            heapq.heappush(armed, heap[0][0])
            self._rules.clock.put_back(heap[0][0], _BEFORE_ALL, self._ring)

    def _drop_those_not_wanted(self) -> None:
        """Drop from the top what its node, or nobody any more, asks for: it wants to be woken earlier by now."""
        heap = self._heap
        while heap and not _is_wanted(heap[0]):
            heapq.heappop(heap)

    def _drop_all_not_wanted(self) -> None:
        """Drop all that no node asks for, or asks for once more."""
        wanted = {id(entry[-1]): entry for entry in self._heap if _is_wanted(entry)}
        self._heap = list(wanted.values())
        heapq.heapify(self._heap)
        self._most = 2 * len(self._heap) + _FEW

    def _ring(self, instant: int) -> None:
        """Have the first node ring that is due, and set the next alarm."""
        while self._armed and self._armed[0] <= instant:
            heapq.heappop(self._armed)
        self._drop_those_not_wanted()
        heap = self._heap
        try:
            if heap and heap[0][0] <= instant:
                at, *_, node = heapq.heappop(heap)
                node.woken = None
                if node.rule.active:  # else it is woken anew where its rule is connected again
                    machine = self._rules.logic.machine
                    self._rules.dispatcher.apart(lambda: machine.run(node.ring(at, machine.done)))
        finally:
            self._arm()


def _is_wanted(entry: _Deadline) -> bool:
    return entry[-1].woken == entry[0]
