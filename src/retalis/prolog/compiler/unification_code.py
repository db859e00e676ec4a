"""Compilation of head unification and of term inspection (``arg/3``, ``functor/3``).

Code that unifies a local with a term known at compile time follows the WAM: for a compound pattern the generated code
has a write mode, which binds an unbound variable to a new term, and a read mode, which takes an existing term apart.
The first occurrence of a variable becomes a name for the argument; later occurrences are unified.

Patterns of several compounds with distinct variables, typical for events made from messages, are first unpacked in
one tuple assignment; only a term that does not fit takes the general code.
"""

from typing import List, Tuple

from ..terms.term_traversal import variables
from ..terms.types import Atom, CompoundTerm, String, Term, Var, deref, functor
from ..terms.unification import same_constant
from .clause_nodes import CallNode
from .code_scope import Scope, is_large

_MIN_UNPACKED_COMPOUNDS, _MAX_UNPACKED_COMPOUNDS = 3, 40
"""Number of compounds of a pattern that is unpacked as a whole; Python allows no more than 90 nested levels."""

_MAX_PATTERN_NESTING = 4
"""Nesting of patterns that are unified by generated code; deeper ones are left to `unify`."""


def match(scope: Scope, name: str, pattern: Term, depth: int = 0) -> None:
    """Write the unification of the value in local ``name`` with ``pattern``.

    Variables of the pattern that have no value become names for the corresponding part; others are unified.
    """
    pattern = deref(pattern)
    if pattern.__class__ is Var:
        known_name = scope.names.get(pattern)
        if known_name is None:
            scope.names[pattern] = name
        elif known_name != name:
            scope.may_bind = True
            scope.fresh.discard(pattern)
            _unify_locals(scope, known_name, name)
    elif pattern.__class__ is tuple and len(pattern) > 1:
        if not scope.unpacking_failed and _is_unpackable(scope, pattern):
            _unpack_whole(scope, name, pattern, depth)
        else:
            _unify_compound(scope, name, pattern, depth)
    else:
        _unify_constant(scope, name, pattern)


def _unify_locals(scope: Scope, bound: str, name: str) -> None:
    """Write the unification of two locals; one is most likely an unbound variable."""
    scope.write(f"if {bound} is not {name}:")
    scope.write(f"    if {name}.__class__ is Var and {name}.ref is None and {bound}.__class__ is not Var:")
    scope.write(f"        {name}.ref = {bound}")
    scope.write(f"        push({name})")
    scope.write(f"    elif {bound}.__class__ is Var and {bound}.ref is None and {name}.__class__ is not Var:")
    scope.write(f"        {bound}.ref = {name}")
    scope.write(f"        push({bound})")
    scope.write(f"    elif not unify({bound}, {name}, trail):")
    scope.write(f"        {scope.fail}")


def _unify_compound(scope: Scope, name: str, pattern: CompoundTerm, depth: int) -> None:
    if depth > _MAX_PATTERN_NESTING or is_large(pattern):
        _call_unify(scope, name, pattern)
    else:
        _write_both_modes(scope, name, pattern, depth)


def _is_unpackable(scope: Scope, pattern: Term) -> bool:
    """Return whether a pattern has several compounds and otherwise only atoms and distinct new variables."""
    # A repeated variable would need a unification, and numbers and strings are compared by value, not by identity.
    compounds = 0
    seen_variables = set()
    stack = [pattern]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple:
            compounds += 1
            stack.extend(item[1:])
        elif item.__class__ is Var:
            if item in scope.names or item in seen_variables:
                return False
            seen_variables.add(item)
        elif item.__class__ is not Atom:
            return False
    return _MIN_UNPACKED_COMPOUNDS <= compounds <= _MAX_UNPACKED_COMPOUNDS


def _unpack_whole(scope: Scope, name: str, pattern: CompoundTerm, depth: int) -> None:
    """Write the unpacking of a whole pattern in one statement, with the general code for terms that do not fit.

    Events made from messages are deep and ground, so that the statement fits them.
    """
    tests = []

    def target_of(term: Term) -> str:
        term = deref(term)
        if term.__class__ is Var:
            return "_" if scope.clause.is_void(term) else scope.clause.local(term)
        part = scope.temp("f")
        tests.append(f"{part} is {scope.unit.constant(term[0] if term.__class__ is tuple else term)}")
        if term.__class__ is not tuple:
            return part
        return f"({', '.join([part, *[target_of(item) for item in term[1:]]])},)"

    unpacked = target_of(pattern)
    is_general = scope.temp("q")
    # A variable or a lazy term within the term, or another arity, raises TypeError or ValueError; another functor or
    # atom fails the tests. In all these cases the general code decides.
    scope.write(f"{is_general} = True")
    scope.write(f"if {name}.__class__ is tuple and {name}[0] is {scope.unit.constant(pattern[0])}:")
    scope.write("    try:")
    scope.write(f"        {unpacked} = {name}")
    scope.write(f"        {is_general} = not ({' and '.join(tests[1:])})")
    scope.write("    except (TypeError, ValueError):")
    scope.write("        pass")
    scope.write(f"if {is_general}:")
    scope.depth += 1
    scope.unpacking_failed = True
    _unify_compound(scope, name, pattern, depth)
    scope.unpacking_failed = False
    scope.depth -= 1


def _call_unify(scope: Scope, name: str, pattern: Term) -> None:
    scope.may_bind = True
    scope.write(f"if not unify({name}, {scope.build(pattern)}, trail):")
    scope.write(f"    {scope.fail}")
    forget_fresh(scope, pattern)


def _unify_constant(scope: Scope, name: str, value: Term) -> None:
    scope.may_bind = True
    const = scope.unit.constant(value)
    if value.__class__ is Atom:
        scope.write(f"if {name} is not {const}:")
        scope.depth += 1
        scope.dereference(name)
        scope.write("if k is Var:")
        _write_binding(scope, name, const)
        # A lazy term may turn out to be an atom.
        scope.write(f"elif {name} is not {const} and (k is not Lazy or {name}.term() is not {const}):")
        scope.write(f"    {scope.fail}")
        scope.depth -= 1
        return
    scope.dereference(name)
    scope.write("if k is Var:")
    _write_binding(scope, name, const)
    scope.write(f"elif {differs(value, name, const)}:")
    scope.write(f"    {scope.fail}")


def differs(value: Term, name: str, const: str) -> str:
    """Return the condition that a dereferenced local (``k`` is its class) differs from a constant other than an atom.

    Floats need care: 0.0 and -0.0 are equal in Python and different terms, and nan equals itself as a term only.
    """
    value_class = value.__class__
    if value_class is int:
        return f"k is not int or {name} != {const}"
    if value_class is float and value and same_constant(value, value) and value == value:
        return f"k is not float or {name} != {const}"
    if value_class is String:
        return f"k is not String or {name}.text != {const}.text"
    return f"k is not {const}.__class__ or not same({name}, {const})"


def _write_binding(scope: Scope, name: str, value: str) -> None:
    scope.write(f"    {name}.ref = {value}")
    scope.write(f"    push({name})")


def _write_both_modes(scope: Scope, name: str, pattern: CompoundTerm, depth: int) -> None:
    """Write both modes: binding of an unbound variable to a new term, and taking a compound term apart."""
    scope.dereference(name)
    scope.write("if k is Var:")
    saved_scope = scope.snapshot()
    scope.depth += 1
    new_term = scope.build(pattern)
    scope.write(f"{name}.ref = {new_term}")
    scope.write(f"push({name})")
    scope.depth -= 1
    written_names = scope.names
    scope.restore(saved_scope)
    scope.write("else:")
    scope.depth += 1
    # A lazy term knows its functor without being decoded, so a mismatch costs nothing.
    scope.write("if k is not tuple:")
    scope.write(f"    if k is not Lazy or {name}.functor is not {scope.unit.constant(pattern[0])}:")
    scope.write(f"        {scope.fail}")
    scope.write(f"    {name} = {name}.term()")
    write_read_mode(scope, name, pattern, depth)
    # Variables that got a value in both modes must have the same name afterwards.
    for var, read_name in list(scope.names.items()):
        written_name = written_names.get(var)
        if written_name is not None and written_name != read_name:
            scope.write(f"{written_name} = {read_name}")
            scope.names[var] = written_name
    scope.depth -= 1
    scope.may_bind = True
    for var in set(written_names) - set(scope.names):
        scope.names[var] = written_names[var]
    forget_fresh(scope, pattern)


def write_read_mode(scope: Scope, name: str, pattern: CompoundTerm, depth: int, check: bool = True) -> None:
    """Write the read mode: ``name`` holds a compound term, whose functor is tested if ``check``."""
    if check:
        scope.write(f"if {name}[0] is not {scope.unit.constant(pattern[0])}:")
        scope.write(f"    {scope.fail}")
    targets = []
    pending: List[Tuple[str, Term]] = []
    for item in pattern[1:]:
        item = deref(item)
        if item.__class__ is Var:
            if scope.clause.is_void(item):
                targets.append("_")
                continue
            if item not in scope.names:
                # The canonical name, which the write mode uses as well.
                target = scope.clause.local(item)
                scope.names[item] = target
                targets.append(target)
                continue
        target = scope.temp("p")
        targets.append(target)
        pending.append((target, item))
    used = [(position, target) for position, target in enumerate(targets, 1) if target != "_"]
    # Unpacking is faster than indexing unless few of many parts are used.
    if len(used) == 1 or len(used) * 3 < len(targets):
        for position, target in used:
            scope.write(f"{target} = {name}[{position}]")
    elif used:
        scope.write(f"_, {', '.join(targets)} = {name}")
    # Cheap tests first, so that a mismatch is found early: constants, then known variables, then nested patterns.
    for target, item in sorted(pending, key=_match_cost):
        match(scope, target, item, depth + 1)


def _match_cost(entry: Tuple[str, Term]) -> int:
    item_class = entry[1].__class__
    return 2 if item_class is tuple else 1 if item_class is Var else 0


def forget_fresh(scope: Scope, term: Term) -> None:
    """Record that the variables of a term may be bound or shared from this point on."""
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is Var:
            scope.fresh.discard(item)
        elif item.__class__ is tuple:
            stack.extend(item[1:])


_NEW_TERM = functor("$blank", 3)


def decoded_local(scope: Scope, term: Term) -> str:
    """Return a local that holds a dereferenced and decoded term, after writing its assignment."""
    term = deref(term)
    if term.__class__ is not Var:
        name = scope.temp("p")
        scope.write(f"{name} = {scope.build(term)}")
        return name
    name = scope.local(term)
    if term not in scope.fresh:
        scope.dereference(name)
        scope.write("if k is Lazy:")
        scope.write(f"    {name} = {name}.term()")
    return name


def write_argument(scope: Scope, result: str, otherwise: str, number: Term, compound: Term) -> None:
    """Write the look-up of an argument of a compound term.

    Args:
        scope: the function.
        result: the local that receives the argument.
        otherwise: the built-in, which handles all other cases and raises the errors.
        number: position of the argument, from 1.
        compound: the compound term.
    """
    position, term = scope.build(number), decoded_local(scope, compound)
    tests = [f"{term}.__class__ is tuple", f"0 < {position} < len({term})"]
    if deref(number).__class__ is not int:
        tests.insert(1, f"{position}.__class__ is int")
    scope.write(f"if {' and '.join(tests)}:")
    scope.write(f"    {result} = {term}[{position}]")
    scope.write("else:")
    scope.write(f"    {result} = {otherwise}({position}, {term})")
    scope.write(f"    if {result} is None:")
    scope.write(f"        {scope.fail}")


def write_functor(scope: Scope, node: CallNode) -> None:
    """Write ``functor/3``: construction for a variable without a value, otherwise both modes."""
    compound, name, arity = (deref(arg) for arg in node.args)
    functional = scope.unit.database.predicate(_NEW_TERM).functional_modes
    assert functional is not None
    blank = scope.unit.constant(functional.function)
    if (
        compound.__class__ is Var
        and compound not in scope.names
        and compound not in variables((node.key, name, arity))
    ):
        new_term = scope.temp("p")
        scope.write(f"{new_term} = {blank}({scope.build(name)}, {scope.build(arity)})")
        match(scope, new_term, compound)
    else:
        term, name_local, arity_local = decoded_local(scope, compound), scope.temp("p"), scope.temp("p")
        # An unbound variable is bound to a new term first; then name and arity are read in either case.
        scope.write(f"if {term}.__class__ is Var:")
        scope.write(
            f"    {name_local} = {blank}({_argument_value(scope, name)}, {_argument_value(scope, arity)})"
        )
        scope.write(f"    {term}.ref = {name_local}")
        scope.write(f"    push({term})")
        scope.write(f"    {term} = {name_local}")
        scope.write(f"if {term}.__class__ is tuple:")
        scope.write(f"    {name_local}, {arity_local} = {term}[0].atom, len({term}) - 1")
        scope.write("else:")
        scope.write(f"    {name_local}, {arity_local} = {term}, 0")
        scope.may_bind = True
        match(scope, name_local, name)
        match(scope, arity_local, arity)
    for arg in node.args:
        forget_fresh(scope, arg)


def _argument_value(scope: Scope, term: Term) -> str:
    """Return an expression for an argument of ``functor/3``; a variable without a value stays without one.

    It gets its value from the unification with the name or arity that follows.
    """
    is_new = term.__class__ is Var and term not in scope.names
    return "Var()" if is_new else scope.build(term)
