"""Predicates that analyse and construct terms: ``functor/3``, ``arg/3``, ``=../2``, ``numbervars/3`` and others.

Terms are immutable, so ``setarg/3`` raises an error. The number of arguments of a new term is limited and charged to
the goal's limits before the arguments are created. The module also has generated symbols and counters (``gensym/2``,
``flag/3``).
"""

from typing import Dict, Optional, Sequence
from zlib import crc32

from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits, with_limit_checks
from ..machine.arithmetic import evaluate
from ..machine.errors import (
    domain_error,
    instantiation_error,
    instantiation_or_type_error,
    permission_error,
    resource_error,
    type_error,
)
from ..machine.machine import LAST
from ..terms.list_terms import make_list
from ..terms.term_traversal import copy, is_ground, resolve, variables
from ..terms.types import NIL, Atom, CompoundTerm, Term, Var, atom, deref, functor
from ..terms.unification import unify
from .argument_checks import atom_of, bound, check_tail, integer, is_iso, items, natural, partial_items
from .builtin_registry import Outcome, ProgramMachine, Solutions, deterministic, function, nondeterministic
from .text_arguments import atomic_text, require_no_compound

_MAX_ARGUMENTS = 1_000_000
"""Maximum arity of a new term."""

_ARGUMENT_BYTES = 64
"""Approximate size of an argument that is a new variable."""


@deterministic("functor/3")
def functor_of(machine: ProgramMachine, term: Term, name: Term, arity: Term) -> bool:
    """Relate a term with its name and arity."""
    term = deref(term)
    trail = machine.trail
    if term.__class__ is tuple:
        return unify(name, term[0].atom, trail) and unify(arity, len(term) - 1, trail)
    if term.__class__ is not Var:
        return unify(name, term, trail) and unify(arity, 0, trail)
    return unify(term, make_most_general(name, arity), trail)


@function("$blank/3")
def make_most_general(name: Term, arity: Term) -> Term:
    """Return the most general term of a name and an arity; compiled clauses call it for ``functor/3``."""
    name, arity = bound(name), deref(arity)
    count = integer(arity)
    # An atomic term is its own name with arity 0.
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
    return _make_compound(name, [Var() for _ in range(_checked_arity(count))])


def _checked_arity(count: int) -> int:
    """Return a number of arguments after a check of the limits.

    Raises:
        PrologError: a resource error if a term cannot have so many arguments.
    """
    if count > _MAX_ARGUMENTS:
        raise resource_error("memory")
    # A small number costs less than the check.
    if count > len(STEPS_PER_ROUND):
        check_limits(count, _ARGUMENT_BYTES * count)
    return count


def _make_compound(name: Atom, args: Sequence[Term]) -> Term:
    return (functor(name.name, _checked_arity(len(args))), *args)


@nondeterministic("arg/3")
def arg(machine: ProgramMachine, number: Term, term: Term, value: Term) -> Outcome:
    """Relate a compound term with its arguments."""
    number, term = deref(number), deref(term)
    if term.__class__ is not tuple:
        raise instantiation_or_type_error("compound", term)
    if number.__class__ is Var:
        return _enumerate_arguments(machine, number, term, value)
    index = natural(number)
    return 0 < index < len(term) and unify(value, term[index], machine.trail)


def _enumerate_arguments(machine: ProgramMachine, number: Term, term: CompoundTerm, value: Term) -> Solutions:
    last = len(term) - 1
    for index in range(1, len(term)):
        if machine.unify_all((number, index), (value, term[index])):
            yield LAST if index == last else None


@function("$arg/3")
def get_argument(number: Term, term: Term) -> Optional[Term]:
    """Return an argument by its number; compiled clauses call it, except for simple cases that they do inline."""
    term = deref(term)
    if term.__class__ is not tuple:
        raise instantiation_or_type_error("compound", term)
    index = natural(number)
    return term[index] if 0 < index < len(term) else None


@deterministic("=../2")
def univ(machine: ProgramMachine, term: Term, parts: Term) -> bool:
    """Relate a term with the list of its name and arguments."""
    term = deref(term)
    # ISO 13211-1 requires the check of the list even if the term is known.
    if term.__class__ is not Var and is_iso(machine):
        partial_items(parts)
    if term.__class__ is tuple:
        check_tail(parts)
        return unify(parts, make_list([term[0].atom, *term[1:]]), machine.trail)
    if term.__class__ is not Var:
        if deref(parts).__class__ not in (Var, tuple):
            check_tail(parts)
        return unify(parts, make_list([term]), machine.trail)
    return unify(term, _term_of_list(parts), machine.trail)


def _term_of_list(list_term: Term) -> Term:
    """Return the term for a list of its name and arguments."""
    values = partial_items(list_term)
    if not values:
        if deref(list_term) is NIL:
            raise domain_error("non_empty_list", NIL)
        raise instantiation_error()
    head, args = deref(values[0]), items(list_term)[1:]
    if head.__class__ is Var:
        raise instantiation_error()
    # A list of one item denotes the item itself, if it is atomic.
    if not args:
        if head.__class__ is tuple:
            raise type_error("atomic", head)
        return head
    if head.__class__ is not Atom:
        raise type_error("atom", head)
    return _make_compound(head, args)


@deterministic("copy_term/2", "duplicate_term/2", "copy_term_nat/2")
def copy_term(machine: ProgramMachine, term: Term, result: Term) -> bool:
    """Copy a term with new variables."""
    return unify(result, copy(term), machine.trail)


@deterministic("compound_name_arity/3")
def compound_name_arity(machine: ProgramMachine, term: Term, name: Term, arity: Term) -> bool:
    """Relate a compound term, possibly without arguments, with its name and arity."""
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
    # Unlike by `functor/3`, arity 0 creates a compound term without arguments, as in SWI-Prolog.
    count = natural(arity)
    return unify(term, _make_compound(name, [Var() for _ in range(_checked_arity(count))]), machine.trail)


@deterministic("compound_name_arguments/3")
def compound_name_arguments(machine: ProgramMachine, term: Term, name: Term, arguments: Term) -> bool:
    """Relate a compound term with its name and list of arguments."""
    term = deref(term)
    if term.__class__ is tuple:
        if not unify(name, term[0].atom, machine.trail):
            return False
        check_tail(arguments)
        return unify(arguments, make_list(term[1:]), machine.trail)
    if term.__class__ is not Var:
        raise type_error("compound", term)
    name = atom_of(name)
    values = items(arguments)
    return unify(term, _make_compound(name, values), machine.trail)


@deterministic("setarg/3", "nb_setarg/3")
def setarg(machine: ProgramMachine, number: Term, term: Term, value: Term) -> bool:
    """Raise a permission error: terms are immutable."""
    # Destructive assignment would change ground terms that clauses and goals share.
    raise permission_error("modify", "term", resolve(term))


_NUMBERED_VAR = functor("$VAR", 1)


@deterministic("numbervars/3")
def numbervars(machine: ProgramMachine, term: Term, start: Term, end: Term) -> bool:
    """Bind the variables of a term to ``'$VAR'(N)`` with increasing numbers."""
    number = integer(start)
    # Variables are numbered in the order of their first occurrence.
    for var in with_limit_checks(variables(term)):
        unify(var, (_NUMBERED_VAR, number), machine.trail)
        number += 1
    return unify(end, number, machine.trail)


@deterministic("numbervars/1")
def numbervars_from_zero(machine: ProgramMachine, term: Term) -> bool:
    """Bind the variables of a term to ``'$VAR'(N)`` with increasing numbers from 0."""
    return numbervars(machine, term, 0, Var())


@deterministic("term_variables/2")
def term_variables(machine: ProgramMachine, term: Term, result: Term) -> bool:
    """Unify with the variables of a term, in the order of their first occurrence."""
    if is_iso(machine):
        partial_items(result)
    return unify(result, make_list(variables(term)), machine.trail)


@deterministic("term_variables/3")
def term_variables_with_tail(machine: ProgramMachine, term: Term, result: Term, tail: Term) -> bool:
    """Unify with a partial list of the variables of a term."""
    return unify(result, make_list(variables(term), tail), machine.trail)


@deterministic("term_hash/2")
def term_hash(machine: ProgramMachine, term: Term, value: Term) -> bool:
    """Unify with a hash of a ground term, which is the same in each process; for other terms, do nothing."""
    if not is_ground(term):
        return True
    # Python's own hash of a text differs between processes.
    return unify(value, crc32(machine.logic.show(term).encode()) & 0xFFFFFF, machine.trail)


def _symbol_counters(machine: ProgramMachine) -> Dict[str, int]:
    counters: Dict[str, int] = machine.logic.state.setdefault("gensym", {})
    return counters


@deterministic("gensym/2")
def gensym(machine: ProgramMachine, base: Term, result: Term) -> bool:
    """Unify with a new atom that consists of a base and a number."""
    name = atomic_text(base)
    require_no_compound(result, "atomic")
    counters = _symbol_counters(machine)
    # The counter belongs to the program and is not reset on backtracking, so names are never reused.
    counters[name] = counters.get(name, 0) + 1
    return unify(result, atom(f"{name}{counters[name]}"), machine.trail)


@deterministic("reset_gensym/1")
def reset_gensym(machine: ProgramMachine, base: Term) -> bool:
    """Restart the numbers of a base."""
    _symbol_counters(machine).pop(atomic_text(base), None)
    return True


@deterministic("reset_gensym/0")
def reset_all_gensym(machine: ProgramMachine) -> bool:
    """Restart the numbers of all bases."""
    _symbol_counters(machine).clear()
    return True


@deterministic("flag/3")
def flag(machine: ProgramMachine, name: Term, old: Term, new: Term) -> bool:
    """Unify with the value of a counter, and set it to the value of an expression."""
    values = machine.logic.state.setdefault("flag", {})
    key = atomic_text(name)
    if not unify(old, values.get(key, 0), machine.trail):
        return False
    values[key] = evaluate(new)
    return True


@nondeterministic("nb_current/2")
def nb_current(machine: ProgramMachine, name: Term, value: Term) -> Solutions:
    """Enumerate the global variables."""
    values = machine.logic.globals
    name_term = deref(name)
    if name_term.__class__ is not Var:
        key = atom_of(name_term).name
        if key in values and machine.unify(value, values[key]):
            yield LAST
        return
    for key, stored_value in list(values.items()):
        if machine.unify_all((name_term, atom(key)), (value, stored_value)):
            yield None
