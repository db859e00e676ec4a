"""Repeat node: a pattern that has to happen a number of times in sequence.

``Q ntimes N`` means the same as ``Q seq Q seq ... seq Q``, which would need N - 1 join nodes and would move every
open sequence from one buffer to the next with each repetition. In the usual case each repetition extends *all* open
sequences, so `RepeatNode` keeps them in a `RunGroup` (see `repetition_runs`), and a repetition costs the same for
any N.

A sequence leaves its group and is stored separately, by number of repetitions, if it cannot be extended by the same
repetition as the others. This happens if a repetition overlaps the one before it, if a repetition exceeds the
``within`` bound of the sequence, or if a sequence of identical events is stored under the policy ``recent``. The
sequence joins the group again when the policy allows it.

The group requires that partners are consumed, that events arrive in order, and that the shared values have no
variables. Otherwise the node creates the join nodes and forwards its matches to them
(`RepeatNode._switch_to_joins`). Both forms have the same results; `test_ntimes` compares them.
"""

from functools import partial
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
from ...serialization.state_fields import StateFields, constraint, field
from ...serialization.stored_field_types import (
    BOOLEAN,
    KEY,
    State,
    integer,
    mapping_of,
    reference,
    sequence_of,
)
from ..language.event_operators import PAIR_OPERATORS
from ..language.pattern_tree import SEQ
from ..matches.consumption_policy import Emit, emit_each, metered
from ..matches.interval_index import interval_bounds
from ..matches.match_buffer import MatchBuffer, key_function
from ..matches.match_policies import NetworkOptions
from ..matches.match_types import PartialMatch, identity
from .join_node import JoinNode
from .lineage_graph import lineage_nodes_of
from .pattern_nodes import IdentityFunction, MatchCheck, NetworkNode, OperandBuffer, accepts_none
from .repetition_runs import (
    BufferSlice,
    RunCursor,
    RunGroup,
    RunGroupBuffer,
    SharedLog,
    set_join_parts,
    set_slice_parts,
    slices_of,
)

if TYPE_CHECKING:
    from .event_rule import EventRule


_SEQ = PAIR_OPERATORS[SEQ]


class _Relay(NetworkNode):
    """Operand of the join nodes for one of the repetitions; the repeat node passes matches to it."""

    def __init__(self, original: NetworkNode, shared_vars: Collection[Var]):
        self.vars = [var if var in shared_vars else Var() for var in original.vars]

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Set the action that receives the matches."""
        self._emit = emit

    def pass_on(self, match: PartialMatch, frame: Frame) -> Frame:
        """Pass on a copy of a match, which can be stored by itself."""
        copied_match = PartialMatch(
            match.values, match.start, match.end, match.event, match.term, match.parts
        )
        return self._emit(copied_match, frame)


class RepeatNode(NetworkNode):
    """Combines a number of consecutive matches of one pattern.

    Args:
        rule: the rule that it belongs to.
        child: node of the pattern; makes at most one match of each event.
        times: number of repetitions, at least two.
        shared_vars: variables that occur more than once in the rule. They have the same value in each repetition.
        make_identity_function: factory of identity functions, given the variables whose values the matches have.

    Attributes:
        retention: retention time of stored matches in ns; None for no bound.
        groups: run groups, by their values.
        visit_count: number of sequences, or lengths of sequences, that were visited one by one; read only by tests of
            the complexity.
    """

    STATE = StateFields(
        field("is_grouped", BOOLEAN),
        # Complete sequences are not stored.
        field("buffer_lengths", lambda node: sequence_of(integer(1, node.times - 1))),
        field("run_groups", sequence_of(reference("run group"))),
        field("separate_lengths", lambda node: mapping_of(KEY, sequence_of(integer(1, node.times - 1)))),
        constraint(
            "run groups of this node, with at least one run",
            lambda node, state: all(
                group.node is node and group.has_stored_cursor() for group in state["run_groups"]
            ),
        ),
    )

    def __init__(
        self,
        rule: "EventRule",
        child: NetworkNode,
        times: int,
        shared_vars: AbstractSet[Var],
        make_identity_function: Callable[[List[Var]], IdentityFunction],
    ):
        self.rule = rule
        self.child = child
        self.times = times
        self.vars = [var for var in child.vars if var in shared_vars]
        self._identity_functions = make_identity_function(child.vars), make_identity_function(self.vars)
        position_by_var = positions(child.vars)
        self._value_positions = tuple([position_by_var[var] for var in self.vars])
        self._compute_key = key_function(self._value_positions)
        self._buffers: Dict[int, MatchBuffer] = {}
        self._separate_lengths_by_key: Dict[Hashable, Dict[int, None]] = {}
        self._join_nodes: List[JoinNode] = []
        self._relays: List[_Relay] = []
        self.groups: Dict[Hashable, RunGroup] = {}
        self._group_buffer = RunGroupBuffer(self)
        self.span: Optional[int] = None
        self.retention: Optional[int] = None
        self._options = NetworkOptions()
        self._is_grouped = False
        self.visit_count = 0

    def buffers(self) -> Sequence[OperandBuffer]:
        """Return the buffers of the node."""
        right_buffers = [join_node.right_buffer for join_node in self._join_nodes]
        return (self._group_buffer, *self._buffers.values(), *right_buffers)

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the interval bound and the retention time; see `NetworkNode.set_span`."""
        self.span = span
        self.retention = retention
        for buffer in self._buffers.values():
            buffer.retention = retention
        for join_node in self._join_nodes:
            join_node.set_span(span, retention)

    def bind(self, emit: Emit, options: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        self._emit = emit
        self._options = options
        has_matches_with_variables = any(None in buffer.newest for buffer in self._buffers.values())
        if not options.policy.consumes_partners or options.out_of_order or has_matches_with_variables:
            self._switch_to_joins()
        else:
            self._is_grouped = True
            # Repetitions in right buffers wait for late ones before them, and are joined if `out_of_order` is on
            # again.
            if self._join_nodes and not any(node.right_buffer.newest for node in self._join_nodes):
                self._remove_join_nodes()
            for length, buffer in self._buffers.items():
                for match in buffer.stored_matches() if length > 1 else ():
                    set_slice_parts(match, length)
                self._configure_buffer(buffer, length)
                for key in buffer.newest:
                    self._separate_lengths_by_key.setdefault(key, {})[length] = None
        self.child.bind(self._on_match, options)

    @property
    def is_grouped(self) -> bool:
        """True if run groups are in use, and not join nodes."""
        return self._is_grouped

    @is_grouped.setter
    def is_grouped(self, was_grouped: bool) -> None:
        if self._is_grouped and not was_grouped:
            self._switch_to_joins()

    @property
    def buffer_lengths(self) -> List[int]:
        """Numbers of repetitions of the sequences in the buffers of separately stored ones."""
        return list(self._buffers)

    @buffer_lengths.setter
    def buffer_lengths(self, lengths: Sequence[int]) -> None:
        # A state file refers to buffers by position, so they have the order in which the former node created them.
        self._buffers = {length: self._buffer(length) for length in [*lengths, *self._buffers]}

    @property
    def run_groups(self) -> List[RunGroup]:
        """The run groups."""
        return list(self.groups.values())

    @run_groups.setter
    def run_groups(self, groups: Sequence[RunGroup]) -> None:
        self.groups = {group.key: group for group in groups}

    @property
    def separate_lengths(self) -> Dict[Hashable, List[int]]:
        """By key, the numbers of repetitions of the sequences that are stored separately."""
        return {key: list(lengths) for key, lengths in self._separate_lengths_by_key.items()}

    @separate_lengths.setter
    def separate_lengths(self, lengths_by_key: Dict[Hashable, List[int]]) -> None:
        self._separate_lengths_by_key = {
            key: dict.fromkeys(lengths) for key, lengths in lengths_by_key.items()
        }

    def buffer_checks(self, saved: State) -> List[MatchCheck]:
        """See `NetworkNode.buffer_checks`."""
        lengths = dict.fromkeys([*saved["buffer_lengths"], *self._buffers])
        uses_joins = not (self._is_grouped and saved["is_grouped"])
        if uses_joins:
            lengths.update(dict.fromkeys(range(1, self.times)))
        # The runs of groups are not stored in a buffer: they belong to the state of the node.
        checks: List[MatchCheck] = [
            accepts_none,
            *(partial(self._accepts_sequence, length) for length in lengths),
        ]
        return [*checks, *[self.child.accepts] * (self.times - 1)] if uses_joins else checks

    def _accepts_sequence(self, length: int, match: PartialMatch) -> bool:
        """Return whether a restored match has a number of repetitions; see `repetitions`."""
        if length == 1:
            return self.child.accepts(match)
        if not self.accepts(match):
            return False
        while length > 1:
            parts: Any = match.parts or ()
            if parts and parts[0].__class__ is BufferSlice:
                return len(parts) == 1 and parts[0].length == length
            if len(parts) != 2 or not all(isinstance(part, PartialMatch) for part in parts):
                return False
            match = parts[0]
            length -= 1
        return True

    def accepts_group(self, group: RunGroup) -> bool:
        """See `NetworkNode.accepts_group`."""
        numbered_cursors = [
            (number, cursor)
            for number, cursor in enumerate(group.cursors, 1)
            if cursor is not None and cursor.buffer is group
        ]
        return (
            len(group.cursors) < self.times
            and all(self._accepts_cursor(number, cursor) for number, cursor in numbered_cursors)
            and all(map(self.child.accepts, group.log.items))
        )

    def _accepts_cursor(self, number: int, cursor: RunCursor) -> bool:
        length = max(cursor.prefix_length, 1)
        return (
            cursor.prefix_length <= number
            and self._accepts_sequence(length, cursor.first)
            and len(cursor.values) == len(cursor.first.values)
        )

    def has_entry(self, owner: object, entry: object) -> bool:
        """See `NetworkNode.has_entry`."""
        return isinstance(owner, RunGroup) and owner.node is self and entry.__class__ is int

    def values_of(self, cursor: RunCursor) -> Values:
        """Return the values of a sequence."""
        return (
            cursor.values
            if cursor.prefix_length > 1
            else tuple([cursor.values[position] for position in self._value_positions])
        )

    def _on_match(self, match: PartialMatch, frame: Frame) -> Frame:
        if self._is_grouped:
            try:
                key = self._compute_key(match.values)
            except ValueError:
                self._switch_to_joins()
            else:
                result = self._extend_sequences(match, key)
                return frame if result is None else self._emit(result, frame)
        return emit_each(
            metered(self._receiving_relays(), self.rule.meter),
            lambda relay, next_frame: relay.pass_on(match, next_frame),
            frame,
        )

    # ---- run groups ----------------------------------------------------------------------------------

    def _extend_sequences(self, match: PartialMatch, key: Hashable) -> Optional[PartialMatch]:
        """Extend the open sequences with a repetition; return the match that it completes, or None."""
        group = self.groups.get(key)
        separate_lengths = self._separate_lengths_by_key.get(key)
        if group is None:
            group = RunGroup(self, key)
        # A repetition must follow the last one of the group. If it does not, it can extend only sequences that are
        # stored separately.
        if match.start <= group.end:
            return self._extend_separate(group, match, separate_lengths)
        group.renew_log(self.times)
        if separate_lengths:
            self._regroup(group, match, separate_lengths)
        # Sequences that are too old expire by the rule's clock. A time stamp in the far future does not advance the
        # clock, so sequences that it cannot extend must stay available for later repetitions.
        if self.span is not None and match.end > self.rule.clock:
            self._ungroup_too_long(group, match)
        completed_cursor = group.advance(match, self.times)
        self.groups[key] = group
        self.visit_count += 1
        result = None
        # The result is made before its cursor leaves the group, which may drop the log.
        if completed_cursor is not None:
            result = group.match_of(completed_cursor, self.times)
            completed_cursor.discard()
        new_cursor: Any = group.cursors[0]
        self.rule.count_stored(new_cursor, self.retention)
        if self._options.tracks_events:
            self._register_dependency(group, match)
        if separate_lengths and self._options.policy.replaces_identical:
            self._replace(group, separate_lengths)
        return result

    def _regroup(self, group: RunGroup, match: PartialMatch, separate_lengths: Dict[int, None]) -> None:
        """Add separately stored sequences to a group, in place of those with the same length.

        The policy decides which of two sequences with the same length stays in the group.
        """
        newest = self._options.policy.prefers_newest
        for length in list(separate_lengths):
            self.visit_count += 1
            grouped = group.cursor_with(length)
            if grouped is not None and newest and self._is_within_span(grouped, match):
                # The grouped sequence is newer than the separately stored ones.
                continue
            separate_match = self._find_extendable(length, group.key, match, separate_lengths)
            if separate_match is None:
                continue
            if grouped is not None:
                self._ungroup(group, grouped, length)
            separate_match.discard()
            new_cursor = RunCursor(separate_match, length, group)
            group.add(length, new_cursor)
            self.rule.count_stored(new_cursor, self.retention)

    def _ungroup_too_long(self, group: RunGroup, match: PartialMatch) -> None:
        """Store the sequences separately that would be too long with a match that does not move the rule's clock."""
        for length, cursor in list(group.cursors_by_length()):
            self.visit_count += 1
            if not self._is_within_span(cursor, match):
                self._ungroup(group, cursor, length)

    def _replace(self, group: RunGroup, separate_lengths: Dict[int, None]) -> None:
        """Remove the separately stored sequences that consist of the same events as the ones in the group."""
        for length in separate_lengths:
            cursor, buffer = group.cursor_with(length), self._buffers[length]
            if cursor is not None and group.key in buffer.newest:
                older = buffer.find_identical(group.match_of(cursor, length), group.key)
                if older is not None:
                    older.discard()

    def _extend_separate(
        self, group: RunGroup, match: PartialMatch, separate_lengths: Optional[Dict[int, None]]
    ) -> Optional[PartialMatch]:
        """Extend the separately stored sequences with a repetition that overlaps the last one of the group."""
        result = None
        separate_lengths = separate_lengths or {}
        # Longest first: a sequence that is extended becomes one of the next length, and must not be extended by the
        # same repetition again.
        for length in sorted(separate_lengths, reverse=True):
            self.visit_count += 1
            sequence = self._find_extendable(length, group.key, match, separate_lengths)
            if sequence is None:
                continue
            sequence.discard()
            values = (
                sequence.values
                if length > 1
                else tuple([sequence.values[position] for position in self._value_positions])
            )
            slices = BufferSlice((*slices_of(sequence, length), (SharedLog([match]), 0, 1)))
            longer = PartialMatch(values, sequence.start, match.end, None, None, (slices,))
            if length + 1 == self.times:
                result = longer
            else:
                self._store_new_sequence(group, longer, length + 1)
        self._store_new_sequence(group, match, 1)
        return result

    def _find_extendable(
        self, length: int, key: Hashable, match: PartialMatch, separate_lengths: Dict[int, None]
    ) -> Optional[PartialMatch]:
        """Return the separately stored sequence of a length that a repetition extends, or None."""
        buffer = self._buffers[length]
        if key not in buffer.newest:
            del separate_lengths[length]
            return None
        partners = buffer.partners(key, match.start, match.end, self._options.policy.prefers_newest)
        for candidate in metered(partners, self.rule.meter):
            if candidate.end < match.start and self._is_within_span(candidate, match):
                return candidate
        return None

    def _is_within_span(self, sequence: PartialMatch, match: PartialMatch) -> bool:
        return self.span is None or match.end - sequence.start <= self.span

    def _store_new_sequence(self, group: RunGroup, match: PartialMatch, length: int) -> None:
        """Store a new sequence separately; it is newer than the one with the same length in the group."""
        cursor = group.cursor_with(length)
        if cursor is not None:
            if self._options.policy.replaces_identical and identity(
                group.match_of(cursor, length)
            ) == identity(match):
                cursor.discard()
            else:
                self._ungroup(group, cursor, length)
        self._store_separately(match, length, group.key)

    def _ungroup(self, group: RunGroup, cursor: RunCursor, length: int) -> None:
        """Remove a sequence from a group and store it separately, with the age that it had in the group."""
        match = group.match_of(cursor, length)
        cursor.discard()
        # The sequence is as old as its last repetition.
        self._store_separately(match, length, group.key, group.order - length + 1)

    def _store_separately(
        self, match: PartialMatch, length: int, key: Hashable, order: Optional[int] = None
    ) -> None:
        buffer = self._buffer(length)
        buffer.add(match, key, order)
        # The lengths are cleared lazily, when a key is used. Keys that are never used again would accumulate, so all
        # entries are rebuilt when there are too many.
        if (
            key not in self._separate_lengths_by_key
            and len(self._separate_lengths_by_key) > 2 * self.rule.stored_match_count + 1000
        ):
            self._separate_lengths_by_key = {}
            for other_length, other_buffer in self._buffers.items():
                for other_key in other_buffer.newest:
                    self._separate_lengths_by_key.setdefault(other_key, {})[other_length] = None
        self._separate_lengths_by_key.setdefault(key, {})[length] = None

    def _buffer(self, length: int) -> MatchBuffer:
        """Return the buffer of the sequences of a length that are stored separately; create it if necessary."""
        buffer = self._buffers.get(length)
        if buffer is None:
            positions = self._value_positions if length == 1 else tuple(range(len(self._value_positions)))
            buffer = self._buffers[length] = MatchBuffer(self.rule, positions)
            buffer.retention = self.retention
            buffer.is_negated = self.is_negated
            self._configure_buffer(buffer, length)
        return buffer

    def _configure_buffer(self, buffer: MatchBuffer, length: int) -> None:
        buffer.partner_bounds = interval_bounds(SEQ, self.span, False)
        # Matches of one key have the same values, so these do not belong to the identity of longer sequences.
        identity_function = self._identity_functions[0] if length == 1 else identity
        buffer.set_identity_function(identity_function if self._options.policy.replaces_identical else None)

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
        """Remove all sequences that contain a repetition whose event was retracted.

        Returns:
            False, because no event was derived from them; see `Dependent`.
        """
        for _, cursor in list(group.cursors_by_length()):
            if cursor.first_number <= repetition_number:
                cursor.discard()
        return False

    # ---- join nodes ----------------------------------------------------------------------------------

    def _switch_to_joins(self) -> None:
        """Switch to join nodes, and move all sequences to their buffers."""
        for group in sorted(self.groups.values(), key=lambda stored: stored.order):
            # Oldest group first, longest sequence first: the order in which they were stored.
            for length, cursor in list(group.cursors_by_length()):
                self._ungroup(group, cursor, length)
        self._separate_lengths_by_key = {}
        self._is_grouped = False
        for length, buffer in self._buffers.items():
            for stored in buffer.stored_matches() if length > 1 else ():
                set_join_parts(stored, length)
        if not self._join_nodes:
            shared_vars = frozenset(self.vars)
            self._relays = [_Relay(self.child, shared_vars) for _ in range(self.times)]
            left: Any = self._relays[0]
            for length, relay in enumerate(self._relays[1:], 1):
                left = JoinNode(
                    rule=self.rule,
                    operator=_SEQ,
                    left=left,
                    right=relay,
                    shared_vars=shared_vars,
                    gap=None,
                    interval_vars=(),
                    shares_events=True,
                    has_instants=False,
                    identity_functions=self._identity_functions_for(length),
                )
                left.left_buffer = self._buffer(length)
                left.right_buffer.is_negated = self.is_negated
                left.set_span(self.span, self.retention)
                self._join_nodes.append(left)
        self._join_nodes[-1].bind(
            self._emit_slices if self._options.policy.replaces_identical else self._emit, self._options
        )

    def _remove_join_nodes(self) -> None:
        """Remove the join nodes of former options and their empty buffers; stored sequences remain.

        The buffers of a node without sequences must not depend on former options, because a state file refers to
        buffers by position.
        """
        self._join_nodes = []
        self._relays = []
        # No key has separate lengths while join nodes are in use, so none refers to the buffers that are removed.
        self._buffers = {length: buffer for length, buffer in self._buffers.items() if buffer.newest}

    def _identity_functions_for(self, length: int) -> Tuple[IdentityFunction, IdentityFunction]:
        identify_single, identify_longer = self._identity_functions
        return (identify_single if length == 1 else identify_longer), identify_single

    def _emit_slices(self, match: PartialMatch, frame: Frame) -> Frame:
        """Emit a complete match with the parts of a run group, because it may replace one that a group emitted."""
        set_slice_parts(match, self.times)
        return self._emit(match, frame)

    def _receiving_relays(self) -> Iterator[_Relay]:
        """Yield the relays that a match is sent to, last repetition first.

        Relays whose join node has no stored partner are skipped, unless the match may be stored there.
        """
        relays, accepts_late_events = self._relays, self._options.out_of_order
        for length in range(self.times - 1, 0, -1):
            if accepts_late_events or self._buffers[length].newest:
                self.visit_count += 1
                yield relays[length]
        yield relays[0]
