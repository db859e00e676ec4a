"""Match buffers: the stored partial matches of one operand.

A buffer is a beta memory of the Rete network, indexed by the values of the variables that both operands share (a
hash join). The matches of one key form a ring in order of arrival, linked by attributes of the matches themselves:
adding and removing cost the same for any number of matches, and no container is needed for keys with one match,
which is the usual case. Two further indices of a key are created only when a search shows that they pay off, and are
dropped when they become idle:

* an `IntervalIndex`, if many matches are skipped because they lie outside of the time bounds of a search;
* a dictionary by identity, if a match replaces an older match with the same identity (policy ``recent``).

Values with variables have no hash key. Matches with such values are stored under the key None, and are unified with
every partner.
"""

import heapq
from operator import attrgetter
from typing import TYPE_CHECKING, Callable, Dict, Hashable, Iterator, List, Optional, Sequence, Tuple

from ...prolog.terms.term_traversal import SELF_KEYED, freeze
from ...prolog.terms.types import Values
from .interval_index import MAX_VALUE, MIN_VALUE, IntervalBounds, IntervalIndex, TimeBounds
from .match_types import EventMatch, IdentifiedEventMatch, PartialMatch

if TYPE_CHECKING:
    from .match_limit import MatchStore


MAX_MISSES_BEFORE_INDEX, MAX_MISSES_WITH_INDEX = 32, 4
"""Matches outside of the time bounds that a search skips before it creates an index, and before it uses one."""
MAX_COMPARED_IDENTITIES = 4
"""Matches of a key that are compared before the key gets a dictionary by identity."""
_PARTNERS_PER_STEP = 16
"""Partners that can be listed in the time of one step of pattern work."""
_UNBOUNDED: TimeBounds = (MIN_VALUE, MAX_VALUE, MIN_VALUE, MAX_VALUE)


class MatchBuffer:
    """Stored matches of one operand, found by the values of the shared variables.

    The matches of one key form a ring: ``older`` of each match is the one before it, and ``older`` of the oldest is
    the newest.

    Args:
        rule: the rule that owns the buffer.
        on_relink: called after the stored matches were linked again, or replaced.

    Attributes:
        rule: the rule that owns the buffer; it counts and limits the stored matches.
        compute_key: returns the key of the values of a match; raises ValueError if a shared value contains variables.
        newest: newest match by key. The key None holds the matches with variables in their shared values, which are
            unified with every partner.
        retention: retention time of stored matches, in ns; None for no bound.
        identity_of: returns the identity by which a match replaces a stored one; None if matches do not replace each
            other.
        partner_bounds: time bounds of the stored matches that a partner searches for; None for no bounds.
        min_end_for: returns the smallest end of the stored matches that can join a partner with the given start; None
            for no bound.
        is_negated: whether the matches belong to a negated pattern; those are not skipped after a match.
        indices: time indices, by key.
        by_identity: stored matches by identity, by key, for keys with more than a few matches.
    """

    is_negated = False

    def __init__(
        self,
        rule: "MatchStore",
        shared_positions: Tuple[int, ...],
        on_relink: Callable[[], None] = lambda: None,
    ):
        self.rule = rule
        self._on_relink = on_relink
        self.compute_key = key_function(shared_positions)
        self.newest: Dict[Hashable, PartialMatch] = {}
        self.retention: Optional[int] = None
        self.identity_of: Optional[Callable[[PartialMatch], Hashable]] = None
        self.partner_bounds: Optional[IntervalBounds] = None
        self.min_end_for: Optional[Callable[[int], int]] = None
        self.indices: Dict[Hashable, IntervalIndex] = {}
        self.by_identity: Dict[Hashable, Dict[Hashable, PartialMatch]] = {}

    def key_of(self, match: PartialMatch) -> Hashable:
        """Return the key of a match; None if a shared value contains variables."""
        try:
            return self.compute_key(match.values)
        except ValueError:
            return None

    def add(self, match: PartialMatch, key: Hashable, order: Optional[int] = None) -> None:
        """Store a match, by default with the next order of the rule."""
        rule = self.rule
        if order is None:
            # The end is a larger number than all orders before it if matches arrive in order of time. No second
            # integer is stored then.
            end = match.end
            rule.order = order = end if end > rule.order else rule.order + 1
        match.order = order
        match.key = key
        newest_match = self.newest.get(key)
        if newest_match is None:
            # The identity of a longer match includes this one, so it is computed once, here.
            if self.identity_of is not None and match.parts is not None:
                match.identity = self.identity_of(match)
            match.buffer = self
            match.older = match.newer = self.newest[key] = match
        else:
            self.add_to_ring(match)
        rule.count_stored(match, self.retention)

    def add_to_ring(self, match: PartialMatch) -> None:
        """Add a match that has a key and an order to the ring of its key, replacing a match of the same identity."""
        key = match.key
        if self.identity_of is not None:
            by_identity = self.by_identity.get(key)
            if by_identity is None:
                replaced = self.find_identical(match, key)
            else:
                match.identity = identity = self.identity_of(match)
                replaced = by_identity.get(identity)
            if replaced is not None:
                self.remove(replaced)
        match.buffer = self
        newest = self.newest
        # `remove` may have removed the only match of the key, so the ring is looked up again.
        newest_match = newest.setdefault(key, match)
        if newest_match is match:
            match.older = match.newer = match
        else:
            match.older = newest_match
            match.newer = oldest = newest_match.newer
            newest_match.newer = oldest.older = newest[key] = match
            if self.indices and key in self.indices:
                self.indices[key].add(match)
                self._drop_if_idle(key)
            if self.by_identity and key in self.by_identity:
                self.by_identity[key][match.identity] = match

    def remove(self, match: PartialMatch) -> None:
        """Remove a stored match."""
        match.buffer = None
        self.rule.stored_match_count -= 1
        key = match.key
        older, newer = match.older, match.newer
        if older is match:
            # A link to itself would be a reference cycle, which only the garbage collector could free.
            match.older = match.newer = None  # type: ignore[assignment]  # read only of stored matches
            del self.newest[key]
            self.indices.pop(key, None)
            self.by_identity.pop(key, None)
            return
        older.newer = newer
        newer.older = older
        if self.newest[key] is match:
            self.newest[key] = older
        match.older = match.newer = None  # type: ignore[assignment]
        if self.indices and key in self.indices:
            self.indices[key].remove(match)
            self._drop_if_idle(key)
        if (
            self.by_identity
            and key in self.by_identity
            and self.by_identity[key].get(match.identity) is match
        ):
            del self.by_identity[key][match.identity]

    def expand(self) -> Dict[PartialMatch, PartialMatch]:
        """Replace the matches that cannot hold all attributes of a `PartialMatch`; return the new ones by the old."""
        stored = self.stored_matches()
        expanded = {match: _expanded(match) for match in stored if not isinstance(match, PartialMatch)}
        if expanded:
            self.newest.clear()
            self.indices.clear()
            self.by_identity.clear()
            for match in expanded:
                match.buffer = None
            self.put_back([expanded.get(match, match) for match in stored])
            self._on_relink()
        return expanded

    def _build_ring(self, key: Hashable, stored_matches: List[PartialMatch]) -> None:
        """Build the ring of a key from its matches, which are given oldest first."""
        for older, newer in zip(stored_matches, [*stored_matches[1:], stored_matches[0]]):
            older.newer, newer.older = newer, older
        self.newest[key] = stored_matches[-1]

    def put_back(self, stored_matches: Sequence[PartialMatch]) -> None:
        """Store matches whose ``order`` is set in an empty buffer, as they were stored in another one."""
        groups: Dict[Hashable, List[PartialMatch]] = {}
        for match in sorted(stored_matches, key=attrgetter("order")):
            match.buffer = self
            try:
                match.key = self.compute_key(match.values_with_key)
            except ValueError:
                match.key = None
            if self.identity_of is not None:
                self._identify_match(match)
            groups.setdefault(match.key, []).append(match)
        for key, group in groups.items():
            self._build_ring(key, group)

    def find_identical(self, match: PartialMatch, key: Hashable) -> Optional[PartialMatch]:
        """Return the stored match that a match with a key replaces; matches with one identity have the same key."""
        assert self.identity_of is not None
        match.identity = identity = self.identity_of(match)
        newest_match = self.newest.get(key)
        if newest_match is None:
            return None
        by_identity = self.by_identity.get(key)
        if by_identity is None:
            candidate = newest_match
            # A dictionary is created only for keys with more matches than a short scan visits.
            for _ in range(MAX_COMPARED_IDENTITIES):
                if (candidate.identity or self._identify_match(candidate)) == identity:
                    return candidate
                candidate = candidate.older
                if candidate is newest_match:
                    return None
            by_identity = self.by_identity[key] = {
                candidate.identity or self._identify_match(candidate): candidate
                for candidate in self.matches_of_key(key)
            }
        return by_identity.get(identity)

    def _identify_match(self, match: PartialMatch) -> Hashable:
        """Set and return the identity of a match; a match that is alone under its key may not have one yet."""
        assert self.identity_of is not None
        identity = self.identity_of(match)
        # Other matches compute it at each access.
        if isinstance(match, (PartialMatch, IdentifiedEventMatch)):
            match.identity = identity
        return identity

    def _drop_if_idle(self, key: Hashable) -> None:
        if self.indices[key].is_idle:
            del self.indices[key]

    def matches_of_key(self, key: Hashable) -> List[PartialMatch]:
        """Return the stored matches of a key, oldest first."""
        newest_match = self.newest.get(key)
        if newest_match is None:
            return []
        matches = [newest_match]
        match = newest_match.older
        while match is not newest_match:
            matches.append(match)
            match = match.older
        matches.reverse()
        return matches

    def stored_matches(self) -> List[PartialMatch]:
        """Return all stored matches, oldest first."""
        return sorted(
            (match for key in self.newest for match in self.matches_of_key(key)), key=attrgetter("order")
        )

    def partners(self, key: Hashable, start: int, end: int, newest: bool) -> Iterator[PartialMatch]:
        """Yield the stored matches that may join a match: newest or oldest first.

        Matches may be added and removed between two results. Matches that are added are not yielded, and neither are
        matches that have been removed.

        Args:
            key: key of the shared values of the match; None if they contain variables.
            start: start of the match.
            end: end of the match.
            newest: whether the newest match is yielded first, else the oldest.
        """
        if key is None:
            matches = self.stored_matches()
            return reversed(matches) if newest else iter(matches)
        limits = _UNBOUNDED if self.partner_bounds is None else self.partner_bounds.limits(start, end)
        if self.min_end_for is not None:
            limits = (*limits[:2], max(limits[2], self.min_end_for(start)), limits[3])
        if None not in self.newest:
            return self._within(key, limits, newest)
        merged_sources = self._within(key, limits, newest), self._within(None, limits, newest)
        return iter(heapq.merge(*merged_sources, key=attrgetter("order"), reverse=newest))

    def partner_list(self, key: Hashable, start: int, end: int) -> Sequence[PartialMatch]:
        """Return the stored matches that may join a match, oldest first; see `partners`.

        The result is empty if pattern work was stopped.
        """
        if key is not None and None not in self.newest:
            newest_match = self.newest.get(key)
            if newest_match is None:
                return ()
            if newest_match.older is newest_match:
                return (newest_match,)
        meter = self.rule.meter
        if meter is None:
            return list(self.partners(key, start, end, False))
        if meter(0):
            return ()
        partners = list(self.partners(key, start, end, False))
        # A nested dispatch creates a list at each level before any level uses its second element, so the lists must
        # be counted as work here, not only their elements later.
        meter(len(partners) // _PARTNERS_PER_STEP)
        return partners

    def _within(self, key: Hashable, limits: TimeBounds, newest: bool) -> Iterator[PartialMatch]:
        """Yield the stored matches of a key whose start and end lie within limits."""
        newest_match = self.newest.get(key)
        if newest_match is None:
            return
        min_start, max_start, min_end, max_end = limits
        newest_order = newest_match.order
        match = newest_match if newest else newest_match.newer
        order = MAX_VALUE if newest else MIN_VALUE
        # Misses and hits are counted against each other: a scan that yields results continues, a scan that mostly
        # skips matches is replaced by an index search.
        misses = -(MAX_MISSES_WITH_INDEX if key in self.indices else MAX_MISSES_BEFORE_INDEX)
        while misses <= 0:
            if match.order >= order if newest else not order < match.order <= newest_order:
                # Once around the ring, or at a match that was added meanwhile.
                return
            order = match.order
            step = match.older if newest else match.newer
            if min_start <= match.start <= max_start and min_end <= match.end <= max_end:
                misses -= 1
                yield match
                # The consumer of the iterator may have removed the next match, whose links are gone then.
                if step.buffer is not self:
                    next_match = self._next_after_removed(key, order, newest)
                    if next_match is None:
                        return
                    step = next_match
            else:
                misses += 1
            match = step
        for match in self._index(key).search(limits, newest, order):
            if match.order > newest_order:
                return
            if match.buffer is self:
                yield match

    def _index(self, key: Hashable) -> IntervalIndex:
        index = self.indices.get(key)
        if index is None:
            by_end = self.partner_bounds is not None and self.partner_bounds.by_end
            index = self.indices[key] = IntervalIndex(self.matches_of_key(key), by_end)
        return index

    def _next_after_removed(self, key: Hashable, order: int, newest: bool) -> Optional[PartialMatch]:
        """Return the next match of a key after an order whose match may have been removed."""
        for match in reversed(self.matches_of_key(key)) if newest else self.matches_of_key(key):
            if match.order < order if newest else match.order > order:
                return match
        return None

    def set_identity_function(self, identity_of: Optional[Callable[[PartialMatch], Hashable]]) -> None:
        """Set the function by which a match replaces a stored one with the same identity; None for no replacement.

        Of the stored matches with one identity, the newest can be replaced.
        """
        self.identity_of = identity_of
        self.by_identity = {}
        if identity_of is not None:
            for match in self.stored_matches():
                self._identify_match(match)


def _expanded(match: EventMatch) -> PartialMatch:
    """Return a match as a `PartialMatch`, to be stored instead of it."""
    expanded = PartialMatch(match.values, match.start, match.end, None, match.term, None)
    expanded.order = match.order
    return expanded


def has_equal_key(key: Hashable, partner: PartialMatch) -> bool:
    """Return whether a partner from `MatchBuffer.partners` is known to have the shared values of the search key."""
    return key is not None and partner.buffer is not None and partner.key is not None


def key_function(positions: Tuple[int, ...]) -> Callable[[Values], Hashable]:
    """Return a function that maps values to the key of those at ``positions``.

    The function raises ValueError for values with variables. The key is never None.
    """
    if not positions:
        return lambda values: ()
    if len(positions) > 1:
        return lambda values: tuple([freeze(values[position]) for position in positions])
    position = positions[0]

    def key(values: Values) -> Hashable:
        value = values[position]
        return value if value.__class__ in SELF_KEYED else freeze(value)

    return key
