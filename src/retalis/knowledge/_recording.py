"""What memories and subscriptions share: from an event that matches to what is kept or sent of it."""

from typing import Any, Callable, Optional, Tuple

from ..logic import Logic, PrologError, instantiation_error, type_error
from ..terms import EMPTY_BLOCK, TRUE, Atom, Term, Var, conjunction, deref, freeze, list_items, variables

Recording = Callable[[Term, Tuple[Term, ...], Callable[[str], None]], Optional[Term]]
"""Takes an event, the values of the pattern's variables, and where to report; gives the record or None."""


def key_of(name: Term) -> Any:
    """Return the dictionary key of an id.

    Raises:
        PrologError: an instantiation error where it has variables.
    """
    try:
        return freeze(deref(name))
    except ValueError:
        raise instantiation_error() from None


def recording(logic: Logic, pattern: Term, conditions: Term, form: Term, name: str) -> Recording:
    """Compile ``conditions`` and ``form``, which share their variables with ``pattern``.

    The first solution of the conditions counts. A ``form`` that is a variable of its own stands for the event.

    Args:
        logic: where the conditions are compiled.
        pattern: the event pattern; values come in the order of its variables.
        conditions: a list of goals.
        form: what to make of the event.
        name: who asks, for reports.

    Raises:
        PrologError: where pattern, conditions or form are not what they have to be.
    """
    if pattern.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", pattern)
    goals = _goals(conditions)
    inputs = variables(pattern)
    whole = form.__class__ is Var and form not in inputs and form not in variables(conditions)
    if not whole and form.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", form)
    if whole and not goals:
        return _whole
    test = logic.compile_goal(conjunction(goals), inputs, [] if whole else [form], name=name).test

    def record(term: Term, values: Tuple[Term, ...], problem: Callable[[str], None]) -> Optional[Term]:
        try:
            solution = test(values)
        except PrologError as error:
            problem(f"{name}: event {logic.show(term)}: {error}")
            return None
        if solution is None:
            return None
        return term if whole else solution[0]

    return record


def _whole(term: Term, values: Tuple[Term, ...], problem: Callable[[str], None]) -> Term:
    return term


def _goals(conditions: Term) -> Any:
    items = list_items(conditions)
    if items is None:
        raise type_error("list", conditions)
    goals = []
    for item in items:
        goal = deref(item)
        if goal.__class__ is Var:
            raise instantiation_error()
        if goal.__class__ not in (tuple, Atom) or goal is EMPTY_BLOCK:
            raise type_error("callable", goal)
        if goal is not TRUE:
            goals.append(goal)
    return goals
