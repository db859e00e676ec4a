"""Calls of procedures that nobody defined: an error that names the caller and what may have been meant."""

from difflib import get_close_matches
from typing import Dict, List, Optional

from ..database import Clause, Predicate
from ..machine import CONTEXT, Frame, existence_error, indicator
from ..terms import FALSE, Atom, CompoundTerm, Functor, Trail, atom, copy, deref, undo, unify
from .predicates import Predicates

_COMPARED = 200
"""Characters of a name that are compared with those of other names."""


def undefined(logic: Predicates, predicate: Predicate, frame: Frame) -> Optional[Frame]:
    """Raise the existence error of a procedure, or fail, as the flag ``unknown`` says; with a first warning."""
    flag = deref(logic.flags["unknown"])
    if flag is atom("fail") or flag is FALSE:
        return None
    key = predicate.functor
    if flag is atom("warning"):
        if not predicate.missed:
            predicate.missed = True
            logic.message("warning", f"Unknown procedure: {key}")
        return None
    notes = []
    callers = _callers(logic, predicate, frame)
    if callers:
        notes.append(f"called from {', '.join(callers)}")
    meant = similar(logic, logic.database.modules.plain_of(key) or key)
    if meant:
        notes.append(f"did you mean {' or '.join(meant)}?")
    shown = logic.database.modules.shown(key) or indicator(key)
    context = (CONTEXT, shown, atom("; ".join(notes))) if notes else shown
    raise existence_error("procedure", shown, context)


def _callers(logic: Predicates, predicate: Predicate, frame: Frame) -> List[str]:
    """Return the clauses that may have made a call, at most three.

    A last call leaves no trace of its clause, so these are the clauses with a goal that the call is an instance
    of; where the frame that the call returns to belongs to one of their predicates, only that one's.
    """
    key = predicate.functor
    call = (key, *frame[1:-1])
    after = getattr(frame[-1][0], "functor", None)
    clauses = [
        clause
        for other in list(logic.database.predicates.values())
        if not other.library
        for clause in other.live()
        if not clause.fact
    ]
    found = [clause for clause in clauses if _may_call(clause, call, len(call))]
    if not found:  # a goal that others add arguments to, as maplist/3 does
        found = [clause for clause in clauses if _may_call(clause, call, 1)]
    returned_to = [clause for clause in found if clause.predicate.functor is after]
    return [_described(clause) for clause in (returned_to or found)[:3]]


def _described(clause: Clause) -> str:
    where = f" ({clause.place})" if clause.place is not None else ""
    return f"{clause.predicate.functor}{where}".split("\n")[0]


def _may_call(clause: Clause, call: CompoundTerm, least: int) -> bool:
    """Tell whether a goal that may make a call stands in a clause's body, if only with its first arguments."""
    stack = [clause.body]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is Atom:
            item = (item.functor,)
        if item.__class__ is tuple:
            if item[0].name == call[0].name and least <= len(item) <= len(call) and _agree(item, call):
                return True
            stack.extend(item[1:])
    return False


def _agree(goal: CompoundTerm, call: CompoundTerm) -> bool:
    """Tell whether a goal, which may lack the last arguments, unifies with a call."""
    trail: Trail = []
    pairs = zip(copy(goal)[1:], call[1:])
    agree = all(unify(one, other, trail) for one, other in pairs)
    undo(trail, 0)
    return agree


def similar(logic: Predicates, key: Functor) -> List[str]:
    """Return indicators of defined procedures whose name is the same or nearly so."""
    names: Dict[str, List[Functor]] = {}
    for other in logic.names():
        if other is not key and not other.name.startswith("$"):
            names.setdefault(other.name, []).append(other)
    close = [key.name] if key.name in names else get_close_matches(key.name[:_COMPARED], names, 1, 0.8)
    return [str(other) for name in close for other in sorted(names[name], key=lambda found: found.arity)][:3]
