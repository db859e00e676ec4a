"""Listeners and their phases, and the context of the current event."""

from enum import IntEnum
from typing import Any, FrozenSet, List, Optional, Tuple

from ...prolog.terms.types import EventAction, Frame, Functor, Term
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


class Listener:
    """Pattern with the action for each matching event; created by `ListenerIndex.listen`.

    Attributes:
        order: sorting key: phase, rank, and number of creation.
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
