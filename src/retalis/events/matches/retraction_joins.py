"""Revision: join partners of matches that arise or become valid because an event is retracted.

If an event is retracted, matches that a negation had prevented may arise, and results of runs are computed again.
Such a *revived* match arrives later than its events did. It must join exactly the partners that it would have joined
if the retracted event had never existed.

In a sequence with events in order, a second operand is not stored, because no first operand arrives after it. If
first operands can be revived, `RetainedMatches` keeps a bounded number of second operands for them. A revived first
operand joins the first of those that arrived after it and is still valid; a revived second operand joins only first
operands that had arrived before it. The order of arrival is the number of the last event of a match, see
`arrival_number_of`.
"""

from collections import deque
from typing import TYPE_CHECKING, Deque, Hashable, Iterable, List, Optional

from ...prolog.terms.types import Frame
from .consumption_policy import Emit, Join, MatchSide, emit_each, metered, unify_and_join
from .match_buffer import MatchBuffer
from .partial_matches import PartialMatch, arrival_number_of, lineage_sources

if TYPE_CHECKING:
    from ..provenance.lineage import LineageTracker


MAX_RETAINED_MATCHES = 10_000
"""Maximum number of second operands that are retained in one buffer."""


def is_valid(match: Optional[PartialMatch]) -> bool:
    """Return whether there is a match and none of its events was retracted."""
    return match is not None and not any(
        getattr(token, "retracted", False) for token in lineage_sources(match)
    )


class RetainedMatches:
    """Second operands that are retained in a buffer; if there are too many, the oldest is removed."""

    def __init__(self, buffer: MatchBuffer):
        self.buffer = buffer
        self._retained: Deque[PartialMatch] = deque()

    def snapshot(self) -> List[PartialMatch]:
        """Return the retained matches, oldest first; see `restore`."""
        return [match for match in self._retained if match.buffer is not None]

    def restore(self, saved: List[PartialMatch]) -> None:
        """Set the retained matches; they are stored in the buffer already."""
        self._retained = deque(saved)

    def add(self, match: PartialMatch, key: Hashable) -> None:
        """Store and retain a match; see `MatchBuffer.add`."""
        self.buffer.add(match, key)
        self._retained.append(match)
        if len(self._retained) > min(MAX_RETAINED_MATCHES, self.buffer.rule.network.max_stored // 2):
            self._retained.popleft().discard()


def is_revived(tracker: "LineageTracker", arrival_number: int) -> bool:
    """Return whether a match that was complete at event ``arrival_number`` is revived.

    It lacks the event that is being served.
    """
    return arrival_number < tracker.current_number()


def join_revived_first(
    tracker: "LineageTracker", side: MatchSide, consumes: bool, joins_all: bool, emit: Emit
) -> Emit:
    """Return the action for a first operand: it is stored, or joins with later second operands if it is revived.

    Args:
        tracker: knows the number of the event that is being served.
        side: the first operand, with the buffer of the partners to search.
        consumes: whether the policy consumes partners.
        joins_all: whether a second operand joins with all stored first ones and is not consumed by them.
        emit: receives the results.
    """
    own_buffer, other_buffer = side.own_buffer, side.other_buffer

    def on_match(match: PartialMatch, frame: Frame) -> Frame:
        key = own_buffer.key_of(match)
        arrival_number = arrival_number_of(match)
        results: List[PartialMatch] = []
        if is_revived(tracker, arrival_number):
            for partner in metered(
                other_buffer.partner_list(key, match.start, match.end), own_buffer.rule.meter
            ):
                # Only partners that arrived later and were not consumed by a match that is still valid would have
                # been available.
                if arrival_number_of(partner) <= arrival_number or (
                    consumes and not joins_all and is_valid(partner.consumed_by)
                ):
                    continue
                result = unify_and_join(side, match, key, partner)
                if result is not None:
                    results.append(result)
                    if consumes:
                        partner.consumed_by = match
                    if consumes or joins_all:
                        break
        if not results or not (consumes or joins_all):
            own_buffer.add(match, key)
        return emit_each(iter(results), emit, frame)

    return on_match


def join_in_order(tracker: "LineageTracker", join: Join) -> Join:
    """Return a join of a second and a first operand for second operands that may be revived.

    A revived second operand joins only with first operands that arrived before it.
    """

    def join_if_earlier(match: PartialMatch, partner: PartialMatch) -> Optional[PartialMatch]:
        arrival_number = arrival_number_of(match)
        if is_revived(tracker, arrival_number) and arrival_number_of(partner) >= arrival_number:
            return None
        return join(match, partner)

    return join_if_earlier


def earlier_partners(
    match: PartialMatch, partners: Iterable[PartialMatch], tracker: "LineageTracker"
) -> Iterable[PartialMatch]:
    """Return the partners that a match may join: all, or the earlier ones if the match is revived."""
    arrival_number = arrival_number_of(match)
    return (
        [partner for partner in partners if arrival_number_of(partner) < arrival_number]
        if is_revived(tracker, arrival_number)
        else partners
    )
