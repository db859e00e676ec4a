"""What memories and subscriptions share: from an event that matches to what is kept or sent of it."""

from typing import Any, Callable, List, Optional, Tuple

from ..events import Dispatcher, compile_builder
from ..logic import Logic, PrologError, instantiation_error, keep_back, type_error
from ..terms import (
    COMMA,
    EMPTY_BLOCK,
    TRUE,
    Atom,
    Term,
    Var,
    compare,
    conjunction,
    deref,
    freeze,
    list_items,
    variables,
)

Warn = Callable[..., None]
"""Takes a warning as text and what kind it is: those of one kind are shown ever more seldom."""

Recording = Callable[[Term, Tuple[Term, ...], Warn], Optional[Term]]
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


def is_whole(pattern: Term, conditions: Term, form: Term) -> bool:
    """Tell whether a form is a variable of its own, which stands for the event."""
    return form.__class__ is Var and form not in variables((COMMA, pattern, conditions))


def recording(
    logic: Logic, dispatcher: Dispatcher, pattern: Term, conditions: Term, form: Term, name: str
) -> Tuple[Recording, bool]:
    """Compile ``conditions`` and ``form``, which share their variables with ``pattern``.

    The first solution of the conditions counts. A ``form`` that is a variable of its own stands for the event.

    Args:
        logic: where the conditions are compiled.
        dispatcher: whose events come.
        pattern: the event pattern; values come in the order of its variables.
        conditions: a list of goals.
        form: what to make of the event.
        name: who asks, for reports.

    Returns:
        The function, and whether it makes a ground record of every ground event.

    Raises:
        PrologError: where pattern, conditions or form are not what they have to be.
    """
    if pattern.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", pattern)
    goals = _goals(conditions)
    inputs = variables(pattern)
    whole = is_whole(pattern, conditions, form)
    if not whole and form.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", form)
    if whole:
        return (_tested(logic, dispatcher, goals, inputs, name) if goals else itself), True
    if goals:
        return _solved(logic, dispatcher, goals, inputs, form, name), False
    build = compile_builder(form, inputs, name)
    if compare(form, pattern) == 0:
        return _same(dispatcher, build), True
    return lambda term, values, problem: build(values), set(variables(form)) <= set(inputs)


def itself(term: Term, values: Tuple[Term, ...], problem: Warn) -> Term:
    """Return the event, as the recording of a form that stands for it."""
    return term


def _same(dispatcher: Dispatcher, build: Callable[[Tuple[Term, ...]], Term]) -> Recording:
    """Return the recording for a form that is the pattern: the event itself, where it has no variables."""
    ground = dispatcher.ground

    def record(term: Term, values: Tuple[Term, ...], problem: Warn) -> Term:
        return term if ground() else build(values)

    return record


def _tested(
    logic: Logic, dispatcher: Dispatcher, goals: List[Term], inputs: List[Var], name: str
) -> Recording:
    """Return the recording of the event itself, under conditions."""
    solved = _solved(logic, dispatcher, goals, inputs, TRUE, name)

    def record(term: Term, values: Tuple[Term, ...], problem: Warn) -> Optional[Term]:
        return None if solved(term, values, problem) is None else term

    return record


def _solved(
    logic: Logic, dispatcher: Dispatcher, goals: List[Term], inputs: List[Var], form: Term, name: str
) -> Recording:
    """Return the recording of a form under conditions, which may bind what is in it."""
    test = logic.compile_goal(conjunction(goals), inputs, [form], name=name).test

    def record(term: Term, values: Tuple[Term, ...], problem: Warn) -> Optional[Term]:
        event = dispatcher.current
        try:
            solution = test(values)
        except PrologError as error:
            dispatcher.current = (
                event  # the conditions may have been in the middle of an event that they made
            )
            keep_back(error)
            problem(f"{name}: event {logic.show(term)}: {error}", name)
            return None
        return None if solution is None else solution[0]

    return record


def _goals(conditions: Term) -> List[Term]:
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
