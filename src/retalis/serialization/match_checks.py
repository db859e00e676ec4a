"""Checks that restored partial matches fit the nodes of their rules.

Generated functions of the engine read values of a match by position, and the arguments of its event, without any
test. A match from a file must therefore have the shape that its node gives to its matches: a value for each variable
of the node, and, for a node that receives events, an event of the functor that the node listens to. `MatchShape`
describes this for the matches of one node, and `buffer_shapes` for each buffer of a node.
"""

from itertools import chain
from typing import Any, Iterable, List, NamedTuple, Sequence, Set, Tuple

from ..events.matches.match_types import PartialMatch, RepetitionChain
from ..events.matches.negation import NegationBuffer
from ..events.matches.shared_run_buffer import BufferSlice, Run, RunCursor, RunGroup
from ..events.network.event_rule import EventRule, RuleState
from ..events.network.join_node import JoinNode
from ..events.network.kleene_node import KleeneNode
from ..events.network.pattern_nodes import EarlyTestNode, EventNode, NetworkNode, NotNode
from ..events.network.repeat_node import RepeatNode
from ..events.network.stream_node import StreamNode
from ..events.provenance.occurrences import Occurrence, Suppressed
from ..foundation.errors import UsageError
from ..prolog.terms.types import Var
from .decoded_value_checks import invalid_value
from .match_graph import GraphReader


class MatchShape(NamedTuple):
    """Shape of the matches of a node.

    Attributes:
        node: the node.
        match_class: class of the matches.
        times: for a buffer of a `RepeatNode`, the number of repetitions of a match; else 1.
    """

    node: Any
    match_class: type = PartialMatch
    times: int = 1

    @property
    def width(self) -> int:
        """Number of values of a match."""
        return len(self.node.vars)

    def fits(self, match: Any) -> bool:
        """Return whether a match has this shape."""
        match_class: Any = match.__class__
        if match_class is not self.match_class or match.start > match.end:
            return False
        if match_class is Run:
            return _run_fits(self.node, match)
        if len(match.values) != len(self.node.vars):
            return False
        if self.times > 1:
            return _has_repetitions(match, self.times)
        return self.node.__class__ is not EventNode or _is_event_of(self.node, match)


class _NoMatches(NamedTuple):
    """Shape for a buffer into which no matches are restored."""

    width: int = 0

    def fits(self, match: Any) -> bool:
        """Return False."""
        return False


def _is_event_of(node: EventNode, match: PartialMatch) -> bool:
    """Return whether a match consists of an event that a node listens to."""
    pattern: Any = node.term
    event: Any = match.term
    if event is None or match.parts is not None:
        return False
    if pattern.__class__ is Var:
        return True
    if pattern.__class__ is tuple and event.__class__ is tuple:
        return bool(pattern[0] is event[0])
    return bool(pattern == event)


def _has_repetitions(match: Any, times: int) -> bool:
    """Return whether a match has parts for ``times`` repetitions; see `repetitions`."""
    while times > 1:
        parts: Any = match.parts or ()
        if parts and parts[0].__class__ is BufferSlice:
            return len(parts) == 1 and parts[0].length == times
        if len(parts) != 2 or not all(isinstance(part, PartialMatch) for part in parts):
            return False
        match = parts[0]
        times -= 1
    return True


def _run_fits(node: KleeneNode, run: Any) -> bool:
    """Return whether a run has the values that its Kleene or aggregate node requires."""
    first, repeated = MatchShape(node.first), MatchShape(node.repeated)
    width, step_width = len(node.first.vars), len(node.step_vars)
    return (
        first.fits(run.first)
        and len(run.values) == width
        and (run.fixed_values is None or len(run.fixed_values) == len(node.fixed_vars))
        and len(run.free_vars) == len(node.free_vars)
        and len(run.repetitions) == len(run.step_values)
        and (run.state is None if node.aggregate is None else node.aggregate.is_state(run.state))
        and all(map(repeated.fits, run.repetitions))
        and all(len(values) == width and len(step) >= step_width for values, step in run.step_values)
    )


def group_fits(node: RepeatNode, group: RunGroup) -> bool:
    """Return whether a group of runs has the matches that a node requires, and at least one."""
    if group.node is not node or len(group.cursors) >= node.times:
        return False
    child = MatchShape(node.child)
    numbered_cursors = [
        (number, cursor)
        for number, cursor in enumerate(group.cursors, 1)
        if cursor is not None and cursor.buffer is group
    ]
    return (
        bool(numbered_cursors)
        and all(_cursor_fits(node, child, number, cursor) for number, cursor in numbered_cursors)
        and all(map(child.fits, group.log.items))
    )


def _cursor_fits(node: RepeatNode, child: MatchShape, number: int, cursor: RunCursor) -> bool:
    first = MatchShape(node, times=cursor.prefix_length) if cursor.prefix_length > 1 else child
    return cursor.prefix_length <= number and len(cursor.values) == first.width and first.fits(cursor.first)


def _shapes_of_negation(negation: NegationBuffer, node: NetworkNode) -> List[Any]:
    """Return the shapes for `NegationBuffer.buffers`."""
    return [MatchShape(node), *_shapes_of_negations(negation.deferred_negations)]


def _shapes_of_negations(negations: Iterable[Tuple[NegationBuffer, NetworkNode]]) -> List[Any]:
    return [shape for negation, node in negations for shape in _shapes_of_negation(negation, node)]


def buffer_shapes(node: Any, saved: Any) -> List[Any]:
    """Return the shape of the matches for each buffer that a node has after it has restored its state ``saved``."""
    if isinstance(node, JoinNode):
        negations = [*zip(node.negations, node.negated_nodes), *node.deferred_negations]
        return [MatchShape(node.left), MatchShape(node.right), *_shapes_of_negations(negations)]
    if isinstance(node, KleeneNode):
        negations = _shapes_of_negations(node.deferred_negations)
        return [MatchShape(node, Run), MatchShape(node.repeated), *negations]
    if isinstance(node, RepeatNode):
        # Group members are not stored in a buffer: they belong to the node's own state.
        return [
            _NoMatches() if not times else MatchShape(node.child if times == 1 else node, times=times)
            for times in node.buffer_lengths(saved)
        ]
    if isinstance(node, NotNode):
        return _shapes_of_negation(node.negation, node.negated)
    if isinstance(node, (EarlyTestNode, StreamNode)):
        return _shapes_of_negations(node.deferred_negations)
    return [_NoMatches() for _ in node.buffers()]


def check_arrivals(rule: EventRule, state: RuleState, shapes: Sequence[Any]) -> None:
    """Check that partial matches fit the buffers that they are put into.

    Args:
        rule: the rule.
        state: its state.
        shapes: shapes of the matches of its buffers.

    Raises:
        UsageError: if a match does not fit.
    """
    matches, buffer_numbers, orders = state.arrivals
    if not len(matches) == len(buffer_numbers) == len(orders):
        raise invalid_value(len(matches), f"{len(orders)} partial matches")
    # Sequence numbers reproduce the order in which partial matches arrived.
    if len(set(orders)) != len(orders):
        raise UsageError(f"{rule.name}: two partial matches have the same sequence number")
    _, last_order, _ = state.times
    if max(orders, default=0) > last_order:
        raise UsageError(f"{rule.name}: a partial match has a sequence number that was not assigned")
    deferred = [(match, buffer_number) for buffer_number, match in state.deferred_matches]
    for match, buffer_number in chain(zip(matches, buffer_numbers), deferred):
        if buffer_number < 0:
            if match.buffer is None:
                raise UsageError(f"{rule.name}: a run does not belong to a group")
        elif not shapes[buffer_number].fits(match):
            width = shapes[buffer_number].width
            raise invalid_value(
                match.values, f"{rule.name}: a match with {width} values and the event of its pattern"
            )


def check_stored_once(rules: Sequence[EventRule], states: Sequence[RuleState]) -> None:
    """Check that no partial match is stored twice: a match has links for one buffer only.

    Raises:
        UsageError: if one is.
    """
    stored: Set[int] = set()
    for rule, state in zip(rules, states):
        stored_matches, _, _ = state.arrivals
        matches = [*stored_matches, *(match for _, match in state.deferred_matches)]
        size = len(stored) + len(matches)
        stored.update(map(id, matches))
        if len(stored) != size:
            raise UsageError(f"{rule.name}: a partial match is stored twice")


def check_lineage(graph: GraphReader) -> None:
    """Check the matches and runs that depend on tracked events, and the matches that a retraction tries again.

    Raises:
        UsageError: if one does not fit its node.
    """
    for suppressed in graph.objects_of(Suppressed):
        if not _can_retry(suppressed.node, suppressed.match_or_pair):
            raise UsageError("a suppressed match does not fit its node")
    checked: Set[Tuple[int, int]] = set()
    for tracked in graph.objects_of(Occurrence, RepetitionChain):
        for holder in tracked.dependents:
            if holder.__class__ is not tuple:
                continue
            node, owner, _ = holder
            # A run has an entry for each repetition, and is as long as their number.
            if (id(node), id(owner)) in checked:
                continue
            checked.add((id(node), id(owner)))
            fits_node = isinstance(node, StreamNode) or (
                _run_fits(node, owner) if isinstance(node, KleeneNode) else owner.node is node
            )
            if not fits_node:
                raise UsageError("a match with repetitions does not fit its node")


def _can_retry(node: Any, suppressed: Any) -> bool:
    """Return whether `retry` of a node accepts a suppressed match or pair."""
    if isinstance(node, (NotNode, EarlyTestNode)):
        return suppressed.__class__ is not tuple and MatchShape(node.child).fits(suppressed)
    if suppressed.__class__ is not tuple:
        return False
    first, second = suppressed
    if isinstance(node, JoinNode):
        return MatchShape(node.left).fits(first) and MatchShape(node.right).fits(second)
    if isinstance(node, KleeneNode):
        return MatchShape(node, Run).fits(first) and MatchShape(node.repeated).fits(second)
    return False
