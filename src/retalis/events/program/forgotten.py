"""Facts that were meant as goals: without their ``:-`` they would take the place of a predicate of the system."""

from typing import Callable, Dict, Optional, Sequence, Set

from ...prolog.logic import Logic, is_replaceable
from ...prolog.terms import COMMA, CONS, SLASH, Atom, Functor, Term, deref, functor
from ..language import HOLDS, STATE, TIMER, declares_state, sets_timer
from .clauses import FileEntry

_CLAUSE = functor(":-", 2)
_GRAMMAR = functor("-->", 2)
_SINGLE_SIDED = functor("=>", 2)
_GIVING_WAY: Dict[Functor, Callable[[Term], bool]] = {
    TIMER: sets_timer,
    functor("timers", 1): lambda term: False,
    functor("module", 2): lambda term: False,
    **dict.fromkeys(STATE, declares_state),
    **dict.fromkeys(HOLDS, lambda term: False),
}
"""Predicates with names that programs give to facts of their own, and whether a fact of them was meant as a goal."""

_DECLARES = frozenset(
    (
        *[functor(name, 1) for name in ("dynamic", "discontiguous", "multifile", "table")],
        functor("dynamic", 2),
    )
)
_AS = functor("as", 2)


def defined_in(steps: Sequence[FileEntry]) -> Set[Functor]:
    """Return the predicates that a file defines in earnest: by clauses with a body, several facts, or declaring them.

    Several facts count where nobody would write a goal so: not for what the standard has, nor for goals about events.
    """
    found: Set[Functor] = set()
    facts: Set[Optional[Functor]] = set()
    for step in steps:
        if step.kind == "clause" and step.term.__class__ is tuple and _has_body(step.term):
            key = _key(step.term[1])
            if key is not None:
                found.add(key)
        elif step.kind == "clause":
            key = _key(step.term)
            if key is not None and key in facts and is_replaceable(key):
                found.add(key)
            facts.add(key)
        elif step.kind == "directive":
            found |= _declared(step.term)
    return found


def fact_error(
    logic: Logic,
    term: Term,
    defined: Set[Functor],
    is_guarded: Optional[Callable[[Functor], bool]] = None,
) -> Optional[str]:
    """Return why a fact of a file that defines these predicates is refused, or None.

    Args:
        logic: knows the predicates.
        term: the fact.
        defined: what the file defines in earnest.
        is_guarded: which predicates of the system such a fact may not replace; by default all.
    """
    key = None if _has_body(term) else _key(term)
    if key is None or key in defined or not (is_guarded or logic.is_of_system)(key):
        return None
    if key in _GIVING_WAY and not _GIVING_WAY[key](term):
        return None
    return (
        f"a fact of {key} would replace the built-in predicate: write :- before a goal; "
        f"to define a predicate of that name, declare it (:- dynamic {key}.)"
    )


def _has_body(term: Term) -> bool:
    return term.__class__ is tuple and term[0] in (_CLAUSE, _GRAMMAR, _SINGLE_SIDED)


def _key(term: Term) -> Optional[Functor]:
    term = deref(term)
    if isinstance(term, Atom):
        return term.functor
    return term[0] if term.__class__ is tuple else None


def _declared(goal: Term) -> Set[Functor]:
    """Return the predicates that a directive declares."""
    goal = deref(goal)
    if goal.__class__ is not tuple or goal[0] not in _DECLARES:
        return set()
    found: Set[Functor] = set()
    stack = [deref(goal[1])]
    while stack:
        term = stack.pop()
        if term.__class__ is not tuple:
            continue
        if term[0] is COMMA or term[0] is CONS:
            stack += [deref(term[2]), deref(term[1])]
        elif term[0] is _AS:  # with options
            stack.append(deref(term[1]))
        elif term[0] is SLASH:
            name, arity = deref(term[1]), deref(term[2])
            if isinstance(name, Atom) and isinstance(arity, int):
                found.add(functor(name.name, arity))
    return found
