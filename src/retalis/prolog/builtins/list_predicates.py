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

Lists: what wants speed; the rest is in the library (library/lists.pl).

Lists as sets and ordered sets: deterministic, and strict about what is not a list.

As for the single-sided rules of SWI-Prolog's library, arguments that fit no clause are an error.

Random numbers, items and orders.
"""

import random
from functools import cmp_to_key
from itertools import compress, count
from math import copysign
from operator import attrgetter
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    Hashable,
    Iterator,
    List,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
)

from ...foundation.cancellation import BULK, look, watched
from ...foundation.errors import TermTooLarge
from ..database.control_constructs import add_arguments
from ..machine.arithmetic import EVALUABLE, Number, add, evaluate
from ..machine.errors import (
    domain_error,
    instantiation_error,
    no_argument,
    no_matching_rule,
    resource_error,
    type_error,
)
from ..machine.machine import LAST, RESUME, Code
from ..terms.list_terms import list_items, list_parts, make_list
from ..terms.term_traversal import LATE_ROUND, MAX_STEPS, ROUNDS, refuse_cycles
from ..terms.types import (
    CONS,
    MINUS,
    NIL,
    Atom,
    CompoundTerm,
    Frame,
    Functor,
    String,
    Term,
    Trail,
    Values,
    Var,
    atom,
    deref,
    functor,
    serial,
)
from ..terms.unification import compare, undo, unify
from .argument_checks import atom_of, integer, is_iso, items, natural, partial_items
from .builtin_registry import Machine, Outcome, Solutions, control, deterministic, nondeterministic

if TYPE_CHECKING:
    from typing_extensions import TypeGuard

Item = TypeVar("Item")

_PLAIN: Dict[type, Callable[[Any], Any]] = {
    int: lambda number: number,
    Atom: attrgetter("name"),
    String: attrgetter("text"),
}
"""Classes of terms whose order Python's own comparison gives, with what is to be compared."""

_MAX_KEY_ITEMS = 64
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
            for argument in watched(item[1:]) if len(item) > _MAX_KEY_ITEMS else item[1:]:
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
            if len(key) + 2 * len(item) > _MAX_KEY_ITEMS:
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
        if len(key) > _MAX_KEY_ITEMS:
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


_MAX, _MIN = EVALUABLE[functor("max", 2)], EVALUABLE[functor("min", 2)]
_REVERSE, _LAST_ITEM = functor("$reverse", 2), functor("$last", 2)


@control("length/2")
def length(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Relate a list with its length."""
    found, tail = list_parts(args[0])
    count = len(found)
    size = deref(args[1])
    if size.__class__ is not Var:
        natural(size)
    if tail is NIL:
        return after if unify(size, count, machine.trail) else None
    if tail.__class__ is not Var:
        raise type_error("list", args[0])
    if size.__class__ is int:
        if size - count > MAX_STEPS:
            raise resource_error("memory")
        return after if size >= count and unify(tail, _open_list(size - count), machine.trail) else None
    if size is tail:
        return None
    return _longer(machine, tail, size, count, count, after)


def _open_list(size: int) -> Term:
    result: Term = NIL
    for at in range(size):
        result = (CONS, Var(), result)
        if not at & 1023:
            look()
    return result


def _longer(
    machine: Machine, tail: Term, size: Term, count: int, total: int, after: Frame
) -> Optional[Frame]:
    machine.choices.append((_LONGER, machine, tail, size, count, total + 1, after, len(machine.trail)))
    return after if machine.unify_all((tail, _open_list(total - count)), (size, total)) else None


_LONGER = Code("length", lambda entry: _longer(*entry[1:7]))
_LONGER.functor = functor("length", 2)


@deterministic("msort/2")
def msort(machine: Machine, unsorted: Term, result: Term) -> bool:
    """Sort in the standard order, keeping duplicates."""
    return unify(result, make_list(sort_terms(items(unsorted))), machine.trail)


@deterministic("sort/2")
def sort(machine: Machine, unsorted: Term, result: Term) -> bool:
    """Sort in the standard order without duplicates."""
    found = sort_unique(items(unsorted))
    if is_iso(machine):
        partial_items(result)
    return unify(result, make_list(found), machine.trail)


@deterministic("sort/4")
def sort_by_key_argument(machine: Machine, key: Term, order: Term, unsorted: Term, result: Term) -> bool:
    """Sort by an argument (0: the whole term) in one of the orders ``@<``, ``@=<``, ``@>``, ``@>=``."""
    at = _sort_key(key)
    order = deref(order)
    if order.__class__ is Var:
        raise instantiation_error()
    if order.__class__ is not Atom:
        raise type_error("atom", order)
    direction = order.name.lstrip("@")
    if direction not in ("<", "=<", ">", ">="):
        raise domain_error("order", order)
    found = by_age(items(unsorted))
    pairs = sort_by(found, [_argument(item, at) for item in watched(found)], direction[0] == ">")
    if "=" not in direction:
        pairs = [pair for n, pair in enumerate(watched(pairs)) if n == 0 or compare(pairs[n - 1][0], pair[0])]
    return unify(result, make_list([item for _, item in pairs]), machine.trail)


def _sort_key(key: Term) -> Optional[int]:
    """Return which argument is the key, 0 for the whole term; None for the name of a field, which no term has."""
    key = deref(key)
    if key.__class__ is Atom or list_items(key):
        return None
    if key.__class__ not in (int, Var):
        raise type_error("sort_key", key)
    number = integer(key)
    if number < 0:
        raise domain_error("not_less_than_one", key)
    return number


def _argument(item: Term, at: Optional[int]) -> Term:
    if at == 0:
        return item
    item = deref(item)
    if item.__class__ is Var:
        raise instantiation_error()
    if item.__class__ is not tuple or at is None:
        raise type_error("compound", item)
    if at >= len(item):
        raise no_argument(at, item)
    found: Term = item[at]
    return found


@deterministic("keysort/2")
def keysort(machine: Machine, pairs: Term, result: Term) -> bool:
    """Sort pairs ``Key-Value`` by key, keeping the order of equal keys."""
    found = [_pair(item) for item in watched(items(pairs))]
    found = [pair for _, pair in sort_by(found, [pair[1] for pair in found])]
    if is_iso(machine):
        for item in watched(partial_items(result)):
            if deref(item).__class__ is not Var:
                _pair(item)
    return unify(result, make_list(found), machine.trail)


@control("$predmerge/4")
def predmerge(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Merge two sorted lists for predsort/3: a goal orders two items at a time, and of equal ones the first stays."""
    closure, first, second, result = args
    goal: Any = add_arguments(closure, (NIL, NIL, NIL), machine.logic.database.modules)
    call = (machine.logic.database.predicate(goal[0]), *goal[1:-3])
    return _merge(machine, call, items(first), 0, items(second), 0, [], result, after)


def _merge(
    machine: Machine,
    call: Frame,
    first: List[Term],
    at: int,
    second: List[Term],
    other: int,
    merged: List[Term],
    result: Term,
    after: Frame,
) -> Optional[Frame]:
    """Return the frame that orders the next item of each list, or goes on where one of them has no more."""
    if at == len(first) or other == len(second):
        return (
            after
            if unify(result, make_list([*merged, *first[at:], *second[other:]]), machine.trail)
            else None
        )
    order = Var()
    height = len(machine.choices)
    then = (_ORDERED, machine, call, first, at, second, other, merged, result, after, order, height)
    return (*call, order, first[at], second[other], then)


def _ordered(frame: Frame) -> Optional[Frame]:
    """Take the item that comes first by the order that the goal has told, which has no other solution from now on."""
    machine: Machine
    _, machine, call, first, at, second, other, merged, result, after, order, height = frame
    del machine.choices[height:]
    order = deref(order)
    if order.__class__ is Var:  # all three are solutions
        for kept, name in enumerate((_GREATER, _SAME)):
            again = (*frame[:7], list(merged), *frame[8:10], name, height + kept)
            machine.choices.append((RESUME, again, len(machine.trail)))
        order = _LESS
    if order is _GREATER:
        merged.append(second[other])
        return _merge(machine, call, first, at, second, other + 1, merged, result, after)
    if order is not _LESS and order is not _SAME:
        return None
    merged.append(first[at])
    return _merge(machine, call, first, at + 1, second, other + (order is _SAME), merged, result, after)


_LESS, _SAME, _GREATER = atom("<"), atom("="), atom(">")
_ORDERED = Code("predsort", _ordered)


def _pair(term: Term) -> CompoundTerm:
    pair = deref(term)
    if pair.__class__ is Var:
        raise instantiation_error()
    if pair.__class__ is not tuple or pair[0] is not MINUS:
        raise type_error("pair", pair)
    return pair


@control("reverse/2", locked=False)
def reverse(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Reverse a list."""
    found = list_items(args[0])
    if found is None:
        return (machine.logic.database.predicate(_REVERSE), *args, after)
    return after if unify(args[1], make_list(found[::-1]), machine.trail) else None


@deterministic("memberchk/2", locked=False)
def memberchk(machine: Machine, item: Term, given: Term) -> bool:
    """Find the first item of a list that unifies; a partial list is extended."""
    trail = machine.trail
    tail = deref(given)
    seen = 0
    while tail.__class__ is tuple and tail[0] is CONS:
        for _ in BULK:
            if tail.__class__ is not tuple or tail[0] is not CONS:
                break
            mark = len(trail)
            if unify(item, tail[1], trail):
                return True
            undo(trail, mark)
            tail = deref(tail[2])
        else:
            look()
            seen += 1
            if seen == LATE_ROUND:
                refuse_cycles(tail)
            if seen > len(ROUNDS):
                raise TermTooLarge
    if tail.__class__ is not Var and tail is not NIL:
        raise type_error("list", tail)
    return tail.__class__ is Var and unify(tail, (CONS, item, Var()), trail)


def _folded(
    name: str, step: Callable[[Term, Term], Term], start: Optional[int]
) -> Callable[[Machine, Term, Term], bool]:
    """Return a predicate that folds the numbers of a list; without a start it begins with the first of them."""
    outer, inner = functor(name, 2), functor(name, 3)

    def run(machine: Machine, given: Term, result: Term) -> bool:
        found, tail = list_parts(given)
        value: Optional[Term] = start
        for item in watched(found):
            value = item if value is None else step(value, item)
        if tail is not NIL:
            goal = (outer, tail, result) if value is None else (inner, tail, value, result)
            raise no_matching_rule("lists", goal)
        return value is not None and unify(result, value, machine.trail)

    return run


def _better(function: Callable[..., Number]) -> Callable[[Term, Term], Term]:
    return lambda best, item: function(evaluate(best), evaluate(item))


deterministic("sum_list/2", "sumlist/2", locked=False)(_folded("sum_list", add, 0))
deterministic("max_list/2", locked=False)(_folded("max_list", _better(_MAX), None))
deterministic("min_list/2", locked=False)(_folded("min_list", _better(_MIN), None))


@deterministic("numlist/3", locked=False)
def numlist(machine: Machine, low: Term, high: Term, result: Term) -> bool:
    """Give the list of integers between two."""
    first, last = integer(low), integer(high)
    if last - first > MAX_STEPS:
        raise resource_error("memory")
    numbers: Term = NIL
    for at in range(last, first - 1, -1):
        numbers = (CONS, at, numbers)
        if not at & 1023:
            look()
    return first <= last and unify(result, numbers, machine.trail)


@control("last/2", locked=False)
def last(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Give the last item of a list."""
    found = list_items(args[0])
    if found is None:
        return (machine.logic.database.predicate(_LAST_ITEM), *args, after)
    return after if found and unify(args[1], found[-1], machine.trail) else None


@deterministic("list_to_set/2", locked=False)
def list_to_set(machine: Machine, given: Term, result: Term) -> bool:
    """Drop duplicates (by ``==``), keeping the first."""
    found = items(given)
    pairs = sort_by(range(len(found)), found)  # stable: of equal ones the first comes first
    kept = bytearray(len(found))
    for n, (item, at) in enumerate(watched(pairs)):
        kept[at] = n == 0 or compare(pairs[n - 1][0], item) != 0
    return unify(result, make_list(compress(found, kept)), machine.trail)


@deterministic("list_to_ord_set/2", locked=False)
def list_to_ord_set(machine: Machine, given: Term, result: Term) -> bool:
    """Sort without duplicates."""
    return sort(machine, given, result)


def _nth(base: int) -> Callable[[Machine, Term, Term, Term], Outcome]:
    def run(machine: Machine, index: Term, given: Term, item: Term) -> Outcome:
        index = deref(index)
        if index.__class__ is Var:
            return _numbered(machine, index, base, given, item)
        number = integer(index)
        if number < base:
            return False
        if number > MAX_STEPS:
            raise resource_error("term_size")
        return _at(machine, number - base, given, item)

    return run


def _at(machine: Machine, left: int, given: Term, item: Term) -> bool:
    """Unify the item after ``left`` others; a partial list is extended."""
    tail = deref(given)
    while left > 0 and tail.__class__ is tuple and tail[0] is CONS:
        left -= 1
        tail = deref(tail[2])
        if not left & 1023:
            look()
    if tail.__class__ is Var:
        return unify(tail, _behind(left, item), machine.trail)
    return left == 0 and tail.__class__ is tuple and tail[0] is CONS and unify(item, tail[1], machine.trail)


def _numbered(machine: Machine, index: Term, base: int, given: Term, item: Term) -> Solutions:
    """Go through the items with their numbers; a partial list is extended."""
    tail = deref(given)
    at = base
    while tail.__class__ is tuple and tail[0] is CONS:
        rest = deref(tail[2])
        if machine.unify_all((item, tail[1]), (index, at)):
            yield LAST if rest is NIL else None
        at += 1
        tail = rest
        if not at & 1023:
            look()
            if at > MAX_STEPS:
                raise TermTooLarge
    known = at
    while tail.__class__ is Var and tail is not index:  # no list is a number
        look()
        if machine.unify_all((tail, _behind(at - known, item)), (index, at)):
            yield None
        at += 1
        if at - known > MAX_STEPS:
            raise TermTooLarge


def _behind(count: int, item: Term) -> Term:
    """Return a partial list with an item behind some unknown ones."""
    cells: Term = (CONS, item, Var())
    for at in range(count):
        cells = (CONS, Var(), cells)
        if not at & 1023:
            look()
    return cells


nondeterministic("nth0/3", locked=False)(_nth(0))
nondeterministic("nth1/3", locked=False)(_nth(1))


@nondeterministic("between/3")
def between(machine: Machine, low: Term, high: Term, value: Term) -> Outcome:
    """Enumerate the integers between two; the upper one may be ``inf``."""
    first = integer(low)
    high = deref(high)
    if high.__class__ is Atom and high.name in ("inf", "infinite"):
        limit = None
    else:
        limit = integer(high)
    value = deref(value)
    if value.__class__ is not Var:
        number = integer(value)
        return first <= number and (limit is None or number <= limit)
    return _integers(machine.trail, first, limit, value)


def _integers(trail: Trail, first: int, limit: Optional[int], value: Var) -> Solutions:
    at = first
    while limit is None or at <= limit:
        value.ref = at
        trail.append(value)
        yield LAST if at == limit else None
        at += 1


_SUBTRACT, _INTERSECTION, _UNION = (functor(name, 3) for name in ("subtract", "intersection", "union"))
_SUBSET = functor("subset", 2)
_ORD_UNION, _ORD_UNION_ALL, _UNION2 = functor("ord_union", 3), functor("ord_union", 2), functor("union2", 4)


_ITEMS = BULK[:32]
"""Items between two looks at the limits: for each, another list of up to a thousand items may be searched."""


def is_cons(term: Term) -> "TypeGuard[CompoundTerm]":
    """Tell whether a dereferenced term is a list cell."""
    return term.__class__ is tuple and term[0] is CONS


def bounded() -> Iterator[None]:
    """Count the items of a list, which may contain itself, with a look at the limits of the goal now and then."""
    for _ in range(MAX_STEPS // len(_ITEMS)):
        yield from _ITEMS
        look(len(_ITEMS))
    raise TermTooLarge


def _filter(
    key: Functor, keeps: bool, end: Callable[[Term], Term]
) -> Callable[[Machine, Term, Term, Term], bool]:
    """Return a predicate that keeps the items of a list that are in another one, or those that are not."""

    def run(machine: Machine, given: Term, other: Term, result: Term) -> bool:
        rest = deref(given)
        for _ in bounded():
            if not is_cons(rest):
                break
            if memberchk(machine, rest[1], other) is keeps:
                tail = Var()
                if not unify(result, (CONS, rest[1], tail), machine.trail):
                    return False
                result = tail
            rest = deref(rest[2])
        if rest is not NIL:
            raise no_matching_rule("lists", (key, rest, other, result))
        return unify(result, end(other), machine.trail)

    return run


deterministic("subtract/3", locked=False)(_filter(_SUBTRACT, False, lambda other: NIL))
deterministic("intersection/3", locked=False)(_filter(_INTERSECTION, True, lambda other: NIL))
deterministic("union/3", locked=False)(_filter(_UNION, False, lambda other: other))


@deterministic("subset/2", locked=False)
def subset(machine: Machine, given: Term, other: Term) -> bool:
    """Test that each item of a list unifies with one of another."""
    rest = deref(given)
    for _ in bounded():
        if not is_cons(rest):
            break
        if not memberchk(machine, rest[1], other):
            return False
        rest = deref(rest[2])
    if rest is not NIL:
        raise no_matching_rule("lists", (_SUBSET, rest, other))
    return True


def _best(name: str, sign: int) -> Callable[[Machine, Term, Term], bool]:
    """Return a predicate that finds the item that is last, or first, in the standard order."""
    outer, inner = functor(name, 2), functor(f"{name}_", 3)

    def run(machine: Machine, result: Term, given: Term) -> bool:
        rest = deref(given)
        if rest is NIL:
            return False
        if not is_cons(rest):
            raise no_matching_rule("lists", (outer, result, rest))
        best, rest = rest[1], deref(rest[2])
        for _ in bounded():
            if not is_cons(rest):
                break
            if compare(best, rest[1]) * sign < 0:
                best = rest[1]
            rest = deref(rest[2])
        if rest is not NIL:
            raise no_matching_rule("lists", (inner, rest, best, result))
        return unify(result, best, machine.trail)

    return run


deterministic("max_member/2", locked=False)(_best("max_member", 1))
deterministic("min_member/2", locked=False)(_best("min_member", -1))


@deterministic("ord_union/3", locked=False)
def ord_union(machine: Machine, left: Term, right: Term, result: Term) -> bool:
    """Merge two ordered sets."""
    first: Optional[Term] = None  # the next item of the left one, once the two are being compared
    for _ in bounded():
        if first is None:
            left = deref(left)
            if left is NIL:
                return unify(result, right, machine.trail)
            if not is_cons(left):
                raise no_matching_rule("ordsets", (_ORD_UNION, left, right, result))
            first, left = left[1], left[2]
        right = deref(right)
        if right is NIL:
            return unify(result, (CONS, first, left), machine.trail)
        if not is_cons(right):
            raise no_matching_rule("ordsets", (_UNION2, right, first, left, result))
        order = compare(first, right[1])
        tail = Var()
        if not unify(result, (CONS, first if order <= 0 else right[1], tail), machine.trail):
            return False
        result = tail
        if order < 0:
            first, left, right = right[1], right[2], left
        else:
            first, right = (first if order else None), right[2]
    return False


@deterministic("ord_union/2", locked=False)
def ord_union_all(machine: Machine, sets: Term, result: Term) -> bool:
    """Merge a list of ordered sets."""
    merged = list_items(sets)
    if merged is None:
        raise no_matching_rule("ordsets", (_ORD_UNION_ALL, sets, result))
    while len(merged) > 1:
        unions = [Var() for _ in range(len(merged) // 2)]
        for at, union in enumerate(unions):
            ord_union(machine, merged[2 * at], merged[2 * at + 1], union)
        merged = unions + merged[2 * len(unions) :]
    return unify(result, merged[0] if merged else NIL, machine.trail)


@deterministic("$no_rule/2")
def no_rule(machine: Machine, module: Term, goal: Term) -> bool:
    """Raise the error of a library predicate of single-sided rules."""
    raise no_matching_rule(atom_of(module).name, goal)


@deterministic("random/1")
def random_float(machine: Machine, value: Term) -> bool:
    """Give a float between 0 and 1, both excluded."""
    return unify(value, random.random() or 0.5, machine.trail)


@deterministic("random_between/3")
def random_between(machine: Machine, low: Term, high: Term, value: Term) -> bool:
    """Give an integer between two, both included."""
    first, last = integer(low), integer(high)
    return first <= last and unify(value, random.randint(first, last), machine.trail)


@deterministic("random_member/2")
def random_member(machine: Machine, value: Term, given: Term) -> bool:
    """Give an item of a list."""
    found = items(given)
    if not found:
        raise domain_error("non_empty_list", given)
    return unify(value, random.choice(found), machine.trail)


@deterministic("random_permutation/2")
def random_permutation(machine: Machine, given: Term, result: Term) -> bool:
    """Give the items of a list in another order."""
    found = items(given)
    ranks = [random.random() for _ in watched(found)]
    return unify(result, make_list([found[at] for at in order_of(ranks)]), machine.trail)


@deterministic("set_random/1")
def set_random(machine: Machine, option: Term) -> bool:
    """Set the seed: ``seed(Number)`` or ``seed(random)``."""
    option = deref(option)
    if option.__class__ is Var:
        raise instantiation_error()
    if option.__class__ is not tuple or option[0].name != "seed":
        raise domain_error("random_option", option)
    seed = deref(option[1])
    random.seed(seed if seed.__class__ is int else None)
    return True
