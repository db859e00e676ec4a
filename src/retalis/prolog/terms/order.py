"""The standard order of terms."""

from typing import Any, Callable, List, Optional

from ...foundation import BULK, TermTooLarge, look
from .cycles import LATE_ROUND, MetPairs, contains_itself
from .kinds import Atom, String, Term, Var, deref, serial
from .steps import ROUNDS

_RANK = {Var: 0, float: 1, int: 1, String: 3, Atom: 4, tuple: 5}


def by_age(left: Var, right: Var) -> int:
    """Compare two different variables; they are numbered where they have no numbers yet."""
    return -1 if serial(left) < serial(right) else 1


def by_number(left: Var, right: Var) -> int:
    """Compare two different variables that have numbers.

    Raises:
        AttributeError: one of them has none yet.
    """
    return -1 if left.serial < right.serial else 1


def unlike(left: Var, right: Var) -> int:
    """Return something but 0: for telling terms apart, which numbers no variables."""
    return 1


def compare(  # noqa: C901 -- the loop of sorting: a call for each pair of terms would double its time
    left: Term, right: Term, variables: Callable[[Var, Var], int] = by_age
) -> int:
    """Compare in the standard order of terms: -1, 0 or 1.

    Variables by age (or as ``variables`` says), then numbers by value (a float before an integer of the same
    value), strings and atoms alphabetically, compound terms by arity, name and arguments.
    """
    left, right = deref(left), deref(right)
    if left is right:
        return 0
    if left.__class__ is Atom and right.__class__ is Atom:
        return -1 if left.name < right.name else 1
    if left.__class__ is int and right.__class__ is int:
        return (left > right) - (left < right)
    if left.__class__ is not tuple or right.__class__ is not tuple:
        return _compare_simple(left, right, variables)
    stack: List[Any] = [right, left]
    met: Optional[MetPairs] = None
    for done in ROUNDS:
        for _ in BULK:
            if not stack:
                return 0
            one: Any = stack.pop()
            two: Any = stack.pop()
            if one is two:
                continue
            one = deref(one)
            two = deref(two)
            if one is two:
                continue
            if one.__class__ is not tuple or two.__class__ is not tuple:
                result = _compare_simple(one, two, variables)
                if result:
                    return result
                continue
            if len(one) != len(two):
                return -1 if len(one) < len(two) else 1
            if one[0] is not two[0]:
                return -1 if one[0].name < two[0].name else 1
            if met is not None and not met.is_new(one, two):
                continue
            if len(one) > len(BULK):
                look(len(one))
            for at in range(len(one) - 1, 0, -1):
                stack.append(two[at])
                stack.append(one[at])
        look()
        if done == LATE_ROUND and (contains_itself(left) or contains_itself(right)):
            met = MetPairs()
    raise TermTooLarge


def _compare_simple(left: Any, right: Any, variables: Callable[[Var, Var], int]) -> int:
    """Compare two terms that are not one object, of which one is not compound at least."""
    kind = left.__class__
    rank, other = _RANK[kind], _RANK[right.__class__]
    if rank != other:
        return -1 if rank < other else 1
    if kind is Var:
        return variables(left, right)
    if kind is Atom:
        return -1 if left.name < right.name else 1
    if kind is String:
        return 1 if left.text > right.text else -1 if left.text < right.text else 0
    if left < right:
        return -1
    if left > right:
        return 1
    if kind is right.__class__:
        return _compare_same_floats(left, right) if kind is float else 0
    if left != left or right != right:  # nan comes before all other numbers
        return -1 if left != left else 1
    return -1 if kind is float else 1


def _compare_same_floats(left: float, right: float) -> int:
    """Order two floats that are neither less nor greater: nan first, then -0.0 before 0.0."""
    one, two = (left == left, left.hex()), (right == right, right.hex())
    if one == two:
        return 0
    if one[0] != two[0]:
        return -1 if not one[0] else 1
    return -1 if one[1] == "-0x0.0p+0" else 1
