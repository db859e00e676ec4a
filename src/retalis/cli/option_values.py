"""Conversion of option values: numbers with ranges, and the two forms of ``--times``."""

import argparse
from typing import Callable, List, Optional

NumberReader = Callable[[str], float]

TIMES_AS_STAMPS, TIMES_RELATIVE = "stamps", "relative"
RELATIVE_TIMES_OPTION = "--times=relative"
"""Option for times relative to the start of a run; ``--times relative`` is the same."""


def non_negative(number_type: Callable[[str], float]) -> NumberReader:
    """Return a converter for numbers of 0 or more.

    Args:
        number_type: ``int`` or ``float``.
    """
    name = "a whole number" if number_type is int else "a number"
    return _make_reader(number_type, lambda number: 0 <= number < float("inf"), f"{name} of 0 or more")


def _make_reader(
    number_type: Callable[[str], float], is_allowed: Callable[[float], bool], expected: str
) -> NumberReader:
    def read(text: str) -> float:
        number = _parse_number(number_type, text)
        if number is None or not is_allowed(number):
            raise argparse.ArgumentTypeError(f"expected {expected}, found {text}")
        return number

    return read


def _parse_number(number_type: Callable[[str], float], text: str) -> Optional[float]:
    try:
        return number_type(text)
    except ValueError:
        return None


positive_integer = _make_reader(int, lambda number: number >= 1, "a whole number of 1 or more")
any_integer = _make_reader(int, lambda number: True, "a whole number")
any_number = _make_reader(float, lambda number: True, "a number")
positive_seconds = _make_reader(
    float, lambda number: 0 < number < float("inf"), "a positive number of seconds"
)


def join_times_option(arguments: List[str]) -> List[str]:
    """Join ``--times relative`` to one argument.

    ``--times`` alone takes no value, so that a bag may follow it. argparse cannot distinguish the two forms.
    """
    joined: List[str] = []
    for argument in arguments:
        if argument == TIMES_RELATIVE and joined and joined[-1] == "--times":
            joined[-1] = RELATIVE_TIMES_OPTION
        else:
            joined.append(argument)
    return joined
