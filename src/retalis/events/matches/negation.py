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
from typing import TYPE_CHECKING, Callable, Deque, Dict, Hashable, List, Optional, Protocol, Sequence, Tuple

from ...prolog.terms.types import Frame, Values
from .interval_index import BEFORE, BETWEEN, MAX_VALUE, MIN_VALUE
from .match_buffer import MatchBuffer, has_equal_key, key_function
from .match_types import PartialMatch, unify_sides
from .network_options import NetworkOptions

if TYPE_CHECKING:
    from .match_limit import MatchStore


_STALE_TOLERANCE = 1000

MAX_RULED_OUT = 1000
"""Maximum number of ruled-out first operands, and of negated matches, that remain stored; see `RuledOutSweep`."""


class _Frontier:
    """The negated matches of one key that are not dominated by others: the skyline of their intervals.

    Starts and ends increase together. Matches that have left the buffer are removed when the number of entries has
    doubled.
    """

    __slots__ = ("starts", "ends", "matches", "compact_threshold")

    def __init__(self) -> None:
        self.starts: List[int] = []
        self.ends: List[int] = []
        self.matches: List[PartialMatch] = []
        self.compact_threshold = _STALE_TOLERANCE

    def add(self, match: PartialMatch) -> bool:
        """Add a match and remove the matches that it dominates; return False if the match itself is dominated."""
        starts, ends, matches = self.starts, self.ends, self.matches
        start, end = match.start, match.end
        position = bisect_left(starts, start)
        # A match that starts no earlier and ends no later dominates the new one. Entries that are not stored any
        # more are removed on the way and dominate nothing.
        while position < len(ends) and ends[position] <= end:
            if matches[position].buffer is not None:
                return False
            del starts[position], ends[position], matches[position]
        last_position = position + 1 if position < len(starts) and starts[position] == start else position
        # Entries that start no later and end no earlier are dominated by the new match. They are adjacent, because
        # starts and ends increase together.
        first = position
        while first and ends[first - 1] >= end:
            first -= 1
        dominated = matches[first:last_position]
        starts[first:last_position] = [start]
        ends[first:last_position] = [end]
        matches[first:last_position] = [match]
        # The frontier is consistent before the matches leave their buffer.
        for dominated_match in dominated:
            dominated_match.discard()
        return True

    def compact(self) -> None:
        """Remove the matches that have left the buffer if there are many entries."""
        if len(self.matches) <= self.compact_threshold:
            return
        self.matches = [match for match in self.matches if match.buffer is not None]
        self.starts = [match.start for match in self.matches]
        self.ends = [match.end for match in self.matches]
        self.compact_threshold = 2 * len(self.matches) + _STALE_TOLERANCE

    def find_between(self, gap_start: int, gap_end: int) -> Optional[PartialMatch]:
        """Return a match that lies strictly between two instants, or None."""
        position = bisect_right(self.starts, gap_start)
        while position < len(self.ends) and self.ends[position] < gap_end:
            if self.matches[position].buffer is not None:
                return self.matches[position]
            # Expired, or dropped because of the limit.
            del self.starts[position], self.ends[position], self.matches[position]
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
        self.buffer = MatchBuffer(rule, shared_positions, self._drop_frontiers)
        self.buffer.partner_bounds = BEFORE if is_unbounded else BETWEEN
        self.buffer.is_negated = True
        self.pair_buffer = MatchBuffer(rule, tuple(pair_position for _, pair_position in self.shared))
        self.frontiers: Dict[Hashable, _Frontier] = {}

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
        return frontier.add(match)

    def _frontier(self, key: Hashable) -> _Frontier:
        frontier = self.frontiers.get(key)
        if frontier is None or key not in self.buffer.newest:
            frontier = self.frontiers[key] = _Frontier()
            for match in self.buffer.matches_of_key(key):
                frontier.add(match)
            # Building a frontier removes dominated matches from the buffer, which may leave keys without matches.
            self._drop_empty_frontiers()
        return frontier

    def rules_out(self, key: Hashable, end: int) -> bool:
        """Return whether a negated match of a key starts after an instant.

        Matches stored without a key do not count.
        """
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
        position = bisect_left(frontier.ends, second_start) - 1
        while position >= 0 and frontier.matches[position].buffer is None:
            position -= 1
        return frontier.starts[position] if position >= 0 else MIN_VALUE

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
        condition = self.condition
        meter = self.rule.meter
        for match in self.buffer.partners(key, gap_start, gap_end, False):
            if meter is not None and meter(1):
                # Pattern work is stopped: a pair that may be ruled out must not produce a result.
                return True
            if match.end < gap_end and (self.is_unbounded or gap_start < match.start):
                negated_match, pair_values = match, values
                if not has_equal_key(key, match):
                    sides = unify_sides(match, pair, self.shared)
                    if sides is None:
                        continue
                    negated_match, pair_values = sides[0], sides[1].values
                if condition is None or condition(pair_values, negated_match):
                    # The lineage records what prevented the pair, so that the pair is tried again if this match is
                    # retracted.
                    self.rule.blocking_match = match
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

        Args:
            last_order: order of the last match that has been stored.
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
            return self.negation.rules_out(self._compute_key(match.values), match.end)
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
