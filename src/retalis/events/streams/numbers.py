"""Numbers that aggregates measure: which values are numbers, and sums, lowest numbers and quantiles of those.

Sums are exact, however many numbers have gone, and rounded once where they are asked for.
"""

import heapq
from math import inf, isfinite, isqrt, nan, sqrt
from typing import Any, List, Optional, Set, Tuple, Union

from ...foundation import RuleError, UsageError, beginning
from ...prolog.arithmetic import EVALUABLE
from ...prolog.syntax import write_term
from ...prolog.terms import Term, deref, timestamps

Number = Union[int, float]
_SMALL, _LARGE = 1e-290, 1e290
_MOST_BITS = 1024


class ExactSum:
    """The sum of the numbers that are in, as an integer over a power of two.

    Floats are such fractions themselves, so that nothing is lost when one is taken out again.

    Attributes:
        total: the sum times two to the ``scale``.
        scale: the power of two, which only grows.
        factor: the same as a float; that times a float is exact where it is an integer. Where it would be too large
            it is no number.
        floats: how many of the numbers are floats.
    """

    __slots__ = ("total", "scale", "factor", "floats")

    def __init__(self) -> None:
        self.total = 0
        self.scale = 0
        self.factor = 1.0
        self.floats = 0

    def change(self, value: Number, by: int) -> None:
        """Add a number ``by`` times; -1 takes it out."""
        if value.__class__ is int:
            self.total += by * int(value) << self.scale
            return
        over, under = value.as_integer_ratio()
        self.floats += by
        self.change_fraction(over, under.bit_length() - 1, by)

    def change_fraction(self, over: int, bits: int, by: int) -> None:
        """Add ``over / 2 ** bits`` so many times."""
        if bits > self.scale:
            self.total <<= bits - self.scale
            self.scale = bits
            self.factor = 2.0**bits if bits < _MOST_BITS else nan
        self.total += by * over << self.scale - bits

    def over(self, number: int) -> Number:
        """Return the sum divided by a number: an integer where there are no floats and it is one, else a float."""
        whole = number << self.scale
        if not self.floats:
            quotient, rest = divmod(self.total, whole)
            if not rest:
                return quotient
        return self.total / whole


def deviation(total: ExactSum, squares: ExactSum, number: int) -> float:
    """Return the standard deviation of a sample of two numbers and more, from their sum and that of their squares.

    The square root of ``(n * squares - total ** 2) / (n * (n - 1))``, exact up to the root.
    """
    bits = max(2 * total.scale, squares.scale)
    spread = number * squares.total << bits - squares.scale
    spread -= total.total**2 << bits - 2 * total.scale
    under = number * (number - 1) << bits
    try:
        square = spread / under
    except OverflowError:
        square = inf
    return sqrt(square) if _SMALL < square < _LARGE or not spread else _root(spread, under)


def _root(over: int, under: int) -> float:
    """Return the square root of a fraction that no float is near to, though one may be near to its root."""
    bits = (under.bit_length() - over.bit_length()) // 2 + 64
    if bits >= 0:
        return isqrt((over << 2 * bits) // under) / (1 << bits)
    return float(isqrt(over // (under << -2 * bits)) << -bits)


ADDING = frozenset(("sum", "avg", "stddev"))
"""The aggregates that add their values with `is`, by name: their values may be expressions such as ``1 + 2``."""


def unfit(name: str, value: Term, expected: str = "a number") -> RuleError:
    """Return the error of an aggregate for a value that it cannot measure."""
    return RuleError(f"aggregate {name}: the value is '{beginning(write_term(value))}': expected {expected}")


def check_finite(value: Any, name: str) -> None:
    """Refuse a value that cannot be added.

    Raises:
        RuleError: if the value is not a number, or not finite.
    """
    if not isinstance(value, (int, float)):
        raise unfit(name, value)
    if value.__class__ is float and not isfinite(value):
        raise unfit(name, value, "a finite number")


def check_ordered(value: Any, name: str) -> None:
    """Refuse a value that is neither more nor less than other numbers.

    Raises:
        RuleError: if the value is not a number, or is nan.
    """
    if not isinstance(value, (int, float)) or value != value:
        raise unfit(name, value)


def is_number(value: Term) -> bool:
    """Tell whether a value is a number, or a stamp, which is the number of its seconds."""
    term: Any = deref(value)
    if term.__class__ in (int, float):
        return True
    if term.__class__ is not tuple:
        return False  # an atom such as `e`, or a text of one character, is an expression, but not a number
    try:
        timestamps.from_any(term)
    except UsageError:
        return False
    return True


def is_number_expression(value: Term) -> bool:
    """Tell whether a value is a number, or an arithmetic expression of numbers."""
    stack = [value]
    seen: Set[int] = set()
    while stack:
        term: Any = deref(stack.pop())
        if is_number(term) or id(term) in seen:
            continue
        if term.__class__ is not tuple or term[0] not in EVALUABLE:
            return False
        seen.add(id(term))  # what is part of a term more than once is looked at once
        stack.extend(term[1:])
    return True


RankedNumber = Tuple[Number, int, Any]
"""A number, the order of its item, the item: of equal numbers the first that came is meant."""


class Lowest:
    """The lowest of the numbers whose items are in; what has gone is dropped when it comes to the top."""

    __slots__ = ("heap", "live")

    def __init__(self) -> None:
        self.heap: List[RankedNumber] = []
        self.live = 0

    def add(self, value: Number, item: Any) -> None:
        """Add the number of an item."""
        self.live += 1
        heapq.heappush(self.heap, (value, item.order, item))

    def remove(self) -> None:
        """Count one that has gone."""
        self.live -= 1
        if len(self.heap) > 2 * self.live + 64:
            self.heap = [entry for entry in self.heap if not entry[2].gone]
            heapq.heapify(self.heap)

    def top(self) -> Optional[RankedNumber]:
        """Return the lowest."""
        heap = self.heap
        while heap and heap[0][2].gone:
            heapq.heappop(heap)
        return heap[0] if heap else None

    def pop(self) -> RankedNumber:
        """Take out the lowest; there has to be one."""
        self.top()
        self.live -= 1
        return heapq.heappop(self.heap)


class Ranked:
    """A quantile of the numbers whose items are in: those up to it in one heap, those above it in another.

    Between two numbers it is interpolated linearly, as numpy does by default.

    Args:
        part: which quantile, 0 to 1; 0.5 for the median.
    """

    __slots__ = ("part", "below", "above", "_is_below")

    def __init__(self, part: float):
        self.part = part
        self.below = Lowest()  # of the negated numbers: the highest is on top
        self.above = Lowest()
        self._is_below: Any = {}

    def add(self, value: Number, item: Any) -> None:
        """Add the number of an item."""
        top = self.below.top()
        low = top is None or value <= -top[0]
        self._put(value, item, low)
        self._balance()

    def remove(self, item: Any) -> None:
        """Take an item out that is gone."""
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
        wanted = int(self.part * (number - 1)) + 1 if number else 0
        while self.below.live < wanted:
            value, _, item = self.above.pop()
            self._put(value, item, True)
        while self.below.live > wanted:
            value, _, item = self.below.pop()
            self._put(-value, item, False)

    def value(self) -> Optional[Number]:
        """Return the quantile; None of nothing."""
        top = self.below.top()
        if top is None:
            return None
        low = -top[0]
        place = self.part * (self.below.live + self.above.live - 1)
        part = place - int(place)
        if not part:
            return low
        entry = self.above.top()
        assert entry is not None  # there is one above a place between two
        found = low + (entry[0] - low) * part
        if found - found == 0:
            return found
        return low * (1 - part) + entry[0] * part  # the difference of the two is too large for a float
