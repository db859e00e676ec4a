"""Abstract store of the value flow analysis: the kinds of the arguments of events, predicates and memory records.

The store has an entry for each event, predicate or memory whose values all come from the program. Events and
predicates without an entry have unknown values. An entry begins with no values; the evaluation of rules and clauses
adds kinds, and schedules the parts of the program that have read the entry.
"""

from collections import deque
from typing import Any, Deque, Dict, Hashable, Iterator, List, Optional, Set

from ...messages.type_definition import Definition
from ...prolog.terms.types import Atom, CompoundTerm, Functor, Term, Var, deref, functor, functor_of
from ..knowledge.knowledge_base import OWN_EVENTS
from ..language.event_declarations import Declaration
from ..language.pattern_parser import PlaceLookup
from ..language.rule_heads import event_raised_by, makes_event
from .abstract_environment import Environment
from .event_flow_checks import SUBSCRIBE_TO, functors_in_fact
from .predicate_checks import ASSERTING_PREDICATES
from .program_model import NECK, ProgramModel, wrap_term
from .value_kinds import Kinds, ValueOrigin, join, kind_of

Values = List[Kinds]
"""Kinds of the arguments of an event, record or predicate."""

_INPUT_EVENT, _EVENT2 = functor("input_event", 1), functor("event", 2)
_RULE_ADDING_GOALS = frozenset(
    functor(name, arity)
    for name, arity in (("ins_event_rule", 1), ("ins_event_rule", 2), ("compile_event_rules", 1))
)
"""Goals that add rules: if their argument is a variable, events may have other producers."""


class Worklist:
    """Worklist of a fixpoint computation: the numbers of the parts that have to be evaluated, in order.

    It records which part has read which entry of the store, so that a changed entry schedules its readers only.
    """

    def __init__(self) -> None:
        self._readers: Dict[Hashable, Set[int]] = {}
        self._pending: Deque[int] = deque()
        self._is_pending: List[bool] = []
        self._current = 0

    def run(self, count: int) -> Iterator[int]:
        """Yield the numbers of all parts, then those of parts that are scheduled, until there are none."""
        self._pending.extend(range(count))
        self._is_pending = [True] * count
        while self._pending:
            self._current = self._pending.popleft()
            self._is_pending[self._current] = False
            yield self._current

    def record_read(self, entry: Hashable) -> None:
        """Record that the current part has read an entry."""
        self._readers.setdefault(entry, set()).add(self._current)

    def schedule_readers(self, entry: Hashable) -> None:
        """Schedule the parts that have read an entry, each once."""
        for number in self._readers.get(entry, ()):
            if not self._is_pending[number]:
                self._is_pending[number] = True
                self._pending.append(number)


class AbstractStore:
    """Kinds of the arguments of events, predicates and records.

    Args:
        goals: all compound terms of the program.
        worklist: schedules the readers of changed entries.
    """

    def __init__(self, program: ProgramModel, goals: List[Any], worklist: Worklist):
        self._worklist = worklist
        self._is_final = False
        self._events: Dict[Functor, Values] = {
            key: create_values(key.arity) for key in find_own_events(program, goals)
        }
        self._predicates: Dict[Functor, Values] = {
            key: create_values(key.arity) for key in find_own_predicates(program, goals)
        }
        self._records: Dict[str, Dict[Optional[Functor], Values]] = {}
        names = [deref(memory.term[4]) for memory in program.memories]
        # A memory whose name is computed at run time may be any of those that are read.
        self._has_unknown_records = not all(isinstance(name, Atom) for name in names)
        for name in names:
            if isinstance(name, Atom):
                self._records.setdefault(name.name, {})

    def finish(self) -> None:
        """Keep all entries as they are: the fixpoint is reached."""
        self._is_final = True

    def has_event(self, key: Functor) -> bool:
        """Return whether only this program produces an event."""
        return key in self._events

    def has_predicate(self, key: Optional[Functor]) -> bool:
        """Return whether all clauses of a predicate are in this program."""
        return key in self._predicates

    def kinds_of_event(self, key: Functor) -> Optional[Values]:
        """Return the kinds of the arguments of an event without recording a reader; None for other events."""
        return self._events.get(key)

    def read_event(self, key: Functor) -> Values:
        """Return the kinds of the arguments of an event of the store."""
        self._record_read(("event", key))
        return self._events[key]

    def read_predicate(self, key: Functor) -> Values:
        """Return the kinds of the arguments of a predicate of the store."""
        self._record_read(("predicate", key))
        return self._predicates[key]

    def read_records(self, name: str) -> Optional[Dict[Optional[Functor], Values]]:
        """Return the kinds in the records of a memory by functor, None for other terms; None for unknown memories."""
        if name not in self._records or self._has_unknown_records:
            return None
        self._record_read(("memory", name))
        return self._records[name]

    def add_event(self, event: CompoundTerm, environment: Environment) -> None:
        """Add the arguments of an event of the store."""
        self._add(("event", event[0]), self._events[event[0]], event, environment)

    def add_clause(self, head: Any, environment: Environment) -> None:
        """Add the arguments of the head of a clause of a predicate of the store."""
        if head.__class__ is tuple:
            self._add(("predicate", head[0]), self._predicates[head[0]], head, environment)

    def add_record(self, name: str, record: Any, environment: Environment) -> None:
        """Add the arguments of a record of a memory, or the record if it is no compound term."""
        if self._is_final:
            return
        is_compound = record.__class__ is tuple
        term = record if is_compound else wrap_term(record)
        key = record[0] if is_compound else None
        values = self._records[name].setdefault(key, create_values(len(term) - 1))
        self._add(("memory", name), values, term, environment)

    def add_fact(self, key: Functor, fact: Any, place_of: PlaceLookup) -> None:
        """Add the constants of a fact; its variables are added when the fact is evaluated as a clause."""
        values = self._predicates[key]
        for position, known in enumerate(values, 1):
            kind = kind_of(fact[position])
            # Most facts of a table add nothing, so their places are not computed.
            if kind is not None and known is not None and kind not in known:
                origin = ValueOrigin("", deref(fact[position]), place_of(fact, position))
                values[position - 1] = join(known, {kind: origin})
            elif kind is None:
                values[position - 1] = None

    def _record_read(self, entry: Hashable) -> None:
        if not self._is_final:
            self._worklist.record_read(entry)

    def _add(self, entry: Hashable, values: Values, term: CompoundTerm, environment: Environment) -> None:
        if self._is_final:
            return
        has_changed = False
        for position, old in enumerate(values, 1):
            if old is None:
                continue
            new = environment.kinds_of(term, position)
            if new is None or not new.keys() <= old.keys():
                values[position - 1] = join(old, new)
                has_changed = True
        if has_changed:
            self._worklist.schedule_readers(entry)


def create_values(arity: int) -> Values:
    """Return the entry of a term with arguments that have no values yet."""
    return [{} for _ in range(arity)]


def find_own_events(program: ProgramModel, goals: List[Any]) -> Set[Functor]:
    """Return the functors of the events with arguments that only this program produces."""
    produced: Set[Functor] = {state.form.functor for state in program.states}
    heads = [event_raised_by(rule.definition.head) for rule in program.rules]
    raised = [raised_event(term) for term in goals if makes_event(term)]
    for event in (*heads, *raised):
        key = None if event is None else functor_of(event)
        if key is not None:
            produced.add(key)
        elif event.__class__ is Var:
            # Any event may be raised here.
            return set()
    # A rule that is added at run time may raise any event, too.
    if any(term[0] in _RULE_ADDING_GOALS and deref(term[1]).__class__ is Var for term in goals):
        return set()
    external = _find_external_events(program, goals)
    return {key for key in produced if key.arity and key not in external and key.name not in external}


def _find_external_events(program: ProgramModel, goals: List[Any]) -> Set[Hashable]:
    """Return the functors or names of the events that come from elsewhere as well."""
    external: Set[Hashable] = set(OWN_EVENTS)
    for clause in program.clauses:
        if functor_of(clause.head) is _INPUT_EVENT:
            external.update(functors_in_fact(clause.head))
    for term in goals:
        if term[0] in SUBSCRIBE_TO:
            external.add(getattr(deref(term[-1]), "name", ""))
    return external


def find_own_predicates(program: ProgramModel, goals: List[Any]) -> Set[Functor]:
    """Return the functors of the predicates whose clauses are all in the program, or asserted by its goals."""
    asserted = {functor_of(clause_head(term[1])) for term in goals if term[0] in ASSERTING_PREDICATES}
    # ``assertz(X)`` may add a clause to any predicate.
    if None in asserted:
        return set()
    own_keys: Set[Functor] = set()
    for key in {*(functor_of(clause.head) for clause in program.clauses), *asserted}:
        if key is None or not key.arity or program.logic.is_system_predicate(key):
            continue
        predicate = program.logic.database.predicates.get(key)
        # The clauses of a dynamic predicate that no goal changes come from queries and services.
        is_changed_from_outside = predicate is not None and predicate.dynamic and key not in asserted
        # The answers of a table may be combined by modes.
        is_tabled = predicate is not None and predicate.hidden_predicate is not None
        if not is_changed_from_outside and not is_tabled:
            own_keys.add(key)
    return own_keys


def raised_event(goal: CompoundTerm) -> Term:
    """Return the event that a goal raises: for ``new_event(event(E, Interval))`` the inner one."""
    event: Any = deref(goal[1])
    if event.__class__ is tuple and event[0] is _EVENT2 and len(goal) == 2:
        event = deref(event[1])
    raised: Term = event
    return raised


def clause_head(clause: Term) -> Term:
    """Return the head of a clause that a goal asserts."""
    term: Any = deref(clause)
    head: Term = deref(term[1]) if term.__class__ is tuple and term[0] is NECK else term
    return head


class EventSignatures:
    """Types of the arguments of terms: slots of messages, and declared arguments of events."""

    def __init__(self, program: ProgramModel):
        self._program = program
        self._definitions: Dict[Functor, Optional[Definition]] = {}

    def message_of(self, term: Any) -> Optional[Definition]:
        """Return the definition of the message type of a term, or None."""
        if term.__class__ is not tuple:
            return None
        key = term[0]
        if key not in self._definitions:
            self._definitions[key] = self._program.message_of(term)
        return self._definitions[key]

    def declaration_of(self, event: CompoundTerm) -> Optional[Declaration]:
        """Return the declaration of an event, or None."""
        declaration = self._program.declarations.get(event[0].name)
        return declaration if declaration is not None and declaration.key is event[0] else None
