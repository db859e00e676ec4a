"""Fused actions of rules with a single event: goal call, emission of the head, and synchronized query.

The general path creates a match, calls the goal through the machine, builds the head event and dispatches it. The
functions generated here do the same on the values of the event directly. Each begins with the conditions under which
that is allowed (ground event, low depth, a goal without choice points) and otherwise calls the general path
(`general_path`) before anything has changed. Results are the same on both paths.
"""

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
from ..dispatch.discrimination_tree import NO_LISTENERS, PushdownFilter
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import DEPTH, GROUND, MAX_RECURSIVE_DEPTH, RESTORE_CONTEXT
from ..dispatch.matcher_compiler import generate_builder

_PASS_ALL_FILTER = PushdownFilter((), None)
"""Filter that passes all events, because its plan stays unknown."""


class Continuation(NamedTuple):
    """Action for the values of a match of one event, with properties by which generated code can shorten it.

    Attributes:
        is_fused: whether the action accepts None for the values of a pattern that matches all events of its functor.
        event_filter: filter for the event that the action creates; if it has no listeners, the action has no effect.
    """

    action: EventAction
    is_fused: bool = False
    event_filter: PushdownFilter = _PASS_ALL_FILTER


def compile_firing_action(
    head: Term,
    value_vars: Sequence[Var],
    rule: Any,
    event_filter: PushdownFilter,
    on_error: Callable[[UsageError, Frame], Frame],
) -> EventAction:
    """Return the action that emits the head of a rule for a match.

    Args:
        head: the head, not an alarm.
        value_vars: the variables of the values of a match, in order.
        rule: the rule.
        event_filter: filter for the head event.
        on_error: called with the error if the head is not a valid event, and the next frame; returns a frame.
    """
    names = codegen.BoundNames({})
    lines, event = generate_builder(
        head, {var: f"values[{index}]" for index, var in enumerate(value_vars)}, names
    )
    body: List[Statement] = [
        "metrics.firing_count += 1",
        "metrics.last_end = end",
        # The firing is counted first: metrics must not depend on whether the event has listeners.
        "plan = event_filter.plan",
        Block("if plan is NO_LISTENERS:", ["return frame"]),
        *lines,
        Block("try:", _dispatch_statements(event)),
        Block("except UsageError as error:", ["return on_error(error, frame)"]),
    ]
    names.values.update(
        metrics=rule.metrics,
        event_filter=event_filter,
        dispatcher=rule.network.dispatcher,
        on_error=on_error,
        RESTORE_CONTEXT=RESTORE_CONTEXT,
        NO_LISTENERS=NO_LISTENERS,
        UsageError=UsageError,
    )
    # Inlined from the function that `Budget.meter` returns.
    if rule.meter is not None:
        budget = rule.network.logic.machine.budget
        body[:0] = [
            "pattern_steps[0] = steps_left = pattern_steps[0] - 1",
            Block("if steps_left < 0 and stops(rule):", ["return frame"]),
        ]
        names.values.update(pattern_steps=budget.pattern_steps, stops=budget.stops, rule=rule)
    source = source_of([Block("def generated(term, values, start, end, frame):", body)])
    action: EventAction = shared_function(source, names.values, "head of a rule")
    return action


def _dispatch_statements(event: str) -> List[Statement]:
    """Return statements that dispatch a derived event by ``plan``; without a call if it has one listener."""
    return [
        "context = dispatcher.current",
        Block(
            "if plan.__class__ is not tuple or len(plan) != 1 or context is None"
            f" or context[{DEPTH}] >= dispatcher.max_recursive_depth or start > end:",
            [f"return dispatcher.dispatch({event}, start, end, frame)"],
        ),
        f"dispatcher.current = [{event}, start, end, context, context[{DEPTH}] + 1, None, dispatcher.cause, None]",
        "matcher, action = plan[0]",
        f"values = matcher({event})",
        Block(
            "if values is not None:",
            [
                "resumption = (RESTORE_CONTEXT, dispatcher, context, frame)",
                f"next_frame = action({event}, values, start, end, resumption)",
                Block("if next_frame is not resumption:", ["return next_frame"]),
            ],
        ),
        "dispatcher.current = context",
        "return frame",
    ]


def compile_goal_action(
    goal: CompiledGoal,
    input_count: int,
    rule: Any,
    on_error: Callable[[PrologError], None],
    general_path: EventAction,
    completion: Continuation,
) -> EventAction:
    """Return the action that calls a goal for each event of a rule whose pattern is a single event.

    Args:
        goal: the goal; its inputs are the values of the match, and it has no outputs.
        input_count: number of inputs, at least 1.
        rule: the rule.
        on_error: called with the error of the goal.
        general_path: the general path, for any event.
        completion: action if the goal succeeds.
    """
    machine = rule.network.logic.machine
    names = {
        "code": goal.code,
        "goal": goal,
        "on_error": on_error,
        "general_path": general_path,
        "solved": completion.action,
        "event_filter": completion.event_filter,
        "NO_LISTENERS": NO_LISTENERS,
        "metrics": rule.metrics,
        "dispatcher": rule.network.dispatcher,
        "machine": machine,
        "budget": machine.budget,
        "trail": machine.trail,
        "done": machine.done,
        "undo": undo,
    }
    action: EventAction = shared_function(_goal_source(input_count), names, "goal of a rule")
    return action


def _goal_source(input_count: int) -> str:
    """Return the source of the action for a goal with a number of inputs."""
    values = ", ".join(f"a{index}" for index in range(input_count))
    body: List[Statement] = [
        "context = dispatcher.current",
        Block(
            f"if not code.keeps_choice_points or not context[{GROUND}] or context[{DEPTH}] > {MAX_RECURSIVE_DEPTH}:",
            ["return general_path(term, term[1:] if values is None else values, start, end, frame)"],
        ),
        Block("if values is None:", [f"_, {values} = term"]),
        Block("else:", [f"{values}, = values"]),
        f"goal_frame = (code, {values}, done)",
        # The trail is as long as before if the goal bound nothing outside of itself.
        "mark = len(trail)",
        "outer_goal = budget.goal",
        # Inlined from `Machine.check`, within an entry of the machine.
        Block(
            "try:",
            [
                Block("if budget.needs_check:", ["budget.check_entry()"]),
                "budget.goal = goal",
                "last = code.run(goal_frame)",
                "solved_goal = (last is done and len(trail) == mark) or machine.finish_step(last, mark)",
            ],
        ),
        Block(
            "except Exception as exc:",
            [
                "dispatcher.current = context",
                "budget.goal = outer_goal",
                "on_error(machine.error(exc, goal_frame, mark))",
                "return frame",
            ],
        ),
        # Bindings must not survive an exception.
        Block("except BaseException:", ["undo(trail, mark)", "raise"]),
        Block("finally:", ["budget.goal = outer_goal"]),
        Block("if not solved_goal:", ["return frame"]),
        Block(
            "if event_filter.plan is NO_LISTENERS:",
            ["metrics.firing_count += 1", "metrics.last_end = end", "return frame"],
        ),
        f"return solved(term, ({values},), start, end, frame)",
    ]
    return source_of([Block("def generated(term, values, start, end, frame):", body)])


def compile_query_action(
    dispatcher: Dispatcher,
    key: Functor,
    ground_count: int,
    run_query: Callable[[Values, int, int, Frame], Frame],
    general_path: EventAction,
    meter: Optional[Meter],
) -> EventAction:
    """Return the action that runs a synchronized query for the values of a match, without creating its event.

    Args:
        dispatcher: the dispatcher of the events.
        key: functor of the event.
        ground_count: number of leading values of a match that are ground if the event is.
        run_query: action of the listener of the event; takes values, start, end and the next frame.
        general_path: creates the event and dispatches it.
        meter: counts the pattern work of the rule; see `Budget.meter`.
    """
    event_filter = dispatcher.event_filter(key)
    ground = dispatcher.ground
    max_depth = dispatcher.max_recursive_depth

    def run_query_directly(term: Term, values: Optional[Values], start: int, end: int, frame: Frame) -> Frame:
        context = dispatcher.current
        if values is None:
            values = term[1:]  # type: ignore[index]
        # Exactly one listener, the query itself, may take the event; otherwise the event must exist for the others.
        plan: Any = event_filter.plan
        if plan is None:
            plan = dispatcher.build_plan(key)
        if (
            context is None
            or context[DEPTH] >= max_depth
            or plan.__class__ is not tuple
            or len(plan) != 1
            or not (context[GROUND] and ground_count == len(values))
            and not are_ground(values[ground_count:] if ground() else values)
        ):
            return general_path(term, values, start, end, frame)
        if meter is not None and meter(1):
            return frame
        dispatcher.current = [TRUE, start, end, context, context[DEPTH] + 1, True, dispatcher.cause, None]
        # The context of the event that is not created is pushed nevertheless: the query sees its interval and depth.
        resumption = (RESTORE_CONTEXT, dispatcher, context, frame)
        next_frame = run_query(values, start, end, resumption)
        if next_frame is not resumption:
            return next_frame
        dispatcher.current = context
        return frame

    return run_query_directly
