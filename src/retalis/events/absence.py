"""What must not have happened: negated matches, kept so that one look tells whether one is in the way."""

from typing import Any, Callable, Optional, Sequence, Tuple

from ..terms import Term
from .matches import Bucket, Match, Place, unify_sides
from .policy import Frame

Values = Tuple[Term, ...]


class Absence:
    """The matches of a negated pattern, by the variables that it shares with what it negates.

    Asked for a gap ``(e1, s2)``: is there a match with ``e1 < start`` and ``end < s2``?  With ``ever`` the
    gap is open to the left: does one end before ``s2``?

    Args:
        rule: the rule that owns it.
        shared: pairs of positions of the shared variables: in the values of the negated match, and in those
            that are asked for.
        ever: whether any time before counts.
        condition: tests the two together, where the negated pattern has conditions about the others; it takes
            the values asked for and those of the negated match.
    """

    def __init__(
        self,
        rule: Any,
        shared: Sequence[Tuple[int, int]],
        ever: bool,
        condition: Optional[Callable[[Values, Match], bool]] = None,
    ):
        self.rule = rule
        self.shared = tuple(shared)
        self.ever = ever
        self.condition = condition
        self.place = Place(rule, tuple(one for one, _ in self.shared))
        self.asked = Place(rule, tuple(two for _, two in self.shared))

    def arrive(self, match: Match, after: Frame) -> Frame:
        """Keep a negated match, unless an older one is in the way of all that it could be in the way of."""
        key = self.place.key_of(match)
        if key is not None and self.condition is None and not self.rule.network.mode.tracked:
            bucket = self.place.buckets.get(key)
            if bucket is not None and not self._makes_room(bucket, match):
                return after
        self.place.add(match, key)
        return after

    def _makes_room(self, bucket: Bucket, match: Match) -> bool:
        """Remove what ``match`` makes superfluous; returns False where it is superfluous itself.

        What is kept rises in start and in end together.
        """
        start, end = match.start, match.end
        if self.ever:
            older = bucket.items[bucket.head]
            if older.end <= end:
                return False
            older.leave()
            return True
        for other in bucket.newest_first():
            if other.start >= start and other.end <= end:
                return False
            if other.start <= start and other.end >= end:
                other.leave()
            elif other.end < start:
                break
        return True

    def blocks(self, values: Values, after: int, before: int) -> bool:
        """Tell whether a negated match lies between two instants."""
        place = self.place
        if not place.buckets and not place.loose.live:
            return False
        asked = Match(values, after, before, None, None, ())
        key = self.asked.key_of(asked)
        ever = self.ever
        condition = self.condition
        for match in place.candidates(key):
            if match.end < before and (ever or after < match.start):
                if (key is None or match.bucket.key is None) and unify_sides(
                    match, asked, self.shared
                ) is None:
                    continue
                if condition is None or condition(values, match):
                    self.rule.network.tracker.blocker = match
                    return True
        return False
