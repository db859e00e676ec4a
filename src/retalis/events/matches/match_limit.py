"""Limit of the stored matches of a rule: their order, their number, and the removal of those that are too many.

`MatchStore` lists the stored matches in order of arrival. Matches that have left their buffers remain in the list
until they are the larger part of it, and are then removed in slices. If a rule has too many matches, those that a
sweep finds ruled out are removed first (`RuledOutSweep`); then the oldest one is dropped and reported.
"""

from collections import deque
from typing import TYPE_CHECKING, Deque, Iterable, Optional, Sequence

from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS
from ...serialization.state_fields import StateOwner
from .expiration import VISITED_SLICE_ENTRIES, StartExpirationQueue, remove_stale_entries
from .match_policies import NetworkOptions
from .match_types import PartialMatch
from .negation import RuledOutSweep

if TYPE_CHECKING:
    from ...prolog.machine.resource_limits import Meter

STALE_ARRIVALS_TOLERANCE = 1000
"""Stale entries in the list of arrivals of a rule that are tolerated in addition to twice the stored matches."""

_NO_SWEEP = 1 << 62
"""Sweep threshold of a rule without sweeps, which no number of matches exceeds."""

_MATCHES_PER_SWEEP_STEP = 250
"""Number of further stored matches after which a sweep visits its next slice."""


class MatchStore(StateOwner):
    """The stored matches of one rule.

    Attributes:
        meter: counts the pattern work of the rule; None if nothing is counted.
        clock: largest end of the events that its patterns matched.
        order: the largest order of the matches so far. Each stored match has a larger one, which is its end if the
            end is larger. Then both are one object.
        stored_match_count: number of matches that are stored in buffers and run groups.
        arrivals: these, oldest first, together with stale entries. Never assigned again, because generated code
            binds it.
        dropped_count: number of matches that were dropped because there were too many.
        expiration_queue: stored matches by expiration.
        sweep_threshold: number of stored matches above which `remove_excess` continues to remove matches that are
            ruled out.
        blocking_match: the negated match that made the last test of a node fail; None if another test failed.
        tracks_stored: whether `track_stored` is called for each match that is stored.
    """

    def __init__(self, max_stored: int):
        self.meter: Optional[Meter] = None
        self.max_stored = max_stored
        self.clock: int = BEFORE_ALL_INSTANTS
        self.order = 0
        self.stored_match_count = 0
        self.arrivals: Deque[PartialMatch] = deque()
        self.dropped_count = 0
        self.expiration_queue = StartExpirationQueue(None)
        self.sweep_threshold = _NO_SWEEP
        self.options = NetworkOptions()
        self.blocking_match: Optional[PartialMatch] = None
        self.tracks_stored = False
        self._next_slice_start = 0
        self._is_sweeping = False
        self._sweeps: Sequence[RuledOutSweep] = ()
        self._has_unvisited_matches = False

    def track_stored(self, match: PartialMatch, retention: Optional[int]) -> None:
        """Record a match that was stored, for expiration, lineage and after-match skip."""
        raise NotImplementedError

    def report_dropped(self, match: PartialMatch, is_negated: bool) -> None:
        """Report that a match was dropped, which may belong to a negated pattern."""
        raise NotImplementedError

    def set_sweeps(self, sweeps: Sequence[RuledOutSweep]) -> None:
        """Set the sweeps that remove matches which are ruled out."""
        self._sweeps = sweeps
        self._end_sweep()

    @property
    def sweeps_ruled_out(self) -> bool:
        """True if matches that are ruled out are removed; see `RuledOutSweep`."""
        return bool(self._sweeps)

    @property
    def last_order(self) -> int:
        """The largest order as a plain integer; it may be an instant of another class."""
        return int(self.order)

    @last_order.setter
    def last_order(self, order: int) -> None:
        self.order = order

    def count_stored(self, match: PartialMatch, retention: Optional[int]) -> None:
        """Count a match that has been stored; if there are too many, drop the oldest."""
        self.stored_match_count += 1
        arrivals = self.arrivals
        arrivals.append(match)
        # Most rules need none of this: no expiration, no tracking, no skip strategy.
        if self.tracks_stored:
            self.track_stored(match, retention)
        stored_count = self.stored_match_count
        if (
            stored_count > self.sweep_threshold
            or stored_count > self.max_stored
            or len(arrivals) > 2 * stored_count + STALE_ARRIVALS_TOLERANCE
        ):
            self.remove_excess()

    def remove_excess(self) -> None:
        """Drop the oldest match if there are too many; remove stale entries if they are the larger part."""
        max_entries = 2 * self.stored_match_count + STALE_ARRIVALS_TOLERANCE
        if self.stored_match_count > self.sweep_threshold or (
            self._is_sweeping and len(self.arrivals) > max_entries
        ):
            self._sweep()
        elif len(self.arrivals) > max_entries:
            self._next_slice_start = remove_stale_entries(self.arrivals, self._next_slice_start) or 0
            # Fewer matches are stored than at the last pass, so the next one begins earlier.
            if self._sweeps:
                self.sweep_threshold = min(
                    self.sweep_threshold, 2 * (self.stored_match_count + STALE_ARRIVALS_TOLERANCE)
                )
        if self.stored_match_count > self.max_stored:
            self._drop_oldest()
        if len(self.expiration_queue) > max_entries:
            self.expiration_queue.remove_stale(self.stored_match_count)

    def _sweep(self) -> None:
        """Remove some of the matches that are ruled out; see `RuledOutSweep`.

        A pass visits the stored matches slice by slice, then removes negated matches in slices. The next pass begins
        when twice as many matches are stored, so each match is visited a constant number of times on average.
        """
        if not self._is_sweeping:
            self._is_sweeping = self._has_unvisited_matches = True
            self._next_slice_start = 0
            for sweep in self._sweeps:
                sweep.begin_pass(self.order)
        # First operands are visited completely before any negated match is removed; see `RuledOutSweep.begin_pass`.
        if self._has_unvisited_matches:
            next_start = remove_stale_entries(self.arrivals, self._next_slice_start, self._visit_match)
            self._has_unvisited_matches = next_start is not None
            self._next_slice_start = next_start or 0
        if not self._has_unvisited_matches and all(
            sweep.drop_negated(VISITED_SLICE_ENTRIES) for sweep in self._sweeps
        ):
            self._end_sweep()
        else:
            self.sweep_threshold = self.stored_match_count + _MATCHES_PER_SWEEP_STEP

    def _visit_match(self, match: PartialMatch) -> None:
        for sweep in self._sweeps:
            sweep.visit_match(match)

    def _end_sweep(self) -> None:
        """End the current pass, if any, and set the number of matches at which the next one begins."""
        self._is_sweeping = self._has_unvisited_matches = False
        for sweep in self._sweeps:
            sweep.begin_pass(self.order)
        self.sweep_threshold = (
            2 * (self.stored_match_count + STALE_ARRIVALS_TOLERANCE) if self._sweeps else _NO_SWEEP
        )

    def reset_arrivals(self, stored_matches: Iterable[PartialMatch]) -> None:
        """Replace the arrivals, oldest first."""
        self.arrivals.clear()
        self.arrivals.extend(stored_matches)
        self._end_sweep()

    def _drop_oldest(self) -> None:
        """Drop the oldest matches until the limit is met; visit at most one slice of entries."""
        arrivals, max_stored = self.arrivals, self.max_stored
        max_visits = min(VISITED_SLICE_ENTRIES, len(arrivals))
        for _ in range(max_visits):
            oldest = arrivals.popleft()
            # The slice of `remove_stale_entries` begins at this position, which moves with the first entry.
            if self._next_slice_start:
                self._next_slice_start -= 1
            if oldest.buffer is not None:
                is_negated = oldest.buffer.is_negated
                oldest.discard()
                self.dropped_count += 1
                self.report_dropped(oldest, is_negated)
                if self.stored_match_count <= max_stored:
                    return
