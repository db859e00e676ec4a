"""Running statistics: exact sums, standard deviation, minimum and quantiles of numbers that are added and removed.

* `ExactSum` holds a sum of floats as an integer over a power of two. Adding and removing are exact, and only the
  result is rounded, so errors do not build up in a window that slides for days.
* `Lowest` is a heap with lazy deletion for minimum and maximum.
* `Ranked` is a pair of heaps around a quantile.
"""

import heapq
from math import inf, isqrt, nan, sqrt
from typing import Any, List, Optional, Tuple, Union

Number = Union[int, float]
_SMALL, _LARGE = 1e-290, 1e290
_MAX_BITS = 1024


class ExactSum:
    """Exact sum of the numbers that were added and not removed, as an integer over a power of two.

    Every finite float is such a fraction, so removing a number restores the earlier sum exactly.

    Attributes:
        total: the sum times two to the power of ``scale``.
        scale: the exponent, which never decreases.
        factor: two to the power of ``scale`` as a float, or nan if that is too large. The product of this factor and
            a float is exact if it is an integer.
        integers: number of integers among the numbers.
    """

    __slots__ = ("total", "scale", "factor", "integers")

    def __init__(self) -> None:
        self.total = 0
        self.scale = 0
        self.factor = 1.0
        self.integers = 0

    def change(self, value: Number, by: int) -> None:
        """Add a number ``by`` times; -1 removes it."""
        if value.__class__ is int:
            self.total += by * int(value) << self.scale
            self.integers += by
            return
        over, under = value.as_integer_ratio()
        self.change_fraction(over, under.bit_length() - 1, by)

    def change_fraction(self, over: int, bits: int, by: int) -> None:
        """Add ``over / 2 ** bits``, ``by`` times."""
        if bits > self.scale:
            # The scale only grows: numbers of other magnitudes come again, and rescaling is linear in the digits.
            self.total <<= bits - self.scale
            self.scale = bits
            self.factor = 2.0**bits if bits < _MAX_BITS else nan
        self.total += by * over << self.scale - bits

    def over(self, divisor: int, number: int) -> Number:
        """Return the sum of ``number`` numbers divided by ``divisor``.

        The result is an integer if it is exact and no number is a float.
        """
        whole = divisor << self.scale
        if self.integers == number:
            quotient, rest = divmod(self.total, whole)
            if not rest:
                # Integers stay exact, of any size.
                return quotient
        return self.total / whole


def deviation(total: ExactSum, squares: ExactSum, number: int) -> float:
    """Return the standard deviation of a sample of two or more numbers, given their sum and the sum of their squares.

    The formula is the square root of ``(n * squares - total ** 2) / (n * (n - 1))``, computed exactly up to the root.
    """
    # Both terms of the numerator as integers over the same power of two: their difference is exact, so numbers that
    # are large and close to each other lose no digits.
    bits = max(2 * total.scale, squares.scale)
    spread = number * squares.total << bits - squares.scale
    spread -= total.total**2 << bits - 2 * total.scale
    under = number * (number - 1) << bits
    try:
        square = spread / under
    except OverflowError:
        square = inf
    # Outside of this range the quotient is subnormal or infinite although its root is an ordinary float.
    return sqrt(square) if _SMALL < square < _LARGE or not spread else _root(spread, under)


def _root(over: int, under: int) -> float:
    """Return the square root of a fraction that is outside of the range of floats."""
    # 64 bits more than the quotient has: the integer root is exact to more digits than a float has.
    bits = (under.bit_length() - over.bit_length()) // 2 + 64
    if bits >= 0:
        return isqrt((over << 2 * bits) // under) / (1 << bits)
    return float(isqrt(over // (under << -2 * bits)) << -bits)


RankedNumber = Tuple[Number, int, Any]
"""Number, order of its element, and the element. Of equal numbers, the one that arrived first is the lowest."""


class Lowest:
    """Heap of the numbers of elements in a window, with lazy deletion."""

    __slots__ = ("heap", "live")

    def __init__(self) -> None:
        self.heap: List[RankedNumber] = []
        self.live = 0

    def add(self, value: Number, item: Any) -> None:
        """Add the number of an element."""
        self.live += 1
        heapq.heappush(self.heap, (value, item.order, item))

    def remove(self) -> None:
        """Count a removal; the element itself must be marked with `StreamElement.gone`."""
        self.live -= 1
        # Compacting after half of the entries were removed costs amortised constant time per removal.
        if len(self.heap) > 2 * self.live + 64:
            self.heap = [entry for entry in self.heap if not entry[2].gone]
            heapq.heapify(self.heap)

    def top(self) -> Optional[RankedNumber]:
        """Return the lowest entry, or None."""
        heap = self.heap
        while heap and heap[0][2].gone:
            heapq.heappop(heap)
        return heap[0] if heap else None

    def pop(self) -> RankedNumber:
        """Remove and return the lowest entry; the heap must not be empty."""
        self.top()
        self.live -= 1
        return heapq.heappop(self.heap)


class Ranked:
    """Quantile of the numbers of elements in a window: one heap for those up to the quantile, one for those above.

    Between two numbers the result is interpolated linearly, as numpy does by default.

    Args:
        part: the quantile, from 0 to 1; 0.5 is the median.
    """

    __slots__ = ("part", "below", "above", "_is_below")

    def __init__(self, part: float):
        self.part = part
        # Numbers are negated, so the highest is on top.
        self.below = Lowest()
        self.above = Lowest()
        self._is_below: Any = {}

    def add(self, value: Number, item: Any) -> None:
        """Add the number of an element."""
        top = self.below.top()
        # Equal numbers go to the lower heap; which of them is irrelevant to the value of the quantile.
        low = top is None or value <= -top[0]
        self._put(value, item, low)
        self._balance()

    def remove(self, item: Any) -> None:
        """Remove an element that is marked as gone."""
        (self.below if self._is_below.pop(item.order) else self.above).remove()
        self._balance()

    def _put(self, value: Number, item: Any, low: bool) -> None:
        self._is_below[item.order] = low
        if low:
            self.below.add(-value, item)
        else:
            self.above.add(value, item)

    def _balance(self) -> None:
        number = self.below.live + self.above.live
        # The lower heap ends with the number at rank ``floor(part * (n - 1))``; the next one is on top of the other
        # heap, so both neighbours of the quantile are available in constant time.
        wanted = int(self.part * (number - 1)) + 1 if number else 0
        while self.below.live < wanted:
            value, _, item = self.above.pop()
            self._put(value, item, True)
        while self.below.live > wanted:
            value, _, item = self.below.pop()
            self._put(-value, item, False)

    def value(self) -> Optional[Number]:
        """Return the quantile, or None if there are no numbers."""
        top = self.below.top()
        if top is None:
            return None
        low = -top[0]
        rank = self.part * (self.below.live + self.above.live - 1)
        fraction = rank - int(rank)
        if not fraction:
            return low
        entry = self.above.top()
        # A rank between two numbers has one above it.
        assert entry is not None
        interpolated = low + (entry[0] - low) * fraction
        # The difference is infinite for two huge numbers of opposite sign; ``inf - inf`` is nan, which differs from
        # 0.
        if interpolated - interpolated == 0:
            return interpolated
        return low * (1 - fraction) + entry[0] * fraction
