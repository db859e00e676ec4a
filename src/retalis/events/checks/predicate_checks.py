"""Predicates that are called, read or retracted and that nothing defines, and arrows that slipped.

Rules of a program's folder that no goal reads.

States that are asked for and not declared.

Labels that two rules have, and variables that stand alone.
"""

import os
from typing import Any, Dict, Iterator, List, Optional, Set

from ...foundation.errors import RuleError, UsageError
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.types import COMMA, CONS, SLASH, Atom, Functor, Term, Var, deref, functor
from ..language.goal_analysis import calls
from ..language.pattern_operators import SPELLINGS
from ..language.state_parser import asked_state
from ..program.program_folder import GOALS, RULES, read_text
from .program_model import (
    NECK,
    Inner,
    NearFunctors,
    ProgramModel,
    WrittenRule,
    WrittenTerm,
    held,
    inners,
    key_of,
)

ADDS = frozenset(
    functor(name, arity)
    for name, arity in (
        *((name, 1) for name in ("assert", "asserta", "assertz", "db")),
        *((name, 2) for name in ("assert", "asserta", "assertz")),
    )
)
_DECLARES = frozenset(
    (
        *[
            functor(name, 1)
            for name in ("dynamic", "discontiguous", "multifile", "table", "use_foreign", "use_swi")
        ],
        functor("dynamic", 2),
    )
)
RETRACTS = frozenset(functor(name, 1) for name in ("retract", "retractall"))
_CUT = functor("!", 0)
_ANYTHING = frozenset((functor("use_foreign", 1), functor("use_swi", 1)))
_SWI = functor("use_swi", 2)
_AS = functor("as", 2)
_HOOKS = frozenset((functor("t1", 1), functor("t2", 1)))


class _Defined:
    """The predicates that a program has or may get."""

    def __init__(self, program: ProgramModel):
        self._logic = program.logic
        self.keys: Set[Functor] = {key for key in (key_of(one.head) for one in program.clauses) if key}
        self.anything = False
        for inner in program.calls():
            term = inner.term
            if term.__class__ is tuple and (term[0] in ADDS or term[0] in _DECLARES):
                self.anything = self.anything or term[0] in _ANYTHING
                self._add(term[1])
            elif term.__class__ is tuple and term[0] is _SWI:
                self._add(term[2], renames=True)

    def __contains__(self, key: Functor) -> bool:
        return self.anything or key in self.keys or self._logic.defines(key)

    def _add(self, term: Term, renames: bool = False) -> None:
        """Note what a term names; ``as`` is followed by a new name where it ``renames``, else by options."""
        stack: List[Any] = [deref(term)]
        while stack:
            item = stack.pop()
            key = key_of(item)
            if key is None:
                self.anything = self.anything or item.__class__ is Var
            elif key is COMMA or key is CONS:
                stack += [deref(item[1]), deref(item[2])]
            elif key is NECK:
                stack.append(deref(item[1]))
            elif key is _AS and renames:
                self.anything = True
            elif key is _AS:
                stack.append(deref(item[1]))
            elif key is SLASH:
                name, arity = deref(item[1]), deref(item[2])
                if isinstance(name, Atom) and isinstance(arity, int):
                    self.keys.add(functor(name.name, arity))
                else:
                    self.anything = True
            else:
                self.keys.add(key)


def slipped_arrows(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the operators of patterns in the bodies of clauses: a rule was meant."""
    for clause in program.clauses:
        if clause.parent[0] is not NECK:
            continue
        for inner in _goals(clause):
            name = SPELLINGS.get(inner.term[0]) if inner.term.__class__ is tuple else None
            if name is not None and inner.term[0].name.isidentifier():
                yield RuleError(
                    f"{name} stands in the body of a clause; the arrow of an event rule is <-", inner.place
                )
                break


def _goals(one: WrittenTerm) -> Iterator[Inner]:
    for call in calls(one.parent, one.number):
        yield Inner(call.term, call.parent, call.number, one.spot)


def redefined(program: ProgramModel) -> Iterator[RuleError]:
    """Yield where a program defines what the system has: its own takes the place of that."""
    kept = program.logic.database.library.kept
    said: Set[Functor] = set()
    for clause in program.clauses:
        key = None if clause.head is None else key_of(clause.head)
        if key is None or key in said or key not in kept or not kept[key].system:
            continue
        said.add(key)
        yield RuleError(f"{key} is built in: for this program its own takes the place of that", clause.place)


def undefined(program: ProgramModel) -> Iterator[RuleError]:
    """Yield what clauses call and nothing defines."""
    defined = _Defined(program)
    said: Dict[Functor, None] = {}
    for clause in program.clauses:
        for inner in _goals(clause):
            key = inner.key
            if (
                key is None
                or key in said
                or key is _CUT
                or key in _HOOKS
                or key in SPELLINGS
                or key in defined
            ):
                continue
            said[key] = None
            known = program.logic.similar(key) if len(said) <= _MAX_HINTS else []
            hint = f"; did you mean {' or '.join(known)}?" if known else ""
            yield RuleError(
                f"there is no predicate {key}{hint or ': define it, or assert facts of it'}", inner.place
            )


_MAX_HINTS = 100
"""Predicates that are not there for which one that is like it is looked for."""


def retracted(program: ProgramModel) -> Iterator[RuleError]:
    """Yield what is retracted, and read, but never asserted."""
    defined = _Defined(program)
    nearby = NearFunctors()
    said: Set[Functor] = set()
    for inner in program.calls():
        term = inner.term
        key = key_of_clause(term[1]) if term.__class__ is tuple and term[0] in RETRACTS else None
        if key is None or key in said or key in defined.keys or defined.anything:
            continue
        if program.logic.defines(key) and not _is_empty(program, key):
            continue
        said.add(key)
        nearest = nearby.of(key, defined.keys)
        hint = f"; did you mean {nearest}?" if nearest else ""
        yield RuleError(f"nothing asserts {key}, so there is never one to retract{hint}", inner.place)


def _is_empty(program: ProgramModel, key: Functor) -> bool:
    """Tell whether a predicate has no clauses: what has been retracted before is dynamic, and has none."""
    predicate = program.logic.database.predicates.get(key)
    return predicate is None or (predicate.kind != "builtin" and not predicate.library and not len(predicate))


def key_of_clause(term: Any) -> Optional[Functor]:
    """Return the functor of a clause's head."""
    term = deref(term)
    if term.__class__ is tuple and term[0] is NECK:
        term = deref(term[1])
    return key_of(term)


def unread_rules(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the rule file where it is there and not read."""
    if program.folder is None:
        return
    path = program.folder / RULES
    if not os.path.isfile(path) or program.loaded.files.has_loaded(
        path
    ):  # where we may not look, it is not there
        return
    try:
        goals = read_text(program.folder / GOALS)
    except UsageError:  # said when it was to be loaded
        goals = ""
    if RULES not in goals:
        yield RuleError(f"{path} is not read: no goal in {GOALS} calls compile_event_file('{RULES}')")


def unknown_states(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the states that goals ask for and nothing declares."""
    known = [one.form.functor for one in program.states]
    nearby = NearFunctors()
    for inner in program.called():
        key = asked_state(inner.term)
        if key is None or key in known or not program.logic.is_of_system(inner.term[0]):
            continue
        nearest = nearby.of(key, known)
        hint = (
            f"; did you mean {nearest}?" if nearest else ": state(S, from(Event), until(Event)) declares one"
        )
        yield RuleError(f"there is no state {key}{hint}", inner.place)


def labels(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the rules whose label another has already."""
    first: Dict[Any, WrittenRule] = {}
    for rule in program.rules:
        label = rule.definition.label
        if label is None:
            continue
        other = first.setdefault(term_key(label), rule)
        if other is not rule:
            place = other.definition.place
            where = "" if place is None else f" (line {place.line})"
            name = program.logic.brief(label)
            yield RuleError(
                f"another rule{where} has the label {name}, too: windows and del_event_rule mean both",
                rule.definition.place,
            )


def singletons(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the variables that stand once in a rule, clause or goal and have a name."""
    for read in program.reads:
        wanted: Set[Var] = {read.names[name] for name in read.singletons}
        if not wanted:
            continue
        names = {var: name for name, var in read.names.items()}
        for inner in inners(held(read.term), 1, read.place_of):
            term: Any = deref(inner.term)
            if term.__class__ is Var and term in wanted:
                wanted.discard(term)
                name = names[term]
                yield RuleError(
                    f"{name} stands here only: a misspelt name? Otherwise write _{name} or _", inner.place
                )
