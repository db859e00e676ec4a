"""Sorting in the standard order of terms."""

from functools import cmp_to_key
from operator import attrgetter, itemgetter
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, TypeVar

from ...foundation import BULK, look
from ..terms import Atom, String, Term, Var, compare, deref, serial

Item = TypeVar("Item")
Key = Optional[Callable[[Any], Any]]
"""By what Python's ``sorted`` compares: None for the items themselves."""

_PLAIN: Dict[type, Key] = {
    int: None,
    Atom: attrgetter("name"),
    String: attrgetter("text"),
}
"""Classes of terms whose order Python's own comparison gives, with what is to be compared."""

_first = itemgetter(0)


def by_age(found: List[Term]) -> List[Term]:
    """Number the variables among terms, and in their arguments, so that they sort in the order they stand in."""
    for item in map(deref, found):
        if item.__class__ is Var:
            serial(item)
        elif item.__class__ is tuple:
            for argument in item[1:]:
                last = deref(argument) if argument.__class__ is Var else argument
                if last.__class__ is Var:
                    serial(last)
    return found


def sort_terms(terms: Sequence[Term], reverse: bool = False) -> List[Term]:
    """Return terms in the standard order; equal ones keep theirs."""
    found: List[Any] = by_age([deref(term) for term in terms])
    return sorted(found, key=_key_for(found), reverse=reverse)


def sort_by(items: Sequence[Item], keys: Sequence[Term], reverse: bool = False) -> List[Tuple[Term, Item]]:
    """Return ``(key, item)`` pairs in the standard order of the keys; equal ones keep theirs."""
    found = by_age([deref(key) for key in keys])
    key = _key_for(found)
    pairs = zip(found, items)
    return sorted(pairs, key=_first if key is None else lambda pair: key(pair[0]), reverse=reverse)


def _key_for(found: Sequence[Term]) -> Key:
    """Return the key by which ``sorted`` puts dereferenced terms in the standard order."""
    kinds = {term.__class__ for term in found}
    if len(kinds) == 1:
        kind = kinds.pop()
        if kind in _PLAIN:
            return _PLAIN[kind]
    return cmp_to_key(_patient())


def _patient() -> Callable[[Term, Term], int]:
    """Return `compare` with a look at the goal's limits once in a while: sorting is one step."""
    turns = iter(BULK)

    def ordered(left: Term, right: Term) -> int:
        nonlocal turns
        if next(turns, 0) == 0:
            look()
            turns = iter(BULK)
        return compare(left, right)

    return ordered


def sort_unique(found: Sequence[Term]) -> List[Term]:
    """Return terms in the standard order, without duplicates."""
    result: List[Term] = []
    for item in sort_terms(found):
        if not result or compare(result[-1], item):
            result.append(item)
    return result
