"""Index of stored matches by time, and time bounds of join partners.

An operator such as ``during`` or a ``within`` bound limits where the partners of a match can lie in time (an
interval join). If many stored matches have the same key but few lie within the limits, a scan in order of arrival is
slow. `IntervalIndex` finds the matches whose start and end lie within given limits, newest or oldest first.

The index is a B+ tree with the keys (instant, other instant, order of arrival). One of the two instants is chosen as
the sort key. As in a priority search tree, each node also stores the smallest and largest other instant and order
below it, so a search skips subtrees that contain no result. Subtrees are visited best-first by order of arrival,
using a heap; each result costs O(log n) if at least one instant is bounded on one side.

`interval_bounds` derives the limits from the comparisons that define an operator and from the maximum span.
"""

import gc
import heapq
from bisect import bisect_left, bisect_right, insort
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Tuple

from ...foundation.codegen import shared_function
from ..language.event_operators import PAIR_OPERATORS, EventOperator
from .match_types import PartialMatch

TimeBounds = Tuple[int, int, int, int]
"""Smallest and largest start, smallest and largest end; all inclusive."""

MIN_VALUE, MAX_VALUE = -(1 << 80), 1 << 80
"""Below and above all instants and orders."""

MAX_NODE_KEYS = 32
"""Maximum number of keys of a tree node."""

_IndexEntry = Tuple[int, int, int, PartialMatch]


class _TreeNode:
    """Node of the tree.

    Attributes:
        keys: entries ``(instant, other, order, match)`` of a leaf; in an inner node the smallest such triple of each
            child (the first child may contain smaller ones).
        children: child nodes; None for a leaf.
        low: smallest other instant of the entries below.
        high: largest other instant of the entries below.
        oldest: smallest order of the entries below.
        newest: largest order of the entries below.
    """

    __slots__ = ("keys", "children", "low", "high", "oldest", "newest")

    def __init__(self, keys: List[Tuple[Any, ...]], children: Optional[List["_TreeNode"]]):
        self.keys = keys
        self.children = children
        self._update_other_bounds()
        self._update_order_bounds()

    def _update_other_bounds(self) -> None:
        if self.children is None:
            others = [key[1] for key in self.keys]
            self.low, self.high = min(others), max(others)
        else:
            self.low, self.high = (
                min(child.low for child in self.children),
                max(child.high for child in self.children),
            )

    def _update_order_bounds(self) -> None:
        if self.children is None:
            orders = [key[2] for key in self.keys]
            self.oldest, self.newest = min(orders), max(orders)
        else:
            self.oldest = min(child.oldest for child in self.children)
            self.newest = max(child.newest for child in self.children)

    def add(self, entry: _IndexEntry) -> Optional["_TreeNode"]:
        """Add an entry; return the second half of the node if it had to be split."""
        _, other, order, _ = entry
        self.low, self.high = min(self.low, other), max(self.high, other)
        self.oldest, self.newest = min(self.oldest, order), max(self.newest, order)
        keys, children = self.keys, self.children
        if children is None:
            insort(keys, entry)
        else:
            position = max(0, bisect_right(keys, entry) - 1)
            right_half = children[position].add(entry)
            if right_half is not None:
                keys.insert(position + 1, right_half.keys[0][:3])
                children.insert(position + 1, right_half)
        return self._split_off_half() if len(keys) > MAX_NODE_KEYS else None

    def _split_off_half(self) -> "_TreeNode":
        keys, children = self.keys, self.children
        middle = len(keys) // 2
        right_half = _TreeNode(keys[middle:], None if children is None else children[middle:])
        del keys[middle:]
        if children is not None:
            del children[middle:]
        self._update_other_bounds()
        self._update_order_bounds()
        return right_half

    def remove(self, entry: _IndexEntry) -> None:
        """Remove an entry, which must be present."""
        keys, children = self.keys, self.children
        if children is None:
            del keys[bisect_left(keys, entry)]
        else:
            position = max(0, bisect_right(keys, entry) - 1)
            children[position].remove(entry)
            if not children[position].keys:
                del keys[position], children[position]
        if keys:
            # Bounds are recomputed only if the entry was at a bound; wider bounds would be correct but would slow
            # searches down.
            if entry[1] in (self.low, self.high):
                self._update_other_bounds()
            if entry[2] in (self.oldest, self.newest):
                self._update_order_bounds()


class IntervalIndex:
    """Matches ordered by their times.

    Args:
        matches: the initial matches, at least one.
        by_end: whether the end is the sort key, else the start; the one that narrows searches down most.

    Attributes:
        changes: number of additions and removals.
        last_search: value of ``changes`` at the last search.
        size: number of matches.
    """

    def __init__(self, matches: Iterable[PartialMatch], by_end: bool):
        self.by_end = by_end
        self.changes = 0
        self.last_search = 0
        # A large tree consists of many small objects that all survive; each collection would walk over all of them
        # again.
        with gc_paused():
            self._build(sorted(map(self._entry, matches)))

    def _build(self, entries: List[_IndexEntry]) -> None:
        self.size = len(entries)
        half = MAX_NODE_KEYS // 2
        nodes = [
            _TreeNode(entries[position : position + half], None) for position in range(0, len(entries), half)
        ]
        while len(nodes) > 1:
            groups = [nodes[position : position + half] for position in range(0, len(nodes), half)]
            nodes = [_TreeNode([node.keys[0][:3] for node in group], group) for group in groups]
        self._root = nodes[0]

    def _entry(self, match: PartialMatch) -> _IndexEntry:
        if self.by_end:
            return (match.end, match.start, match.order, match)
        return (match.start, match.end, match.order, match)

    def add(self, match: PartialMatch) -> None:
        """Add a match."""
        self.changes += 1
        self.size += 1
        root = self._root
        right_half = root.add(self._entry(match))
        if right_half is not None:
            self._root = _TreeNode([root.keys[0][:3], right_half.keys[0][:3]], [root, right_half])

    def remove(self, match: PartialMatch) -> None:
        """Remove a match, which must be present and not be the last one."""
        self.changes += 1
        self.size -= 1
        root = self._root
        root.remove(self._entry(match))
        while root.children is not None and len(root.children) == 1:
            root = root.children[0]
        self._root = root

    @property
    def is_idle(self) -> bool:
        """True if the updates since the last search have cost more than building the index again would."""
        return 2 * (self.changes - self.last_search) > self.size

    def search(self, limits: TimeBounds, newest: bool, boundary_order: int) -> Iterator[PartialMatch]:
        """Yield the matches within limits, in order of arrival or in reverse order.

        Matches may be added and removed between two results. Matches that are added are not yielded, and neither are
        matches that have been removed.

        Args:
            limits: bounds of start and end.
            newest: whether the newest match is yielded first, else the oldest.
            boundary_order: an order; only older matches are yielded if ``newest``, else only newer ones.
        """
        last = self._root.newest
        changes = -1
        # A change may restructure the tree, which invalidates the heap of the search. The search then starts again
        # after the last result. `last` excludes matches that are added meanwhile.
        while self.changes != changes:
            self.last_search = changes = self.changes
            for match in self._search_tree(limits, newest, boundary_order):
                if match.order > last:
                    return
                boundary_order = match.order
                yield match
                if self.changes != changes:
                    break

    def _search_tree(self, limits: TimeBounds, newest: bool, boundary_order: int) -> Iterator[PartialMatch]:
        if self.by_end:
            low, high, lower, upper = limits
        else:
            lower, upper, low, high = limits
        min_key, max_key = (lower, low), (upper, high, MAX_VALUE)
        after, before = (MIN_VALUE, boundary_order) if newest else (boundary_order, MAX_VALUE)
        heap: List[Any] = [(0, self._root)]
        # Best-first search: the heap orders subtrees by the best order that they may contain, and matches by their
        # own. A match that is popped therefore precedes everything that has not been visited.
        while heap:
            item = heapq.heappop(heap)[1]
            if item.__class__ is not _TreeNode:
                yield item
                continue
            keys, children = item.keys, item.children
            start, stop = bisect_right(keys, min_key), bisect_right(keys, max_key)
            if children is None:
                for _, other, order, match in keys[start:stop]:
                    if low <= other <= high and after < order < before:
                        heapq.heappush(heap, (-order if newest else order, match))
                continue
            # The first key of a child may be larger than its smallest entry, so the child before the first hit is
            # searched too.
            for child in children[max(0, start - 1) : max(1, stop)]:
                if child.low <= high and child.high >= low and child.oldest < before and child.newest > after:
                    heapq.heappush(heap, (-child.newest if newest else child.oldest, child))


@contextmanager
def gc_paused() -> Iterator[None]:
    """Disable garbage collection while a large structure is built; each collection would traverse all of it again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


_MIRRORED_SIGNS = {"<": ">", "<=": ">=", "==": "=="}


class IntervalBounds(NamedTuple):
    """Time bounds of possible partners.

    Attributes:
        limits: returns the bounds of start and end of the partners of a match with the given start and end.
        by_end: whether the end is bounded more tightly than the start.
    """

    limits: Callable[[int, int], TimeBounds]
    by_end: bool


BEFORE = IntervalBounds(lambda start, end: (MIN_VALUE, MAX_VALUE, MIN_VALUE, start - 1), True)
"""Everything that ended before."""
BETWEEN = IntervalBounds(lambda start, end: (start + 1, MAX_VALUE, MIN_VALUE, end - 1), False)
"""Everything that lies strictly between two instants."""
ENDS_AFTER_START = IntervalBounds(lambda start, end: (MIN_VALUE, MAX_VALUE, start + 1, MAX_VALUE), True)
"""Everything that ends after the start."""


@lru_cache(maxsize=1000)
def interval_bounds(name: str, span: Optional[int], is_left: bool) -> Optional[IntervalBounds]:
    """Return the time bounds of the partners of a match; None if they are unbounded.

    Args:
        name: an operator.
        span: maximum length of the result, in ns; None for no bound.
        is_left: whether the match is the left operand.
    """
    operator = PAIR_OPERATORS[name]
    lower, upper = _bound_sources(operator, span, "1" if is_left else "2")
    if not any((*lower.values(), *upper.values())):
        return None
    # The bounds are compiled to one expression, because they are computed for every match that arrives.
    bounds = []
    # The bounds of the start, then those of the end, as in `TimeBounds`.
    for instant in "se":
        bounds += [
            _tightest_source("max", lower[instant]) or "MIN_VALUE",
            _tightest_source("min", upper[instant]) or "MAX_VALUE",
        ]
    parameters = "s1, e1" if is_left else "s2, e2"
    source = f"def generated({parameters}):\n    return ({', '.join(bounds)})\n"
    limits = shared_function(
        source, {"MIN_VALUE": MIN_VALUE, "MAX_VALUE": MAX_VALUE}, f"partners of {operator.name}"
    )
    by_end = len(lower["e"]) + len(upper["e"]) > len(lower["s"]) + len(upper["s"])
    return IntervalBounds(limits, by_end)


def _bound_sources(
    operator: EventOperator, span: Optional[int], own_side: str
) -> Tuple[Dict[str, List[str]], Dict[str, List[str]]]:
    """Return lower and upper bounds of the start (``s``) and end (``e``) of a partner, as source expressions."""
    lower: Dict[str, List[str]] = {"s": [], "e": []}
    upper: Dict[str, List[str]] = {"s": [], "e": []}
    for comparison in operator.comparisons:
        first, sign, second = comparison.split()
        # A comparison within one operand says nothing about the partner.
        if first[1] == second[1]:
            continue
        if first[1] == own_side:
            first, sign, second = second, _MIRRORED_SIGNS[sign], first
        if sign in ("<", "<=", "=="):
            upper[first[0]].append(f"{second} - 1" if sign == "<" else second)
        if sign in (">", ">=", "=="):
            lower[first[0]].append(f"{second} + 1" if sign == ">" else second)
    if span is not None:
        # A result never starts after its operands or ends before them, so both lie within `span` of each other.
        lower["s"].append(f"e{own_side} - {span}")
        upper["e"].append(f"s{own_side} + {span}")
    return lower, upper


def _tightest_source(function: str, expressions: List[str]) -> str:
    """Return the source of the tightest of several bounds; empty if there are none."""
    return f"{function}({', '.join(expressions)})" if len(expressions) > 1 else "".join(expressions)
