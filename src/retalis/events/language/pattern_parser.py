"""Parser of rule bodies: terms to patterns, with static checks.

`PatternReader` descends through the term of a rule body and builds a tree of `pattern_tree` nodes. It dispatches on
the kind of the operator (`PatternReader._parsers`). While it reads, it collects what later checks need: called goals,
awaited events, aggregates and windows, each with its term, so that an error can name its place in the source.

Terms that only look like operators stay events (see `is_event`); an event that was probably intended as an operator
or condition gets a warning (see `likely_mistakes`). `check_aggregate` and `check_window` run after the whole rule is
read, because they need all occurrences of its variables.
"""

from typing import Any, Callable, Dict, FrozenSet, List, Mapping, NamedTuple, Optional, Tuple, Union

from ...foundation.errors import RuleError
from ...foundation.source_places import Place
from ...prolog.machine.arithmetic import EVALUABLE
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import (
    COMMA,
    CONS,
    Atom,
    CompoundTerm,
    String,
    Term,
    Var,
    deref,
    functor,
)
from ..streams.aggregates import AGGREGATES
from .called_predicates import Subgoal, calls, required_interval_calls
from .event_operators import (
    ARROWS,
    EVENT_OPERATORS_BY_NAME,
    OPERATOR_NAMES,
    RUN_OPERATORS,
    EventOperator,
    OperatorKind,
    names_of_kind,
)
from .likely_mistakes import bracket_advice, event_warning
from .pattern_tree import (
    AT_END,
    MAX_COMPOSED_REPETITIONS,
    MAX_REPETITIONS,
    SEQ,
    AbsencePattern,
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    EventPattern,
    InstantPattern,
    KleenePattern,
    NegationScope,
    NotPattern,
    OrPattern,
    PairPattern,
    Pattern,
    RepeatedPattern,
    WindowPattern,
    WithinPattern,
    bound_by,
    occurrences,
    substitute_variables,
)
from .row_pattern_parser import insert_stamps
from .stream_parser import (
    NOT_PRECEDED,
    is_computed_timeout,
    is_event,
    parse_measure,
    parse_not_preceded,
    parse_rate_operator,
    parse_window,
    positive_nanoseconds,
    regroup_rate_operator,
)

PlaceLookup = Callable[..., Optional[Place]]
"""Takes a compound term, and optionally the position of an argument; returns the place of its functor or argument."""


def no_place(part: Term, position: int = 0) -> Optional[Place]:
    """Return None as the place of a part; for terms that were not read from a text."""
    return None


_GOAL_OPERANDS = frozenset((functor("prolog", 1), functor("query", 1), functor("db", 1)))
_ABSENCE_OPERATORS = " or ".join(names_of_kind(OperatorKind.ABSENCE))
_ABSENT = "absent"


class EventTerm(NamedTuple):
    """Term that is an event or an event pattern, and its position: argument ``position`` of ``parent``."""

    term: Term
    parent: CompoundTerm
    position: int


class PatternReader:
    """Parser for the body of one rule.

    Args:
        place: returns the place of a subterm in the text of the rule, or None.
        warn: receives probable mistakes that are not errors.
        anonymous: the variables ``_`` of the rule, which occur once and have no name.

    Attributes:
        place: the function ``place``.
        nested_rules: rules that are defined inside the pattern, ``(S <- Q)``.
        goals: calls in the goals of the pattern.
        events: the awaited events.
        interval_calls: calls of ``t1/1`` and ``t2/1`` that a goal requires, in goals for which no interval is
            defined.
        aggregates: the aggregates, each with its term.
        windows: the aggregates over windows, each with its term.
        absences: the terms of absences between two events.
    """

    def __init__(
        self, place: PlaceLookup, warn: Callable[[RuleError], None], anonymous: FrozenSet[Var] = frozenset()
    ):
        self.place = place
        self._warn = warn
        self._anonymous = anonymous
        self.nested_rules: List[Term] = []
        self.goals: List[Subgoal] = []
        self.events: List[EventTerm] = []
        self.interval_calls: List[Subgoal] = []
        self.aggregates: List[Tuple[AggregatePattern, Term]] = []
        self.windows: List[Tuple[WindowPattern, Term]] = []
        self.absences: List[CompoundTerm] = []

    def read(self, parent: CompoundTerm, position: int) -> Pattern:
        """Return the pattern in argument ``position`` of a term.

        Raises:
            RuleError: if the pattern cannot match.
        """
        term = deref(parent[position])
        if term.__class__ is not tuple:
            return self._read_event(parent, position)
        head = term[0]
        if head in ARROWS:
            self.nested_rules.append(term)
            return self._read_event(term, 1)
        name = OPERATOR_NAMES.get(head)
        # Programs older than an operator may use its name for events; `is_event` distinguishes them by the arguments.
        if name is None or is_event(term):
            run = None if is_event(term) else RUN_OPERATORS.get(head)
            if head is NOT_PRECEDED:
                raise self.create_error(f"{head.name} can only be the right side of a with", term)
            if run is None:
                return self._read_event(parent, position)
            subject = run.name if run.kind is OperatorKind.RUN else f"an {run.name}"
            message = f"{subject} can only be the right side of a {SEQ}"
            if run.kind is OperatorKind.AGGREGATE:
                message += ", or has a window: aggregate(K, Q, R, last(60))"
            raise self.create_error(message, term)
        return self._parsers[EVENT_OPERATORS_BY_NAME[name].kind](self, name, term)

    def _parse_pair(self, name: str, term: CompoundTerm) -> Pattern:
        if name == SEQ:
            return self._parse_sequence(term)
        return PairPattern(name, self.read_operand(term, 1, name), self.read_operand(term, 2, name))

    def _reject_operator(self, name: str, term: CompoundTerm) -> Pattern:
        raise self.create_error(
            f"there is no operator {name}; use {_ABSENCE_OPERATORS} for the absence of an event", term
        )

    def _parse_time_limit(self, name: str, term: CompoundTerm) -> WithinPattern:
        # The bound is exclusive in the language and inclusive in the network, hence one nanosecond less.
        return WithinPattern(self.read_operand(term, 1, name), self.read_span(name, term) - 1)

    def _parse_condition(self, name: str, term: CompoundTerm) -> ConditionPattern:
        pattern = self.read_operand(term, 1, name)
        return ConditionPattern(
            pattern, self.read_goal(term, 2, name), EVENT_OPERATORS_BY_NAME[name].has_interval_predicates
        )

    def _parse_action(self, name: str, term: CompoundTerm) -> ActionPattern:
        pattern = self.read_operand(term, 1, name)
        return ActionPattern(
            pattern, self.read_goal(term, 2, name), EVENT_OPERATORS_BY_NAME[name].calls_for_all_solutions
        )

    def read_operand(self, parent: CompoundTerm, position: int, operator: str) -> Pattern:
        """Return the pattern of an operand; see `read`."""
        term = deref(parent[position])
        if term.__class__ is tuple and term[0] in _GOAL_OPERANDS:
            raise self.create_error(
                f"{term[0].name}(Goal) can only be an operand of {SEQ}, not of {operator}", term
            )
        return self.read(parent, position)

    def _read_event(self, parent: CompoundTerm, position: int) -> EventPattern:
        term = deref(parent[position])
        if term.__class__ not in (tuple, Atom, Var):
            class_name = "a string" if term.__class__ is String else "a number"
            message = f"an event is an atom or a compound term, not {class_name}"
            raise self.create_error(message, parent, position)
        warning = event_warning(term)
        if warning is not None:
            self._warn(
                self.create_error(warning, *((parent, position) if term.__class__ is Atom else (term, 0)))
            )
        self.events.append(EventTerm(term, parent, position))
        return EventPattern(term)

    def _parse_sequence(self, term: CompoundTerm) -> Pattern:
        left, right = deref(term[1]), deref(term[2])
        left_goal = self._parse_goal_operand(left)
        right_goal = self._parse_goal_operand(right)
        # A goal beside ``seq`` is a condition on the other operand. With two goals no event would ever start a match.
        if left_goal is not None and right_goal is not None:
            raise self.create_error("a sequence of two goals does not wait for any event", term)
        if right_goal is not None:
            return ConditionPattern(self.read(term, 1), right_goal, False)
        if left_goal is not None:
            return ConditionPattern(self.read(term, 2), left_goal, False)
        first = self.read(term, 1)
        if (
            right.__class__ is tuple
            and right[0] in RUN_OPERATORS
            and (not is_event(right) or is_computed_timeout(right))
        ):
            run = RUN_OPERATORS[right[0]]
            if run.kind is OperatorKind.AGGREGATE:
                return self._parse_aggregate(first, right, run)
            if run.kind is OperatorKind.TIMEOUT:
                negated = self.read_operand(right, 1, run.name)
                return AbsencePattern(first, negated, self._read_timeout(run.name, right, first))
            return KleenePattern(first, self.read_operand(right, 1, run.name))
        if right.__class__ is tuple and right[0].name == _ABSENT:
            notation = f"{_ABSENT}(Pattern, Seconds) has two arguments, the second a number or a variable"
            advice = ""
            if is_event(right) and len(right) == 3 and deref(right[2]).__class__ is tuple:
                advice = f"; compute the time in a condition: (P where N is ...) seq {_ABSENT}(Pattern, N)"
            self._warn(self.create_error(f"this is an ordinary event; {notation}{advice}", right))
        return PairPattern(SEQ, first, self.read(term, 2))

    def _parse_goal_operand(self, term: Term) -> Optional[Term]:
        if term.__class__ is tuple and term[0] in _GOAL_OPERANDS:
            return self.read_goal(term, 1, term[0].name)
        return None

    def _parse_aggregate(
        self, first: Pattern, term: CompoundTerm, operator: EventOperator
    ) -> AggregatePattern:
        measure_term = deref(term[1])
        if list_items(measure_term) is not None:
            raise self.create_error(
                "an aggregate after seq has one kind; a list of kinds needs a window", term, 1
            )
        measure = parse_measure(self, measure_term, term)
        collected = self.read_operand(term, 2, operator.name)
        aggregate = AggregatePattern(
            first, measure.name, measure.setting, measure.value, collected, deref(term[3])
        )
        self.aggregates.append((aggregate, term))
        return aggregate

    def _parse_alternatives(self, name: str, term: CompoundTerm) -> OrPattern:
        branches: List[Pattern] = []
        # Nested alternatives become one node with many branches. An explicit stack, because programs can be generated
        # with thousands of them, more than the recursion limit of Python.
        pending = [(term, 2), (term, 1)]
        while pending:
            parent, position = pending.pop()
            branch = deref(parent[position])
            if branch.__class__ is tuple and OPERATOR_NAMES.get(branch[0]) == name:
                pending += [(branch, 2), (branch, 1)]
            else:
                branches.append(self.read_operand(parent, position, name))
        return OrPattern(tuple(branches))

    def _parse_window(self, name: str, term: CompoundTerm) -> WindowPattern:
        window = parse_window(self, term)
        self.windows.append((window, term))
        return window

    def _parse_rate_operator(self, name: str, term: CompoundTerm) -> Pattern:
        regrouped = regroup_rate_operator(term)
        if regrouped is not None:
            return self.read((term[0], regrouped), 1)
        not_preceded = parse_not_preceded(self, term)
        if not_preceded is not None:
            return not_preceded
        notation = EVENT_OPERATORS_BY_NAME[NOT_PRECEDED.name].notation
        return parse_rate_operator(term, self.read_operand(term, 1, "with"), self.create_error, (notation,))

    def _parse_absence(self, name: str, term: CompoundTerm) -> NotPattern:
        pattern = self.read_operand(term, 1, name)
        negated = self.read_operand(term, 2, name)
        scope = NegationScope(name)
        if scope is not NegationScope.BETWEEN:
            return NotPattern(pattern, negated, scope)
        if _is_sequence(pattern):
            self.absences.append(term)
            return NotPattern(pattern, negated, scope)
        message = (
            f"P {name} R where P is not a sequence means that no R ended before P started "
            f"(write {NegationScope.BEFORE.value}); "
            f"for no R during P write P {NegationScope.OVERLAP.value} R; "
            f"for no R between two events write (P {SEQ} Q) {name} R"
        )
        self._warn(self.create_error(message, term))
        return NotPattern(pattern, negated, NegationScope.BEFORE)

    def _parse_instant(self, name: str, term: CompoundTerm) -> InstantPattern:
        return InstantPattern(self.read_operand(term, 1, name), name == AT_END)

    def _parse_repetition(self, name: str, term: CompoundTerm) -> Pattern:
        times = deref(term[2])
        if times.__class__ is not int or times < 1:
            raise self.create_error(f"{name} needs a positive integer", term, 2)
        if times > MAX_REPETITIONS:
            raise self.create_error(f"{name} takes at most {MAX_REPETITIONS} repetitions", term, 2)
        pattern = self.read_operand(term, 1, name)
        if times == 1:
            return pattern
        # Each ``_`` stands for a different value in each repetition, so each repetition gets fresh variables; named
        # variables join the repetitions.
        fresh_variables = tuple([var for var in bound_by(pattern, True) if var in self._anonymous])
        renaming = {var: Var() for var in fresh_variables}
        self._anonymous |= set(renaming.values())
        # The last repetition is a separate operand: ``cnot`` covers the gap between the operands of a sequence, which
        # then is the gap before the last repetition.
        last = substitute_variables(pattern, renaming) if renaming else pattern
        repeated = RepeatedPattern(pattern, times - 1, fresh_variables)
        if times > MAX_COMPOSED_REPETITIONS and not repeated.repeats_single_events():
            message = (
                f"{name} takes at most {MAX_COMPOSED_REPETITIONS} repetitions of a pattern of several events"
            )
            raise self.create_error(message, term, 2)
        return PairPattern(SEQ, pattern if times == 2 else repeated, last)

    def read_span(self, name: str, term: CompoundTerm) -> int:
        """Return the second argument of a term, a number of seconds, in nanoseconds.

        Raises:
            RuleError: if the argument is not a positive number.
        """
        seconds = deref(term[2])
        nanoseconds = positive_nanoseconds(seconds)
        if nanoseconds is None:
            raise self.create_error(
                f"{name} needs a positive number of seconds{bracket_advice(name, seconds)}", term, 2
            )
        return nanoseconds

    def _read_timeout(self, name: str, term: CompoundTerm, first: Pattern) -> Union[int, Var]:
        """Return the time of a timeout in nanoseconds, or the variable of ``first`` that is bound to the seconds."""
        seconds = deref(term[2])
        if seconds.__class__ is not Var:
            return self.read_span(name, term)
        if seconds not in bound_by(first):
            message = (
                f"{name} needs a positive number of seconds, or a variable that the pattern before it binds"
            )
            raise self.create_error(message, term, 2)
        return seconds

    def read_goal(
        self, parent: CompoundTerm, position: int, operator: str, has_interval: bool = False
    ) -> Term:
        """Return the goal in argument ``position`` of a term, and record its calls.

        Args:
            parent: the term.
            position: position of the argument.
            operator: name of the operator, for errors.
            has_interval: whether ``t1/1`` and ``t2/1`` are defined for the goal, beside the operators that define
                them.

        Raises:
            RuleError: if the goal or a part of it is not callable.
        """
        for call in calls(parent, position):
            if call.term.__class__ not in (tuple, Atom, Var):
                # ``11,5`` is a conjunction whose second goal is a number.
                is_decimal = call.term.__class__ is int and call.parent[0] is COMMA
                hint = (
                    f", found {call.term}; a decimal is written with a point, as 11.5" if is_decimal else ""
                )
                raise self.create_error(f"{operator} needs a goal{hint}", call.parent, call.position)
            self.goals.append(call)
        event_operator = EVENT_OPERATORS_BY_NAME.get(operator)
        if not has_interval and (event_operator is None or not event_operator.has_interval_predicates):
            self.interval_calls += required_interval_calls(parent, position)
        return deref(parent[position])

    def create_error(self, message: str, term: Term, position: int = 0) -> RuleError:
        """Return an error at a term, or at one of its arguments."""
        return RuleError(message, self.place(term, position))

    _parsers: Dict[OperatorKind, Callable[["PatternReader", str, CompoundTerm], Pattern]] = {
        OperatorKind.PAIR: _parse_pair,
        OperatorKind.ALTERNATIVES: _parse_alternatives,
        OperatorKind.ABSENCE: _parse_absence,
        OperatorKind.UNSUPPORTED: _reject_operator,
        OperatorKind.REPETITION: _parse_repetition,
        OperatorKind.LIMIT: _parse_time_limit,
        OperatorKind.CONDITION: _parse_condition,
        OperatorKind.ACTION: _parse_action,
        OperatorKind.WINDOW: _parse_window,
        OperatorKind.RATE: _parse_rate_operator,
        OperatorKind.INSTANT: _parse_instant,
    }
    """Parsing methods, by the kind of the operator."""


def _is_sequence(pattern: Pattern) -> bool:
    """Return whether a pattern is a sequence, possibly inside conditions."""
    while isinstance(pattern, (ConditionPattern, WithinPattern)) or (
        isinstance(pattern, NotPattern) and pattern.scope is NegationScope.OVERLAP
    ):
        pattern = pattern.pattern
    return isinstance(pattern, PairPattern) and pattern.operator == SEQ


def check_aggregate(
    aggregate: AggregatePattern,
    term: Any,
    pattern: Any,
    names: Mapping[Var, str],
    place_of: PlaceLookup,
    warn: Callable[[RuleError], None],
) -> None:
    """Check the value and the result of an aggregate.

    Args:
        aggregate: the aggregate.
        term: the aggregate as it is written.
        pattern: the pattern of the rule.
        names: names of the variables.
        place_of: returns the places of parts of the term.
        warn: receives probable mistakes that are not errors.

    Raises:
        RuleError: if a numeric aggregate gets a value that can never be a number.
    """
    first_vars, collected_vars = set(bound_by(aggregate.first)), set(bound_by(aggregate.collected))
    value_vars = [] if aggregate.value is None else variables(aggregate.value)
    unbound = [var for var in value_vars if var not in first_vars and var not in collected_vars]
    is_numeric = AGGREGATES[aggregate.kind].is_numeric
    if not is_numeric:
        # An aggregate of terms may collect a variable that another part of the pattern binds later; only a variable
        # that occurs nowhere else stays unbound.
        counts = occurrences([], pattern)
        unbound = [var for var in unbound if counts[var] == 1]
    if unbound:
        name = names.get(unbound[0], "a variable")
        message = (
            f"{name} never gets a value: "
            f"neither what {aggregate.kind} collects nor what comes before it binds it"
        )
        error = RuleError(message, place_of(deref(term[1])))
        if is_numeric:
            raise error
        warn(error)
    if aggregate.value is not None and is_numeric and not _may_be_numeric(aggregate.value):
        raise RuleError(f"{aggregate.kind} needs numbers or arithmetic expressions", place_of(deref(term[1])))
    # The variable is already bound to a collected value when it is unified with the result.
    if (
        aggregate.result.__class__ is Var
        and aggregate.result in (collected_vars | set(value_vars)) - first_vars
    ):
        name = names.get(aggregate.result, "a variable")
        message = (
            f"{name} is both a collected value and the result of {aggregate.kind}, "
            "which fires only where they are equal"
        )
        warn(RuleError(message, place_of(term, 3)))


def check_window(
    window_pattern: WindowPattern,
    term: Any,
    rule: Term,
    names: Mapping[Var, str],
    place_of: PlaceLookup,
    warn: Callable[[RuleError], None],
) -> None:
    """Check the measured values of a window, and warn about values that also partition it.

    Args:
        window_pattern: the aggregate over a window.
        term: the aggregate as it is written.
        rule: the rule as it is written.
        names: names of the variables.
        place_of: returns the places of parts of the term.
        warn: receives the warnings.

    Raises:
        RuleError: if a numeric measure gets a value that can never be a number.
    """
    for aggregate_name, value in zip(window_pattern.kinds, window_pattern.values):
        # ``duration`` measures a goal.
        if value is None or aggregate_name not in AGGREGATES or not AGGREGATES[aggregate_name].is_numeric:
            continue
        if not _may_be_numeric(insert_stamps(value) if window_pattern.window.steps else value):
            raise RuleError(
                f"{aggregate_name} needs numbers or arithmetic expressions",
                place_of(deref(term[1])) or place_of(term),
            )
    measured = [value for value in window_pattern.values if value is not None]
    inside_counts = occurrences([*measured, *window_pattern.window.goals], window_pattern.collected)
    rule_counts = occurrences([rule], None)
    for var in dict.fromkeys(variable for value in measured for variable in variables(value)):
        # A window has one partition for each binding of the variables that occur outside of it.
        if rule_counts.get(var, 0) > inside_counts[var]:
            name = names.get(var, "a variable")
            message = (
                f"{name} is measured and also occurs outside of the aggregate, so that there is a window for each of "
                "its values"
            )
            warn(RuleError(message, place_of(deref(term[1])) or place_of(term)))


def _may_be_numeric(value: Term) -> bool:
    """Return whether a term is an arithmetic expression for some values of its variables."""
    stack = [value]
    while stack:
        term = deref(stack.pop())
        if term.__class__ is Atom:
            if term.functor not in EVALUABLE:
                return False
        elif term.__class__ is tuple:
            # ``[X]`` is the arithmetic value of X, as in ISO Prolog, and may be one when it is called.
            if term[0] is CONS:
                continue
            if term[0] not in EVALUABLE:
                return False
            stack.extend(term[1:])
        elif term.__class__ is String:
            return False
    return True
