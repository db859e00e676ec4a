"""Lists: what wants speed; the rest is in the library (library/lists.pl)."""

from itertools import compress
from typing import Any, Callable, List, Optional

from ...foundation import BULK, TermTooLarge, look, watched
from ..arithmetic import EVALUABLE, Number, add, evaluate
from ..database import add_arguments
from ..machine import (
    LAST,
    RESUME,
    Code,
    Frame,
    domain_error,
    instantiation_error,
    no_argument,
    no_matching_rule,
    resource_error,
    type_error,
)
from ..terms import (
    CONS,
    LATE_ROUND,
    MINUS,
    MOST,
    NIL,
    ROUNDS,
    Atom,
    CompoundTerm,
    Term,
    Trail,
    Values,
    Var,
    atom,
    compare,
    deref,
    functor,
    list_items,
    list_parts,
    make_list,
    refuse_cycles,
    undo,
    unify,
)
from .arguments import integer, is_iso, items, natural, partial_items
from .ordering import by_age, sort_terms, sort_unique
from .ordering import sort_by as by_keys
from .program import Machine, Outcome, Solutions
from .registry import control, deterministic, nondeterministic

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
        if size - count > MOST:
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
def sort_by(machine: Machine, key: Term, order: Term, unsorted: Term, result: Term) -> bool:
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
    pairs = by_keys(found, [_argument(item, at) for item in watched(found)], direction[0] == ">")
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
    found = [pair for _, pair in by_keys(found, [pair[1] for pair in found])]
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
    if last - first > MOST:
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
    pairs = by_keys(range(len(found)), found)  # stable: of equal ones the first comes first
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
        if number > MOST:
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
            if at > MOST:
                raise TermTooLarge
    known = at
    while tail.__class__ is Var and tail is not index:  # no list is a number
        look()
        if machine.unify_all((tail, _behind(at - known, item)), (index, at)):
            yield None
        at += 1
        if at - known > MOST:
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
