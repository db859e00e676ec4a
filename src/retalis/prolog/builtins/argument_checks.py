"""Checks of arguments: each returns the value in Python's form or raises the ISO error."""

from typing import List, Optional

from ...foundation.cancellation import watched
from ..machine.arithmetic import Number
from ..machine.errors import domain_error, instantiation_error, type_error
from ..terms.list_terms import list_parts
from ..terms.types import FALSE, NIL, SLASH, TRUE, Atom, Functor, Term, Var, deref, functor
from .builtin_registry import Machine


def is_iso(machine: Machine) -> bool:
    """Tell whether the flag ``iso`` asks for the standard's checks."""
    return machine.logic.flags["iso"] is TRUE


def integer(term: Term) -> int:
    """Return an integer argument."""
    term = deref(term)
    if term.__class__ is int:
        return term
    if term.__class__ is Var:
        raise instantiation_error()
    raise type_error("integer", term)


def number(term: Term) -> Number:
    """Return an argument that has to be a number; no expression is evaluated."""
    term = deref(term)
    if term.__class__ is int or term.__class__ is float:
        return term
    if term.__class__ is Var:
        raise instantiation_error()
    raise type_error("number", term)


def natural(term: Term) -> int:
    """Return an integer argument that is not negative."""
    value = integer(term)
    if value < 0:
        raise domain_error("not_less_than_zero", value)
    return value


def integer_or_var(term: Term) -> Optional[int]:
    """Return an integer argument, or None where it is unbound."""
    term = deref(term)
    return None if term.__class__ is Var else integer(term)


def atom_of(term: Term) -> Atom:
    """Return an argument that has to be an atom."""
    term = deref(term)
    if term.__class__ is Atom:
        return term
    if term.__class__ is Var:
        raise instantiation_error()
    raise type_error("atom", term)


def is_true(term: Term) -> bool:
    """Return an argument that has to be ``true`` or ``false``."""
    value = atom_of(term)
    if value is not TRUE and value is not FALSE:
        raise type_error("boolean", value)
    return value is TRUE


def callable_of(term: Term) -> Term:
    """Return an argument that has to be an atom or a compound term."""
    term = deref(term)
    if term.__class__ is tuple or term.__class__ is Atom:
        return term
    if term.__class__ is Var:
        raise instantiation_error()
    raise type_error("callable", term)


def items(term: Term) -> List[Term]:
    """Return the items of an argument that has to be a proper list.

    Raises:
        PrologError: an instantiation error for a partial list, a type error for what is none.
    """
    found, tail = list_parts(term)
    if tail is NIL:
        return found
    if tail.__class__ is Var:
        raise instantiation_error()
    raise type_error("list", term)


def partial_items(term: Term) -> List[Term]:
    """Return the items of a list, proper or partial, up to its tail.

    Raises:
        PrologError: a type error for what is not a list.
    """
    found, tail = list_parts(term)
    if tail is NIL or tail.__class__ is Var:
        return found
    raise type_error("list", term)


def check_tail(term: Term) -> None:
    """Raise a type error for the end of what is neither a list nor a partial one."""
    tail = list_parts(term)[1]
    if tail is not NIL and tail.__class__ is not Var:
        raise type_error("list", tail)


def indicator_of(term: Term) -> Functor:
    """Return the functor that ``Name/Arity`` names."""
    term = deref(term)
    if term.__class__ is Var:
        raise instantiation_error()
    if term.__class__ is tuple and term[0].name == ":" and len(term) == 3:
        return indicator_of(term[2])
    if term.__class__ is not tuple or term[0] is not SLASH:
        raise type_error("predicate_indicator", term)
    name, arity = deref(term[1]), deref(term[2])
    if name.__class__ is Var or arity.__class__ is Var:
        raise instantiation_error()
    if name.__class__ is not Atom:
        raise type_error("atom", name)
    return functor(name.name, natural(arity))


def option_values(term: Term) -> List[Term]:
    """Return the options of an option list, dereferenced."""
    found = [deref(item) for item in watched(items(term))]
    for item in watched(found):
        if item.__class__ is Var:
            raise instantiation_error()
    return found
