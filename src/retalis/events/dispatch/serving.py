"""What the dispatcher deals in: listeners, the stages in which they are served, and events that are being served."""

from enum import IntEnum
from typing import Any, Callable, FrozenSet, Iterator, Optional, Tuple

from ...prolog.terms import TRUE, EventAction, Frame, Functor, Term
from .matching import Matcher

Lane = Callable[[Term, int, int], bool]
"""Takes an event without variables that follows from no other, start and end; tells whether it has been served."""


MakeLane = Callable[[], Lane]
"""Makes a lane, where it is to be used: most listeners never need theirs."""


class Stage(IntEnum):
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
        partial: whether it takes events of all kinds, and those too in which something is missing that nobody reads.
    """

    __slots__ = (
        "order",
        "pattern",
        "functor",
        "matcher",
        "action",
        "lane",
        "looks_on",
        "sole",
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
        lane: Optional[MakeLane],
        looks_on: bool,
        sole: bool,
        unread: FrozenSet[int],
        partial: bool,
    ):
        self.order = order
        self.pattern = pattern
        self.functor = functor
        self.matcher = matcher
        self.action = action
        self.lane = lane
        self.looks_on = looks_on
        self.sole = sole
        self.unread = unread
        self.partial = partial


AT_ONCE = 5
"""To this depth derived events are served inside the call that makes them; deeper ones by the machine's loop."""


class Dispatch:
    """The dispatch of one event; as ``code`` of a frame it serves the listeners that are left.

    Attributes:
        dispatcher: the `Dispatcher`, which is made of these; None where nobody is left to be served.
        token: what tells this event from all others, given by `Dispatcher.token`.
        depth: how many events it was derived through, itself included.
        cause: the rule and match whose goal made it, where that is tracked.
        ground: whether it has no variables; None while nobody has looked.
    """

    __slots__ = ("dispatcher", "steps", "term", "start", "end", "parent", "depth", "token", "cause", "ground")

    dispatcher: Any
    steps: Iterator[ListenerStep]
    term: Term
    start: int
    end: int
    parent: Optional["Dispatch"]
    depth: int
    token: Any
    cause: Any
    ground: Optional[bool]

    def run(self, frame: Frame) -> Frame:
        """Serve listeners until one of them has something to do first, or none is left."""
        dispatcher = self.dispatcher
        dispatcher.current = self
        term = self.term
        start = self.start
        end = self.end
        for matcher, action in self.steps:
            values = matcher(term)
            if values is not None:
                after = action(term, values, start, end, frame)
                if after is not frame:
                    return after
        dispatcher.current = self.parent
        return frame[1]  # type: ignore[no-any-return]


def event_of(dispatcher: Any, term: Term, start: int, end: int, depth: int) -> Dispatch:
    """Return an event without variables whose listeners have been served, or are by others."""
    event = Dispatch()
    event.dispatcher = dispatcher
    event.steps = iter(())
    event.term, event.start, event.end = term, start, end
    event.token = event.parent = event.cause = None
    event.ground = True
    event.depth = depth
    return event


LEFT_OUT = [event_of(None, TRUE, 0, 0, depth) for depth in range(1, AT_ONCE + 1)]
"""What is current in place of events that are not made, by the depth of what they follow from: at 0 of nothing."""


class _ServeAgain:
    """Code of a frame by which the dispatcher serves again what it did before."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        after: Frame
        _, dispatcher, current, after = frame
        dispatcher.restore(current, dispatcher.cause)
        return after


class _CauseAgain:
    """Code of a frame from which on events have the cause again that they had before."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        after: Frame
        _, dispatcher, cause, after = frame
        dispatcher.restore(dispatcher.current, cause)
        return after


SERVE_AGAIN = _ServeAgain()
CAUSE_AGAIN = _CauseAgain()
