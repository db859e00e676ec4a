"""What memories and subscriptions share: from an event that matches to what is kept or sent of it."""

from typing import Callable, Hashable, List, Optional, Sequence, Set, Tuple

from ...prolog.logic import Logic
from ...prolog.machine import PrologError, instantiation_error, keep_back, type_error
from ...prolog.terms import (
    COMMA,
    EMPTY_BLOCK,
    TRUE,
    Atom,
    Term,
    Values,
    Var,
    compare,
    conjunction,
    deref,
    freeze,
    list_items,
    variables,
)
from ..dispatch import Dispatcher, compile_builder

Warn = Callable[..., None]
"""Takes a warning as text and what kind it is: those of one kind are shown at growing intervals."""

Recording = Callable[[Term, Values, bool], Optional[Term]]
"""Takes an event, the values of the pattern's variables, and whether it has none; gives the record or None."""


def key_of(name: Term) -> Hashable:
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


def unused_variables(pattern: Term, conditions: Term, form: Term, others: Sequence[Term] = ()) -> Set[Var]:
    """Return the variables of a pattern whose values go nowhere: none where the event itself is kept or sent."""
    if form.__class__ is Var:
        return set()
    return set(variables(pattern)).difference(variables((COMMA, conditions, form, *others)))


def recording(
    logic: Logic,
    dispatcher: Dispatcher,
    pattern: Term,
    conditions: Term,
    form: Term,
    name: str,
    problem: Warn,
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
        problem: takes a report about a condition that raised an error.

    Returns:
        The function, and whether it makes a ground record of every ground event.

    Raises:
        PrologError: where pattern, conditions or form are not what they have to be.
    """
    if pattern.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", pattern)
    body = conjunction(_goals(conditions))
    inputs = variables(pattern)
    whole = is_whole(pattern, conditions, form)
    if not whole and form.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", form)
    given = set(inputs)
    made = set(variables(body)) - given
    found = [] if whole else [var for var in variables(form) if var in made]
    keep: Recording = itself
    if not whole:
        keep = _same_or_built(compile_builder(form, inputs, "form"), compare(form, pattern) == 0)
    closed = whole or given.issuperset(variables(form))
    if body is TRUE:
        return keep, closed
    test = logic.compile_goal(body, inputs, found, name=name).test
    test_open = logic.compile_goal(body, inputs, [TRUE if whole else form], name=name).test
    build = compile_builder(form, [*inputs, *found], "form")

    def record(term: Term, values: Values, ground: bool) -> Optional[Term]:
        event = dispatcher.current
        try:
            solution = test(values) if ground else test_open(values)
        except PrologError as error:
            dispatcher.restore(event, dispatcher.cause)
            if keep_back(error):
                problem(f"{name}: event {logic.brief(term)}: {error}", name)
            return None
        if solution is None:
            return None
        if whole or ground and not found:
            return keep(term, values, ground)
        return build(values + solution) if ground else solution[0]

    return record, closed


def itself(term: Term, values: Values, ground: bool) -> Term:
    """Return the event, as the recording of a form that stands for it."""
    return term


def _same_or_built(build: Callable[[Values], Term], same: bool) -> Recording:
    """Return the recording of a form: one that is the same as the pattern is the event itself, if that is ground."""
    if not same:
        return lambda term, values, ground: build(values)
    return lambda term, values, ground: term if ground else build(values)


def _goals(conditions: Term) -> List[Term]:
    items = list_items(conditions)
    if items is None:
        raise type_error("list", conditions)
    goals: List[Term] = []
    for item in items:
        goal = deref(item)
        if goal.__class__ is Var:
            raise instantiation_error()
        if goal.__class__ not in (tuple, Atom) or goal is EMPTY_BLOCK:
            raise type_error("callable", goal)
        if goal is not TRUE:
            goals.append(goal)
    return goals
