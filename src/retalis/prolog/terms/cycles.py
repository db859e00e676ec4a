"""Terms that contain themselves: found after many steps of a walk, so that others cost nothing more."""

from typing import Any, Dict, List, Set, Tuple

from ...foundation import TermTooLarge
from .kinds import Term, Var
from .steps import MASK, check_steps

LATE = 1 << 16
"""Steps of a walk after which it looks whether the term contains itself; as many parts are looked at, at most."""

LATE_ROUND = LATE // (MASK + 1) - 1
"""The round of a walk in which these steps are done."""


def contains_itself(term: Term) -> bool:
    """Tell whether a term contains itself; of a term with many parts only the first are looked at."""
    path: Set[int] = set()
    seen: Set[int] = set()
    stack: List[Any] = [term]
    while stack:
        item = stack.pop()
        if item.__class__ is int:  # all parts of the term of this identity are done
            path.discard(item)
            continue
        while item.__class__ is Var and item.ref is not None:
            item = item.ref
        if item.__class__ is not tuple:
            continue
        key = id(item)
        if key in path:
            return True
        if key in seen:
            continue
        if len(seen) + len(item) > LATE:
            return False
        seen.add(key)
        path.add(key)
        stack.append(key)
        for part in item:
            if part.__class__ is tuple or part.__class__ is Var:
                stack.append(part)
    return False


def refuse_cycles(term: Term) -> None:
    """Give up a walk over a term that contains itself, which would go on for ever.

    Raises:
        TermTooLarge: where it does.
    """
    if contains_itself(term):
        raise TermTooLarge


class MetPairs:
    """Pairs of compound terms that a walk over two terms has met: what holds for all others holds for them."""

    __slots__ = ("_met", "_steps")

    def __init__(self) -> None:
        self._met: Dict[Tuple[int, int], Tuple[Term, Term]] = {}
        """The terms are kept, because the identity of one that is gone may be that of another."""
        self._steps = 0

    def is_new(self, left: Term, right: Term) -> bool:
        """Tell whether a pair is met for the first time; of too many pairs this is no more known."""
        self._steps += 1
        if not self._steps & MASK:
            check_steps(self._steps)
        key = (id(left), id(right))
        if key in self._met:
            return False
        if len(self._met) < LATE:
            self._met[key] = (left, right)
        return True
