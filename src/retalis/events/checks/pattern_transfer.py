"""Transfer functions of patterns: the kinds of the variables that a match of a pattern binds."""

from typing import Any, List, NamedTuple, Optional

from ...messages.type_definition import Definition
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.types import CompoundTerm, Term, Var, deref, functor
from ..language.pattern_tree import (
    AbsencePattern,
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    EventPattern,
    KleenePattern,
    NotPattern,
    NotPrecededPattern,
    OrPattern,
    Pattern,
    WindowPattern,
    children,
)
from ..streams.aggregates import AGGREGATES
from .abstract_environment import Environment
from .abstract_store import AbstractStore, EventSignatures
from .goal_transfer import MAX_NESTING, GoalTransfer
from .program_model import wrap_term
from .value_conflict_reports import NUMBER_ADVICE, ConflictReporter
from .value_kinds import LIST, NUMBER, WORD, Kinds, ValueOrigin, kinds_of_slot, kinds_of_type

_REV = functor("rev", 1)
_NUMERIC_RESULTS = frozenset(("count", "rate", "count_distinct", "duration"))
_LIST_RESULTS = frozenset(("list", "distinct"))
_ELEMENT_RESULTS = frozenset(("first", "last"))


class _PatternParts(NamedTuple):
    """Parts of a pattern, in the order of the text.

    Attributes:
        events: events that each match contains.
        nested: parts whose variables a match does not bind, or not in each branch.
        others: conditions, actions, windows and other nodes, inner ones first.
    """

    events: List[EventPattern]
    nested: List[Pattern]
    others: List[Pattern]


class PatternTransfer:
    """Transfer functions of patterns.

    Args:
        store: kinds of the events that only the program produces.
        signatures: types of the slots and declared arguments of events.
        goals: transfer functions of conditions and actions.
        conflicts: receives measured values that are no numbers.
    """

    def __init__(
        self,
        store: AbstractStore,
        signatures: EventSignatures,
        goals: GoalTransfer,
        conflicts: ConflictReporter,
    ):
        self._store = store
        self._signatures = signatures
        self._goals = goals
        self._conflicts = conflicts

    def bind(self, pattern: Pattern, environment: Environment, depth: int = 0) -> None:
        """Bind the variables of a pattern: first those of its events, then those of its conditions and results."""
        if depth > MAX_NESTING:
            return
        parts = _parts_of(pattern)
        for event in parts.events:
            self.bind_event(event.term, environment)
        for node in parts.nested:
            self._bind_nested(node, environment, depth + 1)
        for node in parts.others:
            if isinstance(node, WindowPattern):
                self._bind_window(node, environment)
            elif isinstance(node, (ConditionPattern, ActionPattern)):
                self._goals.run(wrap_term(node.goal), 1, environment, depth)

    def _bind_nested(self, node: Pattern, environment: Environment, depth: int) -> None:
        """Evaluate a part of a pattern whose variables a match does not bind, or not in each branch."""
        if isinstance(node, OrPattern):
            branches: List[Environment] = []
            for branch in node.branches:
                branches.append(environment.copy())
                self.bind(branch, branches[-1], depth)
            environment.bind_common(branches)
        elif isinstance(node, (NotPattern, AbsencePattern, NotPrecededPattern)):
            self.bind(node.negated, environment.copy(), depth)
        elif isinstance(node, KleenePattern):
            self.bind(node.repeated, environment.copy(), depth)
        elif isinstance(node, AggregatePattern):
            collected = environment.copy()
            self.bind(node.collected, collected, depth)
            kinds = self._kinds_of_result(node.kind, node.value, collected, None)
            environment.bind_argument(wrap_term(node.result), 1, kinds, None)

    # Events

    def bind_event(self, event: Term, environment: Environment) -> None:
        """Bind the variables of an event, and check its constants."""
        term: Any = deref(event)
        if term.__class__ is tuple and term[0] is _REV:
            term = deref(term[1])
        unvisited = [term]
        while unvisited:
            term = unvisited.pop()
            if term.__class__ is not tuple:
                continue
            definition = self._signatures.message_of(term)
            arguments = [deref(argument) for argument in term[1:]]
            if definition is not None:
                _bind_slots(term, definition, environment)
                unvisited += arguments
            elif self._bind_arguments(term, environment):
                # Messages in arguments have slots of known types.
                unvisited += [
                    argument for argument in arguments if self._signatures.message_of(argument) is not None
                ]

    def _bind_arguments(self, event: CompoundTerm, environment: Environment) -> bool:
        """Bind the variables in the arguments of an event; return whether their kinds are known."""
        key = event[0]
        declaration = self._signatures.declaration_of(event)
        if declaration is not None:
            for position, argument in enumerate(declaration.arguments, 1):
                kinds = kinds_of_type(argument.value_type, f"{argument.name} of {declaration.key}")
                environment.bind_slot(event, position, kinds)
            return True
        if not self._store.has_event(key):
            return False
        for position, kinds in enumerate(self._store.read_event(key), 1):
            environment.bind_event_argument(event, position, kinds, f"argument {position} of {key}")
        return True

    # Windows and aggregates

    def _bind_window(self, node: WindowPattern, environment: Environment) -> None:
        for goal in node.goals:
            self._goals.run(wrap_term(goal), 1, environment.copy())
        kinds_of_results = [
            self._kinds_of_result(kind, value, environment, node)
            for kind, value in zip(node.kinds, node.values)
        ]
        if not node.is_listed and len(node.results) == len(kinds_of_results):
            _bind_results(node.results, kinds_of_results, environment)
            return
        for result in node.results:
            items = list_items(result)
            if items is not None and len(items) == len(kinds_of_results):
                _bind_results(items, kinds_of_results, environment)
            else:
                kinds: Kinds = {LIST: ValueOrigin("list of results")}
                environment.bind_argument(wrap_term(result), 1, kinds, None)

    def _kinds_of_result(
        self, kind: str, value: Optional[Term], environment: Environment, window: Optional[WindowPattern]
    ) -> Kinds:
        """Return the kinds of the result of an aggregate, and check the measured values.

        Args:
            kind: name of the aggregate.
            value: the value that is measured, or None.
            environment: kinds of the variables of the collected events.
            window: the window of the aggregate; None for repeated events.
        """
        origin = ValueOrigin(f"result of {kind}")
        if kind in _LIST_RESULTS:
            return {LIST: origin}
        measured: Any = None if value is None else deref(value)
        known = None if measured is None else environment.value_of(measured)
        kinds = None if known is None else known.kinds
        accepts_arrays = window is not None and window.window.kind != "held"
        self._check_measured_kinds(kind, measured, environment, accepts_arrays)
        if kind in _NUMERIC_RESULTS:
            return {NUMBER: origin}
        if kind in _ELEMENT_RESULTS:
            return kinds if measured.__class__ is Var else None
        # Measures of arrays are arrays, and the smallest timestamp is a timestamp.
        if _is_numeric(kind) and kinds and set(kinds) <= {NUMBER, WORD}:
            return {NUMBER: origin}
        return None

    def _check_measured_kinds(
        self, kind: str, measured: Any, environment: Environment, accepts_arrays: bool
    ) -> None:
        """Report a variable that an aggregate of numbers collects although it is no number."""
        known = None if measured is None else environment.value_of(measured)
        if not self._conflicts.is_enabled or known is None or not known.kinds or known.is_direct:
            return
        # Windows aggregate arrays element by element.
        accepts_lists = accepts_arrays and kind in AGGREGATES and AGGREGATES[kind].accepts_arrays
        refused = set(NUMBER_ADVICE) - ({LIST} if accepts_lists else set())
        if _is_numeric(kind) and set(known.kinds) <= refused:
            self._conflicts.report_aggregated_value(environment.part, measured, known.kinds, kind)


def _parts_of(pattern: Pattern) -> _PatternParts:
    parts = _PatternParts([], [], [])
    unvisited: List[Pattern] = [pattern]
    while unvisited:
        node = unvisited.pop()
        if isinstance(node, EventPattern):
            parts.events.append(node)
        elif isinstance(
            node,
            (NotPattern, AbsencePattern, NotPrecededPattern, OrPattern, KleenePattern, AggregatePattern),
        ):
            parts.nested.append(node)
            # The operand that each match contains.
            unvisited += () if isinstance(node, OrPattern) else children(node)[:1]
        else:
            parts.others.append(node)
            unvisited += children(node)
    # The nodes were visited from right to left, and outer ones before inner ones.
    return _PatternParts(parts.events[::-1], parts.nested[::-1], parts.others[::-1])


def _is_numeric(kind: str) -> bool:
    """Return whether an aggregate measures numbers."""
    return kind in AGGREGATES and AGGREGATES[kind].is_numeric


def _bind_slots(message: CompoundTerm, definition: Definition, environment: Environment) -> None:
    for position, slot in enumerate(definition.fields, 1):
        environment.bind_slot(message, position, kinds_of_slot(slot, f"{slot.name} of {definition.name}"))


def _bind_results(results: Any, kinds_of_results: List[Kinds], environment: Environment) -> None:
    """Bind the variables of results of aggregates."""
    for result, kinds in zip(results, kinds_of_results):
        environment.bind_argument(wrap_term(result), 1, kinds, None)
