"""Kleene node: repetitions (``star_times``) and aggregates after a first match.

``P seq (Q star_times)`` is a Kleene closure, in SASE terms under skip-till-next-match: a match of P starts a `Run`,
and later matches of Q extend it in place; each of them extends one run, or all runs if the policy does not consume.
Every extension emits a result that contains all repetitions so far. ``P seq aggregate(K, Q, R)`` is evaluated the
same way, with an accumulator instead of a list of repetitions, so a result costs the same for any number of
repetitions.

Conditions are divided by the data that they need:

* *step tests* use one repetition and the start; they decide whether the repetition extends the run;
* *tests* use the run as a whole and are part of the match: a repetition that fails one does not extend the run;
* *result tests* use the result of an aggregate: the repetition extends the run, but the result is not emitted;
* conditions that use variables of patterns further left are tested by nodes further up (see `condition_placement`).
  Their values are passed on as a list of items, one for each repetition (see `RepetitionItems`).

If an event is retracted, the repetitions that contain it are removed and the run is computed again
(`KleeneNode.recompute_results`).
"""

from typing import (
    TYPE_CHECKING,
    AbstractSet,
    Any,
    Callable,
    Hashable,
    Iterable,
    List,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import positions, resolve, variables
from ...prolog.terms.types import Frame, Term, Trail, Values, Var
from ...prolog.terms.unification import undo, unify
from ...serialization.state_fields import StateFields, part
from ...serialization.stored_field_types import NOTHING, FieldType, State
from ..dispatch.matcher_compiler import compile_builder
from ..language.pattern_tree import SEQ
from ..matches.consumption_policy import (
    Emit,
    RetainedMatches,
    earlier_partners,
    emit_each,
    is_revived,
    is_valid,
    metered,
)
from ..matches.interval_index import interval_bounds
from ..matches.match_buffer import MatchBuffer, has_equal_key
from ..matches.match_policies import NetworkOptions
from ..matches.match_types import (
    ComputedValues,
    EventMatch,
    PartialMatch,
    RepetitionChain,
    arrival_number_of,
    is_retracted,
    unify_sides,
    unify_values,
)
from ..matches.negation import LATE_START_RETENTION_NANOSECONDS
from ..streams.aggregates import SequenceAggregate
from .condition_placement import RepetitionItems, append_item
from .goal_evaluation import Test
from .lineage_graph import MatchOrPair
from .pattern_nodes import (
    IdentityFunction,
    MatchCheck,
    NetworkNode,
    OperandBuffer,
    checks_of_negations,
    computed_values_getter,
)
from .repetition_runs import NO_ITEMS, Run, identity_by_start, identity_by_start_interval

if TYPE_CHECKING:
    from ..matches.negation import DeferredNegations
    from .event_rule import EventRule


class KleeneValues(NetworkNode):
    """Values of a run: positions of variables, and construction of the result.

    Args:
        first: node of the matches that start a run.
        repeated: node of the matches that extend it.

    Attributes:
        step_vars: variables that the step tests of a repetition know, and those that these tests bind.
        fixed_vars: those of them, without variables of the start, that have one value in a run, because they are
            used elsewhere in the rule.
        free_vars: variables of the aggregated term that no repetition binds and that are used elsewhere in the rule.
    """

    rule: "EventRule"
    """The rule that it belongs to."""

    _computed_values: Callable[[Values], Values]
    """Returns the values that are computed here and not passed on."""

    def __init__(self, first: NetworkNode, repeated: NetworkNode):
        self.first = first
        self.repeated = repeated
        self.span: Optional[int] = None
        self.new_result_vars: List[Var] = []
        self._interval_count = 0
        self.tests: List[Test] = []
        self.result_tests: List[Test] = []
        first_vars = set(first.vars)
        self.step_vars = [*first.vars, *(var for var in repeated.vars if var not in first_vars)]
        self.free_vars: List[Var] = []

    def set_free_vars(self, value_vars: Sequence[Var]) -> None:
        """Add variables that no repetition binds and that are used elsewhere.

        They are the same in all repetitions.
        """
        known_vars = set(self.step_vars)
        self.free_vars = [var for var in value_vars if var not in known_vars]
        self.step_vars = [*self.step_vars, *self.free_vars]

    def set_result_layout(
        self,
        outside_vars: AbstractSet[Var],
        aggregate: Optional[SequenceAggregate],
        result: Optional[Term],
        items: Optional[RepetitionItems],
    ) -> None:
        """Set the values of the result, when all conditions on repetitions are known.

        Args:
            outside_vars: variables that are used elsewhere in the rule.
            aggregate: accumulator of an aggregate; None for ``star_times``.
            result: term of an aggregate's result.
            items: layout of the values of each repetition, if conditions on repetitions are tested further up; else
                None.
        """
        first_vars = self.first.vars
        first_var_set = set(first_vars)
        position_in_step = positions(self.step_vars)
        self.aggregate = aggregate
        self.initial_state = None if aggregate is None else aggregate.initial_state
        self.fixed_vars = [var for var in self.step_vars if var in outside_vars and var not in first_var_set]
        self.fixed_positions = [position_in_step[var] for var in self.fixed_vars]
        self.items = items
        # The values before this position are not computed here, see `computed_values_getter`.
        self._first_computed_position = len(first_vars)
        result_vars = [*first_vars, *self.fixed_vars]
        if items is not None:
            known_vars = set(result_vars)
            items.set_item_vars([var for var in self.step_vars if var not in known_vars])
            self._item_positions = [position_in_step[var] for var in items.item_vars]
            result_vars.insert(self._first_computed_position, items.var)
            self._first_computed_position += 1
        position_by_var = positions(result_vars)
        self._free_positions = [position_by_var[var] for var in self.free_vars]
        if aggregate is not None and result is not None:
            self.result_is_variable = result.__class__ is Var and result not in position_by_var
            self.new_result_vars = [var for var in variables(result) if var not in position_by_var]
            self._result_position = len(result_vars)
            result_vars += self.new_result_vars
            self.make_result = compile_builder(result, result_vars, "result of an aggregate")
        self.vars = result_vars

    def add_interval_vars(self, start: Var, end: Var) -> None:
        """Add the interval to the values, for a condition that may have to be tested further up too."""
        self.vars = [*self.vars, start, end]
        self._interval_count += 1

    def add_test(self, test: Test, value_vars: Sequence[Var], uses_result: bool) -> None:
        """Add a condition.

        Args:
            test: the condition.
            value_vars: variables of the values that it returns.
            uses_result: whether it uses the result of an aggregate. Such a condition decides whether the result is
                emitted; any other decides whether the repetition extends the run.
        """
        (self.result_tests if uses_result else self.tests).append(test)
        self.vars = list(value_vars)

    def _result_without_repetitions(self, run: Run) -> Optional[PartialMatch]:
        """Return the result of a run that has no repetitions yet."""
        span = self.span
        if span is not None and run.end - run.start > span:
            return None
        values = self._apply_tests(run.values, NO_ITEMS, None, run.start, run.end)
        return None if values is None else self.result_of(run, values)

    def _apply_tests(
        self, first_values: Values, items: Term, fixed_values: Optional[Values], start: int, end: int
    ) -> Optional[Values]:
        """Return the values of a run after its tests, with variables for the result; None if a test fails."""
        values: Any = first_values
        if self.items is not None:
            values += (items,)
        if self.fixed_vars:
            values += tuple([Var() for _ in self.fixed_vars]) if fixed_values is None else fixed_values
        if self.new_result_vars:
            values += tuple([Var() for _ in self.new_result_vars])
        if self._interval_count:
            values += (start, end) * self._interval_count
        for test in self.tests:
            values = test(values, start, end)
            if values is None:
                return None
        return values  # type: ignore[no-any-return]

    def result_of(self, run: Run, values: Values) -> Optional[PartialMatch]:
        """Return the result of a run in its present state, or None if it is not to be emitted."""
        result_values: Any = values
        start, end = run.start, run.last
        aggregate = self.aggregate
        if aggregate is not None:
            try:
                value = aggregate.result(run.state, run.last - run.end)
            except RuleError as error:
                # The repetition is part of the run: with further ones, the run may have a result again.
                self.rule.network.report_rule_error(self.rule, error)
                return None
            if value is None:
                return None
            if self.free_vars:
                result_values, value = self._bind_free_vars(run, result_values, value)
            result_values = self._insert_result(result_values, value)
            for test in self.result_tests:
                if result_values is None:
                    return None
                result_values = test(result_values, start, end)
            if result_values is None:
                return None
        computed_values = ComputedValues(self._computed_values(result_values))
        event = run.event if run.fixed_values is None else None
        # The `RepetitionChain` is needed even if it is empty: without it, `explanation_terms` would take the parts
        # for those of a `FilterNode` above the node of the start.
        return PartialMatch(result_values, start, end, event, None, (run.first, run.tracked, computed_values))

    def _bind_free_vars(self, run: Run, values: Values, value: Term) -> Tuple[Values, Term]:
        """Bind the variables that no repetition binds by the values that conditions gave them."""
        trail: Trail = []
        try:
            for var, position in zip(run.free_vars, self._free_positions):
                unify(var, values[position], trail)
            return tuple([resolve(element) for element in values]), resolve(value)
        finally:
            undo(trail, 0)

    def _insert_result(self, values: Values, value: Term) -> Optional[Values]:
        """Put the result in the place of its variables in the values."""
        if self.result_is_variable:
            position = self._result_position
            return (*values[:position], value, *values[position + 1 :])
        return self._unify_result(values, value)

    def _unify_result(self, values: Values, value: Term) -> Optional[Values]:
        term = self.make_result(values)
        trail: Trail = []
        try:
            return tuple([resolve(element) for element in values]) if unify(term, value, trail) else None
        finally:
            undo(trail, 0)


class KleeneNode(KleeneValues):
    """Node of ``P seq (Q star_times)`` and ``P seq aggregate(K, Q, R)``.

    Args:
        rule: the rule that it belongs to.
        shares_events: whether one event may be in both.
        has_instants: whether P or Q contains instants of matches, so that one event could be both.
        identity_functions: functions that return the identity of the matches of P and of Q.
        shared_vars: variables that occur more than once in the rule.

    Attributes:
        first_can_be_revived: whether a match of P can be revived by a retraction.
        repeated_can_be_revived: whether a match of Q can be revived by a retraction.
    """

    STATE = StateFields(
        part("retained_matches"),
    )

    first_can_be_revived = False
    repeated_can_be_revived = False

    def __init__(
        self,
        rule: "EventRule",
        first: NetworkNode,
        repeated: NetworkNode,
        shares_events: bool,
        has_instants: bool,
        identity_functions: Tuple[IdentityFunction, IdentityFunction],
        shared_vars: AbstractSet[Var],
    ):
        super().__init__(first, repeated)
        self.rule = rule
        self._identify_first, self._identify_repeated = identity_functions
        self._shared_vars = shared_vars
        self.shares_events = shares_events
        self._can_be_both_operands = shares_events and has_instants
        position_in_first, position_in_repeated = positions(first.vars), positions(repeated.vars)
        self.join_positions = tuple(
            (position, position_in_repeated[var])
            for var, position in position_in_first.items()
            if var in position_in_repeated
        )
        self.buffer = MatchBuffer(rule, tuple(first_position for first_position, _ in self.join_positions))
        self.repetition_buffer = MatchBuffer(
            rule, tuple(repeated_position for _, repeated_position in self.join_positions)
        )
        self.step_tests: List[Test] = []
        self.deferred_negations: DeferredNegations = []
        self._step_positions = [
            position for position, var in enumerate(repeated.vars) if var not in position_in_first
        ]
        self.retained_matches = RetainedMatches(self.repetition_buffer, repeated.accepts)

    def buffers(self) -> Sequence[OperandBuffer]:
        """Return the buffers of the node."""
        negated = [buffer for negation, _ in self.deferred_negations for buffer in negation.buffers()]
        return (self.buffer, self.repetition_buffer, *negated)

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the interval bound and the retention time; see `NetworkNode.set_span`."""
        self.span = span
        self.buffer.retention = retention
        self.repetition_buffer.retention = retention
        # A start emits its first result however late it arrives.
        late_retention = None if retention is None else retention + LATE_START_RETENTION_NANOSECONDS
        for negation, _ in self.deferred_negations:
            negation.set_span(span, late_retention)

    def buffer_checks(self, saved: State) -> List[MatchCheck]:
        """See `NetworkNode.buffer_checks`."""
        return [self._owns, self.repeated.accepts, *checks_of_negations(self.deferred_negations)]

    def _owns(self, run: PartialMatch) -> bool:
        # The values of each run have been checked against its node.
        return isinstance(run, Run) and run.node is self and run.start <= run.end

    def run_state_type(self) -> FieldType[Any]:
        """See `NetworkNode.run_state_type`."""
        return NOTHING if self.aggregate is None else self.aggregate.state_type

    def accepts_run(self, run: Run) -> bool:
        """See `NetworkNode.accepts_run`."""
        width, step_width = len(self.first.vars), len(self.step_vars)
        return (
            self.first.accepts(run.first)
            and len(run.values) == width
            and (run.fixed_values is None or len(run.fixed_values) == len(self.fixed_vars))
            and len(run.free_vars) == len(self.free_vars)
            and len(run.repetitions) == len(run.step_values)
            and all(map(self.repeated.accepts, run.repetitions))
            and all(len(values) == width and len(step) >= step_width for values, step in run.step_values)
        )

    def has_entry(self, owner: object, entry: object) -> bool:
        """See `NetworkNode.has_entry`."""
        return isinstance(owner, Run) and owner.node is self and isinstance(entry, EventMatch)

    def can_retry(self, match_or_pair: MatchOrPair) -> bool:
        """See `NetworkNode.can_retry`."""
        if not isinstance(match_or_pair, tuple):
            return False
        run, match = match_or_pair
        return self._owns(run) and self.repeated.accepts(match)

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        policy = options.policy
        self.tracks_events = options.tracks_events
        self.extend_run: Callable[[Any, PartialMatch, bool], Tuple[bool, Optional[PartialMatch]]]
        self.extend_run = (
            self._extend_and_record if options.tracks_events and self.deferred_negations else self.extend
        )
        if self._can_be_both_operands:
            self.extend_run = _require_other_event(self.extend_run)
        self.consumes_partners = policy.consumes_partners
        self.accepts_late_starts = options.out_of_order
        self.defers_storage = (
            self.accepts_late_starts
            and self.shares_events
            and (policy.replaces_identical or self._can_be_both_operands)
        )
        revises = options.emits_revisions and not self.accepts_late_starts
        self.retains_repetitions, self.joins_in_order = (
            revises and self.first_can_be_revived,
            revises and self.repeated_can_be_revived,
        )
        self.buffer.partner_bounds = interval_bounds(SEQ, self.span, False)
        self.repetition_buffer.partner_bounds = interval_bounds(SEQ, self.span, True)
        self.buffer.set_identity_function(
            (identity_by_start if policy.replaces_identical else identity_by_start_interval)(
                self._identify_first
            )
        )
        self.repetition_buffer.set_identity_function(
            self._identify_repeated if policy.replaces_identical and not self.retains_repetitions else None
        )
        self._computed_values = computed_values_getter(
            self.vars, self._first_computed_position, self._shared_vars
        )
        self.emit = emit
        # The repetitions are connected first: an event that is both starts a run only after it has extended earlier
        # ones.
        if policy.consumes_partners:
            self.repeated.bind(self._extend_one_action(emit, policy.prefers_newest), options)
        else:
            self.repeated.bind(self._extend_all_action(emit), options)
        self.first.bind(self._start_action(emit), options)
        for negation, negated in self.deferred_negations:
            negation.bind(negated, options)

    def _start_action(self, emit: Emit) -> Emit:
        buffer = self.buffer
        aggregate = self.aggregate
        emits_empty_result = aggregate is None or aggregate.empty_result is not None

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            run = Run(self, match)
            key = buffer.key_of(run)
            older = buffer.find_identical(run, key)
            # The same occurrence may arrive twice, for example by two branches of an `or`; it must not reset its
            # run.
            if older is not None and older.start == run.start and older.end == run.end:
                return frame
            buffer.add(run, key)
            result = self._result_without_repetitions(run) if emits_empty_result else None
            if self.accepts_late_starts or (
                self.retains_repetitions
                and is_revived(self.rule.network.tracker.current_number, arrival_number_of(run))
            ):
                results = [] if result is None else [result]
                results += self._results_of_earlier(run, key)
                return emit_each(iter(results), emit, frame)
            return frame if result is None else emit(result, frame)

        return on_match

    def _results_of_earlier(self, run: Run, key: Hashable) -> List[PartialMatch]:
        """Return the results of a late start with the repetitions that arrived before it, in their order.

        A revived start takes the repetitions that arrived after it and are still available.
        """
        results = []
        arrival_number = arrival_number_of(run) if self.retains_repetitions else 0
        for match in metered(self.repetition_buffer.partner_list(key, run.start, run.end), self.rule.meter):
            if self.retains_repetitions and (
                arrival_number_of(match) <= arrival_number
                or (self.consumes_partners and is_valid(match.consumed_by))
            ):
                continue
            extended, result = self.extend_run(run, match, has_equal_key(key, match))
            if extended:
                match.consumed_by = run
                if self.consumes_partners and self.accepts_late_starts:
                    match.discard()
            if result is not None:
                results.append(result)
        return results

    def _store_repetition(self, match: PartialMatch, key: Hashable) -> None:
        """Store a repetition for late starts."""
        # An event that may also be a start is stored after it was tried as such; else it would replace an older
        # repetition that the start needs.
        if self.defers_storage:
            self.rule.defer_storage(self.repetition_buffer, match, key)
        elif self.accepts_late_starts:
            self.repetition_buffer.add(match, key)
        elif self.retains_repetitions:
            self.retained_matches.add(match, key)

    def _extend_one_action(self, emit: Emit, newest: bool) -> Emit:
        stores_repetition, joins_in_order, extend = (
            self.accepts_late_starts or self.retains_repetitions,
            self.joins_in_order,
            self.extend_run,
        )
        meter = self.rule.meter

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            key = self.repetition_buffer.key_of(match)
            extended, result = False, None
            runs: Iterable[PartialMatch] = self.buffer.partners(key, match.start, match.end, newest)
            if joins_in_order:
                runs = earlier_partners(match, runs, self.rule.network.tracker.current_number)
            for run in metered(runs, meter):
                extended, result = extend(run, match, has_equal_key(key, run))
                if extended:
                    match.consumed_by = run
                    break
            if stores_repetition:
                self._store_repetition(match, key)
            return frame if result is None else emit(result, frame)

        return on_match

    def _extend_all_action(self, emit: Emit) -> Emit:
        stores_repetition, joins_in_order, extend = (
            self.accepts_late_starts or self.retains_repetitions,
            self.joins_in_order,
            self.extend_run,
        )
        meter = self.rule.meter

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            key = self.repetition_buffer.key_of(match)
            runs: Iterable[PartialMatch] = self.buffer.partner_list(key, match.start, match.end)
            if joins_in_order:
                runs = earlier_partners(match, runs, self.rule.network.tracker.current_number)
            # The repetition is stored before results are emitted: a start that follows from a result must find it.
            if stores_repetition:
                self._store_repetition(match, key)
            if not runs:
                return frame
            results = (
                result
                for run in metered(runs, meter)
                if run.buffer is not None
                for result in (extend(run, match, has_equal_key(key, run))[1],)
                if result is not None
            )
            return emit_each(results, emit, frame)

        return on_match

    def extend(
        self, run: Run, match: PartialMatch, shares_values: bool
    ) -> Tuple[bool, Optional[PartialMatch]]:
        """Extend a run if the match satisfies all tests; return whether it did, and the result to emit.

        Args:
            run: the run.
            match: the repetition.
            shares_values: whether run and match are known to have the same values of the shared variables; otherwise
                these are unified.
        """
        # `star_times` requires each repetition to follow the one before it; an aggregate only requires it to follow
        # the start.
        if match.start <= (run.last if self.aggregate is None else run.end):
            return False, None
        last = run.last if run.last >= match.end else match.end
        span = self.span
        if span is not None and last - run.start > span:
            return False, None
        values: Any = run.values
        if not shares_values:
            sides = unify_sides(run, match, self.join_positions)
            if sides is None:
                return False, None
            values, match = sides[0].values, sides[1]
        step_values: Any = (
            values + tuple([match.values[position] for position in self._step_positions]) + run.free_vars
        )
        for test in self.step_tests:
            step_values = test(step_values, match.start, match.end)
            if step_values is None:
                return False, None
            # The test may have bound variables of the start.
            values = step_values[: len(values)]
        extended, result = self._add_repetition(run, match, values, step_values, last)
        if extended and self.tracks_events:
            self.rule.network.tracker.register_repetition(run, match, self)
        return extended, result

    def _extend_and_record(
        self, run: Run, match: PartialMatch, shares_values: bool
    ) -> Tuple[bool, Optional[PartialMatch]]:
        """Extend a run as `extend` does.

        If a negation prevents it, record that, to try again if the cause is retracted.
        """
        rule = self.rule
        rule.blocking_match = None
        extended, result = self.extend(run, match, shares_values)
        if not extended and rule.blocking_match is not None:
            rule.network.tracker.record_suppressed(self, (run, match))
        return extended, result

    def _add_repetition(
        self, run: Run, match: PartialMatch, values: Values, step_values: Values, last: int
    ) -> Tuple[bool, Optional[PartialMatch]]:
        """Add a repetition to a run if the values together satisfy the tests; return as `extend`."""
        fixed_values: Any = tuple([step_values[position] for position in self.fixed_positions])
        if run.fixed_values is not None:
            fixed_values = unify_values(run.fixed_values, fixed_values)
            if fixed_values is None:
                return False, None
        items: Term = NO_ITEMS
        if self.items is not None:
            items = append_item(
                run.items, tuple([step_values[position] for position in self._item_positions])
            )
        tested_values = self._apply_tests(values, items, fixed_values, run.start, last)
        if tested_values is None:
            return False, None
        state = run.state
        if self.aggregate is not None:
            try:
                state = self.aggregate.add(state, step_values)
            except RuleError as error:
                self.rule.network.report_rule_error(self.rule, error)
                return False, None
        # All tests have passed.
        run.commit(last, fixed_values, items, values, state)
        if self.tracks_events:
            run.repetitions.append(match)
            run.tracked = RepetitionChain(match, run.tracked)
            run.step_values.append((values, step_values))
        return True, self.result_of(run, tested_values)

    def remove_retracted(self, run: Run, match: PartialMatch) -> bool:
        """Return True, so that the caller calls `recompute_results`, which removes the repetition."""
        return True

    def recompute_results(self, run: Run) -> List[PartialMatch]:
        """Return the results, computed again, that contained repetitions whose events were retracted.

        If pattern work reaches its limit, the run has the repetitions so far.
        """
        if is_retracted(run.first):
            return []
        repetitions = [
            (match, step) for match, step in zip(run.repetitions, run.step_values) if is_valid(match)
        ]
        if len(repetitions) == len(run.repetitions):
            return []
        # Results before the first retracted repetition remain valid and are not emitted again.
        first_invalid = next(index for index, match in enumerate(run.repetitions) if not is_valid(match))
        # Accumulators cannot remove a value, so the run is computed from the start.
        run.restart(self.initial_state)
        results = []
        for number, (match, (values, step_values)) in enumerate(metered(repetitions, self.rule.meter)):
            _, result = self._add_repetition(run, match, values, step_values, max(run.last, match.end))
            if number >= first_invalid and result is not None:
                results.append(result)
        return results if self.rule.active else []

    def invalid_results(self) -> List[RepetitionChain]:
        """Return an empty list: a result becomes invalid only with a repetition that it contains."""
        return []

    def retry(self, retried: Union[PartialMatch, Tuple[Run, PartialMatch]], frame: Frame) -> Frame:
        """Emit a result that was computed again, or extend a run by a repetition that a negation had prevented."""
        result: Optional[PartialMatch]
        if isinstance(retried, PartialMatch):
            result = retried
        else:
            run, match = retried
            if run.buffer is None or (self.consumes_partners and match.consumed_by is not None):
                return frame
            extended, result = self.extend_run(run, match, False)
            if extended:
                match.consumed_by = run
        if result is None or is_retracted(result):
            return frame
        # The result arrives after its events; a match that has fired meanwhile may have skipped it.
        skip_state = None if self.is_negated else self.rule.skip_state
        return (
            self.emit(result, frame)
            if skip_state is None or skip_state.accepts_start(result.start)
            else frame
        )


_ExtendRun = Callable[[Any, PartialMatch, bool], Tuple[bool, Optional[PartialMatch]]]


def _require_other_event(extend_run: _ExtendRun) -> _ExtendRun:
    """Return a function like `KleeneNode.extend` that rejects a repetition that is the single event of the start."""

    def extend(run: Run, match: PartialMatch, shares_values: bool) -> Tuple[bool, Optional[PartialMatch]]:
        if run.first.event is not None and run.first.event == match.event:
            return False, None
        return extend_run(run, match, shares_values)

    return extend
