"""Predicates that call goals: ``phrase/2``, limits, selection of solutions, lambda expressions and cleanup.

They run as frames of the machine and return the first frame of the goal. A construct that has to act at the end of
the goal pushes a choice point below it, which is reached on failure and, if it is a `Guard`, also by an exception. It
appends a frame after the goal, which is reached on success and compares the height of the stack of choice points: if
the construct's choice point is the newest one, the goal has no more solutions.
"""

from time import monotonic
from typing import Dict, Hashable, Optional, Set

from ...foundation.limit_checks import set_limit_check
from ..compiler.clause_nodes import ARROW, CALL, NOT, SEMICOLON
from ..database.goal_terms import add_arguments, check_body
from ..machine.arithmetic import evaluate
from ..machine.errors import PrologError, domain_error, instantiation_error, type_error
from ..machine.machine import Code, Guard
from ..machine.resource_limits import Budget, CallLimitError, record_caught_error
from ..terms.term_traversal import copy, term_key, variables
from ..terms.types import (
    COLON,
    CONS,
    NIL,
    SLASH,
    TRUE,
    Frame,
    String,
    Term,
    Values,
    Var,
    atom,
    deref,
    functor,
)
from ..terms.unification import undo, unify
from .argument_checks import callable_of, integer, items, number
from .builtin_registry import ProgramMachine, control, deterministic
from .grammar_and_ssu_rules import translate_body


@deterministic("true/0", "otherwise/0", "trim_stacks/0")
def true(machine: ProgramMachine) -> bool:
    """Succeed."""
    return True


@deterministic("fail/0", "false/0")
def fail(machine: ProgramMachine) -> bool:
    """Fail."""
    return False


@control("not/1")
def not_provable(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Test that a goal has no solution."""
    return machine.logic.control.call((NOT, (CALL, args[0])), continuation)


@control("apply/2")
def apply(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal with the items of a list as additional arguments."""
    goal = callable_of(args[0])
    modules = machine.logic.database.modules
    added_arguments = tuple(items(args[1]))
    goal = add_arguments(goal, added_arguments, modules) if added_arguments else goal
    return machine.logic.control.call(goal, continuation)


@control("^/2")
def existential(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call the goal of ``Variable^Goal``: outside of ``bagof/3`` and ``setof/3`` the quantifier has no effect."""
    return machine.logic.control.call(args[1], continuation)


# Grammars


@control("phrase/2", "phrase/3")
def phrase(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Parse a list with a grammar body."""
    remainder = args[2] if len(args) == 3 else NIL
    for term in (args[1], remainder):
        value = deref(term)
        if (
            value.__class__ is not Var
            and value is not NIL
            and (value.__class__ is not tuple or value[0] is not CONS)
        ):
            raise type_error("list", value)
    body, module = deref(args[0]), None
    # The innermost module qualification determines the names of the body.
    while body.__class__ is tuple and body[0] is COLON:
        module, body = machine.logic.database.modules.find_module(body[1]), deref(body[2])
    if body.__class__ is not String:
        callable_of(body)
    goal = translate_body(body, args[1], remainder)
    if module is not None:
        goal = machine.logic.database.modules.resolve_body(module, goal)
    # Reports a non-callable part of the body now, not when the goal reaches it.
    check_body(goal)
    return machine.logic.control.call(goal, continuation)


# Limits


@control("call_with_time_limit/2")
def call_with_time_limit(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Run a goal once, and throw ``time_limit_exceeded`` if it takes longer than a number of seconds."""
    seconds = number(args[0])
    if seconds <= 0:
        raise PrologError(_TIME_LIMIT)
    # Position of the guard's choice point, by which `_finish_in_time` finds it.
    height = len(machine.choices)
    budget = machine.budget
    # Long built-ins check the budget of the goal while it runs; the guard restores the previous check.
    previous_watch = set_limit_check(budget.check_limits)
    machine.choices.append((_TIME_GUARD, budget, len(budget.alarms), previous_watch, len(machine.trail)))
    budget.add_alarm(monotonic() + seconds, CallLimitError("time", _TIME_LIMIT))
    return machine.logic.control.once(args[1], (_FINISH_IN_TIME, machine, height, continuation))


def _remove_time_limit(entry: Frame) -> None:
    """Remove the alarms that were set since the choice point was pushed, and restore the previous check."""
    budget: Budget
    _, budget, alarm_count, previous_watch, _ = entry
    for _, error in budget.alarms[alarm_count:]:
        error.record_end()
    del budget.alarms[alarm_count:]
    set_limit_check(previous_watch)


def _finish_in_time(frame: Frame) -> Frame:
    """Remove the time limit and the choice points of a goal that has succeeded."""
    machine: ProgramMachine
    continuation: Frame
    _, machine, height, continuation = frame
    entry = machine.choices[height]
    _, error = entry[1].alarms[entry[2]]
    _remove_time_limit(entry)
    # The goal is called once.
    del machine.choices[height:]
    # The limit may have passed just before the end of the goal; then the error is raised here.
    error.raise_if_caught()
    return continuation


_TIME_LIMIT = atom("time_limit_exceeded")
_TIME_GUARD = Guard("call_with_time_limit", _remove_time_limit)
_FINISH_IN_TIME = Code("call_with_time_limit", _finish_in_time)


@control("call_with_inference_limit/3")
def call_with_inference_limit(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Run a goal with a limit of inferences, counted in thousands; the result is that of SWI-Prolog."""
    goal, count, result = args
    ball = (_INFERENCE_LIMIT, machine.budget.ceiling_after(integer(count)))
    limited_goal = (_WITHIN, goal, ball, result)
    return machine.logic.control.catch(limited_goal, ball, (_EQUAL, result, _EXCEEDED), continuation)


@control("$within/3")
def within(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Run a goal with the ceiling of inferences that `call_with_inference_limit` has computed."""
    goal, ball, result = args
    ball = deref(ball)
    if ball.__class__ is not tuple or ball[0] is not _INFERENCE_LIMIT:
        raise type_error("inference_limit", ball)
    ceiling = integer(ball[1])
    height = len(machine.choices)
    budget = machine.budget
    budget.add_ceiling(ceiling, CallLimitError("inference", ball))
    machine.choices.append((_INFERENCE_GUARD, budget, ceiling, len(machine.trail)))
    return machine.logic.control.call(goal, (_FINISH_WITHIN, machine, height, result, continuation))


def _remove_ceiling(entry: Frame) -> None:
    """Remove the ceiling of inferences of a choice point."""
    budget: Budget
    _, budget, ceiling, _ = entry
    error = budget.ceilings.pop(ceiling, None)
    # If the goal has left choice points, the ceiling was removed when it exited.
    if error is not None:
        error.record_end()


def _finish_within(frame: Frame) -> Optional[Frame]:
    """Remove the ceiling of a goal that has succeeded; its result is ``!`` after the last solution, else ``true``."""
    machine: ProgramMachine
    continuation: Frame
    _, machine, height, result, continuation = frame
    entry = machine.choices[height]
    error = entry[1].ceilings.get(entry[2])
    _remove_ceiling(entry)
    is_determinate = len(machine.choices) == height + 1
    if is_determinate:
        machine.choices.pop()
    if error is not None:
        error.raise_if_caught()
    return continuation if unify(result, _DETERMINATE if is_determinate else TRUE, machine.trail) else None


_EQUAL = functor("=", 2)
_WITHIN = functor("$within", 3)
_INFERENCE_LIMIT = functor("$inference_limit", 1)
_EXCEEDED, _DETERMINATE = atom("inference_limit_exceeded"), atom("!")
_INFERENCE_GUARD = Guard("call_with_inference_limit", _remove_ceiling)
_FINISH_WITHIN = Code("call_with_inference_limit", _finish_within)


# Solutions by number


@control("limit/2")
def limit(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Return only the first solutions of a goal."""
    count = evaluate(args[0])
    if count <= 0:
        return None
    height = len(machine.choices)
    # The count is in a list because frames are immutable, and because backtracking must not undo it.
    return machine.logic.control.call(args[1], (_COUNT_SOLUTION, machine, height, [count], continuation))


def _count_solution(frame: Frame) -> Frame:
    """Count a solution; the last one that is wanted cuts the goal."""
    machine: ProgramMachine
    continuation: Frame
    _, machine, height, remaining, continuation = frame
    remaining[0] -= 1
    if remaining[0] <= 0:
        del machine.choices[height:]
    return continuation


_COUNT_SOLUTION = Code("limit", _count_solution)


@control("offset/2")
def offset(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Skip the first solutions of a goal."""
    count = evaluate(args[0])
    if count < 0:
        raise domain_error("not_less_than_zero", count)
    return machine.logic.control.call(args[1], (_SKIP_SOLUTION, [count], continuation))


def _skip_solution(frame: Frame) -> Optional[Frame]:
    continuation: Frame
    _, remaining, continuation = frame
    if remaining[0] > 0:
        remaining[0] -= 1
        return None
    return continuation


_SKIP_SOLUTION = Code("offset", _skip_solution)


@control("distinct/1", "distinct/2")
def distinct(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Return only solutions whose witness, by default the goal, is not a variant of an earlier one."""
    # The set belongs to this call: backtracking into the goal keeps it, a new call starts with an empty one.
    seen_keys: Set[Hashable] = set()
    return machine.logic.control.call(args[-1], (_FILTER_DISTINCT, args[0], seen_keys, continuation))


def _filter_distinct(frame: Frame) -> Optional[Frame]:
    continuation: Frame
    _, witness, seen_keys, continuation = frame
    key = term_key(witness)
    if key in seen_keys:
        return None
    seen_keys.add(key)
    return continuation


_FILTER_DISTINCT = Code("distinct", _filter_distinct)


@control("call_nth/2")
def call_nth(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Enumerate the solutions of a goal with their numbers, or return the one with a given number."""
    number = deref(args[1])
    if number.__class__ is not Var and integer(number) < 1:
        raise domain_error("not_less_than_one", number)
    height = len(machine.choices)
    return machine.logic.control.call(args[0], (_NUMBER_SOLUTION, machine, height, [0], number, continuation))


def _number_solution(frame: Frame) -> Optional[Frame]:
    machine: ProgramMachine
    continuation: Frame
    _, machine, height, count, number, continuation = frame
    count[0] += 1
    if number.__class__ is Var:
        return continuation if unify(number, count[0], machine.trail) else None
    if count[0] < number:
        return None
    del machine.choices[height:]
    return continuation


_NUMBER_SOLUTION = Code("call_nth", _number_solution)


@control(*[f">>/{arity}" for arity in range(2, 10)], is_protected=False)
def call_lambda(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a lambda expression ``Free/[X1, ...]>>Body`` with arguments.

    Its variables are renamed for each call, except those in ``Free``, as in SWI-Prolog's ``library(yall)``.
    """
    parameters, body, call_arguments = deref(args[0]), args[1], args[2:]
    var_values: Dict[Var, Term] = {}  # values of the expression's variables in this call
    if parameters.__class__ is tuple and parameters[0] is SLASH:
        var_values = {var: var for var in variables(parameters[1])}
        parameters = deref(parameters[2])
    parameter_count = 0
    while parameter_count < len(call_arguments) and parameters.__class__ is tuple and parameters[0] is CONS:
        parameter = deref(parameters[1])
        # A parameter that is a variable is replaced by the argument, which is cheaper than a unification.
        if parameter.__class__ is Var and parameter not in var_values:
            var_values[parameter] = call_arguments[parameter_count]
        elif not machine.unify(copy(parameter, var_values), call_arguments[parameter_count]):
            return None
        parameter_count += 1
        parameters = deref(parameters[2])
    body = deref(copy(body, var_values))
    # Without parameters left, the remaining arguments are appended to the body of `Free/Body`.
    extra_arguments = call_arguments[parameter_count:]
    if body.__class__ is tuple and body[0] is SLASH and extra_arguments:
        body = deref(body[2])
    goal = add_arguments(body, extra_arguments, machine.logic.database.modules) if extra_arguments else body
    return machine.logic.control.call(goal, continuation)


class _Cleanup:
    """The cleanup of a goal, referenced only by the goal's guard on the stack of choice points.

    A cut of the guard frees it and thereby this object, whose finalizer runs the cleanup. So cuts need no check for
    guards.
    """

    __slots__ = ("machine", "goal", "is_done")

    def __init__(self, machine: ProgramMachine, goal: Term):
        self.machine = machine
        self.goal = goal
        self.is_done = False

    def run(self) -> None:
        """Run the cleanup; its failure and its bindings are ignored, and its error is printed as a warning."""
        if self.is_done:
            return
        self.is_done = True
        machine = self.machine
        mark = len(machine.trail)
        try:
            machine.logic.once(self.goal)
        except PrologError as error:
            if record_caught_error(error):
                try:
                    machine.logic.error_output(f"Warning: cleanup: {error.message}\n")
                except PrologError as output_error:
                    # The limit of output has been exceeded; the error is stored until the machine can raise it.
                    record_caught_error(output_error)
        undo(machine.trail, mark)

    def __del__(self) -> None:
        self.run()


@control("setup_call_cleanup/3")
def setup_call_cleanup(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Run a goal, and a cleanup after it has failed, raised an error, exited without choice points, or been cut."""
    setup, goal, cleanup = args
    return machine.logic.control.once(setup, (_CALL_GUARDED, machine, goal, cleanup, continuation))


@control("call_cleanup/2")
def call_cleanup(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Run a goal, and a cleanup after it has failed, raised an error, exited without choice points, or been cut."""
    return setup_call_cleanup(machine, (atom("true"), *args), continuation)


def _call_guarded(frame: Frame) -> Optional[Frame]:
    """Call the goal of ``setup_call_cleanup/3`` above the guard with its cleanup."""
    machine: ProgramMachine
    continuation: Frame
    _, machine, goal, cleanup, continuation = frame
    # Checked after the setup goal, which may have bound it.
    if deref(cleanup).__class__ is Var:
        raise instantiation_error()
    height = len(machine.choices)
    machine.choices.append((_CLEANUP_GUARD, _Cleanup(machine, cleanup), len(machine.trail)))
    return machine.logic.control.call(goal, (_EXIT_GOAL, machine, height, continuation))


def _exit_goal(frame: Frame) -> Optional[Frame]:
    """Call the cleanup of a goal that has succeeded without leaving choice points."""
    machine: ProgramMachine
    continuation: Frame
    _, machine, height, continuation = frame
    # The goal may have more solutions, so its cleanup has to wait.
    if len(machine.choices) > height + 1:
        return continuation
    cleanup: _Cleanup = machine.choices.pop()[1]
    # From here on the cleanup is an ordinary goal, whose errors the program may catch.
    cleanup.is_done = True
    goal = (SEMICOLON, (ARROW, (CALL, cleanup.goal), TRUE), TRUE)
    return machine.logic.control.once(goal, continuation)


_CALL_GUARDED = Code("setup_call_cleanup", _call_guarded)
_EXIT_GOAL = Code("setup_call_cleanup", _exit_goal)
_CLEANUP_GUARD = Guard("setup_call_cleanup", lambda entry: entry[1].run())
