"""Integers where a message has floats: ``{x: 0}`` means 0.0, as no message has an integer there."""

from math import copysign
from typing import Callable, List

from ..terms import CONS, Term, deref

_LARGEST = 1 << 53
"""Whole floats below it are integers, each of its own."""


def as_floats(value: Term, array: bool) -> Term:
    """Return the value of a slot of floats with its integers as floats; the same term where it has none.

    Args:
        value: as it was read.
        array: whether the slot is an array: the integers are elements of a list.
    """
    return _with_elements(value, _float) if array else _float(value)


def as_integers(value: Term, array: bool) -> Term:
    """Return the value of a slot of floats with its whole numbers as integers, which read as the same floats."""
    return _with_elements(value, _integer) if array else _integer(value)


def _float(value: Term) -> Term:
    if value.__class__ is not int:
        return value
    try:
        return float(value)
    except OverflowError:  # no float is as large: it matches no message, as it is written
        return value


def _integer(value: Term) -> Term:
    if value.__class__ is not float or not value.is_integer() or abs(value) >= _LARGEST:
        return value
    return value if value == 0 and copysign(1, value) < 0 else int(value)


def _with_elements(value: Term, change: Callable[[Term], Term]) -> Term:
    elements: List[Term] = []
    rest = value
    while rest.__class__ is tuple and rest[0] is CONS:
        elements.append(deref(rest[1]))
        rest = deref(rest[2])
    changed = [change(one) for one in elements]
    if all(new is old for new, old in zip(changed, elements)):
        return value
    for one in reversed(changed):
        rest = (CONS, one, rest)
    return rest
