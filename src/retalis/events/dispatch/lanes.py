"""Lanes: how a message that one rule takes whole is served in the fewest steps."""

from typing import Any, NamedTuple, Optional

from ...foundation import shared_function
from ...prolog.terms import undo
from .gates import Gate
from .plans import NOBODY
from .serving import EventAction, Lane

OPEN = Gate((), None)


class Completion(NamedTuple):
    """What is done with the values of a match of one event.

    Attributes:
        action: does it.
        lane: does it for an event whose arguments are the values, see `Dispatcher.listen`.
        gate: that of the event that the action makes: where nobody wants it, the action has nothing to do.
    """

    action: EventAction
    lane: Optional[Lane] = None
    gate: Gate = OPEN


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
    dispatcher.current = None
    return True
"""


def goal_lane(call: Any, completion: Completion) -> Lane:
    """Return the lane of a goal whose inputs are the arguments of the event; see `conditions.Call`."""
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
        "undo": undo,
    }
    values = ", ".join(f"a{at}" for at in range(len(call.known)))
    found: Lane = shared_function(_LANE.format(values=values), names, "lane")
    return found
