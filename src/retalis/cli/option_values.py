"""Conversion of option values: numbers with ranges, and the two forms of ``--times``.

This module imports nothing of the engine, so that commands for a running node start fast.
"""

import argparse
from typing import Callable, List, Optional

NumberConverter = Callable[[str], float]
"""Returns the number in the text of an option, for argparse; raises `argparse.ArgumentTypeError` if it is invalid."""

TIMES_AS_STAMPS, TIMES_RELATIVE = "stamps", "relative"
"""Values of option ``--times``."""

RELATIVE_TIMES_OPTION = "--times=relative"
"""Option for times relative to the start of a run; ``--times relative`` is the same."""


def non_negative(number_type: Callable[[str], float]) -> NumberConverter:
    """Return a converter for numbers of 0 or more."""
    name = "a whole number" if number_type is int else "a number"
    return _make_converter(number_type, lambda number: 0 <= number < float("inf"), f"{name} of 0 or more")


def _make_converter(
    number_type: Callable[[str], float], is_allowed: Callable[[float], bool], expected: str
) -> NumberConverter:
    """Return a converter.

    Args:
        number_type: ``int`` or ``float``.
        is_allowed: whether a number is in the range of the option.
        expected: description of the allowed numbers for the error.
    """

    def convert(text: str) -> float:
        number = _parse_number(number_type, text)
        if number is None or not is_allowed(number):
            raise argparse.ArgumentTypeError(f"expected {expected}, found {text}")
        return number

    return convert


def _parse_number(number_type: Callable[[str], float], text: str) -> Optional[float]:
    try:
        return number_type(text)
    except ValueError:
        return None


percentage = _make_converter(float, lambda number: 0 <= number <= 100, "a number from 0 to 100")
positive_integer = _make_converter(int, lambda number: number >= 1, "a whole number of 1 or more")
any_integer = _make_converter(int, lambda number: True, "a whole number")
any_number = _make_converter(float, lambda number: True, "a number")
positive_seconds = _make_converter(
    float, lambda number: 0 < number < float("inf"), "a positive number of seconds"
)


def join_times_option(words: List[str]) -> List[str]:
    """Join ``--times relative`` to one argument.

    ``--times`` alone takes no value, so that a bag may follow it. argparse cannot distinguish the two forms.
    """
    joined: List[str] = []
    for word in words:
        if word == TIMES_RELATIVE and joined and joined[-1] == "--times":
            joined[-1] = RELATIVE_TIMES_OPTION
        else:
            joined.append(word)
    return joined


def parse_delay(text: str) -> Optional[float]:
    """Return a number of seconds from an option; None for ``auto``."""
    return None if text == "auto" else float(non_negative(float)(text))
