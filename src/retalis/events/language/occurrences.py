"""How often variables stand in a rule."""

from typing import Dict, List, Optional

from ...prolog.terms import Term, Var
from .pattern import Pattern, own_terms, walk


def _each_variable(term: Term) -> List[Var]:
    """Return every occurrence of a variable in a term."""
    found: List[Var] = []
    stack = [term]
    while stack:
        item = stack.pop()
        if item.__class__ is tuple:
            stack.extend(item[1:])
        elif item.__class__ is Var:
            if item.ref is None:
                found.append(item)
            else:
                stack.append(item.ref)
    return found


def occurrences(terms: List[Term], pattern: Optional[Pattern]) -> Dict[Var, int]:
    """Count how often each variable stands in a rule."""
    counts: Dict[Var, int] = {}
    parts = [] if pattern is None else walk(pattern, True)
    for term in [*terms, *(term for part in parts for term in own_terms(part))]:
        for var in _each_variable(term):
            counts[var] = counts.get(var, 0) + 1
    return counts
