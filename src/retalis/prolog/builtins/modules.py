"""Modules as predicates: their declaration, what arguments are goals, and names in front of goals."""

from typing import List

from ..database import declared_kinds, indicated
from ..machine import instantiation_error, type_error
from ..terms import COLON, SLASH, Functor, Term, Var, atom, deref, functor, unify
from .arguments import atom_of, items
from .clauses import declared
from .program import Machine, Solutions
from .registry import deterministic, nondeterministic
from .state import op

_USER = atom("user")
_OP, _GRAMMAR_NAME = functor("op", 3), functor("//", 2)


@deterministic("module/2")
def module(machine: Machine, name: Term, exports: Term) -> bool:
    """Begin a module: its other predicates get names of their own for the rest of the file."""
    keys: List[Functor] = []
    wrong: List[Term] = []
    for item in items(exports):
        one = deref(item)
        if isinstance(one, tuple) and one[0] is _OP:
            op(machine, one[1], one[2], one[3])
            continue
        key = indicated(one) if isinstance(one, tuple) and one[0] in (SLASH, _GRAMMAR_NAME) else None
        if key is None:
            wrong.append(one)
        else:
            keys.append(key)
    if not machine.logic.database.modules.begin(atom_of(name).name, keys):
        machine.logic.message(
            "warning", "Warning: a file of event rules is no module: what it defines has its plain names\n"
        )
    if wrong:  # it is one all the same
        raise (
            instantiation_error()
            if wrong[0].__class__ is Var
            else type_error("predicate_indicator", wrong[0])
        )
    return True


@deterministic("module/3")
def module_of_dialect(machine: Machine, name: Term, exports: Term, _: Term) -> bool:
    """Begin a module of another Prolog."""
    return module(machine, name, exports)


@deterministic("meta_predicate/1")
def meta_predicate(machine: Machine, heads: Term) -> bool:
    """Declare which arguments are goals: those of a module mean its own predicates there."""
    modules = machine.logic.database.modules
    for item in declared(modules.names_of(heads)):
        if item.__class__ is Var:
            raise instantiation_error()
        if item.__class__ is tuple:
            modules.metas[item[0]] = declared_kinds(tuple(map(deref, item[1:])))
    return True


@deterministic("strip_module/3")
def strip_module(machine: Machine, term: Term, name: Term, plain: Term) -> bool:
    """Take a term apart into its module and the rest."""
    found: Term = _USER
    rest = deref(term)
    while rest.__class__ is tuple and rest[0] is COLON and deref(rest[1]).__class__ is not Var:
        found, rest = deref(rest[1]), deref(rest[2])
    return unify(name, found, machine.trail) and unify(plain, rest, machine.trail)


@nondeterministic("current_module/1")
def current_module(machine: Machine, name: Term) -> Solutions:
    """Enumerate the modules."""
    for one in ["user", *machine.logic.database.modules.table]:
        if machine.unify(name, atom(one)):
            yield None
