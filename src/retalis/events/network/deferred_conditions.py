"""Pattern analysis: deferred conditions, and properties of patterns that determine their nodes.

A condition is tested at the lowest node that knows its variables, as in predicate pushdown. In a rule such as ``a(X)
seq (b(Y) where Y > X)`` the condition belongs to ``b`` but uses a variable of a pattern further left. It is
*deferred*: the values and the interval that it needs are passed on with each match, and the join with the left
operand tests it (`deferred_test`). Negations with conditions on outer variables are deferred in the same way; their
gap is passed on, and the node that knows all variables owns the `NegationBuffer`.

If some branches of a pattern bind the variables earlier, the test is also tried there (`early_test`). A match that
has passed is marked by replacing the start of its interval by a variable, so it is not tested twice.

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
from ..language.pattern_tree import (
    AbsencePattern,
    AggregatePattern,
    ConditionPattern,
    KleenePattern,
    NotPattern,
    Pattern,
    RatePattern,
    WindowPattern,
    WithinPattern,
    occurrences,
    walk,
)
from ..matches.negation import DeferredNegations, NegationBuffer
from ..matches.partial_matches import PartialMatch
from ..matches.shared_run_buffer import NO_ITEMS
from .goal_evaluation import RuleGoal, Test, goal_test
from .pattern_nodes import EventNode, NetworkNode

if TYPE_CHECKING:
    from .event_rule import EventRule


_ITEMS = functor("items", 2)
ITEM_FUNCTOR_NAME = "item of a run"
"""Functor name of the values of one repetition; a zero precedes these, because there may be none."""


class BuiltPattern(NamedTuple):
    """A node, and properties that the nodes above need.

    Attributes:
        node: the node.
        deferred: conditions below that have not been tested.
        joined: event nodes whose events complete matches of several events, in the order of dispatch.
        single: event nodes whose matches are passed on one by one.
        branches: all event nodes of an ``or``, branch by branch; else None.
    """

    node: NetworkNode
    deferred: "List[DeferredConditions]"
    joined: List[EventNode]
    single: List[EventNode]
    branches: Optional[List[EventNode]] = None

    @property
    def leaves(self) -> List[EventNode]:
        """All event nodes, in the order of dispatch; those of an ``or`` branch by branch."""
        return [*self.joined, *self.single] if self.branches is None else self.branches

    def with_negated(
        self, node: NetworkNode, deferred: "List[DeferredConditions]", negated: "BuiltPattern"
    ) -> "BuiltPattern":
        """Return the result for a node above this one and above a negated pattern."""
        joined = [*self.joined, *negated.leaves]
        branches = None if self.branches is None else [*self.branches, *negated.leaves]
        return BuiltPattern(node, deferred, joined, self.single, branches)


class RepetitionItems:
    """Layout of the values of each repetition of a run, for conditions on repetitions that are tested further up.

    Attributes:
        var: variable that is bound to the list, newest repetition first.
        names: variables that have separate values in each repetition.
        same: variables with one value in the whole match, because they are used elsewhere in the rule.
    """

    def __init__(self, same: Set[Var]):
        self.var = Var()
        self.names: List[Var] = []
        self.same = same


class NegatedPattern:
    """A negated pattern, which is built once for each place that tests it: each has nodes of its own.

    Args:
        build: builds the nodes.
        copies: receives each further copy together with the first one.
        nodes: nodes of the rule, to which the built nodes are added.
    """

    def __init__(
        self,
        build: Callable[[], BuiltPattern],
        copies: List[Tuple[BuiltPattern, BuiltPattern]],
        nodes: Sequence[Tuple[NetworkNode, Any, Any]],
    ):
        self._nodes = nodes
        self._build = build
        self._copies = copies
        self._first_is_used = False
        self.first = self._build_negated()

    def _build_negated(self) -> BuiltPattern:
        node_count = len(self._nodes)
        built = self._build()
        # All nodes that the call has added belong to the negated pattern.
        for node, _, _ in self._nodes[node_count:]:
            node.is_negated = True
            for buffer in node.buffers():
                buffer.is_negated = True
        return built

    def next_copy(self) -> BuiltPattern:
        """Return the nodes that were built first, or at a further call a copy."""
        if not self._first_is_used:
            self._first_is_used = True
            return self.first
        copy = self._build_negated()
        self._copies.append((copy, self.first))
        return copy

    def needs(self, context: AbstractSet[Var], known_vars: Set[Var]) -> Set[Var]:
        """Return the variables of a context that the pattern uses and that are not known."""
        mentioned = set(self.first.node.vars)
        for condition in self.first.deferred:
            mentioned |= condition.needs
        return (mentioned & context) - known_vars


class DeferredConditions(NamedTuple):
    """A condition on variables of patterns further left, which is tested where those are known.

    Attributes:
        needs: variables that it requires.
        goal: the goal; None for a negation.
        timed: whether the goal uses ``t1/1`` and ``t2/1``.
        absent: for a negation the negated pattern, and whether its matches at any earlier time count, not only those
            in the gap.
        start: variable that is bound to the start of its pattern's interval.
        end: variable that is bound to the end of its pattern's interval.
        items: for a condition on each repetition of a run, the layout of their values.
        each: the condition on one repetition.
    """

    needs: Set[Var]
    goal: Optional[Term]
    timed: bool
    absent: "Optional[Tuple[NegatedPattern, bool]]"
    start: Var
    end: Var
    items: Optional[RepetitionItems] = None
    each: "Optional[DeferredConditions]" = None

    def of_each(self, items: RepetitionItems) -> "DeferredConditions":
        """Return the same condition for each repetition of a run."""
        return self._replace(items=items, each=self)

    def may_be_tried(self, value_vars: List[Var]) -> bool:
        """Return whether a match with these variables may already bind all variables that the condition requires."""
        return self.items is None and self.needs.issubset(value_vars)


def split_ready(
    deferred: List[DeferredConditions], always_bound: Set[Var], context: AbstractSet[Var]
) -> Tuple[List[DeferredConditions], List[DeferredConditions]]:
    """Divide conditions into those that can be tested at a node, and those that stay deferred.

    Variables that no pattern further left could bind are not required.

    Args:
        deferred: the conditions.
        always_bound: variables that every match of the node binds.
        context: variables that patterns further left may bind.
    """
    ready: List[DeferredConditions] = []
    later: List[DeferredConditions] = []
    for condition in deferred:
        if (condition.needs - always_bound) & context:
            later.append(condition)
        else:
            ready.append(condition)
            always_bound = (
                always_bound if condition.goal is None else always_bound | set(variables(condition.goal))
            )
    return ready, later


def append_item(items: Term, values: Values) -> Term:
    """Return the list of repetition values with one more item."""
    return (_ITEMS, (functor(ITEM_FUNCTOR_NAME, len(values) + 1), 0, *values), items)


def deferred_test(
    rule: "EventRule", negations: DeferredNegations, condition: DeferredConditions, value_vars: List[Var]
) -> Tuple[Test, List[Var]]:
    """Return the test of a condition at a node that knows all of its variables, and the variables after it.

    Args:
        rule: the rule of the condition.
        negations: receives the negation buffer of the condition, if it has one.
        condition: the condition.
        value_vars: variables that are known there.
    """
    if condition.items is not None and condition.each is not None:
        return _test_of_each(rule, negations, condition.items, condition.each, value_vars)
    interval_positions = (value_vars.index(condition.start), value_vars.index(condition.end))
    if condition.goal is not None:
        call = RuleGoal(rule, condition.goal, value_vars)
        return goal_test(call, condition.timed, interval_positions), call.result_vars
    assert condition.absent is not None
    negated, ever = condition.absent
    built = negated.next_copy()
    absence = negation_buffer_for(rule, built, value_vars, ever)
    negations.append((absence, built.node))
    return _absence_test(absence, interval_positions, ever), value_vars


def early_test(
    rule: "EventRule", negations: DeferredNegations, condition: DeferredConditions, value_vars: List[Var]
) -> Tuple[Test, List[Var]]:
    """Return a test like `deferred_test`, for a node where some required variables may be unbound.

    A match with such variables is passed on untested. A match that has passed is marked, and is not tested further
    up.
    """
    test, result_vars = deferred_test(rule, negations, condition, value_vars)
    position_of = positions(value_vars)
    needed = [position_of[var] for var in condition.needs]
    start_position = position_of[condition.start]
    new_vars = result_vars[len(value_vars) :]

    def test_or_pass(values: Values, start: int, end: int) -> Optional[Values]:
        if any(deref(values[position]).__class__ is Var for position in needed):
            return values + tuple([Var() for _ in new_vars])
        result = test(values, start, end)
        # The mark: a variable in place of the start. The tests above read it as "in a branch that was not taken"
        # and pass.
        return None if result is None else (*result[:start_position], Var(), *result[start_position + 1 :])

    return test_or_pass, result_vars


def _test_of_each(
    rule: "EventRule",
    negations: DeferredNegations,
    items: RepetitionItems,
    condition: DeferredConditions,
    value_vars: List[Var],
) -> Tuple[Test, List[Var]]:
    # Each repetition is tested with its own values after those of the match. Bindings of variables that belong to
    # the whole match are passed from one repetition to the next.
    list_position = value_vars.index(items.var)
    mentioned = [] if condition.goal is None else variables(condition.goal)
    match_vars = set(value_vars)
    known_vars = [*value_vars, *(var for var in mentioned if var in items.same and var not in match_vars)]
    width = len(known_vars)
    test_one, result_vars = deferred_test(rule, negations, condition, [*known_vars, *items.names])
    items.names = result_vars[width:]

    def test(values: Values, start: int, end: int) -> Optional[Values]:
        remaining_items = values[list_position]
        base = values + tuple([Var() for _ in known_vars[len(values) :]])
        if remaining_items.__class__ is Var:
            return base
        oldest_first = []
        # The list ends with NO_ITEMS.
        while remaining_items.__class__ is tuple:
            oldest_first.append(remaining_items[1][2:])
            remaining_items = remaining_items[2]
        tested_items: Term = NO_ITEMS
        for item in reversed(oldest_first):
            result = test_one((*base, *item), start, end)
            if result is None:
                return None
            base = result[:width]
            tested_items = append_item(tested_items, result[width:])
        return (*base[:list_position], tested_items, *base[list_position + 1 :])

    return test, known_vars


def negation_buffer_for(
    rule: "EventRule", negated: BuiltPattern, value_vars: List[Var], ever: bool
) -> NegationBuffer:
    """Return the negation buffer for the matches of a negated node.

    Args:
        rule: the rule that owns it.
        negated: result of building the negated pattern.
        value_vars: variables of the match that the negation may suppress; deferred conditions of the negated pattern
            use them.
        ever: whether a match of the negated pattern at any earlier time counts, not only one in the gap.
    """
    conditions = negated.deferred
    own_vars = negated.node.vars
    position_of = positions(value_vars)
    shared = [(position, position_of[var]) for position, var in enumerate(own_vars) if var in position_of]
    absence = NegationBuffer(rule, shared, ever)
    if not conditions:
        return absence
    new_vars = [var for var in own_vars if var not in position_of]
    new_positions = [position for position, var in enumerate(own_vars) if var not in position_of]
    known_vars = [*value_vars, *new_vars]
    tests = []
    for deferred in conditions:
        test, known_vars = deferred_test(rule, absence.deferred_negations, deferred, known_vars)
        tests.append(test)
    tracker = rule.network.tracker

    def condition(values: Values, match: PartialMatch) -> bool:
        pair_values: Any = values + tuple([match.values[index] for index in new_positions])
        previous_blocker = tracker.blocking_match
        for test in tests:
            pair_values = test(pair_values, match.start, match.end)
            if pair_values is None:
                # This match is suppressed by a negation of its own, which is not what blocks the pair.
                tracker.blocking_match = previous_blocker
                return False
        return True

    absence.condition = condition
    return absence


def _absence_test(absence: NegationBuffer, interval_positions: Tuple[int, int], ever: bool) -> Test:
    """Return the test of a negation whose gap is among the values."""

    def test(values: Values, start: int, end: int) -> Optional[Values]:
        # An instant, or a variable in a branch that was not taken.
        gap_start: Any = values[interval_positions[0]]
        gap_end: Any = values[interval_positions[1]]
        if gap_start.__class__ is Var:
            return values
        if absence.forbids_pair(values, gap_start, gap_start if ever else gap_end):
            return None
        return values

    return test


VarSet = FrozenSet[Var]
TestedCondition = Union[ConditionPattern, DeferredConditions]


class Wrapping(NamedTuple):
    """An operator and the conditions that belong to it, inner ones first."""

    core: Pattern
    span: Optional[int]
    conditions: List[ConditionPattern]
    absent: Optional[NotPattern]


def may_be_revived(pattern: Pattern) -> bool:
    """Return whether retracting an event can create a match of a pattern, instead of only removing some."""
    operators = (NotPattern, KleenePattern, AggregatePattern, WindowPattern, RatePattern, AbsencePattern)
    return any(isinstance(part, operators) for part in walk(pattern))


def goal_variables(conditions: List[ConditionPattern]) -> VarSet:
    """Return the variables of conditions."""
    return frozenset(var for condition in conditions for var in variables(condition.goal))


def order_by_result_use(
    conditions: Sequence[TestedCondition], known_vars: Sequence[Var], result: Sequence[Var]
) -> List[Tuple[bool, TestedCondition]]:
    """Return the conditions of an aggregate, and for each whether it depends on the result.

    A condition depends on the result also if it uses a variable that such a condition binds.
    """
    result_vars = set(result)
    early, late = [], []
    for condition in conditions:
        mentioned = set() if condition.goal is None else set(variables(condition.goal))
        if mentioned & result_vars:
            result_vars |= mentioned.difference(known_vars)
            late.append((True, condition))
        else:
            early.append((False, condition))
    return [*early, *late]


def dispatch_order(is_unordered: bool, left: BuiltPattern, right: BuiltPattern) -> List[EventNode]:
    """Return the event nodes of a pair in the order in which they receive an event that matches several of them.

    In a sequence, the right operand comes first: it completes a pair before the left one is stored. Otherwise nodes
    that complete matches of several events precede those of single events; of the former the left operand is first,
    of single events the right one.
    """
    if not is_unordered:
        return [*right.leaves, *left.leaves]
    return [*left.joined, *right.joined, *right.single, *left.single]


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


def unwrap(pattern: Pattern) -> Wrapping:
    """Return the operator below the conditions of a pattern, together with these conditions."""
    span: Optional[int] = None
    conditions: List[ConditionPattern] = []
    absent: Optional[NotPattern] = None
    while True:
        if isinstance(pattern, ConditionPattern):
            conditions.append(pattern)
        elif isinstance(pattern, WithinPattern):
            span = pattern.span if span is None else min(span, pattern.span)
        elif isinstance(pattern, NotPattern) and pattern.inside:
            absent = pattern
        else:
            return Wrapping(pattern, span, conditions[::-1], absent)
        pattern = pattern.pattern


def shared_variables(terms: List[Term], pattern: Pattern) -> Set[Var]:
    """Return the variables that occur more than once in terms and a pattern."""
    return {var for var, number in occurrences(terms, pattern).items() if number > 1}
