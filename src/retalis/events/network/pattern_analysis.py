"""Conditions that look at patterns further left: what they need is carried with a match until it meets those.

What is read off the parts of a pattern before and after their nodes are made.
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
    Protocol,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...prolog.terms.term_traversal import positions, variables
from ...prolog.terms.types import Term, Values, Var, deref, functor
from ..language.pattern_tree import (
    Absent,
    Aggregate,
    Awaited,
    Condition,
    Pattern,
    Shaped,
    Star,
    Windowed,
    Within,
    occurrences,
    walk,
)
from ..matches.negation import NegationBuffer
from ..matches.partial_matches import PartialMatch
from ..matches.run_groups import NO_ITEMS
from .goal_evaluation import RuleGoal, Test, goal_test
from .pattern_nodes import EventNode, NetworkNode

if TYPE_CHECKING:
    from .event_rule import EventRule


_ITEMS = functor("items", 2)
ITEM = "item of a run"
"""The name of the terms that have the values of one repetition after a zero, since they may be none."""


class Carrying(Protocol):
    """A node, or an absence, that looks at absences.

    Attributes:
        carried: those, with the nodes of what they negate.
    """

    carried: List[Tuple[NegationBuffer, NetworkNode]]


class Built(NamedTuple):
    """A node, with what is to be known of it above.

    Attributes:
        node: the node.
        deferred: the conditions in it that are still to be tested.
        joined: the leaves whose events complete something of several events, in the order in which they are served.
        single: the leaves whose events the node passes on one by one.
        branches: of an ``or`` all leaves, branch by branch.
    """

    node: NetworkNode
    deferred: "List[DeferredConditions]"
    joined: List[EventNode]
    single: List[EventNode]
    branches: Optional[List[EventNode]] = None

    @property
    def leaves(self) -> List[EventNode]:
        """All leaves, in the order in which they are served: those of an ``or`` branch by branch."""
        return [*self.joined, *self.single] if self.branches is None else self.branches

    def with_negated(
        self, node: NetworkNode, deferred: "List[DeferredConditions]", negated: "Built"
    ) -> "Built":
        """Return what is built by a node over this one and over a negated pattern."""
        joined = [*self.joined, *negated.leaves]
        branches = None if self.branches is None else [*self.branches, *negated.leaves]
        return Built(node, deferred, joined, self.single, branches)


class Items:
    """What conditions on each repetition of a run look at, where they are tested further up.

    Attributes:
        var: the variable under which it is carried on, newest repetition first.
        names: the variables that each repetition has values of its own for.
        same: the variables that have one value in the whole match, since they stand elsewhere in the rule.
    """

    def __init__(self, same: Set[Var]):
        self.var = Var()
        self.names: List[Var] = []
        self.same = same


class Negated:
    """A negated pattern, built as often as it is looked at: each place where it is has nodes of its own.

    Args:
        build: builds it.
        twins: takes what was built anew, with what was built first.
        nodes: the nodes of the rule, to which it adds those that are built.
    """

    def __init__(
        self,
        build: Callable[[], Built],
        twins: List[Tuple[Built, Built]],
        nodes: Sequence[Tuple[NetworkNode, Any, Any]],
    ):
        self._nodes = nodes
        self._build = build
        self._twins = twins
        self._made = False
        self.first = self._forbidden()

    def _forbidden(self) -> Built:
        before = len(self._nodes)
        built = self._build()
        for node, _, _ in self._nodes[before:]:
            node.forbids = True
            for buffer in node.buffers():
                buffer.forbids = True
        return built

    def make(self) -> Built:
        """Return the pattern as it was built first, or built anew for another place."""
        if not self._made:
            self._made = True
            return self.first
        again = self._forbidden()
        self._twins.append((again, self.first))
        return again

    def needs(self, context: AbstractSet[Var], known: Set[Var]) -> Set[Var]:
        """Return those variables of a context that it looks at and that are not known."""
        mentioned = set(self.first.node.vars)
        for one in self.first.deferred:
            mentioned |= one.needs
        return (mentioned & context) - known


class DeferredConditions(NamedTuple):
    """A condition that looks at variables of patterns further left, so that it is tested where those are known.

    Attributes:
        needs: the variables it waits for.
        goal: the goal, or None for an absence.
        timed: whether the goal sees ``t1/1`` and ``t2/1``.
        absent: what is `Negated`, and whether any time before counts, for an absence.
        start: the variable under which the start of its pattern is carried on.
        end: the variable of its end.
        items: for a condition on each repetition of a run, what is carried on of those.
        each: what is tested on each of them.
    """

    needs: Set[Var]
    goal: Optional[Term]
    timed: bool
    absent: "Optional[Tuple[Negated, bool]]"
    start: Var
    end: Var
    items: Optional[Items] = None
    each: "Optional[DeferredConditions]" = None

    def of_each(self, items: Items) -> "DeferredConditions":
        """Return the same condition on each repetition of a run."""
        return self._replace(items=items, each=self)

    def may_be_tried(self, names: List[Var]) -> bool:
        """Tell whether a match with these variables may already give all that it waits for a value."""
        return self.items is None and self.needs.issubset(names)


def ready_where(
    deferred: List[DeferredConditions], sure: Set[Var], context: AbstractSet[Var]
) -> Tuple[List[DeferredConditions], List[DeferredConditions]]:
    """Part conditions into those that can be tested where some variables are sure to be known, and the others.

    What no pattern further left could give a value is not waited for.
    """
    ready: List[DeferredConditions] = []
    later: List[DeferredConditions] = []
    for one in deferred:
        if (one.needs - sure) & context:
            later.append(one)
        else:
            ready.append(one)
            sure = sure if one.goal is None else sure | set(variables(one.goal))
    return ready, later


def with_item(items: Term, values: Values) -> Term:
    """Return what is carried of repetitions with one more."""
    return (_ITEMS, (functor(ITEM, len(values) + 1), 0, *values), items)


def deferred_test(
    rule: "EventRule", node: Carrying, one: DeferredConditions, names: List[Var]
) -> Tuple[Test, List[Var]]:
    """Return the test of a condition at a node that knows all it looks at, and the names that it leaves.

    Args:
        rule: whose condition it is.
        node: where it is tested, a node or an absence; it keeps the absences that are looked at.
        one: the condition.
        names: the variables that are known there.
    """
    if one.items is not None and one.each is not None:
        return _test_of_each(rule, node, one.items, one.each, names)
    at = (names.index(one.start), names.index(one.end))
    if one.goal is not None:
        call = RuleGoal(rule, one.goal, names)
        return goal_test(call, one.timed, at), call.result_vars
    assert one.absent is not None
    negated, ever = one.absent
    built = negated.make()
    absence = absence_of(rule, built, names, ever)
    node.carried.append((absence, built.node))
    return _absence_test(absence, at, ever), names


def early_test(
    rule: "EventRule", node: Carrying, one: DeferredConditions, names: List[Var]
) -> Tuple[Test, List[Var]]:
    """Return a test as `deferred_test` does, for where some of what the condition waits for may still be open.

    A match where it is open goes on untested; one that has passed is marked, and not tested further up.
    """
    test, left = deferred_test(rule, node, one, names)
    places = positions(names)
    needed = [places[var] for var in one.needs]
    mark = places[one.start]
    new = left[len(names) :]

    def early(values: Values, start: int, end: int) -> Optional[Values]:
        if any(deref(values[at]).__class__ is Var for at in needed):
            return values + tuple([Var() for _ in new])
        found = test(values, start, end)
        return None if found is None else (*found[:mark], Var(), *found[mark + 1 :])

    return early, left


def _test_of_each(
    rule: "EventRule", node: Carrying, items: Items, one: DeferredConditions, names: List[Var]
) -> Tuple[Test, List[Var]]:
    at = names.index(items.var)
    mentioned = [] if one.goal is None else variables(one.goal)
    here = set(names)
    known = [*names, *(var for var in mentioned if var in items.same and var not in here)]
    width = len(known)
    test_one, left = deferred_test(rule, node, one, [*known, *items.names])
    items.names = left[width:]

    def test(values: Values, start: int, end: int) -> Optional[Values]:
        rest = values[at]
        base = values + tuple([Var() for _ in known[len(values) :]])
        if rest.__class__ is Var:
            return base
        oldest_first = []
        while rest.__class__ is tuple:  # until NO_ITEMS
            oldest_first.append(rest[1][2:])
            rest = rest[2]
        tested: Term = NO_ITEMS
        for item in reversed(oldest_first):
            found = test_one((*base, *item), start, end)
            if found is None:
                return None
            base = found[:width]
            tested = with_item(tested, found[width:])
        return (*base[:at], tested, *base[at + 1 :])

    return test, known


def absence_of(rule: "EventRule", negated: Built, names: List[Var], ever: bool) -> NegationBuffer:
    """Return what looks for matches of a negated node.

    Args:
        rule: whose it is.
        negated: what was built for the negated pattern; what is deferred in it looks at the variables asked for.
        names: the variables of what is asked for.
        ever: whether any time before counts.
    """
    conditions = negated.deferred
    own = negated.node.vars
    places = positions(names)
    shared = [(at, places[var]) for at, var in enumerate(own) if var in places]
    absence = NegationBuffer(rule, shared, ever)
    if not conditions:
        return absence
    new = [var for var in own if var not in places]
    at = [at for at, var in enumerate(own) if var not in places]
    known = [*names, *new]
    tests = []
    for one in conditions:
        test, known = deferred_test(rule, absence, one, known)
        tests.append(test)
    tracker = rule.network.tracker

    def condition(values: Values, match: PartialMatch) -> bool:
        both: Any = values + tuple([match.values[index] for index in at])
        before = tracker.blocker
        for test in tests:
            both = test(both, match.start, match.end)
            if both is None:
                tracker.blocker = before  # what is in the way of the negated match
                return False
        return True

    absence.condition = condition
    return absence


def _absence_test(absence: NegationBuffer, at: Tuple[int, int], ever: bool) -> Test:
    """Return the test of an absence whose gap is carried among the values."""

    def test(values: Values, start: int, end: int) -> Optional[Values]:
        low: Any = values[at[0]]  # an instant, or a variable in a branch that was not taken
        high: Any = values[at[1]]
        if low.__class__ is Var:
            return values
        if absence.blocks(values, low, low if ever else high):
            return None
        return values

    return test


VarSet = FrozenSet[Var]
TestedCondition = Union[Condition, DeferredConditions]


class Wrapping(NamedTuple):
    """The conditions that belong to one operator, inner ones first."""

    core: Pattern
    span: Optional[int]
    conditions: List[Condition]
    absent: Optional[Absent]


def may_be_revived(pattern: Pattern) -> bool:
    """Tell whether taking an event back may make a match of a pattern, instead of only unmaking some."""
    kinds = (Absent, Star, Aggregate, Windowed, Shaped, Awaited)
    return any(isinstance(part, kinds) for part in walk(pattern))


def in_goals(conditions: List[Condition]) -> VarSet:
    """Return the variables of conditions."""
    return frozenset(var for condition in conditions for var in variables(condition.goal))


def those_about_a_result_last(
    conditions: Sequence[TestedCondition], known: Sequence[Var], result: Sequence[Var]
) -> List[Tuple[bool, TestedCondition]]:
    """Return the conditions of an aggregate, and whether each looks at the result or at what follows from it."""
    shown = set(result)
    early, late = [], []
    for condition in conditions:
        mentioned = set() if condition.goal is None else set(variables(condition.goal))
        if mentioned & shown:
            shown |= mentioned.difference(known)
            late.append((True, condition))
        else:
            early.append((False, condition))
    return [*early, *late]


def served(either: bool, left: Built, right: Built) -> List[EventNode]:
    """Return the leaves of a pair in the order in which they take an event that fits several of them.

    Of a sequence the right side comes first: it completes before the left one waits. Else what is made of several
    events comes before a single event, and of two such the left one; of two single events the right one.
    """
    if not either:
        return [*right.leaves, *left.leaves]
    return [*left.joined, *right.joined, *right.single, *left.single]


def meet(left: Built, right: Built) -> bool:
    """Tell whether one event may be in both sides of a pair."""

    def kinds(built: Built) -> Set[Term]:
        found = set()
        for leaf in built.leaves:
            term = leaf.term
            found.add(term[0] if term.__class__ is tuple else term)
        return found

    ours, theirs = kinds(left), kinds(right)
    return bool(ours & theirs) or any(kind.__class__ is Var for kind in ours | theirs)


def unwrap(pattern: Pattern) -> Wrapping:
    """Take the conditions off a pattern until the operator that they belong to."""
    span: Optional[int] = None
    conditions: List[Condition] = []
    absent: Optional[Absent] = None
    while True:
        if isinstance(pattern, Condition):
            conditions.append(pattern)
        elif isinstance(pattern, Within):
            span = pattern.span if span is None else min(span, pattern.span)
        elif isinstance(pattern, Absent) and pattern.inside:
            absent = pattern
        else:
            return Wrapping(pattern, span, conditions[::-1], absent)
        pattern = pattern.pattern


def used_twice(terms: List[Term], pattern: Pattern) -> Set[Var]:
    """Return the variables that stand more than once in terms and a pattern."""
    return {var for var, number in occurrences(terms, pattern).items() if number > 1}
