"""What goals of the event language are given: names of files, lists, intervals."""

from typing import List, Tuple

from ...foundation import UsageError
from ...prolog.machine import domain_error, instantiation_error, type_error
from ...prolog.terms import Atom, String, Term, Var, deref, from_any, functor, list_items

EVENT2 = functor("event", 2)


def path_of(term: Term) -> str:
    """Return the name of a file.

    Raises:
        PrologError: where it is none.
    """
    term = deref(term)
    if term.__class__ is Var:
        raise instantiation_error()
    if term.__class__ not in (Atom, String):
        raise type_error("atom", term)
    return str(term.name if term.__class__ is Atom else term.text)


def items_of(term: Term) -> List[Term]:
    """Return the items of a list.

    Raises:
        PrologError: where it is none.
    """
    items = list_items(term)
    if items is None:
        raise type_error("list", term)
    return items


def interval_of(term: Term) -> Tuple[int, int]:
    """Return the interval of ``[T1,T2]``.

    Raises:
        PrologError: where it is none, or reversed.
    """
    stamps = list_items(term)
    if stamps is None or len(stamps) != 2:
        raise type_error("interval", term)
    try:
        start, end = from_any(stamps[0]), from_any(stamps[1])
    except UsageError:
        raise type_error("datime", term) from None
    if end < start:
        raise domain_error("interval", term)
    return start, end
