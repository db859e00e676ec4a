"""Fit of power laws."""

import math
from typing import Sequence, Tuple


def exponent(points: Sequence[Tuple[float, float]]) -> float:
    """Return b of the power law y = a * x**b that fits best; nan with fewer than two points."""
    logs = [(math.log(x), math.log(y)) for x, y in points]
    if len(logs) < 2:
        return math.nan
    middle_x = sum(x for x, _ in logs) / len(logs)
    middle_y = sum(y for _, y in logs) / len(logs)
    over = sum((x - middle_x) ** 2 for x, _ in logs)
    return sum((x - middle_x) * (y - middle_y) for x, y in logs) / over
