"""Modes of tables: of the answers that agree in the other arguments one is kept, in which these are the best."""

from typing import Callable, Dict, NamedTuple, Optional, Tuple

from ..compiler import ARROW, SEMICOLON
from ..machine import domain_error, instantiation_error, type_error
from ..terms import SLASH, Atom, CompoundTerm, Functor, Term, Var, compare, deref, functor
from .arguments import natural

_EQUAL = functor("=", 2)
_LATTICE, _ORDER = functor("lattice", 1), functor("po", 1)

Pick = Callable[[Term, Term], Term]
_PICKS: Dict[str, Pick] = {
    "first": lambda old, new: old,
    "-": lambda old, new: old,
    "last": lambda old, new: new,
    "min": lambda old, new: old if compare(old, new) <= 0 else new,
    "max": lambda old, new: old if compare(old, new) >= 0 else new,
}


class Mode(NamedTuple):
    """What happens to an argument as answers come.

    Attributes:
        pick: returns the one of two values that is kept; None where a predicate of the program decides.
        goal: returns the goal that makes a value of two others.
        grows: whether a change may lead to other answers; the last one found says nothing of the kind.
    """

    pick: Optional[Pick] = None
    goal: Optional[Callable[[Term, Term, Term], Term]] = None
    grows: bool = True


def modes_of(spec: CompoundTerm) -> Tuple[Functor, Dict[int, Mode]]:
    """Return the functor that a declaration such as ``path(_, _, min)`` names, and modes by position.

    Raises:
        PrologError: a domain error where there is no such mode.
    """
    modes = {}
    for at, given in enumerate(spec[1:], 1):
        given = deref(given)
        if given.__class__ is Var or (given.__class__ is Atom and given.name in ("index", "+")):
            continue
        modes[at] = _mode(given)
    return spec[0], modes


def _mode(given: Term) -> Mode:
    if given.__class__ is Atom and given.name in _PICKS:
        return Mode(_PICKS[given.name], grows=given.name != "last")
    if given.__class__ is not tuple or given[0] not in (_LATTICE, _ORDER):
        raise domain_error("tabled_mode", given)
    arity = 3 if given[0] is _LATTICE else 2
    key = functor(_name(given[1], arity), arity)
    if arity == 3:
        return Mode(goal=lambda old, new, kept: (key, old, new, kept))
    return Mode(
        goal=lambda old, new, kept: (
            SEMICOLON,
            (ARROW, (key, old, new), (_EQUAL, kept, old)),
            (_EQUAL, kept, new),
        )
    )


def _name(given: Term, arity: int) -> str:
    """Return the name of a predicate given by name, by indicator or by head."""
    given = deref(given)
    if given.__class__ is tuple and given[0].name == ":" and len(given) == 3:
        given = deref(given[2])
    size = arity
    if given.__class__ is tuple:
        given, size = (given[1], natural(given[2])) if given[0] is SLASH else (given[0], given[0].arity)
        given = deref(given)
    if size != arity:
        raise domain_error("lattice_arity" if arity == 3 else "po_arity", size)
    if given.__class__ is Var:
        raise instantiation_error()
    if given.__class__ not in (Atom, Functor):
        raise type_error("atom", given)
    return str(given.name)
