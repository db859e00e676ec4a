"""Lambda expressions: ``Free/[X,Y]>>Goal`` called with arguments."""

from typing import Dict, Optional

from ..database import add_arguments
from ..machine import Frame
from ..terms import CONS, SLASH, Term, Values, Var, copy, deref, variables
from .program import Machine
from .registry import control


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
