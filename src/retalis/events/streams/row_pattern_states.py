"""Computation states of row patterns, and the shared buffer of the elements of their matches.

The elements of the matches of a partition are in a shared buffer of `SharedBufferNode`, as in SASE: matches share the
nodes of a common beginning, and a match that begins later shares the nodes of an earlier one while both assign the
same steps. Memory and snapshots grow with the number of nodes and states instead of the lengths of all matches.
"""

from bisect import bisect_left
from collections import deque
from operator import attrgetter, itemgetter
from typing import Deque, Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple

from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS
from ...prolog.terms.types import Values
from .row_pattern_automaton import NavigationTargets
from .stream_operators import StreamElement

StepAssignments = Tuple[Tuple[StreamElement, int], ...]
"""Elements with the steps that accepted them."""


class SharedBufferNode:
    """Node of the shared buffer of a partition: an element, its step, and the node of the element before it.

    A match is a last node and the order of its first element. The nodes before that element belong to matches that
    began earlier.
    """

    __slots__ = ("element", "step", "previous")

    def __init__(self, element: StreamElement, step: int, previous: "Optional[SharedBufferNode]"):
        self.element = element
        self.step = step
        self.previous = previous


class CompletedMatch(NamedTuple):
    """Completed match that waits until no preferred state is left.

    Attributes:
        matched: node of its last element.
        start_order: order of its first element.
    """

    matched: SharedBufferNode
    start_order: int


class ComputationState:
    """Computation state: one assignment of the elements so far to steps.

    Attributes:
        step: position of the step of the last element.
        count: number of elements of that step, capped by `RowPatternNFA.capped_count`.
        remaining_steps: after a skipped element, the positions that can still accept one; otherwise None.
        totals: states of the aggregates.
        matched: node of the last element of the match; None if no match has started.
        start_order: order of its first element.
        start_time: start of the first element in ns.
    """

    __slots__ = (
        "step",
        "count",
        "remaining_steps",
        "targets",
        "totals",
        "matched",
        "start_order",
        "start_time",
    )

    def __init__(
        self,
        step: int,
        count: int,
        remaining_steps: Optional[Tuple[int, ...]],
        targets: NavigationTargets,
        totals: Values,
        matched: Optional[SharedBufferNode],
        start_order: int,
        start_time: int,
    ):
        self.step = step
        self.count = count
        self.remaining_steps = remaining_steps
        self.targets = targets
        self.totals = totals
        self.matched = matched
        self.start_order = start_order
        self.start_time = start_time

    def key(self, count_class: Hashable) -> Hashable:
        """Return a key that is equal for states with the same future; ``count_class`` is the class of its count."""
        return (
            self.step,
            count_class,
            self.remaining_steps,
            # An element is equal to itself only.
            self.targets,
            self.totals,
        )


class StoredNode(NamedTuple):
    """Stored form of a `SharedBufferNode`.

    Attributes:
        element: order of the element.
        step: number of its step.
        previous: index of the previous node, which is smaller than its own; None if no stored match uses it.
    """

    element: int
    step: int
    previous: Optional[int]


class StoredState(NamedTuple):
    """Stored form of a `ComputationState`, which refers to elements by their order.

    Attributes:
        step, element_count, remaining_steps, totals: as in `ComputationState`; `element_count` is ``count`` there.
        targets: order of the element of each navigation, or None if there is none yet.
        last_node: index of the node of the last element of the match; None if no match has started.
        start_order: order of the first element; 0 if no match has started.
    """

    step: int
    element_count: int
    remaining_steps: Optional[Tuple[int, ...]]
    targets: Tuple[Optional[int], ...]
    totals: Values
    last_node: Optional[int]
    start_order: int


class StoredMatch(NamedTuple):
    """Stored form of a `CompletedMatch`.

    Attributes:
        last_node: index of the node of its last element.
        start_order: order of its first element.
    """

    last_node: int
    start_order: int


class StoredPartition(NamedTuple):
    """Stored form of a `PartitionState`.

    Attributes:
        reference_time: the clock at its last element.
        nodes: the nodes of its shared buffer that a state or match uses, each after its previous one.
        states: its computation states in order of preference.
        completed: the waiting matches in the order of their starts.
    """

    reference_time: int
    elements: List[StreamElement]
    nodes: List[StoredNode]
    states: List[StoredState]
    completed: List[StoredMatch]


class PartitionState:
    """State of one partition: its computation states, waiting matches, and the elements that they use.

    A completed match drops all less preferred states of its start, so all states of its start are preferred to it.

    Attributes:
        elements: elements that a state or match uses, and all elements since the oldest of them.
        states: the computation states in order of preference.
        completed: waiting matches in the order of their starts, at most one for each start.
        counted_state_count: number of states that the window has counted for this partition.
        reference_time: the clock at its last element.
    """

    __slots__ = (
        "elements",
        "states",
        "completed",
        "counted_state_count",
        "reference_time",
        "_dropped_element_count",
    )

    def __init__(self, states: List[ComputationState]):
        self.elements: Deque[StreamElement] = deque()
        self.states = states
        self.counted_state_count = 0
        self.reference_time = BEFORE_ALL_INSTANTS
        self.completed: Deque[CompletedMatch] = deque()
        # Number of elements that have been dropped since `release_nodes` has released their nodes.
        self._dropped_element_count = 0

    def first_start(self) -> Optional[int]:
        """Return the order of the first element of the most preferred state; None if no match has begun.

        States and waiting matches begin no earlier, once the decided matches have been removed.
        """
        state = self.states[0]
        return None if state.matched is None else state.start_order

    def replace_completed(
        self, settled_starts: Sequence[int], matches: Sequence[CompletedMatch], drops_later: bool
    ) -> None:
        """Drop the waiting matches of some starts, and add matches of the same starts.

        Args:
            settled_starts: the starts; at most one if ``drops_later``.
            matches: the matches to add, at most one for each start.
            drops_later: whether the waiting matches of later starts are dropped, too.
        """
        if not settled_starts:
            return
        if drops_later:
            while self.completed and self.completed[-1].start_order >= settled_starts[0]:
                self.completed.pop()
            self.completed.extend(matches)
            return
        # One pass for all starts, because each element may replace the matches of many starts.
        settled = set(settled_starts)
        remaining = [match for match in self.completed if match.start_order not in settled]
        self.completed = deque(sorted([*remaining, *matches], key=attrgetter("start_order")))

    def drop_before(self, order: int) -> None:
        """Drop the states and waiting matches that began before the element with an order."""
        self.states = [state for state in self.states if state.matched is None or state.start_order >= order]
        while self.completed and self.completed[0].start_order < order:
            self.completed.popleft()

    def drop_elements_before(self, order: int) -> int:
        """Drop the elements before the one with an order; return their number.

        Elements are dropped in order of arrival; those between used ones stay until the oldest use ends.
        """
        count = len(self.elements)
        while self.elements[0].order < order:
            self.elements.popleft()
        count -= len(self.elements)
        self._dropped_element_count += count
        return count

    def matches(self) -> List[Tuple[SharedBufferNode, int]]:
        """Return the last node and the order of the first element of all partial and waiting matches."""
        partial = [(state.matched, state.start_order) for state in self.states if state.matched is not None]
        return [*partial, *self.completed]

    def release_nodes(self) -> None:
        """Release the nodes of dropped elements, if there are many.

        To be called before an element is processed: matches that an element has decided still use these nodes.
        """
        # All nodes are visited once for as many dropped elements as there are others. On average, this takes no more
        # time than the successors of the states.
        if self._dropped_element_count <= len(self.elements):
            return
        self._dropped_element_count = 0
        order = self.elements[0].order
        visited = set()
        for last_node, _ in self.matches():
            node: Optional[SharedBufferNode] = last_node
            while node is not None and id(node) not in visited:
                visited.add(id(node))
                if node.previous is not None and node.previous.element.order < order:
                    node.previous = None
                node = node.previous


def list_assignments(last_node: SharedBufferNode, start_order: int) -> StepAssignments:
    """Return the elements of a match with their steps, the oldest first."""
    assignments = []
    node: Optional[SharedBufferNode] = last_node
    while node is not None and node.element.order >= start_order:
        assignments.append((node.element, node.step))
        node = node.previous
    return tuple(reversed(assignments))


def stored_partition(partition: PartitionState) -> StoredPartition:
    """Return the stored form of a partition, in which each used node occurs once."""
    nodes: List[StoredNode] = []
    indices: Dict[int, int] = {}
    # The nodes of a match are a part of those of each match that has the same last node and began earlier.
    for last_node, start_order in sorted(partition.matches(), key=itemgetter(1)):
        new_nodes = []
        node: Optional[SharedBufferNode] = last_node
        while node is not None and id(node) not in indices and node.element.order >= start_order:
            new_nodes.append(node)
            node = node.previous
        previous = None if node is None else indices.get(id(node))
        for node in reversed(new_nodes):
            nodes.append(StoredNode(node.element.order, node.step, previous))
            previous = indices[id(node)] = len(indices)
    states = [
        StoredState(
            state.step,
            state.count,
            state.remaining_steps,
            tuple([None if element is None else element.order for element in state.targets]),
            state.totals,
            None if state.matched is None else indices[id(state.matched)],
            state.start_order,
        )
        for state in partition.states
    ]
    completed = [StoredMatch(indices[id(node)], start_order) for node, start_order in partition.completed]
    return StoredPartition(partition.reference_time, list(partition.elements), nodes, states, completed)


def are_paths(nodes: Sequence[StoredNode], matches: Sequence[Tuple[int, int]]) -> bool:
    """Return whether nodes refer to older ones, and the path of each match, from its last node, contains its start.

    Args:
        nodes: stored nodes of a partition.
        matches: index of the last node and order of the first element of each match.
    """
    starts: List[List[int]] = [[] for _ in nodes]
    for last_node, start_order in matches:
        if last_node >= len(nodes):
            return False
        starts[last_node].append(start_order)
    next_nodes: List[List[int]] = [[] for _ in nodes]
    unvisited, depths = [], []
    for index, (order, _, previous) in enumerate(nodes):
        if previous is None:
            depths.append(0)
            unvisited.append(index)
        elif previous < index and nodes[previous].element < order:
            depths.append(depths[previous] + 1)
            next_nodes[previous].append(index)
        else:
            return False
    # A depth-first search over all paths takes linear time; one walk for each match would not.
    path: List[int] = []
    while unvisited:
        index = unvisited.pop()
        path[depths[index] :] = [nodes[index].element]
        for start_order in starts[index]:
            position = bisect_left(path, start_order)
            if position == len(path) or path[position] != start_order:
                return False
        unvisited += next_nodes[index]
    return True
