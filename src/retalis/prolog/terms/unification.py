"""Unification and the standard order of terms.

`unify` is the general algorithm without occurs check (ISO 13211-1, 7.3.2) with an explicit stack. Bindings are pushed
on the trail, and `undo` removes them on backtracking (WAM, chapter 5). The arguments of a pair are compared from left
to right in two groups: constants and variables first, compound arguments afterwards. Constants differ more often and
cost less, so most failures are found without descending.

Terms may be cyclic. After `CYCLE_CHECK_STEP` steps both algorithms check for cycles, and continue with a set of
visited pairs if there is one: two cyclic terms unify, or are equal, if no visited pair contradicts it (rational
trees).

The standard order is that of ISO 13211-1, 7.2, with SWI-Prolog's extensions: variables, numbers by value, strings,
atoms, compound terms by arity, name and arguments.
"""

from typing import Any, Callable, List, Optional

from ...foundation.errors import TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
from .term_traversal import (
    CYCLE_CHECK_ROUND,
    CYCLE_CHECK_STEP,
    STEP_MASK,
    WALK_ROUNDS,
    VisitedPairs,
    check_steps,
    contains_itself,
    copy,
)
from .types import NUMBERED, Atom, Lazy, String, Term, Trail, Var, deref, serial


def unify(  # noqa: C901 -- the innermost loop of all: no calls, no second look at a class
    left: Any, right: Any, trail: Trail
) -> bool:
    """Make two terms equal by binding variables; push each bound variable on ``trail``.

    If both terms are variables, the one that is older in the standard order remains unbound.

    Returns:
        Whether the terms unify. If not, some variables may be bound, and the caller must undo the trail.
    """
    if left is right:
        return True
    left_class = left.__class__
    while left_class is Var:
        ref = left.ref
        if ref is None:
            break
        left = ref
        left_class = ref.__class__
    right_class = right.__class__
    while right_class is Var:
        ref = right.ref
        if ref is None:
            break
        right = ref
        right_class = ref.__class__
    if left is right:
        return True
    if left_class is Var:
        # Bind the younger variable to the older one: in the other direction, the older one would move behind
        # variables that it precedes. Only variables that have a number have an observable order.
        if right_class is Var and NUMBERED and hasattr(left, "serial") and _is_older(left, right):
            left, right = right, left
        left.ref = right  # a lazy term is bound unbuilt
        trail.append(left)
        return True
    if right_class is Var:
        right.ref = left
        trail.append(right)
        return True
    if left_class is Lazy:
        left = left.term()
        left_class = left.__class__
    if right_class is Lazy:
        right = right.term()
        right_class = right.__class__
    if left_class is not right_class:
        return False
    if left_class is not tuple:
        return left is right or (left_class is not Atom and same_constant(left, right))
    if left[0] is not right[0]:
        return False
    # From here on, both terms are compound with the same functor. The loop repeats the code above for the arguments:
    # a call for each argument would double the time of unification.
    stack: List[Any] = []
    steps = 0
    while True:
        size = len(left)
        steps += 1
        if not steps & STEP_MASK:
            check_steps(steps)
            # The pairs that remain are on the stack; a cycle passes through the current pair or the newest entries.
            if steps == CYCLE_CHECK_STEP and contains_itself((left[0], left, right, *stack[-4:])):
                return _unify_cyclic([*stack, right, left], trail)
        if size > STEP_MASK:
            check_limits(size)
        # The first pair of compound arguments is kept in two variables, further ones on the stack: a chain such as a
        # list then needs no stack operations.
        deeper: Any = None
        beside: Any = None
        compound, partner = left, right
        position = 0
        # Most terms have few arguments: setting up `zip` takes more time than it saves.
        while True:
            position += 1
            if position == size:
                break
            left = compound[position]
            right = partner[position]
            if left is right:
                continue
            left_class = left.__class__
            while left_class is Var:
                ref = left.ref
                if ref is None:
                    break
                left = ref
                left_class = ref.__class__
            right_class = right.__class__
            while right_class is Var:
                ref = right.ref
                if ref is None:
                    break
                right = ref
                right_class = ref.__class__
            if left is right:
                continue
            if left_class is Var:
                if right_class is Var and NUMBERED and hasattr(left, "serial") and _is_older(left, right):
                    left, right = right, left
                left.ref = right  # a lazy term is bound unbuilt
                trail.append(left)
                continue
            if right_class is Var:
                right.ref = left
                trail.append(right)
                continue
            if left_class is Atom is right_class:
                return False
            if left_class is Lazy:
                left = left.term()
                left_class = left.__class__
            if right_class is Lazy:
                right = right.term()
                right_class = right.__class__
            if left_class is not right_class:
                return False
            if left_class is tuple:
                if left[0] is not right[0]:
                    return False
                if deeper is None:
                    deeper, beside = left, right
                else:
                    stack.append(right)
                    stack.append(left)
            elif left is not right and (left_class is Atom or not same_constant(left, right)):
                return False
        if deeper is not None:
            left, right = deeper, beside
        elif stack:
            left = stack.pop()
            right = stack.pop()
        else:
            return True


def _unify_cyclic(stack: List[Any], trail: Trail) -> bool:
    """Continue the unification of cyclic terms: compare each pair once."""
    met = VisitedPairs()
    while stack:
        left = deref(stack.pop())
        right = deref(stack.pop())
        if left.__class__ is not tuple or right.__class__ is not tuple:
            if not unify(left, right, trail):
                return False
        elif left[0] is not right[0]:
            return False
        elif left is not right and met.is_new(left, right):
            for position in range(len(left) - 1, 0, -1):
                stack.append(right[position])
                stack.append(left[position])
    return True


def _is_older(left: Var, right: Var) -> bool:
    """Return whether a numbered variable precedes another one, which may have no number yet."""
    return not hasattr(right, "serial") or left.serial < right.serial


def same_constant(left: Any, right: Any) -> bool:
    """Return whether two constants of one class are identical terms: ``nan`` equals itself, 0.0 differs from -0.0."""
    if left.__class__ is float:
        return right.__class__ is float and left.hex() == right.hex()
    return bool(left == right)


def undo(trail: Trail, length: int) -> None:
    """Unbind the entries of ``trail`` above ``length``, newest first."""
    while len(trail) > length:
        trail.pop().ref = None


def may_unify(left: Term, right: Term) -> bool:
    """Return whether two terms without common variables unify; neither is changed."""
    # Only variables of the copies are bound, so no binding has to be undone.
    return unify(copy(left), copy(right), [])


_RANK = {Var: 0, float: 1, int: 1, String: 3, Atom: 4, tuple: 5}
"""Position of each class in the standard order. Numbers share a position, as they are compared by value."""


def compare_by_age(left: Var, right: Var) -> int:
    """Compare two different variables by age; assign numbers to those that have none."""
    return -1 if serial(left) < serial(right) else 1


def compare_by_serial(left: Var, right: Var) -> int:
    """Compare two different variables that have numbers.

    Raises:
        AttributeError: if a variable has no number yet.
    """
    return -1 if left.serial < right.serial else 1


def always_different(left: Var, right: Var) -> int:
    """Return a non-zero result, for tests of identity that must not number variables."""
    return 1


def compare(  # noqa: C901 -- the loop of sorting: a call for each pair of terms would double its time
    left: Term, right: Term, compare_variables: Callable[[Var, Var], int] = compare_by_age
) -> int:
    """Compare two terms in the standard order: return -1, 0 or 1.

    Args:
        left: a term.
        right: another term.
        compare_variables: compares two different variables; by age if not given.
    """
    left, right = deref(left), deref(right)
    if left is right:
        return 0
    if left.__class__ is Atom and right.__class__ is Atom:
        return -1 if left.name < right.name else 1
    if left.__class__ is int and right.__class__ is int:
        return (left > right) - (left < right)
    if left.__class__ is not tuple or right.__class__ is not tuple:
        return _compare_simple(left, right, compare_variables)
    stack: List[Any] = [right, left]
    met: Optional[VisitedPairs] = None  # set once one of the terms has proved to be cyclic
    for round_number in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            if not stack:
                return 0
            first: Any = stack.pop()
            second: Any = stack.pop()
            if first is second:
                continue
            first = deref(first)
            second = deref(second)
            if first is second:
                continue
            if first.__class__ is not tuple or second.__class__ is not tuple:
                result = _compare_simple(first, second, compare_variables)
                if result:
                    return result
                continue
            if len(first) != len(second):
                return -1 if len(first) < len(second) else 1
            if first[0] is not second[0]:
                return -1 if first[0].name < second[0].name else 1
            if met is not None and not met.is_new(first, second):
                continue
            if len(first) > len(STEPS_PER_ROUND):
                check_limits(len(first))
            for position in range(len(first) - 1, 0, -1):
                stack.append(second[position])
                stack.append(first[position])
        check_limits()
        if round_number == CYCLE_CHECK_ROUND and (contains_itself(left) or contains_itself(right)):
            met = VisitedPairs()
    raise TermTooLarge


def _compare_simple(left: Any, right: Any, compare_variables: Callable[[Var, Var], int]) -> int:
    """Compare two different objects that are not both compound."""
    left_class = left.__class__
    left_rank, right_rank = _RANK[left_class], _RANK[right.__class__]
    if left_rank != right_rank:
        return -1 if left_rank < right_rank else 1
    if left_class is Var:
        return compare_variables(left, right)
    if left_class is Atom:
        return -1 if left.name < right.name else 1
    if left_class is String:
        return 1 if left.text > right.text else -1 if left.text < right.text else 0
    if left < right:
        return -1
    if left > right:
        return 1
    # The values are equal or one is nan. Standard order: nan first, and a float before the equal integer.
    if left_class is right.__class__:
        return _compare_same_floats(left, right) if left_class is float else 0
    if left != left or right != right:
        return -1 if left != left else 1
    return -1 if left_class is float else 1


def _compare_same_floats(left: float, right: float) -> int:
    """Order two floats that are equal or not comparable: nan first, then -0.0 before 0.0."""
    left_key, right_key = (left == left, left.hex()), (right == right, right.hex())
    if left_key == right_key:
        return 0
    if left_key[0] != right_key[0]:
        return -1 if not left_key[0] else 1
    return -1 if left_key[1] == "-0x0.0p+0" else 1
