"""A goal that is called for one event, and what follows it, in one function."""

from typing import Any, Callable, List

from ...foundation import Block, Statement, shared_function, source_of
from ...prolog.database import CompiledGoal
from ...prolog.machine import PrologError
from ...prolog.terms import EventAction, undo
from ..dispatch import AT_ONCE, DEPTH, GROUND, NOBODY
from .heads import Completion


def goal_action(
    goal: CompiledGoal,
    inputs: int,
    rule: Any,
    failed: Callable[[PrologError], None],
    plain: EventAction,
    completion: Completion,
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
    made: EventAction = shared_function(_source(inputs), names, "goal of a rule")
    return made


def _source(inputs: int) -> str:
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
    return source_of([Block("def made(term, values, start, end, after):", body)]) + "\n"
