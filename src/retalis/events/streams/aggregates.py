"""Aggregate functions: the table of all of them, and their implementations.

`AGGREGATES` is read by the parser, the checks and the network. An aggregate function has two implementations:

* An `Accumulator` is its incremental state for a window. It is updated when an element enters or leaves the window,
  so the cost of a result does not grow with the window, except for aggregates that list their values. The structures
  that make removal possible are those of `running_statistics`.
* A `Fold` is its form for repeated events (``P seq aggregate(K, Q, R)``), see `repetition_folds`.

A `ValueRule` states which values an aggregate accepts.

Aggregates of arrays, from `sum` to `quantile`, are computed element by element from the arrays of the window:
removing floats from running sums would let errors build up, and an `ExactSum` for each element takes longer than
adding the arrays.
"""

from fractions import Fraction
from math import isfinite
from operator import itemgetter
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
    Set,
    Tuple,
    Type,
    Union,
)

from ...foundation.displayed_text import format_count, shorten
from ...foundation.errors import RuleError, UsageError
from ...prolog.builtins.argument_checks import array_of
from ...prolog.machine.arithmetic import EVALUABLE
from ...prolog.syntax.term_writer import write_term
from ...prolog.terms import timestamps
from ...prolog.terms.array_terms import array_term, element_count, list_array
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.timestamps import SECOND
from ...prolog.terms.types import CONS, NIL, Term, Values, deref
from ...serialization.stored_field_types import (
    COUNT,
    FINITE,
    ORDERED,
    optional,
    tuple_of,
)
from .repetition_folds import (
    CHANGES_FOLD,
    COUNT_DISTINCT_FOLD,
    DEVIATION_FOLD,
    DISTINCT_FOLD,
    FIRST_FOLD,
    LAST_FOLD,
    LIST_FOLD,
    RATE_FOLD,
    Fold,
    add_finite,
    choose_larger,
    choose_smaller,
    compute_average,
    get_state,
    make_quantile_fold,
    make_user_fold,
)
from .running_statistics import ExactSum, LazyMinHeap, QuantileHeaps, standard_deviation
from .stream_operators import StreamElement

if TYPE_CHECKING:
    from ...prolog.terms.array_terms import Array

_MAX_INTEGER = (1 << 63) - 1
_NUMBER_CLASSES = (int, float)


def value_error(name: str, value: Term, expected: str = "a number") -> RuleError:
    """Return the error for a value that an aggregate cannot process."""
    return RuleError(f"aggregate {name}: the value is '{shorten(write_term(value))}': expected {expected}")


def check_finite(value: Any, name: str) -> None:
    """Reject a value that cannot be added.

    Raises:
        RuleError: if the value is not a finite number.
    """
    if not isinstance(value, (int, float)):
        raise value_error(name, value)
    if value.__class__ is float and not isfinite(value):
        raise value_error(name, value, "a finite number")


def check_ordered(value: Any, name: str) -> None:
    """Reject a value that has no order among numbers.

    Raises:
        RuleError: if the value is not a number, or is nan.
    """
    if not isinstance(value, (int, float)) or value != value:
        raise value_error(name, value)


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
    visited_ids: Set[int] = set()
    while stack:
        term: Any = deref(stack.pop())
        if is_number(term) or id(term) in visited_ids:
            continue
        if term.__class__ is not tuple or term[0] not in EVALUABLE:
            return False
        # Shared subterms are visited once.
        visited_ids.add(id(term))
        stack.extend(term[1:])
    return True


def array_length(value: Term) -> Optional[int]:
    """Return the number of elements of an array: an array term or a list of numbers; None for other terms.

    A timestamp [Sec,NSec] counts as a number, not as an array.
    """
    array = list_array(value)
    if array is not None:
        return element_count(array)
    term: Any = deref(value)
    if term is NIL:
        return 0
    if term.__class__ is not tuple or term[0] is not CONS or is_number(term):
        return None
    items = list_items(term)
    are_numbers = items is not None and all(deref(item).__class__ in _NUMBER_CLASSES for item in items)
    return len(items) if items is not None and are_numbers else None


class ValueRule(NamedTuple):
    """Values that an aggregate accepts.

    Attributes:
        check: raises an error for an unsuitable value, given the value and the name of the aggregate; None if every
            term is suitable.
        accepts_expressions: whether a variable may be bound to an arithmetic expression of numbers, such as
            ``1 + 2``, instead of a number.
    """

    check: Optional[Callable[[Any, str], None]]
    accepts_expressions: bool = False


ANY_TERM = ValueRule(None)
SUMMAND = ValueRule(check_finite, True)
FINITE_NUMBER = ValueRule(check_finite)
COMPARABLE_NUMBER = ValueRule(check_ordered)


Setting = Any
"""Setting of an aggregate: a number, or a function that calls predicates of the program; None for most of them."""
WindowElements = Deque[StreamElement]
"""Elements of a window in order of arrival; elements marked as removed may remain for a while."""


def present_elements(elements: WindowElements) -> Iterator[StreamElement]:
    """Yield the elements that are in the window, the oldest first."""
    return (element for element in elements if not element.is_removed)


class Accumulator:
    """Incremental state of one aggregate for one window; this base class has no state.

    `check` is called for all aggregates before an element is added to any of them, so a rejected value leaves no
    accumulator half updated.

    Attributes:
        index: index of the aggregated value in `StreamElement.values`.
        setting: see `Setting`.
        value_rule: the values that the aggregate accepts.
        accepts_arrays: whether arrays are accepted as well as numbers.
        accepts_empty: whether an empty window has a result.
        array_count: number of elements of the window whose value is an array.
        scans_window: whether the computation of the result visits every element.
    """

    value_rule = ANY_TERM
    accepts_arrays = False
    accepts_empty = False
    scans_window = False
    array_count = 0

    def __init__(self, index: int, name: str, setting: Setting):
        self.index = index
        self.name = name
        self.setting = setting

    @property
    def checks_values(self) -> bool:
        """True if `check` rejects some values."""
        return self.value_rule.check is not None

    def check(self, element: StreamElement) -> Optional[bool]:
        """Check the value of an element; return True if it is an array.

        Raises:
            RuleError: if the aggregate cannot process the value.
        """
        check = self.value_rule.check
        if check is not None:
            check(element.values[self.index], self.name)
        return None

    def add(self, element: StreamElement) -> Optional[bool]:
        """Add an element; return True if its value is an array."""
        return None

    def remove(self, element: StreamElement) -> None:
        """Remove an element that is marked as removed."""

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        """Return the result, or None if there is none.

        Args:
            elements: the elements.
            count: number of elements that were not removed; at least 1 unless `accepts_empty`.
        """
        raise NotImplementedError


class _CountAccumulator(Accumulator):
    accepts_empty = True

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        return count


class _ElementwiseAccumulator(Accumulator):
    """Base class, for aggregates whose values are numbers, or arrays of equal length.

    Attributes:
        array_length: length of the arrays of the window.
        check_number: raises an error if a number is not suitable; takes the number and the name of the aggregate.
    """

    accepts_arrays = True
    check_number = staticmethod(check_finite)

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.array_count = 0
        self.array_length = 0

    def check(self, element: StreamElement) -> Optional[bool]:
        value = element.values[self.index]
        if self.array_count or value.__class__ not in _NUMBER_CLASSES:
            return self.check_array(value)
        self.check_number(value, self.name)
        return None

    def check_array(self, value: Term) -> bool:
        """Return True if the value of an element is an array like those of the window, if any; else reject it.

        Raises:
            RuleError: if the aggregate cannot process the value.
        """
        length = array_length(value)
        if self.array_count and length != self.array_length:
            raise value_error(self.name, value, f"an array of {format_count(self.array_length, 'element')}")
        if length is None:
            raise value_error(self.name, value)
        return True

    def add_array(self, value: Term) -> bool:
        """Add an array."""
        self.array_count += 1
        self.array_length = array_length(value) or 0
        return True

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        if not self.array_count:
            return self.result_of_numbers(count)
        values = [element.values[self.index] for element in present_elements(elements)]
        # A row pattern checks its elements one by one, so elements that do not fit together are detected here.
        if len(values) > self.array_count:
            array = next(value for value in values if value.__class__ not in _NUMBER_CLASSES)
            raise value_error(self.name, array)
        arrays = list(map(array_of, values))
        if len({len(array) for array in arrays}) > 1:
            raise RuleError(f"aggregate {self.name}: a window has arrays of different lengths")
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        # nan and infinite values, which many scans contain, are propagated as numpy does, without warnings.
        with np.errstate(all="ignore"):
            return array_term(self.combine(arrays))

    def result_of_numbers(self, count: int) -> Optional[Term]:
        """Return the result of a window of numbers; see `result`."""

    def combine(self, arrays: "List[Array]") -> "Array":
        """Return the result of a window of arrays."""
        raise NotImplementedError


def _add_arrays(arrays: "List[Array]") -> "Array":
    """Return the sum of arrays of equal length: of integers if all are, otherwise of doubles.

    Raises:
        OverflowError: if an integer may be too large.
    """
    # The minimum and maximum are converted to Python integers, because `abs` of a fixed-size integer can overflow.
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


class _SumAccumulator(_ElementwiseAccumulator):
    value_rule = SUMMAND
    accepts_empty = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.sum = ExactSum()

    def add(self, element: StreamElement) -> Optional[bool]:
        value = element.values[self.index]
        if value.__class__ not in _NUMBER_CLASSES:
            return self.add_array(value)
        self.sum.add_multiple(value, 1)
        return None

    def remove(self, element: StreamElement) -> None:
        value = element.values[self.index]
        if value.__class__ in _NUMBER_CLASSES:
            self.sum.add_multiple(value, -1)
        else:
            self.array_count -= 1

    def result_of_numbers(self, count: int) -> Optional[Term]:
        return self.sum.quotient(1, count)

    def combine(self, arrays: "List[Array]") -> "Array":
        return _add_arrays(arrays)


class _AverageAccumulator(_SumAccumulator):
    accepts_empty = False

    def result_of_numbers(self, count: int) -> Optional[Term]:
        return self.sum.quotient(count, count)

    def combine(self, arrays: "List[Array]") -> "Array":
        return _add_arrays(arrays) / len(arrays)


class _DeviationAccumulator(_SumAccumulator):
    accepts_empty = False

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.squares = ExactSum()

    def _add_square(self, element: StreamElement, times: int) -> None:
        numerator, denominator = element.values[self.index].as_integer_ratio()
        self.squares.add_fraction(numerator * numerator, 2 * (denominator.bit_length() - 1), times)

    def add(self, element: StreamElement) -> Optional[bool]:
        is_array = super().add(element)
        if not is_array:
            self._add_square(element, 1)
        return is_array

    def remove(self, element: StreamElement) -> None:
        super().remove(element)
        if element.values[self.index].__class__ in _NUMBER_CLASSES:
            self._add_square(element, -1)

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        return super().result(elements, count) if count > 1 else None

    def result_of_numbers(self, count: int) -> Optional[Term]:
        return standard_deviation(self.sum, self.squares, count)

    def combine(self, arrays: "List[Array]") -> "Array":
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        result: Array = np.std(np.stack(arrays).astype("f8", copy=False), axis=0, ddof=1)
        return result


class _MinimumAccumulator(_ElementwiseAccumulator):
    value_rule = COMPARABLE_NUMBER
    check_number = staticmethod(check_ordered)
    sign = 1

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.heap = LazyMinHeap()

    def add(self, element: StreamElement) -> Optional[bool]:
        value = element.values[self.index]
        if value.__class__ not in _NUMBER_CLASSES:
            return self.add_array(value)
        self.heap.add(self.sign * value, element)
        return None

    def remove(self, element: StreamElement) -> None:
        if element.values[self.index].__class__ in _NUMBER_CLASSES:
            self.heap.remove()
        else:
            self.array_count -= 1

    def result_of_numbers(self, count: int) -> Optional[Term]:
        top = self.heap.top()
        return None if top is None else top[2].values[self.index]

    def combine(self, arrays: "List[Array]") -> "Array":
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        result: Array = np.fmin.reduce(arrays)
        return result


class _MaximumAccumulator(_MinimumAccumulator):
    sign = -1

    def combine(self, arrays: "List[Array]") -> "Array":
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        result: Array = np.fmax.reduce(arrays)
        return result


class _QuantileAccumulator(_ElementwiseAccumulator):
    value_rule = FINITE_NUMBER

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.heaps = QuantileHeaps(setting)

    def add(self, element: StreamElement) -> Optional[bool]:
        value = element.values[self.index]
        if value.__class__ not in _NUMBER_CLASSES:
            return self.add_array(value)
        self.heaps.add(value, element)
        return None

    def remove(self, element: StreamElement) -> None:
        if element.values[self.index].__class__ in _NUMBER_CLASSES:
            self.heaps.remove(element)
        else:
            self.array_count -= 1

    def result_of_numbers(self, count: int) -> Optional[Term]:
        return self.heaps.value()

    def combine(self, arrays: "List[Array]") -> "Array":
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        rows = np.sort(np.stack(arrays).astype("f8", copy=False), axis=0)
        rank = self.heaps.quantile * (len(rows) - 1)
        lower, fraction = rows[int(rank)], rank - int(rank)
        if fraction:
            upper = rows[int(rank) + 1]
            # The comparison keeps infinity between two infinite numbers.
            lower = np.where(lower == upper, lower, lower * (1 - fraction) + upper * fraction)
        # nan comes last.
        result: Array = np.where(np.isnan(rows[-1]), np.nan, lower)
        return result


class _MedianAccumulator(_QuantileAccumulator):
    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, 0.5)


class _FirstAccumulator(Accumulator):
    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        value: Term = next(present_elements(elements)).values[self.index]
        return value


class _LastAccumulator(Accumulator):
    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        value: Term = next(element for element in reversed(elements) if not element.is_removed).values[
            self.index
        ]
        return value


class _ListAccumulator(Accumulator):
    accepts_empty = True
    scans_window = True

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        return make_list([element.values[self.index] for element in present_elements(elements)])


class _CountDistinctAccumulator(Accumulator):
    accepts_empty = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.counts: Dict[Hashable, int] = {}

    def add(self, element: StreamElement) -> None:
        key = term_key(element.values[self.index])
        # A value is removed when its last element is removed.
        self.counts[key] = self.counts.get(key, 0) + 1

    def remove(self, element: StreamElement) -> None:
        key = term_key(element.values[self.index])
        self.counts[key] -= 1
        if not self.counts[key]:
            del self.counts[key]

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        return len(self.counts)


class _ElementsWithValue:
    """Elements with one value in order of arrival.

    Attributes:
        entries: order of arrival and element, also of some elements that were removed.
        first_index: index of the first entry whose element was not removed.
        count: number of elements that were not removed.
    """

    __slots__ = ("entries", "first_index", "count")

    def __init__(self) -> None:
        self.entries: List[Tuple[int, StreamElement]] = []
        self.first_index = 0
        self.count = 0

    def add(self, order: int, element: StreamElement) -> None:
        self.entries.append((order, element))
        self.count += 1

    def count_removal(self) -> None:
        """Count an element that was removed."""
        self.count -= 1
        entries = self.entries
        # Elements leave mostly in order, so the index advances; compaction is for those that leave in between.
        if len(entries) > 2 * self.count + 16:
            self.entries = entries = [entry for entry in entries if not entry[1].is_removed]
            self.first_index = 0
        while self.first_index < len(entries) and entries[self.first_index][1].is_removed:
            self.first_index += 1

    def first(self) -> Tuple[int, StreamElement]:
        """Return the oldest element with its order of arrival; there must be one."""
        return self.entries[self.first_index]


class _DistinctAccumulator(Accumulator):
    """List of distinct values; each value is visited once, however many elements have it."""

    accepts_empty = True
    scans_window = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.by_value: Dict[Hashable, _ElementsWithValue] = {}
        self._order = 0

    def add(self, element: StreamElement) -> None:
        self._order += 1
        self.by_value.setdefault(term_key(element.values[self.index]), _ElementsWithValue()).add(
            self._order, element
        )

    def remove(self, element: StreamElement) -> None:
        key = term_key(element.values[self.index])
        elements_with_value = self.by_value[key]
        elements_with_value.count_removal()
        if not elements_with_value.count:
            del self.by_value[key]

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        # In the order of first occurrence, as a list of distinct values is expected to be.
        first_elements = sorted(
            [elements_with_value.first() for elements_with_value in self.by_value.values()],
            key=itemgetter(0),
        )
        return make_list([element.values[self.index] for _, element in first_elements])


class _RateAccumulator(Accumulator):
    """Number of elements per second, rounded once.

    The duration is that of the window (``setting``), or else the time from the first end to the last one.
    """

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.seconds = Fraction(setting) if setting else None
        self.earliest_ends, self.latest_ends = LazyMinHeap(), LazyMinHeap()

    def add(self, element: StreamElement) -> None:
        if self.seconds is None:
            # The first and last end are kept in heaps, because elements may arrive out of order.
            self.earliest_ends.add(element.end, element)
            self.latest_ends.add(-element.end, element)

    def remove(self, element: StreamElement) -> None:
        if self.seconds is None:
            self.earliest_ends.remove()
            self.latest_ends.remove()

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        if self.seconds is not None:
            return count * self.seconds.denominator / self.seconds.numerator
        first_entry, last_entry = self.earliest_ends.top(), self.latest_ends.top()
        # The window is not empty.
        assert first_entry is not None and last_entry is not None
        # n elements span n - 1 intervals.
        span = last_entry[2].end - first_entry[2].end
        return (count - 1) * SECOND / span if span else None


class _UserFoldAccumulator(Accumulator):
    """Aggregate that the program defines: ``setting`` computes the result from the values, oldest first."""

    scans_window = True

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        result: Optional[Term] = self.setting(
            [element.values[self.index] for element in present_elements(elements)]
        )
        return result


class _Neighbours:
    """An element in the order of arrival: its key, and the orders of the elements before and after it."""

    __slots__ = ("key", "previous", "following")

    def __init__(self, key: Hashable, previous: Optional[int]):
        self.key = key
        self.previous = previous
        self.following: Optional[int] = None


class _ChangesAccumulator(Accumulator):
    """Number of elements whose value differs from that of the previous element of the window.

    The elements form a linked list, because an element may leave the window before older ones.
    """

    accepts_empty = True

    def __init__(self, index: int, name: str, setting: Setting):
        super().__init__(index, name, setting)
        self.change_count = 0
        self._by_order: Dict[int, _Neighbours] = {}
        self._last_order: Optional[int] = None

    def add(self, element: StreamElement) -> None:
        order = element.order
        last = self._last_order
        self._by_order[order] = _Neighbours(term_key(element.values[self.index]), last)
        if last is not None:
            self._by_order[last].following = order
        self.change_count += self._differ(last, order)
        self._last_order = order

    def remove(self, element: StreamElement) -> None:
        order = element.order
        neighbours = self._by_order[order]
        previous, following = neighbours.previous, neighbours.following
        self.change_count += (
            self._differ(previous, following) - self._differ(previous, order) - self._differ(order, following)
        )
        if previous is not None:
            self._by_order[previous].following = following
        if following is None:
            self._last_order = previous
        else:
            self._by_order[following].previous = previous
        del self._by_order[order]

    def _differ(self, previous: Optional[int], following: Optional[int]) -> bool:
        if previous is None or following is None:
            return False
        return self._by_order[previous].key != self._by_order[following].key

    def result(self, elements: WindowElements, count: int) -> Optional[Term]:
        return self.change_count


class AggregateFunction(NamedTuple):
    """Aggregate function of the event language.

    Attributes:
        name: name in rules.
        notation: notation in rules; the last argument is the aggregated value.
        words: the result in words, with the variables of the notation; Q stands for the measured pattern.
        accumulator: implementation for windows.
        fold: implementation for repeated events, or the function that makes it from the setting.
        has_value: whether it has an aggregated value.
        setting_count: number of arguments before the aggregated value.
    """

    name: str
    notation: str
    words: str
    accumulator: Type[Accumulator]
    fold: Union[Fold, Callable[[Setting], Fold]]
    has_value: bool = True
    setting_count: int = 0

    @property
    def arity(self) -> int:
        """Number of arguments."""
        return self.setting_count + self.has_value

    @property
    def value_rule(self) -> ValueRule:
        """Values that it accepts."""
        return self.accumulator.value_rule

    @property
    def accepts_arrays(self) -> bool:
        """True if windows accept arrays as well as numbers."""
        return self.accumulator.accepts_arrays

    @property
    def is_numeric(self) -> bool:
        """True if values must be numbers."""
        return self.value_rule.check is not None

    def make_accumulator(self, index: int, setting: Setting) -> Accumulator:
        """Return the accumulator of a window, given the index of its value in an element and its setting."""
        return self.accumulator(index, self.name, setting)

    def make_fold(self, setting: Setting) -> Fold:
        """Return the implementation for repeated events, given the setting."""
        return self.fold if isinstance(self.fold, Fold) else self.fold(setting)


AGGREGATES: Dict[str, AggregateFunction] = {
    function.name: function
    for function in (
        AggregateFunction(
            "count",
            "count",
            "the number of Q",
            _CountAccumulator,
            Fold(
                initial_state=0,
                state_type=COUNT,
                empty_result=0,
                add=lambda count, value: count + 1,
                result=get_state,
            ),
            has_value=False,
        ),
        AggregateFunction(
            "sum",
            "sum(X)",
            "the sum of X",
            _SumAccumulator,
            Fold(
                initial_state=0,
                state_type=FINITE,
                empty_result=0,
                add=add_finite,
                result=get_state,
            ),
        ),
        AggregateFunction(
            "min",
            "min(X)",
            "the smallest X",
            _MinimumAccumulator,
            Fold(
                initial_state=None,
                state_type=optional(ORDERED),
                empty_result=None,
                add=choose_smaller,
                result=get_state,
            ),
        ),
        AggregateFunction(
            "max",
            "max(X)",
            "the largest X",
            _MaximumAccumulator,
            Fold(
                initial_state=None,
                state_type=optional(ORDERED),
                empty_result=None,
                add=choose_larger,
                result=get_state,
            ),
        ),
        AggregateFunction(
            "avg",
            "avg(X)",
            "the average of X",
            _AverageAccumulator,
            Fold(
                initial_state=(0, 0),
                state_type=tuple_of(FINITE, COUNT),
                empty_result=None,
                add=lambda state, value: (add_finite(state[0], value), state[1] + 1),
                result=compute_average,
            ),
        ),
        AggregateFunction(
            "stddev",
            "stddev(X)",
            "the standard deviation of X",
            _DeviationAccumulator,
            DEVIATION_FOLD,
        ),
        AggregateFunction(
            "median",
            "median(X)",
            "the median of X",
            _MedianAccumulator,
            make_quantile_fold(0.5),
        ),
        AggregateFunction(
            "quantile",
            "quantile(P, X)",
            "the quantile P of X",
            _QuantileAccumulator,
            make_quantile_fold,
            setting_count=1,
        ),
        AggregateFunction(
            "first",
            "first(X)",
            "the first X",
            _FirstAccumulator,
            FIRST_FOLD,
        ),
        AggregateFunction(
            "last",
            "last(X)",
            "the last X",
            _LastAccumulator,
            LAST_FOLD,
        ),
        AggregateFunction(
            "list",
            "list(X)",
            "the list of all X",
            _ListAccumulator,
            LIST_FOLD,
        ),
        AggregateFunction(
            "distinct",
            "distinct(X)",
            "the list of different X",
            _DistinctAccumulator,
            DISTINCT_FOLD,
        ),
        AggregateFunction(
            "count_distinct",
            "count_distinct(X)",
            "the number of different X",
            _CountDistinctAccumulator,
            COUNT_DISTINCT_FOLD,
        ),
        AggregateFunction(
            "changes",
            "changes(X)",
            "the number of changes of X",
            _ChangesAccumulator,
            CHANGES_FOLD,
        ),
        AggregateFunction(
            "rate",
            "rate",
            "the number of Q per second",
            _RateAccumulator,
            RATE_FOLD,
            has_value=False,
        ),
        AggregateFunction(
            "fold",
            "fold(Init, Step, Result, X)",
            "the result of Result after a fold by Step, from Init, of all X",
            _UserFoldAccumulator,
            make_user_fold,
            setting_count=3,
        ),
    )
}


class SequenceAggregate:
    """Aggregate over the repeated events of one rule: the function, and the access to the value in a match.

    Args:
        evaluate: returns the number that an arithmetic expression has with the values of the match.
    """

    def __init__(
        self,
        name: str,
        setting: Setting,
        build_value: Callable[[Values], Term],
        evaluate: Callable[[Term, Values], Term],
    ):
        function = AGGREGATES[name]
        fold = function.make_fold(setting)
        self.name = name
        self.initial_state, self.state_type, self.empty_result, self._add, self._result, _ = fold
        self._is_per_second = fold.is_per_second
        self._check = function.value_rule.check
        self._build_value = build_value
        self._evaluate = evaluate

    def add(self, state: Any, values: Values) -> Any:
        """Return the state with the value of one more match.

        Raises:
            RuleError: if a numeric aggregate gets a value that is not a number.
        """
        value = self._build_value(values)
        check = self._check
        if check is not None:
            # Plain numbers are by far the most frequent values, and need no evaluation.
            if value.__class__ not in (int, float):
                value = self._evaluate(value, values)
            check(value, self.name)
        try:
            return self._add(state, value)
        except OverflowError:
            raise RuleError(f"aggregate {self.name}: a number is too large") from None

    def result(self, state: Any, span: int) -> Optional[Term]:
        """Return the result of a state, or None if there is none.

        Args:
            state: the state.
            span: nanoseconds from the end of the start to the last end, more than 0 after a value was added.

        Raises:
            RuleError: if the result is too large for a float.
        """
        try:
            result: Optional[Any] = self._result(state)
        except OverflowError:
            raise RuleError(f"aggregate {self.name}: the result is too large for a float") from None
        return result * SECOND / span if self._is_per_second and result is not None else result
