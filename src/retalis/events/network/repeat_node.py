"""Repeat node: a pattern that has to happen a number of times in sequence.

``Q ntimes N`` means the same as ``Q seq Q seq ... seq Q``, which would need N - 1 join nodes and would move every
open sequence from one buffer to the next with each repetition. In the usual case each repetition extends *all* open
sequences, so `RepeatNode` keeps them in a `RunGroup` (see `shared_run_buffer`), and a repetition costs the same for
any N.

Sequences leave their group and are stored separately, by number of repetitions, if they cannot take the same
repetition as the others: a repetition that overlaps the one before, a ``within`` bound that some exceed, or
identical events under the policy ``recent``. They join the group again when the policy allows it.

The group requires that partners are consumed, that events arrive in order, and that the shared values have no
variables. Otherwise the node builds the join nodes after all (`RepeatNode._switch_to_joins`) and sends its matches
to them. Both forms have the same results; `test_ntimes` compares them.
"""

from typing import (
    TYPE_CHECKING,
    AbstractSet,
    Any,
    Callable,
    Collection,
    Dict,
    Hashable,
    Iterator,
    List,
    Optional,
    Sequence,
    Tuple,
)

from ...prolog.terms.term_traversal import positions
from ...prolog.terms.types import Frame, Values, Var
from ..language.event_operators import OPERATORS
from ..language.pattern_tree import SEQ
from ..matches.consumption_policy import Emit, emit_each, metered
from ..matches.interval_index import interval_bounds
from ..matches.match_buffer import MatchBuffer, key_function
from ..matches.partial_matches import NetworkOptions, PartialMatch, identity
from ..matches.shared_run_buffer import (
    BufferSlice,
    RunCursor,
    RunGroup,
    RunGroupBuffer,
    SharedLog,
    set_join_parts,
    set_slice_parts,
    slices_of,
)
from ..provenance.event_log import lineage_nodes_of
from .goal_evaluation import Buffer
from .join_node import JoinNode
from .pattern_nodes import IdentityFunction, NetworkNode

if TYPE_CHECKING:
    from .event_rule import EventRule


_SEQ = OPERATORS[SEQ]


class _Relay(NetworkNode):
    """Represents one of the repetitions if they are joined by nodes of their own."""

    def __init__(self, original: NetworkNode, shared: Collection[Var]):
        self.vars = [var if var in shared else Var() for var in original.vars]

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Set the action that receives the matches."""
        self._out = out

    def take(self, match: PartialMatch, frame: Frame) -> Frame:
        """Pass on a copy of a match, which can be stored by itself."""
        copied_match = PartialMatch(
            match.values, match.start, match.end, match.event, match.term, match.parts
        )
        return self._out(copied_match, frame)


class RepeatNode(NetworkNode):
    """Combines a number of consecutive matches of one pattern.

    Args:
        rule: the rule that it belongs to.
        child: node of the pattern; makes at most one match of each event.
        times: number of repetitions, at least two.
        shared_vars: variables that are used elsewhere in the rule. They have the same value in each repetition.
        named: returns the identity function for matches with the values of some variables.

    Attributes:
        limit: retention time of stored matches in ns; None for no bound.
        groups: run groups, by their values.
        visits: number of sequences, or repetition counts, that were visited one by one; for tests of the complexity.
    """

    def __init__(
        self,
        rule: "EventRule",
        child: NetworkNode,
        times: int,
        shared_vars: AbstractSet[Var],
        named: Callable[[List[Var]], IdentityFunction],
    ):
        self.rule = rule
        self.child = child
        self.times = times
        self.vars = [var for var in child.vars if var in shared_vars]
        self._names = named(child.vars), named(self.vars)
        place_of = positions(child.vars)
        self._shared_positions = tuple([place_of[var] for var in self.vars])
        self._key = key_function(self._shared_positions)
        self._buffers: Dict[int, MatchBuffer] = {}
        self._separate: Dict[Hashable, Dict[int, None]] = {}
        self._join_nodes: List[JoinNode] = []
        self._relays: List[_Relay] = []
        self.groups: Dict[Hashable, RunGroup] = {}
        self._group_buffer = RunGroupBuffer(self)
        self.span: Optional[int] = None
        self.limit: Optional[int] = None
        self._mode = NetworkOptions()
        self._is_grouped = False
        self.visits = 0

    def buffers(self) -> Sequence[Buffer]:
        """Return the buffers of the node."""
        right = [joining.right_buffer for joining in self._join_nodes]
        return (self._group_buffer, *self._buffers.values(), *right)

    def set_span(self, span: Optional[int], limit: Optional[int]) -> None:
        """Set the interval bound and the retention time; see `NetworkNode.set_span`."""
        self.span = span
        self.limit = limit
        for buffer in self._buffers.values():
            buffer.retention = limit
        for joining in self._join_nodes:
            joining.set_span(span, limit)

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        self._out = out
        self._mode = mode
        open_ones = any(None in buffer.newest for buffer in self._buffers.values())
        if not mode.policy.consuming or mode.out_of_order or open_ones:
            self._switch_to_joins()
        else:
            self._is_grouped = True
            for length, buffer in self._buffers.items():
                for match in buffer.all() if length > 1 else ():
                    set_slice_parts(match, length)
                self._set_up(buffer, length)
                for key in buffer.newest:
                    self._separate.setdefault(key, {})[length] = None
        self.child.bind(self._arrive, mode)

    def snapshot(self) -> Any:
        """Return the state of the node; see `NetworkNode.snapshot`."""
        separate = [(key, list(lengths)) for key, lengths in self._separate.items()]
        return self._is_grouped, list(self._buffers), list(self.groups.values()), separate

    def restore(self, saved: Any) -> None:
        """Set the state of the node; see `NetworkNode.restore`."""
        was_grouped, lengths, groups, separate = saved
        if self._is_grouped and not was_grouped:
            self._switch_to_joins()
        for length in lengths:
            self._buffer(length)
        self.groups = {group.key: group for group in groups}
        self._separate = {key: dict.fromkeys(lengths) for key, lengths in separate}

    def buffer_lengths(self, saved: Any) -> List[int]:
        """Return for each buffer that the node has after it has restored a state how many repetitions a match has.

        Zero for the buffer of the run groups, whose sequences have any length.
        """
        was_grouped, lengths, _, _ = saved
        if self._is_grouped and was_grouped:
            return [0, *dict.fromkeys([*self._buffers, *lengths])]
        known_lengths = dict.fromkeys([*self._buffers, *range(1, self.times), *lengths])
        return [0, *known_lengths, *[1] * (self.times - 1)]

    def values_of(self, cursor: RunCursor) -> Values:
        """Return the values of a sequence."""
        return (
            cursor.values
            if cursor.prefix_length > 1
            else tuple([cursor.values[position] for position in self._shared_positions])
        )

    def _arrive(self, match: PartialMatch, frame: Frame) -> Frame:
        if self._is_grouped:
            try:
                key = self._key(match.values)
            except ValueError:
                self._switch_to_joins()
            else:
                result = self._take(match, key)
                return frame if result is None else self._out(result, frame)
        return emit_each(
            metered(self._receiving_relays(), self.rule.meter),
            lambda relay, then: relay.take(match, then),
            frame,
        )

    # ---- run groups ----------------------------------------------------------------------------------

    def _take(self, match: PartialMatch, key: Hashable) -> Optional[PartialMatch]:
        """Extend the open sequences with a repetition; return the match that it completes, or None."""
        group = self.groups.get(key)
        separate = self._separate.get(key)
        if group is None:
            group = RunGroup(self, key)
        # A repetition must follow the last one of the group. If it does not, only sequences stored separately can
        # take it.
        if match.start <= group.end:
            return self._extend_separate(group, match, separate)
        group.renew_log(self.times)
        if separate:
            self._regroup(group, match, separate)
        # Sequences that are too old expire by the rule's clock. A time stamp in the far future does not move the
        # clock, so sequences that cannot take it must stay available for later repetitions.
        if self.span is not None and match.end > self.rule.clock:
            self._ungroup_too_long(group, match)
        longest = group.advance(match, self.times)
        self.groups[key] = group
        self.visits += 1
        result = None
        # The result is made before its cursor leaves the group, which may drop the log.
        if longest is not None:
            result = group.match_of(longest, self.times)
            longest.leave()
        cursor: Any = group.cursors[0]
        self.rule.count_stored(cursor, self.limit)
        if self._mode.tracked:
            self._register_dependency(group, match)
        if separate and self._mode.policy.replacing:
            self._replace(group, separate)
        return result

    def _regroup(self, group: RunGroup, match: PartialMatch, separate: Dict[int, None]) -> None:
        """Add separately stored sequences to a group, in place of those with the same length.

        The policy decides which of two sequences with the same length stays in the group.
        """
        newest = self._mode.policy.newest
        for length in list(separate):
            self.visits += 1
            cursor = group.cursor_with(length)
            if cursor is not None and newest and self._fits(cursor, match):
                # It is newer than the separately stored sequences.
                continue
            sequence = self._first_fit(length, group.key, match, separate)
            if sequence is None:
                continue
            if cursor is not None:
                self._ungroup(group, cursor, length)
            sequence.leave()
            sequence = RunCursor(sequence, length, group)
            group.add(length, sequence)
            self.rule.count_stored(sequence, self.limit)

    def _ungroup_too_long(self, group: RunGroup, match: PartialMatch) -> None:
        """Store the sequences separately that would be too long with a match that does not move the rule's clock."""
        for length, cursor in list(group.cursors_by_length()):
            self.visits += 1
            if not self._fits(cursor, match):
                self._ungroup(group, cursor, length)

    def _replace(self, group: RunGroup, separate: Dict[int, None]) -> None:
        """Remove the separately stored sequences that consist of the same events as the ones in the group."""
        for length in separate:
            cursor, buffer = group.cursor_with(length), self._buffers[length]
            if cursor is not None and group.key in buffer.newest:
                older = buffer.find_identical(group.match_of(cursor, length), group.key)
                if older is not None:
                    older.leave()

    def _extend_separate(
        self, group: RunGroup, match: PartialMatch, separate: Optional[Dict[int, None]]
    ) -> Optional[PartialMatch]:
        """Extend the separately stored sequences with a repetition that overlaps the last one of the group."""
        result = None
        separate = separate or {}
        # Longest first: a sequence that is extended becomes one of the next length, and must not take the same
        # repetition again.
        for length in sorted(separate, reverse=True):
            self.visits += 1
            sequence = self._first_fit(length, group.key, match, separate)
            if sequence is None:
                continue
            sequence.leave()
            values = (
                sequence.values
                if length > 1
                else tuple([sequence.values[position] for position in self._shared_positions])
            )
            slices = BufferSlice((*slices_of(sequence, length), (SharedLog([match]), 0, 1)))
            longer = PartialMatch(values, sequence.start, match.end, None, None, (slices,))
            if length + 1 == self.times:
                result = longer
            else:
                self._store_new_sequence(group, longer, length + 1)
        self._store_new_sequence(group, match, 1)
        return result

    def _first_fit(
        self, length: int, key: Hashable, match: PartialMatch, separate: Dict[int, None]
    ) -> Optional[PartialMatch]:
        """Return the separately stored sequence of a length that takes a repetition, or None."""
        buffer = self._buffers[length]
        if key not in buffer.newest:
            del separate[length]
            return None
        partners = buffer.partners(key, match.start, match.end, self._mode.policy.newest)
        for candidate in metered(partners, self.rule.meter):
            if candidate.end < match.start and self._fits(candidate, match):
                return candidate
        return None

    def _fits(self, sequence: PartialMatch, match: PartialMatch) -> bool:
        return self.span is None or match.end - sequence.start <= self.span

    def _store_new_sequence(self, group: RunGroup, match: PartialMatch, length: int) -> None:
        """Store a new sequence separately; it is newer than the one with the same length in the group."""
        cursor = group.cursor_with(length)
        if cursor is not None:
            if self._mode.policy.replacing and identity(group.match_of(cursor, length)) == identity(match):
                cursor.leave()
            else:
                self._ungroup(group, cursor, length)
        self._store_separately(match, length, group.key)

    def _ungroup(self, group: RunGroup, cursor: RunCursor, length: int) -> None:
        """Remove a sequence from a group and store it separately, with the age that it had in the group."""
        match = group.match_of(cursor, length)
        cursor.leave()
        # The sequence is as old as its last repetition.
        self._store_separately(match, length, group.key, group.order - length + 1)

    def _store_separately(
        self, match: PartialMatch, length: int, key: Hashable, order: Optional[int] = None
    ) -> None:
        buffer = self._buffer(length)
        buffer.add(match, key, order)
        # The lengths are cleared lazily, when a key is used. Keys that are never used again would accumulate.
        if key not in self._separate and len(self._separate) > 2 * self.rule.waiting + 1000:
            self._separate = {}
            for other_length, other_buffer in self._buffers.items():
                for other_key in other_buffer.newest:
                    self._separate.setdefault(other_key, {})[other_length] = None
        self._separate.setdefault(key, {})[length] = None

    def _buffer(self, length: int) -> MatchBuffer:
        buffer = self._buffers.get(length)
        if buffer is None:
            shared = self._shared_positions if length == 1 else tuple(range(len(self._shared_positions)))
            buffer = self._buffers[length] = MatchBuffer(self.rule, shared)
            buffer.retention = self.limit
            buffer.is_negated = self.is_negated
            self._set_up(buffer, length)
        return buffer

    def _set_up(self, buffer: MatchBuffer, length: int) -> None:
        buffer.partner_bounds = interval_bounds(SEQ, self.span, False)
        # Matches of one key have the same values, so these do not belong to the identity of longer sequences.
        name = self._names[0] if length == 1 else identity
        buffer.set_identity_function(name if self._mode.policy.replacing else None)

    # ---- retracted events ----------------------------------------------------------------------------

    def _register_dependency(self, group: RunGroup, match: PartialMatch) -> None:
        """Register the group with the events of a repetition."""
        repetition_number = group.repetition_count - 1
        for occurrence in lineage_nodes_of(match):
            if occurrence.retracted:
                self.remove_retracted(group, repetition_number)
                return
            occurrence.dependents.append((self, group, repetition_number))

    def remove_retracted(self, group: RunGroup, repetition_number: int) -> bool:
        """Remove all sequences that contain a repetition whose event was retracted; nothing follows from that."""
        for _, cursor in list(group.cursors_by_length()):
            if cursor.first_number <= repetition_number:
                cursor.leave()
        return False

    # ---- join nodes ----------------------------------------------------------------------------------

    def _switch_to_joins(self) -> None:
        """Switch to join nodes, and move all sequences to their buffers."""
        for group in sorted(self.groups.values(), key=lambda stored: stored.order):
            # Oldest group first, longest sequence first: the order in which they were stored.
            for length, cursor in list(group.cursors_by_length()):
                self._ungroup(group, cursor, length)
        self._separate = {}
        self._is_grouped = False
        for length, buffer in self._buffers.items():
            for stored in buffer.all() if length > 1 else ():
                set_join_parts(stored, length)
        if not self._join_nodes:
            shared = frozenset(self.vars)
            self._relays = [_Relay(self.child, shared) for _ in range(self.times)]
            left: Any = self._relays[0]
            for length, relay in enumerate(self._relays[1:], 1):
                left = JoinNode(self.rule, _SEQ, left, relay, shared, None, (), True, self._names_at(length))
                left.left_buffer = self._buffer(length)
                left.right_buffer.is_negated = self.is_negated
                left.set_span(self.span, self.limit)
                self._join_nodes.append(left)
        self._join_nodes[-1].bind(self._emit_slices if self._mode.policy.replacing else self._out, self._mode)

    def _names_at(self, length: int) -> Tuple[IdentityFunction, IdentityFunction]:
        single_name, longer_name = self._names
        return (single_name if length == 1 else longer_name), single_name

    def _emit_slices(self, match: PartialMatch, frame: Frame) -> Frame:
        """Emit a match of all repetitions with the parts that a run group gives it; it may replace one of those."""
        set_slice_parts(match, self.times)
        return self._out(match, frame)

    def _receiving_relays(self) -> Iterator[_Relay]:
        """Yield the relays that a match is sent to, last repetition first.

        Relays whose join node has no stored partner are skipped, unless the match may be stored there.
        """
        relays, late = self._relays, self._mode.out_of_order
        for length in range(self.times - 1, 0, -1):
            if late or self._buffers[length].newest:
                self.visits += 1
                yield relays[length]
        yield relays[0]
