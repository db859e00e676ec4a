"""Type checks of arguments of built-in predicates.

Each function dereferences an argument and returns its value as a Python object. Otherwise it raises the error that
ISO 13211-1 prescribes: an instantiation error for an unbound argument, a type or domain error for a wrong one.
"""

from typing import TYPE_CHECKING, List, Optional

from ...foundation.errors import MessageError
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits, with_limit_checks
from ..machine.arithmetic import Number
from ..machine.errors import domain_error, instantiation_error, instantiation_or_type_error, type_error
from ..terms.array_terms import ELEMENTS_PER_INFERENCE, lazy_array, view
from ..terms.byte_texts import text_bytes
from ..terms.list_terms import list_parts
from ..terms.types import FALSE, NIL, SLASH, TRUE, Atom, Functor, Term, Var, deref, functor
from .builtin_registry import ProgramMachine

if TYPE_CHECKING:
    from ..terms.array_terms import Array


def is_iso(machine: ProgramMachine) -> bool:
    """Return whether the flag ``iso`` is set, which enables the checks that SWI-Prolog omits by default."""
    return machine.logic.flags["iso"] is TRUE


def bound(term: Term) -> Term:
    """Return an argument that must be bound, dereferenced."""
    term = deref(term)
    if term.__class__ is Var:
        raise instantiation_error()
    return term


def integer(term: Term) -> int:
    """Return the value of an integer argument."""
    term = deref(term)
    # Classes are compared by identity: that is faster than `isinstance`, and terms have no subclasses.
    if term.__class__ is int:
        return term
    raise instantiation_or_type_error("integer", term)


def number(term: Term) -> Number:
    """Return the value of a numeric argument; expressions are not evaluated."""
    term = deref(term)
    if term.__class__ is int or term.__class__ is float:
        return term
    raise instantiation_or_type_error("number", term)


def natural(term: Term) -> int:
    """Return the value of a non-negative integer argument."""
    value = integer(term)
    if value < 0:
        raise domain_error("not_less_than_zero", value)
    return value


def integer_or_var(term: Term) -> Optional[int]:
    """Return the value of an integer argument, or None if it is unbound."""
    term = deref(term)
    return None if term.__class__ is Var else integer(term)


def atom_of(term: Term) -> Atom:
    """Return an atom argument."""
    term = deref(term)
    if term.__class__ is Atom:
        return term
    raise instantiation_or_type_error("atom", term)


def is_true(term: Term) -> bool:
    """Return the value of a boolean argument, ``true`` or ``false``."""
    value = atom_of(term)
    if value is not TRUE and value is not FALSE:
        raise type_error("boolean", value)
    return value is TRUE


def callable_of(term: Term) -> Term:
    """Return a callable argument: an atom or a compound term."""
    term = deref(term)
    if term.__class__ is tuple or term.__class__ is Atom:
        return term
    raise instantiation_or_type_error("callable", term)


def items(term: Term) -> List[Term]:
    """Return the items of a proper list.

    Raises:
        PrologError: an instantiation error for a partial list, a type error for any other term.
    """
    # The tail decides the error: an unbound one might still become a list, any other one cannot.
    values, tail = list_parts(term)
    if tail is NIL:
        return values
    if tail.__class__ is Var:
        raise instantiation_error()
    raise type_error("list", term)


def partial_items(term: Term) -> List[Term]:
    """Return the items of a proper or partial list, without its tail.

    Raises:
        PrologError: a type error for what is not a list.
    """
    values, tail = list_parts(term)
    if tail is NIL or tail.__class__ is Var:
        return values
    raise type_error("list", term)


def check_tail(term: Term) -> None:
    """Raise a type error for the tail of a term that is neither a proper nor a partial list."""
    tail = list_parts(term)[1]
    if tail is not NIL and tail.__class__ is not Var:
        raise type_error("list", tail)


def indicator_of(term: Term) -> Functor:
    """Return the functor of a predicate indicator ``Name/Arity``, without its module."""
    term = bound(term)
    # The module is ignored here: the module system has renamed local predicates before.
    if term.__class__ is tuple and term[0].name == ":" and len(term) == 3:
        return indicator_of(term[2])
    if term.__class__ is not tuple or term[0] is not SLASH:
        raise type_error("predicate_indicator", term)
    # Unbound parts take precedence over parts of the wrong type (ISO 13211-1, 7.12.2).
    name, arity = deref(term[1]), deref(term[2])
    if name.__class__ is Var or arity.__class__ is Var:
        raise instantiation_error()
    if name.__class__ is not Atom:
        raise type_error("atom", name)
    return functor(name.name, natural(arity))


def option_values(term: Term) -> List[Term]:
    """Return the dereferenced items of an option list.

    Raises:
        PrologError: an instantiation error for a partial list or an unbound option, a type error for another term.
    """
    options = [deref(option) for option in with_limit_checks(items(term))]
    for option in with_limit_checks(options):
        if option.__class__ is Var:
            raise instantiation_error()
    return options


_NUMBER_CLASSES = {int, float}

_CHECKED_ELEMENTS = ELEMENTS_PER_INFERENCE * len(STEPS_PER_ROUND)
"""Number of elements from which the limits are checked."""


def array_of(term: Term) -> "Array":
    """Return the numbers of an array term, a list of numbers or a byte array as a one-dimensional array.

    An array term is not decoded: the result is a read-only view of its bytes. A list becomes an array of ``int64`` or
    ``uint64`` if it contains only such integers, and of ``float64`` otherwise. The atom of a byte array becomes
    ``uint8``.

    Raises:
        PrologError: an instantiation error for an unbound variable, a partial list or an unbound item; a type error
            for any other term, which says the position of an item that is not a number.
    """
    lazy = lazy_array(term)
    if lazy is not None:
        return view(lazy)
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    value = deref(term)
    if value.__class__ is Atom and value is not NIL:
        return np.frombuffer(_bytes_of(value), "u1")
    values, tail = list_parts(value)
    if tail.__class__ is Var:
        raise instantiation_error()
    if tail is not NIL:
        raise type_error("list", term)
    if not {item.__class__ for item in values} <= _NUMBER_CLASSES:
        values = [_item(item, position) for position, item in enumerate(with_limit_checks(values))]
    check_limits(size=8 * len(values))
    if all(item.__class__ is int for item in values):
        # numpy 1 converts a negative number to an unsigned one without an error.
        for dtype in ("i8", "u8") if min(values, default=0) >= 0 else ("i8",):  # type: ignore[type-var, operator]
            try:
                return np.array(values, dtype)
            except OverflowError:
                pass
    return np.array(values, "f8")


def count_work(elements: int) -> None:
    """Count the work on the elements of an array as inferences, if there are many; check the limits of the goal.

    Raises:
        PrologError: if the goal must end.
    """
    if elements >= _CHECKED_ELEMENTS:
        check_limits(elements // ELEMENTS_PER_INFERENCE)


def _item(item: Term, position: int) -> Number:
    """Return the item of a list of numbers at a position, which is counted from 0."""
    value = deref(item)
    if value.__class__ is int or value.__class__ is float:
        return value
    raise instantiation_or_type_error(
        "number", value, f"item {position} of a list of numbers, counted from 0"
    )


def _bytes_of(value: Atom) -> bytes:
    """Return the bytes that the atom of a byte array stands for."""
    # Other atoms are names, such as a misspelt list.
    raw = None
    if len(value.name) >= 2 and value.name[0] == value.name[-1] == '"':  # noqa: PLR2004
        try:
            raw = text_bytes(value)
        except MessageError as error:
            raise type_error("list", value, error.message) from None
    if raw is None:
        raise type_error("list", value)
    return raw
