"""What the aggregates of a rule collect, checked when the rule is read."""

from typing import Any, Callable, Mapping

from ...foundation import RuleError
from ...prolog.arithmetic import EVALUABLE
from ...prolog.terms import CONS, Atom, String, Term, Var, deref, variables
from ..streams import MEASURES
from .aggregates import AGGREGATES
from .occurrences import occurrences
from .pattern import Aggregate, Windowed, bound_by
from .reading import Spot


def check_aggregate(
    part: Aggregate,
    term: Any,
    pattern: Any,
    names: Mapping[Var, str],
    spot: Spot,
    warn: Callable[[RuleError], None],
) -> None:
    """Check that an aggregate has something to collect.

    Args:
        part: the aggregate.
        term: as it is written.
        pattern: of the rule.
        names: of the variables.
        spot: gives the places of parts of the term.
        warn: takes what is not an error but probably a mistake.

    Raises:
        RuleError: where what it is given is never a number and has to be one.
    """
    first, collected = set(bound_by(part.first)), set(bound_by(part.collected))
    mentioned = [] if part.value is None else variables(part.value)
    free = [var for var in mentioned if var not in first and var not in collected]
    numeric = AGGREGATES[part.kind].numeric
    if not numeric:
        counts = occurrences([], pattern)
        free = [var for var in free if counts[var] == 1]
    if free:
        name = names.get(free[0], "a variable")
        message = (
            f"{name} never gets a value: neither what {part.kind} collects nor what comes before it binds it"
        )
        error = RuleError(message, spot(deref(term[1])))
        if numeric:
            raise error
        warn(error)
    if part.value is not None and numeric and not _may_be_number(part.value):
        raise RuleError(f"{part.kind} needs numbers or arithmetic expressions", spot(deref(term[1])))
    if part.result.__class__ is Var and part.result in (collected | set(mentioned)) - first:
        name = names.get(part.result, "a variable")
        message = (
            f"{name} is both a collected value and the result of {part.kind}, "
            "which fires only where they are equal"
        )
        warn(RuleError(message, spot(term, 3)))


def check_window(
    part: Windowed,
    term: Any,
    rule: Term,
    names: Mapping[Var, str],
    spot: Spot,
    warn: Callable[[RuleError], None],
) -> None:
    """Check what a window measures, and warn if there is a window for each of its values.

    Args:
        part: the aggregate over a window.
        term: as it is written.
        rule: the rule as it is written.
        names: of the variables.
        spot: gives the places of parts of the term.
        warn: takes the warnings.

    Raises:
        RuleError: if a measure that needs numbers gets what is never a number.
    """
    for kind, value in zip(part.kinds, part.values):
        if value is not None and MEASURES[kind].numeric and not _may_be_number(value):
            raise RuleError(
                f"{kind} needs numbers or arithmetic expressions", spot(deref(term[1])) or spot(term)
            )
    measured = [value for value in part.values if value is not None]
    inside = occurrences([*measured, *part.window.goals], part.collected)
    everywhere = occurrences([rule], None)
    for var in dict.fromkeys(one for value in measured for one in variables(value)):
        if everywhere.get(var, 0) > inside[var]:
            name = names.get(var, "a variable")
            message = (
                f"{name} is measured and stands elsewhere too, so that there is a window for each value of it"
            )
            warn(RuleError(message, spot(deref(term[1])) or spot(term)))


def _may_be_number(value: Term) -> bool:
    """Tell whether there may be numbers for its variables with which a term is an expression."""
    stack = [value]
    while stack:
        term = deref(stack.pop())
        if term.__class__ is Atom:
            if term.functor not in EVALUABLE:
                return False
        elif term.__class__ is tuple:
            if term[0] is CONS:
                continue
            if term[0] not in EVALUABLE:
                return False
            stack.extend(term[1:])
        elif term.__class__ is String:
            return False
    return True
