"""Calls with conditions: grammars, limits, the n-th solution.

Lambda expressions: ``Free/[X,Y]>>Goal`` called with arguments.

Cleanup: what runs when a goal is over, however it ends.
"""

from time import monotonic
from typing import Dict, Hashable, Optional, Set

from ...foundation.cancellation import watched_by
from ...foundation.python_interpreter import PYPY
from ..compiler.clause_nodes import ARROW, CALL, NOT, SEMICOLON
from ..database.control_constructs import add_arguments, check_body
from ..machine.arithmetic import evaluate
from ..machine.errors import PrologError, domain_error, instantiation_error, type_error
from ..machine.machine import Code, Guard
from ..machine.resource_limits import Budget, LimitPassed, keep_back
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
from .builtin_registry import Machine, control, deterministic
from .clause_translation import translate_body


@deterministic("true/0", "otherwise/0", "trim_stacks/0")
def true(machine: Machine) -> bool:
    """Succeed."""
    return True


@deterministic("fail/0", "false/0")
def fail(machine: Machine) -> bool:
    """Fail."""
    return False


@control("not/1")
def not_provable(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Succeed if a goal has no solution."""
    return machine.logic.control.call((NOT, (CALL, args[0])), after)


@control("apply/2")
def apply(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a goal with the items of a list as further arguments."""
    goal = callable_of(args[0])
    modules = machine.logic.database.modules
    extra = tuple(items(args[1]))
    goal = add_arguments(goal, extra, modules) if extra else goal
    return machine.logic.control.call(goal, after)


@control("^/2")
def existential(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call the goal of ``Variable^Goal``: outside of bagof and setof the variable is one like all others."""
    return machine.logic.control.call(args[1], after)


# Grammars


@control("phrase/2", "phrase/3")
def phrase(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Parse a list by a grammar body."""
    rest = args[2] if len(args) == 3 else NIL
    for term in (args[1], rest):
        kind = deref(term)
        if (
            kind.__class__ is not Var
            and kind is not NIL
            and (kind.__class__ is not tuple or kind[0] is not CONS)
        ):
            raise type_error("list", kind)
    body, module = deref(args[0]), None
    while body.__class__ is tuple and body[0] is COLON:
        module, body = machine.logic.database.modules.named(body[1]), deref(body[2])
    if body.__class__ is not String:
        callable_of(body)
    goal = translate_body(body, args[1], rest)
    if module is not None:
        goal = machine.logic.database.modules.body(module, goal)
    check_body(goal)
    return machine.logic.control.call(goal, after)


# Limits


@control("call_with_time_limit/2")
def call_with_time_limit(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Run a goal once, for some seconds at most; then ``time_limit_exceeded`` is thrown."""
    seconds = number(args[0])
    if seconds <= 0:
        raise PrologError(_TIME_LIMIT)
    height = len(machine.choices)
    budget = machine.budget
    before = watched_by(budget.look)
    machine.choices.append((_LIMITED, budget, len(budget.alarms), before, len(machine.trail)))
    budget.warn_at(monotonic() + seconds, LimitPassed("time", _TIME_LIMIT))
    return machine.logic.control.once(args[1], (_IN_TIME, machine, height, after))


def _take_off(entry: Frame) -> None:
    budget: Budget
    _, budget, count, before, _ = entry
    for _, error in budget.alarms[count:]:
        error.close()
    del budget.alarms[count:]
    watched_by(before)


def _in_time(frame: Frame) -> Frame:
    machine: Machine
    after: Frame
    _, machine, height, after = frame
    entry = machine.choices[height]
    _, error = entry[1].alarms[entry[2]]
    _take_off(entry)
    del machine.choices[height:]
    error.deliver()
    return after


_TIME_LIMIT = atom("time_limit_exceeded")
_LIMITED = Guard("call_with_time_limit", _take_off)
_IN_TIME = Code("call_with_time_limit", _in_time)


@control("call_with_inference_limit/3")
def call_with_inference_limit(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Run a goal for some inferences at most (counted by the thousand); say how it went."""
    goal, most, result = args
    ball = (_INFERENCE_LIMIT, machine.budget.cap(integer(most)))
    inner = (_WITHIN, goal, ball, result)
    return machine.logic.control.catch(inner, ball, (_EQUAL, result, _EXCEEDED), after)


@control("$within/3")
def within(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Run a goal that `call_with_inference_limit` has set a ceiling for."""
    goal, ball, result = args
    ball = deref(ball)
    if ball.__class__ is not tuple or ball[0] is not _INFERENCE_LIMIT:
        raise type_error("inference_limit", ball)
    ceiling = integer(ball[1])
    height = len(machine.choices)
    budget = machine.budget
    budget.warn_past(ceiling, LimitPassed("inference", ball))
    machine.choices.append((_CAPPED, budget, ceiling, len(machine.trail)))
    return machine.logic.control.call(goal, (_STAYED, machine, height, result, after))


def _lift(entry: Frame) -> None:
    budget: Budget
    _, budget, ceiling, _ = entry
    error = budget.ceilings.pop(ceiling, None)
    if error is not None:  # on backtracking it is gone already
        error.close()


def _stayed(frame: Frame) -> Optional[Frame]:
    machine: Machine
    after: Frame
    _, machine, height, result, after = frame
    entry = machine.choices[height]
    error = entry[1].ceilings.get(entry[2])
    _lift(entry)
    alone = len(machine.choices) == height + 1
    if alone:
        machine.choices.pop()
    if error is not None:
        error.deliver()
    return after if unify(result, _ALONE if alone else TRUE, machine.trail) else None


_EQUAL = functor("=", 2)
_WITHIN = functor("$within", 3)
_INFERENCE_LIMIT = functor("$inference_limit", 1)
_EXCEEDED, _ALONE = atom("inference_limit_exceeded"), atom("!")
_CAPPED = Guard("call_with_inference_limit", _lift)
_STAYED = Code("call_with_inference_limit", _stayed)


# Solutions by number


@control("limit/2")
def limit(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Give the first solutions of a goal only."""
    count = evaluate(args[0])
    if count <= 0:
        return None
    height = len(machine.choices)
    return machine.logic.control.call(args[1], (_COUNTED, machine, height, [count], after))


def _counted(frame: Frame) -> Frame:
    machine: Machine
    after: Frame
    _, machine, height, left, after = frame
    left[0] -= 1
    if left[0] <= 0:
        del machine.choices[height:]
    return after


_COUNTED = Code("limit", _counted)


@control("offset/2")
def offset(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Leave out the first solutions of a goal."""
    count = evaluate(args[0])
    if count < 0:
        raise domain_error("not_less_than_zero", count)
    return machine.logic.control.call(args[1], (_SKIPPED, [count], after))


def _skipped(frame: Frame) -> Optional[Frame]:
    after: Frame
    _, left, after = frame
    if left[0] > 0:
        left[0] -= 1
        return None
    return after


_SKIPPED = Code("offset", _skipped)


@control("distinct/1", "distinct/2")
def distinct(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Give the solutions for which a term, or else the goal, has not been a variant of what it was before."""
    seen: Set[Hashable] = set()
    return machine.logic.control.call(args[-1], (_DISTINCT, args[0], seen, after))


def _distinct(frame: Frame) -> Optional[Frame]:
    after: Frame
    _, witness, seen, after = frame
    key = term_key(witness)
    if key in seen:
        return None
    seen.add(key)
    return after


_DISTINCT = Code("distinct", _distinct)


@control("call_nth/2")
def call_nth(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Give the solutions of a goal with their numbers, or the one of a number."""
    number = deref(args[1])
    if number.__class__ is not Var and integer(number) < 1:
        raise domain_error("not_less_than_one", number)
    height = len(machine.choices)
    return machine.logic.control.call(args[0], (_NTH, machine, height, [0], number, after))


def _nth(frame: Frame) -> Optional[Frame]:
    machine: Machine
    after: Frame
    _, machine, height, count, number, after = frame
    count[0] += 1
    if number.__class__ is Var:
        return after if unify(number, count[0], machine.trail) else None
    if count[0] < number:
        return None
    del machine.choices[height:]
    return after


_NTH = Code("call_nth", _nth)


@control(*[f">>/{arity}" for arity in range(2, 10)], locked=False)
def call_lambda(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a lambda expression: its variables are renamed for each call, except the free ones and those bound."""
    parameters, body, actual = deref(args[0]), args[1], args[2:]
    fresh: Dict[Var, Term] = {}  # what the variables stand for in this call
    if parameters.__class__ is tuple and parameters[0] is SLASH:
        fresh = {var: var for var in variables(parameters[1])}
        parameters = deref(parameters[2])
    taken = 0
    while taken < len(actual) and parameters.__class__ is tuple and parameters[0] is CONS:
        parameter = deref(parameters[1])
        if parameter.__class__ is Var and parameter not in fresh:
            fresh[parameter] = actual[taken]
        elif not machine.unify(copy(parameter, fresh), actual[taken]):
            return None
        taken += 1
        parameters = deref(parameters[2])
    body = deref(copy(body, fresh))
    given = actual[taken:]
    if body.__class__ is tuple and body[0] is SLASH and given:
        body = deref(body[2])
    goal = add_arguments(body, given, machine.logic.database.modules) if given else body
    return machine.logic.control.call(goal, after)


class _Cleanup:
    """The cleanup of a goal; held by the goal's guard among the choice points and by nothing else.

    So it is told of a cut, too, without costing other cuts anything: a guard that is cut off is freed, and this
    with it. Where Python does not free it at once, the guard is told, see `Code.dropped`.
    """

    __slots__ = ("machine", "goal", "done")

    def __init__(self, machine: Machine, goal: Term):
        self.machine = machine
        self.goal = goal
        self.done = False

    def run(self) -> None:
        """Run the cleanup at once; its failure and its bindings do not count, its error is reported."""
        if self.done:
            return
        self.done = True
        machine = self.machine
        mark = len(machine.trail)
        try:
            machine.logic.once(self.goal)
        except PrologError as error:
            if keep_back(error):
                try:
                    machine.logic.error_output(f"Warning: cleanup: {error.message}\n")
                except PrologError as passed:  # the limit of output: nobody could catch it here
                    keep_back(passed)
        undo(machine.trail, mark)

    if not PYPY:  # there it would come at any time

        def __del__(self) -> None:
            self.run()


@control("setup_call_cleanup/3")
def setup_call_cleanup(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Run a goal, and a cleanup once it has failed, thrown, exited without choice points, or been cut."""
    setup, goal, cleanup = args
    return machine.logic.control.once(setup, (_GUARDED, machine, goal, cleanup, after))


@control("call_cleanup/2")
def call_cleanup(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Run a goal, and a cleanup once it has failed, thrown, exited without choice points, or been cut."""
    return setup_call_cleanup(machine, (atom("true"), *args), after)


def _guarded(frame: Frame) -> Optional[Frame]:
    machine: Machine
    after: Frame
    _, machine, goal, cleanup, after = frame
    if deref(cleanup).__class__ is Var:  # not before: the setup may give it
        raise instantiation_error()
    height = len(machine.choices)
    machine.choices.append((_CLEANUP, _Cleanup(machine, cleanup), len(machine.trail)))
    return machine.logic.control.call(goal, (_LEFT, machine, height, after))


def _left(frame: Frame) -> Optional[Frame]:
    machine: Machine
    after: Frame
    _, machine, height, after = frame
    if len(machine.choices) > height + 1:
        return after
    cleanup: _Cleanup = machine.choices.pop()[1]
    cleanup.done = True
    goal = (SEMICOLON, (ARROW, (CALL, cleanup.goal), TRUE), TRUE)
    return machine.logic.control.once(goal, after)


_GUARDED = Code("setup_call_cleanup", _guarded)
_LEFT = Code("setup_call_cleanup", _left)
_CLEANUP = Guard("setup_call_cleanup", lambda entry: entry[1].run())
_CLEANUP.dropped = _CLEANUP.unwind
