"""The event of a rule, made of the values of a match and dispatched by one function."""

from typing import Any, Callable, List, NamedTuple, Optional, Sequence

from ...foundation import Block, Statement, UsageError, codegen, shared_function, source_of
from ...prolog.machine import Budget, Frame
from ...prolog.terms import EventAction, Term, Var
from ..dispatch import NOBODY, Gate, builder_source

_OPEN_GATE = Gate((), None)
"""A gate that lets everything pass, as its plan is never known."""


class Completion(NamedTuple):
    """What is done with the values of a match of one event.

    Attributes:
        action: does it.
        fused: whether the action may get None for the values of a pattern that takes all events of its functor.
        gate: that of the event that the action makes: where nobody wants it, the action has nothing to do.
    """

    action: EventAction
    fused: bool = False
    gate: Gate = _OPEN_GATE


class Head(NamedTuple):
    """The head of a rule with what is needed to fire it.

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


def firing_action(head: Head, order: Sequence[Var]) -> EventAction:
    """Return the action that emits a rule's head for a match; its values come in the order of the variables."""
    names = codegen.Names({})
    lines, event = builder_source(head.term, {var: f"values[{at}]" for at, var in enumerate(order)}, names)
    body: List[Statement] = [
        "firings.number += 1",
        "firings.last = end",
        Block("if gate.plan is NOBODY:", ["return after"]),
        *lines,
        Block("try:", [f"return dispatch({event}, start, end, after)"]),
        Block("except UsageError as error:", ["return failed(error, after)"]),
    ]
    names.values.update(
        firings=head.rule.firings,
        gate=head.gate,
        dispatch=head.dispatch,
        failed=head.failed,
        NOBODY=NOBODY,
        UsageError=UsageError,
    )
    if head.budget is not None:  # as the function that `Budget.meter` returns
        body[:0] = [
            "pattern_steps[0] = steps_left = pattern_steps[0] - 1",
            Block("if steps_left < 0 and stops(fired):", ["return after"]),
        ]
        names.values.update(pattern_steps=head.budget.pattern_steps, stops=head.budget.stops, fired=head.rule)
    source = source_of([Block("def made(term, values, start, end, after):", body)]) + "\n"
    made: EventAction = shared_function(source, names.values, "head of a rule")
    return made
