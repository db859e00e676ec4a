"""Numbers that aggregates measure: which values are numbers, and sums, lowest numbers and quantiles of those.

Sums are exact, however many numbers have gone, and rounded once where they are asked for.

What windows measure of the items that are in them: one class for each kind of aggregate, and one table of them.
"""

import heapq
from fractions import Fraction
from math import inf, isfinite, isqrt, nan, sqrt
from typing import (
    Any,
    Callable,
    Deque,
    Dict,
    Hashable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Protocol,
    Set,
    Tuple,
    Union,
)

from ...foundation.errors import RuleError, UsageError, beginning
from ...prolog.machine.arithmetic import EVALUABLE
from ...prolog.syntax.term_writer import write_term
from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import make_list
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.timestamps import SECOND
from ...prolog.terms.types import Term, deref
from .stream_elements import StreamElement

Number = Union[int, float]
_SMALL, _LARGE = 1e-290, 1e290
_MAX_BITS = 1024


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
            self.factor = 2.0**bits if bits < _MAX_BITS else nan
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


Setting = Any
"""What a measure is set to, by its kind: a number, or what calls the program's predicates; mostly None."""
Members = Deque[StreamElement]
"""The items of a window in the order in which they came; some of them may be gone."""


def live(members: Members) -> Iterator[StreamElement]:
    """Yield those that are in the window, the oldest first."""
    return (item for item in members if not item.gone)


class Accumulator(Protocol):
    """A measure of the items in one window.

    `check` comes before an item is taken, so that one with a wrong value leaves nothing half done.

    Attributes:
        picky: whether it refuses some values.
        of_none: whether there is a result for no items.
        lists: whether its result looks at each of the items.
    """

    picky: bool
    of_none: bool
    lists: bool

    def check(self, item: StreamElement, /) -> None:
        """Refuse the value of an item.

        Raises:
            RuleError: where the measure cannot take it.
        """

    def add(self, item: StreamElement, /) -> None:
        """Take an item in."""

    def remove(self, item: StreamElement, /) -> None:
        """Take out an item that is gone."""

    def result(self, members: Members, number: int, /) -> Optional[Term]:
        """Return the result for so many items, one at least but for `of_none`; None where there is none."""


class _Plain:
    """A measure that is read off the items."""

    picky = False
    of_none = False
    lists = False

    def __init__(self, at: int, name: str, setting: Setting):
        self.at = at
        self.name = name
        self.setting = setting

    def check(self, item: StreamElement) -> None:
        """See `Accumulator.check`."""

    def add(self, item: StreamElement) -> None:
        """See `Accumulator.add`."""

    def remove(self, item: StreamElement) -> None:
        """See `Accumulator.remove`."""


class _Count(_Plain):
    of_none = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        return number


class _Sum(_Plain):
    picky = True
    of_none = True

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.sum = ExactSum()

    def check(self, item: StreamElement) -> None:
        check_finite(item.values[self.at], self.name)

    def add(self, item: StreamElement) -> None:
        self.sum.change(item.values[self.at], 1)

    def remove(self, item: StreamElement) -> None:
        self.sum.change(item.values[self.at], -1)

    def result(self, members: Members, number: int) -> Optional[Term]:
        return self.sum.over(1)


class _Average(_Sum):
    of_none = False

    def result(self, members: Members, number: int) -> Optional[Term]:
        return self.sum.over(number)


class _Deviation(_Sum):
    of_none = False

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.squares = ExactSum()

    def _square(self, item: StreamElement, by: int) -> None:
        over, under = item.values[self.at].as_integer_ratio()
        self.squares.change_fraction(over * over, 2 * (under.bit_length() - 1), by)

    def add(self, item: StreamElement) -> None:
        super().add(item)
        self._square(item, 1)

    def remove(self, item: StreamElement) -> None:
        super().remove(item)
        self._square(item, -1)

    def result(self, members: Members, number: int) -> Optional[Term]:
        return deviation(self.sum, self.squares, number) if number > 1 else None


class _Least(_Plain):
    picky = True
    sign = 1

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.lowest = Lowest()

    def check(self, item: StreamElement) -> None:
        check_ordered(item.values[self.at], self.name)

    def add(self, item: StreamElement) -> None:
        self.lowest.add(self.sign * item.values[self.at], item)

    def remove(self, item: StreamElement) -> None:
        self.lowest.remove()

    def result(self, members: Members, number: int) -> Optional[Term]:
        top = self.lowest.top()
        return None if top is None else top[2].values[self.at]


class _Greatest(_Least):
    sign = -1


class _Quantile(_Plain):
    picky = True

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.ranked = Ranked(setting)

    def check(self, item: StreamElement) -> None:
        check_finite(item.values[self.at], self.name)

    def add(self, item: StreamElement) -> None:
        self.ranked.add(item.values[self.at], item)

    def remove(self, item: StreamElement) -> None:
        self.ranked.remove(item)

    def result(self, members: Members, number: int) -> Optional[Term]:
        return self.ranked.value()


class _First(_Plain):
    def result(self, members: Members, number: int) -> Optional[Term]:
        value: Term = next(live(members)).values[self.at]
        return value


class _Last(_Plain):
    def result(self, members: Members, number: int) -> Optional[Term]:
        value: Term = next(item for item in reversed(members) if not item.gone).values[self.at]
        return value


class _List(_Plain):
    of_none = True
    lists = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        return make_list([item.values[self.at] for item in live(members)])


class _CountDistinct(_Plain):
    of_none = True

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.numbers: Dict[Hashable, int] = {}

    def add(self, item: StreamElement) -> None:
        key = term_key(item.values[self.at])
        self.numbers[key] = self.numbers.get(key, 0) + 1

    def remove(self, item: StreamElement) -> None:
        key = term_key(item.values[self.at])
        self.numbers[key] -= 1
        if not self.numbers[key]:
            del self.numbers[key]

    def result(self, members: Members, number: int) -> Optional[Term]:
        return len(self.numbers)


class _Alike:
    """The items of one value, in the order in which they came in; the first that is not gone is at ``at``."""

    __slots__ = ("items", "at", "live")

    def __init__(self) -> None:
        self.items: List[Tuple[int, StreamElement]] = []
        self.at = 0
        self.live = 0

    def add(self, order: int, item: StreamElement) -> None:
        self.items.append((order, item))
        self.live += 1

    def left(self) -> None:
        """Take note that one of them is gone."""
        self.live -= 1
        items = self.items
        if len(items) > 2 * self.live + 16:
            self.items = items = [one for one in items if not one[1].gone]
            self.at = 0
        while self.at < len(items) and items[self.at][1].gone:
            self.at += 1

    def first(self) -> Tuple[int, StreamElement]:
        """Return the oldest with its place among all that came in; there has to be one."""
        return self.items[self.at]


class _Distinct(_Plain):
    """The values that are different; looks at each of them once, however many items have it."""

    of_none = True
    lists = True

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.alike: Dict[Hashable, _Alike] = {}
        self._order = 0

    def add(self, item: StreamElement) -> None:
        self._order += 1
        self.alike.setdefault(term_key(item.values[self.at]), _Alike()).add(self._order, item)

    def remove(self, item: StreamElement) -> None:
        key = term_key(item.values[self.at])
        same = self.alike[key]
        same.left()
        if not same.live:
            del self.alike[key]

    def result(self, members: Members, number: int) -> Optional[Term]:
        firsts = sorted([same.first() for same in self.alike.values()], key=_place)
        return make_list([item.values[self.at] for _, item in firsts])


def _place(entry: Tuple[int, StreamElement]) -> int:
    return entry[0]


class _Rate(_Plain):
    """The number of items per second, rounded once.

    The seconds are those of the window (``setting``), else those between the first end and the last.
    """

    def __init__(self, at: int, name: str, setting: Setting):
        super().__init__(at, name, setting)
        self.seconds = Fraction(setting) if setting else None
        self.first, self.last = Lowest(), Lowest()

    def add(self, item: StreamElement) -> None:
        if self.seconds is None:
            self.first.add(item.end, item)
            self.last.add(-item.end, item)

    def remove(self, item: StreamElement) -> None:
        if self.seconds is None:
            self.first.remove()
            self.last.remove()

    def result(self, members: Members, number: int) -> Optional[Term]:
        if self.seconds is not None:
            return number * self.seconds.denominator / self.seconds.numerator
        low, high = self.first.top(), self.last.top()
        assert low is not None and high is not None  # there is an item
        span = high[2].end - low[2].end
        return (number - 1) * SECOND / span if span else None


class _Fold(_Plain):
    """A program's own measure: ``setting`` gives the result of the values, oldest first."""

    lists = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        found: Optional[Term] = self.setting([item.values[self.at] for item in live(members)])
        return found


class AccumulatorKind(NamedTuple):
    """A kind of measure.

    Attributes:
        form: how rules write it; the last argument is what is measured.
        settings: how many arguments come before that.
        takes: whether it is of a value of each item.
        numeric: whether values have to be numbers.
        make: makes one from the place of its value among those of an item, its name, and what it is set to.
    """

    form: str
    settings: int
    takes: bool
    numeric: bool
    make: Callable[[int, str, Any], Any]


MEASURES: Dict[str, AccumulatorKind] = {
    "count": AccumulatorKind("count", 0, False, False, _Count),
    "sum": AccumulatorKind("sum(X)", 0, True, True, _Sum),
    "min": AccumulatorKind("min(X)", 0, True, True, _Least),
    "max": AccumulatorKind("max(X)", 0, True, True, _Greatest),
    "avg": AccumulatorKind("avg(X)", 0, True, True, _Average),
    "stddev": AccumulatorKind("stddev(X)", 0, True, True, _Deviation),
    "median": AccumulatorKind("median(X)", 0, True, True, lambda at, name, _: _Quantile(at, name, 0.5)),
    "quantile": AccumulatorKind("quantile(P, X)", 1, True, True, _Quantile),
    "first": AccumulatorKind("first(X)", 0, True, False, _First),
    "last": AccumulatorKind("last(X)", 0, True, False, _Last),
    "list": AccumulatorKind("list(X)", 0, True, False, _List),
    "distinct": AccumulatorKind("distinct(X)", 0, True, False, _Distinct),
    "count_distinct": AccumulatorKind("count_distinct(X)", 0, True, False, _CountDistinct),
    "rate": AccumulatorKind("rate", 0, False, False, _Rate),
    "fold": AccumulatorKind("fold(Init, Step, Result, X)", 3, True, False, _Fold),
}
"""By their names."""
