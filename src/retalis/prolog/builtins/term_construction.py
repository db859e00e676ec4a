"""Terms taken apart and put together: functor, arg, univ, copies.

Variables given names, terms given numbers: numbervars, hashes, generated symbols.
"""

from typing import Dict, Optional, Sequence
from zlib import crc32

from ...foundation.cancellation import BULK, look, watched
from ..machine.arithmetic import evaluate
from ..machine.errors import domain_error, instantiation_error, permission_error, resource_error, type_error
from ..machine.machine import LAST
from ..terms.list_terms import make_list
from ..terms.term_traversal import copy, is_ground, resolve, variables
from ..terms.types import NIL, Atom, CompoundTerm, Term, Var, atom, deref, functor
from ..terms.unification import unify
from .argument_checks import atom_of, check_tail, integer, is_iso, items, natural, partial_items
from .builtin_registry import Machine, Outcome, Solutions, deterministic, function, nondeterministic
from .text_arguments import atomic_text, no_compound
from .type_checks import is_acyclic

_MAX_ARGUMENTS = 1_000_000

_ARGUMENT = 64
"""Bytes of an argument that is a new variable."""


@deterministic("functor/3")
def functor_of(machine: Machine, term: Term, name: Term, arity: Term) -> bool:
    """Relate a term with its name and arity."""
    term = deref(term)
    trail = machine.trail
    if term.__class__ is tuple:
        return unify(name, term[0].atom, trail) and unify(arity, len(term) - 1, trail)
    if term.__class__ is not Var:
        return unify(name, term, trail) and unify(arity, 0, trail)
    return unify(term, blank(name, arity), trail)


@function("$blank/3")
def blank(name: Term, arity: Term) -> Term:
    """Return a term of a name and an arity with new variables; compiled clauses call it for ``functor/3``."""
    name, arity = deref(name), deref(arity)
    if name.__class__ is Var:
        raise instantiation_error()
    count = integer(arity)
    if count == 0:
        if name.__class__ is tuple:
            raise type_error("atomic", name)
        return name
    if count < 0:
        raise domain_error("not_less_than_zero", count)
    if name.__class__ is tuple:
        raise type_error("atomic", name)
    if name.__class__ is not Atom:
        raise type_error("atom", name)
    return _term(name, [Var() for _ in range(_arity(count))])


def _arity(count: int) -> int:
    """Return a number of arguments that a term may have; look at the limits before many are made."""
    if count > _MAX_ARGUMENTS:
        raise resource_error("memory")
    if count > len(BULK):
        look(count, _ARGUMENT * count)
    return count


def _term(name: Atom, args: Sequence[Term]) -> Term:
    return (functor(name.name, _arity(len(args))), *args)


@nondeterministic("arg/3")
def arg(machine: Machine, number: Term, term: Term, value: Term) -> Outcome:
    """Relate a compound term with its arguments."""
    number, term = deref(number), deref(term)
    if term.__class__ is not tuple:
        if term.__class__ is Var:
            raise instantiation_error()
        raise type_error("compound", term)
    if number.__class__ is Var:
        return _arguments(machine, number, term, value)
    at = natural(number)
    return 0 < at < len(term) and unify(value, term[at], machine.trail)


def _arguments(machine: Machine, number: Term, term: CompoundTerm, value: Term) -> Solutions:
    last = len(term) - 1
    for at in range(1, len(term)):
        if machine.unify_all((number, at), (value, term[at])):
            yield LAST if at == last else None


@function("$arg/3")
def known_arg(number: Term, term: Term) -> Optional[Term]:
    """Return what ``arg/3`` finds for a number that is known; compiled clauses look plain cases up themselves."""
    term = deref(term)
    if term.__class__ is not tuple:
        if term.__class__ is Var:
            raise instantiation_error()
        raise type_error("compound", term)
    at = natural(number)
    return term[at] if 0 < at < len(term) else None


@deterministic("=../2")
def univ(machine: Machine, term: Term, parts: Term) -> bool:
    """Relate a term with the list of its name and arguments."""
    term = deref(term)
    if term.__class__ is not Var and is_iso(machine):
        partial_items(parts)
    if term.__class__ is tuple:
        check_tail(parts)
        return unify(parts, make_list([term[0].atom, *term[1:]]), machine.trail)
    if term.__class__ is not Var:
        if deref(parts).__class__ not in (Var, tuple):
            check_tail(parts)
        return unify(parts, make_list([term]), machine.trail)
    return unify(term, _of_parts(parts), machine.trail)


def _of_parts(parts: Term) -> Term:
    """Return the term of a list of name and arguments."""
    found = partial_items(parts)
    if not found:
        if deref(parts) is NIL:
            raise domain_error("non_empty_list", NIL)
        raise instantiation_error()
    head, args = deref(found[0]), items(parts)[1:]
    if head.__class__ is Var:
        raise instantiation_error()
    if not args:
        if head.__class__ is tuple:
            raise type_error("atomic", head)
        return head
    if head.__class__ is not Atom:
        raise type_error("atom", head)
    return _term(head, args)


@deterministic("copy_term/2", "duplicate_term/2", "copy_term_nat/2")
def copy_term(machine: Machine, term: Term, result: Term) -> bool:
    """Copy a term with new variables."""
    return unify(result, copy(term), machine.trail)


@deterministic("compound_name_arity/3")
def compound_name_arity(machine: Machine, term: Term, name: Term, arity: Term) -> bool:
    """Relate a compound term, also one without arguments, with its name and arity."""
    term = deref(term)
    if term.__class__ is tuple:
        return machine.unify_all((name, term[0].atom), (arity, len(term) - 1))
    if term.__class__ is not Var:
        raise type_error("compound", term)
    name = deref(name)
    if name.__class__ is Var or deref(arity).__class__ is Var:
        raise instantiation_error()
    if name.__class__ is not Atom:
        raise type_error("atom", name)
    count = natural(arity)
    return unify(term, _term(name, [Var() for _ in range(_arity(count))]), machine.trail)


@deterministic("compound_name_arguments/3")
def compound_name_arguments(machine: Machine, term: Term, name: Term, arguments: Term) -> bool:
    """Relate a compound term with its name and list of arguments."""
    term = deref(term)
    if term.__class__ is tuple:
        if not unify(name, term[0].atom, machine.trail):
            return False
        check_tail(arguments)
        return unify(arguments, make_list(term[1:]), machine.trail)
    if term.__class__ is not Var:
        raise type_error("compound", term)
    name = deref(name)
    if name.__class__ is Var:
        raise instantiation_error()
    if name.__class__ is not Atom:
        raise type_error("atom", name)
    found = items(arguments)
    return unify(term, _term(name, found), machine.trail)


@deterministic("setarg/3", "nb_setarg/3")
def setarg(machine: Machine, number: Term, term: Term, value: Term) -> bool:
    """Refuse: terms do not change here."""
    raise permission_error("modify", "term", resolve(term))


_NUMBERED = functor("$VAR", 1)


@deterministic("numbervars/3")
def numbervars(machine: Machine, term: Term, start: Term, end: Term) -> bool:
    """Bind the variables of a term to ``'$VAR'(N)`` with rising numbers."""
    number = integer(start)
    for var in watched(variables(term)):
        unify(var, (_NUMBERED, number), machine.trail)
        number += 1
    return unify(end, number, machine.trail)


@deterministic("numbervars/1")
def numbervars_from_zero(machine: Machine, term: Term) -> bool:
    """Bind the variables of a term to ``'$VAR'(N)``, from 0."""
    return numbervars(machine, term, 0, Var())


@deterministic("term_variables/3")
def term_variables(machine: Machine, term: Term, found: Term, tail: Term) -> bool:
    """Give the variables of a term with a tail after them."""
    return unify(found, make_list(variables(term), tail), machine.trail)


@deterministic("acyclic_term/1")
def acyclic_term(machine: Machine, term: Term) -> bool:
    """Test that a term does not contain itself."""
    return is_acyclic(term)


@deterministic("cyclic_term/1")
def cyclic_term(machine: Machine, term: Term) -> bool:
    """Test that a term contains itself."""
    return not acyclic_term(machine, term)


@deterministic("term_hash/2")
def term_hash(machine: Machine, term: Term, value: Term) -> bool:
    """Give a number for a ground term, the same in every run; leave it open for others."""
    if not is_ground(term):
        return True
    return unify(value, crc32(machine.logic.show(term).encode()) & 0xFFFFFF, machine.trail)


def _counters(machine: Machine) -> Dict[str, int]:
    found: Dict[str, int] = machine.logic.state.setdefault("gensym", {})
    return found


@deterministic("gensym/2")
def gensym(machine: Machine, base: Term, result: Term) -> bool:
    """Give a new atom: the base and a number."""
    name = atomic_text(base)
    no_compound(result, "atomic")
    counters = _counters(machine)
    counters[name] = counters.get(name, 0) + 1
    return unify(result, atom(f"{name}{counters[name]}"), machine.trail)


@deterministic("reset_gensym/1")
def reset_gensym(machine: Machine, base: Term) -> bool:
    """Start again with the numbers of a base."""
    _counters(machine).pop(atomic_text(base), None)
    return True


@deterministic("reset_gensym/0")
def reset_all_gensym(machine: Machine) -> bool:
    """Start again with all numbers."""
    _counters(machine).clear()
    return True


@deterministic("flag/3")
def flag(machine: Machine, name: Term, old: Term, new: Term) -> bool:
    """Give a counter's value and set it to the value of an expression."""
    values = machine.logic.state.setdefault("flag", {})
    key = atomic_text(name)
    if not unify(old, values.get(key, 0), machine.trail):
        return False
    values[key] = evaluate(new)
    return True


@nondeterministic("nb_current/2")
def nb_current(machine: Machine, name: Term, value: Term) -> Solutions:
    """Enumerate global variables."""
    values = machine.logic.globals
    given = deref(name)
    if given.__class__ is not Var:
        key = atom_of(given).name
        if key in values and machine.unify(value, values[key]):
            yield LAST
        return
    for key, known in list(values.items()):
        if machine.unify_all((given, atom(key)), (value, known)):
            yield None
