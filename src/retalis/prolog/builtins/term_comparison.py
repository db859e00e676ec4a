"""Unification, comparison, arithmetic and type tests as predicates (clauses have most of them in line).

Goals on unbound variables: ``freeze/2``, ``dif/2`` and ``when/2`` where they can be decided at once.

No goal waits for a variable here: unification is written into the compiled clauses, and would cost more in all of
them. Where the answer depends on a variable that is not bound yet, these are instantiation errors.
"""

from typing import Any, Callable, Dict, List, Optional, Tuple

from ...foundation import codegen
from ...foundation.cancellation import BULK, look, watched
from ...foundation.errors import TermTooLarge
from ..compiler.clause_nodes import COMPARISONS, ORDERS
from ..machine.arithmetic import measure, plain
from ..machine.errors import (
    CONTEXT,
    PrologError,
    domain_error,
    error,
    indicator,
    instantiation_error,
    type_error,
)
from ..terms.list_terms import list_parts, make_list
from ..terms.term_traversal import LATE, MAX_STEPS, ROUNDS, is_ground, refuse_cycles, variables
from ..terms.types import (
    COMMA,
    CONS,
    MINUS,
    NIL,
    Atom,
    Frame,
    Functor,
    String,
    Term,
    Values,
    Var,
    atom,
    deref,
    functor,
)
from ..terms.unification import by_age, compare, undo, unify, unlike
from .argument_checks import integer, integer_or_var, is_iso, natural, partial_items
from .builtin_registry import Machine, control, deterministic

_ORDERS = {-1: atom("<"), 0: atom("="), 1: atom(">")}


@deterministic("=/2")
def equal(machine: Machine, left: Term, right: Term) -> bool:
    """Unify."""
    return unify(left, right, machine.trail)


@deterministic("\\=/2")
def different(machine: Machine, left: Term, right: Term) -> bool:
    """Test that two terms do not unify."""
    mark = len(machine.trail)
    found = unify(left, right, machine.trail)
    undo(machine.trail, mark)
    return not found


@deterministic("unify_with_occurs_check/2")
def unify_with_occurs_check(machine: Machine, left: Term, right: Term) -> bool:
    """Unify, unless that would make an infinite term."""
    trail = machine.trail
    mark = len(trail)
    return unify(left, right, trail) and not any(
        _is_cyclic(var) for var in watched(trail[mark:]) if var.__class__ is Var
    )


def _is_cyclic(var: Any) -> bool:
    """Tell whether the binding of a variable contains the variable."""
    seen = set()
    stack = [var.ref]
    steps = 0
    while stack:
        steps += 1
        if not steps & 1023:
            look()
        item = stack.pop()
        if item is var:
            return True
        if item.__class__ is Var:
            if item.ref is not None and item not in seen:
                seen.add(item)
                stack.append(item.ref)
        elif item.__class__ is tuple:
            stack.extend(item[1:])
    return False


@deterministic("compare/3")
def compare_terms(
    machine: Machine, order: Term, left: Term, right: Term, variables: Callable[[Var, Var], int] = by_age
) -> bool:
    """Compare in the standard order."""
    order = deref(order)
    if order.__class__ is not Var:
        if order.__class__ is not Atom:
            raise type_error("atom", order)
        if order not in _ORDERS.values():
            raise domain_error("order", order)
    return unify(order, _ORDERS[compare(left, right, variables)], machine.trail)


def _order(test: str) -> Callable[[Machine, Term, Term], bool]:
    variables = unlike if test in ("== 0", "!= 0") else by_age
    lines = ["def made(machine, left, right):", f"    return compare(left, right, variables) {test}"]
    names = {"compare": compare, "variables": variables}
    made: Callable[[Machine, Term, Term], bool] = codegen.function(lines, names, f"comparison {test}")
    return made


def _arithmetic(operator: str) -> Callable[[Machine, Term, Term], bool]:
    lines = ["def made(machine, left, right):", f"    return measure(left) {operator} measure(right)"]
    names = {"measure": measure}
    made: Callable[[Machine, Term, Term], bool] = codegen.function(lines, names, f"comparison {operator}")
    return made


for _key, _test in ORDERS.items():
    deterministic(str(_key))(_order(_test))
for _key, _test in COMPARISONS.items():
    deterministic(str(_key))(_arithmetic(_test))


@deterministic("is/2")
def is_value(machine: Machine, result: Term, expression: Term) -> bool:
    """Evaluate."""
    value = measure(expression)
    if value.__class__ is not int and value.__class__ is not float:
        value = plain(value)
    return unify(result, value, machine.trail)


@deterministic("succ/2")
def succ(machine: Machine, smaller: Term, greater: Term) -> bool:
    """Relate an integer that is not negative with the next one."""
    smaller = deref(smaller)
    if smaller.__class__ is Var:
        greater = deref(greater)
        if greater.__class__ is Var:
            raise instantiation_error()
        value = natural(greater)
        return value > 0 and unify(smaller, value - 1, machine.trail)
    value = natural(smaller)
    if deref(greater).__class__ is not Var:
        natural(greater)
    return unify(greater, value + 1, machine.trail)


@deterministic("plus/3")
def plus(machine: Machine, left: Term, right: Term, total: Term) -> bool:
    """Relate two integers with their sum; one of the three may be unbound."""
    left, right, total = deref(left), deref(right), deref(total)
    for known in (left, right, total):
        integer_or_var(known)
    if total.__class__ is Var:
        return unify(total, integer(left) + integer(right), machine.trail)
    if right.__class__ is Var:
        return unify(right, integer(total) - integer(left), machine.trail)
    return unify(left, integer(total) - integer(right), machine.trail)


def _type_test(*classes: type) -> Callable[[Machine, Term], bool]:
    def test(machine: Machine, term: Term) -> bool:
        return deref(term).__class__ in classes

    return test


deterministic("var/1")(_type_test(Var))
deterministic("atom/1")(_type_test(Atom))
deterministic("integer/1", "rational/1")(_type_test(int))
deterministic("float/1")(_type_test(float))
deterministic("number/1")(_type_test(int, float))
deterministic("string/1")(_type_test(String))
deterministic("compound/1")(_type_test(tuple))
deterministic("atomic/1")(_type_test(Atom, int, float, String))
deterministic("nonvar/1")(_type_test(Atom, int, float, String, tuple))
deterministic("callable/1")(_type_test(Atom, tuple))


@deterministic("blob/2")
def blob(machine: Machine, term: Term, kind: Term) -> bool:
    """Give the kind of an atom: there are only those of text."""
    return deref(term).__class__ is Atom and unify(kind, atom("text"), machine.trail)


@deterministic("is_list/1")
def is_list(machine: Machine, term: Term) -> bool:
    """Test for a proper list."""
    return list_parts(term)[1] is NIL


@deterministic("ground/1")
def ground(machine: Machine, term: Term) -> bool:
    """Test for a term without variables."""
    return is_ground(term)


@deterministic("term_variables/2")
def term_variables(machine: Machine, term: Term, result: Term) -> bool:
    """Give the variables of a term."""
    if is_iso(machine):
        partial_items(result)
    return unify(result, make_list(variables(term)), machine.trail)


@deterministic("?=/2")
def decided(machine: Machine, left: Term, right: Term) -> bool:
    """Test that ``==`` of two terms cannot change any more."""
    return compare(left, right, unlike) == 0 or different(machine, left, right)


@deterministic("subsumes_term/2")
def subsumes_term(machine: Machine, general: Term, specific: Term) -> bool:
    """Test that a term can be made equal to another by binding its own variables only."""
    trail = machine.trail
    mark = len(trail)
    before = variables(specific)
    found = unify(general, specific, trail)
    if found:
        after = [deref(var) for var in watched(before)]
        found = all(var.__class__ is Var for var in after) and len(set(after)) == len(before)
        # A variable of the specific term may be bound to one of the general term, not the other way round.
        found = found and variables((CONS, *before)) == after
    undo(trail, mark)
    return found


@deterministic("=@=/2")
def variant(machine: Machine, left: Term, right: Term) -> bool:
    """Test that two terms are equal up to the names of their variables."""
    return is_variant(left, right)


@deterministic("\\=@=/2")
def no_variant(machine: Machine, left: Term, right: Term) -> bool:
    """Test that two terms are not variants."""
    return not is_variant(left, right)


def is_variant(left: Term, right: Term) -> bool:
    """Tell whether two terms are equal up to the names of their variables."""
    forth: Dict[Var, Var] = {}
    back: Dict[Var, Var] = {}
    stack = [(left, right)]
    steps = 0
    while stack:
        steps += 1
        if not steps & 1023:
            _check_steps(steps, left, right)
        left, right = stack.pop()
        left, right = deref(left), deref(right)
        if left.__class__ is not right.__class__:
            return False
        if left.__class__ is Var and right.__class__ is Var:
            if forth.setdefault(left, right) is not right or back.setdefault(right, left) is not left:
                return False
        elif left.__class__ is tuple and right.__class__ is tuple:
            if left[0] is not right[0]:
                return False
            stack.extend(zip(left[:0:-1], right[:0:-1]))
        elif compare(left, right):
            return False
    return True


def _check_steps(steps: int, left: Term, right: Term) -> None:
    look()
    if steps > MAX_STEPS:
        raise TermTooLarge
    if steps == LATE:
        refuse_cycles((MINUS, left, right))


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
