"""Code that unifies a local with a term that is known when the clause is compiled.

Code that looks into compound terms: arguments by number, names and arities.
"""

from typing import List, Tuple

from ..terms.term_traversal import variables
from ..terms.types import Atom, CompoundTerm, String, Term, Var, deref, functor
from ..terms.unification import same_constant
from .clause_nodes import CallNode
from .code_scope import Scope, is_large

_FEWEST, _MOST = 3, 40
"""How many compounds a pattern may have that is unpacked at one go; deeper than 90 levels Python takes none."""

_NESTING = 4
"""Patterns nested deeper than this are unified by the general routine."""


def match(scope: Scope, name: str, pattern: Term, depth: int = 0) -> None:
    """Write the unification of the value in local ``name`` with ``pattern``.

    New variables of the pattern become names for what they stand for; others are bound as needed.
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
    """Write the unification of two locals, of which one is most likely an unbound variable."""
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
    """Tell whether a pattern is of several compounds, in which there are but atoms and variables new and single."""
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
    """Write the unpacking of a whole pattern in one statement; what it does not fit is looked at part by part.

    That is how messages come: deep, and without a variable anywhere.
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
    """Return the test that a dereferenced local (``k`` its class) is not a constant that is not an atom."""
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
    """Write both modes: binding an unbound variable to a new term, taking a compound term apart."""
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
    scope.line("if k is not tuple:")
    scope.line(f"    if k is not Lazy or {name}.functor is not {scope.unit.constant(pattern[0])}:")
    scope.line(f"        {scope.fail}")
    scope.line(f"    {name} = {name}.term()")
    take_apart(scope, name, pattern, depth)
    # Variables that came up in both modes have to go by the same name afterwards.
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
    """Write the read mode: ``name`` holds a compound term (of the right functor unless ``check``)."""
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
                # Canonical names: the write mode gives the variable the same one.
                target = scope.clause.local(item)
                scope.names[item] = target
                targets.append(target)
                continue
        target = scope.temp("p")
        targets.append(target)
        later.append((target, item))
    used = [(at, target) for at, target in enumerate(targets, 1) if target != "_"]
    if len(used) == 1 or len(used) * 3 < len(targets):
        for at, target in used:
            scope.line(f"{target} = {name}[{at}]")
    elif used:
        scope.line(f"_, {', '.join(targets)} = {name}")
    # Cheap tests first: constants, then known variables, then nested patterns.
    for target, item in sorted(later, key=_cost):
        match(scope, target, item, depth + 1)


def _cost(entry: Tuple[str, Term]) -> int:
    kind = entry[1].__class__
    return 2 if kind is tuple else 1 if kind is Var else 0


def forget_fresh(scope: Scope, term: Term) -> None:
    """Note that the variables of a term may be bound or shared from here on."""
    stack = [term]
    while stack:
        item = deref(stack.pop())
        if item.__class__ is Var:
            scope.fresh.discard(item)
        elif item.__class__ is tuple:
            stack.extend(item[1:])


_BLANK = functor("$blank", 3)


def dereferenced(scope: Scope, term: Term) -> str:
    """Return a local that holds a term, dereferenced and made."""
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
    """Write the look-up of an argument; what is not a compound term and an integer is left to the built-in."""
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
    """Write ``functor/3``; a term that is new is made, of others name and arity are looked up."""
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
    """Return an expression for what a variable was given; one that is new stays so."""
    new = term.__class__ is Var and term not in scope.names
    return "Var()" if new else scope.build(term)
