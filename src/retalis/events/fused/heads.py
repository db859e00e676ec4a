"""How a rule fires: its event is made of the values of a match, and served."""

from typing import Any, Callable, NamedTuple, Optional, Sequence

from ...foundation import UsageError, codegen, shared_function
from ...prolog.machine import Budget, Frame
from ...prolog.terms import EventAction, Term, Var
from ..dispatch import NOBODY, Gate, builder_source

OPEN = Gate((), None)


class Completion(NamedTuple):
    """What is done with the values of a match of one event.

    Attributes:
        action: does it.
        fused: whether the action may get None for the values of a pattern that takes all events of its functor.
        gate: that of the event that the action makes: where nobody wants it, the action has nothing to do.
    """

    action: EventAction
    fused: bool = False
    gate: Gate = OPEN


class Head(NamedTuple):
    """How a rule fires, for code that does so in place; `firing_source` writes it.

    Attributes:
        term: the head, which is no alarm.
        rule: has ``firings``, which counts them by a ``number``, with the instant of the ``last``.
        budget: counts the events as pattern work; None if nothing is counted.
        gate: that of the event.
        dispatch: serves the event, see `Dispatcher.dispatch`.
        failed: takes the error of an event that is none, and the next frame; returns that.
    """

    term: Term
    rule: Any
    budget: Optional[Budget]
    gate: Gate
    dispatch: Callable[..., Frame]
    failed: Callable[[UsageError, Frame], Frame]


_METERED = """
pattern_steps[0] = steps_left = pattern_steps[0] - 1
if steps_left < 0 and stops(fired):
    return after
"""
"""As the function that `Budget.meter` returns."""
_FIRE = """
firings.number += 1
firings.last = end
if gate.plan is NOBODY:
    return after
{lines}
try:
    return dispatch({event}, start, end, after)
except UsageError as error:
    return failed(error, after)
"""


def firing_action(head: Head, order: Sequence[Var]) -> EventAction:
    """Return what takes the values of a match, in the order of their variables, and fires."""
    names = codegen.Names({})
    lines, event = builder_source(head.term, {var: f"values[{at}]" for at, var in enumerate(order)}, names)
    source = _FIRE.format(lines="\n".join(lines), event=event)
    names.values.update(
        firings=head.rule.firings,
        gate=head.gate,
        dispatch=head.dispatch,
        failed=head.failed,
        NOBODY=NOBODY,
        UsageError=UsageError,
    )
    if head.budget is not None:
        source = _METERED + source
        names.values.update(pattern_steps=head.budget.pattern_steps, stops=head.budget.stops, fired=head.rule)
    body = "".join(f"    {line}\n" for line in source.splitlines() if line.strip())
    made: EventAction = shared_function(
        f"def made(term, values, start, end, after):\n{body}", names.values, "head of a rule"
    )
    return made
