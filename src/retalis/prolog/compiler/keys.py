"""First-level keys of terms, which indexes and compiled clauses compare."""

from typing import Any

from ..terms import Atom, Lazy, Var, deref


def key_of(term: Any) -> object:
    """Return the first-level key of a term for indexes: constant, functor, or None for a variable."""
    kind = term.__class__
    if kind is tuple:
        return term[0]
    if kind is Atom or kind is int:
        return term
    if kind is Var:
        term = deref(term)
        return None if term.__class__ is Var else key_of(term)
    if kind is Lazy:
        found = term.functor
        return found if found.arity else key_of(term.term())
    if kind is float:
        return float, term.hex()
    return term
