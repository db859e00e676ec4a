"""must_be/2 and is_of_type/2."""

from typing import Any, Callable, Dict, Optional

from ...terms import NIL, Atom, String, Term, Var, atom, deref, is_ground, list_items, list_parts
from ..faults import PrologError, domain_error, existence_error, instantiation_error, type_error
from .registry import deterministic
from .text import list_text

_NUMBERS = (int, float)
_LIST = atom("list")

_SIMPLE: Dict[str, Callable[[Term], bool]] = {
    "any": lambda term: True,
    "atom": lambda term: term.__class__ is Atom,
    "atomic": lambda term: term.__class__ in (Atom, String, int, float),
    "symbol": lambda term: term.__class__ is Atom,
    "callable": lambda term: term.__class__ in (Atom, tuple),
    "compound": lambda term: term.__class__ is tuple,
    "float": lambda term: term.__class__ is float,
    "integer": lambda term: term.__class__ is int,
    "number": lambda term: term.__class__ in _NUMBERS,
    "string": lambda term: term.__class__ is String,
    "list": lambda term: list_items(term) is not None,
    "proper_list": lambda term: list_items(term) is not None,
    "boolean": lambda term: term.__class__ is Atom and term.name in ("true", "false"),
    "bool": lambda term: term.__class__ is Atom and term.name in ("true", "false"),
    "char": lambda term: term.__class__ is Atom and len(term.name) == 1,
    "code": lambda term: term.__class__ is int and 0 <= term <= 0x10FFFF,
    "pair": lambda term: term.__class__ is tuple and str(term[0]) == "-/2",
    "text": lambda term: term.__class__ in (Atom, String) or _is_text_list(term),
    "chars": lambda term: _each(term, lambda item: item.__class__ is Atom and len(item.name) == 1),
    "codes": lambda term: _each(term, lambda item: item.__class__ is int and 0 <= item <= 0x10FFFF),
}


def _is_text_list(term: Term) -> bool:
    try:
        return list_text(term) is not None
    except PrologError:
        return False


def _each(term: Term, test: Callable[[Term], bool]) -> bool:
    found = list_items(term)
    return found is not None and all(test(deref(item)) for item in found)


def _is_partial_list(term: Term) -> bool:
    _, tail = list_parts(term)
    return tail.__class__ is Var or tail is NIL


def check(kind: Term, term: Term) -> Optional[PrologError]:
    """Return the error for a term that is not of a type, or None.

    Raises:
        PrologError: where there is no such type.
    """
    kind, term = deref(kind), deref(term)
    name = kind.name if kind.__class__ is Atom else kind[0].name if kind.__class__ is tuple else ""
    if kind.__class__ is Var:
        raise instantiation_error()
    if kind.__class__ is tuple:
        return _parametric(name, kind, term)
    if name == "var":
        return None if term.__class__ is Var else PrologError(type_error("var", term).term)
    if name == "list_or_partial":
        return None if _is_partial_list(term) else type_error(name, term)
    if name in ("positive_integer", "nonneg"):
        return _bounded(name, 1 if name[0] == "p" else 0, term)
    if name == "ground":
        return None if is_ground(term) else instantiation_error()
    test = _SIMPLE.get(name)
    if test is None:
        if name in ("cyclic", "acyclic"):
            return None
        raise existence_error("type", kind)
    if name == "any" or (term.__class__ is not Var and test(term)):
        return None
    if term.__class__ is Var or (name in ("list", "proper_list") and _is_partial_list(term)):
        return instantiation_error()
    return type_error("bool" if name == "boolean" else name, term)


def _bounded(name: str, low: int, term: Term) -> Optional[PrologError]:
    if term.__class__ is Var:
        return instantiation_error()
    if term.__class__ is not int:
        return type_error("integer", term)
    return None if term >= low else type_error(name, term)


def _parametric(name: str, kind: Term, term: Term) -> Optional[PrologError]:
    if name in ("oneof", "between") and term.__class__ is Var:
        return instantiation_error()
    if name == "oneof":
        found = list_items(kind[1]) or []
        return (
            None
            if any(deref(item) is term or deref(item) == term for item in found)
            else domain_error_of(kind, term)
        )
    if name == "between" and len(kind) == 3:
        low, high = deref(kind[1]), deref(kind[2])
        wanted = (int,) if low.__class__ is int and high.__class__ is int else _NUMBERS
        if term.__class__ not in wanted:
            return type_error("integer" if len(wanted) == 1 else "number", term)
        return None if low <= term <= high else domain_error_of(kind, term)
    if name in ("list", "list_of") and len(kind) == 2:
        error = check(_LIST, term)
        if error is not None:
            return error
        return next(
            (found for found in (check(kind[1], item) for item in list_items(term) or []) if found), None
        )
    raise existence_error("type", kind)


def domain_error_of(kind: Term, term: Term) -> PrologError:
    """Return the domain error whose domain is a term."""
    error = domain_error("oneof", term)
    error.term = (error.term[0], (error.term[1][0], kind, term), error.term[2])
    return error


@deterministic("must_be/2", locked=False)
def must_be(machine: Any, kind: Term, term: Term) -> bool:
    """Raise the error for a term that is not of a type."""
    error = check(kind, term)
    if error is not None:
        raise error
    return True


@deterministic("is_of_type/2", locked=False)
def is_of_type(machine: Any, kind: Term, term: Term) -> bool:
    """Test that a term is of a type."""
    return check(kind, term) is None
