"""Checks of predicates, rule files and labels: undefined, redefined, unused or duplicate ones.

A program can define predicates at run time (``assert``, foreign libraries). `_DefinablePredicates` therefore collects
everything that goals of the program could define; if that cannot be determined, no predicate is reported as
undefined.
"""

import os
from collections import Counter
from typing import Any, Dict, Iterator, List, Optional, Set

from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.types import (
    COMMA,
    CONS,
    SLASH,
    Atom,
    CompoundTerm,
    Functor,
    String,
    Term,
    Var,
    deref,
    functor,
    functor_of,
)
from ..language.called_predicates import calls
from ..language.event_operators import OPERATOR_NAMES
from ..program.topic_configuration import GOALS, RULES
from .condition_checks import conjunctions_of
from .program_model import NECK, FunctorSuggestions, ProgramModel, SourceRule, SourceTerm, Subterm

ASSERTING_PREDICATES = frozenset(
    functor(name, arity)
    for name, arity in (
        *((name, 1) for name in ("assert", "asserta", "assertz", "db")),
        *((name, 2) for name in ("assert", "asserta", "assertz")),
    )
)
_DECLARING_PREDICATES = frozenset(
    (
        *[
            functor(name, 1)
            for name in ("dynamic", "discontiguous", "multifile", "table", "use_foreign", "use_swi")
        ],
        functor("dynamic", 2),
    )
)
RETRACTING_PREDICATES = frozenset(functor(name, 1) for name in ("retract", "retractall"))
_CUT = functor("!", 0)
_FOREIGN_IMPORTS = frozenset((functor("use_foreign", 1), functor("use_swi", 1)))
_SWI_IMPORT = functor("use_swi", 2)
_AS_OPTION = functor("as", 2)
_INTERVAL_PREDICATES = frozenset((functor("t1", 1), functor("t2", 1)))


class _DefinablePredicates:
    """Predicates that a program has, or can define at run time."""

    def __init__(self, program: ProgramModel):
        self._logic = program.logic
        self.keys: Set[Functor] = {
            key for key in (functor_of(clause.head) for clause in program.clauses) if key
        }
        self.has_unknown_predicates = False
        for subterm in program.all_subterms():
            term = subterm.term
            if term.__class__ is tuple and (
                term[0] in ASSERTING_PREDICATES or term[0] in _DECLARING_PREDICATES
            ):
                # Foreign libraries define predicates that are not listed in the program.
                self.has_unknown_predicates = self.has_unknown_predicates or term[0] in _FOREIGN_IMPORTS
                self._add_predicates(term[1])
            elif term.__class__ is tuple and term[0] is _SWI_IMPORT:
                self._add_predicates(term[2], renames=True)

    def __contains__(self, key: Functor) -> bool:
        return self.has_unknown_predicates or key in self.keys or self._logic.defines(key)

    def _add_predicates(self, term: Term, renames: bool = False) -> None:
        """Add the predicates that a term names; ``as`` precedes a new name if ``renames``, otherwise options."""
        stack: List[Any] = [deref(term)]
        while stack:
            item = stack.pop()
            key = functor_of(item)
            if key is None:
                self.has_unknown_predicates = self.has_unknown_predicates or item.__class__ is Var
            elif key is COMMA or key is CONS:
                stack += [deref(item[1]), deref(item[2])]
            elif key is NECK:
                stack.append(deref(item[1]))
            elif key is _AS_OPTION and renames:
                self.has_unknown_predicates = True
            elif key is _AS_OPTION:
                stack.append(deref(item[1]))
            elif key is SLASH:
                name, arity = deref(item[1]), deref(item[2])
                if isinstance(name, Atom) and isinstance(arity, int):
                    self.keys.add(functor(name.name, arity))
                else:
                    self.has_unknown_predicates = True
            else:
                self.keys.add(key)


def find_operators_in_clauses(program: ProgramModel) -> Iterator[RuleError]:
    """Yield pattern operators in the bodies of clauses, where an event rule was probably intended."""
    for clause in program.clauses:
        head: Any = clause.head
        if head.__class__ is tuple and _is_reversed_rule(head):
            yield RuleError(
                "this is a fact, not a rule: an event rule is written Head <- Pattern where Goal",
                clause.place_of(head),
            )
        if clause.parent[0] is not NECK:
            continue
        for subterm in _calls_in(clause):
            # Only operators in words: ``or`` and ``seq`` have no meaning in a clause, but symbols such as ``;`` do.
            name = OPERATOR_NAMES.get(subterm.term[0]) if subterm.term.__class__ is tuple else None
            if name is not None and subterm.term[0].name.isidentifier():
                yield RuleError(
                    f"{name} occurs in the body of a clause; the arrow of an event rule is <-", subterm.place
                )
                break


def _is_reversed_rule(head: CompoundTerm) -> bool:
    """Return whether a fact is a pattern, or a pattern with an arrow to its head."""
    return head[0] in _RIGHT_ARROWS or (
        head[0] in OPERATOR_NAMES and len(head) == 3 and head[0].name.isidentifier()
    )


_RIGHT_ARROWS = frozenset((functor("->", 2), functor("=>", 2)))


def _calls_in(clause: SourceTerm) -> Iterator[Subterm]:
    for call in calls(clause.parent, clause.position):
        yield Subterm(call.term, call.parent, call.position, clause.place_of)


def find_redefined_builtins(program: ProgramModel) -> Iterator[RuleError]:
    """Yield predicates of the program that replace built-in ones."""
    built_in = program.logic.database.library.shadowed_predicates
    reported: Set[Functor] = set()
    for clause in program.clauses:
        key = None if clause.head is None else functor_of(clause.head)
        if key is None or key in reported or key not in built_in or not built_in[key].is_protected:
            continue
        reported.add(key)
        yield RuleError(f"{key} is built in: the definition of this program replaces it", clause.place)


def find_undefined_predicates(program: ProgramModel) -> Iterator[RuleError]:
    """Yield calls of undefined predicates in clauses."""
    definable = _DefinablePredicates(program)
    reported: Dict[Functor, None] = {}
    events = {subterm.key for subterm, _ in program.patterns()}
    called = {call.key for call in program.calls()}
    for clause in program.clauses:
        for subterm in _calls_in(clause):
            key = subterm.key
            if (
                key is None
                or key in reported
                or key is _CUT
                or key in _INTERVAL_PREDICATES
                or key in OPERATOR_NAMES
                or key in definable
            ):
                continue
            # Each predicate is reported once, at its first call.
            reported[key] = None
            similar = program.logic.find_similar(key) if len(reported) <= _MAX_HINTS else []
            # A clause that calls itself was not meant.
            similar = [name for name in similar if name != str(functor_of(clause.head))]
            hint = f"; did you mean {' or '.join(similar)}?" if similar else ""
            hint = hint or ": define it, or assert facts of it"
            if key in events or (
                not similar and clause.head is not None and functor_of(clause.head) not in called
            ):
                hint += f"; if {key} is an event, the arrow of the rule is <-"
            yield RuleError(f"there is no predicate {key}{hint}", subterm.place)


_MAX_HINTS = 100
"""Maximum number of undefined predicates for which similar names are searched."""


def find_never_asserted(program: ProgramModel) -> Iterator[RuleError]:
    """Yield predicates that are retracted but never asserted."""
    definable = _DefinablePredicates(program)
    suggestions = FunctorSuggestions()
    reported: Set[Functor] = set()
    for subterm in program.all_subterms():
        term = subterm.term
        key = key_of_clause(term[1]) if term.__class__ is tuple and term[0] in RETRACTING_PREDICATES else None
        if key is None or key in reported or key in definable.keys or definable.has_unknown_predicates:
            continue
        # A predicate with clauses from another source, for example a loaded state, has something to retract.
        if program.logic.defines(key) and not _is_empty(program, key):
            continue
        reported.add(key)
        suggestion = suggestions.suggest(key, definable.keys)
        hint = f"; did you mean {suggestion}?" if suggestion else ""
        yield RuleError(f"nothing asserts {key}, so there is never a clause to retract{hint}", subterm.place)


def find_missing_first_clauses(program: ProgramModel) -> Iterator[RuleError]:
    """Yield goals that need a clause of a predicate, if clauses are added only after such goals have succeeded.

    A counter that is updated by ``retract(count(N)), New is N + 1, assertz(count(New))`` needs a first value. If a
    single file is checked, goals elsewhere may add it.
    """
    if program.folder is None or not os.path.isdir(program.folder):
        return
    definable = _DefinablePredicates(program)
    clause_keys = {functor_of(clause.head) for clause in program.clauses}
    asserted = Counter(
        key_of_clause(subterm.term[1])
        for subterm in program.all_subterms()
        if subterm.key in ASSERTING_PREDICATES and subterm.term.__class__ is tuple
    )
    # Goals that are computed at run time, or foreign libraries, may add clauses.
    if None in asserted or definable.has_unknown_predicates:
        return
    guarded: Counter[Functor] = Counter()
    first_needs: Dict[Functor, Subterm] = {}
    for conjunction in conjunctions_of(program):
        needed: Dict[Functor, Subterm] = {}
        for goal in conjunction.goals:
            if goal.key in ASSERTING_PREDICATES and goal.term.__class__ is tuple:
                key = key_of_clause(goal.term[1])
                if key is not None and key in needed:
                    guarded[key] += 1
                    first_needs.setdefault(key, needed[key])
                continue
            key = key_of_clause(goal.term[1]) if goal.key is _RETRACT else goal.key
            if key is not None:
                needed.setdefault(key, goal)
    for key, goal in first_needs.items():
        has_clauses = key in clause_keys or not _is_empty(program, key)
        if has_clauses or guarded[key] != asserted[key] or program.logic.is_system_predicate(key):
            continue
        arguments = ", ".join("0" for _ in range(key.arity))
        fact = f"{key.name}({arguments})" if arguments else key.name
        yield RuleError(
            f"{key} has no clause here, and goals add one only after this one succeeds: add a first fact, such as "
            f"{fact}.",
            goal.place,
        )


_RETRACT = functor("retract", 1)


def _is_empty(program: ProgramModel, key: Functor) -> bool:
    """Return whether a predicate has no clauses. Retracting creates an empty one."""
    predicate = program.logic.database.predicates.get(key)
    return predicate is None or (
        predicate.kind != "builtin" and not predicate.is_library_predicate and not len(predicate)
    )


def key_of_clause(term: Any) -> Optional[Functor]:
    """Return the functor of the head of a clause."""
    term = deref(term)
    if term.__class__ is tuple and term[0] is NECK:
        term = deref(term[1])
    return functor_of(term)


def find_unloaded_rule_file(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the rule file of the folder if no goal loads it."""
    if program.folder is None:
        return
    path = program.folder / RULES
    if not os.path.isfile(path) or program.rule_base.files.has_loaded(path):
        return
    # A goal that names the file is enough: whether it is called can depend on conditions.
    texts = (_text_of(subterm.term) for subterm in program.all_subterms())
    if not any(RULES in text for text in texts):
        yield RuleError(f"{path} is not read: no goal in {GOALS} calls compile_event_file('{RULES}')")


def _text_of(term: Term) -> str:
    """Return the text of an atom or string; "" for other terms."""
    if isinstance(term, Atom):
        return str(term.name)
    return str(term.text) if isinstance(term, String) else ""


def find_duplicate_labels(program: ProgramModel) -> Iterator[RuleError]:
    """Yield rules that share the label of an earlier rule."""
    rules_by_label: Dict[Any, SourceRule] = {}
    for rule in program.rules:
        label = rule.definition.label
        if label is None:
            continue
        first_rule = rules_by_label.setdefault(term_key(label), rule)
        if first_rule is not rule:
            place = first_rule.definition.place
            line_text = "" if place is None else f" (line {place.line})"
            name = program.logic.brief(label)
            yield RuleError(
                f"another rule{line_text} has the label {name}, too: windows and del_event_rule mean both",
                rule.definition.place,
            )
