"""Code that looks into compound terms: arguments by number, names and arities."""

from ..terms import Term, Var, deref, functor, variables
from .nodes import CallNode
from .scope import Scope
from .unification import forget_fresh, match

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
