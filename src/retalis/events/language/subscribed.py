"""What a subscription sends: all events of a pattern, or those of them that a shape lets through, ``P with S``."""

from typing import Any, Optional

from ...foundation import RuleError, UsageError
from ...prolog.terms import Atom, CompoundTerm, Term, Var, deref
from .operators import SPELLINGS
from .pattern import Occurs, Pattern, Shaped
from .streaming import read_shape, what_follows

_SINGLE = "a subscription takes single events: a rule may make one of a pattern"
_NOTHING_AFTER = "a subscription takes P with S, and nothing after it"


def subscribed_event(term: Term) -> Term:
    """Return the pattern of the events that a subscription takes: P of ``P with S``, else all of it."""
    found: Any = deref(term)
    return deref(found[1]) if _operator(found) == "with" else found


def subscribed_shape(term: Term) -> Optional[Shaped]:
    """Return which of them are sent; None where all are.

    Raises:
        UsageError: what was expected.
    """
    found: Any = deref(term)
    try:
        if _operator(found) == "with":
            if what_follows(found) is not None:
                raise UsageError(_NOTHING_AFTER)
            return read_shape(_SingleEvent(), found)
    except RuleError as error:
        raise UsageError(error.message) from None
    left = found
    while _operator(left):  # what is to the right of a shape
        left = deref(left[1])
        if _operator(left) == "with":
            raise UsageError(_NOTHING_AFTER)
    return None


def _operator(term: Any) -> str:
    return SPELLINGS.get(term[0], "") if term.__class__ is tuple else ""


class _SingleEvent:
    """Reads a pattern that is a single event; see `FormReader`."""

    def operand(self, parent: CompoundTerm, number: int, operator: str) -> Pattern:
        event = deref(parent[number])
        if event.__class__ not in (tuple, Atom, Var) or _operator(event):
            raise self.error(_SINGLE, event)
        return Occurs(event)

    def span(self, name: str, term: CompoundTerm) -> int:
        raise self.error(_SINGLE, term)  # for patterns that may take some time

    def error(self, message: str, term: Term, number: int = 0) -> RuleError:
        return RuleError(message)
