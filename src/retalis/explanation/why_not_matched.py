"""Why-not provenance: evaluation of a rule's pattern over recorded events, to find what is missing.

Each part of a pattern is evaluated over all recorded events as if no event were consumed. The result is a tree of
parts with one of three states: the part matched, it did not match, or it was not tested because a part below it did
not match. The lowest parts that did not match are the missing ones.

A part keeps its newest `MAX_MATCHES` matches, by their ends. Operators that combine the matches of two parts use the
newest `MAX_CANDIDATES` of each, because the number of combinations would grow exponentially with the depth of the
pattern. Windows and other stream operators are evaluated by new operators over the matches that were kept. If older
ones were not, the text of a window says so, and results to which they may belong are omitted.
"""

from contextlib import closing
from functools import lru_cache
from operator import attrgetter
from typing import (
    Any,
    Callable,
    Dict,
    Hashable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ..events.language.event_operators import PAIR_OPERATORS, EventOperator, OperatorKind, names_of_kind
from ..events.language.pattern_tree import (
    AbsencePattern,
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    EventPattern,
    InstantPattern,
    KleenePattern,
    NegationScope,
    NotPattern,
    NotPrecededPattern,
    OrPattern,
    PairPattern,
    RatePattern,
    RepeatedPattern,
    RowPatternStep,
    WindowPattern,
    WithinPattern,
)
from ..events.language.row_pattern_parser import step_term
from ..events.language.state_parser import queried_state
from ..events.language.stream_parser import (
    NOT_PRECEDED,
    positive_nanoseconds,
    rate_operator_term,
    window_term,
)
from ..events.matches.match_policies import NetworkOptions
from ..events.network.event_rule import EventRule
from ..events.network.goal_evaluation import Evaluators
from ..events.network.lineage_graph import Occurrence
from ..events.network.stream_compiler import create_rate_operator
from ..events.network.stream_node import StreamNode
from ..events.streams.aggregates import SequenceAggregate
from ..events.streams.rate_operators import RATE_OPERATORS
from ..events.streams.row_pattern import RowPatternWindow
from ..events.streams.stream_operators import StreamElement, StreamOutput
from ..foundation import codegen
from ..foundation.displayed_text import format_number
from ..foundation.errors import RetalisError, RuleError
from ..foundation.limit_checks import check_limits
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms import timestamps
from ..prolog.terms.list_terms import conjunction, conjuncts
from ..prolog.terms.term_traversal import copy, term_key, variables
from ..prolog.terms.types import NIL, Term, Trail, Var, functor
from ..prolog.terms.unification import undo, unify
from .explanation_lines import TimeFormat, names_of_bound_variables, show_term

MAX_MATCHES = 5000
"""Maximum number of matches of a part that windows and conditions examine; the newest ones are kept."""
MAX_CANDIDATES = 200
"""Maximum number of matches of a part that are combined with those of another part, or whose conditions are examined
one by one; the newest ones are used."""
MAX_CONJUNCTS = 20
"""Maximum number of goals of a conjunction that are examined one by one."""
MAX_REPETITIONS = 50
"""Maximum number of repetitions of ``ntimes`` that are examined."""
MAX_SHOWN_CANDIDATES = 3
"""Maximum number of matches in the text of a part; the newest ones are shown."""
MAX_SHOWN_VALUE_CHARACTERS = 60
"""Maximum length of the text of a variable's value."""

_PRESENT_STATES_NOTE = " (with the states that hold now)"
_CONSECUTIVE_WINDOWS = ("batch", "first")
"""Kinds of windows that begin after the end of the previous one."""

_VALUES_FUNCTOR = functor("values", 0)
"""Functor of the terms that combine any number of values or variables; its arity is not used."""
_OR_NAME, *_ = names_of_kind(OperatorKind.ALTERNATIVES)
_STAR_NAME, *_ = names_of_kind(OperatorKind.RUN)
_WITHIN_NAME, *_ = names_of_kind(OperatorKind.LIMIT)
_UNLIMITED_NAMES = f"{NegationScope.BETWEEN.value} or {NegationScope.BEFORE.value}"
_CONDITION_NAMES = [
    names_of_kind(OperatorKind.CONDITION, has_interval_predicates=timed)[0] for timed in (False, True)
]
_ACTION_NAMES = [
    names_of_kind(OperatorKind.ACTION, calls_for_all_solutions=every)[0] for every in (False, True)
]
_RATE_NAME, *_ = names_of_kind(OperatorKind.RATE)
_TIMEOUT_NAME, *_ = names_of_kind(OperatorKind.TIMEOUT)


class Candidate(NamedTuple):
    """A match of a part of a pattern.

    Attributes:
        values: values of the rule's variables, as a compound term.
        start: start time in nanoseconds.
        end: end time in nanoseconds.
        event: the occurrence, if the match is a single event.
        gap: end of the first and start of the second operand of a sequence.
    """

    values: Term
    start: int
    end: int
    event: Optional[Occurrence] = None
    gap: Optional[Tuple[int, int]] = None


_NO_VALUES: Term = (_VALUES_FUNCTOR,)
_PLACEHOLDER_MATCH = Candidate(_NO_VALUES, 0, 0)
"""Match that makes a part count as matched which has no matches of its own."""


class PartResult(NamedTuple):
    """Result for a part of a pattern.

    Attributes:
        parts: results of the parts below it.
        event: the event, if the part is a single event.
        was_tested: False if the part was not tested, because a part below it did not match.
        omits_older: whether older matches were omitted, of this part or of one below it.
    """

    text: str
    matches: List[Candidate]
    parts: List["PartResult"]
    event: Optional[Term] = None
    was_tested: bool = True
    omits_older: bool = False

    @property
    def symbol(self) -> str:
        """``+`` for a part that matched, ``-`` for one that did not, ``?`` for one that was not tested."""
        if not self.was_tested:
            return "?"
        return "+" if self.matches else "-"

    def keep_newest(self, max_count: int) -> "PartResult":
        """Return the result with its newest matches only."""
        if len(self.matches) <= max_count:
            return self
        return self._replace(matches=self.matches[-max_count:], omits_older=True)


class WhyNotMatched:
    """Evaluation of the parts of one rule's pattern.

    Args:
        logic: evaluates conditions.
        occurrences: the recorded events.
        rule: the rule; its head is unified with the event that is explained.
        reference_time: see `TimeFormat`.
    """

    def __init__(
        self,
        logic: PrologSystem,
        occurrences: Sequence[Occurrence],
        rule: EventRule,
        reference_time: Optional[int] = None,
    ):
        self._logic = logic
        self._occurrences = occurrences
        rule_variables = [
            var
            for term in (rule.definition.term, rule.definition.head)
            if term is not None
            for var in variables(term)
        ]
        self._rule = rule
        self._current_time = rule.network.alarm_time()
        # A match is represented by a copy of all variables of the rule: two matches are joined by unifying them.
        self._rule_variables = (_VALUES_FUNCTOR, *dict.fromkeys(rule_variables))
        # After the head was unified, variables of the rule may be bound to variables of the explained event.
        self._names = names_of_bound_variables(rule.definition.names)
        self._field_named_variables = rule.definition.names
        self._times = TimeFormat(self._show, reference_time, occurrences)
        self._methods: Dict[type, Callable[[Any], PartResult]] = {
            EventPattern: self._evaluate_event,
            PairPattern: self._evaluate_pair,
            RepeatedPattern: self._evaluate_repeated,
            OrPattern: self._evaluate_or,
            NotPattern: self._evaluate_negation,
            KleenePattern: self._evaluate_kleene,
            AggregatePattern: self._evaluate_aggregate,
            ConditionPattern: self._evaluate_condition,
            WithinPattern: self._evaluate_within,
            ActionPattern: self._evaluate_action,
            WindowPattern: self._evaluate_window,
            RatePattern: self._evaluate_rate_operator,
            AbsencePattern: self._evaluate_absence_timeout,
            NotPrecededPattern: self._evaluate_not_preceded,
            InstantPattern: self._evaluate_instant,
        }

    def evaluate(self, pattern: Any) -> PartResult:
        """Return the result for a pattern."""
        result = self._methods[type(pattern)](pattern).keep_newest(MAX_MATCHES)
        return result._replace(omits_older=True) if any(part.omits_older for part in result.parts) else result

    def _evaluate_operand(self, pattern: Any) -> PartResult:
        """Return the result for a pattern whose matches are combined with those of another one."""
        return self.evaluate(pattern).keep_newest(MAX_CANDIDATES)

    # ---- one method per type of pattern ----------------------------------------------------------------

    # Each evaluates the parts of the pattern first, selects or joins their matches, and says why none is left.

    def _evaluate_event(self, pattern: EventPattern) -> PartResult:
        matches = []
        for occurrence in self._occurrences:
            check_limits(1)
            trail: Trail = []
            try:
                if unify(pattern.term, copy(occurrence.term), trail):
                    matches.append(
                        Candidate(copy(self._rule_variables), occurrence.start, occurrence.end, occurrence)
                    )
            finally:
                undo(trail, 0)
        text = f"{self._show(pattern.term)}: {self._format_result(matches, 'did not happen', pattern.term)}"
        return PartResult(text, matches, [], copy(pattern.term))

    def _evaluate_pair(self, pattern: PairPattern) -> PartResult:
        left, right = self._evaluate_operand(pattern.left), self._evaluate_operand(pattern.right)
        join_intervals = _compile_interval_join(PAIR_OPERATORS[pattern.operator])
        values_agree = False
        matches = []
        for first in left.matches:
            for second in right.matches:
                values = self._join_values(first, second)
                # A rule never uses one event as both operands.
                if values is None or (first.event is not None and first.event is second.event):
                    continue
                values_agree = True
                interval = join_intervals(first.start, first.end, second.start, second.end)
                if interval is not None:
                    matches.append(Candidate(values, *interval, None, (first.end, second.start)))
        matches = _sort_by_end(matches)
        reason = "one side is missing"
        if left.matches and right.matches:
            reason = (
                PAIR_OPERATORS[pattern.operator].no_match_text
                if values_agree
                else "no pair with the same values"
            )
        return PartResult(
            f"{pattern.operator}: {self._format_result(matches, reason)}", matches, [left, right]
        )

    def _evaluate_repeated(self, pattern: RepeatedPattern) -> PartResult:
        # A repetition of many events is cut off: the first missing event is among the first repetitions.
        return self.evaluate(pattern._replace(times=min(pattern.times, MAX_REPETITIONS)).as_sequence())

    def _evaluate_or(self, pattern: OrPattern) -> PartResult:
        parts = [self.evaluate(branch) for branch in pattern.branches]
        matches = _sort_by_end([match for part in parts for match in part.matches])
        text = f"{_OR_NAME}: {self._format_result(matches, 'no branch matched')}"
        return PartResult(text, matches, parts)

    def _evaluate_negation(self, pattern: NotPattern) -> PartResult:
        part, negated = self._evaluate_operand(pattern.pattern), self._evaluate_operand(pattern.negated)
        matches = [
            match
            for match in part.matches
            if not any(
                self._excludes(pattern.scope, negated_match, match) for negated_match in negated.matches
            )
        ]
        # A cnot that has no gap is read as a negation of all earlier matches.
        name = _UNLIMITED_NAMES if pattern.scope is NegationScope.BEFORE else pattern.scope.value
        reason = "ruled out by what must not happen" if part.matches else "not tested"
        text = f"{name}: {self._format_result(matches, reason)}"
        return PartResult(text, matches, [part, _create_negated_part(negated)], None, bool(part.matches))

    def _excludes(self, scope: NegationScope, negated: Candidate, match: Candidate) -> bool:
        """Return whether a match of the negated part excludes a match: it lies in its gap, or before it if none."""
        if self._join_values(match, negated) is None:
            return False
        if scope is NegationScope.OVERLAP:
            return negated.start < match.end and match.start < negated.end
        if match.gap is None:
            return negated.end < match.start
        gap_start, gap_end = match.gap
        return gap_start < negated.start and negated.end < gap_end

    def _evaluate_kleene(self, pattern: KleenePattern) -> PartResult:
        first_part, repeated_part = (
            self._evaluate_operand(pattern.first),
            self._evaluate_operand(pattern.repeated),
        )
        extended = [
            Candidate(values, match.start, last.end)
            for match, last, values in self._find_ordered_pairs(first_part, repeated_part)
        ]
        matches = _sort_by_end(first_part.matches + extended)
        text = f"{_STAR_NAME}: {self._format_result(matches, 'it did not start')}"
        return PartResult(text, matches, [first_part, repeated_part])

    def _evaluate_aggregate(self, pattern: AggregatePattern) -> PartResult:
        first_part, collected_part = (
            self._evaluate_operand(pattern.first),
            self._evaluate_operand(pattern.collected),
        )
        value = NIL if pattern.value is None else pattern.value
        value_vars = variables(value)
        evaluators = Evaluators(self._rule)
        evaluate = evaluators.compile_expression(pattern.kind, value, value_vars)
        setting = evaluators.compile_setting(pattern.kind, pattern.setting)
        # The values that are passed to the aggregate below are those of `value_vars`, and the aggregated term last.
        aggregate = SequenceAggregate(pattern.kind, setting, lambda values: values[-1], evaluate)
        matches: List[Candidate] = []
        results: List[str] = []

        def add_result(start: Candidate, end: int, result: Term) -> None:
            # A result that differs from the requested one is not a match, but it is shown as the reason.
            values = self._extend(start.values, [(pattern.result, result)])
            if values is not None:
                matches.append(Candidate(values, start.start, end))
            results.append(f"{self._shorten(result)} {self._times.format_interval(start.start, end)}")

        problem = ""
        for match in first_part.matches:
            state = aggregate.initial_state
            if aggregate.empty_result is not None:
                add_result(match, match.end, aggregate.empty_result)
            for _, last, values in self._find_ordered_pairs(
                first_part._replace(matches=[match]), collected_part
            ):
                aggregated_values = tuple([self._instantiate(values, term) for term in (*value_vars, value)])
                try:
                    state = aggregate.add(state, aggregated_values)
                    result = aggregate.result(state, last.end - match.end)
                except RuleError as error:
                    problem = f", {error.message}"
                    continue
                if result is not None:
                    add_result(match, last.end, result)
        reason = self._format_other_results(results) or "nothing was collected"
        reason = f"{reason}{problem}" if first_part.matches else "it did not begin"
        matches = _sort_by_end(matches)
        text = f"{pattern.kind}: {self._format_result(matches, reason, pattern.result)}"
        return PartResult(text, matches, [first_part, collected_part])

    def _find_ordered_pairs(
        self, first: PartResult, second: PartResult
    ) -> Iterator[Tuple[Candidate, Candidate, Term]]:
        """Yield pairs of matches whose second one starts after the end of the first, and their joint values."""
        for match in first.matches:
            for later in second.matches:
                if match.end < later.start:
                    values = self._join_values(match, later)
                    if values is not None:
                        yield match, later, values

    def _evaluate_condition(self, pattern: ConditionPattern) -> PartResult:
        part = self.evaluate(pattern.pattern)
        matches = []
        rejected_matches = []
        problems: Dict[str, None] = {}
        for match in part.matches:
            try:
                values = self._solve(pattern, match)
            except RetalisError as error:
                # As in the rule, an error rejects this match only; it is shown if no other match is accepted.
                problems.setdefault(error.message)
                values = None
            if values is None:
                rejected_matches.append(match)
            else:
                matches.append(match._replace(values=values))
        name = _CONDITION_NAMES[pattern.timed]
        if not part.matches:
            return PartResult(f"{name} {self._show(pattern.goal)}: not tested", [], [part], None, False)
        rejected = self._format_rejected(part.matches, pattern.goal)
        if problems:
            rejected = f"{rejected}, with the error: {list(problems)[-1]}"
        text = f"{name} {self._show(pattern.goal)}: {self._format_result(matches, rejected, pattern.goal)}"
        goal_results = [] if matches else self._evaluate_conjuncts(pattern, rejected_matches)
        return PartResult(text, matches, [*goal_results, part])

    def _evaluate_conjuncts(
        self, pattern: ConditionPattern, rejected_matches: Sequence[Candidate]
    ) -> List[PartResult]:
        """Return for each goal of a conjunction the newest matches that satisfy the goals before it, but not it."""
        goals = list(conjuncts(pattern.goal))
        # Each match evaluates up to all beginnings of the conjunction, which takes quadratic time.
        if not 1 < len(goals) <= MAX_CONJUNCTS:
            return []
        beginnings = [pattern._replace(goal=conjunction(goals[:count])) for count in range(1, len(goals))]
        rejected_by_goal: List[List[Candidate]] = [[] for _ in goals]
        for match in rejected_matches[-MAX_CANDIDATES:]:
            # With the values that the goals so far have bound.
            satisfied = match
            for beginning, rejected in zip(beginnings, rejected_by_goal):
                try:
                    values = self._solve(beginning, match)
                except RetalisError:
                    values = None
                if values is None:
                    rejected.append(satisfied)
                    break
                satisfied = match._replace(values=values)
            else:
                rejected_by_goal[-1].append(satisfied)
        scope = f"of the newest {MAX_CANDIDATES}, " if len(rejected_matches) > MAX_CANDIDATES else ""
        return [
            PartResult(
                f"{self._show(goal)}: {scope}{self._format_rejected(rejected, goal)}"
                f"{_PRESENT_STATES_NOTE if queried_state(goal) else ''}",
                [],
                [],
            )
            for goal, rejected in zip(goals, rejected_by_goal)
            if rejected
        ]

    def _evaluate_within(self, pattern: WithinPattern) -> PartResult:
        part = self.evaluate(pattern.pattern)
        matches = [match for match in part.matches if match.end - match.start <= pattern.span]
        # The parser has subtracted a nanosecond, because `within` excludes the bound that is written.
        seconds = timestamps.to_seconds(pattern.span + 1)
        reason = "all took longer" if part.matches else "not tested"
        return PartResult(
            f"{_WITHIN_NAME} {format_number(seconds)}: {self._format_result(matches, reason)}",
            matches,
            [part],
            None,
            bool(part.matches),
        )

    def _evaluate_action(self, pattern: ActionPattern) -> PartResult:
        part = self.evaluate(pattern.pattern)
        text = f"{_ACTION_NAMES[pattern.every]} {self._show(pattern.goal)}"
        if not part.matches:
            return PartResult(f"{text}: not called", [], [part], None, False)
        # The goal is not called here, because it may have effects: the action counts as done.
        return PartResult(text, part.matches, [part])

    def _evaluate_window(self, pattern: WindowPattern) -> PartResult:
        # The window is evaluated separately from its input, so that missing events and unfinished windows can be told
        # apart.
        part = self.evaluate(pattern.collected)
        text = f"aggregate over {self._show(window_term(pattern.window))}"
        if part.omits_older:
            text += f" (run again over the newest {len(part.matches)} matches only)"
            if pattern.window.kind in _CONSECUTIVE_WINDOWS:
                text += ": not tested, because the omitted ones determine where its windows begin"
                return PartResult(text, [], [part], None, False)
        node = self._rule.stream_node(pattern)
        if not part.matches or node is None:
            return PartResult(f"{text}: nothing was measured", [], [part], None, bool(part.matches))
        # The state of the rule's own window depends on consumption, so a new window is run over the matches.
        window = _WindowEvaluation(node, len(pattern.window.steps), self._instantiate)
        for match in part.matches:
            window.process(match)
        outputs = window.finish(node.watermark_time())
        if part.omits_older:
            outputs = [output for output in outputs if not window.may_lack_elements(output)]
        matches = []
        results = []
        for output in outputs:
            values = None
            if node.spec.build_match_values is not None:
                values = node.spec.build_match_values(output.elements[-1].key_values, output.results)
            extended = (
                None if values is None else self._extend(self._rule_variables, list(zip(node.vars, values)))
            )
            if extended is not None:
                matches.append(Candidate(extended, output.start, output.end))
            shown_results = ", ".join(self._shorten(result) for result in output.results)
            results.append(f"{shown_results} {self._times.format_interval(output.start, output.end)}")
        parts = [part]
        reason = self._format_other_results(results) or "no window has ended"
        # Without any result, the steps show how far the best candidate sequence got.
        if pattern.window.kind == "steps" and not results:
            reason = "no match has timed out" if pattern.window.span else "no events took all steps"
            parts += self._evaluate_steps(
                pattern.window.steps, window.progress, pattern.window.structure is None
            )
        shown_results = self._format_result(
            matches, f"{reason}{window.problem}", (_VALUES_FUNCTOR, *pattern.results)
        )
        return PartResult(f"{text}: {shown_results}", matches, parts)

    def _evaluate_steps(
        self, steps: Sequence[RowPatternStep], progress: Sequence[int], is_sequence: bool
    ) -> List[PartResult]:
        """Return the results for the steps of a row pattern, for the sequence of events that got farthest.

        Args:
            steps: the steps.
            progress: number of events of each step.
            is_sequence: whether each step is reached after the one before it.
        """
        parts = []
        is_reached = True
        for step, count in zip(steps, progress):
            is_complete = count >= step.min_count
            text = f"step {self._show(step_term(step))}"
            if not is_reached:
                parts.append(PartResult(f"{text}: not reached", [], [], None, False))
            else:
                events = "1 event" if count == 1 else f"{count} events"
                missing = "" if is_complete else f" of {step.min_count}"
                parts.append(
                    PartResult(
                        f"{text}: took {events}{missing}", [_PLACEHOLDER_MATCH] if is_complete else [], []
                    )
                )
            is_reached = is_reached and (is_complete or not is_sequence)
        return parts

    def _evaluate_rate_operator(self, pattern: RatePattern) -> PartResult:
        part = self.evaluate(pattern.pattern)
        operator = create_rate_operator(pattern)
        node = self._rule.stream_node(pattern)
        if node is not None:
            operator.set_bounds(node.stream.bounds)
        outputs = []
        for match in part.matches:
            keys = tuple([self._instantiate(match.values, term) for term in pattern.keys])
            value = () if pattern.value is None else (self._instantiate(match.values, pattern.value),)
            outputs += operator.advance_to(match.end)
            outputs += operator.process(
                StreamElement(match, match.start, match.end, keys, value), match.end, 0
            )
        # Operators with deadlines emit when the watermark reaches them, even without a further event.
        outputs += operator.advance_to(self._current_time if node is None else node.watermark_time())
        matches = [output.elements[-1].match._replace(end=output.end, event=None) for output in outputs]
        reason = RATE_OPERATORS[pattern.operator].block_reason.format(
            format_number(timestamps.to_seconds(pattern.span))
        )
        reason = reason if part.matches else "not tested"
        text = (
            f"{_RATE_NAME} {self._show(rate_operator_term(pattern))}: {self._format_result(matches, reason)}"
        )
        return PartResult(text, matches, [part], None, bool(part.matches))

    def _evaluate_absence_timeout(self, pattern: AbsencePattern) -> PartResult:
        part, negated = self._evaluate_operand(pattern.pattern), self._evaluate_operand(pattern.negated)
        node = self._rule.stream_node(pattern)
        watermark_time = self._current_time if node is None else node.watermark_time()
        spans = [(match, self._timeout_of(pattern, match)) for match in part.matches]
        timed_matches = [(match, span) for match, span in spans if span is not None]
        elapsed_matches = [
            (match, span) for match, span in timed_matches if match.end + span <= watermark_time
        ]
        matches = [
            match._replace(end=match.end + span, event=None)
            for match, span in elapsed_matches
            if not any(
                self._is_within_deadline(negated_match, match, span) for negated_match in negated.matches
            )
        ]
        is_waiting = any(match.end + span <= self._current_time for match, span in timed_matches)
        if part.matches and not timed_matches:
            reason = "its time is not a positive number of seconds"
        elif elapsed_matches:
            reason = "ruled out by what must not happen"
        elif is_waiting:
            delay = timestamps.to_seconds(self._current_time - watermark_time)
            reason = (
                f"the time after it is over, and the alarm waits {format_number(delay)} s for late events"
            )
        else:
            reason = (
                "the time after it is not over ('until' of a test case sets a later end)"
                if part.matches
                else "not tested"
            )
        seconds = (
            self._show(pattern.span)
            if isinstance(pattern.span, Var)
            else format_number(timestamps.to_seconds(pattern.span))
        )
        text = f"{_TIMEOUT_NAME} {seconds}: {self._format_result(matches, reason)}"
        return PartResult(text, matches, [part, _create_negated_part(negated)], None, bool(part.matches))

    def _evaluate_not_preceded(self, pattern: NotPrecededPattern) -> PartResult:
        part, negated = self._evaluate_operand(pattern.pattern), self._evaluate_operand(pattern.negated)
        matches = [
            match
            for match in part.matches
            if not any(
                match.start - pattern.span < negated_match.end < match.start
                and self._join_values(match, negated_match) is not None
                for negated_match in negated.matches
            )
        ]
        reason = "ruled out by what must not happen" if part.matches else "not tested"
        name = f"{NOT_PRECEDED.name} {format_number(timestamps.to_seconds(pattern.span))}"
        text = f"{_RATE_NAME} {name}: {self._format_result(matches, reason)}"
        return PartResult(text, matches, [part, _create_negated_part(negated)], None, bool(part.matches))

    def _timeout_of(self, pattern: AbsencePattern, match: Candidate) -> Optional[int]:
        """Return the time after a match in ns; None if its variable has no valid value."""
        if not isinstance(pattern.span, Var):
            return pattern.span
        return positive_nanoseconds(self._instantiate(match.values, pattern.span))

    def _evaluate_instant(self, pattern: InstantPattern) -> PartResult:
        part = self.evaluate(pattern.pattern)
        # An instant of a single event is still that event, which is never both operands of a pair.
        matches = [
            match._replace(start=instant, end=instant, gap=None)
            for match in part.matches
            for instant in (match.end if pattern.at_end else match.start,)
        ]
        text = f"{pattern.operator}: {self._format_result(matches, 'not tested')}"
        return PartResult(text, matches, [part], None, bool(part.matches))

    def _is_within_deadline(self, negated: Candidate, match: Candidate, span: int) -> bool:
        """Return whether a match of the negated part lies entirely within the time span after a match."""
        lies_within = match.end < negated.start and negated.end < match.end + span
        return lies_within and self._join_values(match, negated) is not None

    # ---- values ----------------------------------------------------------------------------------------

    def _join_values(self, first: Candidate, second: Candidate) -> Optional[Term]:
        """Return the values of two matches together; None if they disagree."""
        check_limits(1)
        # Only variables of the copies are bound, so no binding has to be undone.
        values = copy(first.values)
        return copy(values) if unify(values, copy(second.values), []) else None

    def _instantiate(self, values: Term, term: Term) -> Term:
        trail: Trail = []
        try:
            unify(self._rule_variables, copy(values), trail)
            return copy(term)
        finally:
            undo(trail, 0)

    def _extend(self, values: Term, bindings: Sequence[Tuple[Term, Term]]) -> Optional[Term]:
        """Return the values extended by further bindings, or None if these do not unify."""
        trail: Trail = []
        try:
            is_consistent = unify(self._rule_variables, copy(values), trail) and all(
                unify(term, copy(value), trail) for term, value in bindings
            )
            return copy(self._rule_variables) if is_consistent else None
        finally:
            undo(trail, 0)

    def _solve(self, condition: ConditionPattern, match: Candidate) -> Optional[Term]:
        """Return the values extended by those of the first solution of a condition, or None."""
        interval = (match.start, match.end) if condition.timed else None
        trail: Trail = []
        try:
            if unify(self._rule_variables, copy(match.values), trail):
                with self._rule.network.condition_state.interval(interval), closing(
                    self._logic.solutions(condition.goal)
                ) as solutions:
                    for _ in solutions:
                        return copy(self._rule_variables)
            return None
        finally:
            undo(trail, 0)

    # ---- text ------------------------------------------------------------------------------------------

    def _format_result(self, matches: List[Candidate], reason: str, term: Term = _NO_VALUES) -> str:
        """Return a text of the matches with the values of a term's variables, or the reason if there are none."""
        return self._format_candidates(matches, term) if matches else reason

    def _format_rejected(self, matches: List[Candidate], goal: Term) -> str:
        text = self._format_candidates(matches, goal)
        return f"false for {text}" if " = " in text else f"false {text}"

    def _format_candidates(self, matches: List[Candidate], term: Term) -> str:
        """Return a text of the newest matches, with the values of a term's variables and their times."""
        named_vars = [var for var in dict.fromkeys(variables(term)) if var in self._names]
        shown = []
        for match in matches[-MAX_SHOWN_CANDIDATES:]:
            values = [(self._names[var], self._instantiate(match.values, var)) for var in named_vars]
            bindings = ", ".join(
                f"{name} = {self._shorten(value)}" for name, value in values if value.__class__ is not Var
            )
            time = self._times.format_interval(match.start, match.end)
            shown.append(f"{bindings} {time}" if bindings else time)
        text = ("; " if named_vars else ", ").join(shown)
        return text if len(matches) <= MAX_SHOWN_CANDIDATES else f"{len(matches)} times, the last ones {text}"

    def _format_other_results(self, results: List[str]) -> str:
        """Return a text of the results of an aggregate that differ from those of the event that is explained."""
        if not results:
            return ""
        shown = "; ".join(results[-MAX_SHOWN_CANDIDATES:])
        return f"other results: {'... ' if len(results) > MAX_SHOWN_CANDIDATES else ''}{shown}"

    def _shorten(self, term: Term) -> str:
        text = self._show(term)
        return (
            text
            if len(text) <= MAX_SHOWN_VALUE_CHARACTERS
            else f"{text[: MAX_SHOWN_VALUE_CHARACTERS - 4]} ..."
        )

    def _show(self, term: Term) -> str:
        return show_term(term, self._logic.operators, self._names, self._field_named_variables)


def _sort_by_end(matches: List[Candidate]) -> List[Candidate]:
    """Return matches from the oldest to the newest, as a rule would have emitted them."""
    return sorted(matches, key=attrgetter("end"))


def _create_negated_part(negated: PartResult) -> PartResult:
    """Return the line about a negated part. It counts as matched, because its events need not be explained."""
    source = negated
    # A condition that was not tested explains nothing: the missing event is below it.
    while not source.was_tested and source.parts:
        source = source.parts[0]
    return PartResult(f"must not happen: {source.text}", negated.matches or [_PLACEHOLDER_MATCH], [])


class _WindowEvaluation:
    """Evaluation of a window by a new operator over the matches of its pattern.

    Args:
        node: the rule's node of the window.
        step_count: number of steps of a row pattern; 0 for other windows.
        instantiate: returns a copy of a term with the values of a match, given the values and the term.

    Attributes:
        progress: number of events in each step, for the sequence of events that got farthest; empty without steps.
        problem: text of an error in a measure or condition, or "".
    """

    def __init__(self, node: StreamNode, step_count: int, instantiate: Callable[[Term, Term], Term]):
        self._node = node
        self._stream = node.spec.create_operator(NetworkOptions())
        self._stream.set_bounds(node.stream.bounds)
        self._instantiate = instantiate
        self._outputs: List[StreamOutput] = []
        self._first_starts: Dict[Hashable, int] = {}
        """Start of the first match of each key."""
        self.progress = [0] * step_count
        self.problem = ""

    def process(self, match: Candidate) -> None:
        """Pass a match to the window, after emitting the results that are due before it."""
        check_limits(1)
        # Alarms that are due before the match come first, as in the engine.
        self._outputs += self._stream.advance_to(match.end)
        values = tuple([self._instantiate(match.values, var) for var in self._node.children[0].vars])
        try:
            element = self._node.spec.create_element(match, values, match.start, match.end)
            self._first_starts.setdefault(_get_key(element), match.start)
            self._outputs += self._stream.process(element, match.end, 0)
        except RuleError as error:
            self.problem = f", {error.message}"
        if self.progress:
            self._update_progress()

    def finish(self, now: int) -> List[StreamOutput]:
        """Return all results until the given time in nanoseconds."""
        self._outputs += self._stream.advance_to(now)
        for output in self._outputs:
            if output.error is not None:
                self.problem = f", {output.error.message}"
        return [output for output in self._outputs if output.error is None]

    def may_lack_elements(self, output: StreamOutput) -> bool:
        """Return whether a window may have begun before the first match of its key."""
        return output.start <= self._first_starts[_get_key(output.elements[-1])]

    def _update_progress(self) -> None:
        # Only a row pattern has steps.
        assert isinstance(self._stream, RowPatternWindow)
        for steps in self._stream.partial_match_steps():
            counts = [0] * len(self.progress)
            for step in steps:
                counts[step] += 1
            self.progress = max(self.progress, counts, key=_get_progress_key)


def _get_key(element: StreamElement) -> Hashable:
    return term_key((_VALUES_FUNCTOR, *element.key_values))


def _get_progress_key(counts: Sequence[int]) -> Tuple[int, int]:
    """Return a key that orders sequences of events by the last step reached, then by the number of events."""
    return max((step for step, count in enumerate(counts) if count), default=-1), sum(counts)


@lru_cache(maxsize=len(PAIR_OPERATORS))
def _compile_interval_join(
    operator: EventOperator,
) -> Callable[[int, int, int, int], Optional[Tuple[int, int]]]:
    """Return the function that joins the intervals of two matches.

    It returns the interval of the result, or None if the two do not satisfy the operator's condition.
    """
    lines = [
        "def generated(s1, e1, s2, e2):",
        f"    if not ({operator.interval_condition}):",
        "        return None",
        f"    return ({operator.start}), ({operator.end})",
    ]
    join_intervals: Callable[[int, int, int, int], Optional[Tuple[int, int]]] = codegen.function(
        lines, {}, f"pairs of {operator.name}"
    )
    return join_intervals
