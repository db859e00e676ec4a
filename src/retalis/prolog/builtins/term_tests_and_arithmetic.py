"""Predicates that unify, compare and test terms, check their types, and evaluate arithmetic.

Compiled clauses contain most of these tests inline; the predicates serve for calls of goals that are known only at
run time. ``must_be/2`` and ``is_of_type/2`` have the types and errors of SWI-Prolog's ``library(error)``.

``freeze/2``, ``dif/2`` and ``when/2`` are supported only if they can be decided immediately. Coroutining (suspended
goals that are resumed by the binding of a variable) is not supported, because every inlined unification would have to
check for suspended goals. A call that depends on an unbound variable raises an instantiation error.
"""

from typing import Any, Callable, Dict, List, Optional, Tuple

from ...foundation import codegen
from ...foundation.errors import TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits, with_limit_checks
from ..compiler.clause_nodes import COMPARISONS, ORDERS
from ..machine.arithmetic import evaluate, evaluate_exact, integer_root, without_instant
from ..machine.errors import (
    CONTEXT,
    PrologError,
    domain_error,
    error,
    evaluation_error,
    existence_error,
    indicator,
    instantiation_error,
    type_error,
    uninstantiation_error,
)
from ..terms.list_terms import list_items, list_parts
from ..terms.term_traversal import (
    CYCLE_CHECK_STEP,
    WALK_ROUNDS,
    check_steps,
    is_ground,
    require_acyclic,
    resolve,
    variables,
)
from ..terms.types import (
    COMMA,
    MINUS,
    NIL,
    Atom,
    CompoundTerm,
    Frame,
    Functor,
    String,
    Term,
    Values,
    Var,
    atom,
    deref,
    functor,
    functor_name,
)
from ..terms.unification import always_different, compare, compare_by_age, undo, unify
from .argument_checks import bound, integer, integer_or_var, items, natural
from .builtin_registry import ProgramMachine, control, deterministic
from .text_arguments import is_text_list

_ORDER_ATOMS = {-1: atom("<"), 0: atom("="), 1: atom(">")}


@deterministic("=/2")
def unify_terms(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Unify two terms."""
    return unify(left, right, machine.trail)


@deterministic("\\=/2")
def is_not_unifiable(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Test that two terms do not unify."""
    mark = len(machine.trail)
    unifies = unify(left, right, machine.trail)
    undo(machine.trail, mark)
    return not unifies


@deterministic("unify_with_occurs_check/2")
def unify_with_occurs_check(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Unify two terms, but fail if that would create a cyclic term."""
    trail = machine.trail
    mark = len(trail)
    # Unifies first and checks the new bindings afterwards: the check is only needed for variables that were bound.
    return unify(left, right, trail) and not any(
        _occurs_in_binding(var) for var in with_limit_checks(trail[mark:]) if var.__class__ is Var
    )


def _occurs_in_binding(var: Any) -> bool:
    """Return whether the binding of a variable contains the variable."""
    followed_vars = set()
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
            if item.ref is not None and item not in followed_vars:
                followed_vars.add(item)
                stack.append(item.ref)
        elif item.__class__ is tuple:
            stack.extend(item[1:])
    return False


@deterministic("compare/3")
def compare_terms(
    machine: ProgramMachine,
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


def _standard_order_test(test: str) -> Callable[[ProgramMachine, Term, Term], bool]:
    """Return a predicate that compares terms in the standard order; ``test`` is a condition such as "< 0"."""
    # For equality the age of variables is irrelevant, and `compare_by_age` assigns serial numbers to variables, which
    # costs memory.
    compare_variables = always_different if test in ("== 0", "!= 0") else compare_by_age
    lines = ["def generated(machine, left, right):", f"    return compare(left, right, variables) {test}"]
    names = {"compare": compare, "variables": compare_variables}
    predicate: Callable[[ProgramMachine, Term, Term], bool] = codegen.function(
        lines, names, f"comparison {test}"
    )
    return predicate


def _arithmetic_comparison(operator: str) -> Callable[[ProgramMachine, Term, Term], bool]:
    """Return a predicate that compares the values of two expressions."""
    lines = [
        "def generated(machine, left, right):",
        f"    return evaluate_exact(left) {operator} evaluate_exact(right)",
    ]
    names = {"evaluate_exact": evaluate_exact}
    predicate: Callable[[ProgramMachine, Term, Term], bool] = codegen.function(
        lines, names, f"comparison {operator}"
    )
    return predicate


for _key, _test in ORDERS.items():
    deterministic(str(_key))(_standard_order_test(_test))
for _key, _test in COMPARISONS.items():
    deterministic(str(_key))(_arithmetic_comparison(_test))


@deterministic("is/2")
def evaluate_is(machine: ProgramMachine, result: Term, expression: Term) -> bool:
    """Evaluate an expression."""
    value = evaluate_exact(expression)
    # For timestamps, `evaluate_exact` returns numbers that carry an exact instant, which a program must not see.
    if value.__class__ is not int and value.__class__ is not float:
        value = without_instant(value)
    return unify(result, value, machine.trail)


@deterministic("succ/2")
def succ(machine: ProgramMachine, smaller: Term, greater: Term) -> bool:
    """Relate a non-negative integer with its successor."""
    smaller = deref(smaller)
    if smaller.__class__ is Var:
        value = natural(greater)
        return value > 0 and unify(smaller, value - 1, machine.trail)
    value = natural(smaller)
    if deref(greater).__class__ is not Var:
        natural(greater)
    return unify(greater, value + 1, machine.trail)


@deterministic("plus/3")
def plus(machine: ProgramMachine, left: Term, right: Term, total: Term) -> bool:
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


@deterministic("nth_integer_root_and_remainder/4")
def nth_integer_root_and_remainder(
    machine: ProgramMachine, degree: Term, power: Term, root: Term, remainder: Term
) -> bool:
    """Compute the integer root of a degree, truncated toward zero, and the remainder of its power."""
    exponent, value = integer(degree), integer(power)
    if exponent < 1:
        raise domain_error("not_less_than_one", exponent)
    if value < 0 and exponent % 2 == 0:
        raise evaluation_error("undefined")
    magnitude = integer_root(exponent, abs(value))
    result = -magnitude if value < 0 else magnitude
    return machine.unify_all((root, result), (remainder, value - result**exponent))


def _type_test(*classes: type) -> Callable[[ProgramMachine, Term], bool]:
    """Return a predicate that tests whether the class of a term is one of some classes."""

    def test(machine: ProgramMachine, term: Term) -> bool:
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
def blob(machine: ProgramMachine, term: Term, blob_type: Term) -> bool:
    """Unify with the type of an atom, which is always ``text``."""
    return deref(term).__class__ is Atom and unify(blob_type, atom("text"), machine.trail)


@deterministic("is_list/1")
def is_list(machine: ProgramMachine, term: Term) -> bool:
    """Test for a proper list."""
    return list_parts(term)[1] is NIL


@deterministic("ground/1")
def ground(machine: ProgramMachine, term: Term) -> bool:
    """Test for a term without variables."""
    return is_ground(term)


def is_acyclic(term: Term) -> bool:
    """Return whether a term is not cyclic."""
    # `resolve` raises the error for cyclic terms.
    try:
        resolve(term)
    except TermTooLarge:
        return False
    return True


@deterministic("acyclic_term/1")
def acyclic_term(machine: ProgramMachine, term: Term) -> bool:
    """Test that a term is not cyclic."""
    return is_acyclic(term)


@deterministic("cyclic_term/1")
def cyclic_term(machine: ProgramMachine, term: Term) -> bool:
    """Test that a term is cyclic."""
    return not acyclic_term(machine, term)


@deterministic("?=/2")
def is_decided(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Test that the result of ``==`` cannot change by further bindings."""
    return compare(left, right, always_different) == 0 or is_not_unifiable(machine, left, right)


@deterministic("subsumes_term/2")
def subsumes_term(machine: ProgramMachine, general: Term, specific: Term) -> bool:
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
def is_variant_of(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Test that two terms are equal up to renaming of variables."""
    return is_variant(left, right)


@deterministic("\\=@=/2")
def is_not_variant(machine: ProgramMachine, left: Term, right: Term) -> bool:
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
    check_steps(steps)
    if steps == CYCLE_CHECK_STEP:
        require_acyclic((MINUS, left, right))


_NUMBER_CLASSES = (int, float)


_LIST_OF = functor("list", 1)
_TYPE_ERROR = functor("type_error", 2)

_ENCODINGS = frozenset(
    [
        "octet",
        "ascii",
        "iso_latin_1",
        "text",
        "utf8",
        "unicode_be",
        "unicode_le",
        "utf16be",
        "utf16le",
        "wchar_t",
    ]
)
_STANDARD_STREAMS = frozenset(("user_input", "user_output", "user_error"))

_TYPE_TESTS: Dict[str, Callable[[Term], bool]] = {
    "any": lambda term: True,
    "dict": lambda term: False,  # dicts are not supported
    "encoding": lambda term: term.__class__ is Atom and term.name in _ENCODINGS,
    "stream": lambda term: term.__class__ is Atom and term.name in _STANDARD_STREAMS,
    "acyclic": is_acyclic,
    "cyclic": lambda term: not is_acyclic(term),
    "var": lambda term: term.__class__ is Var,
    "nonvar": lambda term: term.__class__ is not Var,
    "ground": is_ground,
    "rational": lambda term: term.__class__ is int,
    "positive_integer": lambda term: term.__class__ is int and term > 0,
    "nonneg": lambda term: term.__class__ is int and term >= 0,
    "list_or_partial": lambda term: _is_partial_list(term),
    "list_or_partial_list": lambda term: _is_partial_list(term),
    "atom": lambda term: term.__class__ is Atom,
    "atomic": lambda term: term.__class__ in (Atom, String, int, float),
    "symbol": lambda term: term.__class__ is Atom,
    "callable": lambda term: term.__class__ in (Atom, tuple),
    "compound": lambda term: term.__class__ is tuple,
    "float": lambda term: term.__class__ is float,
    "integer": lambda term: term.__class__ is int,
    "number": lambda term: term.__class__ in _NUMBER_CLASSES,
    "string": lambda term: term.__class__ is String,
    "list": lambda term: list_items(term) is not None,
    "proper_list": lambda term: list_items(term) is not None,
    "boolean": lambda term: term.__class__ is Atom and term.name in ("true", "false"),
    "bool": lambda term: term.__class__ is Atom and term.name in ("true", "false"),
    "char": lambda term: term.__class__ is Atom and len(term.name) == 1,
    "code": lambda term: term.__class__ is int and 0 <= term <= 0x10FFFF,
    "pair": lambda term: term.__class__ is tuple and str(term[0]) == "-/2",
    "text": lambda term: term.__class__ in (Atom, String) or is_text_list(term),
    "chars": lambda term: _is_list_of(term, lambda item: item.__class__ is Atom and len(item.name) == 1),
    "codes": lambda term: _is_list_of(term, lambda item: item.__class__ is int and 0 <= item <= 0x10FFFF),
}


def _is_list_of(term: Term, test: Callable[[Term], bool]) -> bool:
    values = list_items(term)
    return values is not None and all(test(deref(item)) for item in with_limit_checks(values))


def _is_partial_list(term: Term) -> bool:
    _, tail = list_parts(term)
    return tail.__class__ is Var or tail is NIL


_ITEM_TYPES_OF_LISTS = {"chars": atom("char"), "codes": atom("code")}

_GROUND_TYPES = frozenset(("text", "string", "rational", "ground", "oneof"))
"""Types without variables: a term that contains some is an instantiation error, because it may still get the type."""


def has_type(type_term: Term, term: Term) -> Optional[bool]:
    """Return whether a dereferenced term has a type, or None for an unknown type.

    Raises:
        PrologError: if an argument of the type is invalid.
    """
    name = functor_name(type_term)
    if type_term.__class__ is tuple:
        return _has_compound_type(name, type_term, term)
    test = _TYPE_TESTS.get(name)
    return None if test is None else test(term)


def _has_compound_type(name: str, type_term: CompoundTerm, term: Term) -> Optional[bool]:
    if name == "oneof" and len(type_term) == 2:
        return is_ground(term) and any(
            not compare(item, term) for item in with_limit_checks(items(type_term[1]))
        )
    if name == "between" and len(type_term) == 3:
        low, high = deref(type_term[1]), deref(type_term[2])
        # Bounds that are integers require an integer, other bounds accept any number.
        if low.__class__ is int:
            return term.__class__ is int and low <= term <= integer(high)
        return term.__class__ in _NUMBER_CLASSES and evaluate(low) <= term <= evaluate(high)
    if name in ("list", "list_of") and len(type_term) == 2:
        values = list_items(term)
        return values is not None and all(
            has_type(deref(type_term[1]), deref(item)) for item in with_limit_checks(values)
        )
    return None


def find_type_error(type_term: Term, term: Term) -> Optional[PrologError]:
    """Return the error for a term that does not have a type, or None if it has the type."""
    type_term, term = deref(type_term), deref(term)
    if type_term.__class__ is Var:
        return instantiation_error()
    name = functor_name(type_term)
    # `chars` and `codes` are checked as lists of a type, so that the error names the wrong item.
    item_type = _ITEM_TYPES_OF_LISTS.get(name) if type_term.__class__ is Atom else None
    if item_type is not None:
        type_term = (_LIST_OF, item_type)
    result = has_type(type_term, term)
    if result:
        return None
    if result is None:
        return existence_error("type", type_term)
    if name in ("list", "list_of") or item_type is not None:
        return _list_error(type_term, term)
    if name == "var":
        return uninstantiation_error(term)
    if name in ("cyclic", "acyclic"):
        return domain_error(f"{name}_term", term)
    # An unbound part might still be bound to a value of the type.
    if term.__class__ is Var or (name in _GROUND_TYPES and not is_ground(term)):
        return instantiation_error()
    return type_error_of(type_term, term)


def _list_error(type_term: Term, term: Term) -> Optional[PrologError]:
    """Return the error for a term that is not a list, or for the first item of the wrong type."""
    values = list_items(term)
    if values is None or type_term.__class__ is not tuple:
        return instantiation_error() if _is_partial_list(term) else type_error_of(type_term, term)
    errors = (find_type_error(type_term[1], item) for item in with_limit_checks(values))
    return next((error for error in errors if error is not None), None)


def type_error_of(type_term: Term, term: Term) -> PrologError:
    """Return the type error for a type, which may be a compound term."""
    return error((_TYPE_ERROR, type_term, term))


@deterministic("must_be/2", is_protected=False)
def must_be(machine: ProgramMachine, type_term: Term, term: Term) -> bool:
    """Raise an error unless a term has a type."""
    problem = find_type_error(type_term, term)
    if problem is not None:
        raise problem
    return True


@deterministic("is_of_type/2", is_protected=False)
def is_of_type(machine: ProgramMachine, type_term: Term, term: Term) -> bool:
    """Test that a term has a type; fail for an unknown type."""
    type_term = bound(type_term)
    return bool(has_type(type_term, deref(term)))


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
def dif(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Test that two terms can never be equal; raise an error if they could become equal."""
    trail = machine.trail
    mark = len(trail)
    if not unify(left, right, trail):
        undo(trail, mark)
        return True
    # The terms unify. Without bindings they are equal; with some, later bindings may make them equal or different.
    is_undecided = len(trail) > mark
    undo(trail, mark)
    if is_undecided:
        raise _undecided_error(_DIF)
    return False


@control("freeze/2")
def freeze(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal if a term is bound; raise an error otherwise."""
    if deref(args[0]).__class__ is Var:
        raise _undecided_error(_FREEZE)
    return machine.logic.control.call(args[1], continuation)


@control("when/2")
def when(machine: ProgramMachine, args: Values, continuation: Frame) -> Optional[Frame]:
    """Call a goal if a condition holds; raise an error otherwise."""
    if not _is_when_condition_true(machine, args[0]):
        raise _undecided_error(_WHEN)
    return machine.logic.control.call(args[1], continuation)


def _is_when_condition_true(machine: ProgramMachine, condition: Term) -> bool:
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
            is_true = _is_simple_condition_true(machine, condition)
            while pending:
                key, right = pending.pop()
                # The left operand has not decided the connective, so the right one does.
                if is_true is (key is COMMA):
                    condition = right
                    break
            else:
                return is_true
        check_limits()
    raise TermTooLarge


def _is_simple_condition_true(machine: ProgramMachine, condition: Term) -> bool:
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
        return is_not_unifiable(machine, condition[1], condition[2]) or _unifies_without_binding(
            machine, *condition[1:]
        )
    raise domain_error("when_condition", condition)


def _unifies_without_binding(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Return whether two terms unify without a binding, which means that they are equal."""
    trail = machine.trail
    mark = len(trail)
    is_same = unify(left, right, trail) and len(trail) == mark
    undo(trail, mark)
    return is_same
