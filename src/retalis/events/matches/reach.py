"""Where in time the partners of a match lie: derived from what an operator says about a pair."""

from functools import lru_cache
from typing import Callable, Dict, List, NamedTuple, Optional, Tuple

from ...foundation import shared_function
from ...prolog.syntax import EventOperator
from ..language import OPERATORS
from .timeindex import LEAST, MOST, TimeBounds

_MIRRORED = {"<": ">", "<=": ">=", "==": "=="}


class Reach(NamedTuple):
    """The times of possible partners.

    Attributes:
        limits: from start and end of a match to between what its partners start and end.
        by_end: whether the end is limited more closely than the start.
    """

    limits: Callable[[int, int], TimeBounds]
    by_end: bool


BEFORE = Reach(lambda start, end: (LEAST, MOST, LEAST, start - 1), True)
"""Whatever ended before."""
BETWEEN = Reach(lambda start, end: (start + 1, MOST, LEAST, end - 1), False)
"""What lies wholly between two instants."""


@lru_cache(maxsize=1000)
def reach_of(name: str, span: Optional[int], left: bool) -> Optional[Reach]:
    """Return where the partners of a match are; None where they may be anywhere.

    Args:
        name: an operator.
        span: how long the result may be, in ns; None for no bound.
        left: whether the match is the left operand.
    """
    operator = OPERATORS[name]
    lower, upper = _bounds(operator, span, "1" if left else "2")
    if not any((*lower.values(), *upper.values())):
        return None
    parts = []
    for instant in "se":
        parts += [_tightest("max", lower[instant]) or "LEAST", _tightest("min", upper[instant]) or "MOST"]
    given = "s1, e1" if left else "s2, e2"
    source = f"def made({given}):\n    return ({', '.join(parts)})\n"
    limits = shared_function(source, {"LEAST": LEAST, "MOST": MOST}, f"partners of {operator.name}")
    by_end = len(lower["e"]) + len(upper["e"]) > len(lower["s"]) + len(upper["s"])
    return Reach(limits, by_end)


def _bounds(
    operator: EventOperator, span: Optional[int], mine: str
) -> Tuple[Dict[str, List[str]], Dict[str, List[str]]]:
    """Return the lower and the upper bounds of a partner's start and end, as sources."""
    lower: Dict[str, List[str]] = {"s": [], "e": []}
    upper: Dict[str, List[str]] = {"s": [], "e": []}
    for comparison in operator.comparisons:
        one, sign, other = comparison.split()
        if one[1] == other[1]:
            continue
        if one[1] == mine:
            one, sign, other = other, _MIRRORED[sign], one
        if sign in ("<", "<=", "=="):
            upper[one[0]].append(f"{other} - 1" if sign == "<" else other)
        if sign in (">", ">=", "=="):
            lower[one[0]].append(f"{other} + 1" if sign == ">" else other)
    if span is not None:  # a result always reaches from the start of the one to the end of the other
        lower["s"].append(f"e{mine} - {span}")
        upper["e"].append(f"s{mine} + {span}")
    return lower, upper


def _tightest(function: str, sources: List[str]) -> str:
    return f"{function}({', '.join(sources)})" if len(sources) > 1 else "".join(sources)
