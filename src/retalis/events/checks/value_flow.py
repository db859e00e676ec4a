"""Flow of values through the events, memories, states and predicates of a program.

The analysis is an abstract interpretation: it computes which kinds of values (see `value_kinds`) each argument of an
event, record or predicate can have. Values enter by the slots of messages, by constants, and by goals with known
results. A rule passes those of its pattern to its head, a memory those of its events to its records, and a clause
those of its body to its head.

The parts of the program (rules, clauses with variables, memories, states, goals) are evaluated until nothing changes:
a part is evaluated again if something that it has read gets a new kind. Kinds are only added and their number is
bounded, so the time is linear in the size of the program, and recursion ends. Facts are read once.

The results are upper bounds. Whatever is not known has all kinds: events of other programs (``input_event/1``, or no
producer in this one), results of other goals, tabled predicates, and dynamic predicates that are changed from outside
only. A last pass over all parts reports where two sets of values have nothing in common. It leaves uses of a
variable of a slot in the same rule to the checks in `variable_type_checks`.
"""

from collections import deque
from typing import (
    Any,
    Callable,
    Deque,
    Dict,
    Hashable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

from ...foundation.errors import Place, RuleError
from ...messages.type_definition import Definition
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import COMMA, TRUE, Atom, CompoundTerm, Functor, Term, Var, deref, functor
from ..knowledge.knowledge_base import OWN_EVENTS
from ..language.event_declarations import Declaration
from ..language.pattern_parser import PlaceLookup
from ..language.pattern_tree import (
    AbsencePattern,
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    EventPattern,
    KleenePattern,
    NotPattern,
    OrPattern,
    Pattern,
    WindowPattern,
    children,
)
from ..language.rule_heads import ALARMS, SYNCHRONIZED, event_raised_by, makes_event
from ..language.state_parser import HOLDS
from ..streams.aggregates import AGGREGATES
from .condition_checks import IS, NUMERIC_COMPARISONS
from .event_flow_checks import SUBSCRIBE_TO, functors_in_fact
from .memory_checks import RECORD_READS
from .predicate_checks import ASSERTING_PREDICATES
from .program_model import (
    NECK,
    EventConsumer,
    ProgramModel,
    SourceRule,
    StateDeclaration,
    key_of,
    subterms,
    wrap_term,
)
from .value_kinds import (
    ATOM,
    BOOL,
    COMPOUND,
    DESCRIPTIONS,
    LIST,
    NUMBER,
    STAMP,
    STRING,
    TEXT,
    WORD,
    Kinds,
    ValueOrigin,
    advise,
    advise_conversion,
    are_disjoint,
    conversion_to_text,
    describe,
    join,
    kind_of,
    kinds_of_slot,
    kinds_of_type,
    meet,
    numeric_kinds,
    overlaps,
)

MAX_NESTING = 100
"""Maximum depth of nested patterns and goals that are followed; deeper ones are not evaluated."""

_INPUT_EVENT, _REV, _EVENT2 = functor("input_event", 1), functor("rev", 1), functor("event", 2)
_UNIFICATIONS = frozenset((functor("=", 2), functor("==", 2)))
_INEQUALITIES = frozenset((functor("\\=", 2), functor("\\==", 2)))
_OR, _NOT = functor(";", 2), functor("\\+", 1)
_CONDITIONALS = frozenset((functor("->", 2), functor("*->", 2)))
_TRANSPARENT = frozenset((functor("call", 1), functor("once", 1)))
_LOCAL_GOALS = {
    _NOT: (1,),
    functor("ignore", 1): (1,),
    functor("forall", 2): (1, 2),
    functor("findall", 3): (2,),
    functor("findall", 4): (2,),
    functor("aggregate_all", 3): (2,),
    functor("catch", 3): (1,),
}
"""Goals whose arguments are goals with solutions that bind no variable, or not for certain; with their positions."""

_RESULTS = {
    functor("findall", 3): {3: LIST},
    functor("atom_number", 2): {2: NUMBER},
    functor("atom_length", 2): {2: NUMBER},
    functor("string_length", 2): {2: NUMBER},
    functor("length", 2): {2: NUMBER},
    functor("number_string", 2): {1: NUMBER},
    functor("between", 3): {3: NUMBER},
    functor("atom_string", 2): {2: STRING},
    functor("string_concat", 3): {3: STRING},
}
"""Built-in predicates with the kinds of their results, by position."""

_RULE_ADDING_GOALS = frozenset(
    functor(name, arity)
    for name, arity in (("ins_event_rule", 1), ("ins_event_rule", 2), ("compile_event_rules", 1))
)
"""Goals that add rules: if their argument is a variable, events may have other producers."""

_NUMERIC_RESULTS = frozenset(("count", "rate", "count_distinct"))
_LIST_RESULTS = frozenset(("list", "distinct"))
_ELEMENT_RESULTS = frozenset(("first", "last"))
_ACCEPTED_AS_TEXT = (ATOM, STRING, BOOL)
_NUMBER_ADVICE = {
    TEXT: "compare texts with == or \\==",
    BOOL: "write == true or == false",
    STRING: "compare strings with == or \\==",
    ATOM: "compare atoms with == or \\==",
    LIST: "take a number of it, as with nth0/3 or array_min/2",
}

Values = List[Kinds]
"""Kinds of the arguments of an event, record or predicate."""


class _Known(NamedTuple):
    """Kinds of a variable, and whether the slots or declared arguments of its own rule give them as well."""

    kinds: Kinds
    is_direct: bool


Bindings = Dict[Var, _Known]


class _Part(NamedTuple):
    """Part of a program that is evaluated as a whole.

    Attributes:
        subject: the rule, clause, memory, state or goal.
        names: names of its variables.
        place_of: returns the places of its terms.
        place: its own place, for terms without one.
        prefix: beginning of findings, which names it if its place is unknown.
    """

    subject: Any
    names: Mapping[Var, str]
    place_of: PlaceLookup
    place: Optional[Place]
    prefix: str = ""


class _ClauseTerm(NamedTuple):
    """Head and body of a clause; the head is None for a goal, and the body an argument of ``parent``."""

    head: Optional[Term]
    parent: CompoundTerm
    position: int


class ValueFlow:
    """Kinds of the values in a program, and the contradictions between them.

    Args:
        program: the program.

    Attributes:
        impossible_values: constants in patterns of events that no such event has.
        type_conflicts: comparisons, calls and reads with values that are never equal.
    """

    def __init__(self, program: ProgramModel):
        self._program = program
        self.impossible_values: List[RuleError] = []
        self.type_conflicts: List[RuleError] = []
        self._events: Dict[Functor, Values] = {}
        self._predicates: Dict[Functor, Values] = {}
        self._records: Dict[str, Dict[Optional[Functor], Values]] = {}
        self._message_definitions: Dict[Functor, Optional[Definition]] = {}
        self._goals: List[Any] = [
            subterm.term for subterm in program.all_subterms() if subterm.term.__class__ is tuple
        ]
        self._has_unknown_records = False
        self._parts: List[_Part] = []
        self._readers: Dict[Hashable, Set[int]] = {}
        self._pending: Deque[int] = deque()
        self._is_pending: List[bool] = []
        self._reports = False
        self._index = 0
        self._part: Any = None
        self._calls: Dict[Functor, Callable[[CompoundTerm, Bindings], None]] = {
            **dict.fromkeys((*_UNIFICATIONS, *_INEQUALITIES), self._compare),
            **dict.fromkeys(NUMERIC_COMPARISONS, self._compare_numbers),
            IS: self._evaluate_number,
            **dict.fromkeys(RECORD_READS, self._read_record),
            **dict.fromkeys(HOLDS, self._query_state),
            **dict.fromkeys(ASSERTING_PREDICATES, self._assert_clause),
            functor("retract", 1): self._retract_fact,
        }
        self._define_events()
        self._define_predicates()
        self._define_memories()
        self._collect_parts()
        self._compute_fixpoint()
        self._report_conflicts()

    def kinds_of_event(self, key: Functor) -> Optional[Values]:
        """Return the kinds of the arguments of an event that only this program produces; None for other events."""
        return self._events.get(key)

    # Initial values

    def _define_events(self) -> None:
        """Find the events that only this program produces."""
        program = self._program
        produced: Set[Functor] = {state.form.functor for state in program.states}
        heads = [event_raised_by(rule.definition.head) for rule in program.rules]
        raised = [_raised_event(term) for term in self._goals if makes_event(term)]
        for event in (*heads, *raised):
            key = None if event is None else key_of(event)
            if key is not None:
                produced.add(key)
            elif event.__class__ is Var:
                # Any event may be raised here.
                return
        # A rule that is added at run time may raise any event, too.
        if any(term[0] in _RULE_ADDING_GOALS and deref(term[1]).__class__ is Var for term in self._goals):
            return
        external = self._find_external_events()
        self._events = {
            key: [{} for _ in range(key.arity)]
            for key in produced
            if key.arity and key not in external and key.name not in external
        }

    def _find_external_events(self) -> Set[Hashable]:
        """Return the functors or names of the events that come from elsewhere as well."""
        external: Set[Hashable] = set(OWN_EVENTS)
        for clause in self._program.clauses:
            if key_of(clause.head) is _INPUT_EVENT:
                external.update(functors_in_fact(clause.head))
        for term in self._goals:
            if term[0] in SUBSCRIBE_TO:
                external.add(getattr(deref(term[-1]), "name", ""))
        return external

    def _define_predicates(self) -> None:
        """Find the predicates whose clauses are all in the program, or asserted by its goals."""
        program = self._program
        asserted = {key_of(_clause_head(term[1])) for term in self._goals if term[0] in ASSERTING_PREDICATES}
        # ``assertz(X)`` may add a clause to any predicate.
        if None in asserted:
            return
        keys = {key_of(clause.head) for clause in program.clauses}
        for key in (*keys, *asserted):
            if key is None or not key.arity or program.logic.is_system_predicate(key):
                continue
            predicate = program.logic.database.predicates.get(key)
            # The clauses of a dynamic predicate that no goal changes come from queries and services.
            is_changed_from_outside = predicate is not None and predicate.dynamic and key not in asserted
            # The answers of a table may be combined by modes.
            is_tabled = predicate is not None and predicate.hidden_predicate is not None
            if not is_changed_from_outside and not is_tabled:
                self._predicates[key] = [{} for _ in range(key.arity)]

    def _define_memories(self) -> None:
        for memory in self._program.memories:
            name = deref(memory.term[4])
            if isinstance(name, Atom):
                self._records.setdefault(name.name, {})
            else:
                # A memory whose name is computed at run time may be any of those that are read.
                self._has_unknown_records = True

    def _collect_parts(self) -> None:
        program = self._program
        for clause in program.clauses:
            head = clause.head
            key = key_of(head)
            has_body = clause.parent[0] is NECK
            if key is None:
                continue
            if not has_body and key in self._predicates:
                self._add_fact(key, head, clause.place_of)
            if has_body or variables(head or TRUE):
                self._parts.append(
                    _Part(
                        _ClauseTerm(head, clause.parent, clause.position),
                        program.names,
                        clause.place_of,
                        clause.place,
                    )
                )
        for goal in program.goals:
            self._parts.append(
                _Part(_ClauseTerm(None, goal.parent, goal.position), program.names, goal.place_of, goal.place)
            )
        for state in program.states:
            self._parts.append(_Part(state, program.names, state.place_of, None, state.prefix))
        for rule in program.rules:
            self._parts.append(_Part(rule, rule.definition.names, rule.place_of, rule.definition.place))
        for consumer in (*program.memories, *program.subscriptions):
            self._parts.append(_Part(consumer, program.names, consumer.place_of, None, consumer.prefix))

    def _add_fact(self, key: Functor, fact: Any, place_of: PlaceLookup) -> None:
        """Add the constants of a fact; its variables are added by the part of the fact."""
        for position, values in enumerate(self._predicates[key], 1):
            kind = kind_of(fact[position])
            # Most facts of a table add nothing, so their places are not computed.
            if kind is not None and values is not None and kind not in values:
                origin = ValueOrigin("", deref(fact[position]), place_of(fact, position))
                self._predicates[key][position - 1] = join(values, {kind: origin})
            elif kind is None:
                self._predicates[key][position - 1] = None

    # Fixpoint

    def _compute_fixpoint(self) -> None:
        self._pending.extend(range(len(self._parts)))
        self._is_pending = [True] * len(self._parts)
        while self._pending:
            self._index = self._pending.popleft()
            self._is_pending[self._index] = False
            self._evaluate(self._parts[self._index])

    def _report_conflicts(self) -> None:
        self._reports = True
        for part in self._parts:
            self._evaluate(part)

    def _evaluate(self, part: _Part) -> None:
        self._part = part
        subject = part.subject
        if isinstance(subject, SourceRule):
            self._evaluate_rule(subject)
        elif isinstance(subject, EventConsumer):
            self._evaluate_consumer(subject)
        elif isinstance(subject, StateDeclaration):
            self._evaluate_state(subject)
        else:
            bindings: Bindings = {}
            self._run_goal(subject.parent, subject.position, bindings, 0)
            key = key_of(subject.head) if subject.head is not None else None
            if key in self._predicates:
                self._write(("predicate", key), self._predicates[key], subject.head, bindings)

    def _read(self, name: Hashable) -> None:
        if not self._reports:
            self._readers.setdefault(name, set()).add(self._index)

    def _write(self, name: Hashable, values: Values, term: Any, bindings: Bindings) -> None:
        """Add the arguments of a term to the values of an event, record or predicate."""
        if self._reports or term.__class__ is not tuple:
            return
        has_changed = False
        for position in range(1, len(term)):
            old = values[position - 1]
            if old is None:
                continue
            new = self._kinds_of(term, position, bindings)
            if new is None or not new.keys() <= old.keys():
                values[position - 1] = join(old, new)
                has_changed = True
        if has_changed:
            self._schedule_readers(name)

    def _schedule_readers(self, name: Hashable) -> None:
        for index in self._readers.get(name, ()):
            if not self._is_pending[index]:
                self._is_pending[index] = True
                self._pending.append(index)

    def _kinds_of(self, term: CompoundTerm, position: int, bindings: Bindings) -> Kinds:
        """Return the kinds of an argument of a term."""
        value: Any = deref(term[position])
        if value.__class__ is Var:
            known = bindings.get(value)
            return None if known is None else known.kinds
        kind = kind_of(value)
        return None if kind is None else {kind: ValueOrigin("", value, self._part.place_of(term, position))}

    # Rules, memories, states

    def _evaluate_rule(self, rule: SourceRule) -> None:
        bindings: Bindings = {}
        self._bind_pattern(rule.definition.pattern, bindings, 0)
        head: Any = rule.definition.head
        if head is None:
            return
        head = deref(head)
        while head.__class__ is tuple and (head[0] in ALARMS or head[0] in SYNCHRONIZED):
            if head[0] in SYNCHRONIZED:
                self._run_goal(head, 2, bindings, 0)
            head = deref(head[1])
        self._raise_event(head, bindings)

    def _raise_event(self, event: Any, bindings: Bindings) -> None:
        """Add an event that the program emits, and check its message slots."""
        if event.__class__ is not tuple:
            return
        if event[0] in self._events:
            self._write(("event", event[0]), self._events[event[0]], event, bindings)
        if self._reports:
            self._check_created_term(event, bindings)

    def _evaluate_consumer(self, consumer: EventConsumer) -> None:
        bindings: Bindings = {}
        event = consumer.event
        self._bind_event(event.term, bindings)
        condition_list: Any = deref(consumer.term[2])
        while condition_list.__class__ is tuple and len(condition_list) == 3:
            self._run_goal(condition_list, 1, bindings, 0)
            condition_list = deref(condition_list[2])
        output: Any = deref(consumer.output_term)
        name = deref(consumer.term[4])
        if consumer.term[0].name == "subscribe":
            if self._reports and output.__class__ is tuple:
                self._check_created_term(output, bindings)
            return
        if not isinstance(name, Atom) or self._reports:
            return
        records = self._records[name.name]
        if output.__class__ is tuple:
            values = records.setdefault(output[0], [{} for _ in output[1:]])
            self._write(("memory", name.name), values, output, bindings)
        else:
            values = records.setdefault(None, [{}])
            self._write(("memory", name.name), values, wrap_term(output), bindings)

    def _evaluate_state(self, state: StateDeclaration) -> None:
        form = state.form
        bindings: Bindings = {}
        self._bind_event(form.begin_event, bindings)
        self._bind_event(form.end_event, dict(bindings))
        self._raise_event(deref(form.state), bindings)

    # Patterns

    def _bind_pattern(self, pattern: Pattern, bindings: Bindings, depth: int) -> None:
        """Bind the variables of a pattern: first those of its events, then those of its conditions and results."""
        if depth > MAX_NESTING:
            return
        events: List[EventPattern] = []
        conditions: List[Pattern] = []
        nested: List[Pattern] = []
        stack: List[Pattern] = [pattern]
        while stack:
            node = stack.pop()
            if isinstance(node, EventPattern):
                events.append(node)
            elif isinstance(node, (NotPattern, AbsencePattern, OrPattern, KleenePattern, AggregatePattern)):
                nested.append(node)
                # The operand that each match contains.
                stack += () if isinstance(node, OrPattern) else children(node)[:1]
            else:
                conditions.append(node)
                stack += children(node)
        # The nodes were visited from right to left, and outer ones before inner ones.
        for event in reversed(events):
            self._bind_event(event.term, bindings)
        for node in reversed(nested):
            self._bind_nested_pattern(node, bindings, depth + 1)
        for node in reversed(conditions):
            if isinstance(node, WindowPattern):
                self._bind_window(node, bindings)
            elif isinstance(node, (ConditionPattern, ActionPattern)):
                self._run_goal(wrap_term(node.goal), 1, bindings, depth)

    def _bind_nested_pattern(self, node: Pattern, bindings: Bindings, depth: int) -> None:
        """Evaluate a part of a pattern whose variables a match does not bind, or not in each branch."""
        if isinstance(node, OrPattern):
            self._bind_alternatives(node, bindings, depth)
        elif isinstance(node, (NotPattern, AbsencePattern)):
            self._bind_pattern(node.negated, dict(bindings), depth)
        elif isinstance(node, KleenePattern):
            self._bind_pattern(node.repeated, dict(bindings), depth)
        elif isinstance(node, AggregatePattern):
            collected = dict(bindings)
            self._bind_pattern(node.collected, collected, depth)
            kinds = self._kinds_of_result(node.kind, node.value, collected, None)
            self._bind_argument(wrap_term(node.result), 1, kinds, False, bindings, None)

    def _bind_alternatives(self, node: OrPattern, bindings: Bindings, depth: int) -> None:
        """Bind the variables that each branch binds."""
        branches: List[Bindings] = []
        for branch in node.branches:
            branches.append(dict(bindings))
            self._bind_pattern(branch, branches[-1], depth)
        for var, first in branches[0].items():
            entries = [branch[var] for branch in branches if var in branch]
            if len(entries) == len(branches):
                kinds = first.kinds
                for entry in entries:
                    kinds = join(kinds, entry.kinds)
                bindings[var] = _Known(kinds, any(entry.is_direct for entry in entries))

    def _bind_window(self, node: WindowPattern, bindings: Bindings) -> None:
        for goal in node.window.goals:
            self._run_goal(wrap_term(goal), 1, dict(bindings), 0)
        results: List[Kinds] = [
            self._kinds_of_result(kind, value, bindings, node) for kind, value in zip(node.kinds, node.values)
        ]
        if not node.is_listed and len(node.results) == len(results):
            for result, kinds in zip(node.results, results):
                self._bind_argument(wrap_term(result), 1, kinds, False, bindings, None)
            return
        for result in node.results:
            items = list_items(result)
            if items is None or len(items) != len(results):
                self._bind_argument(
                    wrap_term(result), 1, {LIST: ValueOrigin("list of results")}, False, bindings, None
                )
                continue
            for item, kinds in zip(items, results):
                self._bind_argument(wrap_term(item), 1, kinds, False, bindings, None)

    def _kinds_of_result(
        self, kind: str, value: Optional[Term], bindings: Bindings, window: Optional[WindowPattern]
    ) -> Kinds:
        """Return the kinds of the result of an aggregate, and check the measured values."""
        origin = ValueOrigin(f"result of {kind}")
        if kind in _LIST_RESULTS:
            return {LIST: origin}
        measured: Any = None if value is None else deref(value)
        known = bindings.get(measured) if measured.__class__ is Var else None
        kinds = None if known is None else known.kinds
        function = AGGREGATES.get(kind)
        is_numeric = function is not None and function.is_numeric
        if is_numeric and known is not None and kinds and not known.is_direct and self._reports:
            # Windows aggregate arrays element by element.
            accepts_lists = window is not None and function is not None and function.accepts_arrays
            refused = set(_NUMBER_ADVICE) - ({LIST} if accepts_lists else set())
            if set(kinds) <= refused:
                self._report(
                    f"{self._name(measured)} is {self._describe(kinds)}: {kind} collects numbers", None
                )
        if kind in _NUMERIC_RESULTS:
            return {NUMBER: origin}
        if kind in _ELEMENT_RESULTS:
            return kinds if measured.__class__ is Var else None
        # Measures of arrays are arrays, and the smallest timestamp is a timestamp.
        if is_numeric and kinds and set(kinds) <= {NUMBER, WORD}:
            return {NUMBER: origin}
        return None

    def _bind_event(self, event: Term, bindings: Bindings) -> None:
        """Bind the variables of an event, and check its constants."""
        term: Any = deref(event)
        if term.__class__ is tuple and term[0] is _REV:
            term = deref(term[1])
        stack = [term]
        while stack:
            term = stack.pop()
            if term.__class__ is not tuple:
                continue
            definition = self._message_of(term)
            if definition is not None:
                for position, slot in enumerate(definition.fields, 1):
                    kinds = kinds_of_slot(slot, f"{slot.name} of {definition.name}")
                    self._bind_variable(term, position, kinds, True, bindings, "")
                stack += [deref(argument) for argument in term[1:]]
                continue
            if term[0] not in self._events and self._declaration_of(term) is None:
                continue
            self._read(("event", term[0]))
            for position, (kinds, is_direct) in enumerate(self._values_of_event(term), 1):
                if is_direct:
                    self._bind_variable(term, position, kinds, True, bindings, "")
                else:
                    self._bind_argument(
                        term, position, kinds, True, bindings, f"argument {position} of {term[0]}"
                    )
            # Messages in arguments have slots of known types.
            stack += [argument for argument in map(deref, term[1:]) if self._message_of(argument) is not None]

    def _values_of_event(self, term: CompoundTerm) -> Iterator[Tuple[Kinds, bool]]:
        """Yield the kinds of the arguments of an event, and whether they are declared."""
        declaration = self._declaration_of(term)
        if declaration is None:
            for kinds in self._events[term[0]]:
                yield kinds, False
        else:
            for argument in declaration.arguments:
                yield kinds_of_type(argument.value_type, f"{argument.name} of {declaration.key}"), True

    def _declaration_of(self, term: CompoundTerm) -> Optional[Declaration]:
        declaration = self._program.declarations.get(term[0].name)
        return declaration if declaration is not None and declaration.key is term[0] else None

    def _message_of(self, term: Any) -> Optional[Definition]:
        """Return the definition of the message type of a term, or None."""
        if term.__class__ is not tuple:
            return None
        key = term[0]
        if key not in self._message_definitions:
            self._message_definitions[key] = self._program.message_of(term)
        return self._message_definitions[key]

    def _bind_variable(
        self,
        term: CompoundTerm,
        position: int,
        kinds: Kinds,
        is_direct: bool,
        bindings: Bindings,
        subject: str,
    ) -> None:
        if deref(term[position]).__class__ is Var:
            self._bind_argument(term, position, kinds, is_direct, bindings, subject)

    def _bind_argument(
        self,
        term: CompoundTerm,
        position: int,
        kinds: Kinds,
        is_event: bool,
        bindings: Bindings,
        subject: Optional[str],
    ) -> None:
        """Bind or check an argument whose values have certain kinds.

        Args:
            term: the term.
            position: the position of the argument.
            kinds: kinds of its values.
            is_event: whether the term is an event.
            bindings: kinds of variables; changed.
            subject: name of the argument in findings; "" for a slot or declared argument, None for a result.
        """
        if kinds is None:
            return
        value: Any = deref(term[position])
        if value.__class__ is Var:
            is_direct = subject == ""
            known = bindings.get(value)
            if known is None or known.kinds is None:
                bindings[value] = _Known(kinds, is_direct)
                return
            if self._reports and are_disjoint(known.kinds, kinds) and not (known.is_direct and is_direct):
                self._report_clash(value, known.kinds, kinds, subject or "", self._place(term, position))
            bindings[value] = _Known(meet(known.kinds, kinds), known.is_direct or is_direct)
            return
        kind = kind_of(value)
        if self._reports and kind is not None and kinds and not overlaps(kind, kinds):
            advice = advise(kinds, value, self._show)
            text = f"{subject or 'this'} is {self._describe(kinds)}, never {self._show(value)}"
            self._report(
                f"{text}: {advice}" if advice else text,
                self._place(term, position),
                is_value=is_event and bool(subject),
            )

    # Goals

    def _run_goal(self, parent: CompoundTerm, position: int, bindings: Bindings, depth: int) -> None:
        """Bind the variables of a goal that succeeds, in the order of its calls."""
        if depth > MAX_NESTING:
            return
        pending = [(parent, position)]
        while pending:
            parent, position = pending.pop()
            goal: Any = deref(parent[position])
            if goal.__class__ is not tuple:
                continue
            key = goal[0]
            if key is COMMA:
                pending += [(goal, 2), (goal, 1)]
            elif key in _TRANSPARENT:
                pending.append((goal, 1))
            elif key is _OR or key in _CONDITIONALS:
                self._run_alternatives(goal, bindings, depth)
            elif key in _LOCAL_GOALS:
                for goal_position in _LOCAL_GOALS[key]:
                    self._run_goal(goal, goal_position, dict(bindings), depth + 1)
                self._bind_results(goal, bindings)
            else:
                self._run_call(goal, bindings)

    def _run_alternatives(self, goal: CompoundTerm, bindings: Bindings, depth: int) -> None:
        """Evaluate the branches of a disjunction or conditional, whose bindings are not known afterwards."""
        branches = [goal]
        while branches:
            branch = branches.pop()
            if branch[0] is _OR:
                for position in (1, 2):
                    inner: Any = deref(branch[position])
                    if inner.__class__ is tuple and (inner[0] is _OR or inner[0] in _CONDITIONALS):
                        branches.append(inner)
                    else:
                        self._run_goal(branch, position, dict(bindings), depth + 1)
            else:
                branch_bindings = dict(bindings)
                self._run_goal(branch, 1, branch_bindings, depth + 1)
                self._run_goal(branch, 2, branch_bindings, depth + 1)

    def _run_call(self, goal: CompoundTerm, bindings: Bindings) -> None:
        key = goal[0]
        run = self._calls.get(key)
        if key in self._predicates:
            self._call_predicate(goal, bindings)
        elif run is not None:
            run(goal, bindings)
        elif makes_event(goal):
            self._raise_event(_raised_event(goal), bindings)
        else:
            self._bind_results(goal, bindings)

    def _call_predicate(self, goal: CompoundTerm, bindings: Bindings) -> None:
        key = goal[0]
        self._read(("predicate", key))
        for position, kinds in enumerate(self._predicates[key], 1):
            self._bind_argument(goal, position, kinds, False, bindings, f"argument {position} of {key}")

    def _compare_numbers(self, goal: CompoundTerm, bindings: Bindings) -> None:
        for position in (1, 2):
            self._check_number(goal, position, bindings)

    def _evaluate_number(self, goal: CompoundTerm, bindings: Bindings) -> None:
        self._check_number(goal, 2, bindings)
        # A constant as the result is a mistake of one goal, no flow.
        if deref(goal[1]).__class__ is Var:
            self._bind_argument(
                goal, 1, {NUMBER: ValueOrigin("result of is")}, False, bindings, "the result of is"
            )

    def _query_state(self, goal: CompoundTerm, bindings: Bindings) -> None:
        state: Any = deref(goal[1])
        if state.__class__ is tuple and state[0] in self._events:
            self._read(("event", state[0]))
            for position, kinds in enumerate(self._events[state[0]], 1):
                self._bind_argument(
                    state, position, kinds, False, bindings, f"argument {position} of {state[0]}"
                )

    def _assert_clause(self, goal: CompoundTerm, bindings: Bindings) -> None:
        head: Any = _clause_head(goal[1])
        if head.__class__ is tuple and head[0] in self._predicates:
            self._write(("predicate", head[0]), self._predicates[head[0]], head, bindings)

    def _retract_fact(self, goal: CompoundTerm, bindings: Bindings) -> None:
        fact: Any = deref(goal[1])
        if fact.__class__ is tuple and fact[0] in self._predicates:
            self._call_predicate(fact, bindings)

    def _bind_results(self, goal: CompoundTerm, bindings: Bindings) -> None:
        if goal[0] in _RESULTS and self._program.logic.is_system_predicate(goal[0]):
            for position, kind in _RESULTS[goal[0]].items():
                kinds = {kind: ValueOrigin(f"result of {goal[0]}")}
                self._bind_argument(goal, position, kinds, False, bindings, f"the result of {goal[0]}")

    def _read_record(self, goal: CompoundTerm, bindings: Bindings) -> None:
        """Bind the variables of a record that a goal reads from a memory."""
        name, record = deref(goal[1]), deref(goal[2])
        if not isinstance(name, Atom) or name.name not in self._records or self._has_unknown_records:
            return
        self._read(("memory", name.name))
        records = self._records[name.name]
        subject = f"the record of memory {name.name}"
        if record.__class__ is tuple and None not in records:
            # A record that has not been computed yet has no values: with unknown ones, the result would stay unknown.
            values = records.get(record[0], [{} for _ in record[1:]])
            for position, kinds in enumerate(values, 1):
                self._bind_argument(
                    record, position, kinds, False, bindings, f"argument {position} of {subject}"
                )
        elif record.__class__ is Var or set(records) == {None}:
            # Constants and terms of another form are reported by `find_record_mismatches`.
            record_kinds: Kinds = {}
            for key, values in records.items():
                record_kinds = join(
                    record_kinds, values[0] if key is None else {COMPOUND: ValueOrigin(subject)}
                )
            self._bind_argument(goal, 2, record_kinds, False, bindings, subject)

    def _compare(self, goal: CompoundTerm, bindings: Bindings) -> None:
        """Bind or check the two sides of ``=`` or ``==``, or check those of their negations."""
        left: Any
        right: Any
        left, right = deref(goal[1]), deref(goal[2])
        is_equal = goal[0] in _UNIFICATIONS
        for other_position, var, other in ((2, left, right), (1, right, left)):
            if var.__class__ is not Var:
                continue
            known = bindings.get(var)
            kinds = self._kinds_of(goal, other_position, bindings)
            if known is not None and known.kinds and kinds and are_disjoint(known.kinds, kinds):
                other_known = bindings.get(other) if other.__class__ is Var else None
                # `find_type_conflicts` reports slots of messages in one rule.
                is_direct = known.is_direct and (
                    other.__class__ is not Var or (other_known or known).is_direct
                )
                if self._reports and not is_direct:
                    self._report_comparison(goal, other_position, var, known.kinds, kinds)
                    return
            if is_equal and kinds is not None:
                bindings[var] = (
                    _Known(kinds, False)
                    if known is None
                    else _Known(meet(known.kinds, kinds), known.is_direct)
                )

    def _report_comparison(
        self, goal: CompoundTerm, other_position: int, var: Var, kinds: Kinds, other_kinds: Kinds
    ) -> None:
        other: Any = deref(goal[other_position])
        place = self._place(goal, other_position)
        if other.__class__ is Var:
            self._report_clash(var, kinds, other_kinds, self._name(other), place)
            return
        advice = advise(kinds or {}, other, self._show)
        text = f"{self._name(var)} is {self._describe(kinds)}, never {self._show(other)}"
        self._report(f"{text}: {advice}" if advice else text, place)

    def _check_number(self, goal: CompoundTerm, position: int, bindings: Bindings) -> None:
        """Check the variables of an arithmetic expression; those that are compared are numbers afterwards."""
        operands = [(goal, position)]
        while operands:
            parent, operand_position = operands.pop()
            term: Any = deref(parent[operand_position])
            if term.__class__ is tuple and term[0].name not in ("[|]", "."):
                operands += [(term, argument_position) for argument_position in range(len(term) - 1, 0, -1)]
            if term.__class__ is not Var:
                continue
            known = bindings.get(term)
            if known is None or known.kinds is None:
                bindings[term] = _Known(numeric_kinds(), False)
            elif known.kinds and are_disjoint(known.kinds, numeric_kinds()):
                if self._reports and not known.is_direct:
                    advice = _NUMBER_ADVICE[next(iter(known.kinds))]
                    self._report(
                        f"{self._name(term)} is {self._describe(known.kinds)}, not a number: {advice}",
                        self._place(parent, operand_position),
                    )
                # One finding for each variable is enough.
                bindings[term] = _Known(None, known.is_direct)

    # Created messages

    def _check_created_term(self, term: CompoundTerm, bindings: Bindings) -> None:
        """Report values that do not fit the slots or declared arguments that they are put into."""
        for subterm in subterms(wrap_term(term), 1, self._part.place_of):
            definition = self._message_of(subterm.term)
            expected: List[Tuple[int, str, Kinds]] = []
            if definition is not None:
                for position, slot in enumerate(definition.fields, 1):
                    # Truth values can be written as 0 and 1, and bytes as lists.
                    accepts_others = slot.is_bytes or (slot.type == "bool" and slot.length is None)
                    if not accepts_others:
                        name = f"{slot.name} of {definition.name}"
                        expected.append((position, name, kinds_of_slot(slot, name)))
            elif subterm.term is term:
                declaration = self._declaration_of(term)
                for position, argument in enumerate(() if declaration is None else declaration.arguments, 1):
                    name = f"{argument.name} of {term[0]}"
                    expected.append((position, name, kinds_of_type(argument.value_type, name)))
            for position, name, kinds in expected:
                self._check_created_argument(subterm.term, position, name, kinds, bindings)

    def _check_created_argument(
        self, term: CompoundTerm, position: int, slot: str, kinds: Kinds, bindings: Bindings
    ) -> None:
        value: Any = deref(term[position])
        known = bindings.get(value) if value.__class__ is Var else None
        if known is None or known.is_direct or not known.kinds or not kinds:
            return
        accepted = dict(kinds)
        # Texts are also written for names and strings, and stamps for ``datime`` terms.
        for kind in _ACCEPTED_AS_TEXT if TEXT in kinds else (LIST, COMPOUND) if STAMP in kinds else ():
            accepted.setdefault(kind, ValueOrigin(slot))
        # A name such as ``pi`` is written as text, too, although it overlaps with numbers.
        if not are_disjoint(known.kinds, accepted) or (TEXT in kinds and WORD in known.kinds):
            return
        name = self._name(value)
        advice = conversion_to_text(name) if TEXT in kinds else advise_conversion(known.kinds, kinds, name)
        target = " or ".join(DESCRIPTIONS[kind] for kind in kinds)
        self._report(
            f"{name} is {self._describe(known.kinds)} and goes into {target} ({slot}): "
            f"{advice or 'send another value'}",
            self._place(term, position),
        )

    # Findings

    def _report_clash(
        self, var: Var, first: Kinds, second: Kinds, subject: str, place: Optional[Place]
    ) -> None:
        name = self._name(var)
        text = f"{name} is {self._describe(first)}, and {subject or 'here it'} is {self._describe(second)}"
        advice = advise_conversion(first, second, name)
        self._report(f"{text}: these are never equal{f'; {advice}' if advice else ''}", place)

    def _report(self, message: str, place: Optional[Place], is_value: bool = False) -> None:
        part = self._part
        errors = self.impossible_values if is_value else self.type_conflicts
        errors.append(RuleError(f"{part.prefix}{message}", place or part.place))

    def _place(self, term: CompoundTerm, position: int) -> Optional[Place]:
        place: Optional[Place] = self._part.place_of(term, position)
        return place

    def _name(self, var: Var) -> str:
        return self._part.names.get(var) or self._program.names.get(var) or "this variable"

    def _describe(self, kinds: Kinds) -> str:
        place = self._part.place
        return describe(kinds or {}, self._show, None if place is None else place.source)

    def _show(self, term: Term) -> str:
        return self._program.brief(term)


def _raised_event(goal: CompoundTerm) -> Term:
    """Return the event that a goal raises: for ``new_event(event(E, Interval))`` the inner one."""
    event: Any = deref(goal[1])
    if event.__class__ is tuple and event[0] is _EVENT2 and len(goal) == 2:
        event = deref(event[1])
    raised: Term = event
    return raised


def _clause_head(clause: Term) -> Term:
    """Return the head of a clause that a goal asserts."""
    term: Any = deref(clause)
    head: Term = deref(term[1]) if term.__class__ is tuple and term[0] is NECK else term
    return head


def find_impossible_flows(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the constants in patterns that no event of the program has."""
    yield from program.derive(ValueFlow).impossible_values


def find_conflicting_flows(program: ProgramModel) -> Iterator[RuleError]:
    """Yield the uses of values that contradict their kinds."""
    yield from program.derive(ValueFlow).type_conflicts
