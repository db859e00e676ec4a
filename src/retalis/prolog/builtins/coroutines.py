"""Goals on unbound variables: ``freeze/2``, ``dif/2`` and ``when/2`` where they can be decided at once.

No goal waits for a variable here: unification is written into the compiled clauses, and would cost more in all of
them. Where the answer depends on a variable that is not bound yet, these are instantiation errors.
"""

from typing import List, Optional, Tuple

from ...foundation import BULK, TermTooLarge, look
from ..machine import CONTEXT, Frame, PrologError, domain_error, error, indicator, instantiation_error
from ..terms import COMMA, ROUNDS, Functor, Term, Values, Var, atom, deref, functor, is_ground, undo, unify
from .comparing import different
from .program import Machine
from .registry import control, deterministic

_DIF, _FREEZE, _WHEN = functor("dif", 2), functor("freeze", 2), functor("when", 2)
_SEMICOLON = functor(";", 2)
_NONVAR = functor("nonvar", 1)
_GROUND = functor("ground", 1)
_DECIDED = functor("?=", 2)


def _undecided(key: Functor) -> PrologError:
    """Return the error for what a variable decides, which says where there is more."""
    reason = (
        "no goal waits here until a variable is bound: that needs SWI-Prolog, see use_swi in docs/prolog.md"
    )
    return error(atom("instantiation_error"), (CONTEXT, indicator(key), atom(reason)))


@deterministic("dif/2")
def dif(machine: Machine, left: Term, right: Term) -> bool:
    """Test that two terms can never be equal; an error where they may become so."""
    trail = machine.trail
    mark = len(trail)
    if not unify(left, right, trail):
        undo(trail, mark)
        return True
    undecided = len(trail) > mark
    undo(trail, mark)
    if undecided:
        raise _undecided(_DIF)
    return False


@control("freeze/2")
def freeze(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a goal when a variable is bound: it has to be already."""
    if deref(args[0]).__class__ is Var:
        raise _undecided(_FREEZE)
    return machine.logic.control.call(args[1], after)


@control("when/2")
def when(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a goal when a condition holds: it has to hold already."""
    if not _holds(machine, args[0]):
        raise _undecided(_WHEN)
    return machine.logic.control.call(args[1], after)


def _holds(machine: Machine, condition: Term) -> bool:
    """Tell whether a condition holds; no recursion, however deep it is."""
    # Of conjunctions and disjunctions whose left side is looked at: key, right side.
    lefts: List[Tuple[Functor, Term]] = []
    for _ in ROUNDS:
        for _ in BULK:
            condition = deref(condition)
            if condition.__class__ is tuple and condition[0] in (COMMA, _SEMICOLON):
                lefts.append((condition[0], condition[2]))
                condition = condition[1]
                continue
            holds = _simple(machine, condition)
            while lefts:
                key, right = lefts.pop()
                if holds is (key is COMMA):  # the right side decides
                    condition = right
                    break
            else:
                return holds
        look()
    raise TermTooLarge


def _simple(machine: Machine, condition: Term) -> bool:
    if condition.__class__ is Var:
        raise instantiation_error()
    if condition.__class__ is not tuple:
        raise domain_error("when_condition", condition)
    key = condition[0]
    if key is _NONVAR:
        return deref(condition[1]).__class__ is not Var
    if key is _GROUND:
        return is_ground(condition[1])
    if key is _DECIDED:
        return different(machine, condition[1], condition[2]) or _same(machine, *condition[1:])
    raise domain_error("when_condition", condition)


def _same(machine: Machine, left: Term, right: Term) -> bool:
    trail = machine.trail
    mark = len(trail)
    same = unify(left, right, trail) and len(trail) == mark
    undo(trail, mark)
    return same
