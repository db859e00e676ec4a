"""Lambda expressions: ``Free/[X,Y]>>Goal`` called with arguments."""

from typing import Optional

from ..database import add_arguments
from ..machine import Frame
from ..terms import CONS, SLASH, Term, Values, copy, deref, functor, make_list, variables
from .program import Machine
from .registry import control

_ARROW = functor(">>", 2)


@control(*[f">>/{arity}" for arity in range(2, 10)], locked=False)
def call_lambda(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a lambda expression: its variables are renamed for each call, except the free ones and those bound."""
    parameters, body, actual = args[0], args[1], args[2:]
    shared = _free(parameters)
    renamed = copy((_ARROW, parameters, body), {var: var for var in variables(make_list([shared]))})
    parameters, body = deref(renamed[1]), renamed[2]
    if parameters.__class__ is tuple and parameters[0] is SLASH:
        parameters = deref(parameters[2])
    given = list(actual)
    while given and parameters.__class__ is tuple and parameters[0] is CONS:
        if not machine.unify(parameters[1], given.pop(0)):
            return None
        parameters = deref(parameters[2])
    body = deref(body)
    if body.__class__ is tuple and body[0] is SLASH and given:
        body = deref(body[2])
    goal = add_arguments(body, tuple(given), machine.logic.database.modules) if given else body
    return machine.logic.control.call(goal, after)


def _free(parameters: Term) -> Term:
    """Return the term whose variables a lambda expression shares with what is around it."""
    parameters = deref(parameters)
    if parameters.__class__ is tuple and parameters[0] is SLASH:
        free: Term = parameters[1]
        return free
    return make_list([])
