"""Similar names, for the hint "did you mean ...?" of errors."""

from difflib import get_close_matches
from itertools import islice
from typing import Iterable

MAX_CANDIDATES = 2000
"""Maximum number of names that are compared; each comparison takes about 25 µs."""

DEFAULT_CUTOFF = 0.6
"""Minimum similarity from 0 to 1, see ``difflib.SequenceMatcher.ratio``."""


def closest_name(name: str, names: Iterable[str], cutoff: float = DEFAULT_CUTOFF) -> str:
    """Return the most similar name, or "".

    >>> closest_name("throtle", ["debounce", "throttle"])
    'throttle'
    """
    candidates = list(islice(dict.fromkeys(names), MAX_CANDIDATES))
    matches = get_close_matches(name, candidates, 1, cutoff)
    return matches[0] if matches else ""


def did_you_mean(name: str, names: Iterable[str], cutoff: float = DEFAULT_CUTOFF) -> str:
    """Return ``; did you mean NAME?`` with the most similar name, or "".

    >>> did_you_mean("throtle", ["debounce", "throttle"]), did_you_mean("x", ["debounce"])
    ('; did you mean throttle?', '')
    """
    closest = closest_name(name, names, cutoff)
    return f"; did you mean {closest}?" if closest else ""
