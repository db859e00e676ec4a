"""Conversion between Python sequences and Prolog lists or conjunctions."""

from typing import Iterable, Iterator, List, Optional, Tuple

from ...foundation.errors import TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
from .term_traversal import CYCLE_CHECK_ROUND, WALK_ROUNDS, require_acyclic
from .types import COMMA, CONS, NIL, TRUE, Term, deref

_CELL_BYTES = 64
"""Memory of a list cell in bytes."""

_CHECKED_LENGTH = 1 << 14
"""Items above which `make_list` checks the memory limit before it allocates."""


def make_list(items: Iterable[Term], tail: Term = NIL) -> Term:
    """Return the Prolog list of ``items``.

    >>> Engine().show(make_list([1, atom("b")]))
    '[1,b]'
    """
    remaining = list(items)
    if len(remaining) > _CHECKED_LENGTH:
        check_limits(size=_CELL_BYTES * len(remaining))
    # Long lists are built in blocks from the end, with a check of the limits after each block. Deleting the items of
    # a block frees them early, so that the Python list and the cells do not both exist in full.
    while len(remaining) > len(STEPS_PER_ROUND):
        for item in reversed(remaining[-len(STEPS_PER_ROUND) :]):
            tail = (CONS, item, tail)
        del remaining[-len(STEPS_PER_ROUND) :]
        check_limits()
    for item in reversed(remaining):
        tail = (CONS, item, tail)
    return tail


def list_items(term: Term) -> Optional[List[Term]]:
    """Return the items of a proper list, or None for any other term, partial lists included.

    >>> (solution,) = Engine().query("X = [1, 2], Y = [1|_]")
    >>> list_items(solution["X"]), list_items(solution["Y"])
    ([1, 2], None)
    """
    items, tail = list_parts(term)
    return items if tail is NIL else None


def list_parts(term: Term) -> Tuple[List[Term], Term]:
    """Return the items of a proper or partial list, and its tail."""
    items: List[Term] = []
    term = deref(term)
    for round_number in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            if term.__class__ is not tuple or term[0] is not CONS:
                return items, term
            items.append(term[1])
            term = term[2]
            if term.__class__ is not tuple:
                term = deref(term)
        check_limits()
        if round_number == CYCLE_CHECK_ROUND:
            _refuse_endless(term)
    raise TermTooLarge


def _refuse_endless(term: Term) -> None:
    """Raise an error if the tail of a list is cyclic. Items are not checked, as they may be cyclic terms.

    Raises:
        TermTooLarge: if the list has no end.
    """
    # Brent's algorithm (BIT 20, 1980): the cell to compare with moves forward after 1, 2, 4, ... steps. Once it
    # lies in the cycle, the walk returns to it. Unlike a set of visited cells it needs no memory.
    marked, steps, next_mark = term, 0, 1
    while term.__class__ is tuple and term[0] is CONS:
        term = term[2]
        if term.__class__ is not tuple:
            term = deref(term)
        if term is marked:
            raise TermTooLarge
        steps += 1
        if steps == next_mark:
            marked, next_mark = term, 2 * next_mark
            check_limits()


def conjuncts(term: Term) -> Iterator[Term]:
    """Yield the goals of a conjunction from left to right."""
    stack = [term]
    for round_number in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            if not stack:
                return
            goal = deref(stack.pop())
            if goal.__class__ is tuple and goal[0] is COMMA:
                stack += (goal[2], goal[1])
            else:
                yield goal
        check_limits()
        if round_number == CYCLE_CHECK_ROUND:
            require_acyclic(term)
    raise TermTooLarge


def conjunction(goals: Iterable[Term]) -> Term:
    """Return the goals as one conjunction, ``true`` if there are none."""
    goals = list(goals)
    if not goals:
        return TRUE
    result = goals[-1]
    for goal in reversed(goals[:-1]):
        result = (COMMA, goal, result)
    return result
