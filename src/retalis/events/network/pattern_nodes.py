"""Nodes of the Rete network: events, conditions, alternatives, actions and negation.

Each rule has a tree of nodes that mirrors its pattern. A node receives matches from the nodes below it and emits its
own to ``emit``. An action takes a match and the next frame, and returns the frame to continue with. Matches of one
event are processed depth-first: a match reaches the root, and the rule fires, before the next match is made.

The nodes are connected for given options by `NetworkNode.bind`, from the root down. Each ``bind`` compiles the
options into a closure; if an option changes, the nodes are connected again and stored matches remain.

A rule whose pattern is a single event with conditions and goals (`NetworkNode.is_single_event`) needs no match
objects. Its nodes are connected by `NetworkNode.bind_values`, and pass values instead.

`MatchKeys` determines the identity of the matches of a pattern. Usually it follows from their events. A value that a
goal, a repetition or an aggregate has computed may still be unbound, and be bound by an event further up; such
values belong to the identity, because two matches consist of the same terms only if these are equal in the end.
"""

from operator import itemgetter
from typing import (
    TYPE_CHECKING,
    AbstractSet,
    Any,
    Callable,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...prolog.terms.term_traversal import positions, term_key, variables
from ...prolog.terms.types import EventAction, Frame, Term, Values, Var
from ...serialization.state_fields import StateOwner
from ...serialization.stored_field_types import NOTHING, FieldType, State
from ..dispatch.discrimination_tree import matches_all_events
from ..fused.fused_single_event import Continuation
from ..language.pattern_tree import (
    AggregatePattern,
    KleenePattern,
    OrPattern,
    Pattern,
    WindowPattern,
    children,
    own_terms,
)
from ..matches.consumption_policy import Emit
from ..matches.expiration import Retention
from ..matches.match_buffer import MatchBuffer
from ..matches.match_policies import NetworkOptions
from ..matches.match_types import ComputedValues, IdentityWithValues, PartialMatch, identity
from ..matches.negation import (
    LATE_MATCH_RETENTION_NANOSECONDS,
    DeferredNegations,
    NegatedNode,
    NegationBuffer,
    RuledOutSweep,
)
from .goal_evaluation import RuleGoal, Test
from .lineage_graph import MatchOrPair
from .repetition_runs import Run, RunGroup, RunGroupBuffer

if TYPE_CHECKING:
    from .event_rule import EventRule


IdentityFunction = Callable[[PartialMatch], Hashable]
OperandBuffer = Union[MatchBuffer, RunGroupBuffer]
"""The stored matches of an operand of a node."""


class MatchKeys:
    """Identity functions for the matches of the patterns of one rule.

    Args:
        shared_vars: variables that occur in the rule more than once.

    Attributes:
        passed_on_vars: variables of the rule that are passed on from node to node.
    """

    def __init__(self, shared_vars: AbstractSet[Var]):
        self.passed_on_vars: Set[Var] = set(shared_vars)
        self._event_bound_vars: Dict[int, FrozenSet[Var]] = {}

    def identity_function(self, value_vars: Sequence[Var], pattern: Pattern) -> IdentityFunction:
        """Return the identity function of the matches of a pattern."""
        return identity_by_values(
            [
                position
                for position, var in enumerate(value_vars)
                if var in self.passed_on_vars and var not in self._vars_bound_by_events(pattern)
            ]
        )

    def _vars_bound_by_events(self, pattern: Pattern) -> FrozenSet[Var]:
        """Return the variables that the events of a match always bind; cached for each part of the pattern."""
        bound = self._event_bound_vars.get(id(pattern))
        if bound is None:
            bound = self._event_bound_vars[id(pattern)] = self._find_vars_bound_by_events(pattern)
        return bound

    def _find_vars_bound_by_events(self, pattern: Pattern) -> FrozenSet[Var]:
        # There may be no repetition, so only the start is certain.
        if isinstance(pattern, (KleenePattern, AggregatePattern)):
            return self._vars_bound_by_events(pattern.first)
        if isinstance(pattern, WindowPattern):
            return frozenset()
        below = [self._vars_bound_by_events(child) for child in children(pattern, False)]
        if isinstance(pattern, OrPattern):
            return frozenset.intersection(*below)
        if not below:
            return frozenset(var for term in own_terms(pattern) for var in variables(term))
        return frozenset().union(*below)


def identity_by_values(positions: List[int]) -> IdentityFunction:
    """Return an identity function by events and by the values at some positions."""
    if not positions:
        return identity
    return lambda match: IdentityWithValues(
        identity(match), tuple([term_key(match.values[position]) for position in positions])
    )


def computed_values_getter(
    value_vars: Sequence[Var], received_count: int, passed_on_vars: AbstractSet[Var]
) -> Callable[[Values], Values]:
    """Return a function for the values that a node has computed itself and does not pass on; see `ComputedValues`.

    Args:
        value_vars: variables of its values.
        received_count: number of leading values that the node received from below.
        passed_on_vars: variables that are passed on, and belong to the identity of stored matches.
    """
    hidden_positions = [
        position
        for position in range(received_count, len(value_vars))
        if value_vars[position] not in passed_on_vars
    ]
    if len(hidden_positions) == len(value_vars) - received_count:
        return itemgetter(slice(received_count, None))
    return lambda values: tuple([values[position] for position in hidden_positions])


def checks_of_negations(negations: Iterable[Tuple[NegationBuffer, NegatedNode]]) -> List["MatchCheck"]:
    """Return the check of each of `NegationBuffer.buffers`, for negations with their negated nodes."""
    return [
        check
        for negation, node in negations
        for check in (node.accepts, *checks_of_negations(negation.deferred_negations))
    ]


Fuse = Callable[[EventAction], EventAction]
"""Returns a fused action, given the plain one that it replaces; see `ListenerIndex.listen`."""


MatchCheck = Callable[[PartialMatch], bool]
"""Returns whether a match is one that a buffer can store."""


def accepts_none(match: PartialMatch) -> bool:
    """Return False: no matches are restored into the buffer."""
    return False


class NetworkNode(StateOwner):
    """Node for one part of a rule's pattern.

    Its state is that of the node itself, besides the matches in its buffers, which are restored later.

    Attributes:
        position: position among the nodes of the rule; a node follows those below it.
        vars: variables of the values of its matches, in order.
        retention: retention time of matches below, in ns; None for no bound.
    """

    rule: "EventRule"
    """The rule that it belongs to; nodes that only test or convert matches have none."""
    vars: List[Var]
    position = 0
    tests_label_window = True
    """True if the longest interval that the rule's label allows is tested here."""
    is_single_event = False
    """True if the pattern is one event with conditions and goals, so that values are passed instead of matches."""
    values_are_arguments = False
    """True if the values of its matches are the arguments of an event."""
    is_negated = False
    """True if it belongs to a negated pattern; its matches are not skipped after a match."""

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Send matches to ``emit`` from now on, according to ``options``; stored matches remain."""
        raise NotImplementedError

    def bind_values(self, completion: Continuation) -> None:
        """Send values to ``completion`` from now on, without creating matches; for nodes that are
        `is_single_event`.
        """
        raise NotImplementedError

    def buffers(self) -> Sequence[OperandBuffer]:
        """Return the buffers of this node itself."""
        return ()

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the bounds of the node.

        Args:
            span: longest interval of its matches in ns; None for no bound.
            retention: retention time of stored matches in ns; None for no bound.
        """

    def sweeps(self, options: NetworkOptions) -> Sequence[RuledOutSweep]:
        """Return the sweeps that remove ruled-out matches of the node, if there are many; see `RuledOutSweep`."""
        return ()

    def clear(self) -> None:
        """Reset the state of the node itself."""

    def stored_count(self) -> int:
        """Return the number of matches in the state of the node itself, besides those in buffers."""
        return 0

    def keys(self) -> int:
        """Return the number of keys in the state of the node itself."""
        return 0

    def bytes(self) -> int:
        """Return an estimate of the memory of the state of the node itself."""
        return 0

    # ---- constraints of restored objects -------------------------------------------------------------

    # Generated functions read values of a match by position, and the arguments of its event, without any test.
    # A match from a file must therefore have a value for each variable of the node, and an event that it receives.

    def accepts(self, match: PartialMatch) -> bool:
        """Return whether a restored match is one that the node emits."""
        return (
            match.__class__ is PartialMatch
            and match.start <= match.end
            and len(match.values) == len(self.vars)
        )

    def buffer_checks(self, saved: State) -> List[MatchCheck]:
        """Return the check of each buffer that the node has after it has restored a state; see `buffers`."""
        return [accepts_none for _ in self.buffers()]

    def accepts_run(self, run: Run) -> bool:
        """Return whether a run is one of this node."""
        return False

    def run_state_type(self) -> FieldType[Any]:
        """Return the type of the states of aggregates in runs."""
        return NOTHING

    def accepts_group(self, group: RunGroup) -> bool:
        """Return whether a run group is one of this node.

        A group without runs is not a group of the node any more, but entries of retractable events may refer to it.
        """
        return False

    def has_entry(self, owner: object, entry: object) -> bool:
        """Return whether an entry of a run, run group or node can be removed if an event is retracted."""
        return False

    def can_retry(self, match_or_pair: MatchOrPair) -> bool:
        """Return whether ``retry`` accepts a match, or two matches, that a negated match has prevented."""
        return False

    # ---- retraction ----------------------------------------------------------------------------------

    def still_allows(self, match: PartialMatch) -> bool:
        """Return whether the negated patterns of the node, and of those below it, still allow one of its matches.

        Matches that are stored further down, such as operands and repetitions, are not tested again.
        """
        return True


def part_of(match: PartialMatch, position: int, node: NetworkNode) -> Optional[PartialMatch]:
    """Return the match of a node that another match was made of; None for a restored match that has none there."""
    parts: Any = match.parts or ()
    part = parts[position] if position < len(parts) else None
    return part if part.__class__ is PartialMatch and node.accepts(part) else None


def still_allows_child(match: PartialMatch, child: NetworkNode) -> bool:
    """Return whether a node still allows the match that the node above it has converted."""
    part = part_of(match, 0, child)
    return part is None or child.still_allows(part)


class BoundedNode(NamedTuple):
    """Node of a rule with its bounds.

    Attributes:
        span: interval bound in ns; None for no bound.
        retention: retention times of the matches below it.
    """

    node: NetworkNode
    span: Optional[int]
    retention: Retention


class EventNode(NetworkNode):
    """Receives the events that unify with a term; it is `values_are_arguments` if all events of its functor do."""

    def __init__(self, rule: "EventRule", term: Term):
        self.rule = rule
        self.term = term
        self.is_single_event = True
        self.values_are_arguments = matches_all_events(term)
        self.rank = 0
        self.vars = variables(term)

    def accepts(self, match: PartialMatch) -> bool:
        """See `NetworkNode.accepts`."""
        return super().accepts(match) and self._receives(match)

    def _receives(self, match: PartialMatch) -> bool:
        pattern: Any = self.term
        event: Any = match.term
        if event is None or match.parts is not None:
            return False
        if pattern.__class__ is Var:
            return True
        if pattern.__class__ is tuple and event.__class__ is tuple:
            return bool(pattern[0] is event[0])
        return bool(pattern == event)

    def bind(self, emit: Emit, options: NetworkOptions, fuse: Optional[Fuse] = None) -> None:
        """Listen to events.

        Args:
            emit: receives the matches.
            options: options of the network.
            fuse: makes a fused action from the plain one; None if there is none.
        """
        rule = self.rule
        token = rule.network.dispatcher.token

        # One closure for each combination of options: the first one runs for most events, and must not test
        # anything. The token of an event is created only if something needs its identity.
        def on_event(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            return emit(PartialMatch(values, start, end, None, term, None), frame)

        def on_event_timed(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            rule.advance_clock(end)
            return emit(PartialMatch(values, start, end, None, term, None), frame)

        def on_event_identified(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            event = token()
            # Matches of the previous event are stored before this event looks for partners.
            if rule.deferred_matches:
                rule.store_deferred_of_earlier_events(event)
            if rule.maintains_clock:
                rule.advance_clock(end)
            return emit(PartialMatch(values, start, end, event, term, None), frame)

        def on_event_unskipped(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            event = token()
            rule.store_deferred_of_earlier_events(event)
            if rule.maintains_clock:
                rule.advance_clock(end)
            return (
                emit(PartialMatch(values, start, end, event, term, None), frame)
                if accepts_start(start)
                else frame
            )

        needs_identity = rule.shares_events or options.tracks_events
        if rule.skip_state is None:
            event_action = (
                on_event_identified
                if needs_identity
                else on_event_timed
                if rule.maintains_clock
                else on_event
            )
            if fuse is None:
                rule.listen(self, event_action)
            else:
                rule.listen(self, fuse(event_action), is_fused=True)
        else:
            accepts_start = (lambda start: True) if self.is_negated else rule.skip_state.accepts_start
            rule.listen(self, on_event_unskipped)

    def bind_values(self, completion: Continuation) -> None:
        """Listen to events for a rule whose pattern is a single event; see `NetworkNode.is_single_event`."""
        self.rule.listen(self, completion.action, completion.is_fused)


class FilterNode(NetworkNode):
    """Passes on the matches that satisfy tests: conditions on an event, an ``or``, or the solution of an action."""

    def __init__(
        self,
        child: NetworkNode,
        value_vars: Sequence[Var],
        tests: Sequence[Test],
        shared_vars: AbstractSet[Var],
    ):
        self.child = child
        self.shared_vars = shared_vars
        self.is_single_event = child.is_single_event
        self.tests_label_window = False
        self.vars = list(value_vars)
        self.tests = list(tests)
        self.span: Optional[int] = None

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the interval bound; see `NetworkNode.set_span`."""
        self.span = span

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        tests = self.tests
        span = self.span
        computed_values = computed_values_getter(self.vars, len(self.child.vars), self.shared_vars)

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            start = match.start
            end = match.end
            if span is not None and end - start > span:
                return frame
            values: Any = match.values
            for test in tests:
                values = test(values, start, end)
                if values is None:
                    return frame
            # A new match is needed only if a condition has bound variables; those bindings are part of its
            # identity.
            if values is not match.values:
                match = PartialMatch(
                    values, start, end, match.event, None, (match, ComputedValues(computed_values(values)))
                )
            return emit(match, frame)

        self.child.bind(on_match, options)

    def still_allows(self, match: PartialMatch) -> bool:
        """See `NetworkNode.still_allows`."""
        # If no condition adds a variable, the match has the values and the interval of the one below.
        if len(self.vars) == len(self.child.vars):
            return self.child.still_allows(match)
        return still_allows_child(match, self.child)

    def bind_values(self, completion: Continuation) -> None:
        """Connect the node; see `NetworkNode.bind_values`."""
        complete = completion.action
        tests = self.tests
        span = self.span

        def on_values(term: Term, values: Any, start: int, end: int, frame: Frame) -> Frame:
            if span is not None and end - start > span:
                return frame
            for test in tests:
                values = test(values, start, end)
                if values is None:
                    return frame
            return complete(term, values, start, end, frame)

        self.child.bind_values(Continuation(on_values))


class BindNode(NetworkNode):
    """Adds the interval of a match to its values, for a condition that is tested further up."""

    def __init__(self, child: NetworkNode, start: Var, end: Var):
        self.child = child
        self.vars = [*child.vars, start, end]

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            values = (*match.values, match.start, match.end)
            return emit(PartialMatch(values, match.start, match.end, match.event, None, (match,)), frame)

        self.child.bind(on_match, options)

    def still_allows(self, match: PartialMatch) -> bool:
        """See `NetworkNode.still_allows`."""
        return len(match.parts or ()) != 1 or still_allows_child(match, self.child)


class InstantNode(NetworkNode):
    """Passes on each match with the interval of one instant: its end or its start.

    The match of a single event remains one: it is never both operands of a pair.
    """

    def __init__(self, child: NetworkNode, at_end: bool):
        self.child = child
        self.at_end = at_end
        self.vars = list(child.vars)

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""

        def on_match_at_end(match: PartialMatch, frame: Frame) -> Frame:
            end = match.end
            return emit(PartialMatch(match.values, end, end, match.event, None, (match,)), frame)

        def on_match_at_start(match: PartialMatch, frame: Frame) -> Frame:
            start = match.start
            return emit(PartialMatch(match.values, start, start, match.event, None, (match,)), frame)

        self.child.bind(on_match_at_end if self.at_end else on_match_at_start, options)

    def still_allows(self, match: PartialMatch) -> bool:
        """See `NetworkNode.still_allows`."""
        return len(match.parts or ()) != 1 or still_allows_child(match, self.child)


class EndNode(NetworkNode):
    """Passes on each match of the pattern of a ``without`` with the interval of its end, and its start as a value.

    Matches expire by their starts, but one that overlaps a later match is needed until its end.
    """

    def __init__(self, child: NetworkNode):
        self.child = child
        self.vars = [*child.vars, Var()]

    def accepts(self, match: PartialMatch) -> bool:
        """See `NetworkNode.accepts`."""
        if not super().accepts(match):
            return False
        start = match.values[-1]
        return start.__class__ is int and start <= match.end == match.start

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            end = match.end
            values = (*match.values, int(match.start))
            return emit(PartialMatch(values, end, end, match.event, None, (match,)), frame)

        self.child.bind(on_match, options)


class OrNode(NetworkNode):
    """Emits the matches of all branches; variables of the other branches remain unbound.

    Args:
        shared_vars: variables that occur more than once in the rule.
        match_counts: numbers of the matches of the branches, which are incremented; None to count none.
    """

    def __init__(
        self,
        children: Sequence[NetworkNode],
        shared_vars: AbstractSet[Var],
        match_counts: Optional[List[int]] = None,
    ):
        self.children = children
        self._match_counts = match_counts
        emitted_vars: Dict[Var, None] = {}
        for child in children:
            for var in child.vars:
                if var in shared_vars:
                    emitted_vars.setdefault(var)
        self.vars = list(emitted_vars)

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        for index, child in enumerate(self.children):
            child.bind(self._branch_action(index, child, emit), options)

    def _branch_action(self, index: int, child: NetworkNode, emit: Emit) -> Emit:
        position_by_var = positions(child.vars)
        layout = [position_by_var.get(var) for var in self.vars]

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            values = match.values
            ordered_values = tuple([Var() if position is None else values[position] for position in layout])
            return emit(
                PartialMatch(ordered_values, match.start, match.end, match.event, None, (index, match)), frame
            )

        counts = self._match_counts
        if counts is None:
            return on_match

        def count_match(match: PartialMatch, frame: Frame) -> Frame:
            counts[index] += 1
            return on_match(match, frame)

        return count_match

    def still_allows(self, match: PartialMatch) -> bool:
        """See `NetworkNode.still_allows`."""
        parts: Any = match.parts
        index = parts[0] if parts else None
        if index.__class__ is not int or not 0 <= index < len(self.children):
            return True
        branch = self.children[index]
        part = part_of(match, 1, branch)
        return part is None or branch.still_allows(part)


class ActionNode(NetworkNode):
    """Calls a goal for each match: once, or for all of its solutions.

    Attributes:
        may_fire: returns for the start of a match whether it may fire; None except for the first goal after the
            whole pattern.
    """

    def __init__(
        self, child: NetworkNode, rule_goal: RuleGoal, calls_for_all: bool, shared_vars: AbstractSet[Var]
    ):
        self.child = child
        self.shared_vars = shared_vars
        self.is_single_event = child.is_single_event
        self.tests_label_window = False
        self.rule_goal = rule_goal
        self.calls_for_all = calls_for_all
        self.may_fire: Optional[Callable[[int], bool]] = None
        self.vars = list(rule_goal.result_vars)
        self.span: Optional[int] = None

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the interval bound; see `NetworkNode.set_span`."""
        self.span = span

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        rule_goal = self.rule_goal
        call_goal = rule_goal.call_for_all if self.calls_for_all else rule_goal.call_once
        tracked = options.tracks_events
        span = self.span
        computed_values = computed_values_getter(self.vars, len(self.child.vars), self.shared_vars)
        consists_of_ground_event = rule_goal.rule.network.dispatcher.consists_of_ground_event

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            if span is not None and match.end - match.start > span:
                return frame

            def emit_solution(term: Term, values: Values, start: int, end: int, next_frame: Frame) -> Frame:
                return emit(
                    PartialMatch(
                        values,
                        start,
                        end,
                        match.event,
                        None,
                        (match, ComputedValues(computed_values(values))),
                    ),
                    next_frame,
                )

            # Events that the goal makes are derived from this match, so that they are retracted together with it.
            continuation = (
                rule_goal.with_cause(match, emit_solution, frame) if tracked else (emit_solution, frame)
            )
            return call_goal(
                match.term,
                match.values,
                match.start,
                match.end,
                consists_of_ground_event(match),
                *continuation,
            )

        may_fire = self.may_fire
        self.child.bind(
            on_match
            if may_fire is None
            else lambda match, frame: on_match(match, frame) if may_fire(match.start) else frame,
            options,
        )

    def still_allows(self, match: PartialMatch) -> bool:
        """See `NetworkNode.still_allows`."""
        return still_allows_child(match, self.child)

    def bind_values(self, completion: Continuation) -> None:
        """Connect the node; see `NetworkNode.bind_values`."""
        rule_goal = self.rule_goal
        call_goal = rule_goal.call_for_all if self.calls_for_all else rule_goal.call_once
        complete = completion.action
        span = self.span
        # A condition or goal in between may return values with variables although the event has none.
        is_above_event = isinstance(self.child, EventNode)
        dispatcher = rule_goal.rule.network.dispatcher

        def on_values(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            return call_goal(
                term, values, start, end, is_above_event and dispatcher.ground(), complete, frame
            )

        continuation = (
            rule_goal.continuation_for_event(completion)
            if is_above_event and not self.calls_for_all
            else Continuation(on_values)
        )
        act_once = continuation.action

        def on_values_in_span(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            if span is not None and end - start > span:
                return frame
            return act_once(term, values, start, end, frame)

        self.child.bind_values(continuation if span is None else Continuation(on_values_in_span))


class NotNode(NetworkNode):
    """Passes on a match if no match of another pattern ended before it started."""

    def __init__(self, rule: "EventRule", child: NetworkNode, negated: NetworkNode, negation: NegationBuffer):
        self.child = child
        self.negated = negated
        self.negation = negation
        self.rule = rule
        self.vars = child.vars

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        negation = self.negation
        tracker = self.rule.network.tracker
        tracked = options.tracks_events

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            if negation.forbids_pair(match.values, match.start, match.start):
                if tracked:
                    tracker.record_suppressed(self, match)
                return frame
            return emit(match, frame)

        self.retry = _test_again(self, on_match)
        self.child.bind(on_match, options)
        negation.bind(self.negated, options)

    def still_allows(self, match: PartialMatch) -> bool:
        """See `NetworkNode.still_allows`."""
        return self.child.still_allows(match) and not self.negation.forbids_pair(
            match.values, match.start, match.start
        )

    def buffers(self) -> Sequence[OperandBuffer]:
        """Return the buffers of the node."""
        return self.negation.buffers()

    def buffer_checks(self, saved: State) -> List[MatchCheck]:
        """See `NetworkNode.buffer_checks`."""
        return checks_of_negations([(self.negation, self.negated)])

    def can_retry(self, match_or_pair: MatchOrPair) -> bool:
        """See `NetworkNode.can_retry`."""
        return isinstance(match_or_pair, PartialMatch) and self.child.accepts(match_or_pair)


class EarlyTestNode(NetworkNode):
    """Tests a ``without``, or a deferred negation on the matches that bind all of its variables.

    Args:
        rule: the rule that it belongs to.
        child: node of the pattern.
        test: the test; see `compile_early_test` and `compile_overlap_test`.
        deferred_negations: negation buffers of the test, with the nodes of their negated patterns.
    """

    def __init__(
        self, rule: "EventRule", child: NetworkNode, test: Test, deferred_negations: DeferredNegations
    ):
        self.rule = rule
        self.child = child
        self.test = test
        self.deferred_negations = deferred_negations
        self.vars = child.vars
        # Set for nodes whose matches are within the interval of the rule's match.
        self.tests_label_window = False

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the interval bound; see `NetworkNode.set_span`."""
        # A session window emits a match long after its end, so the bound of its interval alone is not enough.
        lateness = None if span is None else max(span, LATE_MATCH_RETENTION_NANOSECONDS)
        for negation, _ in self.deferred_negations:
            negation.set_span(span, lateness)

    def clear(self) -> None:
        """See `NetworkNode.clear`."""
        for negation, _ in self.deferred_negations:
            negation.clear()

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        tracker, tracked, test = self.rule.network.tracker, options.tracks_events, self.test

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            values = test(match.values, match.start, match.end)
            if values is None:
                if tracked:
                    tracker.record_suppressed(self, match)
                return frame
            tested_match = match
            if values is not match.values:
                tested_match = PartialMatch(values, match.start, match.end, match.event, None, (match,))
            return emit(tested_match, frame)

        self.retry = _test_again(self, on_match)
        self.child.bind(on_match, options)
        for negation, negated in self.deferred_negations:
            negation.bind(negated, options)

    def still_allows(self, match: PartialMatch) -> bool:
        """See `NetworkNode.still_allows`."""
        return self.child.still_allows(match) and self.test(match.values, match.start, match.end) is not None

    def buffers(self) -> Sequence[OperandBuffer]:
        """Return the buffers of the node."""
        return [buffer for negation, _ in self.deferred_negations for buffer in negation.buffers()]

    def buffer_checks(self, saved: State) -> List[MatchCheck]:
        """See `NetworkNode.buffer_checks`."""
        return checks_of_negations(self.deferred_negations)

    def can_retry(self, match_or_pair: MatchOrPair) -> bool:
        """See `NetworkNode.can_retry`."""
        return isinstance(match_or_pair, PartialMatch) and self.child.accepts(match_or_pair)


def _test_again(node: Union[NotNode, EarlyTestNode], emit: Emit) -> Emit:
    """Return an action for matches that were suppressed, which ignores those that a match has skipped meanwhile.

    Negated patterns below may have matched since the match was suppressed, so they are tested again.
    """
    rule = node.rule
    skip_state = None if node.is_negated else rule.skip_state

    def retry(match: PartialMatch, frame: Frame) -> Frame:
        if skip_state is not None and not skip_state.accepts_start(match.start):
            return frame
        rule.blocking_match = None
        if node.child.still_allows(match):
            return emit(match, frame)
        rule.network.tracker.record_suppressed(node, match)
        return frame

    return retry
