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
from typing import TYPE_CHECKING, Any, Dict, List, Optional, Sequence, Set, Tuple, TypeVar, Union

from ...foundation.errors import RuleError
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import NIL, Term, Var
from ..dispatch.matcher_compiler import compile_builder
from ..language.event_operators import OPERATORS
from ..language.pattern_tree import (
    AbsencePattern,
    ActionPattern,
    AggregatePattern,
    ConditionPattern,
    EventPattern,
    KleenePattern,
    NotPattern,
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
from ..matches.expiration import UNLIMITED, Retention
from ..streams.aggregates import SequenceAggregate
from .deferred_conditions import (
    BuiltPattern,
    DeferredConditions,
    NegatedPattern,
    RepetitionItems,
    TestedCondition,
    VarSet,
    Wrapping,
    deferred_test,
    dispatch_order,
    early_test,
    goal_variables,
    may_be_revived,
    may_share_event,
    negation_buffer_for,
    order_by_result_use,
    shared_variables,
    split_ready,
    unwrap,
)
from .goal_evaluation import Evaluators, RuleGoal, Test, goal_test
from .join_node import JoinNode
from .kleene_node import KleeneNode
from .pattern_nodes import (
    ActionNode,
    BindNode,
    EarlyTestNode,
    EventNode,
    FilterNode,
    IdentityFunction,
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


class RuleCompiler(StreamCompiler):
    """Builds the nodes of one rule.

    Args:
        rule: the rule at run time.
        head: the terms besides the pattern that use its variables.
        pattern: the pattern.

    Attributes:
        nodes: all nodes, each with its own interval bound and the retention of its stored matches.
        stream_nodes: the operators on streams in the order of their alarms. As for events, the right
            operand of a pair precedes the left one: a match is completed before it is replaced.
        copies: further copies of negated patterns, each with the first one.
    """

    def __init__(self, rule: "EventRule", head: List[Term], pattern: Pattern):
        super().__init__(rule)
        self.pattern = pattern
        self.shared_vars = shared_variables(head, pattern)
        self._counts = occurrences(head, pattern)
        self._match_keys = MatchKeys(self.shared_vars)
        self.nodes: List[Tuple[NetworkNode, Optional[int], Retention]] = []
        self.stream_nodes: List[StreamNode] = []
        self.copies: List[Tuple[BuiltPattern, BuiltPattern]] = []
        self._bound_by: Dict[int, VarSet] = {}

    def build(self) -> NetworkNode:
        """Return the root of the tree."""
        built = self._build(self.pattern, frozenset(), UNLIMITED)
        if built.deferred:
            raise RuleError("a condition uses variables that no pattern to its left binds", self.rule.place)
        for rank, leaf in enumerate(built.leaves):
            leaf.rank = rank
        for position, stream in enumerate(self.stream_nodes):
            stream.position = position
        # Copies of a negated pattern receive an event together with the first one, whichever node tests them.
        for built_copy, first in self.copies:
            for leaf, first_leaf in zip(built_copy.leaves, first.leaves):
                leaf.rank = first_leaf.rank
        node = root = built.node
        while isinstance(node, (ActionNode, FilterNode)):
            node.tests_window = True
            node = node.child
        return root

    def _build(self, pattern: Pattern, context: VarSet, retention: Retention) -> BuiltPattern:
        """Build a pattern.

        Args:
            pattern: the pattern.
            context: variables of the patterns to its left.
            retention: smallest interval bounds above it; None for none.
        """
        pairs: List[Tuple[PairPattern, Wrapping, Retention]] = []
        first_left_stream = len(self.stream_nodes)
        while True:
            wrapping = unwrap(pattern)
            span = wrapping.span
            retention = inner = retention.within(span)
            core = wrapping.core
            if not isinstance(core, PairPattern):
                break
            pairs.append((core, wrapping, inner))
            pattern = core.left
        built = self._build_core(core, wrapping, context, inner)
        # Innermost pair first.
        while pairs:
            pair, wrapping, inner = pairs.pop()
            built = self._build_join(pair, wrapping, context, inner, built, first_left_stream)
        return built

    def _build_core(
        self, core: Pattern, wrapping: Wrapping, context: VarSet, inner: Retention
    ) -> BuiltPattern:
        """Build a pattern that is not a pair."""
        if isinstance(core, (KleenePattern, AggregatePattern)):
            return self._build_kleene(core, wrapping, context, inner)
        if isinstance(core, RepeatedPattern):
            return self._build_repeat(core, context, inner)
        if isinstance(core, EventPattern):
            leaf = self._add(EventNode(self.rule, core.term), None, UNLIMITED)
            built = BuiltPattern(leaf, [], [], [leaf])
        elif isinstance(core, OrPattern):
            branches = [self._build(branch, context, inner) for branch in core.branches]
            node: NetworkNode = OrNode([branch.node for branch in branches], self.shared_vars)
            deferred = [condition for branch in branches for condition in branch.deferred]
            joined = [leaf for branch in branches for leaf in branch.joined]
            single = [leaf for branch in branches for leaf in branch.single]
            in_order = [leaf for branch in branches for leaf in branch.leaves]
            built = BuiltPattern(self._add(node, None, inner), deferred, joined, single, in_order)
        elif isinstance(core, NotPattern):
            built = self._build_not(core, context, inner)
        elif isinstance(core, (WindowPattern, RatePattern, AbsencePattern)):
            built = self._build_stream(core, context, inner.part)
        else:
            assert isinstance(core, ActionPattern)
            below = self._build(core.pattern, context, inner)
            node = ActionNode(
                below.node, RuleGoal(self.rule, core.goal, below.node.vars), core.every, self.shared_vars
            )
            built = below._replace(node=self._add(node, None, inner))
        return self._add_filter(built, wrapping, context)

    def _build_repeat(self, core: RepeatedPattern, context: VarSet, retention: Retention) -> BuiltPattern:
        """Build a repeated pattern, by a `RepeatNode` if possible, else written out as a sequence."""
        if core.repeats_single_events():
            # If the pattern has deferred conditions, the nodes built so far are discarded, and the sequence is
            # built instead.
            node_count = len(self.nodes)
            built = self._build(core.pattern, context | self._bindable_vars(core.pattern), retention)
            if not built.deferred:
                identity_functions = partial(self._match_keys.identity_function, pattern=core.pattern)
                repeat_node = RepeatNode(
                    self.rule, built.node, core.times, self.shared_vars, identity_functions
                )
                node = self._add(repeat_node, None, retention)
                return BuiltPattern(node, [], built.leaves, [])
            del self.nodes[node_count:]
        return self._build(core.as_sequence(), context, retention)

    def _bindable_vars(self, pattern: Pattern) -> VarSet:
        """Return the variables that a match of a pattern may bind; cached for the parts of a sequence."""
        bound = self._bound_by.get(id(pattern))
        if bound is None:
            if isinstance(pattern, PairPattern) and id(pattern.left) in self._bound_by:
                bound = self._bindable_vars(pattern.left).union(bound_by(pattern.right))
            else:
                bound = frozenset(bound_by(pattern))
            self._bound_by[id(pattern)] = bound
        return bound

    def _identity_function(self, built: BuiltPattern, pattern: Pattern) -> IdentityFunction:
        return self._match_keys.identity_function(built.node.vars, pattern)

    def _add(self, node: N, span: Optional[int], retention: Retention) -> N:
        if isinstance(node, StreamNode):
            self.stream_nodes.append(node)
        self.nodes.append((node, span, retention))
        return node

    def _add_filter(self, built: BuiltPattern, wrapping: Wrapping, context: VarSet) -> BuiltPattern:
        """Add a node with the conditions of an event, ``or`` or action above its node."""
        conditions, newly_deferred = self._split(wrapping.conditions, wrapping.core, context)
        node = built.node
        for deferred in newly_deferred:
            node = self._add_bind_node(node, deferred)
        value_vars: List[Var] = node.vars
        tests: List[Test] = []
        for condition in conditions:
            compiled_test = self._compile_test(node, condition, value_vars)
            if compiled_test is not None:
                tests.append(compiled_test[0])
                value_vars = compiled_test[1]
        if tests or wrapping.span is not None:
            node = self._add(FilterNode(node, value_vars, tests, self.shared_vars), wrapping.span, UNLIMITED)
        return built._replace(node=node, deferred=[*built.deferred, *newly_deferred])

    def _split(
        self, conditions: List[ConditionPattern], core: Pattern, context: VarSet
    ) -> Tuple[List[TestedCondition], List[DeferredConditions]]:
        """Divide the conditions of an operator into those that it can test and those that are deferred.

        Returns:
            All conditions in order, deferred ones as `DeferredConditions`, and the deferred ones alone.
        """
        if not conditions:
            return [], []
        assigned: List[TestedCondition] = []
        # A variable that only some branches bind counts as unbound: the condition must then wait for the left
        # operand.
        known_vars = always_bound_by(core, False, True)
        for condition in conditions:
            mentioned = set(variables(condition.goal))
            needs = (mentioned & context) - known_vars
            if needs:
                assigned.append(self._defer(condition.goal, condition.timed, None, needs))
            else:
                assigned.append(condition)
                known_vars |= mentioned
        return assigned, [part for part in assigned if isinstance(part, DeferredConditions)]

    def _compile_test(
        self, node: Any, condition: TestedCondition, value_vars: List[Var]
    ) -> Optional[Tuple[Test, List[Var]]]:
        """Return the test of a condition and the variables after it; None if it cannot be tested at this node.

        A deferred condition is tried at a node that may bind all variables that it requires.
        """
        if isinstance(condition, DeferredConditions):
            return (
                early_test(self.rule, node.deferred_negations, condition, value_vars)
                if condition.may_be_tried(value_vars)
                else None
            )
        call = RuleGoal(self.rule, condition.goal, value_vars)
        return goal_test(call, condition.timed, None), call.result_vars

    def _defer(
        self,
        goal: Optional[Term],
        timed: bool,
        absent: Optional[Tuple[NegatedPattern, bool]],
        needs: Set[Var],
    ) -> DeferredConditions:
        start, end = Var(), Var()
        self.shared_vars |= {start, end}
        # Matches may differ in the node that binds these variables.
        if goal is not None:
            mentioned = variables(goal)
            self.shared_vars.update(mentioned)
            self._match_keys.passed_on_vars.update(mentioned)
        return DeferredConditions(needs, goal, timed, absent, start, end)

    def _add_bind_node(self, node: NetworkNode, deferred: DeferredConditions) -> NetworkNode:
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
        core: PairPattern,
        wrapping: Wrapping,
        context: VarSet,
        retention: Retention,
        left: BuiltPattern,
        first_left_stream: int,
    ) -> BuiltPattern:
        inner_context = context | self._bindable_vars(core.left)
        right = self._build_right(core.right, inner_context, retention, first_left_stream)
        below = [*left.deferred, *right.deferred]
        always_bound: Set[Var] = set()
        # Only then: the analysis visits the whole left operand.
        if below or wrapping.absent is not None:
            always_bound = always_bound_by(core, False, True)
        ready, deferred = split_ready(below, always_bound, context) if below else ([], [])
        conditions, newly_deferred = self._split(wrapping.conditions, core, context)
        negated: Optional[NegatedPattern] = None
        needs: Set[Var] = set()
        if wrapping.absent is not None:
            inner = inner_context | frozenset(bound_by(core.right)) | goal_variables(wrapping.conditions)
            negated = self._negated(wrapping.absent, inner, retention.of_negated(wrapping.span))
            known_vars = set(left.node.vars) | set(right.node.vars)
            needs = negated.needs(inner, known_vars) | negated.needs(context, always_bound)
        gap = (Var(), Var()) if needs else None
        self.shared_vars |= set(gap or ())
        node = JoinNode(
            self.rule,
            OPERATORS[core.operator],
            left.node,
            right.node,
            self.shared_vars,
            gap,
            [(condition.start, condition.end) for condition in newly_deferred],
            may_share_event(left, right),
            (self._identity_function(left, core.left), self._identity_function(right, core.right)),
        )
        node.can_be_revived = (may_be_revived(core.left), may_be_revived(core.right))
        self._add(node, wrapping.span, retention)
        if negated is not None and gap is None:
            built = negated.next_copy()
            node.add_absence(negation_buffer_for(self.rule, built, node.vars, False), built.node)
        self._test_joined(node, below, ready, conditions)
        deferred += newly_deferred
        if negated is not None and gap is not None:
            deferred += self._test_gap(
                node, DeferredConditions(needs, None, False, (negated, False), *gap), conditions
            )
        joined = dispatch_order(OPERATORS[core.operator].completes_in_any_order, left, right)
        if negated is not None:
            joined += negated.first.leaves
        return BuiltPattern(node, deferred, joined, [])

    def _negated(
        self, absent: Union[NotPattern, AbsencePattern], context: VarSet, retention: Retention
    ) -> NegatedPattern:
        return NegatedPattern(
            lambda: self._build(absent.negated, context, retention), self.copies, self.nodes
        )

    def _test_joined(
        self,
        node: JoinNode,
        below: List[DeferredConditions],
        ready: List[DeferredConditions],
        conditions: Sequence[TestedCondition],
    ) -> None:
        """Add the conditions that the operands of a pair have deferred, and those of the pair itself."""
        for deferred in below:
            if deferred in ready:
                node.add_test(*deferred_test(self.rule, node.deferred_negations, deferred, node.vars))
            elif deferred.may_be_tried(node.vars):
                node.add_test(*early_test(self.rule, node.deferred_negations, deferred, node.vars))
        for condition in conditions:
            compiled_test = self._compile_test(node, condition, node.vars)
            if compiled_test is not None:
                node.add_test(*compiled_test)

    def _test_gap(
        self, node: JoinNode, gap_condition: DeferredConditions, conditions: Sequence[TestedCondition]
    ) -> List[DeferredConditions]:
        """Test a negation with conditions on outer variables, or return it for the nodes above."""
        if not gap_condition.needs - goal_variables(
            [test for test in conditions if isinstance(test, ConditionPattern)]
        ):
            # The conditions of the pair bind all of its variables.
            node.add_test(*deferred_test(self.rule, node.deferred_negations, gap_condition, node.vars))
            return []
        if gap_condition.may_be_tried(node.vars):
            node.add_test(*early_test(self.rule, node.deferred_negations, gap_condition, node.vars))
        return [gap_condition]

    def _build_not(self, core: NotPattern, context: VarSet, retention: Retention) -> BuiltPattern:
        below = self._build(core.pattern, context, retention)
        inner_context = context | frozenset(bound_by(core.pattern))
        negated = self._negated(core, inner_context, UNLIMITED)
        always_bound = always_bound_by(core.pattern, False, True)
        needs = negated.needs(inner_context, set(below.node.vars)) | negated.needs(context, always_bound)
        # The negated pattern needs no variables from further left, so it is tested directly above its pattern.
        if not needs:
            built = negated.next_copy()
            absence = negation_buffer_for(self.rule, built, below.node.vars, True)
            node: NetworkNode = self._add(
                NotNode(self.rule, below.node, built.node, absence), None, UNLIMITED
            )
            return below.with_negated(node, below.deferred, negated.first)
        gap_condition = self._defer(None, False, (negated, True), needs)
        node = self._add_bind_node(below.node, gap_condition)
        if gap_condition.may_be_tried(node.vars):
            node = self._add(EarlyTestNode(self.rule, node), None, UNLIMITED)
            node.test, _ = early_test(self.rule, node.deferred_negations, gap_condition, node.vars)
        return below.with_negated(node, [*below.deferred, gap_condition], negated.first)

    def _build_kleene(
        self,
        core: Union[KleenePattern, AggregatePattern],
        wrapping: Wrapping,
        context: VarSet,
        retention: Retention,
    ) -> BuiltPattern:
        inner_context = context | frozenset(bound_by(core.first))
        pattern = core.repeated if isinstance(core, KleenePattern) else core.collected
        first_left_stream = len(self.stream_nodes)
        first = self._build(core.first, context, retention)
        repeated = self._build_right(pattern, inner_context, retention, first_left_stream)
        identity_functions = (
            self._identity_function(first, core.first),
            self._identity_function(repeated, pattern),
        )
        node = KleeneNode(
            self.rule,
            first.node,
            repeated.node,
            may_share_event(first, repeated),
            identity_functions,
            self.shared_vars,
        )
        node.can_be_revived = (may_be_revived(core.first), may_be_revived(pattern))
        self._add(node, wrapping.span, retention)
        measured = [core.value] if isinstance(core, AggregatePattern) and core.value is not None else []
        outside = self._outside(pattern, measured)
        for value in measured:
            node.set_open_vars([var for var in variables(value) if var in outside])
        items = RepetitionItems(outside)
        always_bound = always_bound_by(core.first, False, True) | always_bound_by(pattern, False, True)
        # Conditions on a repetition that use variables of the context are tested above, on the list of all
        # repetitions.
        ready, further = split_ready(repeated.deferred, always_bound, context)
        for pending in ready:
            test, node.step_vars = deferred_test(self.rule, node.deferred_negations, pending, node.step_vars)
            node.step_tests.append(test)
        deferred = [*first.deferred, *(pending.of_each(items) for pending in further)]
        carried = items if further else None
        self.shared_vars.add(items.var)
        if isinstance(core, AggregatePattern):
            node.set_result_layout(
                outside, self._sequence_aggregate(core, node.step_vars), core.result, carried
            )
        else:
            node.set_result_layout(outside, None, None, carried)
        conditions, newly_deferred = self._split(wrapping.conditions, wrapping.core, context)
        for pending in newly_deferred:
            node.add_interval_vars(pending.start, pending.end)
        for pending in first.deferred:
            if pending.may_be_tried(node.vars):
                node.add_test(*early_test(self.rule, node.deferred_negations, pending, node.vars), False)
        for late, condition in order_by_result_use(conditions, node.vars, node.new_result_vars):
            compiled_test = self._compile_test(node, condition, node.vars)
            if compiled_test is not None:
                node.add_test(*compiled_test, late)
        return BuiltPattern(
            node, [*deferred, *newly_deferred], [*repeated.leaves, *first.joined], first.single
        )

    def _outside(self, pattern: Pattern, values: Sequence[Term] = ()) -> Set[Var]:
        """Return the variables that are used in the rule outside of a pattern and of the given terms."""
        inside = occurrences(list(values), pattern)
        return {var for var, number in self._counts.items() if number > inside.get(var, 0)}

    def _sequence_aggregate(self, core: AggregatePattern, value_vars: List[Var]) -> SequenceAggregate:
        if core.value is None:
            return SequenceAggregate(core.kind, lambda values: NIL, lambda term, values: term)
        value = compile_builder(core.value, value_vars, "value of an aggregate")
        return SequenceAggregate(
            core.kind, value, Evaluators(self.rule).compile_expression(core.kind, core.value, value_vars)
        )
