"""Argument projection: the arguments of events that no listener reads, and that sources may omit.

Argument projection (column pruning) saves work at the source of an event. A ROS image, for example, is sent to the
engine with a text of a megabyte for its pixels; if no listener reads that argument, the source sends `NOT_READ` in
its place. A listener that is added later and does read the argument never sees the placeholder: its matcher rejects
such events, as if they had come before it was added.
"""

from typing import AbstractSet, Any, Dict, FrozenSet, Iterable, Optional

from ...prolog.terms.types import Functor, Term, Values, Var, atom, deref
from ..language.pattern_tree import occurrences
from .listeners import Listener
from .matcher_compiler import Matcher

NOT_READ = atom("$not_read")
"""Placeholder in an event for an argument that no listener reads."""

Positions = FrozenSet[int]
"""Argument positions, counted from 1."""

NO_POSITIONS: Positions = frozenset()

MAX_PROJECTED_FUNCTORS = 1000
"""Maximum number of functors for which projections are announced."""


def find_unread_positions(pattern: Term, unread_variables: AbstractSet[Var]) -> Positions:
    """Return the positions of arguments that are unread variables without another occurrence in the pattern."""
    if pattern.__class__ is not tuple or not unread_variables:
        return NO_POSITIONS
    counts = occurrences([pattern], None)
    return frozenset(
        position
        for position, argument in enumerate(map(deref, pattern[1:]), 1)
        if argument.__class__ is Var and argument in unread_variables and counts[argument] == 1
    )


class ArgumentProjection:
    """Arguments that no listener reads, and those that sources of events were told to omit."""

    def __init__(self, listeners: Dict[Optional[Functor], Dict[Listener, None]]):
        self._listeners = listeners
        self._announced: Dict[Functor, Positions] = {}

    def announce(self) -> Dict[Functor, Positions]:
        """Return, by functor, the arguments that sources may omit from now on.

        Thread-safe. The result is stored before it is checked a second time: a listener that is added concurrently is
        either seen by the second check, or sees the stored result in `reject_events_with_unread`.
        """
        # Announced positions are never withdrawn here: events with placeholders may be on their way, so
        # `reject_events_with_unread` must know all positions that were ever announced.
        for functor, positions in self._find_commonly_unread().items():
            announced = self._announced.get(functor, NO_POSITIONS)
            if positions and (announced or len(self._announced) < MAX_PROJECTED_FUNCTORS):
                self._announced[functor] = announced | positions
        unread = self._find_commonly_unread()
        return {
            functor: positions & self._announced[functor]
            for functor, positions in unread.items()
            if positions & self._announced.get(functor, NO_POSITIONS)
        }

    def _find_commonly_unread(self) -> Dict[Functor, Positions]:
        """Return, by functor, the arguments that no listener reads."""
        # Copied, because other threads add listeners.
        groups = list(self._listeners.items())
        if any(
            functor is None and not listener.accepts_unread
            for functor, group in groups
            for listener in list(group)
        ):
            # A listener for all events reads all of their arguments.
            return {}
        return {
            functor: frozenset.intersection(*(listener.unread_positions for listener in group))
            for functor, group in ((functor, list(group)) for functor, group in groups)
            if functor is not None and group
        }

    def reject_events_with_unread(self, listener: Listener) -> None:
        """Make a new listener reject events that lack an argument that it reads.

        The listener must be in the table already.
        """
        functor = listener.functor
        if functor is not None:
            may_be_omitted = self._announced.get(functor, NO_POSITIONS) - listener.unread_positions
            if may_be_omitted:
                listener.matcher = _reject_unread(listener.matcher, sorted(may_be_omitted))
                # A fused action would bypass the guarded matcher.
                listener.is_fused = False
        elif self._announced and not listener.accepts_unread:
            listener.matcher = _reject_any_unread(listener.matcher)


def _reject_unread(matcher: Matcher, positions: Iterable[int]) -> Matcher:
    def match(term: Any) -> Optional[Values]:
        for position in positions:
            if term[position] is NOT_READ:
                return None
        return matcher(term)

    return match


def _reject_any_unread(matcher: Matcher) -> Matcher:
    def match(term: Any) -> Optional[Values]:
        if term.__class__ is tuple and NOT_READ in term[1:]:
            return None
        return matcher(term)

    return match
