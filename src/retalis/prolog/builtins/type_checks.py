"""Type checks ``must_be/2`` and ``is_of_type/2``, with the types and errors of SWI-Prolog's ``library(error)``."""

from typing import Callable, Dict, Optional

from ...foundation.cancellation import with_limit_checks
from ...foundation.errors import TermTooLarge
from ..machine.arithmetic import evaluate
from ..machine.errors import (
    PrologError,
    domain_error,
    error,
    existence_error,
    instantiation_error,
    uninstantiation_error,
)
from ..machine.machine import Machine
from ..terms.list_terms import list_items, list_parts
from ..terms.term_traversal import is_ground, resolve
from ..terms.types import NIL, Atom, CompoundTerm, String, Term, Var, atom, deref, functor, functor_name
from ..terms.unification import compare
from .argument_checks import integer, items
from .builtin_registry import deterministic
from .text_arguments import is_text_list

_NUMBERS = (int, float)


def is_acyclic(term: Term) -> bool:
    """Return whether a term is not cyclic."""
    # `resolve` raises the error for cyclic terms.
    try:
        resolve(term)
    except TermTooLarge:
        return False
    return True


_LIST_OF = functor("list", 1)
_TYPE_ERROR = functor("type_error", 2)

_ENCODINGS = frozenset(
    [
        "octet",
        "ascii",
        "iso_latin_1",
        "text",
        "utf8",
        "unicode_be",
        "unicode_le",
        "utf16be",
        "utf16le",
        "wchar_t",
    ]
)
_STREAMS = frozenset(("user_input", "user_output", "user_error"))

_TYPE_TESTS: Dict[str, Callable[[Term], bool]] = {
    "any": lambda term: True,
    "dict": lambda term: False,  # dicts are not supported
    "encoding": lambda term: term.__class__ is Atom and term.name in _ENCODINGS,
    "stream": lambda term: term.__class__ is Atom and term.name in _STREAMS,
    "acyclic": is_acyclic,
    "cyclic": lambda term: not is_acyclic(term),
    "var": lambda term: term.__class__ is Var,
    "nonvar": lambda term: term.__class__ is not Var,
    "ground": is_ground,
    "rational": lambda term: term.__class__ is int,
    "positive_integer": lambda term: term.__class__ is int and term > 0,
    "nonneg": lambda term: term.__class__ is int and term >= 0,
    "list_or_partial": lambda term: _is_partial_list(term),
    "list_or_partial_list": lambda term: _is_partial_list(term),
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
    "text": lambda term: term.__class__ in (Atom, String) or is_text_list(term),
    "chars": lambda term: _is_list_of(term, lambda item: item.__class__ is Atom and len(item.name) == 1),
    "codes": lambda term: _is_list_of(term, lambda item: item.__class__ is int and 0 <= item <= 0x10FFFF),
}


def _is_list_of(term: Term, test: Callable[[Term], bool]) -> bool:
    values = list_items(term)
    return values is not None and all(test(deref(item)) for item in with_limit_checks(values))


def _is_partial_list(term: Term) -> bool:
    _, tail = list_parts(term)
    return tail.__class__ is Var or tail is NIL


_ITEM_TYPES = {"chars": atom("char"), "codes": atom("code")}
_WHOLLY_BOUND = frozenset(("text", "string", "rational", "ground", "oneof"))
"""Types for which a term that contains variables is an instantiation error."""


def holds(type_term: Term, term: Term) -> Optional[bool]:
    """Return whether a term has a type, or None for an unknown type.

    Raises:
        PrologError: if an argument of the type is invalid.
    """
    name = functor_name(type_term)
    if type_term.__class__ is tuple:
        return _has_parametric_type(name, type_term, term)
    # The tests take a dereferenced term.
    test = _TYPE_TESTS.get(name)
    return None if test is None else test(term)


def _has_parametric_type(name: str, type_term: CompoundTerm, term: Term) -> Optional[bool]:
    if name == "oneof" and len(type_term) == 2:
        return is_ground(term) and any(
            not compare(item, term) for item in with_limit_checks(items(type_term[1]))
        )
    if name == "between" and len(type_term) == 3:
        low, high = deref(type_term[1]), deref(type_term[2])
        # Bounds that are integers require an integer, other bounds accept any number.
        if low.__class__ is int:
            return term.__class__ is int and low <= term <= integer(high)
        return term.__class__ in _NUMBERS and evaluate(low) <= term <= evaluate(high)
    if name in ("list", "list_of") and len(type_term) == 2:
        values = list_items(term)
        return values is not None and all(
            holds(deref(type_term[1]), deref(item)) for item in with_limit_checks(values)
        )
    return None


def check(type_term: Term, term: Term) -> Optional[PrologError]:
    """Return the error for a term that does not have a type, or None if it does."""
    type_term, term = deref(type_term), deref(term)
    if type_term.__class__ is Var:
        return instantiation_error()
    name = functor_name(type_term)
    # `chars` and `codes` are checked as lists of a type, so that the error names the wrong item.
    item_type = _ITEM_TYPES.get(name) if type_term.__class__ is Atom else None
    if item_type is not None:
        type_term = (_LIST_OF, item_type)
    result = holds(type_term, term)
    if result:
        return None
    if result is None:
        return existence_error("type", type_term)
    if name in ("list", "list_of") or item_type is not None:
        return _list_error(type_term, term)
    if name == "var":
        return uninstantiation_error(term)
    if name in ("cyclic", "acyclic"):
        return domain_error(f"{name}_term", term)
    # An unbound part might still be bound to a value of the type.
    if term.__class__ is Var or (name in _WHOLLY_BOUND and not is_ground(term)):
        return instantiation_error()
    return type_error_of(type_term, term)


def _list_error(type_term: Term, term: Term) -> Optional[PrologError]:
    """Return the error for a term that is not a list, or for the first item of the wrong type."""
    values = list_items(term)
    if values is None or type_term.__class__ is not tuple:
        return instantiation_error() if _is_partial_list(term) else type_error_of(type_term, term)
    errors = (check(type_term[1], item) for item in with_limit_checks(values))
    return next((error for error in errors if error is not None), None)


def type_error_of(type_term: Term, term: Term) -> PrologError:
    """Return the type error for a type, which may be a compound term."""
    return error((_TYPE_ERROR, type_term, term))


@deterministic("must_be/2", is_locked=False)
def must_be(machine: Machine, type_term: Term, term: Term) -> bool:
    """Raise an error unless a term has a type."""
    failure = check(type_term, term)
    if failure is not None:
        raise failure
    return True


@deterministic("is_of_type/2", is_locked=False)
def is_of_type(machine: Machine, type_term: Term, term: Term) -> bool:
    """Test that a term has a type; fail for an unknown type."""
    type_term = deref(type_term)
    if type_term.__class__ is Var:
        raise instantiation_error()
    return bool(holds(type_term, deref(term)))
