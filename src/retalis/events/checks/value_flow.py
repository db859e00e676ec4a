"""Flow of values through the events, memories, states and predicates of a program.

The analysis is an abstract interpretation: it computes which kinds of values (see `value_kinds`) each argument of an
event, record or predicate can have. Values enter by the slots of messages, by constants, and by goals with known
results. A rule passes those of its pattern to its head, a memory those of its events to its records, and a clause
those of its body to its head.

The transfer functions of patterns and goals (`pattern_transfer`, `goal_transfer`) evaluate the parts of the program
(rules, clauses with variables, memories, states, goals) until nothing changes. A part is evaluated again if
something that it has read (`abstract_store`) gets a new kind. Kinds are only added and their number is bounded, so
the time is linear in the size of the program, and recursion ends. Facts are read once.

The results are upper bounds. Whatever is not known has all kinds: events of other programs (``input_event/1``, or no
producer in this one), results of other goals, tabled predicates, and dynamic predicates that are changed from outside
only. A last pass over all parts reports where two sets of values have nothing in common (`value_conflict_reports`).
`variable_type_checks` compares the uses of a variable of a slot in the same rule.
"""

from typing import Any, Iterator, List, NamedTuple, Optional

from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import TRUE, Atom, CompoundTerm, Functor, Term, deref, functor_of
from ..language.rule_heads import ALARMS, SYNCHRONIZED
from .abstract_environment import Environment
from .abstract_store import AbstractStore, EventSignatures, Values, Worklist
from .created_event_values import CreatedEvents
from .goal_transfer import GoalTransfer
from .pattern_transfer import PatternTransfer
from .program_model import NECK, EventConsumer, ProgramModel, SourceRule, SourceTerm, StateDeclaration
from .value_conflict_reports import ConflictReporter, ProgramPart


class _ClauseTerm(NamedTuple):
    """Head and body of a clause; the head is None for a goal, and the body an argument of ``parent``."""

    head: Optional[Term]
    parent: CompoundTerm
    position: int


class ValueFlow:
    """Kinds of the values in a program, and the contradictions between them.

    Attributes:
        impossible_values: constants in patterns of events that no such event has.
        type_conflicts: comparisons, calls and reads with values that are never equal.
    """

    def __init__(self, program: ProgramModel):
        goals = [subterm.term for subterm in program.all_subterms() if subterm.term.__class__ is tuple]
        worklist = Worklist()
        signatures = EventSignatures(program)
        self._conflicts = conflicts = ConflictReporter(program)
        self._store = store = AbstractStore(program, goals, worklist)
        self._created_events = CreatedEvents(store, signatures, conflicts)
        self._goals = GoalTransfer(program, store, self._created_events, conflicts)
        self._patterns = PatternTransfer(store, signatures, self._goals, conflicts)
        self.impossible_values: List[RuleError] = conflicts.impossible_values
        self.type_conflicts: List[RuleError] = conflicts.type_conflicts
        for clause in program.clauses:
            self._add_constants_of_fact(clause)
        parts = list(_parts_of(program))
        for number in worklist.run(len(parts)):
            self._evaluate(parts[number])
        # The kinds are complete now, so that what has nothing in common never will.
        store.finish()
        conflicts.enable()
        for part in parts:
            self._evaluate(part)

    def kinds_of_event(self, key: Functor) -> Optional[Values]:
        """Return the kinds of the arguments of an event that only this program produces; None for other events."""
        return self._store.kinds_of_event(key)

    def _add_constants_of_fact(self, clause: SourceTerm) -> None:
        key = functor_of(clause.head)
        if key is not None and clause.parent[0] is not NECK and self._store.has_predicate(key):
            self._store.add_fact(key, clause.head, clause.place_of)

    def _evaluate(self, part: ProgramPart) -> None:
        """Apply the transfer function of a part: add the values that it produces to the store."""
        environment = Environment(part, self._conflicts)
        subject = part.subject
        if isinstance(subject, SourceRule):
            self._evaluate_rule(subject, environment)
        elif isinstance(subject, EventConsumer):
            self._evaluate_consumer(subject, environment)
        elif isinstance(subject, StateDeclaration):
            self._evaluate_state(subject, environment)
        else:
            self._evaluate_clause(subject, environment)

    def _evaluate_rule(self, rule: SourceRule, environment: Environment) -> None:
        self._patterns.bind(rule.definition.pattern, environment)
        head: Any = rule.definition.head
        if head is None:
            return
        head = deref(head)
        # The event of an alarm or of a synchronized head is its first argument.
        while head.__class__ is tuple and (head[0] in ALARMS or head[0] in SYNCHRONIZED):
            if head[0] in SYNCHRONIZED:
                self._goals.run(head, 2, environment)
            head = deref(head[1])
        self._created_events.add(head, environment)

    def _evaluate_consumer(self, consumer: EventConsumer, environment: Environment) -> None:
        """Evaluate a memory or subscription: its event, its list of conditions, and its records or outputs."""
        self._patterns.bind_event(consumer.event.term, environment)
        condition_list: Any = deref(consumer.term[2])
        while condition_list.__class__ is tuple and len(condition_list) == 3:
            self._goals.run(condition_list, 1, environment)
            condition_list = deref(condition_list[2])
        output: Any = deref(consumer.output_term)
        if consumer.term[0].name == "subscribe":
            self._created_events.check_slots(output, environment)
            return
        name = deref(consumer.term[4])
        if isinstance(name, Atom):
            self._store.add_record(name.name, output, environment)

    def _evaluate_state(self, state: StateDeclaration, environment: Environment) -> None:
        self._patterns.bind_event(state.form.begin_event, environment)
        # The state has the variables of its begin; those of its end are only compared with them.
        self._patterns.bind_event(state.form.end_event, environment.copy())
        self._created_events.add(deref(state.form.state), environment)

    def _evaluate_clause(self, clause: _ClauseTerm, environment: Environment) -> None:
        self._goals.run(clause.parent, clause.position, environment)
        key = None if clause.head is None else functor_of(clause.head)
        if self._store.has_predicate(key):
            self._store.add_clause(clause.head, environment)


def _parts_of(program: ProgramModel) -> Iterator[ProgramPart]:
    """Yield the parts of a program that are evaluated; facts without variables are not."""
    names = program.names
    for clause in program.clauses:
        has_body = clause.parent[0] is NECK
        if functor_of(clause.head) is not None and (has_body or variables(clause.head or TRUE)):
            term = _ClauseTerm(clause.head, clause.parent, clause.position)
            yield ProgramPart(term, names, clause.place_of, clause.place)
    for goal in program.goals:
        term = _ClauseTerm(None, goal.parent, goal.position)
        yield ProgramPart(term, names, goal.place_of, goal.place)
    for state in program.states:
        yield ProgramPart(state, names, state.place_of, None, state.prefix)
    for rule in program.rules:
        yield ProgramPart(rule, rule.definition.names, rule.place_of, rule.definition.place)
    for consumer in (*program.memories, *program.subscriptions):
        yield ProgramPart(consumer, names, consumer.place_of, None, consumer.prefix)


def find_impossible_flows(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the constants in patterns that no event of the program has."""
    yield from program.derive(ValueFlow).impossible_values


def find_conflicting_flows(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the uses of values that contradict their kinds."""
    yield from program.derive(ValueFlow).type_conflicts
