"""Predicates on arrays of numbers, which are computed by numpy.

An array is an array term (see `array_terms`), such as the value of a numeric array slot of a message, a list of
numbers, or the atom of a byte array. Array terms are read from their bytes; no list is built. Elements are counted
from 0.

An element has the value that it has as an item of the list: results are integers or doubles, and floats of 32 bits
are compared and added as doubles. numpy would compare them with numbers that are rounded to 32 bits.

A predicate that selects or combines elements fails for an empty array, or if its options leave no element, like
``min_list/2``. nan has no order, so it is an evaluation error unless an option leaves it out. Infinity is a value,
but no result of arithmetic, as in ``is/2``.
"""

import operator
from math import isfinite
from typing import TYPE_CHECKING, Any, Callable, Dict, List, NamedTuple, Optional, Union

from ...foundation.limit_checks import check_limits
from ..machine.arithmetic import Number, evaluate
from ..machine.errors import domain_error, evaluation_error
from ..terms.array_terms import array_term, element, lazy_array, sum_of_integers
from ..terms.list_terms import make_list
from ..terms.types import CONS, Atom, Functor, Term, atom, deref, functor
from ..terms.unification import unify
from .argument_checks import array_of, bound, count_work, natural, number, option_values
from .builtin_registry import ProgramMachine, deterministic, function

if TYPE_CHECKING:
    from ..terms.array_terms import Array

_GREATEST_INTEGER = (1 << 63) - 1

_GREATEST_EXACT_INTEGER = 1 << 53
"""Greatest integer up to which a double represents each integer."""


def _read_array(term: Term) -> "Array":
    """Return an array, and count the work on its elements if there are many.

    Raises:
        PrologError: an instantiation or type error for a term that is not an array.
    """
    array = array_of(term)
    count_work(len(array))
    return array


def _require_ordered(value: Number) -> Number:
    """Return a result that depends on the order of the elements; raise an error if an element is nan."""
    if value != value:
        raise evaluation_error("undefined")
    return value


def _require_finite(value: float) -> float:
    """Return a result of arithmetic; raise an error if it is not finite."""
    if value - value != 0:
        raise evaluation_error("undefined" if value != value else "float_overflow")
    return value


# Reductions of an array with elements to a number.


def _minimum(values: "Array") -> Number:
    return _require_ordered(values.min().item())


def _maximum(values: "Array") -> Number:
    return _require_ordered(values.max().item())


def _position_of_minimum(values: "Array") -> Number:
    # The position of a nan, if there is one.
    position = int(values.argmin())
    _require_ordered(values[position].item())
    return position


def _position_of_maximum(values: "Array") -> Number:
    position = int(values.argmax())
    _require_ordered(values[position].item())
    return position


def _sum(values: "Array") -> Number:
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    if values.dtype.kind != "f":
        return sum_of_integers(values)
    with np.errstate(all="ignore"):
        return _require_finite(values.sum(dtype="f8").item())


def _mean(values: "Array") -> Number:
    return _sum(values) / len(values)


def _standard_deviation(values: "Array") -> Number:
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    with np.errstate(all="ignore"):
        return _require_finite(values.std(dtype="f8").item())


def _median(values: "Array") -> Number:
    return _percentile(values, 50)


def _percentile(values: "Array", percent: Number) -> float:
    """Return the value below which ``percent`` of the elements lie, interpolated linearly between two of them."""
    # `numpy.percentile` handles axes and weights, and takes several times as long for an array of this size.
    last = len(values) - 1
    position = last * percent / 100
    low = int(position)
    fraction = position - low
    high = min(low + 1, last)
    partitioned = values.copy()
    # nan is sorted to the end, where it is found without another pass.
    partitioned.partition((low, high, last) if high < last else (low, last))
    _require_ordered(partitioned[last].item())
    lower, upper = float(partitioned[low]), float(partitioned[high])
    # Between equal infinities the difference is nan.
    if not fraction or lower == upper:
        return lower
    difference = upper - lower
    if isfinite(difference):
        return lower + difference * fraction
    # The difference of finite numbers is too large for a float, or one is infinite. Between infinity and its negative
    # there is no value.
    return _require_ordered(lower * (1 - fraction) + upper * fraction)


_REDUCTIONS: Dict[str, Callable[["Array"], Number]] = {
    "array_min": _minimum,
    "array_max": _maximum,
    "array_sum": _sum,
    "array_mean": _mean,
    "array_median": _median,
    "array_std": _standard_deviation,
    "array_argmin": _position_of_minimum,
    "array_argmax": _position_of_maximum,
}
"""Reductions by the name of their predicates."""

_EMPTY_RESULTS = {"array_sum": 0}
"""Results for an array without elements; the other predicates fail."""

_POSITION_REDUCTIONS = ("array_argmin", "array_argmax")
"""Predicates whose result is the position of an element."""


class _Selection(NamedTuple):
    """Elements of an array that options select.

    Attributes:
        mask: for each element of the array whether it is selected; None for all.
        count_terms: terms that are unified with the number of elements that were left out.
        skipped_count: that number.
    """

    values: "Array"
    mask: "Optional[Array]"
    count_terms: List[Term]
    skipped_count: int


_SKIP, _SKIPPED, _WITHIN = functor("skip", 1), functor("skipped", 1), functor("within", 2)
_NAN, _INF, _FINITE = atom("nan"), atom("inf"), atom("finite")


def _select_elements(array: Term, options: Term) -> _Selection:
    """Return the elements that options select.

    ``skip(nan)`` and ``skip(inf)`` leave out these values, ``within(Low, High)`` those outside of two bounds and nan;
    ``skipped(Count)`` receives the number of elements that were left out.

    Raises:
        PrologError: an error for a term that is not an array, and for malformed or unknown options.
    """
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    values = _read_array(array)
    masks: List[Array] = []
    count_terms: List[Term] = []
    option: Any
    for option in option_values(options):
        key: Optional[Functor] = option[0] if option.__class__ is tuple else None
        if key is _SKIPPED:
            count_terms.append(option[1])
        elif key is _WITHIN:
            masks += [
                _compare_elements(values, ">=", number(option[1])),
                _compare_elements(values, "=<", number(option[2])),
            ]
        elif key is _SKIP and deref(option[1]) in (_NAN, _INF):
            masks.append(~np.isnan(values) if deref(option[1]) is _NAN else ~np.isinf(values))
        else:
            raise domain_error("array_option", option)
    if not masks:
        return _Selection(values, None, count_terms, 0)
    mask = np.logical_and.reduce(masks)
    selected = values[mask]
    return _Selection(selected, mask, count_terms, len(values) - len(selected))


def _define_reduction(name: str, reduce: Callable[["Array"], Number]) -> None:
    """Define a reduction as a predicate of two arguments, and of three with options."""

    def reduce_array(array: Term) -> Optional[Term]:
        values = _read_array(array)
        return reduce(values) if len(values) else _EMPTY_RESULTS.get(name)

    def reduce_selected(machine: ProgramMachine, array: Term, result: Term, options: Term) -> bool:
        selection = _select_elements(array, options)
        value = reduce(selection.values) if len(selection.values) else _EMPTY_RESULTS.get(name)
        if value is not None and name in _POSITION_REDUCTIONS and selection.mask is not None:
            value = int(selection.mask.nonzero()[0][int(value)])
        return _unify_selected(machine, selection, result, value)

    function(f"{name}/2")(reduce_array)
    deterministic(f"{name}/3")(reduce_selected)


def _unify_selected(
    machine: ProgramMachine, selection: _Selection, result: Term, value: Optional[Number]
) -> bool:
    """Unify the result, and the number of elements that were left out."""
    return (
        value is not None
        and unify(result, value, machine.trail)
        and all(unify(count, selection.skipped_count, machine.trail) for count in selection.count_terms)
    )


for _name, _reduce in _REDUCTIONS.items():
    _define_reduction(_name, _reduce)


def _percentage(term: Term) -> Number:
    percent = number(term)
    if not 0 <= percent <= 100:  # noqa: PLR2004
        raise domain_error("percentage", percent)
    return percent


@function("array_percentile/3")
def array_percentile(array: Term, percent: Term) -> Optional[Term]:
    """Return a percentile, interpolated linearly between two elements as a float; fail for an empty array."""
    values, percent_value = _read_array(array), _percentage(percent)
    return _percentile(values, percent_value) if len(values) else None


@deterministic("array_percentile/4")
def array_percentile_with_options(
    machine: ProgramMachine, array: Term, percent: Term, result: Term, options: Term
) -> bool:
    """Unify with a percentile of the elements that options select."""
    selection, percent_value = _select_elements(array, options), _percentage(percent)
    value = _percentile(selection.values, percent_value) if len(selection.values) else None
    return _unify_selected(machine, selection, result, value)


# Conditions on elements

_COMPARISONS: Dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "=<": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=:=": operator.eq,
    "=\\=": operator.ne,
}
_COMPARISON_NAMES = {functor(name, 1): name for name in _COMPARISONS}
_BETWEEN = functor("between", 2)

_Operand = Union[Number, "Array"]


def _read_operand(term: Term) -> _Operand:
    """Return the array that a term is, or the value of an arithmetic expression."""
    if lazy_array(term) is None:
        value = deref(term)
        if value.__class__ is int or value.__class__ is float:
            return value
        if value.__class__ is tuple and value[0] is not CONS:
            return evaluate(value)
    return _read_array(term)


def _check_lengths(left: "Array", right: "Array", term: Term) -> None:
    if len(left) != len(right):
        reason = f"one array has {len(left)} elements, the other one {len(right)}"
        raise domain_error("array_of_equal_length", term, reason)


def _compare_elements(values: "Array", name: str, operand: _Operand) -> "Array":
    """Return for each element whether it compares so with a number, or with the element of another array.

    The result is exact, as for the items of the list: an integer is not rounded before it is compared with a float.
    """
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    compare = _COMPARISONS[name]
    with np.errstate(invalid="ignore"):
        if operand.__class__ is int and values.dtype.kind != "f":
            bounds = np.iinfo(values.dtype)
            if not bounds.min <= operand <= bounds.max:
                # All elements are less than the operand, or all are greater.
                is_less = operand > bounds.max
                return np.full(len(values), compare(0, 1) if is_less else compare(1, 0))
            return compare(values, values.dtype.type(operand))  # type: ignore[no-any-return]
        # numpy before 1.25 compares signed with unsigned integers of 64 bits as doubles.
        if isinstance(operand, np.ndarray) and np.result_type(values, operand).kind != "f":
            return compare(values, operand)  # type: ignore[no-any-return]
        if _fits_doubles(values) and _fits_doubles(operand):
            return compare(values.astype("f8"), _as_float64(operand))  # type: ignore[no-any-return]
    pairs = zip(values.tolist(), _as_list(operand, len(values)))
    return np.array([compare(left_item, right_item) for left_item, right_item in pairs], bool)


def _fits_doubles(operand: _Operand) -> bool:
    """Return whether doubles represent a number, or all elements of an array, exactly."""
    return not _is_integral(operand) or _magnitude(operand) <= _GREATEST_EXACT_INTEGER


def _match_condition(array: Term, condition: Term) -> "Array":
    """Return for each element of an array whether it fulfils a condition.

    A condition is a comparison without its left operand, such as ``<(0.5)``, whose operand is a number, an expression
    or an array; ``between(Low, High)``; or one of the atoms ``nan``, ``inf`` and ``finite``.

    Raises:
        PrologError: an error for a term that is not an array, and for another condition.
    """
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    values = _read_array(array)
    condition = bound(condition)
    if condition.__class__ is tuple:
        name = _COMPARISON_NAMES.get(condition[0])
        if name is not None:
            operand = _read_operand(condition[1])
            if operand.__class__ is not int and operand.__class__ is not float:
                _check_lengths(values, operand, condition[1])  # type: ignore[arg-type]
            return _compare_elements(values, name, operand)
        if condition[0] is _BETWEEN:
            low, high = number(condition[1]), number(condition[2])
            return _compare_elements(values, ">=", low) & _compare_elements(values, "=<", high)
    elif condition.__class__ is Atom:
        test: Any = {_NAN: np.isnan, _INF: np.isinf, _FINITE: np.isfinite}.get(condition)
        if test is not None:
            matching: Array = test(values)
            return matching
    raise domain_error("array_condition", condition)


@function("array_count/3")
def array_count(array: Term, condition: Term) -> Term:
    """Return the number of elements that fulfil a condition."""
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    return int(np.count_nonzero(_match_condition(array, condition)))


@function("array_where/3")
def array_where(array: Term, condition: Term) -> Term:
    """Return the positions of the elements that fulfil a condition."""
    mask = _match_condition(array, condition)
    check_limits(size=8 * len(mask))
    return array_term(mask.nonzero()[0])


# Elements and slices


@function("array_get/3")
def array_get(array: Term, position: Term) -> Optional[Term]:
    """Return the element at a position; fail after the last one."""
    index = natural(position)
    lazy = lazy_array(array)
    if lazy is not None:
        return element(lazy, index)
    values = array_of(array)
    return values[index].item() if index < len(values) else None


@function("array_slice/4")
def array_slice(array: Term, start: Term, end: Term) -> Term:
    """Return the elements from a position up to, but not including, another one; positions after the end are cut."""
    first, last = natural(start), natural(end)
    values = array_of(array)[first:last]
    check_limits(size=values.nbytes)
    return array_term(values)


# Arithmetic


def _elementwise(
    apply: Callable[[Any, Any], Any], bound_result: Optional[Callable[[int, int], int]]
) -> Callable[[Term, Term], Term]:
    """Return a function of two operands, for at least one array.

    Args:
        apply: the operation on numbers or arrays.
        bound_result: returns a bound of the absolute result from those of integer operands; None if the result is
            always a float.
    """

    def run(left: Term, right: Term) -> Term:
        import numpy as np  # noqa: PLC0415 - see `array_terms`

        first, second = _read_operand(left), _read_operand(right)
        sizes = [len(operand) for operand in (first, second) if isinstance(operand, np.ndarray)]
        if not sizes:
            array_of(left)  # raises the type error
        if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
            _check_lengths(first, second, right)
        check_limits(size=8 * sizes[0])
        if bound_result is None or not _is_integral(first) or not _is_integral(second):
            return array_term(_apply_to_floats(apply, first, second))
        if bound_result(_magnitude(first), _magnitude(second)) <= _GREATEST_INTEGER:
            return array_term(apply(_as_int64(first), _as_int64(second)))
        # Integers of any size, as the list would have them.
        pairs = zip(_as_list(first, sizes[0]), _as_list(second, sizes[0]))
        return make_list([apply(left_item, right_item) for left_item, right_item in pairs])

    return run


def _apply_to_floats(apply: Callable[[Any, Any], Any], first: _Operand, second: _Operand) -> "Array":
    """Return the result of an operation on doubles, for at least one array.

    Raises:
        PrologError: an evaluation error for a division by 0, and for finite numbers whose result is not finite.
    """
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    first_values, second_values = _as_float64(first), _as_float64(second)
    with np.errstate(all="ignore"):
        if apply is operator.truediv and not np.all(second_values):
            raise evaluation_error("zero_divisor")
        result: Array = apply(first_values, second_values)
        # nan and infinity stay what they are; arithmetic on finite numbers must not create them.
        if (
            not np.isfinite(result).all()
            and ((np.isfinite(first_values) & np.isfinite(second_values)) & ~np.isfinite(result)).any()
        ):
            raise evaluation_error("float_overflow")
    return result


def _is_integral(operand: _Operand) -> bool:
    return operand.__class__ is int or (operand.__class__ is not float and operand.dtype.kind != "f")  # type: ignore[union-attr]


def _magnitude(operand: Any) -> int:
    """Return the largest absolute value of an integer, or of an array of integers."""
    if operand.__class__ is int:
        return abs(operand)
    return max(abs(int(operand.min())), abs(int(operand.max()))) if len(operand) else 0


def _as_int64(operand: Any) -> Any:
    return operand if operand.__class__ is int else operand.astype("i8")


def _as_float64(operand: Any) -> Any:
    return float(operand) if operand.__class__ in (int, float) else operand.astype("f8")


def _as_list(operand: Any, count: int) -> List[Number]:
    return [operand] * count if operand.__class__ in (int, float) else operand.tolist()


def _add_bound(first: int, second: int) -> int:
    return first + second


def _product_bound(first: int, second: int) -> int:
    # An operand is a 64-bit integer itself, also if the other one is 0.
    return max(first * second, first, second)


function("array_add/3")(_elementwise(operator.add, _add_bound))
function("array_subtract/3")(_elementwise(operator.sub, _add_bound))
function("array_multiply/3")(_elementwise(operator.mul, _product_bound))
function("array_divide/3")(_elementwise(operator.truediv, None))
