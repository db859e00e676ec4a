"""Listeners and their phases, the context of the current event, and the projection of arguments that nobody reads.

Argument projection (column pruning) saves work at the source of an event. A ROS image, for example, is sent to the
engine with a text of a megabyte for its pixels; if no listener reads that argument, the source sends `NOT_READ` in
its place. A listener that is added later and does read the argument never sees the placeholder: its matcher rejects
such events, as if they had come before it was added.
"""

from enum import IntEnum
from typing import AbstractSet, Any, Dict, FrozenSet, Iterable, List, Optional, Tuple

from ...prolog.terms.types import EventAction, Frame, Functor, Term, Var, atom, deref
from ..language.pattern_tree import occurrences
from .matcher_compiler import Matcher


class ListenerPhase(IntEnum):
    """Phase of a listener: lower phases are called first, and in a phase the oldest listener first."""

    TRACE = 0
    """Listeners without effect on other listeners: recordings and logs."""
    SUBSCRIPTIONS = 1
    MEMORIES = 2
    QUERIES = 3
    STATES = 4
    RULES = 5


ListenerStep = Tuple[Matcher, EventAction]
"""Matcher and action of a listener."""


class Listener:
    """Pattern with the action for each matching event; created by `ListenerIndex.listen`.

    Attributes:
        order: sorting key: phase, rank, and number of creation.
        pattern: the pattern.
        functor: its functor; None for a variable.
        matcher: the compiled pattern.
        action: called with each match.
        unread_positions: arguments of the event, counted from 1, that the action does not read.
        is_fused: whether the action may be called without values; see `ListenerIndex.listen`.
        accepts_unread: whether its pattern is a variable whose value is not read, so that it also takes events with
            `NOT_READ` arguments.
    """

    __slots__ = (
        "order",
        "pattern",
        "functor",
        "matcher",
        "action",
        "is_fused",
        "unread_positions",
        "accepts_unread",
    )

    def __init__(
        self,
        order: Tuple[int, ...],
        pattern: Term,
        functor: Optional[Functor],
        matcher: Matcher,
        action: EventAction,
        is_fused: bool,
        unread_positions: FrozenSet[int],
        accepts_unread: bool,
    ):
        self.order = order
        self.pattern = pattern
        self.functor = functor
        self.matcher = matcher
        self.action = action
        self.is_fused = is_fused
        self.unread_positions = unread_positions
        self.accepts_unread = accepts_unread


MAX_RECURSIVE_DEPTH = 5
"""Depth up to which derived events are dispatched by recursive calls; deeper ones by the loop of the machine."""

Context = List[Any]
"""Event that is being dispatched: a list of eight values at the indices below.

Creating a list takes 60 ns, an object with these attributes 115 to 220 ns; an event takes 1,000 to 3,000 ns.
"""

TERM, START, END = 0, 1, 2
"""The event and its interval in ns."""
PARENT = 3
"""Context of the event that it is derived from; None for an input event."""
DEPTH = 4
"""Length of its chain of derivation, including itself."""
GROUND = 5
"""True if the event has no variables; None if that is not known yet."""
CAUSE = 6
"""Value of `Dispatcher.cause` when the event was dispatched."""
TOKEN = 7
"""Unique token of the event; None until `Dispatcher.token` is called."""


class _CallListeners:
    """Code of a frame that calls the remaining listeners of an event."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        """Call listeners until one returns another frame first, or all are called."""
        _, dispatcher, steps, context, following = frame
        dispatcher.current = context
        term, start, end = context[:PARENT]
        # The iterator keeps its position: when the machine comes back to this frame, the loop continues behind the
        # listener that returned another frame first.
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
        next_frame: Frame
        _, dispatcher, context, next_frame = frame
        dispatcher.restore_context(context, dispatcher.cause)
        return next_frame


class _RestoreCause:
    """Code of a frame that restores the previous cause."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        next_frame: Frame
        _, dispatcher, cause, next_frame = frame
        dispatcher.restore_context(dispatcher.current, cause)
        return next_frame


CALL_LISTENERS = _CallListeners()
RESTORE_CONTEXT = _RestoreContext()
RESTORE_CAUSE = _RestoreCause()


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
    """Arguments that no listener reads, and those that sources of events were told to omit.

    Args:
        listeners: the listeners of the dispatcher, by functor.
    """

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
    def match(term: Any) -> Any:
        for position in positions:
            if term[position] is NOT_READ:
                return None
        return matcher(term)

    return match


def _reject_any_unread(matcher: Matcher) -> Matcher:
    def match(term: Any) -> Any:
        if term.__class__ is tuple and NOT_READ in term[1:]:
            return None
        return matcher(term)

    return match
