"""How a rule fires: its event is made of the values of a match, and served."""

from typing import Any, Callable, Mapping, NamedTuple, Optional, Sequence

from ...foundation import UsageError, codegen, shared_function
from ...prolog.machine import Budget, Frame
from ...prolog.terms import EventAction, Term, Var
from .building import builder_source
from .gates import Gate
from .plans import NOBODY, Onlookers


class Head(NamedTuple):
    """How a rule fires, for code that does so in place; `firing_source` writes it.

    Attributes:
        term: the head, which is no alarm.
        rule: has ``firings``, which counts them by a ``number``, with the instant of the ``last``.
        budget: counts the events as pattern work; None if nothing is counted.
        gate: that of the event.
        show: serves an event on which others only look, see `Dispatcher.show`.
        dispatch: serves any other, see `Dispatcher.dispatch`.
        failed: takes the error of an event that is none, and the next frame; returns that.
    """

    term: Term
    rule: Any
    budget: Optional[Budget]
    gate: Gate
    show: Callable[..., Frame]
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
plan = gate.plan
if plan is NOBODY:
    return after
{lines}
try:
    if plan.__class__ is Onlookers:
        return show(plan, {event}, start, end, after)
    return dispatch({event}, start, end, after)
except UsageError as error:
    return failed(error, after)
"""


def firing_source(head: Head, known: Mapping[Var, str], names: codegen.Names) -> str:
    """Return the lines by which a rule fires: they return the frame to go on with.

    Args:
        head: of the rule.
        known: the expressions of the values of its variables; ``start``, ``end`` and ``after`` are as in actions.
        names: get what the lines name.
    """
    lines, event = builder_source(head.term, known, names)
    names.values.update(
        firings=head.rule.firings,
        gate=head.gate,
        show=head.show,
        dispatch=head.dispatch,
        failed=head.failed,
        NOBODY=NOBODY,
        Onlookers=Onlookers,
        UsageError=UsageError,
    )
    return _FIRE.format(lines="\n".join(lines), event=event)


def firing_action(head: Head, order: Sequence[Var]) -> EventAction:
    """Return what takes the values of a match, in the order of their variables, and fires."""
    names = codegen.Names({})
    lines = firing_source(head, {var: f"values[{at}]" for at, var in enumerate(order)}, names)
    if head.budget is not None:
        # Not in a lane, whose event follows from no other: as many of these fire as rules listen.
        lines = _METERED + lines
        names.values.update(pattern_steps=head.budget.pattern_steps, stops=head.budget.stops, fired=head.rule)
    source = "".join(f"    {line}\n" for line in lines.splitlines() if line.strip())
    made: EventAction = shared_function(
        f"def made(term, values, start, end, after):\n{source}", names.values, "head of a rule"
    )
    return made
