"""Sorting in the standard order of terms.

A list is sorted by keys that Python compares: the terms themselves, or their names, where all are of one plain
class; otherwise a flat tuple for each term, made once. The tuple holds, for each part of the term from left to right,
its rank in the standard order and then the items that order it among others of this rank:

=========== ======================================
part        items
=========== ======================================
variable    0, number by age
number      1, value, -1 for -0.0, 0 for floats, 1 for integers
string      3, text
atom        4, name
compound    5, arity, name, and the items of its arguments
=========== ======================================

Two tuples that agree up to an item describe terms of the same shape up to it, so items of one kind are compared. No
tuple stands in another, which Python would compare by recursion. If a key would be long, as for long lists in a list,
or a number is nan, `compare` is called for each pair of terms.
"""

from functools import cmp_to_key
from math import copysign
from operator import attrgetter
from typing import Any, Callable, Dict, Hashable, List, Optional, Sequence, Tuple, TypeVar

from ...foundation import BULK, look
from ..terms import Atom, String, Term, Var, compare, deref, serial

Item = TypeVar("Item")

_PLAIN: Dict[type, Callable[[Any], Any]] = {
    int: lambda number: number,
    Atom: attrgetter("name"),
    String: attrgetter("text"),
}
"""Classes of terms whose order Python's own comparison gives, with what is to be compared."""

_LONGEST_KEY = 64
"""Items of a key from which on terms are compared pair by pair: keys share nothing, as terms do."""

_MOST_KEYS = 1 << 18
"""Terms of a list that is sorted by keys: Python sorts without a look at the goal's limits, half a second at most."""


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
    found = [deref(term) for term in terms]
    keys = _keys_of(found)
    return [found[at] for at in sorted(range(len(found)), key=keys.__getitem__, reverse=reverse)]


def sort_by(items: Sequence[Item], keys: Sequence[Term], reverse: bool = False) -> List[Tuple[Term, Item]]:
    """Return ``(key, item)`` pairs in the standard order of the keys; equal ones keep theirs."""
    found = [deref(key) for key in keys]
    order = sorted(range(len(found)), key=_keys_of(found).__getitem__, reverse=reverse)
    return [(found[at], items[at]) for at in order]


def sort_unique(terms: Sequence[Term]) -> List[Term]:
    """Return terms in the standard order, without duplicates."""
    found = [deref(term) for term in terms]
    keys = _keys_of(found)
    order = sorted(range(len(found)), key=keys.__getitem__)
    return [found[at] for n, at in enumerate(order) if not n or keys[order[n - 1]] != keys[at]]


def _keys_of(found: List[Term]) -> Sequence[Any]:
    """Return a key for each of some dereferenced terms: they compare as the terms do in the standard order."""
    by_age(found)
    kinds = {term.__class__ for term in found}
    if len(kinds) == 1:
        plain = _PLAIN.get(*kinds)
        if plain is not None:
            return found if kinds == {int} else list(map(plain, found))
    if len(found) <= _MOST_KEYS:
        keys: List[Tuple[Hashable, ...]] = []
        for term in found:
            key = _flat_key(term)
            if key is None:
                break
            keys.append(key)
            if not len(keys) & 1023:
                look()
        else:
            return keys
    return list(map(cmp_to_key(_patient()), found))


def _flat_key(  # noqa: C901 -- a call for each part of a term would double its time
    term: Term,
) -> Optional[Tuple[Hashable, ...]]:
    """Return the key of a term; None where it would be long, or there is none."""
    key: List[Any] = []
    stack = [term]
    while stack:
        item: Any = stack.pop()
        kind = item.__class__
        if kind is not int and kind is not Atom and kind is not tuple:
            item = deref(item)
            kind = item.__class__
        if kind is int:
            key += (1, item, 1)
        elif kind is Atom:
            key += (4, item.name)
        elif kind is tuple:
            key += (5, len(item), item[0].name)
            if len(key) + 2 * len(item) > _LONGEST_KEY:
                return None
            stack += item[:0:-1]
        elif kind is float:
            if item != item:  # nan has no place in an order of Python's
                return None
            key += (1, item, 0 if item or copysign(1.0, item) > 0 else -1)
        elif kind is String:
            key += (3, item.text)
        else:
            key += (0, serial(item))
        if len(key) > _LONGEST_KEY:
            return None
    return tuple(key)


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
