"""Pattern analysis: deferred conditions, and properties of patterns that determine their nodes.

A condition is tested at the lowest node that knows its variables, as in predicate pushdown. In a rule such as ``a(X)
seq (b(Y) where Y > X)`` the condition belongs to ``b`` but uses a variable of a pattern further left. It is
*deferred*: the values and the interval that it needs are passed on with each match, and the join with the left
operand tests it (`compile_deferred_test`). Negations with conditions on outer variables are deferred in the same way;
their gap is passed on, and the node that knows all variables owns the `NegationBuffer`.

If some branches of a pattern bind the variables earlier, the test is also tried there (`compile_early_test`). A match
that has passed is marked by replacing the start of its interval by a variable, so it is not tested twice.

A condition on each repetition of a run is deferred together with a list of the values of all repetitions
(`RepetitionItems`).
"""

from typing import (
    TYPE_CHECKING,
    AbstractSet,
    Any,
    Callable,
    FrozenSet,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...prolog.terms.term_traversal import positions, variables
from ...prolog.terms.types import Term, Values, Var, deref, functor
from ...serialization.stored_field_types import ITEM_FUNCTOR_NAME
from ..language.pattern_tree import (
    AbsencePattern,
    AggregatePattern,
    ConditionPattern,
    InstantPattern,
    KleenePattern,
    NegationScope,
    NotPattern,
    NotPrecededPattern,
    Pattern,
    RatePattern,
    WindowPattern,
    WithinPattern,
    occurrences,
    walk,
)
from ..matches.match_types import PartialMatch
from ..matches.negation import DeferredNegations, NegationBuffer, OverlapBuffer
from .goal_evaluation import RuleGoal, Test, compile_condition_test
from .pattern_nodes import BoundedNode, EventNode, NetworkNode
from .repetition_runs import NO_ITEMS

if TYPE_CHECKING:
    from .event_rule import EventRule


_ITEMS = functor("items", 2)

_UNDECIDED_REPORT = (
    "a late match is dropped: an event after without that it may overlap is not stored any more"
)


class BuiltPattern(NamedTuple):
    """A node, and properties that the nodes above need.

    Attributes:
        deferred: conditions below that have not been tested.
        joined_leaves: event nodes whose events complete matches of several events, in the order of dispatch.
        single_leaves: event nodes whose matches are passed on one by one.
        branch_leaves: all event nodes of an ``or``, branch by branch; else None.

    The event nodes of negated patterns are not among the leaves, see `NegatedPattern`.
    """

    node: NetworkNode
    deferred: "List[DeferredCondition]"
    joined_leaves: List[EventNode]
    single_leaves: List[EventNode]
    branch_leaves: Optional[List[EventNode]] = None

    @property
    def leaves(self) -> List[EventNode]:
        """All event nodes, in the order of dispatch; those of an ``or`` branch by branch."""
        if self.branch_leaves is not None:
            return self.branch_leaves
        return [*self.joined_leaves, *self.single_leaves]


class RepetitionItems:
    """Layout of the values of each repetition of a run, for conditions on repetitions that are tested further up.

    Attributes:
        var: variable that is bound to the list, newest repetition first.
        item_vars: variables that have separate values in each repetition.
        match_vars: variables with one value in the whole match, because they are used elsewhere in the rule.
    """

    def __init__(self, match_vars: Set[Var]):
        self.var = Var()
        self.item_vars: List[Var] = []
        self.match_vars = match_vars

    def set_item_vars(self, item_vars: List[Var]) -> None:
        """Set the variables of each repetition, which are known when all conditions on repetitions are."""
        self.item_vars = item_vars


class NegatedPattern:
    """A negated pattern, which is built once for each place that tests it: each has nodes of its own.

    An event that is part of a negated match and of another one is part of the negated one first: with instants, the
    start of an event may lie in a gap that ends with the end of the same event. All event nodes of negated patterns
    therefore receive each event before the others, those of inner negated patterns first.

    Args:
        nodes: nodes of the rule, to which the built nodes are added.
        negated_leaves: event nodes of the negated patterns of the rule, to which those of this pattern are added.
    """

    def __init__(
        self,
        build: Callable[[], BuiltPattern],
        nodes: Sequence[BoundedNode],
        negated_leaves: List[EventNode],
    ):
        self._nodes = nodes
        self._build = build
        self._negated_leaves = negated_leaves
        self._first_is_used = False
        self.first = self._build_negated()

    def _build_negated(self) -> BuiltPattern:
        node_count = len(self._nodes)
        built = self._build()
        # All nodes that the call has added belong to the negated pattern.
        for node in [bounded.node for bounded in self._nodes[node_count:]]:
            node.is_negated = True
            for buffer in node.buffers():
                buffer.is_negated = True
        self._negated_leaves += built.leaves
        return built

    def next_copy(self) -> BuiltPattern:
        """Return the nodes that were built first, or at a further call a copy."""
        if not self._first_is_used:
            self._first_is_used = True
            return self.first
        return self._build_negated()

    def find_missing_vars(self, context: AbstractSet[Var], known_vars: Set[Var]) -> Set[Var]:
        """Return the variables of a context that the pattern uses and that are not known."""
        return (self.mentioned_vars() & context) - known_vars

    def mentioned_vars(self) -> Set[Var]:
        """Return the variables of its matches and those that its deferred conditions require."""
        mentioned = set(self.first.node.vars)
        for condition in self.first.deferred:
            mentioned |= condition.required_vars
        return mentioned


class OverlapCondition(NamedTuple):
    """A ``without`` that is tested where it is written, because all of its variables are known there."""

    negated: NegatedPattern
    vars: FrozenSet[Var]


class DeferredCondition(NamedTuple):
    """A condition on variables of patterns further left, which is tested where those are known.

    Attributes:
        required_vars: variables of patterns further left that it uses.
        condition: the condition in the pattern; None for a negation.
        start: variable that is bound to the start of its pattern's interval; for ``cnot``, to that of the gap.
        end: variable that is bound to the end of its pattern's interval; for ``cnot``, to that of the gap.
        negated: the negated pattern of a negation; None for a goal.
        scope: where the negated pattern must not match.
        items: for a condition on each repetition of a run, the layout of their values; else None.
        repetition_condition: for a condition on each repetition, the condition on a single one; else None.
    """

    required_vars: Set[Var]
    condition: Optional[ConditionPattern]
    start: Var
    end: Var
    negated: Optional[NegatedPattern] = None
    scope: NegationScope = NegationScope.BETWEEN
    items: Optional[RepetitionItems] = None
    repetition_condition: "Optional[DeferredCondition]" = None

    @property
    def goal(self) -> Optional[Term]:
        """The goal; None for a negation."""
        return None if self.condition is None else self.condition.goal

    def for_each_repetition(self, items: RepetitionItems) -> "DeferredCondition":
        """Return the condition that requires this one of each repetition of a run."""
        return self._replace(items=items, repetition_condition=self)

    def may_be_testable(self, value_vars: List[Var]) -> bool:
        """Return whether a match with these variables may already bind all variables that the condition requires."""
        # A condition on each repetition is tested only where the run is complete.
        return self.items is None and self.required_vars.issubset(value_vars)


def split_testable(
    deferred: List[DeferredCondition], always_bound: Set[Var], context: AbstractSet[Var]
) -> Tuple[List[DeferredCondition], List[DeferredCondition]]:
    """Divide conditions into those that can be tested at a node, and those that stay deferred.

    Variables that no pattern further left could bind are not required.

    Args:
        deferred: the conditions.
        always_bound: variables that every match of the node binds.
        context: variables that patterns further left may bind.
    """
    testable: List[DeferredCondition] = []
    still_deferred: List[DeferredCondition] = []
    for condition in deferred:
        if (condition.required_vars - always_bound) & context:
            still_deferred.append(condition)
        else:
            testable.append(condition)
            # A goal that is tested binds its variables, so conditions after it may be testable too.
            always_bound = (
                always_bound if condition.goal is None else always_bound | set(variables(condition.goal))
            )
    return testable, still_deferred


def append_item(items: Term, values: Values) -> Term:
    """Return the list of repetition values with one more item."""
    # A zero precedes the values, because there may be none.
    return (_ITEMS, (functor(ITEM_FUNCTOR_NAME, len(values) + 1), 0, *values), items)


def compile_deferred_test(
    rule: "EventRule", negations: DeferredNegations, condition: DeferredCondition, value_vars: List[Var]
) -> Tuple[Test, List[Var]]:
    """Return the test of a condition at a node that knows all of its variables, and the variables after it.

    Args:
        rule: the rule of the condition.
        negations: receives the negation buffer of the condition, if it has one.
        condition: the condition.
        value_vars: variables that are known there.
    """
    if condition.items is not None and condition.repetition_condition is not None:
        return _compile_repetition_test(
            rule, negations, condition.items, condition.repetition_condition, value_vars
        )
    interval_positions = (value_vars.index(condition.start), value_vars.index(condition.end))
    if condition.condition is not None:
        rule_goal = RuleGoal(rule, condition.condition.goal, value_vars)
        test = compile_condition_test(rule_goal, condition.condition, interval_positions)
        return test, rule_goal.result_vars
    assert condition.negated is not None
    built = condition.negated.next_copy()
    negation = create_negation_buffer(rule, built, value_vars, condition.scope)
    negations.append((negation, built.node))
    return _compile_negation_test(negation, interval_positions), value_vars


def compile_overlap_test(
    rule: "EventRule",
    negations: DeferredNegations,
    condition: OverlapCondition,
    value_vars: List[Var],
    expects_late: bool,
) -> Test:
    """Return the test of ``without`` at the node whose matches it limits.

    Args:
        rule: the rule of the condition.
        negations: receives the negation buffer.
        condition: the condition.
        value_vars: variables of the node.
        expects_late: see `OverlapBuffer`.
    """
    built = condition.negated.next_copy()
    negation = create_negation_buffer(rule, built, value_vars, NegationScope.OVERLAP, True, expects_late)
    assert isinstance(negation, OverlapBuffer)
    negations.append((negation, built.node))

    def test(values: Values, start: int, end: int) -> Optional[Values]:
        if negation.forbids_pair(values, start, end):
            return None
        # The event that is not stored any more may be the one whose retraction makes this test run again.
        if negation.may_have_lost(values, start) and not rule.options.emits_revisions:
            rule.blocking_match = None
            rule.network.report_late(rule, _UNDECIDED_REPORT)
            return None
        return values

    return test


def compile_early_test(
    rule: "EventRule", negations: DeferredNegations, condition: DeferredCondition, value_vars: List[Var]
) -> Tuple[Test, List[Var]]:
    """Return a test like `compile_deferred_test`, for a node where some required variables may be unbound.

    A match in which a required variable is unbound is passed on untested; a node further up tests it. A match that
    has passed the test is marked, so that it is not tested again.
    """
    test, result_vars = compile_deferred_test(rule, negations, condition, value_vars)
    position_of = positions(value_vars)
    required_positions = [position_of[var] for var in condition.required_vars]
    start_position = position_of[condition.start]
    new_vars = result_vars[len(value_vars) :]

    def test_or_pass(values: Values, start: int, end: int) -> Optional[Values]:
        if any(deref(values[position]).__class__ is Var for position in required_positions):
            return values + tuple([Var() for _ in new_vars])
        result = test(values, start, end)
        # The mark: a variable in place of the start. The tests above read it as "in a branch that was not taken"
        # and pass.
        return None if result is None else (*result[:start_position], Var(), *result[start_position + 1 :])

    return test_or_pass, result_vars


def _compile_repetition_test(
    rule: "EventRule",
    negations: DeferredNegations,
    items: RepetitionItems,
    condition: DeferredCondition,
    value_vars: List[Var],
) -> Tuple[Test, List[Var]]:
    # The values of a repetition are appended to those of the match. Bindings of variables that belong to the whole
    # match are passed from one repetition to the next.
    list_position = value_vars.index(items.var)
    goal_vars = [] if condition.goal is None else variables(condition.goal)
    known_at_node = set(value_vars)
    bound_by_condition = [var for var in goal_vars if var in items.match_vars and var not in known_at_node]
    known_vars = [*value_vars, *bound_by_condition]
    known_count = len(known_vars)
    test_repetition, result_vars = compile_deferred_test(
        rule, negations, condition, [*known_vars, *items.item_vars]
    )
    items.item_vars = result_vars[known_count:]

    def test(values: Values, start: int, end: int) -> Optional[Values]:
        remaining_items = values[list_position]
        match_values = values + tuple([Var() for _ in known_vars[len(values) :]])
        if remaining_items.__class__ is Var:
            # The match comes from a branch without this repetition.
            return match_values
        items_newest_first = []
        # The list ends with NO_ITEMS.
        while remaining_items.__class__ is tuple:
            # An item is a functor, a zero and the values; see `append_item`.
            items_newest_first.append(remaining_items[1][2:])
            remaining_items = remaining_items[2]
        tested_items: Term = NO_ITEMS
        for item in reversed(items_newest_first):
            result = test_repetition((*match_values, *item), start, end)
            if result is None:
                return None
            match_values = result[:known_count]
            tested_items = append_item(tested_items, result[known_count:])
        return (*match_values[:list_position], tested_items, *match_values[list_position + 1 :])

    return test, known_vars


def create_negation_buffer(
    rule: "EventRule",
    negated: BuiltPattern,
    value_vars: List[Var],
    scope: NegationScope,
    is_on_own_interval: bool = False,
    expects_late: bool = True,
) -> NegationBuffer:
    """Create the negation buffer for the matches of a negated pattern.

    Args:
        rule: the rule that owns it.
        negated: result of building the negated pattern.
        value_vars: variables of the match that the negation may suppress; deferred conditions of the negated pattern
            use them.
        scope: where the negated pattern must not match.
        is_on_own_interval: see `OverlapBuffer`.
        expects_late: see `OverlapBuffer`.
    """
    own_vars = negated.node.vars
    position_of = positions(value_vars)
    shared = [(position, position_of[var]) for position, var in enumerate(own_vars) if var in position_of]
    if scope is NegationScope.OVERLAP:
        # The start is the last value of a match, see `EndNode`.
        negation: NegationBuffer = OverlapBuffer(
            rule, shared, len(own_vars) - 1, is_on_own_interval, expects_late
        )
    else:
        negation = NegationBuffer(rule, shared, scope is NegationScope.BEFORE)
    if not negated.deferred:
        return negation
    new_vars = [var for var in own_vars if var not in position_of]
    new_positions = [position for position, var in enumerate(own_vars) if var not in position_of]
    known_vars = [*value_vars, *new_vars]
    tests = []
    for condition in negated.deferred:
        test, known_vars = compile_deferred_test(rule, negation.deferred_negations, condition, known_vars)
        tests.append(test)

    def holds_for(values: Values, match: PartialMatch) -> bool:
        known_values: Any = values + tuple([match.values[position] for position in new_positions])
        previous_blocker = rule.blocking_match
        for test in tests:
            known_values = test(known_values, match.start, match.end)
            if known_values is None:
                # If a negation of the negated pattern itself failed, it has replaced what blocks the other match.
                rule.blocking_match = previous_blocker
                return False
        return True

    negation.condition = holds_for
    return negation


def _compile_negation_test(negation: NegationBuffer, interval_positions: Tuple[int, int]) -> Test:
    """Return the test of a negation whose gap is among the values."""
    is_unbounded = negation.is_unbounded

    def test(values: Values, start: int, end: int) -> Optional[Values]:
        # An instant, or a variable in a branch that was not taken.
        gap_start: Any = values[interval_positions[0]]
        gap_end: Any = values[interval_positions[1]]
        if gap_start.__class__ is Var:
            return values
        if negation.forbids_pair(values, gap_start, gap_start if is_unbounded else gap_end):
            return None
        return values

    return test


VarSet = FrozenSet[Var]
TestedCondition = Union[ConditionPattern, DeferredCondition, OverlapCondition]


class UnwrappedPattern(NamedTuple):
    """A pattern without the ``within`` bounds, conditions and negation that surround it.

    Attributes:
        pattern: the event or operator below them.
        span: smallest ``within`` bound in ns; None for no bound.
        conditions: the conditions, inner ones first, with each ``without``.
        negated: the negation in the gap of a pair; None if there is none.
    """

    pattern: Pattern
    span: Optional[int]
    conditions: "List[Union[ConditionPattern, NotPattern]]"
    negated: Optional[NotPattern]


def may_be_revived(pattern: Pattern) -> bool:
    """Return whether retracting an event can create a match of a pattern, instead of only removing some."""
    operators = (
        NotPattern,
        KleenePattern,
        AggregatePattern,
        WindowPattern,
        RatePattern,
        AbsencePattern,
        NotPrecededPattern,
    )
    return any(isinstance(part, operators) for part in walk(pattern))


def has_instants(pattern: Pattern) -> bool:
    """Return whether a pattern contains instants of matches."""
    return any(isinstance(part, InstantPattern) for part in walk(pattern))


def find_condition_vars(conditions: "Sequence[Union[TestedCondition, NotPattern]]") -> VarSet:
    """Return the variables of the goals of conditions that are tested where they are written."""
    return frozenset(
        var
        for condition in conditions
        if isinstance(condition, ConditionPattern)
        for var in variables(condition.goal)
    )


def order_by_result_use(
    conditions: Sequence[TestedCondition], known_vars: Sequence[Var], result: Sequence[Var]
) -> List[Tuple[bool, TestedCondition]]:
    """Return pairs of a boolean and a condition of an aggregate: whether the condition depends on the result.

    Those that do not depend on it come first.

    A condition also depends on the result if it uses a variable that such a condition binds.
    """
    result_vars = set(result)
    independent, dependent = [], []
    for condition in conditions:
        if isinstance(condition, OverlapCondition):
            goal_vars = set(condition.vars)
        else:
            goal_vars = set() if condition.goal is None else set(variables(condition.goal))
        if goal_vars & result_vars:
            result_vars |= goal_vars.difference(known_vars)
            dependent.append((True, condition))
        else:
            independent.append((False, condition))
    return [*independent, *dependent]


def order_for_dispatch(is_unordered: bool, left: BuiltPattern, right: BuiltPattern) -> List[EventNode]:
    """Return the event nodes of a pair in the order in which they receive an event that matches several of them.

    In a sequence, the right operand comes first: it completes a pair before the left one is stored. Otherwise nodes
    that complete matches of several events precede those of single events. Of the former, the left operand is first;
    of single events, the right one.
    """
    if not is_unordered:
        return [*right.leaves, *left.leaves]
    return [*left.joined_leaves, *right.joined_leaves, *right.single_leaves, *left.single_leaves]


def may_share_event(left: BuiltPattern, right: BuiltPattern) -> bool:
    """Return whether one event may be in both operands of a pair."""

    def functors_of(built: BuiltPattern) -> Set[Term]:
        functors = set()
        for leaf in built.leaves:
            term = leaf.term
            functors.add(term[0] if term.__class__ is tuple else term)
        return functors

    left_functors, right_functors = functors_of(left), functors_of(right)
    return bool(left_functors & right_functors) or any(
        functor.__class__ is Var for functor in left_functors | right_functors
    )


def unwrap(pattern: Pattern) -> UnwrappedPattern:
    """Return the event or operator below the bounds, conditions and negation of a pattern, together with these."""
    span: Optional[int] = None
    conditions: List[Union[ConditionPattern, NotPattern]] = []
    negated: Optional[NotPattern] = None
    while True:
        if isinstance(pattern, ConditionPattern) or (
            isinstance(pattern, NotPattern) and pattern.scope is NegationScope.OVERLAP
        ):
            conditions.append(pattern)
        elif isinstance(pattern, WithinPattern):
            span = pattern.span if span is None else min(span, pattern.span)
        elif isinstance(pattern, NotPattern) and pattern.scope is NegationScope.BETWEEN:
            negated = pattern
        else:
            return UnwrappedPattern(pattern, span, conditions[::-1], negated)
        pattern = pattern.pattern


def find_shared_vars(terms: List[Term], pattern: Pattern) -> Set[Var]:
    """Return the variables that occur more than once in terms and a pattern."""
    return {var for var, count in occurrences(terms, pattern).items() if count > 1}
