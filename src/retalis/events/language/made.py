"""What makes events: heads of rules, and goals."""

from typing import Any, Optional

from ...prolog.terms import Term, deref, functor
from .alarms import ALARMS
from .heads import SYNCHRONIZED
from .schedules import sets_timer

NEW_EVENT = frozenset(
    (*(functor("new_event", arity) for arity in (2, 3, 5)), functor("event", 1), functor("event", 2))
)
"""The goals that make an event of their first argument, at once."""


def makes_event(term: Term) -> bool:
    """Tell whether a term is a goal that makes an event, its first argument: now or later."""
    return term.__class__ is tuple and (term[0] in NEW_EVENT or sets_timer(term))


def made_by(head: Optional[Term]) -> Optional[Term]:
    """Return the event that a rule with some head fires, now or later."""
    if head is None:
        return None
    term: Any = deref(head)
    while term.__class__ is tuple and (term[0] in ALARMS or term[0] in SYNCHRONIZED):
        term = deref(term[1])
    made: Term = term
    return made
