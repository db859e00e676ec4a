"""Absence: the matches of a negated pattern, indexed so that one look-up finds one between two instants.

In a sequence without a window, first sides that a negated match has ruled out, and the negated matches, would
accumulate without bound: a `RuledOutSweep` drops the oldest of them.
"""

from bisect import bisect_left, bisect_right
from collections import deque
from typing import TYPE_CHECKING, Callable, Deque, Dict, Hashable, List, Optional, Sequence, Tuple

from ...prolog.terms.types import Frame, Values
from .interval_index import BEFORE, BETWEEN, LEAST, MOST
from .match_buffer import MatchBuffer, key_function, surely_same
from .partial_matches import NetworkOptions, PartialMatch, unify_sides

if TYPE_CHECKING:
    from ..network.event_rule import EventRule
    from ..network.pattern_nodes import NetworkNode


_SPARE = 1000

MAX_RULED_OUT = 1000
"""First sides of one sequence that are ruled out and stay, and negated matches that stay; see `RuledOutSweep`."""


class _Frontier:
    """The matches of one key of which each is in the way of something that no other is in the way of.

    They rise in start and in end together, so the first that starts after an instant ends first of all that do.
    Matches that have left the buffer are removed when the number of entries has doubled.
    """

    __slots__ = ("starts", "ends", "matches", "compact_at")

    def __init__(self) -> None:
        self.starts: List[int] = []
        self.ends: List[int] = []
        self.matches: List[PartialMatch] = []
        self.compact_at = _SPARE

    def takes(self, match: PartialMatch) -> bool:
        """Add a match and remove what it makes superfluous; returns False where it is superfluous itself."""
        starts, ends, matches = self.starts, self.ends, self.matches
        start, end = match.start, match.end
        at = bisect_left(starts, start)
        while at < len(ends) and ends[at] <= end:
            if matches[at].buffer is not None:
                return False
            del starts[at], ends[at], matches[at]
        last = at + 1 if at < len(starts) and starts[at] == start else at
        first = at
        while first and ends[first - 1] >= end:
            first -= 1
        superfluous = matches[first:last]
        starts[first:last] = [start]
        ends[first:last] = [end]
        matches[first:last] = [match]
        for other in superfluous:
            other.leave()
        return True

    def compact(self) -> None:
        """Remove the matches that have left the buffer if there are many entries."""
        if len(self.matches) <= self.compact_at:
            return
        self.matches = [match for match in self.matches if match.buffer is not None]
        self.starts = [match.start for match in self.matches]
        self.ends = [match.end for match in self.matches]
        self.compact_at = 2 * len(self.matches) + _SPARE

    def between(self, after: int, before: int) -> Optional[PartialMatch]:
        """Return a match that lies between two instants, or None."""
        at = bisect_right(self.starts, after)
        while at < len(self.ends) and self.ends[at] < before:
            if self.matches[at].buffer is not None:
                return self.matches[at]
            del self.starts[at], self.ends[at], self.matches[at]  # it has left: too old, or one too many
        return None


class NegationBuffer:
    """The matches of a negated pattern, by the variables that it shares with what it negates.

    Asked for a gap ``(e1, s2)``: is there a match with ``e1 < start`` and ``end < s2``?  With ``ever`` the
    gap is open to the left: does one end before ``s2``?

    Args:
        rule: the rule that owns it.
        shared: pairs of positions of the shared variables: in the values of the negated match, and in those
            that are asked for.
        ever: whether any time before counts.

    Attributes:
        condition: tests the two together, where the negated pattern has conditions about the others; it takes
            the values asked for and the negated match.
        carried: the absences among those conditions, with the nodes of what they negate.
        borders: by key, the matches that are in the way of something that no other is in the way of.
    """

    def __init__(self, rule: "EventRule", shared: Sequence[Tuple[int, int]], ever: bool):
        self.rule = rule
        self.shared = tuple(shared)
        self.ever = ever
        self.condition: Optional[Callable[[Values, PartialMatch], bool]] = None
        self.carried: List[Tuple[NegationBuffer, NetworkNode]] = []
        self.buffer = MatchBuffer(rule, tuple(one for one, _ in self.shared))
        self.buffer.reach = BEFORE if ever else BETWEEN
        self.buffer.forbids = True
        self.asked = MatchBuffer(rule, tuple(two for _, two in self.shared))
        self.borders: Dict[Hashable, _Frontier] = {}
        self.buffer.on_mend = self._forget_borders

    def _forget_borders(self) -> None:
        """Have the borders made anew when they are asked for."""
        self.borders = {}

    def bind(self, negated: "NetworkNode", mode: NetworkOptions) -> None:
        """Take what a node finds, and have the absences among the conditions take theirs."""
        negated.bind(self.arrive, mode)
        self.bind_carried(mode)

    def bind_carried(self, mode: NetworkOptions) -> None:
        """Have the absences among the conditions take what is found for them."""
        for absence, node in self.carried:
            absence.bind(node, mode)

    def buffers(self) -> List[MatchBuffer]:
        """Return where negated matches wait, its own and those among its conditions."""
        return [self.buffer, *(buffer for absence, _ in self.carried for buffer in absence.buffers())]

    def arrive(self, match: PartialMatch, after: Frame) -> Frame:
        """Keep a negated match, unless others are in the way of all that it could be in the way of."""
        key = self.buffer.key_of(match)
        if key is not None and self.has_borders() and not self._needed(key, match):
            return after
        self.buffer.add(match, key)
        return after

    def has_borders(self) -> bool:
        """Tell whether only times matter: not where matches are tested one by one, or may be taken back."""
        return self.condition is None and not self.rule.network.mode.tracked

    def _needed(self, key: Hashable, match: PartialMatch) -> bool:
        waiting = self.buffer.newest.get(key)
        if self.ever:
            if waiting is None:
                return True
            older = waiting.newer
            if older.end <= match.end:
                return False
            older.leave()
            return True
        border = self._border(key)
        border.compact()  # before the match is added, which is in no buffer yet
        return border.takes(match)

    def _border(self, key: Hashable) -> _Frontier:
        border = self.borders.get(key)
        if border is None or key not in self.buffer.newest:
            border = self.borders[key] = _Frontier()
            for other in self.buffer.with_key(key):
                border.takes(other)
            self._drop_empty_borders()
        return border

    def rules_out(self, key: Hashable, end: int) -> bool:
        """Return whether a negated match under a key starts after an instant; with open values it does not count."""
        last = self.buffer.newest.get(key)
        if last is None:
            return False
        if last.older is last:
            return last.start > end
        return self._border(key).between(end, MOST) is not None

    def least_end(self, before: int) -> int:
        """Return the end from which a first side is not ruled out for a second one that starts at an instant.

        Only for an absence that shares no variables and has borders.
        """
        last = self.buffer.newest.get(())
        if last is None:
            return LEAST
        if last.older is last:
            return last.start if last.end < before else LEAST
        border = self._border(())
        at = bisect_left(border.ends, before) - 1
        while at >= 0 and border.matches[at].buffer is None:
            at -= 1
        return border.starts[at] if at >= 0 else LEAST

    def _drop_empty_borders(self) -> None:
        """Forget keys under which nothing waits any more, and that nobody has asked for since, when they are many."""
        newest = self.buffer.newest
        if len(self.borders) > 2 * len(newest) + _SPARE:
            self.borders = {key: border for key, border in self.borders.items() if key in newest}

    def blocks(self, values: Values, after: int, before: int) -> bool:
        """Tell whether a negated match lies between two instants."""
        buffer = self.buffer
        if not buffer.newest:
            self.borders.clear()
            return False
        try:
            key = self.asked.key(values)
        except ValueError:
            key = None
        if key is not None and not self.ever and None not in buffer.newest and self.has_borders():
            last = buffer.newest.get(key)
            if last is None:
                self.borders.pop(key, None)
                return False
            if last.older is last:
                return after < last.start and last.end < before
            border = self.borders.get(key)
            if border is not None:
                return border.between(after, before) is not None
        return self._search(key, values, after, before)

    def _search(self, key: Hashable, values: Values, after: int, before: int) -> bool:
        """Look at all negated matches that may share the values."""
        asked = PartialMatch(values, after, before, None, None, ())
        condition = self.condition
        meter = self.rule.meter
        for match in self.buffer.partners(key, after, before, False):
            if meter is not None and meter(1):
                return True  # the search has to stop: what may be ruled out does not begin to wait
            if match.end < before and (self.ever or after < match.start):
                met, of = match, values
                if not surely_same(key, match):
                    sides = unify_sides(match, asked, self.shared)
                    if sides is None:
                        continue
                    met, of = sides[0], sides[1].values
                if condition is None or condition(of, met):
                    self.rule.network.tracker.blocker = match
                    return True
        return False


class RuledOutSweep:
    """Drops first sides that are ruled out, and the negated matches that ruled them out, when there are many.

    A negated match R rules out each first side P that ended before R started, for all second sides that start after R
    ended. If events come in order and no second side overlaps an R, that is all of them. For others, the newest
    `MAX_RULED_OUT` such P and as many R stay. An R leaves together with the waiting P that it rules out, so that no
    sequence matches that it prevents; only a P that arrives later, but ended before R started, misses it.

    A pass over all that waits is made in slices: it never takes long at once.

    Args:
        waiting: where the first sides wait.
        absence: the negated matches; they share variables with first sides only, and have no conditions.
        positions: of the shared variables in the values of a first side.
    """

    def __init__(self, waiting: MatchBuffer, absence: NegationBuffer, positions: Sequence[int]):
        self.waiting = waiting
        self.absence = absence
        self._key = key_function(tuple(positions))
        self._ruled_out: Deque[PartialMatch] = deque()
        self._negated: Deque[PartialMatch] = deque()
        self._first_open_end = MOST
        self._last = LEAST

    def begin(self, last: int) -> None:
        """Begin a pass; ``last`` is the order of the last match so far.

        Negated matches that come later are left to the next pass: this one may have visited what they rule out.
        """
        self._last = last
        self._ruled_out.clear()
        self._negated.clear()
        self._first_open_end = MOST

    def visit(self, match: PartialMatch) -> None:
        """Take the next match of the rule, in the order of arrival."""
        if match.buffer is self.absence.buffer:
            if match.key is not None and match.order <= self._last:
                self._negated.append(match)
        elif match.buffer is self.waiting and self._is_ruled_out(match):
            self._ruled_out.append(match)
            if len(self._ruled_out) > MAX_RULED_OUT:
                self._ruled_out.popleft().leave()

    def _is_ruled_out(self, match: PartialMatch) -> bool:
        try:
            return self.absence.rules_out(self._key(match.values), match.end)
        except ValueError:
            # Only unification tells which negated matches rule out one with open values. It stays, and so do they.
            self._first_open_end = min(self._first_open_end, match.end)
            return False

    def drop_negated(self, most: int) -> bool:
        """Drop up to so many of the negated matches that are too many; returns whether all of these have gone."""
        negated = self._negated
        going: List[PartialMatch] = []
        while len(negated) > MAX_RULED_OUT and len(going) < most:
            match = negated.popleft()
            if match.buffer is not None and match.start <= self._first_open_end:
                going.append(match)
        latest: Dict[Hashable, int] = {}
        for match in going:
            latest[match.key] = max(match.start, latest.get(match.key, match.start))
        if going:
            for match in self._ruled_out:
                if match.buffer is not None and latest.get(self._key(match.values), match.end) > match.end:
                    match.leave()
        for match in going:
            match.leave()
        return len(negated) <= MAX_RULED_OUT
