"""Running statistics: exact sums, standard deviation, minimum and quantiles of numbers that are added and removed.

* `ExactSum` holds a sum of floats as an integer over a power of two. Adding and removing are exact, and only the
  result is rounded, so errors do not build up in a window that slides for days.
* `LazyMinHeap` is a heap with lazy deletion for minimum and maximum.
* `QuantileHeaps` is a pair of heaps around a quantile.
"""

import heapq
from math import inf, isqrt, nan, sqrt
from typing import Any, List, Optional, Tuple, Union

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


def standard_deviation(total: ExactSum, squares: ExactSum, count: int) -> float:
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
        lower_value = -top[0]
        rank = self.quantile * (self.below.count + self.above.count - 1)
        fraction = rank - int(rank)
        if not fraction:
            return lower_value
        entry = self.above.top()
        # A rank between two numbers has one above it.
        assert entry is not None
        interpolated = lower_value + (entry[0] - lower_value) * fraction
        # The difference is infinite for two huge numbers of opposite sign; ``inf - inf`` is nan, which differs from
        # 0.
        if interpolated - interpolated == 0:
            return interpolated
        return lower_value * (1 - fraction) + entry[0] * fraction
