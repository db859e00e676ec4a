"""A rule whose event asks a synchronized query: the query is asked without making the event."""

from typing import Any, Callable, Optional

from ...prolog.machine import Frame
from ...prolog.terms import TRUE, EventAction, Functor, Term, Values, are_ground
from ..dispatch import AT_ONCE, DEPTH, GROUND, RESTORE_CONTEXT, Dispatcher


def question_action(
    dispatcher: Dispatcher,
    key: Functor,
    known: int,
    ask: Callable[[Values, int, int, Frame], Frame],
    plain: EventAction,
    meter: Optional[Callable[[int], bool]],
) -> EventAction:
    """Return the action that asks a synchronized query with the values of a match, without making its event.

    Args:
        dispatcher: of the events.
        key: functor of the event.
        known: how many of the values of a match, the first ones, are ground where the event is.
        ask: what the listener does; takes values, start, end and the next frame.
        plain: makes the event and has it served.
        meter: counts the pattern work of the rule; see `Budget.meter`.
    """
    gate, ground = dispatcher.gate(key), dispatcher.ground
    at_once = min(AT_ONCE, dispatcher.max_depth + 1)

    def act(term: Term, values: Optional[Values], start: int, end: int, after: Frame) -> Frame:
        context = dispatcher.current
        if values is None:
            values = term[1:]  # type: ignore[index]
        plan: Any = gate.plan
        if plan is None:
            plan = dispatcher.plan(key)
        if (
            context is None
            or context[DEPTH] >= at_once
            or plan.__class__ is not tuple
            or len(plan) != 1
            or not (context[GROUND] and known == len(values))
            and not are_ground(values[known:] if ground() else values)
        ):
            return plain(term, values, start, end, after)
        if meter is not None and meter(1):
            return after
        dispatcher.current = [TRUE, start, end, context, context[DEPTH] + 1, True, dispatcher.cause, None]
        following = (RESTORE_CONTEXT, dispatcher, context, after)
        frame = ask(values, start, end, following)
        if frame is not following:
            return frame
        dispatcher.current = context
        return after

    return act
