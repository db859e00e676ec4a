"""Accumulators of window aggregates: incremental state of ``sum``, ``median``, ``rate`` and the other measures.

An accumulator is updated when an element enters or leaves a window, so the cost of a result does not grow with the
window, except for measures that list their values. Three structures make removal possible:

* `ExactSum` holds a sum of floats as an integer over a power of two. Adding and removing are exact, and only the
  result is rounded, so errors do not build up in a window that slides for days.
* `Lowest` is a heap with lazy deletion for minimum and maximum.
* `Ranked` is a pair of heaps around a quantile.

`sum`, `avg`, `min` and `max` of arrays are computed element by element from the arrays of the window: removing floats
from running sums would let errors build up, and an `ExactSum` for each element takes longer than adding the arrays.

`MEASURES` is the table of all measures.
"""

import heapq
from fractions import Fraction
from math import inf, isfinite, isqrt, nan, sqrt
from typing import (
    TYPE_CHECKING,
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

from ...foundation.errors import RuleError, UsageError, beginning, counted
from ...prolog.builtins.argument_checks import array_of
from ...prolog.machine.arithmetic import EVALUABLE
from ...prolog.machine.errors import PrologError
from ...prolog.syntax.term_writer import write_term
from ...prolog.terms import timestamps
from ...prolog.terms.array_terms import array_term, element_count, list_array
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.timestamps import SECOND
from ...prolog.terms.types import CONS, NIL, Term, deref
from .stream_operator import StreamElement

if TYPE_CHECKING:
    from ...prolog.terms.array_terms import Array

Number = Union[int, float]
_SMALL, _LARGE = 1e-290, 1e290
_MAX_BITS = 1024
_MAX_INTEGER = (1 << 63) - 1


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


ADDING = frozenset(("sum", "avg", "stddev"))
"""Aggregates that add their values; these may be arithmetic expressions such as ``1 + 2``."""


_NUMBER_CLASSES = (int, float)

ELEMENTWISE = frozenset(("sum", "avg", "min", "max"))
"""Measures of windows that take arrays as well as numbers."""


def unfit(name: str, value: Term, expected: str = "a number") -> RuleError:
    """Return the error for a value that an aggregate cannot process."""
    return RuleError(f"aggregate {name}: the value is '{beginning(write_term(value))}': expected {expected}")


def check_finite(value: Any, name: str) -> None:
    """Reject a value that cannot be added.

    Raises:
        RuleError: if the value is not a finite number.
    """
    if not isinstance(value, (int, float)):
        raise unfit(name, value)
    if value.__class__ is float and not isfinite(value):
        raise unfit(name, value, "a finite number")


def check_ordered(value: Any, name: str) -> None:
    """Reject a value that has no order among numbers.

    Raises:
        RuleError: if the value is not a number, or is nan.
    """
    if not isinstance(value, (int, float)) or value != value:
        raise unfit(name, value)


def is_number(value: Term) -> bool:
    """Return whether a value is a number, or a timestamp, which counts as its number of seconds."""
    term: Any = deref(value)
    if term.__class__ in (int, float):
        return True
    if term.__class__ is not tuple:
        # Atoms such as `e` and strings of one character are expressions, but not numbers.
        return False
    try:
        timestamps.from_any(term)
    except UsageError:
        return False
    return True


def is_number_expression(value: Term) -> bool:
    """Return whether a value is a number, or an arithmetic expression of numbers."""
    stack = [value]
    seen: Set[int] = set()
    while stack:
        term: Any = deref(stack.pop())
        if is_number(term) or id(term) in seen:
            continue
        if term.__class__ is not tuple or term[0] not in EVALUABLE:
            return False
        # Shared subterms are visited once.
        seen.add(id(term))
        stack.extend(term[1:])
    return True


def array_length(value: Term) -> Optional[int]:
    """Return the number of elements of an array: an array term or a list of numbers; None for other terms.

    A timestamp [Sec,NSec] counts as a number, not as an array.
    """
    lazy = list_array(value)
    if lazy is not None:
        return element_count(lazy)
    term: Any = deref(value)
    if term is NIL:
        return 0
    if term.__class__ is not tuple or term[0] is not CONS or is_number(term):
        return None
    items = list_items(term)
    are_numbers = items is not None and all(deref(item).__class__ in (int, float) for item in items)
    return len(items) if items is not None and are_numbers else None


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


Setting = Any
"""Setting of a measure: a number, or a function that calls predicates of the program; None for most measures."""
Members = Deque[StreamElement]
"""Elements of a window in order of arrival; elements marked as gone may remain for a while."""


def live(members: Members) -> Iterator[StreamElement]:
    """Yield the elements that are in the window, the oldest first."""
    return (item for item in members if not item.gone)


class Accumulator(Protocol):
    """Incremental state of one measure for one window.

    `check` is called for all measures before an element is added to any of them, so a rejected value leaves no
    accumulator half updated.

    Attributes:
        picky: whether `check` rejects some values.
        of_none: whether an empty window has a result.
        lists: whether computing the result visits every element.
    """

    picky: bool
    of_none: bool
    lists: bool

    def check(self, item: StreamElement, /) -> None:
        """Reject the value of an element.

        Raises:
            RuleError: if the measure cannot process the value.
        """

    def add(self, item: StreamElement, /) -> Optional[bool]:
        """Add an element; return True if its value is an array."""

    def remove(self, item: StreamElement, /) -> None:
        """Remove an element that is marked as gone."""

    def result(self, members: Members, number: int, /) -> Optional[Term]:
        """Return the result, or None if there is none.

        Args:
            members: the elements.
            number: number of elements that are not gone; at least 1 unless `of_none`.
        """


class _StatelessMeasure:
    """Base class, for measures without state of their own."""

    picky = False
    of_none = False
    lists = False

    def __init__(self, index: int, name: str, setting: Setting):
        self.index = index
        self.name = name
        self.setting = setting

    def check(self, item: StreamElement) -> None:
        """See `Accumulator.check`."""

    def add(self, item: StreamElement) -> Optional[bool]:
        """See `Accumulator.add`."""
        return None

    def remove(self, item: StreamElement) -> None:
        """See `Accumulator.remove`."""


class _Count(_StatelessMeasure):
    of_none = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        return number


class _ElementwiseMeasure(_StatelessMeasure):
    """Base class, for measures whose values are numbers, or arrays of equal length.

    Attributes:
        arrays: number of elements whose value is an array.
        length: number of elements of these arrays.
    """

    picky = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.arrays = 0
        self.length = 0

    def check_array(self, value: Term) -> None:
        """Reject the value of an element unless it is an array like those of the window, if any.

        Raises:
            RuleError: if the measure cannot process the value.
        """
        length = array_length(value) if self.name in ELEMENTWISE else None
        if self.arrays and length != self.length:
            raise unfit(self.name, value, f"an array of {counted(self.length, 'element')}")
        if length is None:
            raise unfit(self.name, value)

    def add_array(self, value: Term) -> bool:
        """Add an array."""
        self.arrays += 1
        self.length = array_length(value) or 0
        return True

    def result(self, members: Members, number: int) -> Optional[Term]:
        if not self.arrays:
            return self.result_of_numbers(number)
        try:
            arrays = [array_of(item.values[self.index]) for item in live(members)]
        except PrologError:
            raise RuleError(f"aggregate {self.name}: a window has both numbers and arrays") from None
        if len({len(array) for array in arrays}) > 1:
            raise RuleError(f"aggregate {self.name}: a window has arrays of different lengths")
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        # Elements that are nan or infinite, as in many scans, stay what they are.
        with np.errstate(all="ignore"):
            return array_term(self.combine(arrays))

    def result_of_numbers(self, number: int) -> Optional[Term]:
        """Return the result of a window of numbers; see `result`."""

    def combine(self, arrays: "List[Array]") -> "Array":
        """Return the result of a window of arrays."""
        raise NotImplementedError


def _sum_of_arrays(arrays: "List[Array]") -> "Array":
    """Return the sum of arrays of equal length: of integers if all are, otherwise of doubles.

    Raises:
        OverflowError: if an integer may be too large.
    """
    # Ends of an array of unsigned integers as Python integers, which do not overflow.
    bound = 0
    if all(array.dtype.kind != "f" for array in arrays):
        for array in arrays:
            bound += max(abs(int(array.min())), abs(int(array.max()))) if len(array) else 0
        if bound > _MAX_INTEGER:
            raise OverflowError
        total = arrays[0].astype("i8")
    else:
        total = arrays[0].astype("f8")
    for array in arrays[1:]:
        total += array.astype(total.dtype, copy=False)
    return total


class _Sum(_ElementwiseMeasure):
    of_none = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.sum = ExactSum()

    def check(self, item: StreamElement) -> None:
        value = item.values[self.index]
        if self.arrays or value.__class__ not in _NUMBER_CLASSES:
            self.check_array(value)
        else:
            check_finite(value, self.name)

    def add(self, item: StreamElement) -> Optional[bool]:
        value = item.values[self.index]
        if value.__class__ not in _NUMBER_CLASSES:
            return self.add_array(value)
        self.sum.change(value, 1)
        return None

    def remove(self, item: StreamElement) -> None:
        value = item.values[self.index]
        if value.__class__ in _NUMBER_CLASSES:
            self.sum.change(value, -1)
        else:
            self.arrays -= 1

    def result_of_numbers(self, number: int) -> Optional[Term]:
        return self.sum.over(1, number)

    def combine(self, arrays: "List[Array]") -> "Array":
        return _sum_of_arrays(arrays)


class _Average(_Sum):
    of_none = False

    def result_of_numbers(self, number: int) -> Optional[Term]:
        return self.sum.over(number, number)

    def combine(self, arrays: "List[Array]") -> "Array":
        return _sum_of_arrays(arrays) / len(arrays)


class _Deviation(_Sum):
    of_none = False

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.squares = ExactSum()

    def _square(self, item: StreamElement, by: int) -> None:
        over, under = item.values[self.index].as_integer_ratio()
        self.squares.change_fraction(over * over, 2 * (under.bit_length() - 1), by)

    def add(self, item: StreamElement) -> Optional[bool]:
        super().add(item)
        self._square(item, 1)
        return None

    def remove(self, item: StreamElement) -> None:
        super().remove(item)
        self._square(item, -1)

    def result_of_numbers(self, number: int) -> Optional[Term]:
        return deviation(self.sum, self.squares, number) if number > 1 else None


class _Minimum(_ElementwiseMeasure):
    sign = 1

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.lowest = Lowest()

    def check(self, item: StreamElement) -> None:
        value = item.values[self.index]
        if self.arrays or value.__class__ not in _NUMBER_CLASSES:
            self.check_array(value)
        else:
            check_ordered(value, self.name)

    def add(self, item: StreamElement) -> Optional[bool]:
        value = item.values[self.index]
        if value.__class__ not in _NUMBER_CLASSES:
            return self.add_array(value)
        self.lowest.add(self.sign * value, item)
        return None

    def remove(self, item: StreamElement) -> None:
        if item.values[self.index].__class__ in _NUMBER_CLASSES:
            self.lowest.remove()
        else:
            self.arrays -= 1

    def result_of_numbers(self, number: int) -> Optional[Term]:
        top = self.lowest.top()
        return None if top is None else top[2].values[self.index]

    def combine(self, arrays: "List[Array]") -> "Array":
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        result: Array = np.fmin.reduce(arrays)
        return result


class _Maximum(_Minimum):
    sign = -1

    def combine(self, arrays: "List[Array]") -> "Array":
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        result: Array = np.fmax.reduce(arrays)
        return result


class _Quantile(_StatelessMeasure):
    picky = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.ranked = Ranked(setting)

    def check(self, item: StreamElement) -> None:
        check_finite(item.values[self.index], self.name)

    def add(self, item: StreamElement) -> None:
        self.ranked.add(item.values[self.index], item)

    def remove(self, item: StreamElement) -> None:
        self.ranked.remove(item)

    def result(self, members: Members, number: int) -> Optional[Term]:
        return self.ranked.value()


class _First(_StatelessMeasure):
    def result(self, members: Members, number: int) -> Optional[Term]:
        value: Term = next(live(members)).values[self.index]
        return value


class _Last(_StatelessMeasure):
    def result(self, members: Members, number: int) -> Optional[Term]:
        value: Term = next(item for item in reversed(members) if not item.gone).values[self.index]
        return value


class _List(_StatelessMeasure):
    of_none = True
    lists = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        return make_list([item.values[self.index] for item in live(members)])


class _CountDistinct(_StatelessMeasure):
    of_none = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.numbers: Dict[Hashable, int] = {}

    def add(self, item: StreamElement) -> None:
        key = term_key(item.values[self.index])
        # A count per value: a value leaves when its last element does.
        self.numbers[key] = self.numbers.get(key, 0) + 1

    def remove(self, item: StreamElement) -> None:
        key = term_key(item.values[self.index])
        self.numbers[key] -= 1
        if not self.numbers[key]:
            del self.numbers[key]

    def result(self, members: Members, number: int) -> Optional[Term]:
        return len(self.numbers)


class _EqualValues:
    """Elements with one value in order of arrival; the first that is not gone has the index ``at``."""

    __slots__ = ("items", "at", "live")

    def __init__(self) -> None:
        self.items: List[Tuple[int, StreamElement]] = []
        self.at = 0
        self.live = 0

    def add(self, order: int, item: StreamElement) -> None:
        self.items.append((order, item))
        self.live += 1

    def count_removal(self) -> None:
        """Count an element that is gone."""
        self.live -= 1
        items = self.items
        # Elements leave mostly in order, so the index advances; compaction is for those that leave in between.
        if len(items) > 2 * self.live + 16:
            self.items = items = [entry for entry in items if not entry[1].gone]
            self.at = 0
        while self.at < len(items) and items[self.at][1].gone:
            self.at += 1

    def first(self) -> Tuple[int, StreamElement]:
        """Return the oldest element with its order of arrival; there must be one."""
        return self.items[self.at]


class _Distinct(_StatelessMeasure):
    """List of distinct values; each value is visited once, however many elements have it."""

    of_none = True
    lists = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.alike: Dict[Hashable, _EqualValues] = {}
        self._order = 0

    def add(self, item: StreamElement) -> None:
        self._order += 1
        self.alike.setdefault(term_key(item.values[self.index]), _EqualValues()).add(self._order, item)

    def remove(self, item: StreamElement) -> None:
        key = term_key(item.values[self.index])
        same_value = self.alike[key]
        same_value.count_removal()
        if not same_value.live:
            del self.alike[key]

    def result(self, members: Members, number: int) -> Optional[Term]:
        # In the order of first occurrence, as a list of distinct values is expected to be.
        firsts = sorted([same_value.first() for same_value in self.alike.values()], key=_place)
        return make_list([item.values[self.index] for _, item in firsts])


def _place(entry: Tuple[int, StreamElement]) -> int:
    return entry[0]


class _Rate(_StatelessMeasure):
    """Number of elements per second, rounded once.

    The duration is that of the window (``setting``), or else the time from the first end to the last one.
    """

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.seconds = Fraction(setting) if setting else None
        self.first, self.last = Lowest(), Lowest()

    def add(self, item: StreamElement) -> None:
        if self.seconds is None:
            # The first and last end are kept in heaps, because elements may arrive out of order.
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
        # The window is not empty.
        assert low is not None and high is not None
        # n elements span n - 1 intervals.
        span = high[2].end - low[2].end
        return (number - 1) * SECOND / span if span else None


class _Fold(_StatelessMeasure):
    """Aggregate that the program defines: ``setting`` computes the result from the values, oldest first."""

    lists = True

    def result(self, members: Members, number: int) -> Optional[Term]:
        result: Optional[Term] = self.setting([item.values[self.index] for item in live(members)])
        return result


class AccumulatorKind(NamedTuple):
    """Kind of measure.

    Attributes:
        form: notation in rules; the last argument is the measured value.
        settings: number of arguments before the measured value.
        takes: whether elements have a measured value.
        numeric: whether the values must be numbers.
        make: creates an accumulator from the index of its value in an element, its name and its setting.
    """

    form: str
    settings: int
    takes: bool
    numeric: bool
    make: Callable[[int, str, Any], Any]


MEASURES: Dict[str, AccumulatorKind] = {
    "count": AccumulatorKind("count", 0, False, False, _Count),
    "sum": AccumulatorKind("sum(X)", 0, True, True, _Sum),
    "min": AccumulatorKind("min(X)", 0, True, True, _Minimum),
    "max": AccumulatorKind("max(X)", 0, True, True, _Maximum),
    "avg": AccumulatorKind("avg(X)", 0, True, True, _Average),
    "stddev": AccumulatorKind("stddev(X)", 0, True, True, _Deviation),
    "median": AccumulatorKind("median(X)", 0, True, True, lambda index, name, _: _Quantile(index, name, 0.5)),
    "quantile": AccumulatorKind("quantile(P, X)", 1, True, True, _Quantile),
    "first": AccumulatorKind("first(X)", 0, True, False, _First),
    "last": AccumulatorKind("last(X)", 0, True, False, _Last),
    "list": AccumulatorKind("list(X)", 0, True, False, _List),
    "distinct": AccumulatorKind("distinct(X)", 0, True, False, _Distinct),
    "count_distinct": AccumulatorKind("count_distinct(X)", 0, True, False, _CountDistinct),
    "rate": AccumulatorKind("rate", 0, False, False, _Rate),
    "fold": AccumulatorKind("fold(Init, Step, Result, X)", 3, True, False, _Fold),
}
"""Measures by name."""
