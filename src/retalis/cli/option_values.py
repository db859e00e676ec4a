"""Conversion of option values: numbers with ranges, and the two forms of ``--times``."""

import argparse
from typing import Callable, List, Optional

Reader = Callable[[str], float]

STAMPS, RELATIVE = "stamps", "relative"
RELATIVE_TIMES = "--times=relative"
"""Option for times relative to the start of a run; ``--times relative`` is the same."""


def from_zero(kind: Callable[[str], float]) -> Reader:
    """Return a converter for numbers of 0 or more.

    Args:
        kind: ``int`` or ``float``.
    """
    name = "a whole number" if kind is int else "a number"
    return _reader(kind, lambda number: 0 <= number < float("inf"), f"{name} of 0 or more")


def _reader(kind: Callable[[str], float], fits: Callable[[float], bool], expected: str) -> Reader:
    def read(text: str) -> float:
        number = _number(kind, text)
        if number is None or not fits(number):
            raise argparse.ArgumentTypeError(f"expected {expected}, found {text}")
        return number

    return read


def _number(kind: Callable[[str], float], text: str) -> Optional[float]:
    try:
        return kind(text)
    except ValueError:
        return None


from_one = _reader(int, lambda number: number >= 1, "a whole number of 1 or more")
whole = _reader(int, lambda number: True, "a whole number")
any_number = _reader(float, lambda number: True, "a number")
seconds = _reader(float, lambda number: 0 < number < float("inf"), "a positive number of seconds")


def join_times(arguments: List[str]) -> List[str]:
    """Join ``--times relative`` to one argument.

    ``--times`` alone takes no value, so that a bag may follow it. argparse cannot distinguish the two forms.
    """
    joined: List[str] = []
    for argument in arguments:
        if argument == RELATIVE and joined and joined[-1] == "--times":
            joined[-1] = RELATIVE_TIMES
        else:
            joined.append(argument)
    return joined
