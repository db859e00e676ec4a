"""Listeners, their stages, and the context of the event that is being served.

Which arguments of events nobody reads: who makes the events from messages may leave those out.

An image's bytes beside its header are text of a megabyte between the two nodes, written and read for nothing where
no rule looks at them. What is left out has `NOT_READ` in its place. Listeners that come later and do look never see
that: to them an event in which something is missing that they read is one from before they came.
"""

from enum import IntEnum
from typing import AbstractSet, Any, Dict, FrozenSet, Iterable, List, Optional, Tuple

from ...prolog.terms.types import EventAction, Frame, Functor, Term, Var, atom, deref
from ..language.pattern_tree import occurrences
from .matcher_compiler import Matcher


class ListenerPhase(IntEnum):
    """When a listener is served: lower stages first, in a stage the oldest first."""

    TRACE = 0
    """Those who only look on: recorded streams, logs."""
    SUBSCRIPTIONS = 1
    MEMORIES = 2
    QUERIES = 3
    STATES = 4
    RULES = 5


ListenerStep = Tuple[Matcher, EventAction]
"""What is done for a listener."""


class Listener:
    """One pattern with what to do for each event that matches it; made by `Audience.listen`.

    Attributes:
        unread: the arguments of the event, counted from 1, that the action never looks at.
        fused: whether the action may be called without values; see `Audience.listen`.
        partial: whether it takes events of all kinds, and those too in which something is missing that nobody reads.
    """

    __slots__ = (
        "order",
        "pattern",
        "functor",
        "matcher",
        "action",
        "fused",
        "unread",
        "partial",
    )

    def __init__(
        self,
        order: Tuple[int, ...],
        pattern: Term,
        functor: Optional[Functor],
        matcher: Matcher,
        action: EventAction,
        fused: bool,
        unread: FrozenSet[int],
        partial: bool,
    ):
        self.order = order
        self.pattern = pattern
        self.functor = functor
        self.matcher = matcher
        self.action = action
        self.fused = fused
        self.unread = unread
        self.partial = partial


AT_ONCE = 5
"""To this depth derived events are served inside the call that makes them; deeper ones by the machine's loop."""

Context = List[Any]
"""An event that is being served: a list of the eight values whose places are named below.

A list is made in 60 ns, an object with these attributes in 115 to 220; an event is served in 1,000 to 3,000.
"""

TERM, START, END = 0, 1, 2
"""The event and its interval in ns."""
PARENT = 3
"""The context of the event that it is derived from; None for an event that comes in."""
DEPTH = 4
"""The number of events that it is derived through, itself included."""
GROUND = 5
"""True if the event has no variables; None if nobody has looked yet."""
CAUSE = 6
"""`Dispatcher.cause` when the event came."""
TOKEN = 7
"""The token of the event, which no other event has; None until `Dispatcher.token` is called."""


class _Serve:
    """Code of a frame that serves the remaining listeners of an event."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        """Serve listeners until one of them has something to do first, or none is left."""
        _, dispatcher, steps, context, following = frame
        dispatcher.current = context
        term, start, end = context[:PARENT]
        for matcher, action in steps:
            values = matcher(term)
            if values is not None:
                next_frame = action(term, values, start, end, frame)
                if next_frame is not frame:
                    return next_frame  # type: ignore[no-any-return]
        dispatcher.current = context[PARENT]
        return following  # type: ignore[no-any-return]


class _RestoreContext:
    """Code of a frame that restores the previous context."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        after: Frame
        _, dispatcher, context, after = frame
        dispatcher.restore(context, dispatcher.cause)
        return after


class _CauseAgain:
    """Code of a frame that restores the previous cause."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        after: Frame
        _, dispatcher, cause, after = frame
        dispatcher.restore(dispatcher.current, cause)
        return after


SERVE = _Serve()
RESTORE_CONTEXT = _RestoreContext()
CAUSE_AGAIN = _CauseAgain()


NOT_READ = atom("$not_read")
"""What stands in an event for an argument that nobody reads."""

Positions = FrozenSet[int]
"""Arguments by number, counted from 1."""

NONE: Positions = frozenset()

MAX_FUNCTORS = 1000
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


class ArgumentProjection:
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
        is either seen the second time, or sees the note (`ArgumentProjection.guard`).
        """
        for functor, positions in self._found().items():
            known = self._told.get(functor, NONE)
            if positions and (known or len(self._told) < MAX_FUNCTORS):
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
