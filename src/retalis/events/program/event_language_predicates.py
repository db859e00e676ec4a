"""Predicates of the event language: rules, flags, counters, files, and queries about stored and explained events.

Predicates that load files follow SWI-Prolog (``consult/1``, ``use_module/1,2``, ``ensure_loaded/1``,
``load_files/2``). Those of ETALIS are named as there (``ins_event_rule/1``, ``set_etalis_flag/2``).
"""

from pathlib import Path
from typing import Dict, Hashable, Iterator, Sequence, Tuple

from ...foundation.errors import UsageError
from ...prolog.builtins.argument_checks import bound, callable_of
from ...prolog.files.source_files import SourceFiles
from ...prolog.machine.errors import domain_error, existence_error, instantiation_error
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import copy, freeze, resolve
from ...prolog.terms.timestamps import interval_term, lazy_term
from ...prolog.terms.types import CONS, NIL, Atom, Term, Var, atom, deref, functor
from ...prolog.terms.unification import undo
from ..dispatch.event_recording import enumerate_stored_events
from ..language.pattern_parser import no_place
from ..language.rule_labels import is_rule
from ..rules.event_input_predicates import EVENT2, define_event_predicates, file_name_of, require_list
from ..rules.language_flags import FLAGS
from ..rules.program_timers import define_timers
from ..rules.rule_base import RuleBase
from .event_file_loader import EventFileLoader
from .event_file_parser import EventFileParser

_IF_OPTION = functor("if", 1)
_LOAD_IF_CHANGED = ("not_loaded", "changed")
_NO_VALUE = atom("nil")


def define_load_predicates(logic: PrologSystem, files: SourceFiles, loader: EventFileLoader) -> None:
    """Define the predicates that load files, except those that `_RulePredicates` defines."""

    def load(machine: Machine, names: Term, options: Term = NIL) -> bool:
        option_terms = [deref(option) for option in list_items(options) or ()]
        loads_once = any(
            option.__class__ is tuple
            and option[0] is _IF_OPTION
            and getattr(deref(option[1]), "name", "") in _LOAD_IF_CHANGED
            for option in option_terms
        )
        items = list_items(names)
        for name in [names] if items is None else items:
            loader.use_file(name, loads_once)
        return True

    def load_context(machine: Machine, key: Term, value: Term) -> Iterator[bool]:
        path = files.innermost_file
        for entry in () if path is None else _create_load_context(path):
            # Bindings are undone before the next solution, because the machine expects none from a previous one.
            mark = len(machine.trail)
            if machine.unify_all((key, entry[0]), (value, entry[1])):
                yield True
            undo(machine.trail, mark)

    def load_module(machine: Machine, name: Term, imports: Term = NIL) -> bool:
        loader.use_file(name, once=False)
        return True

    for name in ("reconsult", "compile", "load_files"):
        logic.define(name, 1, load)
    for name in ("autoload", "reexport"):
        logic.define(name, 1, load_module)
        logic.define(name, 2, load_module)
    logic.define("load_files", 2, load)
    logic.define_nondeterministic("prolog_load_context", 2, load_context)


def _create_load_context(path: Path) -> Tuple[Tuple[Term, Term], ...]:
    """Return the properties of the file that is being loaded, as ``prolog_load_context/2`` reports them."""
    return (
        (atom("directory"), atom(str(path.parent))),
        (atom("source"), atom(str(path))),
        (atom("file"), atom(str(path))),
        (atom("module"), atom("user")),
        (atom("dialect"), atom("swi")),
    )


def define_predicates(rules: RuleBase, loader: EventFileLoader) -> None:
    """Define all predicates of the event language for a program's rules."""
    logic = rules.logic
    _RulePredicates(rules, loader).define(logic)
    _FlagPredicates(rules).define(logic)
    define_event_predicates(rules)
    define_load_predicates(logic, rules.files, loader)
    define_timers(logic, rules.timers, rules.declared_events.require_declared)
    _QueryPredicates(rules).define(logic)


def _unify_each_solution(
    machine: Machine, terms: Sequence[Term], results: Iterator[Tuple[Term, ...]]
) -> Iterator[bool]:
    """Unify terms with one solution after another."""
    # The solutions are collected first, because a goal that runs between two solutions may change the store.
    for solution in list(results):
        mark = len(machine.trail)
        if all(machine.unify(term, value) for term, value in zip(terms, solution)):
            yield True
        undo(machine.trail, mark)


class _RulePredicates:
    """Predicates that add and delete rules and load files."""

    def __init__(self, rules: RuleBase, loader: EventFileLoader):
        self.rules = rules
        self.loader = loader

    def define(self, logic: PrologSystem) -> None:
        logic.define("ins_event_rule", 1, self.insert_rule)
        logic.define("del_event_rule", 1, self.delete_rule)
        logic.define("del_all_event_rules", 1, self.delete_rules)
        for name in ("compile_event_file", "compile_events"):
            logic.define(name, 1, self.load_file)
        logic.define("consult", 1, self.consult)
        logic.define("[|]", 2, lambda machine, name, more: self.consult(machine, (CONS, name, more)))
        logic.define("use_module", 1, self.load_module)
        logic.define("use_module", 2, lambda machine, name, imports: self.load_module(machine, name))
        logic.define("ensure_loaded", 1, self.ensure_loaded)
        logic.define("compile_event_rules", 1, self.load_terms)
        logic.define("compile_event_rules", 2, lambda machine, module, terms: self.load_terms(machine, terms))
        logic.define("reset_db", 0, self.reset_db)
        logic.define("call_gc", 0, self.reset_db)
        logic.define("reset_etalis_state", 0, self.reset_etalis_state)
        logic.define("reset_etalis", 0, self.reset_etalis)

    def insert_rule(self, machine: Machine, rule: Term) -> bool:
        term = callable_of(rule)
        # The term is copied, because backtracking over the goal undoes its bindings.
        self.loader.load_terms([(copy(term), None)])
        return is_rule(term)

    def delete_rule(self, machine: Machine, rule: Term) -> bool:
        term = deref(callable_of(rule))
        if not is_rule(term):
            self.rules.delete(term)
            return True
        parser = EventFileParser()
        parser.parse_term(copy(term), no_place, None)
        if parser.rules:
            self.rules.delete_equal(parser.rules[0])
        return True

    def delete_rules(self, machine: Machine, head: Term) -> bool:
        self.rules.delete_by_head(callable_of(head))
        return True

    def load_file(self, machine: Machine, path: Term) -> bool:
        self.loader.load_file(file_name_of(path))
        return True

    def consult(self, machine: Machine, names: Term) -> bool:
        items = list_items(names)
        for name in [names] if items is None else items:
            self.loader.use_file(name, once=False)
        return True

    def load_module(self, machine: Machine, name: Term) -> bool:
        self.loader.use_file(name, once=False)
        return True

    def ensure_loaded(self, machine: Machine, name: Term) -> bool:
        self.loader.use_file(name, once=True)
        return True

    def load_terms(self, machine: Machine, terms: Term) -> bool:
        self.loader.load_terms([(term, None) for term in require_list(terms)])
        return True

    def reset_db(self, machine: Machine) -> bool:
        # Past states, stored events, lineage and the clocks of the rules remain.
        for rule in self.rules.rules:
            rule.clear_matches()
        self.rules.report_reset(False)
        return True

    def reset_etalis_state(self, machine: Machine) -> bool:
        # Rules, flags, memories and facts remain.
        for rule in self.rules.rules:
            rule.clear()
        self.rules.report_reset(True)
        self.rules.event_log.clear()
        self.rules.network.tracker.clear()
        return True

    def reset_etalis(self, machine: Machine) -> bool:
        # Each changed flag is checked, so that a client that may not set a flag cannot reset it either; see
        # `PrologSystem.require_flags`.
        for name in self.rules.flags.changed_flags():
            self.rules.logic.require_flags(atom(name))
        self.rules.reset()
        return True


class _FlagPredicates:
    """Predicates that set and read flags and counters."""

    def __init__(self, rules: RuleBase):
        self.rules = rules
        # Stored with the state of the built-ins, so that snapshots include it.
        state = rules.logic.state
        self.counters: Dict[Hashable, int] = state.setdefault("counters of events", {})
        self.user_flags: Dict[Hashable, Term] = state.setdefault("flags of events", {})

    def define(self, logic: PrologSystem) -> None:
        logic.define("set_etalis_flag", 2, self.set_etalis_flag)
        logic.define_nondeterministic("get_etalis_flag", 2, self.get_etalis_flag)
        logic.define("incCounter", 1, self.increment_counter)
        logic.define("counter", 2, self.read_counter)
        logic.define("resetCounter", 1, self.reset_counter)
        logic.define("set_flag", 2, self.set_user_flag)
        logic.define("get_flag", 2, self.get_user_flag)

    def set_etalis_flag(self, machine: Machine, name: Term, value: Term) -> bool:
        name, value = callable_of(name), bound(value)
        if name.__class__ is not Atom:
            raise domain_error("etalis_flag", name)
        self.rules.logic.require_flags(name)
        try:
            self.rules.flags.set(name.name, value)
        except UsageError as error:
            if self.rules.flags.get(name.name) is None:
                raise domain_error("etalis_flag", name, error.message) from None
            raise domain_error("etalis_flag_value", (functor("+", 2), name, value), error.message) from None
        return True

    def get_etalis_flag(self, machine: Machine, name: Term, value: Term) -> Iterator[bool]:
        name = deref(name)
        names = list(FLAGS) if name.__class__ is Var else [name.name if name.__class__ is Atom else ""]
        # An unknown name that is given is an error; with a variable all flags are enumerated.
        for flag_name in names:
            current = self.rules.flags.get(flag_name)
            if current is None:
                raise existence_error("etalis_flag", name)
            mark = len(machine.trail)
            if machine.unify(name, atom(flag_name)) and machine.unify(value, current):
                yield True
            undo(machine.trail, mark)

    def increment_counter(self, machine: Machine, name: Term) -> bool:
        key = _key_of_term(name)
        self.counters[key] = self.counters.get(key, 0) + 1
        return True

    def read_counter(self, machine: Machine, name: Term, value: Term) -> bool:
        return bool(machine.unify(value, self.counters.get(_key_of_term(name), 0)))

    def reset_counter(self, machine: Machine, name: Term) -> bool:
        self.counters.pop(_key_of_term(name), None)
        return True

    def set_user_flag(self, machine: Machine, name: Term, value: Term) -> bool:
        # `nil` is the value of a flag that is not set, so setting it removes the entry.
        key, value = _key_of_term(name), copy(value)
        if value is _NO_VALUE:
            self.user_flags.pop(key, None)
        else:
            self.user_flags[key] = value
        return True

    def get_user_flag(self, machine: Machine, name: Term, value: Term) -> bool:
        return bool(machine.unify(value, copy(self.user_flags.get(_key_of_term(name), _NO_VALUE))))


def _key_of_term(term: Term) -> Hashable:
    try:
        return freeze(deref(term))
    except ValueError:
        raise instantiation_error() from None


class _QueryPredicates:
    """Predicates that query intervals, stored events and explanations."""

    def __init__(self, rules: RuleBase):
        self.rules = rules

    def define(self, logic: PrologSystem) -> None:
        logic.define("t1", 1, lambda machine, instant: self.unify_condition_bound(machine, instant, 0))
        logic.define("t2", 1, lambda machine, instant: self.unify_condition_bound(machine, instant, 1))
        logic.define_nondeterministic("fired_event", 2, self.enumerate_fired_events)
        logic.define_nondeterministic("stored_event", 1, self.enumerate_stored_events)
        self.rules.event_log.define_predicates()
        logic.define("see_db", 0, self.print_partial_matches)
        logic.define_nondeterministic("justify_event", 3, self.enumerate_explanations)
        logic.define_nondeterministic("justification_edge", 2, self.enumerate_edges)
        # Declared dynamic, so that a call without any property fails and does not raise an existence error.
        logic.database.predicate(functor("event_rule_property", 3)).dynamic = True

    def unify_condition_bound(self, machine: Machine, instant: Term, position: int) -> bool:
        interval = self.rules.network.condition_state.condition_interval
        return interval is not None and bool(machine.unify(instant, lazy_term(interval[position])))

    def enumerate_fired_events(self, machine: Machine, event: Term, interval: Term) -> Iterator[bool]:
        return enumerate_stored_events(self.rules.event_log.stored_events, machine, event, interval)

    def enumerate_stored_events(self, machine: Machine, event: Term) -> Iterator[bool]:
        events = self.rules.event_log.stored_events
        solutions = [((EVENT2, term, interval_term(start, end)),) for term, start, end in events]
        return _unify_each_solution(machine, (event,), iter(solutions))

    def enumerate_explanations(
        self, machine: Machine, event: Term, interval: Term, explanation: Term
    ) -> Iterator[bool]:
        explanations = self.rules.justifier.explanations(resolve(event), resolve(interval))
        return _unify_each_solution(machine, (event, interval, explanation), explanations)

    def enumerate_edges(self, machine: Machine, head: Term, body: Term) -> Iterator[bool]:
        return _unify_each_solution(machine, (head, body), self.rules.justifier.edges())

    def print_partial_matches(self, machine: Machine) -> bool:
        logic = self.rules.logic
        for rule in self.rules.rules:
            logic.output(f"rule {rule.title}: {rule.match_count} partial matches\n")
        return True
