"""Evaluable functions beyond the integers: powers, trigonometry, constants, random numbers."""

import math
import random
import sys
import time
from struct import pack, unpack
from typing import Any, Callable

from ...foundation import UsageError
from ..machine import domain_error, evaluation_error, resource_error
from ..terms import Functor, functor, timestamps
from .evaluation import EVALUABLE, HUGE, SLOW, Number, _to_float, checked, evaluable, integer, not_less
from .instants import of_instant


def _real(name: str, function: Callable[[float], float]) -> None:
    """Register a function of one float; a value outside its domain is undefined."""

    def apply(value: Number) -> float:
        try:
            return checked(function(_to_float(value)))
        except OverflowError:
            raise evaluation_error("float_overflow") from None
        except ValueError:
            raise evaluation_error("undefined") from None

    EVALUABLE[functor(name, 1)] = apply


for _name in (
    "sqrt",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "exp",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
):
    _real(_name, getattr(math, _name))
for _name in ("erf", "erfc", "lgamma"):
    _real(_name, getattr(math, _name))


def _logarithm(name: str, function: Callable[[Number], float]) -> None:
    def apply(value: Number) -> float:
        if value <= 0:
            raise evaluation_error("undefined")
        return checked(function(value if value.__class__ is int else checked(value)))

    EVALUABLE[functor(name, 1)] = apply


_logarithm("log", math.log)
_logarithm("log2", math.log2)
_logarithm("log10", math.log10)


@evaluable("log", 2)
def _log(base: Number, value: Number) -> float:
    if value <= 0 or base <= 0:
        raise evaluation_error("undefined")
    if base == 1:
        raise evaluation_error("zero_divisor")
    return math.log(value) / math.log(base)


@evaluable("atan2", 2)
@evaluable("atan", 2)
def _atan2(y: Number, x: Number) -> float:
    return math.atan2(_to_float(y), _to_float(x))


@evaluable("copysign", 2)
def _copysign(value: Number, sign: Number) -> Number:
    if value.__class__ is int:
        return abs(value) * (-1 if math.copysign(1.0, sign) < 0 else 1)
    return math.copysign(value, sign)


@evaluable("nexttoward", 2)
def _nexttoward(value: Number, target: Number) -> float:
    value, target = _to_float(value), _to_float(target)
    if value == target or value != value:
        return value
    if value == 0:
        return math.copysign(sys.float_info.min * sys.float_info.epsilon, target)
    bits = unpack("<q", pack("<d", value))[0]
    bits += 1 if (target > value) == (value > 0) else -1
    return float(unpack("<d", pack("<q", bits))[0])


@evaluable("hypot", 2)
def _hypot(x: Number, y: Number) -> float:
    return checked(math.hypot(x, y))


@evaluable("^", 2)
def power(base: Number, exponent: Number) -> Number:
    """Return the power; of integers it is an integer, unless the exponent is negative."""
    if exponent.__class__ is int:
        if exponent == 0:
            return 1
        if base.__class__ is int and (exponent > 0 or base in (0, 1, -1)):
            return _integer_power(base, exponent)
    return _float_power(base, exponent)


@evaluable("**", 2)
def _power2(base: Number, exponent: Number) -> Number:
    """Return the power."""
    return power(base, exponent)


def _integer_power(base: Any, exponent: Any) -> int:
    if base in (0, 1, -1):
        if exponent >= 0:
            small: int = base**exponent
            return small
        if base == 0:
            raise evaluation_error("zero_divisor")
        return base if exponent % 2 else 1
    if base.bit_length() * exponent > HUGE:
        raise resource_error("memory")
    power: int = base**exponent
    return power


def _float_power(base: Number, exponent: Number) -> float:
    base, exponent = _to_float(base), _to_float(exponent)
    if base == 0 and exponent < 0:
        raise evaluation_error("zero_divisor")
    try:
        return checked(math.pow(base, exponent))
    except OverflowError:
        raise evaluation_error("float_overflow") from None
    except ValueError:
        raise evaluation_error("undefined") from None


@evaluable("powm", 3)
def _powm(base: Number, exponent: Number, modulus: Number) -> int:
    size = not_less(1, modulus).bit_length()
    # A bit of the exponent costs a product of the modulus's size, and as much again as one of 400 bits.
    if not_less(0, exponent).bit_length() * (size * size + 400 * 400) > SLOW:
        raise resource_error("integer_size")
    return pow(integer(base), integer(exponent), integer(modulus))


@evaluable("cot", 1)
def _cot(value: Number) -> float:
    if value == 0:
        raise evaluation_error("undefined")
    return 1.0 / math.tan(value)


@evaluable("acot", 1)
def _acot(value: Number) -> float:
    return math.atan(1.0 / value) if value else math.pi / 2


@evaluable("random", 1)
def _random(limit: Number) -> int:
    return random.randrange(not_less(1, limit))


@evaluable("numerator", 1)
def _numerator(value: Number) -> int:
    return integer(value)


@evaluable("denominator", 1)
def _denominator(value: Number) -> int:
    integer(value)
    return 1


@evaluable("eval", 1)
def _eval(value: Number) -> Number:
    return value


@evaluable("rational", 1)
@evaluable("rationalize", 1)
def _rational(value: Number) -> Number:
    if value.__class__ is float and value == math.trunc(value):
        return math.trunc(value)
    return value


def _seconds(key: Functor) -> Callable[..., Number]:
    def seconds(*fields: Number) -> Number:
        """Return the seconds since the epoch of a stamp, which is as good a number as the others that stamps are."""
        try:
            return of_instant(timestamps.from_term((key, *fields)))
        except UsageError:
            raise domain_error("datime", (key, *fields)) from None

    return seconds


for _key in (timestamps.DATIME6, timestamps.DATIME7):
    EVALUABLE[_key] = _seconds(_key)


def _constants() -> None:
    constant: Callable[[Number], Callable[[], Number]] = lambda value: lambda: value  # noqa: E731
    for name, value in (
        ("pi", math.pi),
        ("e", math.e),
        ("inf", math.inf),
        ("infinite", math.inf),
        ("nan", math.nan),
        ("epsilon", sys.float_info.epsilon),
        ("max_tagged_integer", (1 << 60) - 1),
        ("min_tagged_integer", -(1 << 60)),
        ("max_integer", (1 << 63) - 1),
        ("min_integer", -(1 << 63)),
    ):
        EVALUABLE[functor(name, 0)] = constant(value)
    EVALUABLE[functor("random", 0)] = random.random
    EVALUABLE[functor("random_float", 0)] = random.random
    EVALUABLE[functor("cputime", 0)] = time.process_time
    EVALUABLE[functor("realtime", 0)] = lambda: int(time.time())


_constants()
