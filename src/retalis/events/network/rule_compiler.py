"""Rule compiler: from the pattern of a rule to its tree of network nodes.

The compiler walks the pattern top-down and builds the nodes bottom-up, as the NFACompiler of Flink or the Rete
builder of Drools do. On the way down it passes the *context* (variables of the patterns further left) and the
*retention* (the smallest interval bounds above). Each part returns `BuiltPattern`: its node, its event nodes in the
order of dispatch, and the conditions that could not be tested below because they need variables of the context.

Conditions belong to the nearest operator below them. `unwrap` collects them, `_split` divides them into those that
the operator can test and those that it must defer, and the join with the left operand tests the deferred ones.

A sequence of n patterns is a left-deep tree; its pairs are collected in a list and built in a loop, so a long
sequence needs no deep recursion. The order of the event nodes matters if one event matches several of them: right
operands receive events before left ones, so that an event completes a match before it is stored.
"""

from functools import partial
from typing import TYPE_CHECKING, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple, TypeVar, Union

from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import NIL, Term, Var
from ..dispatch.matcher_compiler import compile_builder
from ..language.event_operators import PAIR_OPERATORS
from ..language.pattern_tree import (
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
    Pattern,
    RatePattern,
    RepeatedPattern,
    WindowPattern,
    always_bound_by,
    bound_by,
    occurrences,
)
from ..matches.expiration import UNLIMITED, Retention, smaller_bound
from ..matches.negation import DeferredNegations
from ..streams.aggregates import SequenceAggregate
from .condition_placement import (
    BuiltPattern,
    DeferredCondition,
    NegatedPattern,
    OverlapCondition,
    RepetitionItems,
    TestedCondition,
    UnwrappedPattern,
    VarSet,
    compile_deferred_test,
    compile_early_test,
    compile_overlap_test,
    create_negation_buffer,
    find_condition_vars,
    find_shared_vars,
    has_instants,
    may_be_revived,
    may_share_event,
    order_by_result_use,
    order_for_dispatch,
    split_testable,
    unwrap,
)
from .goal_evaluation import Evaluators, RuleGoal, Test, compile_condition_test
from .join_node import JoinNode
from .kleene_node import KleeneNode
from .pattern_nodes import (
    ActionNode,
    BindNode,
    BoundedNode,
    EarlyTestNode,
    EndNode,
    EventNode,
    FilterNode,
    IdentityFunction,
    InstantNode,
    MatchKeys,
    NetworkNode,
    NotNode,
    OrNode,
)
from .repeat_node import RepeatNode
from .stream_compiler import StreamCompiler
from .stream_node import StreamNode

if TYPE_CHECKING:
    from .event_rule import EventRule


N = TypeVar("N", bound=NetworkNode)


class SplitConditions(NamedTuple):
    """The conditions of a pattern.

    Attributes:
        conditions: all conditions in order, deferred ones as `DeferredCondition`.
        deferred: the deferred ones alone.
    """

    conditions: List[TestedCondition]
    deferred: List[DeferredCondition]


class RuleCompiler(StreamCompiler):
    """Builds the nodes of one rule.

    Args:
        rule: the rule at run time.
        head: the head of the rule in a list; empty for a rule without a head.

    Attributes:
        nodes: all nodes with their bounds.
        stream_nodes: the operators on streams in the order of their alarms. As for events, the right
            operand of a pair precedes the left one: a match is completed before it is replaced.
        negated_leaves: event nodes of negated patterns, in the order of dispatch.
    """

    def __init__(self, rule: "EventRule", head: List[Term], pattern: Pattern):
        super().__init__(rule)
        self.pattern = pattern
        self.shared_vars = find_shared_vars(head, pattern)
        self._occurrence_counts = occurrences(head, pattern)
        self._match_keys = MatchKeys(self.shared_vars)
        self.nodes: List[BoundedNode] = []
        self.stream_nodes: List[StreamNode] = []
        self.negated_leaves: List[EventNode] = []
        self._bindable_vars_cache: Dict[int, VarSet] = {}

    def build(self) -> NetworkNode:
        """Return the root of the tree."""
        built = self._build(self.pattern, frozenset(), UNLIMITED)
        if built.deferred:
            raise RuleError("a condition uses variables that no pattern to its left binds", self.rule.place)
        for rank, leaf in enumerate([*self.negated_leaves, *built.leaves]):
            leaf.rank = rank
        for position, stream in enumerate(self.stream_nodes):
            stream.position = position
        node = root = built.node
        # Filters and goals of the whole pattern see only complete matches, so they test the window of the label.
        while isinstance(node, (ActionNode, FilterNode, EarlyTestNode)):
            node.tests_label_window = True
            node = node.child
        self._limit_parts(root)
        return root

    def _limit_parts(self, root: NetworkNode) -> None:
        """Apply the window of the label to each ``without`` whose interval is a part of that of the rule's match."""
        nodes = [root]
        while nodes:
            node = nodes.pop()
            if isinstance(node, EarlyTestNode):
                node.tests_label_window = True
            if isinstance(node, (ActionNode, FilterNode, EarlyTestNode, BindNode, NotNode)):
                nodes.append(node.child)
            elif isinstance(node, OrNode):
                nodes += node.children
            elif isinstance(node, JoinNode):
                nodes += (node.left, node.right)

    def _build(self, pattern: Pattern, context: VarSet, retention: Retention) -> BuiltPattern:
        """Build a pattern.

        Args:
            pattern: the pattern.
            context: variables of the patterns to its left.
            retention: smallest interval bounds above it.
        """
        pairs: List[Tuple[PairPattern, UnwrappedPattern, Retention]] = []
        first_left_stream = len(self.stream_nodes)
        while True:
            unwrapped = unwrap(pattern)
            retention = retention.within(unwrapped.span)
            pattern = unwrapped.pattern
            if not isinstance(pattern, PairPattern):
                break
            pairs.append((pattern, unwrapped, retention))
            pattern = pattern.left
        built = self._build_operand(unwrapped, context, retention)
        # Innermost pair first.
        while pairs:
            pair, unwrapped, retention = pairs.pop()
            built = self._build_join(pair, unwrapped, context, retention, built, first_left_stream)
        return built

    def _build_operand(
        self, unwrapped: UnwrappedPattern, context: VarSet, retention: Retention
    ) -> BuiltPattern:
        """Build a pattern that is not a pair."""
        pattern = unwrapped.pattern
        if isinstance(pattern, (KleenePattern, AggregatePattern)):
            return self._build_kleene(pattern, unwrapped, context, retention)
        if isinstance(pattern, RepeatedPattern):
            return self._build_repeat(pattern, context, retention)
        if isinstance(pattern, EventPattern):
            leaf = self._add(EventNode(self.rule, pattern.term), None, UNLIMITED)
            built = BuiltPattern(leaf, [], [], [leaf])
        elif isinstance(pattern, OrPattern):
            branches = [self._build(branch, context, retention) for branch in pattern.branches]
            node: NetworkNode = OrNode(
                [branch.node for branch in branches],
                self.shared_vars,
                None if self.rule.use_counts is None else self.rule.use_counts.branch_counts(pattern),
            )
            deferred = [condition for branch in branches for condition in branch.deferred]
            joined_leaves = [leaf for branch in branches for leaf in branch.joined_leaves]
            single_leaves = [leaf for branch in branches for leaf in branch.single_leaves]
            branch_leaves = [leaf for branch in branches for leaf in branch.leaves]
            built = BuiltPattern(
                self._add(node, None, retention), deferred, joined_leaves, single_leaves, branch_leaves
            )
        elif isinstance(pattern, NotPattern):
            built = self._build_not(pattern, context, retention)
        elif isinstance(pattern, (WindowPattern, RatePattern, AbsencePattern, NotPrecededPattern)):
            built = self._build_stream(pattern, context, retention.max_interval)
        elif isinstance(pattern, InstantPattern):
            # A bound above limits the time between instants, not the intervals of the matches below.
            below = self._build(pattern.pattern, context, UNLIMITED)
            built = below._replace(node=self._add(InstantNode(below.node, pattern.at_end), None, UNLIMITED))
        else:
            assert isinstance(pattern, ActionPattern)
            below = self._build(pattern.pattern, context, retention)
            node = ActionNode(
                below.node,
                RuleGoal(self.rule, pattern.goal, below.node.vars),
                pattern.every,
                self.shared_vars,
            )
            built = below._replace(node=self._add(node, None, retention))
        return self._add_filter(built, unwrapped, context, retention.max_interval)

    def _build_repeat(self, repeated: RepeatedPattern, context: VarSet, retention: Retention) -> BuiltPattern:
        """Build a repeated pattern, by a `RepeatNode` if possible, else written out as a sequence."""
        if repeated.repeats_single_events():
            # If the pattern has deferred conditions, the nodes built so far are discarded, and the sequence is
            # built instead.
            node_count = len(self.nodes)
            built = self._build(repeated.pattern, context | self._bindable_vars(repeated.pattern), retention)
            if not built.deferred:
                identity_functions = partial(self._match_keys.identity_function, pattern=repeated.pattern)
                repeat_node = RepeatNode(
                    self.rule, built.node, repeated.times, self.shared_vars, identity_functions
                )
                node = self._add(repeat_node, None, retention)
                return BuiltPattern(node, [], built.leaves, [])
            del self.nodes[node_count:]
        sequence = repeated.as_sequence()
        if self.rule.use_counts is not None:
            self.rule.use_counts.add_repetitions(repeated, sequence)
        return self._build(sequence, context, retention)

    def _bindable_vars(self, pattern: Pattern) -> VarSet:
        """Return the variables that a match of a pattern may bind; cached for the parts of a sequence."""
        bound = self._bindable_vars_cache.get(id(pattern))
        if bound is None:
            if isinstance(pattern, PairPattern) and id(pattern.left) in self._bindable_vars_cache:
                bound = self._bindable_vars(pattern.left).union(bound_by(pattern.right))
            else:
                bound = frozenset(bound_by(pattern))
            self._bindable_vars_cache[id(pattern)] = bound
        return bound

    def _identity_function(self, built: BuiltPattern, pattern: Pattern) -> IdentityFunction:
        return self._match_keys.identity_function(built.node.vars, pattern)

    def _add(self, node: N, span: Optional[int], retention: Retention) -> N:
        if isinstance(node, StreamNode):
            self.stream_nodes.append(node)
        self.nodes.append(BoundedNode(node, span, retention))
        return node

    def _add_filter(
        self,
        built: BuiltPattern,
        unwrapped: UnwrappedPattern,
        context: VarSet,
        max_interval: Optional[int],
    ) -> BuiltPattern:
        """Add nodes with the conditions of a pattern above its node, unless it is a pair or a repetition.

        Args:
            built: result of building the pattern without its conditions.
            unwrapped: the pattern.
            context: variables of the patterns to its left.
            max_interval: longest interval of a useful match, in ns; None for no bound.
        """
        if isinstance(unwrapped.pattern, WindowPattern):
            max_interval = smaller_bound(max_interval, unwrapped.pattern.window.max_duration)
        conditions, newly_deferred = self._split(
            unwrapped.conditions, unwrapped.pattern, context, built.deferred
        )
        node = built.node
        for deferred in newly_deferred:
            node = self._add_bind_node(node, deferred)
        value_vars: List[Var] = node.vars
        tests: List[Test] = []
        for condition in conditions:
            negations: DeferredNegations = []
            # A repetition ends with the event that completes it; other matches may come from a window.
            expects_late = not isinstance(unwrapped.pattern, RepeatedPattern)
            compiled_test = self._compile_test(negations, condition, value_vars, expects_late)
            if compiled_test is None:
                continue
            if negations:
                # A negation needs a node that can try again after a retraction; the tests so far stay below it.
                if tests:
                    node = self._add(FilterNode(node, value_vars, tests, self.shared_vars), None, UNLIMITED)
                    tests = []
                early_test = EarlyTestNode(self.rule, node, compiled_test[0], negations)
                node = self._add(early_test, max_interval, UNLIMITED)
            else:
                tests.append(compiled_test[0])
                value_vars = compiled_test[1]
        if tests or unwrapped.span is not None:
            node = self._add(FilterNode(node, value_vars, tests, self.shared_vars), unwrapped.span, UNLIMITED)
        return built._replace(node=node, deferred=[*built.deferred, *newly_deferred])

    def _split(
        self,
        conditions: List[Union[ConditionPattern, NotPattern]],
        pattern: Pattern,
        context: VarSet,
        deferred_below: Sequence[DeferredCondition],
    ) -> SplitConditions:
        """Divide the conditions of a pattern into those that it can test and those that are deferred.

        Args:
            conditions: the conditions.
            pattern: the pattern, without the conditions.
            context: variables of the patterns to its left.
            deferred_below: conditions below that are tested further up.
        """
        if not conditions:
            return SplitConditions([], [])
        assigned: List[TestedCondition] = []
        # A deferred goal binds its variables further up only.
        unbound_vars = {
            var for below in deferred_below if below.goal is not None for var in variables(below.goal)
        }
        # A variable that only some branches bind counts as unbound: the condition must then wait for the left
        # operand.
        known_vars = always_bound_by(pattern, False, True)
        for condition in conditions:
            if isinstance(condition, NotPattern):
                inner_context = context | frozenset(bound_by(condition.pattern))
                negated = self._make_negated(condition, inner_context, UNLIMITED)
                missing_vars = negated.find_missing_vars(context | unbound_vars, known_vars)
                assigned.append(
                    self._defer(missing_vars, negated=negated, scope=NegationScope.OVERLAP)
                    if missing_vars
                    else OverlapCondition(negated, frozenset(negated.mentioned_vars()))
                )
                continue
            goal_vars = set(variables(condition.goal))
            missing_vars = (goal_vars & context) - known_vars
            if missing_vars:
                assigned.append(self._defer(missing_vars, condition))
                unbound_vars |= goal_vars
            else:
                assigned.append(condition)
                known_vars |= goal_vars
        deferred = [condition for condition in assigned if isinstance(condition, DeferredCondition)]
        return SplitConditions(assigned, deferred)

    def _compile_test(
        self,
        negations: DeferredNegations,
        condition: TestedCondition,
        value_vars: List[Var],
        expects_late: bool = False,
    ) -> Optional[Tuple[Test, List[Var]]]:
        """Return the test of a condition at a node and the variables after it; None if it cannot be tested there.

        A deferred condition is tried at a node that may bind all variables that it requires.

        Args:
            negations: receives the negation buffers of the condition.
            condition: the condition.
            value_vars: variables of the node.
            expects_late: whether the node emits matches long after their ends.
        """
        if isinstance(condition, DeferredCondition):
            return (
                compile_early_test(self.rule, negations, condition, value_vars)
                if condition.may_be_testable(value_vars)
                else None
            )
        if isinstance(condition, OverlapCondition):
            test = compile_overlap_test(self.rule, negations, condition, value_vars, expects_late)
            return test, value_vars
        rule_goal = RuleGoal(self.rule, condition.goal, value_vars)
        return compile_condition_test(rule_goal, condition, None), rule_goal.result_vars

    def _defer(
        self,
        required_vars: Set[Var],
        condition: Optional[ConditionPattern] = None,
        negated: Optional[NegatedPattern] = None,
        scope: NegationScope = NegationScope.BEFORE,
    ) -> DeferredCondition:
        """Return a condition that is tested further up: a goal, ``without``, or a negation of all earlier matches."""
        start, end = Var(), Var()
        self.shared_vars |= {start, end}
        # Matches may differ in the node that binds these variables.
        if condition is not None:
            mentioned = variables(condition.goal)
            self.shared_vars.update(mentioned)
            self._match_keys.passed_on_vars.update(mentioned)
        return DeferredCondition(required_vars, condition, start, end, negated, scope)

    def _add_bind_node(self, node: NetworkNode, deferred: DeferredCondition) -> NetworkNode:
        """Add a node that passes on the interval of a match, for a condition."""
        return self._add(BindNode(node, deferred.start, deferred.end), None, UNLIMITED)

    def _build_right(
        self, pattern: Pattern, context: VarSet, retention: Retention, first_left_stream: int
    ) -> BuiltPattern:
        """Build the right operand of a pair; the streams of the left one begin at ``first_left_stream``."""
        # The alarms of the operators of the right operand run first, see `stream_nodes`; the left ones were built
        # before.
        left_streams = self.stream_nodes[first_left_stream:]
        del self.stream_nodes[first_left_stream:]
        built = self._build(pattern, context, retention)
        self.stream_nodes += left_streams
        return built

    def _build_join(
        self,
        pair: PairPattern,
        unwrapped: UnwrappedPattern,
        context: VarSet,
        retention: Retention,
        left: BuiltPattern,
        first_left_stream: int,
    ) -> BuiltPattern:
        """Build a pair whose left operand is built; its streams begin at ``first_left_stream``."""
        inner_context = context | self._bindable_vars(pair.left)
        right = self._build_right(pair.right, inner_context, retention, first_left_stream)
        deferred_below = [*left.deferred, *right.deferred]
        always_bound: Set[Var] = set()
        # Computed only if it is needed, because the analysis visits the whole left operand.
        if deferred_below or unwrapped.negated is not None:
            always_bound = always_bound_by(pair, False, True)
        testable, deferred = (
            split_testable(deferred_below, always_bound, context) if deferred_below else ([], [])
        )
        conditions, newly_deferred = self._split(unwrapped.conditions, pair, context, deferred)
        negated: Optional[NegatedPattern] = None
        required_vars: Set[Var] = set()
        if unwrapped.negated is not None:
            negation_context = inner_context | frozenset(bound_by(pair.right))
            negation_context |= find_condition_vars(unwrapped.conditions)
            negated = self._make_negated(
                unwrapped.negated, negation_context, retention.of_negated(unwrapped.span)
            )
            known_vars = set(left.node.vars) | set(right.node.vars)
            required_vars = negated.find_missing_vars(
                negation_context, known_vars
            ) | negated.find_missing_vars(context, always_bound)
        gap = (Var(), Var()) if required_vars else None
        self.shared_vars |= set(gap or ())
        node = JoinNode(
            rule=self.rule,
            operator=PAIR_OPERATORS[pair.operator],
            left=left.node,
            right=right.node,
            shared_vars=self.shared_vars,
            gap=gap,
            interval_vars=[(condition.start, condition.end) for condition in newly_deferred],
            shares_events=may_share_event(left, right),
            has_instants=has_instants(pair),
            identity_functions=(
                self._identity_function(left, pair.left),
                self._identity_function(right, pair.right),
            ),
        )
        node.left_can_be_revived = may_be_revived(pair.left)
        node.right_can_be_revived = may_be_revived(pair.right)
        self._add(node, unwrapped.span, retention)
        if negated is not None and gap is None:
            built = negated.next_copy()
            negation = create_negation_buffer(self.rule, built, node.vars, NegationScope.BETWEEN)
            node.add_negation(negation, built.node)
        self._test_joined(node, deferred_below, testable, conditions)
        deferred += newly_deferred
        if negated is not None and gap is not None:
            deferred += self._test_gap(
                node, DeferredCondition(required_vars, None, *gap, negated), conditions
            )
        joined_leaves = order_for_dispatch(PAIR_OPERATORS[pair.operator].completes_in_any_order, left, right)
        return BuiltPattern(node, deferred, joined_leaves, [])

    def _make_negated(
        self,
        pattern: Union[NotPattern, AbsencePattern, NotPrecededPattern],
        context: VarSet,
        retention: Retention,
    ) -> NegatedPattern:
        def build() -> BuiltPattern:
            built = self._build(pattern.negated, context, retention)
            if isinstance(pattern, NotPattern) and pattern.scope is NegationScope.OVERLAP:
                return built._replace(node=self._add(EndNode(built.node), None, UNLIMITED))
            return built

        return NegatedPattern(build, self.nodes, self.negated_leaves)

    def _test_joined(
        self,
        node: JoinNode,
        deferred_below: List[DeferredCondition],
        testable: List[DeferredCondition],
        conditions: Sequence[TestedCondition],
    ) -> None:
        """Add the conditions that the operands of a pair have deferred, and those of the pair itself."""
        for deferred in deferred_below:
            if deferred in testable:
                node.add_test(*compile_deferred_test(self.rule, node.deferred_negations, deferred, node.vars))
            elif deferred.may_be_testable(node.vars):
                node.add_test(*compile_early_test(self.rule, node.deferred_negations, deferred, node.vars))
        for condition in conditions:
            compiled_test = self._compile_test(node.deferred_negations, condition, node.vars)
            if compiled_test is not None:
                node.add_test(*compiled_test)

    def _test_gap(
        self, node: JoinNode, gap_condition: DeferredCondition, conditions: Sequence[TestedCondition]
    ) -> List[DeferredCondition]:
        """Test a negation with conditions on outer variables, or return it for the nodes above."""
        if not gap_condition.required_vars - find_condition_vars(conditions):
            # The conditions of the pair bind all of its variables.
            node.add_test(
                *compile_deferred_test(self.rule, node.deferred_negations, gap_condition, node.vars)
            )
            return []
        if gap_condition.may_be_testable(node.vars):
            node.add_test(*compile_early_test(self.rule, node.deferred_negations, gap_condition, node.vars))
        return [gap_condition]

    def _build_not(self, pattern: NotPattern, context: VarSet, retention: Retention) -> BuiltPattern:
        below = self._build(pattern.pattern, context, retention)
        inner_context = context | frozenset(bound_by(pattern.pattern))
        negated = self._make_negated(pattern, inner_context, UNLIMITED)
        always_bound = always_bound_by(pattern.pattern, False, True)
        missing_vars = negated.find_missing_vars(
            inner_context, set(below.node.vars)
        ) | negated.find_missing_vars(context, always_bound)
        # The negated pattern needs no variables from further left, so it is tested directly above its pattern.
        if not missing_vars:
            built = negated.next_copy()
            negation = create_negation_buffer(self.rule, built, below.node.vars, NegationScope.BEFORE)
            node: NetworkNode = self._add(
                NotNode(self.rule, below.node, built.node, negation), None, UNLIMITED
            )
            return below._replace(node=node)
        gap_condition = self._defer(missing_vars, negated=negated)
        node = self._add_bind_node(below.node, gap_condition)
        if gap_condition.may_be_testable(node.vars):
            negations: DeferredNegations = []
            test, _ = compile_early_test(self.rule, negations, gap_condition, node.vars)
            node = self._add(EarlyTestNode(self.rule, node, test, negations), None, UNLIMITED)
        return below._replace(node=node, deferred=[*below.deferred, gap_condition])

    def _build_kleene(
        self,
        kleene: Union[KleenePattern, AggregatePattern],
        unwrapped: UnwrappedPattern,
        context: VarSet,
        retention: Retention,
    ) -> BuiltPattern:
        inner_context = context | frozenset(bound_by(kleene.first))
        repeated_pattern = kleene.repeated if isinstance(kleene, KleenePattern) else kleene.collected
        first_left_stream = len(self.stream_nodes)
        first = self._build(kleene.first, context, retention)
        repeated = self._build_right(repeated_pattern, inner_context, retention, first_left_stream)
        identity_functions = (
            self._identity_function(first, kleene.first),
            self._identity_function(repeated, repeated_pattern),
        )
        node = KleeneNode(
            self.rule,
            first.node,
            repeated.node,
            may_share_event(first, repeated),
            has_instants(kleene),
            identity_functions,
            self.shared_vars,
        )
        node.first_can_be_revived = may_be_revived(kleene.first)
        node.repeated_can_be_revived = may_be_revived(repeated_pattern)
        self._add(node, unwrapped.span, retention)
        aggregated = (
            [kleene.value] if isinstance(kleene, AggregatePattern) and kleene.value is not None else []
        )
        outside_vars = self._find_outside_vars(repeated_pattern, aggregated)
        for value in aggregated:
            node.set_free_vars([var for var in variables(value) if var in outside_vars])
        items = RepetitionItems(outside_vars)
        always_bound = always_bound_by(kleene.first, False, True) | always_bound_by(
            repeated_pattern, False, True
        )
        # Conditions on a repetition that use variables of the context are tested above, on the list of all
        # repetitions.
        testable, still_deferred = split_testable(repeated.deferred, always_bound, context)
        for condition in testable:
            test, node.step_vars = compile_deferred_test(
                self.rule, node.deferred_negations, condition, node.step_vars
            )
            node.step_tests.append(test)
        deferred = [*first.deferred, *(condition.for_each_repetition(items) for condition in still_deferred)]
        passed_on_items = items if still_deferred else None
        self.shared_vars.add(items.var)
        if isinstance(kleene, AggregatePattern):
            node.set_result_layout(
                outside_vars, self._sequence_aggregate(kleene, node.step_vars), kleene.result, passed_on_items
            )
        else:
            node.set_result_layout(outside_vars, None, None, passed_on_items)
        conditions, newly_deferred = self._split(unwrapped.conditions, unwrapped.pattern, context, deferred)
        for condition in newly_deferred:
            node.add_interval_vars(condition.start, condition.end)
        for condition in first.deferred:
            if condition.may_be_testable(node.vars):
                node.add_test(
                    *compile_early_test(self.rule, node.deferred_negations, condition, node.vars), False
                )
        for uses_result, tested_condition in order_by_result_use(conditions, node.vars, node.new_result_vars):
            compiled_test = self._compile_test(node.deferred_negations, tested_condition, node.vars)
            if compiled_test is not None:
                node.add_test(*compiled_test, uses_result)
        return BuiltPattern(
            node, [*deferred, *newly_deferred], [*repeated.leaves, *first.joined_leaves], first.single_leaves
        )

    def _find_outside_vars(self, pattern: Pattern, values: Sequence[Term] = ()) -> Set[Var]:
        """Return the variables that are used in the rule outside of a pattern and of the given terms."""
        inside = occurrences(list(values), pattern)
        return {var for var, count in self._occurrence_counts.items() if count > inside.get(var, 0)}

    def _sequence_aggregate(self, aggregate: AggregatePattern, value_vars: List[Var]) -> SequenceAggregate:
        if aggregate.value is None:
            return SequenceAggregate(aggregate.kind, None, lambda values: NIL, lambda term, values: term)
        evaluators = Evaluators(self.rule)
        value = compile_builder(aggregate.value, value_vars, "value of an aggregate")
        return SequenceAggregate(
            aggregate.kind,
            evaluators.compile_setting(aggregate.kind, aggregate.setting),
            value,
            evaluators.compile_expression(aggregate.kind, aggregate.value, value_vars),
        )
