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

_FEWEST, _MOST = 3, 40
"""Least and greatest number of compounds of a pattern that is unpacked as a whole; Python allows 90 nested levels."""

_NESTING = 4
"""Nesting of patterns that are unified by generated code; deeper ones are left to `unify`."""


def match(scope: Scope, name: str, pattern: Term, depth: int = 0) -> None:
    """Write the unification of the value in local ``name`` with ``pattern``.

    Variables of the pattern that have no value become names for the corresponding part; others are unified.
    """
    pattern = deref(pattern)
    if pattern.__class__ is Var:
        known = scope.names.get(pattern)
        if known is None:
            scope.names[pattern] = name
        elif known != name:
            scope.binds = True
            scope.fresh.discard(pattern)
            _known(scope, known, name)
    elif pattern.__class__ is tuple and len(pattern) > 1:
        if not scope.at_one_go and _is_one_shape(scope, pattern):
            _at_one_go(scope, name, pattern, depth)
        else:
            _either_mode(scope, name, pattern, depth)
    else:
        _constant(scope, name, pattern)


def _known(scope: Scope, known: str, name: str) -> None:
    """Write the unification of two locals; one of them is most likely an unbound variable."""
    scope.line(f"if {known} is not {name}:")
    scope.line(f"    if {name}.__class__ is Var and {name}.ref is None and {known}.__class__ is not Var:")
    scope.line(f"        {name}.ref = {known}")
    scope.line(f"        push({name})")
    scope.line(f"    elif {known}.__class__ is Var and {known}.ref is None and {name}.__class__ is not Var:")
    scope.line(f"        {known}.ref = {name}")
    scope.line(f"        push({known})")
    scope.line(f"    elif not unify({known}, {name}, trail):")
    scope.line(f"        {scope.fail}")


def _either_mode(scope: Scope, name: str, pattern: CompoundTerm, depth: int) -> None:
    if depth > _NESTING or is_large(pattern):
        _general(scope, name, pattern)
    else:
        _compound(scope, name, pattern, depth)


def _is_one_shape(scope: Scope, pattern: Term) -> bool:
    """Return whether a pattern has several compounds and otherwise only atoms and distinct new variables."""
    compounds = 0
    seen = set()
    stack = [pattern]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is tuple:
            compounds += 1
            stack.extend(item[1:])
        elif item.__class__ is Var:
            if item in scope.names or item in seen:
                return False
            seen.add(item)
        elif item.__class__ is not Atom:
            return False
    return _FEWEST <= compounds <= _MOST


def _at_one_go(scope: Scope, name: str, pattern: CompoundTerm, depth: int) -> None:
    """Write the unpacking of a whole pattern in one statement, with the general code for terms that do not fit.

    Events made from messages are deep and ground, so that the statement fits them.
    """
    tests = []

    def target(term: Term) -> str:
        term = deref(term)
        if term.__class__ is Var:
            return "_" if scope.clause.is_void(term) else scope.clause.local(term)
        found = scope.temp("f")
        tests.append(f"{found} is {scope.unit.constant(term[0] if term.__class__ is tuple else term)}")
        if term.__class__ is not tuple:
            return found
        return f"({', '.join([found, *[target(item) for item in term[1:]]])},)"

    unpacked = target(pattern)
    slow = scope.temp("q")
    # A variable or a lazy term within the term, or another arity, raises TypeError or ValueError; another functor or
    # atom fails the tests. In all these cases the general code decides.
    scope.line(f"{slow} = True")
    scope.line(f"if {name}.__class__ is tuple and {name}[0] is {scope.unit.constant(pattern[0])}:")
    scope.line("    try:")
    scope.line(f"        {unpacked} = {name}")
    scope.line(f"        {slow} = not ({' and '.join(tests[1:])})")
    scope.line("    except (TypeError, ValueError):")
    scope.line("        pass")
    scope.line(f"if {slow}:")
    scope.depth += 1
    scope.at_one_go = True
    _either_mode(scope, name, pattern, depth)
    scope.at_one_go = False
    scope.depth -= 1


def _general(scope: Scope, name: str, pattern: Term) -> None:
    scope.binds = True
    scope.line(f"if not unify({name}, {scope.build(pattern)}, trail):")
    scope.line(f"    {scope.fail}")
    forget_fresh(scope, pattern)


def _constant(scope: Scope, name: str, value: Term) -> None:
    scope.binds = True
    const = scope.unit.constant(value)
    if value.__class__ is Atom:
        scope.line(f"if {name} is not {const}:")
        scope.depth += 1
        scope.dereference(name)
        scope.line("if k is Var:")
        _bind(scope, name, const)
        # A lazy term may turn out to be an atom.
        scope.line(f"elif {name} is not {const} and (k is not Lazy or {name}.term() is not {const}):")
        scope.line(f"    {scope.fail}")
        scope.depth -= 1
        return
    scope.dereference(name)
    scope.line("if k is Var:")
    _bind(scope, name, const)
    scope.line(f"elif {differs(value, name, const)}:")
    scope.line(f"    {scope.fail}")


def differs(value: Term, name: str, const: str) -> str:
    """Return the condition that a dereferenced local (``k`` is its class) differs from a constant other than an atom.

    Floats need care: 0.0 and -0.0 are equal in Python and different terms, and nan equals itself as a term only.
    """
    kind = value.__class__
    if kind is int:
        return f"k is not int or {name} != {const}"
    if kind is float and value and same_constant(value, value) and value == value:
        return f"k is not float or {name} != {const}"
    if kind is String:
        return f"k is not String or {name}.text != {const}.text"
    return f"k is not {const}.__class__ or not same({name}, {const})"


def _bind(scope: Scope, name: str, value: str) -> None:
    scope.line(f"    {name}.ref = {value}")
    scope.line(f"    push({name})")


def _compound(scope: Scope, name: str, pattern: CompoundTerm, depth: int) -> None:
    """Write both modes: binding of an unbound variable to a new term, and taking a compound term apart."""
    scope.dereference(name)
    scope.line("if k is Var:")
    before = scope.branch()
    scope.depth += 1
    built = scope.build(pattern)
    scope.line(f"{name}.ref = {built}")
    scope.line(f"push({name})")
    scope.depth -= 1
    created = scope.names
    scope.restore(before)
    scope.line("else:")
    scope.depth += 1
    # A lazy term knows its functor without being decoded, so a mismatch costs nothing.
    scope.line("if k is not tuple:")
    scope.line(f"    if k is not Lazy or {name}.functor is not {scope.unit.constant(pattern[0])}:")
    scope.line(f"        {scope.fail}")
    scope.line(f"    {name} = {name}.term()")
    take_apart(scope, name, pattern, depth)
    # Variables that got a value in both modes must have the same name afterwards.
    for var, here in list(scope.names.items()):
        other = created.get(var)
        if other is not None and other != here:
            scope.line(f"{other} = {here}")
            scope.names[var] = other
    scope.depth -= 1
    scope.binds = True
    for var in set(created) - set(scope.names):
        scope.names[var] = created[var]
    forget_fresh(scope, pattern)


def take_apart(scope: Scope, name: str, pattern: CompoundTerm, depth: int, check: bool = True) -> None:
    """Write the read mode: ``name`` holds a compound term, whose functor is tested if ``check``."""
    if check:
        scope.line(f"if {name}[0] is not {scope.unit.constant(pattern[0])}:")
        scope.line(f"    {scope.fail}")
    targets = []
    later: List[Tuple[str, Term]] = []
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
        later.append((target, item))
    used = [(at, target) for at, target in enumerate(targets, 1) if target != "_"]
    # Unpacking is faster than indexing unless few of many parts are used.
    if len(used) == 1 or len(used) * 3 < len(targets):
        for at, target in used:
            scope.line(f"{target} = {name}[{at}]")
    elif used:
        scope.line(f"_, {', '.join(targets)} = {name}")
    # Cheap tests first, so that a mismatch is found early: constants, then known variables, then nested patterns.
    for target, item in sorted(later, key=_cost):
        match(scope, target, item, depth + 1)


def _cost(entry: Tuple[str, Term]) -> int:
    kind = entry[1].__class__
    return 2 if kind is tuple else 1 if kind is Var else 0


def forget_fresh(scope: Scope, term: Term) -> None:
    """Record that the variables of a term may be bound or shared from this point on."""
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is Var:
            scope.fresh.discard(item)
        elif item.__class__ is tuple:
            stack.extend(item[1:])


_BLANK = functor("$blank", 3)


def dereferenced(scope: Scope, term: Term) -> str:
    """Return a local that holds a dereferenced and decoded term, after writing its assignment."""
    term = deref(term)
    if term.__class__ is not Var:
        name = scope.temp("p")
        scope.line(f"{name} = {scope.build(term)}")
        return name
    name = scope.local(term)
    if term not in scope.fresh:
        scope.dereference(name)
        scope.line("if k is Lazy:")
        scope.line(f"    {name} = {name}.term()")
    return name


def write_argument(scope: Scope, result: str, otherwise: str, number: Term, whole: Term) -> None:
    """Write the look-up of an argument of a compound term.

    Args:
        scope: the function.
        result: the local that receives the argument.
        otherwise: the built-in, which handles all other cases and raises the errors.
        number: position of the argument, from 1.
        whole: the compound term.
    """
    at, term = scope.build(number), dereferenced(scope, whole)
    tests = [f"{term}.__class__ is tuple", f"0 < {at} < len({term})"]
    if deref(number).__class__ is not int:
        tests.insert(1, f"{at}.__class__ is int")
    scope.line(f"if {' and '.join(tests)}:")
    scope.line(f"    {result} = {term}[{at}]")
    scope.line("else:")
    scope.line(f"    {result} = {otherwise}({at}, {term})")
    scope.line(f"    if {result} is None:")
    scope.line(f"        {scope.fail}")


def write_functor(scope: Scope, node: CallNode) -> None:
    """Write ``functor/3``: construction for a variable without a value, otherwise both modes."""
    whole, name, arity = (deref(arg) for arg in node.args)
    functional = scope.unit.database.predicate(_BLANK).functional
    assert functional is not None
    blank = scope.unit.constant(functional.function)
    if (
        whole.__class__ is Var
        and whole not in scope.names
        and whole not in variables((node.key, name, arity))
    ):
        made = scope.temp("p")
        scope.line(f"{made} = {blank}({scope.build(name)}, {scope.build(arity)})")
        match(scope, made, whole)
    else:
        term, named, size = dereferenced(scope, whole), scope.temp("p"), scope.temp("p")
        # An unbound variable is bound to a new term first; then name and arity are read in either case.
        scope.line(f"if {term}.__class__ is Var:")
        scope.line(f"    {named} = {blank}({_given(scope, name)}, {_given(scope, arity)})")
        scope.line(f"    {term}.ref = {named}")
        scope.line(f"    push({term})")
        scope.line(f"    {term} = {named}")
        scope.line(f"if {term}.__class__ is tuple:")
        scope.line(f"    {named}, {size} = {term}[0].atom, len({term}) - 1")
        scope.line("else:")
        scope.line(f"    {named}, {size} = {term}, 0")
        scope.binds = True
        match(scope, named, name)
        match(scope, size, arity)
    for arg in node.args:
        forget_fresh(scope, arg)


def _given(scope: Scope, term: Term) -> str:
    """Return an expression for an argument of ``functor/3``; a variable without a value stays without one.

    It gets its value from the unification with the name or arity that follows.
    """
    new = term.__class__ is Var and term not in scope.names
    return "Var()" if new else scope.build(term)
