"""Which arguments of events nobody reads: who makes the events from messages may leave those out.

An image's bytes beside its header are text of a megabyte between the two nodes, written and read for nothing where
no rule looks at them. What is left out has `NOT_READ` in its place. Listeners that come later and do look never see
that: to them an event in which something is missing that they read is one from before they came.
"""

from typing import AbstractSet, Any, Dict, FrozenSet, Iterable, Optional

from ...prolog.terms import Functor, Term, Var, atom, deref
from ..language import occurrences
from .matching import Matcher
from .serving import Listener

NOT_READ = atom("$not_read")
"""What stands in an event for an argument that nobody reads."""

Positions = FrozenSet[int]
"""Arguments by number, counted from 1."""

NONE: Positions = frozenset()

MOST = 1000
"""Functors of which it is told at most that arguments may be left out."""


def unread_positions(pattern: Term, unused: AbstractSet[Var]) -> Positions:
    """Return the arguments of a pattern that are variables of their own, with values that nobody uses."""
    if pattern.__class__ is not tuple or not unused:
        return NONE
    places = occurrences([pattern], None)
    return frozenset(
        at
        for at, one in enumerate(map(deref, pattern[1:]), 1)
        if one.__class__ is Var and one in unused and places[one] == 1
    )


class Unread:
    """What nobody reads, and what makers of events were told of it.

    Args:
        listeners: those of the dispatcher, by functor.
    """

    def __init__(self, listeners: Dict[Optional[Functor], Dict[Listener, None]]):
        self._listeners = listeners
        self._told: Dict[Functor, Positions] = {}

    def tell(self) -> Dict[Functor, Positions]:
        """Return, by functor, the arguments of events that may be left out from now on.

        Any thread may ask. What is told is noted first, and looked at once more then: a listener that comes meanwhile
        is either seen the second time, or sees the note (`Unread.guard`).
        """
        for functor, positions in self._found().items():
            known = self._told.get(functor, NONE)
            if positions and (known or len(self._told) < MOST):
                self._told[functor] = known | positions
        found = self._found()
        return {
            functor: positions & self._told[functor]
            for functor, positions in found.items()
            if positions & self._told.get(functor, NONE)
        }

    def _found(self) -> Dict[Functor, Positions]:
        groups = list(self._listeners.items())
        if any(functor is None and not one.partial for functor, group in groups for one in list(group)):
            return {}  # somebody takes all events whole
        return {
            functor: frozenset.intersection(*(one.unread for one in group))
            for functor, group in ((functor, list(group)) for functor, group in groups)
            if functor is not None and group
        }

    def guard(self, listener: Listener) -> None:
        """Have a listener, which is among the others already, not match what lacks an argument that it reads."""
        functor = listener.functor
        if functor is not None:
            missing = self._told.get(functor, NONE) - listener.unread
            if missing:
                listener.matcher = _guarded(listener.matcher, sorted(missing))
                listener.fused = False
        elif self._told and not listener.partial:
            listener.matcher = _guarded_all(listener.matcher)


def _guarded(matcher: Matcher, positions: Iterable[int]) -> Matcher:
    def match(term: Any) -> Any:
        for at in positions:
            if term[at] is NOT_READ:
                return None
        return matcher(term)

    return match


def _guarded_all(matcher: Matcher) -> Matcher:
    def match(term: Any) -> Any:
        if term.__class__ is tuple and NOT_READ in term[1:]:
            return None
        return matcher(term)

    return match
