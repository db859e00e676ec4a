"""Evaluable functions of the bits of integers."""

from ..machine import resource_error
from .evaluation import HUGE, Number, evaluable, integer, not_less


@evaluable(">>", 2)
def shift_right(left: Number, right: Number) -> int:
    """Return ``left`` shifted right."""
    left, right = integer(left), integer(right)
    return left >> right if right >= 0 else shift_left(left, -right)


@evaluable("<<", 2)
def shift_left(left: Number, right: Number) -> int:
    """Return ``left`` shifted left."""
    left, right = integer(left), integer(right)
    if right < 0:
        return left >> -right
    if left and right + left.bit_length() > HUGE:
        raise resource_error("memory")
    return left << right if left else 0


@evaluable("/\\", 2)
def bit_and(left: Number, right: Number) -> int:
    """Return the bitwise and."""
    return integer(left) & integer(right)


@evaluable("\\/", 2)
def bit_or(left: Number, right: Number) -> int:
    """Return the bitwise or."""
    return integer(left) | integer(right)


@evaluable("xor", 2)
def _xor(left: Number, right: Number) -> int:
    return integer(left) ^ integer(right)


@evaluable("\\", 1)
def _invert(value: Number) -> int:
    return ~integer(value)


@evaluable("msb", 1)
def _msb(value: Number) -> int:
    return not_less(1, value).bit_length() - 1


@evaluable("lsb", 1)
def _lsb(value: Number) -> int:
    number = not_less(1, value)
    return (number & -number).bit_length() - 1


@evaluable("popcount", 1)
def _popcount(value: Number) -> int:
    return bin(not_less(0, value)).count("1")


@evaluable("getbit", 2)
def _getbit(value: Number, bit: Number) -> int:
    return (not_less(0, value) >> not_less(0, bit)) & 1
