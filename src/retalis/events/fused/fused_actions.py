"""Actions of rules: a goal of a single event, the event that a rule makes, and a synchronized query."""

from typing import Any, Callable, List, NamedTuple, Optional, Sequence

from ...foundation import codegen
from ...foundation.codegen import Block, Statement, shared_function, source_of
from ...foundation.errors import UsageError
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.errors import PrologError
from ...prolog.machine.resource_limits import Meter
from ...prolog.terms.term_traversal import are_ground
from ...prolog.terms.types import TRUE, EventAction, Frame, Functor, Term, Values, Var
from ...prolog.terms.unification import undo
from ..dispatch.discrimination_tree import NOBODY, PushdownFilter
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import AT_ONCE, DEPTH, GROUND, RESTORE_CONTEXT
from ..dispatch.matcher_compiler import builder_source

_OPEN_GATE = PushdownFilter((), None)
"""A gate that lets everything pass, as its plan is never known."""


class Continuation(NamedTuple):
    """The action for the values of a match of one event, with what is known about it.

    Attributes:
        action: the action.
        fused: whether it may get None for the values of a pattern that takes all events of its functor.
        gate: that of the event that it makes: where nobody wants it, the action has nothing to do.
    """

    action: EventAction
    fused: bool = False
    gate: PushdownFilter = _OPEN_GATE


def firing_action(
    head: Term,
    order: Sequence[Var],
    rule: Any,
    gate: PushdownFilter,
    failed: Callable[[UsageError, Frame], Frame],
) -> EventAction:
    """Return the action that emits a rule's head for a match.

    Args:
        head: the head, which is no alarm.
        order: the variables, in the order of the values of a match.
        rule: the rule.
        gate: that of the event.
        failed: takes the error of an event that is none, and the next frame; returns that.
    """
    names = codegen.BoundNames({})
    lines, event = builder_source(head, {var: f"values[{at}]" for at, var in enumerate(order)}, names)
    body: List[Statement] = [
        "firings.number += 1",
        "firings.last = end",
        Block("if gate.plan is NOBODY:", ["return after"]),
        *lines,
        Block("try:", [f"return dispatch({event}, start, end, after)"]),
        Block("except UsageError as error:", ["return failed(error, after)"]),
    ]
    names.values.update(
        firings=rule.firings,
        gate=gate,
        dispatch=rule.network.dispatcher.dispatch,
        failed=failed,
        NOBODY=NOBODY,
        UsageError=UsageError,
    )
    if rule.meter is not None:  # as the function that `Budget.meter` returns
        budget = rule.network.logic.machine.budget
        body[:0] = [
            "pattern_steps[0] = steps_left = pattern_steps[0] - 1",
            Block("if steps_left < 0 and stops(rule):", ["return after"]),
        ]
        names.values.update(pattern_steps=budget.pattern_steps, stops=budget.stops, rule=rule)
    source = source_of([Block("def made(term, values, start, end, after):", body)])
    made: EventAction = shared_function(source, names.values, "head of a rule")
    return made


def goal_action(
    goal: CompiledGoal,
    inputs: int,
    rule: Any,
    failed: Callable[[PrologError], None],
    plain: EventAction,
    completion: Continuation,
) -> EventAction:
    """Return the action that calls a goal for each event of a rule whose pattern is a single event.

    Args:
        goal: the goal; its inputs are the values of the match, and it has no outputs.
        inputs: how many there are.
        rule: the rule.
        failed: takes the error of the goal.
        plain: does the same, for any event.
        completion: goes on where the goal succeeds.
    """
    machine = rule.network.logic.machine
    names = {
        "code": goal.code,
        "goal": goal,
        "failed": failed,
        "plain": plain,
        "solved": completion.action,
        "gate": completion.gate,
        "NOBODY": NOBODY,
        "firings": rule.firings,
        "dispatcher": rule.network.dispatcher,
        "machine": machine,
        "budget": machine.budget,
        "trail": machine.trail,
        "done": machine.done,
        "undo": undo,
    }
    made: EventAction = shared_function(_goal_source(inputs), names, "goal of a rule")
    return made


def _goal_source(inputs: int) -> str:
    """Return the source of the action of a goal with so many inputs."""
    values = ", ".join(f"a{at}" for at in range(inputs))
    body: List[Statement] = [
        "context = dispatcher.current",
        Block(
            f"if not code.steady or not context[{GROUND}] or context[{DEPTH}] > {AT_ONCE}:",
            ["return plain(term, term[1:] if values is None else values, start, end, after)"],
        ),
        Block("if values is None:", [f"_, {values} = term"]),
        Block("else:", [f"{values}, = values"]),
        f"frame = (code, {values}, done)",
        "mark = len(trail)",
        "asked = budget.goal",
        Block(  # as `Machine.check`, in an entry that has been entered
            "try:",
            [
                Block("if budget.closed:", ["budget.admit()"]),
                "budget.goal = goal",
                "left = code.run(frame)",
                "found = (left is done and len(trail) == mark) or machine.settle(left, mark)",
            ],
        ),
        Block(
            "except Exception as exc:",
            [
                "dispatcher.current = context",
                "budget.goal = asked",
                "failed(machine.error(exc, frame, mark))",
                "return after",
            ],
        ),
        Block("except BaseException:", ["undo(trail, mark)", "raise"]),
        Block("finally:", ["budget.goal = asked"]),
        Block("if not found:", ["return after"]),
        Block("if gate.plan is NOBODY:", ["firings.number += 1", "firings.last = end", "return after"]),
        f"return solved(term, ({values},), start, end, after)",
    ]
    return source_of([Block("def made(term, values, start, end, after):", body)])


def question_action(
    dispatcher: Dispatcher,
    key: Functor,
    known: int,
    ask: Callable[[Values, int, int, Frame], Frame],
    plain: EventAction,
    meter: Optional[Meter],
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
    gate, ground, at_once = dispatcher.gate(key), dispatcher.ground, dispatcher.at_once

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
