"""``:- include(File)``: the terms of another file, as if they stood in its place."""

from typing import Optional

from ...prolog.terms import Term, deref, functor
from .clauses import DIRECTIVES

_INCLUDE = functor("include", 1)


def included(term: Term) -> Optional[Term]:
    """Return the name of the file in ``:- include(File)``, None for another term."""
    term = deref(term)
    if term.__class__ is not tuple or term[0] not in DIRECTIVES:
        return None
    goal = deref(term[1])
    return deref(goal[1]) if goal.__class__ is tuple and goal[0] is _INCLUDE else None
