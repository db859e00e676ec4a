"""What was probably meant by a name that nobody knows."""

from difflib import get_close_matches
from typing import Iterable

from ...prolog.terms import Functor

_MOST = 2000
"""Names among which one is looked for."""

COMPARISONS = 40_000
"""Names that a check compares; about a second."""


def near(name: str, names: Iterable[str], alike: float = 0.66) -> str:
    """Return the name that is most like another, or ""."""
    found = get_close_matches(name, list(dict.fromkeys(names))[:_MOST], 1, alike)
    return found[0] if found else ""


def meant(name: str, names: Iterable[str], alike: float = 0.66) -> str:
    """Return the question whether another name was meant, behind a semicolon; "" where none is like it."""
    found = near(name, names, alike)
    return f"; did you mean {found}?" if found else ""


class NearFunctors:
    """Finds the functors that were probably meant by others, until that has taken its time."""

    def __init__(self) -> None:
        self._left = COMPARISONS

    def of(self, key: Functor, keys: Iterable[Functor]) -> str:
        """Return the functor that was probably meant: of the same name, or of one that is like it; or ""."""
        known = list(keys)
        same = [one for one in known if one.name == key.name and one is not key]
        if not same:
            names = list(dict.fromkeys(one.name for one in known))[:_MOST]
            self._left -= len(names)
            name = near(key.name, names) if self._left >= 0 else ""
            same = [one for one in known if one.name == name]
        return str(min(same, key=lambda one: abs(one.arity - key.arity))) if same else ""
