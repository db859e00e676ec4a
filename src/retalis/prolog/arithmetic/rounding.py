"""Evaluable functions from floats to integers and back."""

import math
from typing import Any, Callable

from ..terms import functor
from .evaluation import EVALUABLE, Number, _to_float, checked, evaluable


def _rounded(function: Callable[[float], int]) -> Callable[[Number], int]:
    def apply(value: Any) -> int:
        if value.__class__ is int:
            return value
        return function(value) if value - value == 0 else value

    return apply


def round_half_away(value: float) -> int:
    """Round to the nearest integer, halves away from zero."""
    whole = math.floor(abs(value))
    whole += abs(value) - whole >= 0.5
    return whole if value >= 0 else -whole


EVALUABLE[functor("floor", 1)] = _rounded(math.floor)
EVALUABLE[functor("ceiling", 1)] = EVALUABLE[functor("ceil", 1)] = _rounded(math.ceil)
EVALUABLE[functor("truncate", 1)] = _rounded(math.trunc)
EVALUABLE[functor("integer", 1)] = _rounded(round_half_away)
EVALUABLE[functor("round", 1)] = _rounded(round_half_away)


@evaluable("float", 1)
def _float(value: Number) -> float:
    return _to_float(value)


@evaluable("float_integer_part", 1)
def _integer_part(value: Number) -> Number:
    return value if value.__class__ is int else math.copysign(math.trunc(checked(value)), value)


@evaluable("float_fractional_part", 1)
def _fractional_part(value: Number) -> Number:
    return 0 if value.__class__ is int else math.fmod(value, 1.0) if value - value == 0 else value
