"""What a revision has set free, or what is computed again: it meets those that it could have met in their order.

Where a sequence takes its sides only in their order, its second sides do not wait. They are kept where events may be
taken back and a first side may come of that: it takes, of those that came after it, the first that is left.
"""

from collections import deque
from typing import TYPE_CHECKING, Deque, Hashable, Iterable, List, Optional

from ...prolog.terms.types import Frame
from .consumption_policy import Emit, Join, MatchSide, counted, emit_each, join_any
from .match_buffer import MatchBuffer
from .partial_matches import PartialMatch, arrival, sources

if TYPE_CHECKING:
    from ..provenance.lineage import LineageTracker


KEPT = 10_000
"""How many second sides are kept in one buffer."""


def stands(match: Optional[PartialMatch]) -> bool:
    """Tell whether there is a match, and none of its events was taken back."""
    return match is not None and not any(getattr(token, "gone", False) for token in sources(match))


class RetainedMatches:
    """Keeps second sides in a buffer; with too many of them the oldest goes."""

    def __init__(self, buffer: MatchBuffer):
        self.buffer = buffer
        self._kept: Deque[PartialMatch] = deque()

    def kept(self) -> List[PartialMatch]:
        """Return those that are kept, the oldest first; see `restore`."""
        return [match for match in self._kept if match.buffer is not None]

    def restore(self, kept: List[PartialMatch]) -> None:
        """Keep those that were kept; they wait in the buffer already."""
        self._kept = deque(kept)

    def add(self, match: PartialMatch, key: Hashable) -> None:
        """Keep one; see `MatchBuffer.add`."""
        self.buffer.add(match, key)
        self._kept.append(match)
        if len(self._kept) > min(KEPT, self.buffer.rule.network.cap // 2):
            self._kept.popleft().leave()


def after_all(tracker: "LineageTracker", came: int) -> bool:
    """Tell whether what came then is not a part of the event that is served: it is there after all, by a revision."""
    return came < tracker.present()


def first_side(tracker: "LineageTracker", side: MatchSide, uses: bool, all_too: bool, emit: Emit) -> Emit:
    """Return what a first side does: it waits; set free by a revision, it takes what has come since.

    Args:
        tracker: knows when events came.
        side: the first side, as one sees it that looks for partners.
        uses: whether the policy uses partners up.
        all_too: whether a second side takes all that wait, and is not used up by them.
        emit: where results go.
    """
    own, other = side.own, side.other

    def arrive(match: PartialMatch, after: Frame) -> Frame:
        key = own.key_of(match)
        came = arrival(match)
        results: List[PartialMatch] = []
        if after_all(tracker, came):
            for partner in counted(other.partners_now(key, match.start, match.end), own.rule.meter):
                if arrival(partner) <= came or (uses and not all_too and stands(partner.used)):
                    continue
                result = join_any(side, match, key, partner)
                if result is not None:
                    results.append(result)
                    if uses:
                        partner.used = match
                    if uses or all_too:
                        break
        if not results or not (uses or all_too):
            own.add(match, key)
        return emit_each(iter(results), emit, after)

    return arrive


def in_order(tracker: "LineageTracker", join: Join) -> Join:
    """Return a join of a second side and a first one, for second sides that may be there after all.

    These take what had come before them only.
    """

    def joined(match: PartialMatch, partner: PartialMatch) -> Optional[PartialMatch]:
        came = arrival(match)
        if after_all(tracker, came) and arrival(partner) >= came:
            return None
        return join(match, partner)

    return joined


def that_came_before(
    match: PartialMatch, others: Iterable[PartialMatch], tracker: "LineageTracker"
) -> Iterable[PartialMatch]:
    """Return those of others that a match may meet: all, unless it is there after all, by a revision."""
    came = arrival(match)
    return [one for one in others if arrival(one) < came] if after_all(tracker, came) else others
