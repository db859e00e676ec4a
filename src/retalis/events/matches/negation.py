"""Negation: stored matches of negated patterns, and removal of matches that they rule out.

A negated pattern (``cnot``, ``fnot``) prevents a pair of matches if one of its own matches lies in the gap between
them. `NegationBuffer` corresponds to the NotNode of a Rete network, and to negation in SASE: it stores the negated
matches by the values of the variables that they share with the pair, and answers one question for each pair that is
joined: does a negated match lie strictly between the end of the first operand and the start of the second one?

If only times matter, the question is answered by binary search. A negated match is *dominated* if another one starts
no earlier and ends no later, because every gap that contains the former contains the latter. `_Frontier` stores only
the matches that are not dominated (the skyline). Their starts and ends increase together, so the first of them that
starts after the gap begins is also the first of those to end. If a negated pattern has conditions on the pair, or if
events may be retracted, all matches are stored and tested one by one.

Without a ``within`` bound nothing expires, and first operands that are ruled out forever would accumulate together
with the matches that rule them out. `RuledOutSweep` removes the oldest of both.
"""

from bisect import bisect_left, bisect_right
from collections import deque
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Deque,
    Dict,
    Hashable,
    List,
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

from ...prolog.terms.timestamps import SECOND
from ...prolog.terms.types import Frame, Values
from .expiration import retention_for_late
from .interval_index import BEFORE, BETWEEN, ENDS_AFTER_START, MAX_VALUE, MIN_VALUE, IntervalBounds
from .match_buffer import MatchBuffer, has_equal_key, key_function
from .match_policies import NetworkOptions
from .match_types import PartialMatch, unify_sides

if TYPE_CHECKING:
    from .match_limit import MatchStore


_STALE_TOLERANCE = 1000

MAX_RULED_OUT = 1000
"""Maximum number of ruled-out first operands, and of negated matches, that remain stored; see `RuledOutSweep`."""


MAX_LOST_KEYS = 10_000
"""Number of keys for which an `OverlapBuffer` records separately which matches are lost."""

LATE_MATCH_RETENTION_NANOSECONDS = 600 * SECOND
"""Time for which the negated matches of ``without`` are stored in addition, for matches that are emitted late."""

LATE_START_RETENTION_NANOSECONDS = 60 * SECOND
"""Time for which the negated matches of a repetition are stored in addition, for starts that arrive late."""


class _Frontier:
    """The negated matches of one key that are not dominated by others: the skyline of their bounds.

    The bounds of a match are two instants, a lower and an upper one: the match lies in a scope if its lower bound is
    after the start of the scope, and its upper bound before the end. Both bounds of the entries increase together.
    Matches that have left the buffer are removed when the number of entries has doubled.
    """

    __slots__ = ("lower_bounds", "upper_bounds", "matches", "compact_threshold")

    def __init__(self) -> None:
        self.lower_bounds: List[int] = []
        self.upper_bounds: List[int] = []
        self.matches: List[PartialMatch] = []
        self.compact_threshold = _STALE_TOLERANCE

    def add(self, match: PartialMatch, lower: int, upper: int) -> bool:
        """Add a match and remove the matches that it dominates; return False if the match itself is dominated."""
        lower_bounds, upper_bounds, matches = self.lower_bounds, self.upper_bounds, self.matches
        position = bisect_left(lower_bounds, lower)
        # A match with no smaller lower bound and no larger upper bound dominates the new one. Entries that are not
        # stored any more are removed on the way and dominate nothing.
        while position < len(upper_bounds) and upper_bounds[position] <= upper:
            if matches[position].buffer is not None:
                return False
            del lower_bounds[position], upper_bounds[position], matches[position]
        is_equal = position < len(lower_bounds) and lower_bounds[position] == lower
        last_position = position + 1 if is_equal else position
        # Entries with no larger lower bound and no smaller upper bound are dominated by the new match. They are
        # adjacent, because both bounds increase together.
        first = position
        while first and upper_bounds[first - 1] >= upper:
            first -= 1
        dominated = matches[first:last_position]
        lower_bounds[first:last_position] = [lower]
        upper_bounds[first:last_position] = [upper]
        matches[first:last_position] = [match]
        # The frontier is consistent before the matches leave their buffer.
        for dominated_match in dominated:
            dominated_match.discard()
        return True

    def pop_first(self) -> PartialMatch:
        """Remove the entry with the smallest bounds and return its match."""
        del self.lower_bounds[0], self.upper_bounds[0]
        return self.matches.pop(0)

    def compact(self) -> None:
        """Remove the matches that have left the buffer if there are many entries."""
        if len(self.matches) <= self.compact_threshold:
            return
        positions = [position for position, match in enumerate(self.matches) if match.buffer is not None]
        self.lower_bounds = [self.lower_bounds[position] for position in positions]
        self.upper_bounds = [self.upper_bounds[position] for position in positions]
        self.matches = [self.matches[position] for position in positions]
        self.compact_threshold = 2 * len(positions) + _STALE_TOLERANCE

    def find_between(self, scope_start: int, scope_end: int) -> Optional[PartialMatch]:
        """Return a match with bounds strictly between two instants, or None."""
        position = bisect_right(self.lower_bounds, scope_start)
        while position < len(self.upper_bounds) and self.upper_bounds[position] < scope_end:
            if self.matches[position].buffer is not None:
                return self.matches[position]
            # Expired, or dropped because of the limit.
            del self.lower_bounds[position], self.upper_bounds[position], self.matches[position]
        return None


class NegatedNode(Protocol):
    """The node of a negated pattern: any node of the network."""

    def bind(self, emit: Callable[[PartialMatch, Frame], Frame], options: NetworkOptions, /) -> None:
        """Emit the matches of the pattern to a function."""

    def accepts(self, match: PartialMatch, /) -> bool:
        """Return whether a stored match has the values and the event that the node requires."""


DeferredNegations = List[Tuple["NegationBuffer", NegatedNode]]
"""Negation buffers that conditions contain, with the nodes of their negated patterns."""


class NegationBuffer:
    """Stored matches of a negated pattern, by the variables that it shares with the pair that it can prevent.

    For a gap ``(e1, s2)`` the buffer answers whether a match has ``e1 < start`` and ``end < s2``. If it
    ``is_unbounded``, the gap has no beginning: any match that ended before ``s2`` counts.

    Args:
        rule: the rule that owns the buffer.
        shared: pairs of positions of the shared variables: in the values of the negated match, and in the values of
            the pair.
        is_unbounded: whether a match at any time before the gap's end counts.

    Attributes:
        condition: tests the values of the pair together with a negated match, if the negated pattern has conditions
            on the pair; else None.
        deferred_negations: negation buffers that those conditions contain, with the nodes of their negated patterns.
        frontiers: frontiers by key.
    """

    def __init__(self, rule: "MatchStore", shared: Sequence[Tuple[int, int]], is_unbounded: bool):
        self.rule = rule
        self.shared = tuple(shared)
        self.is_unbounded = is_unbounded
        self.condition: Optional[Callable[[Values, PartialMatch], bool]] = None
        self.deferred_negations: DeferredNegations = []
        shared_positions = tuple(position for position, _ in self.shared)
        self.buffer = self._create_buffer(shared_positions)
        self.buffer.partner_bounds = self._partner_bounds()
        self.buffer.is_negated = True
        self.pair_buffer = MatchBuffer(rule, tuple(pair_position for _, pair_position in self.shared))
        self.frontiers: Dict[Hashable, _Frontier] = {}

    def _create_buffer(self, shared_positions: Tuple[int, ...]) -> MatchBuffer:
        return MatchBuffer(self.rule, shared_positions, self._drop_frontiers)

    def _partner_bounds(self) -> IntervalBounds:
        """Return the time bounds of the negated matches that can prevent a pair."""
        return BEFORE if self.is_unbounded else BETWEEN

    def _bounds(self, match: PartialMatch) -> Tuple[int, int]:
        """Return the bounds of a negated match for `_Frontier`."""
        return match.start, match.end

    def _drop_frontiers(self) -> None:
        """Drop the frontiers; each is built again at its next use."""
        self.frontiers = {}

    def bind(self, negated: "NegatedNode", options: NetworkOptions) -> None:
        """Receive the matches of a node, and connect the buffers that the conditions contain."""
        negated.bind(self.on_match, options)
        self.bind_deferred_negations(options)

    def bind_deferred_negations(self, options: NetworkOptions) -> None:
        """Connect the negation buffers that the conditions contain."""
        for negation, node in self.deferred_negations:
            negation.bind(node, options)

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the bounds of the node that tests pairs, if they limit the retention of negated matches."""

    def clear(self) -> None:
        """Reset the state besides the stored matches."""

    def buffers(self) -> List[MatchBuffer]:
        """Return the buffers of negated matches, including those of its conditions."""
        return [
            self.buffer,
            *(buffer for negation, _ in self.deferred_negations for buffer in negation.buffers()),
        ]

    def on_match(self, match: PartialMatch, frame: Frame) -> Frame:
        """Store a negated match, unless stored matches dominate it."""
        key = self.buffer.key_of(match)
        if key is not None and self.uses_frontiers() and not self._is_needed(key, match):
            return frame
        self.buffer.add(match, key)
        return frame

    def uses_frontiers(self) -> bool:
        """Return whether only times matter: matches have no conditions, and events are not retracted."""
        return self.condition is None and not self.rule.options.tracks_events

    def _is_needed(self, key: Hashable, match: PartialMatch) -> bool:
        newest_match = self.buffer.newest.get(key)
        # If the gap has no beginning, the match that ends first dominates all others, so at most one is stored for
        # each key.
        if self.is_unbounded:
            if newest_match is None:
                return True
            older = newest_match.newer
            if older.end <= match.end:
                return False
            older.discard()
            return True
        frontier = self._frontier(key)
        # Must precede `add`: the new match is in no buffer yet and would be removed.
        frontier.compact()
        return frontier.add(match, *self._bounds(match))

    def _frontier(self, key: Hashable) -> _Frontier:
        frontier = self.frontiers.get(key)
        if frontier is None or key not in self.buffer.newest:
            frontier = self.frontiers[key] = _Frontier()
            for match in self.buffer.matches_of_key(key):
                frontier.add(match, *self._bounds(match))
            # Building a frontier removes dominated matches from the buffer, which may leave keys without matches.
            self._drop_empty_frontiers()
        return frontier

    def rules_out(self, key: Hashable, first: PartialMatch) -> bool:
        """Return whether a negated match of a key starts after a first operand.

        Matches stored without a key do not count.
        """
        end = first.end
        newest_match = self.buffer.newest.get(key)
        if newest_match is None:
            return False
        if newest_match.older is newest_match:
            return newest_match.start > end
        return self._frontier(key).find_between(end, MAX_VALUE) is not None

    def min_first_end(self, second_start: int) -> int:
        """Return the smallest end that a first operand can have if the second operand starts at ``second_start``.

        This bound lets the join skip all first operands that are ruled out. It holds only if the negated pattern
        shares no variables and `uses_frontiers` is true.
        """
        newest_match = self.buffer.newest.get(())
        if newest_match is None:
            return MIN_VALUE
        if newest_match.older is newest_match:
            return newest_match.start if newest_match.end < second_start else MIN_VALUE
        frontier = self._frontier(())
        # The last match that ends before the second operand also has the largest start of those; a first operand
        # that ends before that start is ruled out.
        position = bisect_left(frontier.upper_bounds, second_start) - 1
        while position >= 0 and frontier.matches[position].buffer is None:
            position -= 1
        return frontier.lower_bounds[position] if position >= 0 else MIN_VALUE

    def _drop_empty_frontiers(self) -> None:
        """Remove the frontiers of keys without stored matches, if there are many."""
        newest = self.buffer.newest
        if len(self.frontiers) > 2 * len(newest) + _STALE_TOLERANCE:
            self.frontiers = {key: frontier for key, frontier in self.frontiers.items() if key in newest}

    def forbids_pair(self, values: Values, gap_start: int, gap_end: int) -> bool:
        """Return whether a negated match lies between two instants."""
        buffer = self.buffer
        if not buffer.newest:
            self.frontiers.clear()
            return False
        try:
            key = self.pair_buffer.compute_key(values)
        except ValueError:
            key = None
        if key is not None and not self.is_unbounded and None not in buffer.newest and self.uses_frontiers():
            newest_match = buffer.newest.get(key)
            if newest_match is None:
                self.frontiers.pop(key, None)
                return False
            # A key with one match is the usual case and needs no frontier.
            if newest_match.older is newest_match:
                return gap_start < newest_match.start and newest_match.end < gap_end
            frontier = self.frontiers.get(key)
            if frontier is not None:
                return frontier.find_between(gap_start, gap_end) is not None
        return self._search_buffer(key, values, gap_start, gap_end)

    def _search_buffer(self, key: Hashable, values: Values, gap_start: int, gap_end: int) -> bool:
        """Test the stored matches that may share the values, one by one."""
        pair = PartialMatch(values, gap_start, gap_end, None, None, ())
        meter = self.rule.meter
        for match in self.buffer.partners(key, gap_start, gap_end, False):
            if meter is not None and meter(1):
                # Pattern work is stopped: a pair that may be ruled out must not produce a result.
                return True
            is_in_gap = match.end < gap_end and (self.is_unbounded or gap_start < match.start)
            if is_in_gap and self._is_forbidden_by(match, key, pair):
                return True
        return False

    def _is_forbidden_by(self, match: PartialMatch, key: Hashable, pair: PartialMatch) -> bool:
        """Return whether a negated match in the scope agrees with the values of a pair, given its key."""
        negated_match, pair_values = match, pair.values
        if not has_equal_key(key, match):
            sides = unify_sides(match, pair, self.shared)
            if sides is None:
                return False
            negated_match, pair_values = sides[0], sides[1].values
        condition = self.condition
        if condition is not None and not condition(pair_values, negated_match):
            return False
        # The lineage records what prevented the pair, so that the pair is tried again if this match is retracted.
        self.rule.blocking_match = match
        return True


class _OverlapMatchBuffer(MatchBuffer):
    """Buffer of an `OverlapBuffer`, which records the ends of the matches that are lost.

    A match is lost if it has expired, or if there were too many of its key.
    """

    def __init__(self, rule: "MatchStore", shared_positions: Tuple[int, ...], on_relink: Callable[[], None]):
        super().__init__(rule, shared_positions, on_relink)
        self.forget_lost()

    def forget_lost(self) -> None:
        """Record that no match is lost."""
        self._lost_ends: Dict[Hashable, int] = {}
        """Largest end of the lost matches of a key; the key that has lost one last is the last one."""
        self._lost_end_of_other_keys = self._largest_lost_end = MIN_VALUE

    def remove(self, match: PartialMatch) -> None:
        """See `MatchBuffer.remove`."""
        super().remove(match)
        retention = self.retention
        if retention is not None and match.start + retention < self.rule.clock:
            self.note_lost(match.key, match.end)

    def note_lost(self, key: Hashable, end: int) -> None:
        """Record that a match is not stored although it may overlap a match that is tested later."""
        self._largest_lost_end = max(self._largest_lost_end, end)
        self._lost_ends[key] = max(self._lost_ends.pop(key, end), end)
        # A match with variables in its key may agree with any key.
        if key is None or len(self._lost_ends) > MAX_LOST_KEYS:
            other_end = self._lost_ends.pop(key if key is None else next(iter(self._lost_ends)))
            self._lost_end_of_other_keys = max(self._lost_end_of_other_keys, other_end)

    def largest_lost_end(self, key: Hashable) -> int:
        """Return the largest end of the lost matches that may have a key; None for a key with variables."""
        if key is None:
            return self._largest_lost_end
        return max(self._lost_ends.get(key, MIN_VALUE), self._lost_end_of_other_keys)

    def has_lost(self, start: int) -> bool:
        """Return whether a match of any key that ended after an instant is lost."""
        return start < self._largest_lost_end


class OverlapBuffer(NegationBuffer):
    """Stored matches of a negated pattern that must not overlap a match (``without``).

    Its matches come from an `EndNode`: their interval is the end of the negated match, because they expire by their
    ends, and their last value is its start. A match overlaps an interval if it ends after the start of the interval,
    and starts before the end. For a gap, start and end have the opposite roles, so the lower bound of a match is its
    end here, the upper bound is its start, and of two nested matches the outer one dominates.

    Without a time limit nothing expires. A match that is emitted late, as by a session window, may overlap any of the
    stored ones, so only the limit of the rule removes some, and reports it. A pair that is joined ends with the event
    that completes it. If this event is not late, only the negated match of a key that ends last decides, so the
    `MAX_RULED_OUT` of each key that end last are stored. If a match is tested that one which is not stored any more
    may overlap, this is reported, see `may_have_lost`.

    Args:
        rule: the rule that owns the buffer.
        shared: see `NegationBuffer`.
        start_position: position of the start in the values of a negated match.
        is_on_own_interval: whether the interval of each tested match is that of the node that tests it.
        expects_late: whether matches may be tested long after their ends.
    """

    def __init__(
        self,
        rule: "MatchStore",
        shared: Sequence[Tuple[int, int]],
        start_position: int,
        is_on_own_interval: bool,
        expects_late: bool,
    ):
        super().__init__(rule, shared, False)
        self.is_on_own_interval = is_on_own_interval
        self._start_position = start_position
        self._expects_late = expects_late

    def _create_buffer(self, shared_positions: Tuple[int, ...]) -> MatchBuffer:
        self._overlap_buffer = _OverlapMatchBuffer(self.rule, shared_positions, self._drop_frontiers)
        return self._overlap_buffer

    def clear(self) -> None:
        """See `NegationBuffer.clear`."""
        self._overlap_buffer.forget_lost()

    def _partner_bounds(self) -> IntervalBounds:
        return ENDS_AFTER_START

    def _bounds(self, match: PartialMatch) -> Tuple[int, int]:
        return match.end, self._start_of(match)

    def set_span(self, span: Optional[int], retention: Optional[int]) -> None:
        """Set the retention of matches, for the bounds of the node that tests pairs; see `NetworkNode.set_span`."""
        if self.is_on_own_interval:
            # A pair ends after the earliest start of a stored operand, and starts at most a span before its end.
            self.buffer.retention = retention_for_late(span, retention)

    def _start_of(self, match: PartialMatch) -> int:
        start: Any = match.values[self._start_position]
        return start  # type: ignore[no-any-return]

    def may_have_lost(self, values: Values, start: int) -> bool:
        """Return whether a match that ended after ``start``, and may agree with values, is not stored any more."""
        buffer = self._overlap_buffer
        return buffer.has_lost(start) and start < buffer.largest_lost_end(self._key_of_pair(values))

    def _key_of_pair(self, values: Values) -> Hashable:
        try:
            return self.pair_buffer.compute_key(values)
        except ValueError:
            return None

    def _is_needed(self, key: Hashable, match: PartialMatch) -> bool:
        if not super()._is_needed(key, match):
            return False
        if self._expects_late or self.buffer.retention is not None:
            return True
        frontier = self.frontiers[key]
        while len(frontier.matches) > MAX_RULED_OUT:
            lost_match = frontier.pop_first()
            self._overlap_buffer.note_lost(key, lost_match.end)
            # A late match may be the one that ends first.
            if lost_match is match:
                return False
            lost_match.discard()
        return True

    def rules_out(self, key: Hashable, first: PartialMatch) -> bool:
        """Return whether a negated match of a key ends after the start of a first operand.

        Matches stored without a key do not count.
        """
        if key not in self.buffer.newest:
            return False
        return self._frontier(key).find_between(first.start, MAX_VALUE) is not None

    def forbids_pair(self, values: Values, gap_start: int, gap_end: int) -> bool:
        """Return whether a negated match overlaps the interval from ``gap_start`` to ``gap_end``."""
        buffer = self.buffer
        if not buffer.newest:
            self.frontiers.clear()
            return False
        key = self._key_of_pair(values)
        if key is None or None in buffer.newest or not self.uses_frontiers():
            return self._search_buffer(key, values, gap_start, gap_end)
        if key not in buffer.newest:
            self.frontiers.pop(key, None)
            return False
        return self._frontier(key).find_between(gap_start, gap_end) is not None

    def _search_buffer(self, key: Hashable, values: Values, start: int, end: int) -> bool:
        """Test the stored matches that may share the values, the newest first."""
        pair = PartialMatch(values, start, end, None, None, ())
        meter = self.rule.meter
        for match in self.buffer.partners(key, start, end, True):
            if meter is not None and meter(1):
                # Pattern work is stopped: a pair that may be ruled out must not produce a result.
                return True
            overlaps = match.end > start and self._start_of(match) < end
            if overlaps and self._is_forbidden_by(match, key, pair):
                return True
        return False


class RuledOutSweep:
    """Removes first operands that are ruled out, and the negated matches that rule them out, if there are many.

    A negated match R rules out each first operand P that ended before R started, for all second operands that start
    after R ended. If events arrive in order and no second operand overlaps R, P can never complete. For the other
    cases, the newest `MAX_RULED_OUT` of such P and as many R remain stored. R leaves together with every stored P
    that it rules out, so no sequence is reported that R prevents. Only a P that arrives later, and ended before R
    started, is not prevented any more.

    A pass over all stored matches is made in slices, so no event waits for a complete pass.

    Args:
        first_buffer: buffer of the first operands.
        negation: buffer of the negated matches. It shares variables with first operands only and has no conditions.
        positions: positions of the shared variables in the values of a first operand.
    """

    def __init__(self, first_buffer: MatchBuffer, negation: NegationBuffer, positions: Sequence[int]):
        self.first_buffer = first_buffer
        self.negation = negation
        self._compute_key = key_function(tuple(positions))
        self._ruled_out: Deque[PartialMatch] = deque()
        self._negated: Deque[PartialMatch] = deque()
        self._min_unkeyed_end = MAX_VALUE
        self._last_order = MIN_VALUE

    def begin_pass(self, last_order: int) -> None:
        """Begin a pass.

        Negated matches that arrive during the pass are left to the next one, because the pass may already have
        visited first operands that they rule out.
        """
        self._last_order = last_order
        self._ruled_out.clear()
        self._negated.clear()
        self._min_unkeyed_end = MAX_VALUE

    def visit_match(self, match: PartialMatch) -> None:
        """Process the next match of the rule, in order of arrival."""
        if match.buffer is self.negation.buffer:
            if match.key is not None and match.order <= self._last_order:
                self._negated.append(match)
        elif match.buffer is self.first_buffer and self._is_ruled_out(match):
            self._ruled_out.append(match)
            if len(self._ruled_out) > MAX_RULED_OUT:
                self._ruled_out.popleft().discard()

    def _is_ruled_out(self, match: PartialMatch) -> bool:
        try:
            return self.negation.rules_out(self._compute_key(match.values), match)
        except ValueError:
            # A first operand with variables in shared values would need unification to find what rules it out. It is
            # kept, and so are all negated matches that start after its end.
            self._min_unkeyed_end = min(self._min_unkeyed_end, match.end)
            return False

    def drop_negated(self, max_count: int) -> bool:
        """Remove up to ``max_count`` surplus negated matches; return whether all of them are removed."""
        negated = self._negated
        surplus: List[PartialMatch] = []
        while len(negated) > MAX_RULED_OUT and len(surplus) < max_count:
            match = negated.popleft()
            if match.buffer is not None and match.start <= self._min_unkeyed_end:
                surplus.append(match)
        latest_end: Dict[Hashable, int] = {}
        for match in surplus:
            latest_end[match.key] = max(match.start, latest_end.get(match.key, match.start))
        if surplus:
            for match in self._ruled_out:
                if (
                    match.buffer is not None
                    and latest_end.get(self._compute_key(match.values), match.end) > match.end
                ):
                    match.discard()
        for match in surplus:
            match.discard()
        return len(negated) <= MAX_RULED_OUT


class OverlapSweep(RuledOutSweep):
    """Removes first operands that a match of `OverlapBuffer` rules out.

    A negated match that ends after the start of a first operand overlaps all pairs that end after it. The negated
    matches remain: they also overlap pairs whose first operands consist of matches that are stored elsewhere.
    """

    def visit_match(self, match: PartialMatch) -> None:
        """See `RuledOutSweep.visit_match`."""
        if match.buffer is not self.negation.buffer:
            super().visit_match(match)

    def drop_negated(self, max_count: int) -> bool:
        """Return True: there is nothing to remove."""
        return True
