"""Variables given names, terms given numbers: numbervars, hashes, generated symbols."""

from typing import Dict
from zlib import crc32

from ...foundation import watched
from ..arithmetic import evaluate
from ..machine import LAST
from ..terms import Term, Var, atom, deref, functor, is_ground, make_list, unify, variables
from .arguments import atom_of, integer
from .checking import is_acyclic
from .program import Machine, Solutions
from .registry import deterministic, nondeterministic
from .text import atomic_text, no_compound

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
