"""Lanes: how a message that one rule takes whole is served in the fewest steps."""

from typing import Any, Callable, NamedTuple, Optional, Tuple

from ...foundation import shared_function
from ...prolog.machine import Frame, Machine
from ...prolog.terms import EventAction, Functor, Term, Values, are_ground, undo
from .dispatch import Dispatcher
from .firing import Head
from .gates import Gate
from .plans import NOBODY
from .serving import LEFT_OUT, SERVE_AGAIN, Lane

OPEN = Gate((), None)


class Completion(NamedTuple):
    """What is done with the values of a match of one event.

    Attributes:
        action: does it.
        lane: does it for an event whose arguments are the values, see `Audience.listen`.
        gate: that of the event that the action makes: where nobody wants it, the action has nothing to do.
        head: says the same as the action, where that can be done in place.
    """

    action: EventAction
    lane: Optional[Lane] = None
    gate: Gate = OPEN
    head: Optional[Head] = None


_LANE = """
def made(term, start, end):
    if not code.steady:
        return False
    dispatcher.current = event = (term, start, end, None)
    _, {values} = term
    frame = (code, {values}, done)
    mark = len(trail)
    try:  # as `Machine.check`
        if budget.closed:
            budget.admit()
        budget.goal = goal
        left = code.run(frame)
        found = (left is done and len(trail) == mark) or machine.settle(left, mark)
    except Exception as exc:
        dispatcher.current = event
        budget.goal = None
        failed(machine.error(exc, frame, mark))
        found = False
    except BaseException:
        undo(trail, mark)
        raise
    finally:
        budget.goal = None
    if found and gate.plan is not NOBODY:
        left = action(term, ({values},), start, end, done)
        if left is not done:
            machine.run(left)
    elif found:
        firings.number += 1
        firings.last = end
    dispatcher.current = None
    return True
"""


def goal_lane(call: Any, completion: Completion) -> Lane:
    """Return the lane of a goal whose inputs are the arguments of the event; see `conditions.RuleGoal`.

    Without it the NAO's events take 43 % more instructions.
    """
    machine = call.rule.network.logic.machine
    names = {
        "code": call.plain.code,
        "goal": call.plain,
        "failed": call.failed,
        "dispatcher": call.rule.network.dispatcher,
        "machine": machine,
        "budget": machine.budget,
        "trail": machine.trail,
        "done": machine.done,
        "action": completion.action,
        "gate": completion.gate,
        "NOBODY": NOBODY,
        "firings": call.rule.firings,
        "undo": undo,
    }
    values = ", ".join(f"a{at}" for at in range(len(call.known)))
    found: Lane = shared_function(_LANE.format(values=values), names, "lane")
    return found


def stand_in(
    dispatcher: Dispatcher,
    machine: Machine,
    key: Functor,
    known: int,
    work: Callable[[Values, int, int, Frame], Frame],
    otherwise: EventAction,
) -> Tuple[EventAction, Lane]:
    """Return an action and a lane that do what is to be done for an event without making it; see `shortcuts`.

    Args:
        dispatcher: whose event it is.
        machine: runs what is left to do.
        key: functor of the event.
        known: how many of the values of a match, the first ones, are ground where the event is.
        work: what the one who listens does; takes values, start, end and the next frame.
        otherwise: the action that makes the event, where it has to be made.
    """
    left_out, one_listens, done = dispatcher.left_out, dispatcher.one_listens, machine.done

    def take(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        current = dispatcher.current
        instead = left_out(key)
        if instead is None or not are_ground(values[known:] if dispatcher.ground() else values):
            return otherwise(term, values, start, end, after)
        dispatcher.current = instead
        then = (SERVE_AGAIN, dispatcher, current, after)
        frame = work(values, start, end, then)
        if frame is not then:
            return frame
        dispatcher.current = current
        return after

    def lane(term: Any, start: int, end: int) -> bool:
        if not one_listens(key):
            return False
        dispatcher.current = LEFT_OUT[1]
        frame = work(term[1:], start, end, done)
        if frame is not done:
            machine.run(frame)
        dispatcher.current = None
        return True

    return take, lane
