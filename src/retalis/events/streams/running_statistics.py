"""Running statistics: exact sums, standard deviation, minimum and quantiles of numbers that are added and removed.

* `ExactSum` holds a sum of floats as an integer over a power of two. Adding and removing are exact, and only the
  result is rounded, so errors do not build up in a window that slides for days.
* `LazyMinHeap` is a heap with lazy deletion for minimum and maximum.
* `QuantileHeaps` is a pair of heaps around a quantile.

Repetitions only add numbers, and never change a state in place. Their states are persistent:

* `SumState` is an `ExactSum` that is not changed.
* `QuantileState` has leftist heaps (Crane, 1972): merging two heaps copies a path of logarithmic length.
* `KeySet` consists of immutable sets of decreasing sizes (Bentley and Saxe, 1980): adding a key merges sets of equal
  size, which takes amortised logarithmic time, as does the search in all of them.
"""

import heapq
from math import inf, isqrt, nan, sqrt
from typing import Any, FrozenSet, Hashable, List, NamedTuple, Optional, Tuple, Union

Number = Union[int, float]
_MIN_EXACT_ROOT, _MAX_EXACT_ROOT = 1e-290, 1e290
"""Range of variances whose floating-point square root is exact enough."""
_MAX_EXPONENT = 1024
"""Smallest power of two that is too large for a float."""


class ExactSum:
    """Exact sum of the numbers that were added and not removed, as an integer over a power of two.

    Every finite float is such a fraction, so removing a number restores the earlier sum exactly.

    Attributes:
        total: the sum times two to the power of ``scale``.
        scale: the exponent, which never decreases.
        factor: two to the power of ``scale`` as a float, or nan if that is too large. The product of this factor and
            a float is exact if it is an integer.
        integer_count: number of integers among the numbers.
    """

    __slots__ = ("total", "scale", "factor", "integer_count")

    def __init__(self) -> None:
        self.total = 0
        self.scale = 0
        self.factor = 1.0
        self.integer_count = 0

    def add_multiple(self, value: Number, times: int) -> None:
        """Add a number ``times`` times; -1 removes it."""
        if value.__class__ is int:
            self.total += times * int(value) << self.scale
            self.integer_count += times
            return
        numerator, denominator = value.as_integer_ratio()
        self.add_fraction(numerator, denominator.bit_length() - 1, times)

    def add_fraction(self, numerator: int, bits: int, times: int) -> None:
        """Add ``numerator / 2 ** bits``, ``times`` times."""
        if bits > self.scale:
            # The scale only grows: numbers of other magnitudes come again, and rescaling is linear in the digits.
            self.total <<= bits - self.scale
            self.scale = bits
            self.factor = 2.0**bits if bits < _MAX_EXPONENT else nan
        self.total += times * numerator << self.scale - bits

    def quotient(self, divisor: int, count: int) -> Number:
        """Return the sum of ``count`` numbers divided by ``divisor``.

        The result is an integer if it is exact and no number is a float.
        """
        denominator = divisor << self.scale
        if self.integer_count == count:
            quotient, remainder = divmod(self.total, denominator)
            if not remainder:
                # Integers stay exact, of any size.
                return quotient
        return self.total / denominator


class SumState(NamedTuple):
    """Exact sum of numbers, as an integer over a power of two.

    Attributes:
        total: the sum times two to the power of ``scale``.
        scale: the exponent.
    """

    total: int = 0
    scale: int = 0

    def with_fraction(self, numerator: int, bits: int) -> "SumState":
        """Return the sum with one more number, ``numerator / 2 ** bits``."""
        scale = max(self.scale, bits)
        return SumState((self.total << scale - self.scale) + (numerator << scale - bits), scale)


AnySum = Union[ExactSum, SumState]


def standard_deviation(total: AnySum, squares: AnySum, count: int) -> float:
    """Return the standard deviation of a sample of two or more numbers, given their sum and the sum of their squares.

    The formula is the square root of ``(n * squares - total ** 2) / (n * (n - 1))``, computed exactly up to the root.
    """
    # Both terms of the numerator as integers over the same power of two: their difference is exact, so numbers that
    # are large and close to each other lose no digits.
    bits = max(2 * total.scale, squares.scale)
    numerator = count * squares.total << bits - squares.scale
    numerator -= total.total**2 << bits - 2 * total.scale
    denominator = count * (count - 1) << bits
    try:
        variance = numerator / denominator
    except OverflowError:
        variance = inf
    # Outside of this range the quotient is subnormal or infinite although its root is an ordinary float.
    return (
        sqrt(variance)
        if _MIN_EXACT_ROOT < variance < _MAX_EXACT_ROOT or not numerator
        else _root(numerator, denominator)
    )


def _root(numerator: int, denominator: int) -> float:
    """Return the square root of a fraction that is outside of the range of floats."""
    # 64 bits more than the quotient has: the integer root is exact to more digits than a float has.
    bits = (denominator.bit_length() - numerator.bit_length()) // 2 + 64
    if bits >= 0:
        return isqrt((numerator << 2 * bits) // denominator) / (1 << bits)
    return float(isqrt(numerator // (denominator << -2 * bits)) << -bits)


HeapEntry = Tuple[Number, int, Any]
"""Number, order of its element, and the element. Of equal numbers, the one that arrived first is the lowest."""


class LazyMinHeap:
    """Heap of the numbers of elements in a window, with lazy deletion."""

    __slots__ = ("entries", "count")

    def __init__(self) -> None:
        self.entries: List[HeapEntry] = []
        self.count = 0

    def add(self, value: Number, element: Any) -> None:
        """Add the number of an element."""
        self.count += 1
        heapq.heappush(self.entries, (value, element.order, element))

    def remove(self) -> None:
        """Count a removal; the element itself must be marked with `StreamElement.is_removed`."""
        self.count -= 1
        # Compacting after half of the entries were removed costs amortised constant time per removal.
        if len(self.entries) > 2 * self.count + 64:
            self.entries = [entry for entry in self.entries if not entry[2].is_removed]
            heapq.heapify(self.entries)

    def top(self) -> Optional[HeapEntry]:
        """Return the lowest entry, or None."""
        heap = self.entries
        while heap and heap[0][2].is_removed:
            heapq.heappop(heap)
        return heap[0] if heap else None

    def pop(self) -> HeapEntry:
        """Remove and return the lowest entry; the heap must not be empty."""
        self.top()
        self.count -= 1
        return heapq.heappop(self.entries)


class QuantileHeaps:
    """Quantile of the numbers of elements in a window: one heap for those up to the quantile, one for those above.

    Between two numbers the result is interpolated linearly, as numpy does by default.

    Args:
        quantile: the quantile, from 0 to 1; 0.5 is the median.
    """

    __slots__ = ("quantile", "below", "above", "_is_below_by_order")

    def __init__(self, quantile: float):
        self.quantile = quantile
        # Numbers are negated, so the highest is on top.
        self.below = LazyMinHeap()
        self.above = LazyMinHeap()
        self._is_below_by_order: Any = {}

    def add(self, value: Number, element: Any) -> None:
        """Add the number of an element."""
        top = self.below.top()
        # Equal numbers go to the lower heap; which of them is irrelevant to the value of the quantile.
        is_low = top is None or value <= -top[0]
        self._add_to_heap(value, element, is_low)
        self._balance()

    def remove(self, element: Any) -> None:
        """Remove an element that is marked as removed."""
        (self.below if self._is_below_by_order.pop(element.order) else self.above).remove()
        self._balance()

    def _add_to_heap(self, value: Number, element: Any, is_low: bool) -> None:
        self._is_below_by_order[element.order] = is_low
        if is_low:
            self.below.add(-value, element)
        else:
            self.above.add(value, element)

    def _balance(self) -> None:
        count = self.below.count + self.above.count
        # The lower heap ends with the number at rank ``floor(quantile * (n - 1))``; the next one is on top of the
        # other heap, so both neighbours of the quantile are available in constant time.
        target_count = int(self.quantile * (count - 1)) + 1 if count else 0
        while self.below.count < target_count:
            value, _, element = self.above.pop()
            self._add_to_heap(value, element, True)
        while self.below.count > target_count:
            value, _, element = self.below.pop()
            self._add_to_heap(-value, element, False)

    def value(self) -> Optional[Number]:
        """Return the quantile, or None if there are no numbers."""
        top = self.below.top()
        if top is None:
            return None
        rank = self.quantile * (self.below.count + self.above.count - 1)
        fraction = rank - int(rank)
        entry = self.above.top() if fraction else None
        return _interpolate(-top[0], None if entry is None else entry[0], fraction)


def _interpolate(lower: Number, upper: Optional[Number], fraction: float) -> Number:
    """Return the number between two neighbours of a quantile; ``upper`` may be None if ``fraction`` is 0."""
    # A rank between two numbers has one above it.
    if upper is None or not fraction:
        return lower
    interpolated = lower + (upper - lower) * fraction
    # The difference is infinite for two huge numbers of opposite sign; ``inf - inf`` is nan, which differs from 0.
    return interpolated if interpolated - interpolated == 0 else lower * (1 - fraction) + upper * fraction


LeftistHeap = Optional[Tuple[Number, int, Any, Any, int]]
"""Number, order of its arrival, the two subheaps, and the length of the shortest path down; None is empty."""


def _merge(first: LeftistHeap, second: LeftistHeap) -> LeftistHeap:
    """Return a heap with the numbers of two heaps; the recursion is as deep as their shortest paths."""
    if first is None:
        return second
    if second is None:
        return first
    if second[:2] < first[:2]:
        first, second = second, first
    left, right = first[2], _merge(first[3], second)
    # The shorter path down is on the right.
    left_length, right_length = (0 if heap is None else heap[4] for heap in (left, right))
    if left_length < right_length:
        left, right, right_length = right, left, left_length
    return (first[0], first[1], left, right, right_length + 1)


class QuantileState(NamedTuple):
    """Heaps of the numbers up to a quantile, which are negated, and of those above it; see `QuantileHeaps`."""

    below: LeftistHeap = None
    above: LeftistHeap = None
    below_count: int = 0
    size: int = 0

    def with_number(self, value: Number, quantile: float) -> "QuantileState":
        """Return the state with one more number."""
        below, above, below_count, order = self
        count = order + 1
        if below is None or value <= -below[0]:
            below, below_count = _merge(below, (-value, order, None, None, 1)), below_count + 1
        else:
            above = _merge(above, (value, order, None, None, 1))
        target_count = int(quantile * (count - 1)) + 1
        while below_count < target_count and above is not None:
            number, order, left, right, _ = above
            above, below = _merge(left, right), _merge(below, (-number, order, None, None, 1))
            below_count += 1
        while below_count > target_count and below is not None:
            number, order, left, right, _ = below
            below, above = _merge(left, right), _merge(above, (-number, order, None, None, 1))
            below_count -= 1
        return QuantileState(below, above, below_count, count)

    def value(self, quantile: float) -> Optional[Number]:
        """Return the quantile, or None if there are no numbers."""
        if self.below is None:
            return None
        rank = quantile * (self.size - 1)
        return _interpolate(-self.below[0], None if self.above is None else self.above[0], rank - int(rank))

    def numbers(self) -> List[Number]:
        """Return the numbers in order of arrival."""
        entries: List[Tuple[int, Number]] = []
        for sign, heap in ((-1, self.below), (1, self.above)):
            pending = [heap]
            while pending:
                node = pending.pop()
                if node is not None:
                    entries.append((node[1], sign * node[0]))
                    pending += [node[2], node[3]]
        return [number for _, number in sorted(entries)]


KeySet = Tuple[FrozenSet[Hashable], ...]
"""Disjoint sets of keys, of decreasing sizes."""


def add_key(keys: KeySet, key: Hashable) -> KeySet:
    """Return the set of keys with one more, which it must not have."""
    merged = frozenset((key,))
    while keys and len(keys[-1]) <= len(merged):
        merged, keys = merged | keys[-1], keys[:-1]
    return (*keys, merged)
