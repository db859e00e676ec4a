"""Join node: a pair of matches, combined by an interval operator.

This is the two-input node of the Rete network. The matches of each operand are stored in a `MatchBuffer`, keyed by
the shared variables. A match that arrives at one operand looks up partners in the other buffer; the consumption
policy selects the partners and decides which matches remain stored. A pair is a result if

1. it satisfies the interval operator (``seq``, ``and``, Allen's relations),
2. it is not longer than a ``within`` bound,
3. no negated match lies in the gap between the operands, and
4. its conditions succeed.

These tests and the construction of the result are compiled to one Python function per direction
(`JoinNode._compile_join`). If an operand is a plain event and nothing inspects its matches, the join is also fused
with the dispatch of the event (`fused_join`), and creates no match object for an event that completes a pair
immediately.

For ``seq`` and other operators that order their operands, only left operands are stored if events arrive in order.
Right operands are stored only if the left one may be late (``out_of_order``) or revived by a retraction.
"""

from typing import (
    TYPE_CHECKING,
    AbstractSet,
    Any,
    Dict,
    Hashable,
    Iterator,
    List,
    Optional,
    Sequence,
    Tuple,
)

from ...foundation.codegen import shared_function
from ...prolog.terms.term_traversal import positions
from ...prolog.terms.types import Frame, Var
from ...serialization.state_fields import StateFields, field, part
from ...serialization.stored_field_types import State, sequence_of
from ..fused.fused_join import FusedPair, PartnerChoice, compile_fused_negation, compile_fused_operand
from ..language.event_operators import EventOperator
from ..matches.consumption_policy import (
    Emit,
    Join,
    MatchSide,
    RetainedMatches,
    join_all_at_once,
    join_all_partners,
    join_in_order,
    join_one_of_others,
    join_one_partner,
    join_revived_first,
    store_only,
)
from ..matches.expiration import retention_for_late
from ..matches.interval_index import interval_bounds
from ..matches.match_buffer import MatchBuffer
from ..matches.match_policies import NetworkOptions
from ..matches.match_types import TOKEN_KEY, ComputedValues, PartialMatch, is_retracted, unify_sides
from ..matches.negation import DeferredNegations, NegationBuffer, OverlapBuffer, OverlapSweep, RuledOutSweep
from .goal_evaluation import Test
from .lineage_graph import MatchOrPair
from .pattern_nodes import (
    EventNode,
    Fuse,
    IdentityFunction,
    MatchCheck,
    NetworkNode,
    OperandBuffer,
    checks_of_negations,
    computed_values_getter,
    part_of,
)

if TYPE_CHECKING:
    from .event_rule import EventRule


class JoinNode(NetworkNode):
    """Combines two matches by an operator, an interval bound, negations and conditions.

    Args:
        rule: the rule that it belongs to.
        operator: defines which pairs are results, and their interval.
        left: node of the left operand.
        right: node of the right operand.
        shared_vars: variables that occur more than once in the rule.
        gap: variables that receive the gap between the operands, for a negation that is tested further up; or None.
        interval_vars: pairs of variables that receive the interval of the result, for conditions tested further up.
        shares_events: whether one event may be in both operands.
        has_instants: whether an operand contains instants of matches, so that one event may be both operands of a
            sequence if nothing excludes it.
        identity_functions: functions that return the identity of the matches of the left and of the right operand.

    Attributes:
        left_can_be_revived: whether a match of the left operand can be revived by a retraction.
        right_can_be_revived: whether a match of the right operand can be revived by a retraction.
    """

    STATE = StateFields(
        field("completed_keys", sequence_of(TOKEN_KEY)),
        part("retained_matches"),
    )

    left_can_be_revived = False
    right_can_be_revived = False

    def __init__(
        self,
        rule: "EventRule",
        operator: EventOperator,
        left: NetworkNode,
        right: NetworkNode,
        shared_vars: AbstractSet[Var],
        gap: Optional[Tuple[Var, Var]],
        interval_vars: Sequence[Tuple[Var, Var]],
        shares_events: bool,
        has_instants: bool,
        identity_functions: Tuple[IdentityFunction, IdentityFunction],
    ):
        self.rule = rule
        self.operator = operator
        self.left = left
        self.right = right
        self.gap = gap
        self.shared_vars = shared_vars
        self._identity_functions = identity_functions
        position_in_left, position_in_right = positions(left.vars), positions(right.vars)
        self.join_positions = tuple(
            (position, position_in_right[var])
            for var, position in position_in_left.items()
            if var in position_in_right
        )
        self.left_buffer = MatchBuffer(rule, tuple(left_position for left_position, _ in self.join_positions))
        self.right_buffer = MatchBuffer(
            rule, tuple(right_position for _, right_position in self.join_positions)
        )
        # Values of the result as source expressions: variables that nothing above uses are dropped here (projection).
        value_sources = [
            (f"lv[{position}]", var) for position, var in enumerate(left.vars) if var in shared_vars
        ]
        value_sources += [
            (f"rv[{position}]", var)
            for position, var in enumerate(right.vars)
            if var in shared_vars and var not in position_in_left
        ]
        if gap is not None:
            value_sources += [("e1", gap[0]), ("s2", gap[1])]
        for start_var, end_var in interval_vars:
            value_sources += [("start", start_var), ("end", end_var)]
        self.value_sources = [source for source, _ in value_sources]
        self.vars = [var for _, var in value_sources]
        self.negations: List[NegationBuffer] = []
        self.negated_nodes: List[NetworkNode] = []
        self.deferred_negations: DeferredNegations = []
        self.tests: List[Test] = []
        self.completed: Dict[Hashable, None] = {}
        self.shares_events = shares_events
        self._has_instants = has_instants
        self._can_be_both_operands = shares_events and (operator.can_share_event or has_instants)
        self.span: Optional[int] = None
        self.retained_matches = RetainedMatches(self.right_buffer, right.accepts)

    def add_test(self, test: Test, value_vars: Sequence[Var]) -> None:
        """Add a condition; ``value_vars`` are the variables after it."""
        self.tests.append(test)
        self.vars = list(value_vars)

    def add_negation(self, negation: NegationBuffer, negated: NetworkNode) -> None:
        """Add a pattern that must not match between the operands."""
        self.negations.append(negation)
        self.negated_nodes.append(negated)

    def buffers(self) -> Sequence[OperandBuffer]:
        """Return the buffers of the node."""
        negations = [*self.negations, *(negation for negation, _ in self.deferred_negations)]
        negated = [buffer for negation in negations for buffer in negation.buffers()]
        return (self.left_buffer, self.right_buffer, *negated)

    def sweeps(self, options: NetworkOptions) -> List[RuledOutSweep]:
        """Return the sweeps that remove ruled-out first operands; see `NetworkNode.sweeps`."""
        if options.out_of_order or options.tracks_events or options.emits_revisions:
            # A first operand may arrive after the match that rules it out, or that match may be retracted.
            return []
        sweeps = []
        for negation in self.negations:
            sources = [self.value_sources[position] for _, position in negation.shared]
            # If the negated pattern shares a variable with the second operand, different second operands have
            # different negated matches, and no first operand is ruled out for all of them.
            if negation.uses_frontiers() and all(source.startswith("lv[") for source in sources):
                left_positions = [int(source[3:-1]) for source in sources]
                sweeps.append(RuledOutSweep(self.left_buffer, negation, left_positions))
        if not self.operator.completes_in_any_order:
            sweeps += self._overlap_sweeps()
        return sweeps

    def _overlap_sweeps(self) -> Iterator[OverlapSweep]:
        """Yield the sweeps for ``without``."""
        for negation, _ in self.deferred_negations:
            if isinstance(negation, OverlapBuffer) and negation.uses_frontiers():
                positions_in_pair = [position for _, position in negation.shared]
                sources = self.value_sources + [""] * len(self.vars)
                is_of_left = all(sources[position].startswith("lv[") for position in positions_in_pair)
                if negation.is_on_own_interval and is_of_left:
                    left_positions = [int(sources[position][3:-1]) for position in positions_in_pair]
                    yield OverlapSweep(self.left_buffer, negation, left_positions)

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the interval bound and the retention time; see `NetworkNode.set_span`."""
        self.span = span
        self.left_buffer.retention = self.right_buffer.retention = retention
        accepts_late = self.rule.options.out_of_order
        for negation in self.negations:
            negation.buffer.retention = retention_for_late(span, retention) if accepts_late else retention
        for negation, _ in self.deferred_negations:
            negation.set_span(span, retention)

    @property
    def completed_keys(self) -> List[Hashable]:
        """The keys of `completed`."""
        return list(self.completed)

    @completed_keys.setter
    def completed_keys(self, keys: Sequence[Hashable]) -> None:
        self.completed.update(dict.fromkeys(keys))

    def buffer_checks(self, saved: State) -> List[MatchCheck]:
        """See `NetworkNode.buffer_checks`."""
        negations = [*zip(self.negations, self.negated_nodes), *self.deferred_negations]
        return [self.left.accepts, self.right.accepts, *checks_of_negations(negations)]

    def can_retry(self, match_or_pair: MatchOrPair) -> bool:
        """See `NetworkNode.can_retry`."""
        if not isinstance(match_or_pair, tuple):
            return False
        left_match, right_match = match_or_pair
        return self.left.accepts(left_match) and self.right.accepts(right_match)

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node, and the join nodes on its left; see `NetworkNode.bind`."""
        node: NetworkNode = self
        fuse: Optional[Fuse] = None
        # A long sequence is a deep tree on the left, so it is walked by a loop instead of recursion.
        while isinstance(node, JoinNode):
            emit, fuse = node.bind_right(emit, options)
            node = node.left
        _bind(node, emit, options, fuse)

    def bind_right(self, emit: Emit, options: NetworkOptions) -> Tuple[Emit, Optional[Fuse]]:
        """Connect all but the left operand; return the action for its matches, and the function that fuses it."""
        operator = self.operator
        self.emit = emit
        self._test_pair = self._compile_join(True)
        self.join_pair = self._record_suppressed_joins(self._test_pair, True)
        self.left_buffer.partner_bounds = interval_bounds(operator.name, self.span, False)
        self.right_buffer.partner_bounds = interval_bounds(operator.name, self.span, True)
        self.left_buffer.min_end_for = None
        for negation in self.negations:
            # Without shared variables the bound is the same for all first operands, so the search can use it.
            if negation.uses_frontiers() and not negation.shared:
                self.left_buffer.min_end_for = negation.min_first_end
        identify_left, identify_right = (
            self._identity_functions if options.policy.replaces_identical else (None, None)
        )
        self.left_buffer.set_identity_function(None if operator.joins_all_left else identify_left)
        self.right_buffer.set_identity_function(None if self._retains_right(options) else identify_right)
        left_action = self._bind_sides(self._left_side(), self._right_side(options), emit, options)
        for node, negation in zip(self.negated_nodes, self.negations):
            _bind(node, negation.on_match, options, self._fuse_negation(node, negation, options))
            negation.bind_deferred_negations(options)
        for negation, negated in self.deferred_negations:
            negation.bind(negated, options)
        return left_action

    def _accepts_late_left(self, options: NetworkOptions) -> bool:
        """Return whether the first operand of a sequence may arrive after the second one."""
        return options.out_of_order and not self.operator.completes_in_any_order

    def _revives_operands(self, options: NetworkOptions) -> bool:
        """Return whether a retraction can revive operands of a sequence that arrive in order."""
        return (
            options.emits_revisions and not self.operator.completes_in_any_order and not options.out_of_order
        )

    def _retains_right(self, options: NetworkOptions) -> bool:
        """Return whether second operands are kept for a first one that a retraction may revive."""
        return self._revives_operands(options) and self.left_can_be_revived

    def _left_side(self) -> MatchSide:
        # A left operand is always stored, even after it has joined with a partner: later right operands may use it.
        return MatchSide(
            self.left_buffer, self.right_buffer, self.join_pair, self.join_positions, True, True, False
        )

    def _right_side(self, options: NetworkOptions) -> MatchSide:
        is_unordered, accepts_late, retains_right = (
            self.operator.completes_in_any_order,
            self._accepts_late_left(options),
            self._retains_right(options),
        )
        flipped_positions = tuple(
            (right_position, left_position) for left_position, right_position in self.join_positions
        )
        join = self._record_suppressed_joins(self._compile_join(False), False)
        if self._revives_operands(options) and self.right_can_be_revived:
            join = join_in_order(self.rule.network.tracker.current_number, join)
        stores_unmatched, stores_matched = (
            is_unordered or accepts_late or retains_right,
            accepts_late or retains_right,
        )
        right = MatchSide(
            self.right_buffer,
            self.left_buffer,
            join,
            flipped_positions,
            False,
            stores_unmatched,
            stores_matched,
        )
        if retains_right:
            right = right._replace(store=self.retained_matches.add)
        # With instants, the event of a late right operand may also complete a left one that precedes it. Unless all
        # combinations are results, an event is stored only after it was tried at both operands.
        completes_before_stored = options.policy.replaces_identical or (
            self._has_instants and accepts_late and options.policy.consumes_partners
        )
        if self.shares_events and completes_before_stored and (is_unordered or accepts_late):
            right = right._replace(store=self._store_later)
        return right

    def _bind_sides(
        self, left: MatchSide, right: MatchSide, emit: Emit, options: NetworkOptions
    ) -> Tuple[Emit, Optional[Fuse]]:
        """Connect the right operand by the policy.

        Return the action of the left one, and the function that fuses it.
        """
        policy, operator, accepts_late = options.policy, self.operator, self._accepts_late_left(options)
        is_unordered = operator.completes_in_any_order
        left_action: Tuple[Emit, Optional[Fuse]] = store_only(left), self._fuse(left, False, emit, options)
        if self._retains_right(options):
            current_number = self.rule.network.tracker.current_number
            left_action = (
                join_revived_first(
                    current_number, left, policy.consumes_partners, operator.joins_all_left, emit
                ),
                None,
            )
        if operator.joins_all_left:
            self.right.bind(join_all_at_once(right, True, emit), options)
            if not accepts_late:
                return left_action
            if policy.consumes_partners:
                return join_one_partner(left, policy.prefers_newest, emit), self._fuse(
                    left, True, emit, options
                )
            return join_all_at_once(left, False, emit), None
        fuse = self._fuse(right, True, emit, options)
        if not policy.consumes_partners:
            _bind(self.right, join_all_partners(right, emit), options, fuse)
            return (
                (join_all_partners(left, emit), self._fuse(left, True, emit, options))
                if is_unordered or accepts_late
                else left_action
            )
        # `and` with one event in both operands: each event may complete one pair only.
        completed_events = self.completed if self._can_be_both_operands and is_unordered else None
        _bind(
            self.right,
            join_one_partner(right, policy.prefers_newest, emit, completed_events),
            options,
            fuse,
        )
        if not is_unordered and not accepts_late:
            return left_action
        join_left = join_one_partner(left, policy.prefers_newest, emit, completed_events)
        # The event of a right operand is stored when it has been tried as a left operand too; see `_store_later`.
        if right.store and is_unordered:
            return self._store_deferred_first(join_left), None
        return join_left, self._fuse(left, True, emit, options)

    def _fuse(self, side: MatchSide, joins: bool, emit: Emit, options: NetworkOptions) -> Optional[Fuse]:
        """Return the function that fuses an operand with the dispatch of its events; None if it cannot be fused.

        Args:
            side: the operand.
            joins: whether its matches join with partners; else they are only stored.
            emit: receives the results.
            options: options of the network.
        """
        rule = self.rule
        if not self._may_fuse(options):
            return None
        # At the root, the pair is not created as a match: its values go directly to the head.
        completion = rule.completion if rule.root is self else None
        pair = FusedPair(
            values_are_arguments=(self.left.values_are_arguments, self.right.values_are_arguments),
            operator=self.operator,
            span=self.span,
            value_sources=list(zip(self.vars, self.value_sources)),
            negation_tests=[negation.forbids_pair for negation in self.negations],
            tests=self.tests,
            condition_vars=self.vars[len(self.value_sources) :],
            computed_values=computed_values_getter(self.vars, len(self.value_sources), self.shared_vars),
            complete=completion,
        )
        newest, consumes = options.policy.prefers_newest, options.policy.consumes_partners
        choice = PartnerChoice(newest, consumes, join_one_of_others(side, newest, emit)) if joins else None
        return lambda general_path: compile_fused_operand(side, pair, choice, rule, general_path, emit)

    def _may_fuse(self, options: NetworkOptions) -> bool:
        """Return whether nothing inspects the events of the matches, so that no match object is needed."""
        rule = self.rule
        is_inspected = (
            options.tracks_events
            or options.emits_revisions
            or rule.shares_events
            or rule.skip_state is not None
        )
        return not is_inspected and not rule.collects_garbage

    def _fuse_negation(
        self, negated: NetworkNode, negation: NegationBuffer, options: NetworkOptions
    ) -> Optional[Fuse]:
        rule = self.rule
        if not self._may_fuse(options):
            return None
        return lambda general_path: compile_fused_negation(
            negation, rule, negated.values_are_arguments, general_path
        )

    def _store_later(self, match: PartialMatch, key: Hashable) -> None:
        """Store a right operand when its event has been tried as a left operand too.

        Stored immediately, it would replace an older one of the same event that the left operand must still join
        with.
        """
        if match.event is None and self.operator.completes_in_any_order:
            self.rule.store_deferred(self.right_buffer)
            self.right_buffer.add(match, key)
        else:
            self.rule.defer_storage(self.right_buffer, match, key)

    def _store_deferred_first(self, on_match: Emit) -> Emit:
        """Return an action that first stores the right operands of the current event.

        A left operand that consists of several events may join with the right operand of its own last event.
        """
        rule = self.rule
        buffer = self.right_buffer

        def store_and_join(match: PartialMatch, frame: Frame) -> Frame:
            if match.event is None and rule.deferred_matches:
                rule.store_deferred(buffer)
            return on_match(match, frame)

        return store_and_join

    def _compile_join(self, left_arrives: bool) -> Join:
        """Compile the tests and the result of a pair; the arriving match is the first argument."""
        operator = self.operator
        namespace: Dict[str, Any] = {"Match": PartialMatch}
        # The order of the lines is from cheap to expensive: interval, span, negations, conditions.
        lines = [
            f"def generated({'l, r' if left_arrives else 'r, l'}, originals=None):",
            "    s1 = l.start; e1 = l.end; s2 = r.start; e2 = r.end",
            f"    if not ({operator.interval_condition}):",
            "        return None",
        ]
        # `and` of two different events: one event may not be both operands.
        if self._can_be_both_operands:
            lines += ["    if l.event is not None and l.event == r.event:", "        return None"]
        lines += [f"    start = {operator.start}", f"    end = {operator.end}"]
        if self.span is not None:
            lines += [f"    if end - start > {self.span}:", "        return None"]
        lines += ["    lv = l.values", "    rv = r.values"]
        lines.append(
            f"    values = ({', '.join(self.value_sources)}{',' if len(self.value_sources) == 1 else ''})"
        )
        for number, negation in enumerate(self.negations):
            namespace[f"negation{number}"] = negation.forbids_pair
            lines += [f"    if negation{number}(values, e1, s2):", "        return None"]
        for number, test in enumerate(self.tests):
            namespace[f"test{number}"] = test
            lines += [
                f"    values = test{number}(values, start, end)",
                "    if values is None:",
                "        return None",
            ]
        received_count = len(self.value_sources)
        namespace["ComputedValues"], namespace["own"] = (
            ComputedValues,
            computed_values_getter(self.vars, received_count, self.shared_vars),
        )
        parts = "(l, r, ComputedValues(own(values)))" if len(self.vars) > received_count else "(l, r)"
        lines.append(f"    return Match(values, start, end, None, None, {parts})")
        join: Join = shared_function("\n".join(lines) + "\n", namespace, f"join by {operator.name}")
        return join

    def _record_suppressed_joins(self, join: Join, left_arrives: bool) -> Join:
        """Return a join that records the pairs that a negated match suppresses, if a retraction may release them."""
        rule, tracker = self.rule, self.rule.network.tracker
        if not rule.options.tracks_events or not (self.negations or self.deferred_negations):
            return join

        def join_and_record(
            match: PartialMatch,
            partner: PartialMatch,
            originals: Optional[Tuple[PartialMatch, PartialMatch]] = None,
        ) -> Optional[PartialMatch]:
            rule.blocking_match = None
            result = join(match, partner)
            if result is None and rule.blocking_match is not None:
                # Copies are in no buffer, so that a retraction could not see whether the matches are still stored.
                match, partner = originals or (match, partner)
                tracker.record_suppressed(self, (match, partner) if left_arrives else (partner, match))
            return result

        return join_and_record

    def retry(self, pair: Tuple[PartialMatch, PartialMatch], frame: Frame) -> Frame:
        """Join two matches again, after the negated match between them was retracted."""
        left, right = pair
        options = self.rule.options
        # Meanwhile the operands may have been consumed by other pairs, or retracted themselves.
        if left.buffer is None or right.consumed_by is not None:
            return frame
        if right.buffer is None and self._stores_right(options):
            return frame
        if is_retracted(left) or is_retracted(right):
            return frame
        sides = unify_sides(left, right, self.join_positions)
        result = None if sides is None else self.join_pair(*sides, (left, right))
        if result is None:
            return frame
        if self.operator.joins_all_left:
            # The right operand may be joined with further left ones.
            left.discard()
        elif options.policy.consumes_partners:
            left.discard()
            right.consumed_by = left
            if self.operator.completes_in_any_order:
                right.discard()
        return self.emit(result, frame)

    def still_allows(self, match: PartialMatch) -> bool:
        """See `NetworkNode.still_allows`."""
        left, right = part_of(match, 0, self.left), part_of(match, 1, self.right)
        return left is None or right is None or self._test_pair(left, right) is not None

    def _stores_right(self, options: NetworkOptions) -> bool:
        return self.operator.completes_in_any_order or options.out_of_order


def _bind(node: NetworkNode, emit: Emit, options: NetworkOptions, fuse: Optional[Fuse]) -> None:
    """Connect an operand; only event nodes can be fused with the join."""
    if fuse is not None and isinstance(node, EventNode):
        node.bind(emit, options, fuse)
    else:
        node.bind(emit, options)
