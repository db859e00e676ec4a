"""Predicates for unification, comparison, arithmetic, and tests of terms.

Compiled clauses contain most of these tests inline; the predicates serve for calls of goals that are known only at
run time.

``freeze/2``, ``dif/2`` and ``when/2`` are supported only if they can be decided immediately. Coroutining (suspended
goals that are resumed by the binding of a variable) is not supported, because every inlined unification would have to
check for suspended goals. A call that depends on an unbound variable raises an instantiation error.
"""

from typing import Any, Callable, Dict, List, Optional, Tuple

from ...foundation import codegen
from ...foundation.cancellation import STEPS_PER_ROUND, check_limits, with_limit_checks
from ...foundation.errors import TermTooLarge
from ..compiler.clause_nodes import COMPARISONS, ORDERS
from ..machine.arithmetic import evaluate_exact, without_instant
from ..machine.errors import (
    CONTEXT,
    PrologError,
    domain_error,
    error,
    indicator,
    instantiation_error,
    type_error,
)
from ..machine.machine import Machine
from ..terms.list_terms import list_parts, make_list
from ..terms.term_traversal import (
    CYCLE_CHECK_STEP,
    MAX_STEPS,
    WALK_ROUNDS,
    is_ground,
    require_acyclic,
    variables,
)
from ..terms.types import (
    COMMA,
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
from ..terms.unification import always_different, compare, compare_by_age, undo, unify
from .argument_checks import integer, integer_or_var, is_iso, natural, partial_items
from .builtin_registry import control, deterministic

_ORDER_ATOMS = {-1: atom("<"), 0: atom("="), 1: atom(">")}


@deterministic("=/2")
def unify_terms(machine: Machine, left: Term, right: Term) -> bool:
    """Unify two terms."""
    return unify(left, right, machine.trail)


@deterministic("\\=/2")
def is_not_unifiable(machine: Machine, left: Term, right: Term) -> bool:
    """Test that two terms do not unify."""
    mark = len(machine.trail)
    unifies = unify(left, right, machine.trail)
    undo(machine.trail, mark)
    return not unifies


@deterministic("unify_with_occurs_check/2")
def unify_with_occurs_check(machine: Machine, left: Term, right: Term) -> bool:
    """Unify two terms, but fail if that would create a cyclic term."""
    trail = machine.trail
    mark = len(trail)
    # Unifies first and checks the new bindings afterwards: the check is only needed for variables that were bound.
    return unify(left, right, trail) and not any(
        _is_cyclic(var) for var in with_limit_checks(trail[mark:]) if var.__class__ is Var
    )


def _is_cyclic(var: Any) -> bool:
    """Return whether the binding of a variable contains the variable."""
    seen = set()
    stack = [var.ref]
    steps = 0
    while stack:
        steps += 1
        if not steps & 1023:
            check_limits()
        item = stack.pop()
        if item is var:
            return True
        if item.__class__ is Var:
            # A variable that occurs many times is followed once.
            if item.ref is not None and item not in seen:
                seen.add(item)
                stack.append(item.ref)
        elif item.__class__ is tuple:
            stack.extend(item[1:])
    return False


@deterministic("compare/3")
def compare_terms(
    machine: Machine,
    order: Term,
    left: Term,
    right: Term,
    compare_variables: Callable[[Var, Var], int] = compare_by_age,
) -> bool:
    """Compare two terms in the standard order."""
    order = deref(order)
    # A given order is checked before the comparison, so an invalid one is always an error.
    if order.__class__ is not Var:
        if order.__class__ is not Atom:
            raise type_error("atom", order)
        if order not in _ORDER_ATOMS.values():
            raise domain_error("order", order)
    return unify(order, _ORDER_ATOMS[compare(left, right, compare_variables)], machine.trail)


def _standard_order_test(test: str) -> Callable[[Machine, Term, Term], bool]:
    """Return a predicate that compares terms in the standard order."""
    # For equality the age of variables is irrelevant, and `compare_by_age` assigns serial numbers to variables, which
    # costs memory.
    compare_variables = always_different if test in ("== 0", "!= 0") else compare_by_age
    lines = ["def generated(machine, left, right):", f"    return compare(left, right, variables) {test}"]
    names = {"compare": compare, "variables": compare_variables}
    predicate: Callable[[Machine, Term, Term], bool] = codegen.function(lines, names, f"comparison {test}")
    return predicate


def _arithmetic_comparison(operator: str) -> Callable[[Machine, Term, Term], bool]:
    """Return a predicate that compares the values of two expressions."""
    lines = [
        "def generated(machine, left, right):",
        f"    return evaluate_exact(left) {operator} evaluate_exact(right)",
    ]
    names = {"evaluate_exact": evaluate_exact}
    predicate: Callable[[Machine, Term, Term], bool] = codegen.function(
        lines, names, f"comparison {operator}"
    )
    return predicate


for _key, _test in ORDERS.items():
    deterministic(str(_key))(_standard_order_test(_test))
for _key, _test in COMPARISONS.items():
    deterministic(str(_key))(_arithmetic_comparison(_test))


@deterministic("is/2")
def evaluate_is(machine: Machine, result: Term, expression: Term) -> bool:
    """Evaluate an expression."""
    value = evaluate_exact(expression)
    # For timestamps, `evaluate_exact` returns numbers that carry an exact instant, which a program must not see.
    if value.__class__ is not int and value.__class__ is not float:
        value = without_instant(value)
    return unify(result, value, machine.trail)


@deterministic("succ/2")
def succ(machine: Machine, smaller: Term, greater: Term) -> bool:
    """Relate a non-negative integer with its successor."""
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
    # All arguments are checked first, so that a wrong type is reported even if another one is unbound.
    for operand in (left, right, total):
        integer_or_var(operand)
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
def blob(machine: Machine, term: Term, blob_type: Term) -> bool:
    """Unify with the type of an atom, which is always ``text``."""
    return deref(term).__class__ is Atom and unify(blob_type, atom("text"), machine.trail)


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
    """Unify with the variables of a term, in the order of their first occurrence."""
    if is_iso(machine):
        partial_items(result)
    return unify(result, make_list(variables(term)), machine.trail)


@deterministic("?=/2")
def is_decided(machine: Machine, left: Term, right: Term) -> bool:
    """Test that the result of ``==`` cannot change by further bindings."""
    return compare(left, right, always_different) == 0 or is_not_unifiable(machine, left, right)


@deterministic("subsumes_term/2")
def subsumes_term(machine: Machine, general: Term, specific: Term) -> bool:
    """Test that two terms unify without binding variables of the second one."""
    trail = machine.trail
    mark = len(trail)
    specific_variables = variables(specific)
    subsumes = unify(general, specific, trail)
    if subsumes:
        remaining_variables = [deref(var) for var in with_limit_checks(specific_variables)]
        # A variable of the specific term may be renamed, but neither bound to a term nor to another one of them.
        subsumes = all(var.__class__ is Var for var in remaining_variables) and len(
            set(remaining_variables)
        ) == len(specific_variables)
    undo(trail, mark)
    return subsumes


@deterministic("=@=/2")
def is_variant_of(machine: Machine, left: Term, right: Term) -> bool:
    """Test that two terms are equal up to renaming of variables."""
    return is_variant(left, right)


@deterministic("\\=@=/2")
def is_not_variant(machine: Machine, left: Term, right: Term) -> bool:
    """Test that two terms are not variants."""
    return not is_variant(left, right)


def is_variant(left: Term, right: Term) -> bool:
    """Return whether two terms are equal up to renaming of variables."""
    # The renaming has to be a bijection, so it is recorded in both directions.
    renaming: Dict[Var, Var] = {}
    inverse: Dict[Var, Var] = {}
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
            if renaming.setdefault(left, right) is not right or inverse.setdefault(right, left) is not left:
                return False
        elif left.__class__ is tuple and right.__class__ is tuple:
            if left[0] is not right[0]:
                return False
            stack.extend(zip(left[:0:-1], right[:0:-1]))
        elif compare(left, right):
            return False
    return True


def _check_steps(steps: int, left: Term, right: Term) -> None:
    """Check the limits of the goal, and raise `TermTooLarge` for cyclic or too large terms."""
    check_limits()
    if steps > MAX_STEPS:
        raise TermTooLarge
    if steps == CYCLE_CHECK_STEP:
        require_acyclic((MINUS, left, right))


_DIF, _FREEZE, _WHEN = functor("dif", 2), functor("freeze", 2), functor("when", 2)
_SEMICOLON = functor(";", 2)
_NONVAR = functor("nonvar", 1)
_GROUND = functor("ground", 1)
_DECIDED = functor("?=", 2)


def _undecided_error(key: Functor) -> PrologError:
    """Return the error for a call that depends on an unbound variable, with a hint to SWI-Prolog."""
    reason = "goals cannot wait for a variable to be bound: load them with use_swi/1, see docs/how-to/swi-prolog.md"
    return error(atom("instantiation_error"), (CONTEXT, indicator(key), atom(reason)))


@deterministic("dif/2")
def dif(machine: Machine, left: Term, right: Term) -> bool:
    """Test that two terms can never be equal; raise an error if they could become equal."""
    trail = machine.trail
    mark = len(trail)
    if not unify(left, right, trail):
        undo(trail, mark)
        return True
    # The terms unify. Without bindings they are equal; with some, later bindings may make them equal or different.
    undecided = len(trail) > mark
    undo(trail, mark)
    if undecided:
        raise _undecided_error(_DIF)
    return False


@control("freeze/2")
def freeze(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal if a term is bound; raise an error otherwise."""
    if deref(args[0]).__class__ is Var:
        raise _undecided_error(_FREEZE)
    return machine.logic.control.call(args[1], continuation)


@control("when/2")
def when(machine: Machine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal if a condition holds; raise an error otherwise."""
    if not _holds(machine, args[0]):
        raise _undecided_error(_WHEN)
    return machine.logic.control.call(args[1], continuation)


def _holds(machine: Machine, condition: Term) -> bool:
    """Return whether a condition of ``when/2`` holds, without recursion into nested conditions."""
    # Connective and right operand of the conjunctions and disjunctions whose left operand is being evaluated.
    pending: List[Tuple[Functor, Term]] = []
    for _ in WALK_ROUNDS:
        for _ in STEPS_PER_ROUND:
            condition = deref(condition)
            if condition.__class__ is tuple and condition[0] in (COMMA, _SEMICOLON):
                pending.append((condition[0], condition[2]))
                condition = condition[1]
                continue
            holds = _simple_condition_holds(machine, condition)
            while pending:
                key, right = pending.pop()
                # The left operand has not decided the connective, so the right one does.
                if holds is (key is COMMA):
                    condition = right
                    break
            else:
                return holds
        check_limits()
    raise TermTooLarge


def _simple_condition_holds(machine: Machine, condition: Term) -> bool:
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
        return is_not_unifiable(machine, condition[1], condition[2]) or _is_identical(machine, *condition[1:])
    raise domain_error("when_condition", condition)


def _is_identical(machine: Machine, left: Term, right: Term) -> bool:
    trail = machine.trail
    mark = len(trail)
    # Equal if they unify without binding a variable.
    is_same = unify(left, right, trail) and len(trail) == mark
    undo(trail, mark)
    return is_same
