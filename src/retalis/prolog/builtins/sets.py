"""Lists as sets and ordered sets: deterministic, and strict about what is not a list.

As for the single-sided rules of SWI-Prolog's library, arguments that fit no clause are an error.
"""

from typing import TYPE_CHECKING, Callable, Iterator, Optional

from ...foundation import BULK, TermTooLarge, look
from ..machine import no_matching_rule
from ..terms import (
    CONS,
    MOST,
    NIL,
    CompoundTerm,
    Functor,
    Term,
    Var,
    compare,
    deref,
    functor,
    list_items,
    unify,
)
from .arguments import atom_of
from .lists import memberchk
from .program import Machine
from .registry import deterministic

if TYPE_CHECKING:
    from typing_extensions import TypeGuard

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
    for _ in range(MOST // len(_ITEMS)):
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
