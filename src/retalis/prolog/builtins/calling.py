"""Calls with conditions: grammars, limits, the n-th solution."""

from time import monotonic
from typing import Hashable, Optional, Set

from ...foundation import watched_by
from ..arithmetic import evaluate
from ..compiler import CALL, NOT
from ..database import add_arguments, check_body
from ..machine import Budget, Code, Frame, Guard, LimitPassed, PrologError, domain_error, type_error
from ..terms import COLON, CONS, NIL, TRUE, String, Values, Var, atom, deref, functor, term_key, unify
from .arguments import callable_of, integer, items, number
from .dcg import translate_body
from .program import Machine
from .registry import control, deterministic


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
