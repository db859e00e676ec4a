"""Dictionary keys of terms: for shared variables, and for telling identical events."""

from typing import Any, Dict, Hashable, List

from ...foundation import BULK, TermTooLarge, look
from .cycles import LATE_ROUND, refuse_cycles
from .kinds import Atom, String, Term, Var, deref
from .steps import ROUNDS
from .walking import freeze

PLAIN = frozenset((Atom, int, String))
"""The classes of terms that are their own keys."""


def term_key(term: Term) -> Hashable:
    """Return a hashable key: equal for two terms exactly when they are variants of each other."""
    if term.__class__ in PLAIN:
        return term
    if term.__class__ is tuple:
        for item in term[1:]:
            if item.__class__ not in PLAIN:
                if item.__class__ is Var and item.ref is None:
                    return variant_key(term)
                break
        else:
            return term
    try:
        return freeze(term)
    except ValueError:
        return variant_key(term)


def variant_key(term: Term) -> Hashable:
    """Return the key of a term with variables: they count by the order in which they are met."""
    flat: List[Hashable] = [Var]
    numbers: Dict[Var, int] = {}
    stack = [term]
    for done in ROUNDS:
        for _ in BULK:
            if not stack:
                return tuple(flat)
            item: Any = deref(stack.pop())
            kind = item.__class__
            if kind is tuple:
                flat.append(item[0])
                stack.extend(item[:0:-1])
            elif kind is float:
                flat.append((float, item.hex()))
            elif kind is Var:
                flat.append((Var, numbers.setdefault(item, len(numbers))))
            else:
                flat.append(item)
        look()
        if done == LATE_ROUND:
            refuse_cycles(term)
    raise TermTooLarge
