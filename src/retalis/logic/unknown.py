"""Calls of procedures that nobody defined: an error that names the caller and what may have been meant."""

from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Dict, List

from ..terms import FALSE, Atom, Functor, Term, atom, deref
from .database import Predicate
from .faults import CONTEXT, existence_error, indicator

if TYPE_CHECKING:
    from .logic import Logic


def undefined(logic: "Logic", predicate: Predicate) -> Any:
    """Raise the existence error of a procedure (or fail, as the flag ``unknown`` says)."""
    flag = deref(logic.flags["unknown"])
    if flag is atom("fail") or flag is FALSE:
        return None
    key = predicate.functor
    notes = []
    callers = _callers(logic, key)
    if callers:
        notes.append(f"called from {', '.join(callers)}")
    meant = similar(logic, key)
    if meant:
        notes.append(f"did you mean {' or '.join(meant)}?")
    context = (CONTEXT, indicator(key), atom("; ".join(notes))) if notes else indicator(key)
    raise existence_error("procedure", indicator(key), context)


def _callers(logic: "Logic", key: Functor) -> List[str]:
    """Return the first clauses whose bodies mention a goal of this functor."""
    found = []
    for predicate in list(logic.database.predicates.values()):
        if predicate.library:
            continue
        for clause in predicate.live():
            if _mentions(clause.body, key):
                where = f" ({clause.place})" if clause.place is not None else ""
                found.append(f"{predicate.functor}{where}".split("\n")[0])
                if len(found) == 3:
                    return found
                break
    return found


def _mentions(term: Term, key: Functor) -> bool:
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple:
            if item[0] is key:
                return True
            stack.extend(item[1:])
        elif item.__class__ is Atom and key.arity == 0 and item.name == key.name:
            return True
    return False


def similar(logic: "Logic", key: Functor) -> List[str]:
    """Return indicators of defined procedures whose name is the same or nearly so."""
    names: Dict[str, List[Functor]] = {}
    for other in logic.names():
        if other is not key:
            names.setdefault(other.name, []).append(other)
    close = [key.name] if key.name in names else get_close_matches(key.name, names, 1, 0.8)
    return [str(other) for name in close for other in sorted(names[name], key=lambda found: found.arity)][:3]
