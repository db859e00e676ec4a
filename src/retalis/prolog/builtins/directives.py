"""Directives of other Prologs: what they declare needs nothing done here, or is done as a goal."""

from typing import Optional

from ..machine import Frame, domain_error, instantiation_error
from ..terms import Atom, Term, Values, Var, atom, deref, functor
from .dcg import translate_rule
from .program import Machine
from .registry import control, deterministic

_GRAMMAR = functor("-->", 2)
_MAIN = atom("main")
_TIMES = ("now", "after_load", "restore", "restore_state", "program", "main")


@deterministic(
    "style_check/1",
    "no_style_check/1",
    "mode/1",
    "license/1",
    "encoding/1",
    "noprofile/1",
    "non_terminal/1",
    "expects_dialect/1",
)
def declaration(machine: Machine, given: Term) -> bool:
    """Take a declaration that changes nothing here."""
    if deref(given).__class__ is Var:
        raise instantiation_error()
    return True


@control("initialization/1")
def initialization(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a goal; in a file it is called when that has been loaded, which who loads it sees to."""
    return machine.logic.control.call(args[0], after)


@control("initialization/2")
def initialization_at(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a goal, but for one that would be the main goal of a program."""
    when = deref(args[1])
    if when.__class__ is Var:
        raise instantiation_error()
    if not isinstance(when, Atom) or when.name not in _TIMES:
        raise domain_error("initialization_type", when)
    return after if when is _MAIN else machine.logic.control.call(args[0], after)


@deterministic("dcg_translate_rule/2")
def dcg_translate_rule(machine: Machine, rule: Term, clause: Term) -> bool:
    """Translate a grammar rule."""
    rule = deref(rule)
    if rule.__class__ is Var:
        raise instantiation_error()
    if rule.__class__ is not tuple or rule[0] is not _GRAMMAR:
        return False
    return machine.unify(clause, translate_rule(rule))


@deterministic("expand_term/2")
def expand_term(machine: Machine, term: Term, expanded: Term) -> bool:
    """Expand a term as when a file is loaded: what ``term_expansion/2`` says, and grammar rules."""
    term = deref(term)
    key = functor("term_expansion", 2)
    predicate = machine.logic.database.predicates.get(key)
    if term.__class__ is not Var and predicate is not None and not predicate.library and len(predicate):
        result = Var()
        if machine.logic.once((key, term, result)):
            term = deref(result)
    if term.__class__ is tuple and term[0] is _GRAMMAR:
        term = translate_rule(term)
    return machine.unify(expanded, term)
