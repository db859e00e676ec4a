"""Numbers of the rounds of a search for errors: some for each push, and many more for each night."""

from typing import Any, List

import pytest


def round_numbers(push: int, nightly: int) -> List[Any]:
    """Return the numbers below ``nightly`` as parameters; those from ``push`` on are marked as nightly."""
    return [
        number if number < push else pytest.param(number, marks=pytest.mark.nightly)
        for number in range(nightly)
    ]
