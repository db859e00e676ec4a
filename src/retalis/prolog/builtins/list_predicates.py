"""Predicates on lists, ordered sets and random numbers, and sorting in the standard order of terms.

The module contains the predicates whose speed matters; the others are in library/lists.pl. As in SWI-Prolog, whose
library defines many of them with single-sided rules, an argument that matches no rule is an error.

A list is sorted by keys that Python compares: the terms themselves or their names if all terms are of one plain
class; otherwise one flat tuple for each term. The tuple holds, for each part of the term from left to right, its rank
in the standard order and then the items that order it among others of this rank:

=========== ======================================
part        items
=========== ======================================
variable    0, number by age
number      1, value, -1 for -0.0, 0 for floats, 1 for integers
string      3, text
atom        4, name
compound    5, arity, name, and the items of its arguments
=========== ======================================

Two tuples that agree up to an item describe terms of the same shape up to it, so only items of one type are compared.
Tuples are not nested, because Python compares nested ones recursively. If a key would be long, as for long lists in a
list, or a number is nan, `compare` is called for each pair of terms instead.

Python's sort does not check the limits of the goal, so a long list is sorted in chunks, which are then merged. The
merge is a sort too: Timsort finds the sorted runs and merges them. If a merge would take too long, the runs are first
divided at a pivot, and the parts before and after it are merged separately.
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

from ...foundation.errors import TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits, with_limit_checks
from ..database.goal_terms import add_arguments
from ..machine.arithmetic import EVALUABLE, Number, add, evaluate
from ..machine.errors import (
    domain_error,
    instantiation_or_type_error,
    no_argument,
    no_matching_rule,
    resource_error,
    type_error,
)
from ..machine.machine import LAST, RESUME, Code
from ..terms.array_terms import element, element_count, list_array, sum_of_integers, view
from ..terms.list_terms import list_items, list_parts, make_list
from ..terms.term_traversal import CYCLE_CHECK_ROUND, MAX_STEPS, WALK_ROUNDS, check_steps, require_acyclic
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
from .argument_checks import atom_of, bound, count_work, integer, is_iso, items, natural, partial_items
from .builtin_registry import Outcome, ProgramMachine, Solutions, control, deterministic, nondeterministic

if TYPE_CHECKING:
    from typing_extensions import TypeGuard

    from ..terms.array_terms import Array

Item = TypeVar("Item")

_COMPARABLE_VALUES: Dict[type, Callable[[Any], Any]] = {
    int: lambda number: number,
    Atom: attrgetter("name"),
    String: attrgetter("text"),
}
"""Classes of terms that Python can order, with the function that returns the value that it compares."""

_MAX_KEY_ITEMS = 64
"""Limit for the items of a key, beyond which terms are compared in pairs. Keys do not share parts as terms do."""

_CHUNK_ITEMS = 1 << 17
"""Items that are sorted or merged in one step: 50 ms for those of one plain class. Smaller chunks take more time."""

_COMPARISON_KEY_CLASS = type(cmp_to_key(compare)(0))
"""Class of keys that call a function for each comparison."""

_COMPARISONS_PER_CHECK = 32
"""Comparisons between two checks of the goal's limits; one takes up to a thousand steps without a check."""


def number_variables(terms: List[Term]) -> List[Term]:
    """Number the variables among terms and their arguments, and return the terms.

    Variables sort by age, and one gets its number when it is first compared. Without this call, variables would sort
    in the order of comparisons instead of their occurrence.
    """
    for item in map(deref, with_limit_checks(terms)):
        if item.__class__ is Var:
            serial(item)
        elif item.__class__ is tuple:
            for argument in with_limit_checks(item[1:]) if len(item) > _MAX_KEY_ITEMS else item[1:]:
                value = deref(argument) if argument.__class__ is Var else argument
                if value.__class__ is Var:
                    serial(value)
    return terms


def sort_terms(terms: Sequence[Term]) -> List[Term]:
    """Return terms in the standard order; the sort is stable."""
    values = [deref(term) for term in with_limit_checks(terms)]
    return [values[position] for position in with_limit_checks(sorted_positions(_make_sort_keys(values)))]


def sort_by(items: Sequence[Item], keys: Sequence[Term], reverse: bool = False) -> List[Tuple[Term, Item]]:
    """Return ``(key, item)`` pairs in the standard order of the keys; the sort is stable."""
    values = [deref(key) for key in with_limit_checks(keys)]
    return [
        (values[position], items[position])
        for position in with_limit_checks(sorted_positions(_make_sort_keys(values), reverse))
    ]


def sort_unique(terms: Sequence[Term]) -> List[Term]:
    """Return terms in the standard order, without duplicates."""
    values = [deref(term) for term in with_limit_checks(terms)]
    keys = _make_sort_keys(values)
    # Equal items are adjacent after sorting, and equal keys denote equal terms.
    order = sorted_positions(keys)
    return [
        values[position]
        for index, position in enumerate(with_limit_checks(order))
        if not index or keys[order[index - 1]] != keys[position]
    ]


def sorted_positions(keys: Sequence[Any], reverse: bool = False) -> List[int]:
    """Return the positions of keys in sorted order; the sort is stable."""
    key = keys.__getitem__
    if len(keys) <= _CHUNK_ITEMS or keys[0].__class__ is _COMPARISON_KEY_CLASS:
        return sorted(range(len(keys)), key=key, reverse=reverse)
    # Charges the memory of the positions before the sort, which cannot be interrupted.
    check_limits(size=64 * len(keys))
    runs: List[List[int]] = []
    for start in range(0, len(keys), _CHUNK_ITEMS):
        runs.append(sorted(range(start, min(start + _CHUNK_ITEMS, len(keys))), key=key, reverse=reverse))
        check_limits(_CHUNK_ITEMS)
    return _merge_runs(runs, keys, reverse)


def _merge_runs(runs: List[List[int]], keys: Sequence[Any], reverse: bool) -> List[int]:
    """Return the positions of several sorted runs in sorted order."""
    size = sum(map(len, runs))
    check_limits(size)
    if size > _CHUNK_ITEMS:
        # The middle of the longest run divides the positions roughly in half.
        longest = max(runs, key=len)
        pivot = keys[longest[len(longest) // 2]]
        cuts = [_count_before(run, pivot, keys, reverse) for run in runs]
        # If the pivot does not divide the positions, as for many equal keys, the merge is done in one step, which is
        # fast.
        if any(cuts) and cuts != [len(run) for run in runs]:
            merged_heads = _merge_runs([run[:cut] for run, cut in zip(runs, cuts)], keys, reverse)
            return merged_heads + _merge_runs([run[cut:] for run, cut in zip(runs, cuts)], keys, reverse)
    positions = [position for run in runs for position in run]
    positions.sort(key=keys.__getitem__, reverse=reverse)
    return positions


def _count_before(run: List[int], pivot: Any, keys: Sequence[Any], reverse: bool) -> int:
    """Return the number of positions in a sorted run whose keys precede a pivot, by binary search."""
    low, high = 0, len(run)
    while low < high:
        middle = (low + high) // 2
        key = keys[run[middle]]
        if pivot < key if reverse else key < pivot:
            low = middle + 1
        else:
            high = middle
    return low


def _make_sort_keys(terms: List[Term]) -> Sequence[Any]:
    """Return keys that compare like dereferenced terms in the standard order."""
    number_variables(terms)
    classes = {term.__class__ for term in terms}
    if len(classes) == 1:
        to_comparable = _COMPARABLE_VALUES.get(*classes)
        if to_comparable is not None:
            return terms if classes == {int} else list(map(to_comparable, with_limit_checks(terms)))
    keys: List[Tuple[Hashable, ...]] = []
    for term in terms:
        key = _make_flat_key(term)
        if key is None:
            break
        keys.append(key)
        if not len(keys) & 1023:
            check_limits()
    else:
        return keys
    return list(map(cmp_to_key(_checked_compare()), with_limit_checks(terms)))


def _make_flat_key(  # noqa: C901 -- a call for each part of a term would double its time
    term: Term,
) -> Optional[Tuple[Hashable, ...]]:
    """Return the flat key of a term, or None if it would be too long or the term contains nan."""
    key: List[Any] = []
    stack = [term]
    while stack:
        item: Any = stack.pop()
        item_class = item.__class__
        if item_class is not int and item_class is not Atom and item_class is not tuple:
            item = deref(item)
            item_class = item.__class__
        if item_class is int:
            key += (1, item, 1)
        elif item_class is Atom:
            key += (4, item.name)
        elif item_class is tuple:
            key += (5, len(item), item[0].name)
            # The standard order compares arity, then name, then arguments from left to right.
            if len(key) + 2 * len(item) > _MAX_KEY_ITEMS:
                return None
            # Reversed, because the stack returns the last item first.
            stack += item[:0:-1]
        elif item_class is float:
            if item != item:  # Python's comparison does not order nan
                return None
            key += (1, item, 0 if item or copysign(1.0, item) > 0 else -1)
        elif item_class is String:
            key += (3, item.text)
        else:
            key += (0, serial(item))
        if len(key) > _MAX_KEY_ITEMS:
            return None
    return tuple(key)


def _checked_compare() -> Callable[[Term, Term], int]:
    """Return `compare` with regular checks of the goal's limits, since a sort is a single step of the machine."""
    comparison_numbers = count(1)

    def compare_with_checks(left: Term, right: Term) -> int:
        if not next(comparison_numbers) % _COMPARISONS_PER_CHECK:
            check_limits(_COMPARISONS_PER_CHECK)
        return compare(left, right)

    return compare_with_checks


_MAX, _MIN = EVALUABLE[functor("max", 2)], EVALUABLE[functor("min", 2)]
_REVERSE, _LAST_ITEM = functor("$reverse", 2), functor("$last", 2)


@control("length/2")
def length(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Relate a list with its length; a partial list is extended."""
    array = None if args[0].__class__ is tuple else list_array(args[0])
    tail: Term
    if array is None:
        values, tail = list_parts(args[0])
        count = len(values)
    else:
        count, tail = element_count(array), NIL
    size = deref(args[1])
    if size.__class__ is not Var:
        natural(size)
    if tail is NIL:
        return continuation if unify(size, count, machine.trail) else None
    if tail.__class__ is not Var:
        raise type_error("list", args[0])
    if size.__class__ is int:
        if size - count > MAX_STEPS:
            raise resource_error("memory")
        return (
            continuation if size >= count and unify(tail, _open_list(size - count), machine.trail) else None
        )
    # `length(L, L)` has no solution, since no list is a number, but enumeration would not end.
    if size is tail:
        return None
    return _enumerate_lengths(machine, tail, size, count, count, continuation)


def _open_list(size: int) -> Term:
    """Return a list of unbound items."""
    # Built from the end, since list cells are immutable.
    result: Term = NIL
    for index in range(size):
        result = (CONS, Var(), result)
        if not index & 1023:
            check_limits()
    return result


def _enumerate_lengths(
    machine: ProgramMachine, tail: Term, size: Term, known_count: int, length: int, continuation: Frame
) -> Optional[Frame]:
    """Unify with the list that has ``known_count`` items and unbound ones up to ``length``, then with longer ones."""
    # There is always a longer list, so the choice point is pushed for every solution.
    machine.choices.append(
        (_NEXT_LENGTH, machine, tail, size, known_count, length + 1, continuation, len(machine.trail))
    )
    return (
        continuation if machine.unify_all((tail, _open_list(length - known_count)), (size, length)) else None
    )


_NEXT_LENGTH = Code("length", lambda entry: _enumerate_lengths(*entry[1:-1]))
_NEXT_LENGTH.functor = functor("length", 2)


@deterministic("msort/2")
def msort(machine: ProgramMachine, unsorted: Term, result: Term) -> bool:
    """Sort in the standard order with duplicates."""
    return unify(result, make_list(sort_terms(items(unsorted))), machine.trail)


@deterministic("sort/2")
def sort(machine: ProgramMachine, unsorted: Term, result: Term) -> bool:
    """Sort in the standard order without duplicates."""
    sorted_terms = sort_unique(items(unsorted))
    if is_iso(machine):
        partial_items(result)
    return unify(result, make_list(sorted_terms), machine.trail)


@deterministic("sort/4")
def sort_by_key_argument(
    machine: ProgramMachine, key: Term, order: Term, unsorted: Term, result: Term
) -> bool:
    """Sort by an argument, or by the whole term for 0, in one of the orders ``@<``, ``@=<``, ``@>``, ``@>=``."""
    position = _parse_key_position(key)
    order = atom_of(order)
    direction = order.name.lstrip("@")
    if direction not in ("<", "=<", ">", ">="):
        raise domain_error("order", order)
    values = number_variables(items(unsorted))
    pairs = sort_by(
        values, [_key_argument(item, position) for item in with_limit_checks(values)], direction[0] == ">"
    )
    # `@<` and `@>` remove items with equal keys and keep the first of each.
    if "=" not in direction:
        pairs = [
            pair
            for index, pair in enumerate(with_limit_checks(pairs))
            if index == 0 or compare(pairs[index - 1][0], pair[0])
        ]
    return unify(result, make_list([item for _, item in pairs]), machine.trail)


def _parse_key_position(key: Term) -> Optional[int]:
    """Return the position of the key argument, 0 for the whole term; None for the name of a dict's field."""
    key = deref(key)
    if key.__class__ is Atom or list_items(key):
        return None
    if key.__class__ not in (int, Var):
        raise type_error("sort_key", key)
    number = integer(key)
    if number < 0:
        raise domain_error("not_less_than_one", key)
    return number


def _key_argument(item: Term, position: Optional[int]) -> Term:
    if position == 0:
        return item
    item = deref(item)
    if item.__class__ is not tuple or position is None:
        raise instantiation_or_type_error("compound", item)
    if position >= len(item):
        raise no_argument(position, item)
    value: Term = item[position]
    return value


@deterministic("keysort/2")
def keysort(machine: ProgramMachine, pairs: Term, result: Term) -> bool:
    """Sort pairs ``Key-Value`` by key; the sort is stable."""
    sorted_pairs = [_checked_pair(item) for item in with_limit_checks(items(pairs))]
    sorted_pairs = [pair for _, pair in sort_by(sorted_pairs, [pair[1] for pair in sorted_pairs])]
    if is_iso(machine):
        for item in with_limit_checks(partial_items(result)):
            if deref(item).__class__ is not Var:
                _checked_pair(item)
    return unify(result, make_list(sorted_pairs), machine.trail)


class _Merge:
    """State of the merge of two sorted lists for ``predsort/3``, which advances in place.

    Attributes:
        call: the predicate and the first arguments of the comparison goal.
        first: the first list.
        position: number of merged items of the first list.
        second_position: number of merged items of the second list.
        merged: the items merged so far.
        result: the term that is unified with the merged list.
        continuation: the frame after the merge.
    """

    __slots__ = (
        "call",
        "first",
        "position",
        "second",
        "second_position",
        "merged",
        "result",
        "continuation",
    )

    def __init__(self, call: Frame, first: List[Term], second: List[Term], result: Term, continuation: Frame):
        self.call = call
        self.first = first
        self.position = 0
        self.second = second
        self.second_position = 0
        self.merged: List[Term] = []
        self.result = result
        self.continuation = continuation

    def copy(self) -> "_Merge":
        """Return a copy that advances independently."""
        copied = _Merge(self.call, self.first, self.second, self.result, self.continuation)
        copied.position = self.position
        copied.second_position = self.second_position
        copied.merged = list(self.merged)
        return copied


@control("$predmerge/4")
def predmerge(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Merge two sorted lists for ``predsort/3``: a goal compares two items, and of equal ones the first is kept."""
    closure, first, second, result = args
    # The predicate is resolved once, not for each comparison; the arguments are replaced in `_merge`.
    goal: Any = add_arguments(closure, (NIL, NIL, NIL), machine.logic.database.modules)
    call = (machine.logic.database.predicate(goal[0]), *goal[1:-3])
    return _merge(machine, _Merge(call, items(first), items(second), result, continuation))


def _merge(machine: ProgramMachine, state: _Merge) -> Optional[Frame]:
    """Return the frame that compares the next items of both lists, or the continuation if one list has ended."""
    first, position = state.first, state.position
    second, second_position = state.second, state.second_position
    if position == len(first) or second_position == len(second):
        merged_list = make_list([*state.merged, *first[position:], *second[second_position:]])
        return state.continuation if unify(state.result, merged_list, machine.trail) else None
    order = Var()
    after_comparison = (_COMPARED, machine, state, order, len(machine.choices))
    return (*state.call, order, first[position], second[second_position], after_comparison)


def _merge_next(frame: Frame) -> Optional[Frame]:
    """Append the item that is first by the result of the comparison goal, which is cut."""
    machine: ProgramMachine
    state: _Merge
    _, machine, state, order, height = frame
    # Cuts the comparison goal, which is called once.
    del machine.choices[height:]
    order = deref(order)
    # An unbound order unifies with all three results, in this sequence on backtracking.
    if order.__class__ is Var:
        for index, alternative_order in enumerate((_GREATER, _SAME)):
            retry_frame = (_COMPARED, machine, state.copy(), alternative_order, height + index)
            machine.choices.append((RESUME, retry_frame, len(machine.trail)))
        order = _LESS
    if order is _GREATER:
        state.merged.append(state.second[state.second_position])
        state.second_position += 1
    elif order is _LESS or order is _SAME:
        state.merged.append(state.first[state.position])
        state.position += 1
        state.second_position += order is _SAME
    else:
        return None
    return _merge(machine, state)


_LESS, _SAME, _GREATER = atom("<"), atom("="), atom(">")
_COMPARED = Code("predsort", _merge_next)


def _checked_pair(term: Term) -> CompoundTerm:
    """Return a pair ``Key-Value``; raise an instantiation or type error for any other term."""
    pair = deref(term)
    if pair.__class__ is not tuple or pair[0] is not MINUS:
        raise instantiation_or_type_error("pair", pair)
    return pair


@control("reverse/2", is_protected=False)
def reverse(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Reverse a list."""
    values = list_items(args[0])
    if values is None:
        return (machine.logic.database.predicate(_REVERSE), *args, continuation)
    return continuation if unify(args[1], make_list(values[::-1]), machine.trail) else None


@deterministic("memberchk/2", is_protected=False)
def memberchk(machine: ProgramMachine, item: Term, list_term: Term) -> bool:
    """Unify with the first item of a list that unifies; a partial list is extended."""
    trail = machine.trail
    tail = deref(list_term)
    rounds = 0
    while tail.__class__ is tuple and tail[0] is CONS:
        for _ in STEPS_PER_ROUND:
            if tail.__class__ is not tuple or tail[0] is not CONS:
                break
            mark = len(trail)
            if unify(item, tail[1], trail):
                return True
            undo(trail, mark)
            tail = deref(tail[2])
        else:
            check_limits()
            rounds += 1
            if rounds == CYCLE_CHECK_ROUND:
                # Only a long list is checked for a cycle, because the check takes as long as the search.
                require_acyclic(tail)
            if rounds > len(WALK_ROUNDS):
                raise TermTooLarge
    # As by SWI-Prolog, a partial list gets the item as its next element.
    if tail.__class__ is not Var and tail is not NIL:
        raise type_error("list", tail)
    return tail.__class__ is Var and unify(tail, (CONS, item, Var()), trail)


def _fold_predicate(
    name: str,
    step: Callable[[Term, Term], Term],
    start: Optional[int],
    fold_array: "Callable[[Array], Optional[Number]]",
) -> Callable[[ProgramMachine, Term, Term], bool]:
    """Return a predicate that folds the numbers of a list.

    Args:
        name: name of the predicate.
        step: folds one number.
        start: value before the first number; None if that is the first number.
        fold_array: returns the same value for an array, or None if the numbers have to be folded one by one.
    """
    list_functor, accumulator_functor = functor(name, 2), functor(name, 3)

    def run(machine: ProgramMachine, list_term: Term, result: Term) -> bool:
        array = None if list_term.__class__ is tuple else list_array(list_term)
        if array is not None:
            count_work(element_count(array))
            folded = fold_array(view(array))
            if folded is not None:
                return unify(result, folded, machine.trail)
        values, tail = list_parts(list_term)
        value: Optional[Term] = start
        for item in with_limit_checks(values):
            value = item if value is None else step(value, item)
        # The error names the predicate that SWI-Prolog's library calls at this point, with the value so far.
        if tail is not NIL:
            goal = (
                (list_functor, tail, result) if value is None else (accumulator_functor, tail, value, result)
            )
            raise no_matching_rule("lists", goal)
        return value is not None and unify(result, value, machine.trail)

    return run


def _extremum(choose: Callable[..., Number]) -> Callable[[Term, Term], Term]:
    return lambda best, item: choose(evaluate(best), evaluate(item))


def _array_sum(values: "Array") -> Optional[Number]:
    """Return the sum of an array, added from left to right; None if it is not finite."""
    if values.dtype.kind != "f":
        return sum_of_integers(values)
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    # `numpy.sum` adds in pairs, which rounds differently.
    with np.errstate(all="ignore"):
        # The sum of a list starts with the integer 0, which makes a sum of negative zeros positive.
        total: float = np.add.accumulate(values, dtype="f8")[-1].item() + 0.0
    # The numbers are then added one by one, to find the one that causes the error.
    return total if total - total == 0 else None


def _array_extremum(values: "Array", extremum: "Callable[[Array], Any]") -> Optional[Number]:
    """Return the smallest or largest number of an array, without nan; None if all are nan."""
    value: Number = extremum(values).item()
    if value != value:
        return None
    # For a list, the last one of equal numbers is returned. Equal numbers differ only if they are zeros.
    return value or values[(values == 0).nonzero()[0][-1]].item()


def _array_maximum(values: "Array") -> Optional[Number]:
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    return _array_extremum(values, np.fmax.reduce)


def _array_minimum(values: "Array") -> Optional[Number]:
    import numpy as np  # noqa: PLC0415 - see `array_terms`

    return _array_extremum(values, np.fmin.reduce)


deterministic("sum_list/2", "sumlist/2", is_protected=False)(_fold_predicate("sum_list", add, 0, _array_sum))
deterministic("max_list/2", is_protected=False)(
    _fold_predicate("max_list", _extremum(_MAX), None, _array_maximum)
)
deterministic("min_list/2", is_protected=False)(
    _fold_predicate("min_list", _extremum(_MIN), None, _array_minimum)
)


@deterministic("numlist/3", is_protected=False)
def numlist(machine: ProgramMachine, low: Term, high: Term, result: Term) -> bool:
    """Unify with the list of integers between two bounds."""
    first, last = integer(low), integer(high)
    # A longer list could not be processed by other predicates either.
    if last - first > MAX_STEPS:
        raise resource_error("memory")
    numbers: Term = NIL
    for number in range(last, first - 1, -1):
        numbers = (CONS, number, numbers)
        if not number & 1023:
            check_limits()
    return first <= last and unify(result, numbers, machine.trail)


@control("last/2", is_protected=False)
def last(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Unify with the last item of a list."""
    values = list_items(args[0])
    if values is None:
        return (machine.logic.database.predicate(_LAST_ITEM), *args, continuation)
    return continuation if values and unify(args[1], values[-1], machine.trail) else None


@deterministic("list_to_set/2", is_protected=False)
def list_to_set(machine: ProgramMachine, list_term: Term, result: Term) -> bool:
    """Remove duplicates by ``==``, and keep the first of each."""
    values = items(list_term)
    # The sort is stable, so the first of equal items is the one that was first in the list.
    pairs = sort_by(range(len(values)), values)
    # Marks the positions to keep, so that the order of the list is preserved.
    is_first = bytearray(len(values))
    for index, (item, position) in enumerate(with_limit_checks(pairs)):
        is_first[position] = index == 0 or compare(pairs[index - 1][0], item) != 0
    return unify(result, make_list(compress(values, is_first)), machine.trail)


@deterministic("list_to_ord_set/2", is_protected=False)
def list_to_ord_set(machine: ProgramMachine, list_term: Term, result: Term) -> bool:
    """Sort without duplicates."""
    return sort(machine, list_term, result)


def _nth_predicate(base: int) -> Callable[[ProgramMachine, Term, Term, Term], Outcome]:
    """Return ``nth0/3`` or ``nth1/3``; items are counted from ``base``."""

    def run(machine: ProgramMachine, index: Term, list_term: Term, item: Term) -> Outcome:
        index = deref(index)
        if index.__class__ is Var:
            return _enumerate_items(machine, index, base, list_term, item)
        number = integer(index)
        if number < base:
            return False
        if number > MAX_STEPS:
            raise resource_error("term_size")
        return _unify_item(machine, number - base, list_term, item)

    return run


def _unify_item(machine: ProgramMachine, skipped: int, list_term: Term, item: Term) -> bool:
    """Unify the item after ``skipped`` others; a partial list is extended."""
    array = None if list_term.__class__ is tuple else list_array(list_term)
    if array is not None:
        value = element(array, skipped)
        return value is not None and unify(item, value, machine.trail)
    tail = deref(list_term)
    while skipped > 0 and tail.__class__ is tuple and tail[0] is CONS:
        skipped -= 1
        tail = deref(tail[2])
        if not skipped & 1023:
            check_limits()
    if tail.__class__ is Var:
        return unify(tail, _extended_list(skipped, item), machine.trail)
    return (
        skipped == 0 and tail.__class__ is tuple and tail[0] is CONS and unify(item, tail[1], machine.trail)
    )


def _enumerate_items(
    machine: ProgramMachine, index: Term, base: int, list_term: Term, item: Term
) -> Solutions:
    """Enumerate the items with their numbers; a partial list is extended."""
    tail = deref(list_term)
    number = base
    while tail.__class__ is tuple and tail[0] is CONS:
        next_tail = deref(tail[2])
        if machine.unify_all((item, tail[1]), (index, number)):
            yield LAST if next_tail is NIL else None
        number += 1
        tail = next_tail
        if not number & 1023:
            check_steps(number)
    known_count = number
    # If the tail is also the index there is no solution, because a list is not a number.
    while tail.__class__ is Var and tail is not index:
        check_limits()
        if machine.unify_all((tail, _extended_list(number - known_count, item)), (index, number)):
            yield None
        number += 1
        if number - known_count > MAX_STEPS:
            raise TermTooLarge


def _extended_list(count: int, item: Term) -> Term:
    """Return a partial list with an item after ``count`` unbound ones."""
    cells: Term = (CONS, item, Var())
    for index in range(count):
        cells = (CONS, Var(), cells)
        if not index & 1023:
            check_limits()
    return cells


nondeterministic("nth0/3", is_protected=False)(_nth_predicate(0))
nondeterministic("nth1/3", is_protected=False)(_nth_predicate(1))


@nondeterministic("between/3")
def between(machine: ProgramMachine, low: Term, high: Term, value: Term) -> Outcome:
    """Enumerate the integers between two bounds; the upper one may be ``inf``."""
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
    return _enumerate_integers(machine.trail, first, limit, value)


def _enumerate_integers(trail: Trail, first: int, limit: Optional[int], value: Var) -> Solutions:
    number = first
    while limit is None or number <= limit:
        # The variable is unbound at each solution, so it is bound without a unification.
        value.ref = number
        trail.append(value)
        yield LAST if number == limit else None
        number += 1


_SUBTRACT, _INTERSECTION, _UNION = (functor(name, 3) for name in ("subtract", "intersection", "union"))
_SUBSET = functor("subset", 2)
_ORD_UNION, _ORD_UNION_ALL, _UNION2 = functor("ord_union", 3), functor("ord_union", 2), functor("union2", 4)


_ITEMS_PER_CHECK = STEPS_PER_ROUND[:32]
"""Items between two checks of the limits; for each item, a list of up to a thousand items may be searched."""


def is_cons(term: Term) -> "TypeGuard[CompoundTerm]":
    """Return whether a dereferenced term is a list cell."""
    return term.__class__ is tuple and term[0] is CONS


def limited_rounds() -> Iterator[None]:
    """Yield for each item of a list, with regular checks of the limits; raise `TermTooLarge` for a cyclic list."""
    for _ in range(MAX_STEPS // len(_ITEMS_PER_CHECK)):
        yield from _ITEMS_PER_CHECK
        check_limits(len(_ITEMS_PER_CHECK))
    raise TermTooLarge


def _filter_predicate(
    key: Functor, keeps_members: bool, make_tail: Callable[[Term], Term]
) -> Callable[[ProgramMachine, Term, Term, Term], bool]:
    """Return a predicate that keeps some items of a list.

    Args:
        key: functor of the predicate, for errors.
        keeps_members: whether it keeps the items that are in a second list; otherwise it keeps the others.
        make_tail: returns the items that follow the kept ones in the result, from the second list.
    """

    def run(machine: ProgramMachine, list_term: Term, second_list: Term, result: Term) -> bool:
        remaining = deref(list_term)
        for _ in limited_rounds():
            if not is_cons(remaining):
                break
            if memberchk(machine, remaining[1], second_list) is keeps_members:
                tail = Var()
                if not unify(result, (CONS, remaining[1], tail), machine.trail):
                    return False
                result = tail
            remaining = deref(remaining[2])
        if remaining is not NIL:
            raise no_matching_rule("lists", (key, remaining, second_list, result))
        return unify(result, make_tail(second_list), machine.trail)

    return run


deterministic("subtract/3", is_protected=False)(_filter_predicate(_SUBTRACT, False, lambda second_list: NIL))
deterministic("intersection/3", is_protected=False)(
    _filter_predicate(_INTERSECTION, True, lambda second_list: NIL)
)
deterministic("union/3", is_protected=False)(
    _filter_predicate(_UNION, False, lambda second_list: second_list)
)


@deterministic("subset/2", is_protected=False)
def subset(machine: ProgramMachine, list_term: Term, superset: Term) -> bool:
    """Test that each item of a list unifies with an item of another list."""
    remaining = deref(list_term)
    for _ in limited_rounds():
        if not is_cons(remaining):
            break
        if not memberchk(machine, remaining[1], superset):
            return False
        remaining = deref(remaining[2])
    if remaining is not NIL:
        raise no_matching_rule("lists", (_SUBSET, remaining, superset))
    return True


def _extreme_member_predicate(name: str, sign: int) -> Callable[[ProgramMachine, Term, Term], bool]:
    """Return a predicate that finds the last item in the standard order, or the first one if ``sign`` is -1."""
    list_functor, accumulator_functor = functor(name, 2), functor(f"{name}_", 3)

    def run(machine: ProgramMachine, result: Term, list_term: Term) -> bool:
        remaining = deref(list_term)
        if remaining is NIL:
            return False
        if not is_cons(remaining):
            raise no_matching_rule("lists", (list_functor, result, remaining))
        best, remaining = remaining[1], deref(remaining[2])
        for _ in limited_rounds():
            if not is_cons(remaining):
                break
            if compare(best, remaining[1]) * sign < 0:
                best = remaining[1]
            remaining = deref(remaining[2])
        if remaining is not NIL:
            raise no_matching_rule("lists", (accumulator_functor, remaining, best, result))
        return unify(result, best, machine.trail)

    return run


deterministic("max_member/2", is_protected=False)(_extreme_member_predicate("max_member", 1))
deterministic("min_member/2", is_protected=False)(_extreme_member_predicate("min_member", -1))


@deterministic("ord_union/3", is_protected=False)
def ord_union(machine: ProgramMachine, left: Term, right: Term, result: Term) -> bool:
    """Compute the union of two ordered sets."""
    first: Optional[Term] = None  # the item taken from the left set and not yet merged
    for _ in limited_rounds():
        if first is None:
            left = deref(left)
            if left is NIL:
                return unify(result, right, machine.trail)
            if not is_cons(left):
                raise no_matching_rule("ordsets", (_ORD_UNION, left, right, result))
            first, left = left[1], left[2]
        # Each round compares the item taken from the left set with the first one of the right set.
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
            # The sets change roles, so that the left one always has the item that was taken.
            first, left, right = right[1], right[2], left
        else:
            first, right = (first if order else None), right[2]
    return False


@deterministic("ord_union/2", is_protected=False)
def ord_union_all(machine: ProgramMachine, sets: Term, result: Term) -> bool:
    """Compute the union of a list of ordered sets."""
    merged = list_items(sets)
    if merged is None:
        raise no_matching_rule("ordsets", (_ORD_UNION_ALL, sets, result))
    # Sets are merged in pairs, which takes time O(n log n) for n sets of similar size.
    while len(merged) > 1:
        unions = [Var() for _ in range(len(merged) // 2)]
        for index, union in enumerate(unions):
            ord_union(machine, merged[2 * index], merged[2 * index + 1], union)
        merged = unions + merged[2 * len(unions) :]
    return unify(result, merged[0] if merged else NIL, machine.trail)


@deterministic("$no_rule/2")
def no_rule(machine: ProgramMachine, module: Term, goal: Term) -> bool:
    """Raise the error of a library predicate for a call that matches no rule."""
    raise no_matching_rule(atom_of(module).name, goal)


@deterministic("random/1")
def random_float(machine: ProgramMachine, value: Term) -> bool:
    """Unify with a random float between 0 and 1, excluding both."""
    # `random.random` may return 0.0, which is excluded.
    return unify(value, random.random() or 0.5, machine.trail)


_RANDOM_BITS_PER_STEP = 64
"""Bits of a random integer that are generated in the time of one inference, approximately."""


@deterministic("random_between/3")
def random_between(machine: ProgramMachine, low: Term, high: Term, value: Term) -> bool:
    """Unify with a random integer between two bounds, including both."""
    first, last = integer(low), integer(high)
    # A number of a million digits takes a millisecond, as long as thousands of inferences.
    bits = (last - first).bit_length()
    if bits > len(STEPS_PER_ROUND):
        check_limits(bits // _RANDOM_BITS_PER_STEP, bits // 8)
    return first <= last and unify(value, random.randint(first, last), machine.trail)


@deterministic("random_member/2")
def random_member(machine: ProgramMachine, value: Term, list_term: Term) -> bool:
    """Unify with a random item of a list."""
    values = items(list_term)
    if not values:
        raise domain_error("non_empty_list", list_term)
    return unify(value, random.choice(values), machine.trail)


@deterministic("random_permutation/2")
def random_permutation(machine: ProgramMachine, list_term: Term, result: Term) -> bool:
    """Unify with a random permutation of a list."""
    values = items(list_term)
    # Sorting by random ranks instead of `random.shuffle` has the checks of limits of `sorted_positions`.
    ranks = [random.random() for _ in with_limit_checks(values)]
    return unify(result, make_list([values[position] for position in sorted_positions(ranks)]), machine.trail)


@deterministic("set_random/1")
def set_random(machine: ProgramMachine, option: Term) -> bool:
    """Set the seed of the random number generator: ``seed(Number)`` or ``seed(random)``."""
    option = bound(option)
    if option.__class__ is not tuple or option[0].name != "seed":
        raise domain_error("random_option", option)
    seed = deref(option[1])
    random.seed(seed if seed.__class__ is int else None)
    return True
