"""Lists and conjunctions."""

from typing import Iterable, Iterator, List, Optional, Tuple

from ...foundation.cancellation import BULK, look
from ...foundation.errors import TermTooLarge
from .term_traversal import LATE_ROUND, ROUNDS, refuse_cycles
from .types import COMMA, CONS, NIL, TRUE, Term, deref

_CELL = 64
"""Bytes of a list cell."""
_LONG = 1 << 14
"""Items from which on there is a check for room before a list is made."""


def make_list(items: Iterable[Term], tail: Term = NIL) -> Term:
    """Return the Prolog list of ``items``.

    >>> Engine().show(make_list([1, atom("b")]))
    '[1,b]'
    """
    left = list(items)
    if len(left) > _LONG:
        look(size=_CELL * len(left))
    while len(left) > len(BULK):
        for item in reversed(left[-len(BULK) :]):
            tail = (CONS, item, tail)
        del left[-len(BULK) :]
        look()
    for item in reversed(left):
        tail = (CONS, item, tail)
    return tail


def list_items(term: Term) -> Optional[List[Term]]:
    """Return the items of a proper list, or None where ``term`` is none (partial lists included).

    >>> (solution,) = Engine().query("X = [1, 2], Y = [1|_]")
    >>> list_items(solution["X"]), list_items(solution["Y"])
    ([1, 2], None)
    """
    items, tail = list_parts(term)
    return items if tail is NIL else None


def list_parts(term: Term) -> Tuple[List[Term], Term]:
    """Return the items of a list, proper or partial, and its tail."""
    items: List[Term] = []
    term = deref(term)
    for done in ROUNDS:
        for _ in BULK:
            if term.__class__ is not tuple or term[0] is not CONS:
                return items, term
            items.append(term[1])
            term = term[2]
            if term.__class__ is not tuple:
                term = deref(term)
        look()
        if done == LATE_ROUND:
            _refuse_endless(term)
    raise TermTooLarge


def _refuse_endless(term: Term) -> None:
    """Raise an error where the tail of a list is a part of itself; its items are not looked at.

    The cell that the walk compares with is set anew after 1, 2, 4, ... steps: once it is in the cycle, the walk comes
    back to it (Brent's algorithm).
    """
    marked, steps, turn = term, 0, 1
    while term.__class__ is tuple and term[0] is CONS:
        term = term[2]
        if term.__class__ is not tuple:
            term = deref(term)
        if term is marked:
            raise TermTooLarge
        steps += 1
        if steps == turn:
            marked, turn = term, 2 * turn
            look()


def conjuncts(term: Term) -> Iterator[Term]:
    """Yield the goals of a conjunction from left to right."""
    stack = [term]
    for done in ROUNDS:
        for _ in BULK:
            if not stack:
                return
            goal = deref(stack.pop())
            if goal.__class__ is tuple and goal[0] is COMMA:
                stack += (goal[2], goal[1])
            else:
                yield goal
        look()
        if done == LATE_ROUND:
            refuse_cycles(term)
    raise TermTooLarge


def conjunction(goals: Iterable[Term]) -> Term:
    """Return the goals as one goal; ``true`` for none."""
    goals = list(goals)
    if not goals:
        return TRUE
    result = goals[-1]
    for goal in reversed(goals[:-1]):
        result = (COMMA, goal, result)
    return result
