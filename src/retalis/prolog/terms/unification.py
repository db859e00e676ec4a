"""Unification.

The standard order of terms.
"""

from typing import Any, Callable, List, Optional

from ...foundation.cancellation import BULK, look
from ...foundation.errors import TermTooLarge
from .term_traversal import LATE, LATE_ROUND, MASK, ROUNDS, MetPairs, check_steps, contains_itself, copy
from .types import NUMBERED, Atom, Lazy, String, Term, Trail, Var, deref, serial


def unify(  # noqa: C901 -- the innermost loop of all: no calls, no second look at a class
    left: Any, right: Any, trail: Trail
) -> bool:
    """Make two terms equal by binding variables; each bound variable is pushed on ``trail``.

    Of two variables the one stays that is the older one in the order of terms.
    Returns False where they do not unify; then some variables may be bound, and the caller undoes the trail.
    """
    if left is right:
        return True
    kind = left.__class__
    while kind is Var:
        ref = left.ref
        if ref is None:
            break
        left = ref
        kind = ref.__class__
    other = right.__class__
    while other is Var:
        ref = right.ref
        if ref is None:
            break
        right = ref
        other = ref.__class__
    if left is right:
        return True
    if kind is Var:
        if other is Var and NUMBERED and hasattr(left, "serial") and _is_older(left, right):
            left, right = right, left
        left.ref = right  # a lazy term stays lazy
        trail.append(left)
        return True
    if other is Var:
        right.ref = left
        trail.append(right)
        return True
    if kind is Lazy:
        left = left.term()
        kind = left.__class__
    if other is Lazy:
        right = right.term()
        other = right.__class__
    if kind is not other:
        return False
    if kind is not tuple:
        return left is right or (kind is not Atom and same_constant(left, right))
    if left[0] is not right[0]:
        return False
    stack: List[Any] = []
    steps = 0
    while True:
        size = len(left)
        steps += 1
        if not steps & MASK:
            check_steps(steps)
            if steps == LATE and contains_itself((left[0], left, right, *stack[-4:])):
                return _unify_met([*stack, right, left], trail)
        if size > MASK:
            look(size)
        deeper: Any = None  # compound arguments come after the others, which tell sooner that terms differ
        beside: Any = None
        compound, partner = left, right
        at = 0
        while True:  # most terms have few arguments: setting up `zip` takes more time than it saves
            at += 1
            if at == size:
                break
            left = compound[at]
            right = partner[at]
            if left is right:
                continue
            kind = left.__class__
            while kind is Var:
                ref = left.ref
                if ref is None:
                    break
                left = ref
                kind = ref.__class__
            other = right.__class__
            while other is Var:
                ref = right.ref
                if ref is None:
                    break
                right = ref
                other = ref.__class__
            if left is right:
                continue
            if kind is Var:
                if other is Var and NUMBERED and hasattr(left, "serial") and _is_older(left, right):
                    left, right = right, left
                left.ref = right  # a lazy term stays lazy
                trail.append(left)
                continue
            if other is Var:
                right.ref = left
                trail.append(right)
                continue
            if kind is Atom is other:
                return False
            if kind is Lazy:
                left = left.term()
                kind = left.__class__
            if other is Lazy:
                right = right.term()
                other = right.__class__
            if kind is not other:
                return False
            if kind is tuple:
                if left[0] is not right[0]:
                    return False
                if deeper is None:
                    deeper, beside = left, right
                else:
                    stack.append(right)
                    stack.append(left)
            elif left is not right and (kind is Atom or not same_constant(left, right)):
                return False
        if deeper is not None:
            left, right = deeper, beside
        elif stack:
            left = stack.pop()
            right = stack.pop()
        else:
            return True


def _unify_met(stack: List[Any], trail: Trail) -> bool:
    """Go on with what is left of a unification, where a term contains itself: each pair once."""
    met = MetPairs()
    while stack:
        left = deref(stack.pop())
        right = deref(stack.pop())
        if left.__class__ is not tuple or right.__class__ is not tuple:
            if not unify(left, right, trail):
                return False
        elif left[0] is not right[0]:
            return False
        elif left is not right and met.is_new(left, right):
            for at in range(len(left) - 1, 0, -1):
                stack.append(right[at])
                stack.append(left[at])
    return True


def _is_older(left: Var, right: Var) -> bool:
    """Tell whether a variable that has a number comes before another one, which may have none yet."""
    return not hasattr(right, "serial") or left.serial < right.serial


def same_constant(left: Any, right: Any) -> bool:
    """Tell whether two constants of one class are the same term (``nan`` is itself; 0.0 is not -0.0)."""
    if left.__class__ is float:
        return right.__class__ is float and left.hex() == right.hex()
    return bool(left == right)


def undo(trail: Trail, length: int) -> None:
    """Unbind what was bound since ``trail`` had this length, newest first."""
    while len(trail) > length:
        trail.pop().ref = None


def may_unify(one: Term, other: Term) -> bool:
    """Tell whether two terms unify, each with variables of its own; nothing is bound."""
    trail: Trail = []
    found = unify(copy(one), copy(other), trail)
    undo(trail, 0)
    return found


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
