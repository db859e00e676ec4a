"""Unification."""

from typing import Any, List

from ...foundation import look
from .cycles import LATE, MetPairs, contains_itself
from .kinds import NUMBERED, Atom, Lazy, Term, Trail, Var, deref
from .steps import MASK, check_steps
from .walking import copy


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
