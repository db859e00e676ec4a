"""Predicates on arrays of numbers, which are computed by numpy.

An array is an array term (see `array_terms`), such as the value of a numeric array slot of a message, a list of
numbers, or the atom of a byte array. Array terms are read from their bytes; no list is built.
"""

from typing import TYPE_CHECKING, Optional

from ...foundation.cancellation import check_limits
from ..machine.arithmetic import Number
from ..machine.errors import domain_error, evaluation_error
from ..terms.types import Term
from .argument_checks import array_of, number
from .builtin_registry import function

if TYPE_CHECKING:
    from ..terms.array_terms import Array

_ELEMENTS_PER_INFERENCE = 64
"""Elements that numpy processes in about the time of an inference."""


def _numbers(term: Term) -> "Array":
    """Return an array, and count the work on its elements.

    Raises:
        PrologError: an instantiation or type error for a term that is not an array.
    """
    array = array_of(term)
    if len(array) > _ELEMENTS_PER_INFERENCE:
        check_limits(len(array) // _ELEMENTS_PER_INFERENCE)
    return array


def _ordered(value: Number) -> Number:
    """Return a result that depends on the order of the elements, which nan does not have."""
    if value != value:
        raise evaluation_error("undefined")
    return value


@function("array_min/2")
def array_min(array: Term) -> Optional[Term]:
    """Return the smallest element; fail for an empty array."""
    values = _numbers(array)
    return _ordered(values.min().item()) if len(values) else None


@function("array_max/2")
def array_max(array: Term) -> Optional[Term]:
    """Return the largest element; fail for an empty array."""
    values = _numbers(array)
    return _ordered(values.max().item()) if len(values) else None


@function("array_mean/2")
def array_mean(array: Term) -> Optional[Term]:
    """Return the arithmetic mean as a float; fail for an empty array."""
    values = _numbers(array)
    if not len(values):
        return None
    mean: float = values.mean(dtype="f8").item()
    if mean - mean != 0:
        raise evaluation_error("undefined" if mean != mean else "float_overflow")
    return mean


@function("array_percentile/3")
def array_percentile(array: Term, percent: Term) -> Optional[Term]:
    """Return a percentile, interpolated linearly between two elements as a float; fail for an empty array."""
    values = _numbers(array)
    share = number(percent)
    if not 0 <= share <= 100:  # noqa: PLR2004
        raise domain_error("percentage", share)
    return _percentile(values, share) if len(values) else None


def _percentile(values: "Array", share: Number) -> float:
    """Return the element at a share of the sorted elements, in percent; see ``numpy.percentile``."""
    # numpy's function handles axes and weights, and takes several times as long for a short array.
    position = (len(values) - 1) * share / 100
    low = int(position)
    fraction = position - low
    last = len(values) - 1
    high = min(low + 1, last)
    # nan is sorted to the end, where it is found without another pass.
    parted = values.copy()
    parted.partition((low, high, last) if high < last else (low, last))
    _ordered(parted[last].item())
    lower, upper = float(parted[low]), float(parted[high])
    # Between equal infinities the difference is nan.
    return lower if not fraction or lower == upper else lower + (upper - lower) * fraction
