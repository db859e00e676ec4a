"""Conditional compilation: ``:- if(Goal)``, ``elif``, ``else`` and ``endif`` of a file."""

from typing import Callable, List, Optional

from ...foundation import Place, RuleError
from ...prolog.terms import Atom, Term, deref, functor

_IF, _ELIF = functor("if", 1), functor("elif", 1)
_ELSE, _ENDIF = functor("else", 0), functor("endif", 0)

Holds = Callable[[Term, Optional[Place]], bool]


class _Branch:
    """An ``if`` that is open."""

    __slots__ = ("place", "outside", "counts", "chosen", "last")

    def __init__(self, place: Optional[Place], outside: bool):
        self.place = place
        self.outside = outside
        """Whether what stands around it counts."""
        self.counts = False
        """Whether what stands in the branch that is open counts."""
        self.chosen = False
        """Whether one of its branches has counted."""
        self.last = False
        """Whether that is the branch of ``else``."""

    def choose(self, holds: bool) -> None:
        self.counts = self.outside and holds and not self.chosen
        self.chosen |= self.counts


class Conditions:
    """The ``if`` directives of a file that are open, the outer ones first.

    Args:
        holds: tells whether the goal of an ``if`` at a place is true.
    """

    def __init__(self, holds: Holds):
        self._holds = holds
        self._open: List[_Branch] = []

    @property
    def skip(self) -> bool:
        """Whether what follows does not count."""
        return bool(self._open) and not self._open[-1].counts

    def take(self, goal: Term, place: Optional[Place]) -> bool:
        """Return whether a directive is one of these, and follow it.

        Raises:
            RuleError: where no ``if`` is open that it belongs to.
        """
        goal = deref(goal)
        key = goal[0] if goal.__class__ is tuple else goal.functor if isinstance(goal, Atom) else None
        if goal.__class__ is tuple and key is _IF:
            branch = _Branch(place, not self.skip)
            self._open.append(branch)
            branch.choose(branch.outside and self._holds(goal[1], place))
        elif goal.__class__ is tuple and key is _ELIF:
            branch = self._innermost("elif", place)
            branch.choose(branch.outside and not branch.chosen and self._holds(goal[1], place))
        elif key is _ELSE:
            branch = self._innermost("else", place)
            branch.choose(True)
            branch.last = True
        elif key is _ENDIF:
            self._innermost("endif", place, closes=True)
            self._open.pop()
        else:
            return False
        return True

    def unclosed(self) -> List[RuleError]:
        """Return an error for each ``if`` that no ``endif`` closes."""
        return [RuleError("this if has no endif", branch.place) for branch in self._open]

    def _innermost(self, name: str, place: Optional[Place], closes: bool = False) -> _Branch:
        if not self._open:
            raise RuleError(f"there is no if before this {name}", place)
        if self._open[-1].last and not closes:
            raise RuleError(f"there is an else before this {name}", place)
        return self._open[-1]
