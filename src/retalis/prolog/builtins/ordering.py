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

Python sorts without a look at the limits of the goal, so a long list is sorted in chunks, which are then merged.
Python's sort finds the sorted runs in a list and merges them. If a merge would take long, the runs are cut at a key
first, and the parts before and behind it are merged separately.
"""

from functools import cmp_to_key
from itertools import count
from math import copysign
from operator import attrgetter
from typing import Any, Callable, Dict, Hashable, List, Optional, Sequence, Tuple, TypeVar

from ...foundation import look, watched
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

_CHUNK = 1 << 17
"""Items that are sorted or merged in one piece: 50 ms for those of one plain class. Smaller pieces take more time."""

_BY_PAIR = type(cmp_to_key(compare)(0))
"""The class of keys that call a function for each comparison."""

_MEASURED = 32
"""Comparisons of terms between two looks at the limits of the goal; each takes up to a thousand steps without one."""


def by_age(found: List[Term]) -> List[Term]:
    """Number the variables among terms, and in their arguments, so that they sort in the order they stand in."""
    for item in map(deref, watched(found)):
        if item.__class__ is Var:
            serial(item)
        elif item.__class__ is tuple:
            for argument in watched(item[1:]) if len(item) > _LONGEST_KEY else item[1:]:
                last = deref(argument) if argument.__class__ is Var else argument
                if last.__class__ is Var:
                    serial(last)
    return found


def sort_terms(terms: Sequence[Term], reverse: bool = False) -> List[Term]:
    """Return terms in the standard order; equal ones keep theirs."""
    found = [deref(term) for term in watched(terms)]
    return [found[at] for at in watched(order_of(_keys_of(found), reverse))]


def sort_by(items: Sequence[Item], keys: Sequence[Term], reverse: bool = False) -> List[Tuple[Term, Item]]:
    """Return ``(key, item)`` pairs in the standard order of the keys; equal ones keep theirs."""
    found = [deref(key) for key in watched(keys)]
    return [(found[at], items[at]) for at in watched(order_of(_keys_of(found), reverse))]


def sort_unique(terms: Sequence[Term]) -> List[Term]:
    """Return terms in the standard order, without duplicates."""
    found = [deref(term) for term in watched(terms)]
    keys = _keys_of(found)
    order = order_of(keys)
    return [found[at] for n, at in enumerate(watched(order)) if not n or keys[order[n - 1]] != keys[at]]


def order_of(keys: Sequence[Any], reverse: bool = False) -> List[int]:
    """Return the positions of keys in their order; those of equal keys in the order that they have."""
    key = keys.__getitem__
    if len(keys) <= _CHUNK or keys[0].__class__ is _BY_PAIR:
        return sorted(range(len(keys)), key=key, reverse=reverse)
    look(size=64 * len(keys))
    runs: List[List[int]] = []
    for start in range(0, len(keys), _CHUNK):
        runs.append(sorted(range(start, min(start + _CHUNK, len(keys))), key=key, reverse=reverse))
        look(_CHUNK)
    return _merged(runs, keys, reverse)


def _merged(runs: List[List[int]], keys: Sequence[Any], reverse: bool) -> List[int]:
    """Return the positions of several sorted runs, sorted."""
    size = sum(map(len, runs))
    look(size)
    if size > _CHUNK:
        longest = max(runs, key=len)
        pivot = keys[longest[len(longest) // 2]]
        cuts = [_first_from(run, pivot, keys, reverse) for run in runs]
        if any(cuts) and cuts != [len(run) for run in runs]:
            before = _merged([run[:cut] for run, cut in zip(runs, cuts)], keys, reverse)
            return before + _merged([run[cut:] for run, cut in zip(runs, cuts)], keys, reverse)
    whole = [at for run in runs for at in run]
    whole.sort(key=keys.__getitem__, reverse=reverse)
    return whole


def _first_from(run: List[int], pivot: Any, keys: Sequence[Any], reverse: bool) -> int:
    """Return how many positions of a sorted run have keys that come before a pivot."""
    low, high = 0, len(run)
    while low < high:
        middle = (low + high) // 2
        key = keys[run[middle]]
        if pivot < key if reverse else key < pivot:
            low = middle + 1
        else:
            high = middle
    return low


def _keys_of(found: List[Term]) -> Sequence[Any]:
    """Return a key for each of some dereferenced terms: they compare as the terms do in the standard order."""
    by_age(found)
    kinds = {term.__class__ for term in found}
    if len(kinds) == 1:
        plain = _PLAIN.get(*kinds)
        if plain is not None:
            return found if kinds == {int} else list(map(plain, watched(found)))
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
    return list(map(cmp_to_key(_patient()), watched(found)))


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
    turns = count(1)

    def ordered(left: Term, right: Term) -> int:
        if not next(turns) % _MEASURED:
            look(_MEASURED)
        return compare(left, right)

    return ordered
