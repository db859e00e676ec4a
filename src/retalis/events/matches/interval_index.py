"""Waiting matches by time: finds those that start and end within given limits, newest or oldest first.

A B+ tree over (instant, other instant, order of arrival). Each node also knows between what the other instants and
the orders below it lie, so that a search goes only where there may be something to find: where each instant is
named, or limited from one side, every match found costs the logarithm of what waits.

Where in time the partners of a match lie: derived from what an operator says about a pair.
"""

import gc
import heapq
from bisect import bisect_left, bisect_right, insort
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Optional, Tuple

from ...foundation.codegen import shared_function
from ...prolog.syntax.event_operators import EventOperator
from ..language.pattern_operators import OPERATORS
from .partial_matches import PartialMatch

TimeBounds = Tuple[int, int, int, int]
"""The least and the largest start, the least and the largest end; all of them inclusive."""

LEAST, MOST = -(1 << 80), 1 << 80
"""Before and after any instant and any order."""

FULL = 32
"""How many parts of a node of the tree there are at most."""

_IndexEntry = Tuple[int, int, int, PartialMatch]


class _TreeNode:
    """A part of the tree.

    Attributes:
        keys: of a leaf its entries ``(instant, other, order, match)``; else the least such triple of each kid (of
            the first one there may be less).
        kids: the nodes below; None for a leaf.
        low: the least other instant of the entries below.
        high: the largest.
        oldest: the least order.
        newest: the largest.
    """

    __slots__ = ("keys", "kids", "low", "high", "oldest", "newest")

    def __init__(self, keys: List[Tuple[Any, ...]], kids: Optional[List["_TreeNode"]]):
        self.keys = keys
        self.kids = kids
        self._set_others()
        self._set_orders()

    def _set_others(self) -> None:
        if self.kids is None:
            others = [key[1] for key in self.keys]
            self.low, self.high = min(others), max(others)
        else:
            self.low, self.high = min(kid.low for kid in self.kids), max(kid.high for kid in self.kids)

    def _set_orders(self) -> None:
        if self.kids is None:
            orders = [key[2] for key in self.keys]
            self.oldest, self.newest = min(orders), max(orders)
        else:
            self.oldest = min(kid.oldest for kid in self.kids)
            self.newest = max(kid.newest for kid in self.kids)

    def add(self, entry: _IndexEntry) -> Optional["_TreeNode"]:
        """Add an entry; return the second half of the node where it has become too full."""
        _, other, order, _ = entry
        self.low, self.high = min(self.low, other), max(self.high, other)
        self.oldest, self.newest = min(self.oldest, order), max(self.newest, order)
        keys, kids = self.keys, self.kids
        if kids is None:
            insort(keys, entry)
        else:
            at = max(0, bisect_right(keys, entry) - 1)
            half = kids[at].add(entry)
            if half is not None:
                keys.insert(at + 1, half.keys[0][:3])
                kids.insert(at + 1, half)
        return self._halved() if len(keys) > FULL else None

    def _halved(self) -> "_TreeNode":
        keys, kids = self.keys, self.kids
        middle = len(keys) // 2
        half = _TreeNode(keys[middle:], None if kids is None else kids[middle:])
        del keys[middle:]
        if kids is not None:
            del kids[middle:]
        self._set_others()
        self._set_orders()
        return half

    def remove(self, entry: _IndexEntry) -> None:
        """Remove an entry that is there."""
        keys, kids = self.keys, self.kids
        if kids is None:
            del keys[bisect_left(keys, entry)]
        else:
            at = max(0, bisect_right(keys, entry) - 1)
            kids[at].remove(entry)
            if not kids[at].keys:
                del keys[at], kids[at]
        if keys:
            if entry[1] in (self.low, self.high):
                self._set_others()
            if entry[2] in (self.oldest, self.newest):
                self._set_orders()


class IntervalIndex:
    """Matches by their times.

    Args:
        matches: what is in it at first, at least one.
        by_end: whether the end is what narrows searches down most, else the start.

    Attributes:
        changes: how often something was added or removed.
        searched: what ``changes`` was at the last search.
        size: how many matches are in it.
    """

    def __init__(self, matches: Iterable[PartialMatch], by_end: bool):
        self.by_end = by_end
        self.changes = 0
        self.searched = 0
        with paused():
            self._build(sorted(map(self._entry, matches)))

    def _build(self, entries: List[_IndexEntry]) -> None:
        self.size = len(entries)
        half = FULL // 2
        nodes = [_TreeNode(entries[at : at + half], None) for at in range(0, len(entries), half)]
        while len(nodes) > 1:
            parts = [nodes[at : at + half] for at in range(0, len(nodes), half)]
            nodes = [_TreeNode([node.keys[0][:3] for node in part], part) for part in parts]
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
        half = root.add(self._entry(match))
        if half is not None:
            self._root = _TreeNode([root.keys[0][:3], half.keys[0][:3]], [root, half])

    def remove(self, match: PartialMatch) -> None:
        """Remove a match that is there and not the last one."""
        self.changes += 1
        self.size -= 1
        root = self._root
        root.remove(self._entry(match))
        while root.kids is not None and len(root.kids) == 1:
            root = root.kids[0]
        self._root = root

    @property
    def idle(self) -> bool:
        """Whether keeping it up to date since the last search has cost more than making it anew would."""
        return 2 * (self.changes - self.searched) > self.size

    def search(self, limits: TimeBounds, newest: bool, beyond: int) -> Iterator[PartialMatch]:
        """Yield the matches within limits that are in it now, in order of arrival or against it.

        Others may come and go meanwhile; what is gone is not yielded any more.

        Args:
            limits: between what start and end have to lie.
            newest: whether the newest comes first, else the oldest.
            beyond: an order: only those that are older are yielded, or else newer.
        """
        last = self._root.newest
        changes = -1
        while self.changes != changes:  # begins again after the last one, when there was a change
            self.searched = changes = self.changes
            for match in self._within(limits, newest, beyond):
                if match.order > last:
                    return
                beyond = match.order
                yield match
                if self.changes != changes:
                    break

    def _within(self, limits: TimeBounds, newest: bool, beyond: int) -> Iterator[PartialMatch]:
        if self.by_end:
            low, high, least, most = limits
        else:
            least, most, low, high = limits
        first, final = (least, low), (most, high, MOST)
        after, before = (LEAST, beyond) if newest else (beyond, MOST)
        heap: List[Any] = [(0, self._root)]
        while heap:
            item = heapq.heappop(heap)[1]
            if item.__class__ is not _TreeNode:
                yield item
                continue
            keys, kids = item.keys, item.kids
            start, stop = bisect_right(keys, first), bisect_right(keys, final)
            if kids is None:
                for _, other, order, match in keys[start:stop]:
                    if low <= other <= high and after < order < before:
                        heapq.heappush(heap, (-order if newest else order, match))
                continue
            for kid in kids[max(0, start - 1) : max(1, stop)]:
                if kid.low <= high and kid.high >= low and kid.oldest < before and kid.newest > after:
                    heapq.heappush(heap, (-kid.newest if newest else kid.oldest, kid))


@contextmanager
def paused() -> Iterator[None]:
    """Keep the collector from looking while something large is built: it would walk all of it again and again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


_MIRRORED = {"<": ">", "<=": ">=", "==": "=="}


class IntervalBounds(NamedTuple):
    """The times of possible partners.

    Attributes:
        limits: from start and end of a match to between what its partners start and end.
        by_end: whether the end is limited more closely than the start.
    """

    limits: Callable[[int, int], TimeBounds]
    by_end: bool


BEFORE = IntervalBounds(lambda start, end: (LEAST, MOST, LEAST, start - 1), True)
"""Whatever ended before."""
BETWEEN = IntervalBounds(lambda start, end: (start + 1, MOST, LEAST, end - 1), False)
"""What lies wholly between two instants."""


@lru_cache(maxsize=1000)
def reach_of(name: str, span: Optional[int], left: bool) -> Optional[IntervalBounds]:
    """Return where the partners of a match are; None where they may be anywhere.

    Args:
        name: an operator.
        span: how long the result may be, in ns; None for no bound.
        left: whether the match is the left operand.
    """
    operator = OPERATORS[name]
    lower, upper = _bounds(operator, span, "1" if left else "2")
    if not any((*lower.values(), *upper.values())):
        return None
    parts = []
    for instant in "se":
        parts += [_tightest("max", lower[instant]) or "LEAST", _tightest("min", upper[instant]) or "MOST"]
    given = "s1, e1" if left else "s2, e2"
    source = f"def made({given}):\n    return ({', '.join(parts)})\n"
    limits = shared_function(source, {"LEAST": LEAST, "MOST": MOST}, f"partners of {operator.name}")
    by_end = len(lower["e"]) + len(upper["e"]) > len(lower["s"]) + len(upper["s"])
    return IntervalBounds(limits, by_end)


def _bounds(
    operator: EventOperator, span: Optional[int], mine: str
) -> Tuple[Dict[str, List[str]], Dict[str, List[str]]]:
    """Return the lower and the upper bounds of a partner's start and end, as sources."""
    lower: Dict[str, List[str]] = {"s": [], "e": []}
    upper: Dict[str, List[str]] = {"s": [], "e": []}
    for comparison in operator.comparisons:
        one, sign, other = comparison.split()
        if one[1] == other[1]:
            continue
        if one[1] == mine:
            one, sign, other = other, _MIRRORED[sign], one
        if sign in ("<", "<=", "=="):
            upper[one[0]].append(f"{other} - 1" if sign == "<" else other)
        if sign in (">", ">=", "=="):
            lower[one[0]].append(f"{other} + 1" if sign == ">" else other)
    if span is not None:  # a result always reaches from the start of the one to the end of the other
        lower["s"].append(f"e{mine} - {span}")
        upper["e"].append(f"s{mine} + {span}")
    return lower, upper


def _tightest(function: str, sources: List[str]) -> str:
    return f"{function}({', '.join(sources)})" if len(sources) > 1 else "".join(sources)
