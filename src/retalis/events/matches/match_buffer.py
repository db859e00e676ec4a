"""Where matches wait for partners: by the values they share, in order of arrival and, where that helps, by time."""

import heapq
from typing import TYPE_CHECKING, Callable, Dict, Hashable, Iterator, List, Optional, Sequence, Set, Tuple

from ...prolog.terms.term_traversal import PLAIN, freeze
from ...prolog.terms.types import Values
from .interval_index import LEAST, MOST, IntervalBounds, IntervalIndex, TimeBounds
from .partial_matches import PartialMatch

if TYPE_CHECKING:
    from ..network.event_rule import EventRule


FEW, FEWER = 32, 4
"""How many matches at the wrong time are passed over before an index is made; before one that there is is used."""
_LISTED_IN_A_STEP = 16
"""Partners that are listed in the time in which a step of pattern work takes one."""
_ANY: TimeBounds = (LEAST, MOST, LEAST, MOST)


class MatchBuffer:
    """Where the matches of one operand wait for partners, found by the values of the variables they share.

    Those with the same key are a ring in order of arrival: each knows the next older one, and the oldest the newest.

    Attributes:
        rule: the rule that owns it; it counts and bounds what waits.
        newest: by key, the newest match; under None is what has variables in its shared values, and is unified
            with every partner.
        span: how many nanoseconds a match that waits here can be a part of; None for no bound.
        name: what a match and the one that it replaces have in common; None where none replaces another.
        reach: where in time those lie that a partner looks for here; None for anywhere.
        least_end: returns the least end of those that fit a partner which starts at an instant; None for no bound.
        forbids: whether what waits is about what must not happen: no match skips it.
        indices: by key, those by time of keys under which some were looked for in vain.
        names: by key, those by their names, of keys with more than a few.
    """

    forbids = False

    def __init__(self, rule: "EventRule", shared: Tuple[int, ...]):
        self.rule = rule
        self.key = key_function(shared)
        self.newest: Dict[Hashable, PartialMatch] = {}
        self.span: Optional[int] = None
        self.name: Optional[Callable[[PartialMatch], Hashable]] = None
        self.reach: Optional[IntervalBounds] = None
        self.least_end: Optional[Callable[[int], int]] = None
        self.indices: Dict[Hashable, IntervalIndex] = {}
        self.names: Dict[Hashable, Dict[Hashable, PartialMatch]] = {}
        self.on_mend: Callable[[], None] = lambda: None

    def key_of(self, match: PartialMatch) -> Hashable:
        """Return the key of a match; None where a shared value has variables."""
        try:
            return self.key(match.values)
        except ValueError:
            return None

    def add(self, match: PartialMatch, key: Hashable) -> None:
        """Let a match wait."""
        rule = self.rule
        match.order = rule.order = rule.order + 1
        match.key = key
        last = self.newest.get(key)
        if last is None:
            if self.name is not None and match.parts is not None:  # those of longer matches share it
                match.identity = self.name(match)
            match.buffer = self
            match.older = match.newer = self.newest[key] = match
        else:
            self.join(match)
        rule.keep(match, self.span)

    def join(self, match: PartialMatch) -> None:
        """Let a match that has its key and order wait with others of that key."""
        key = match.key
        if self.name is not None:
            names = self.names.get(key)
            if names is None:
                older = self.namesake(match, key)
            else:
                match.identity = name = self.name(match)
                older = names.get(name)
            if older is not None:
                self.remove(older)
        match.buffer = self
        newest = self.newest
        last = newest.setdefault(key, match)
        if last is match:
            match.older = match.newer = match
        else:
            match.older = last
            match.newer = oldest = last.newer
            last.newer = oldest.older = newest[key] = match
            if self.indices and key in self.indices:
                self.indices[key].add(match)
                self._drop_if_idle(key)
            if self.names and key in self.names:
                self.names[key][match.identity] = match

    def remove(self, match: PartialMatch) -> None:
        """Take a match out that waits here."""
        match.buffer = None
        self.rule.waiting -= 1
        key = match.key
        older, newer = match.older, match.newer
        if older is match:
            match.older = match.newer = None  # type: ignore[assignment]  # asked only of one that waits
            del self.newest[key]
            self.indices.pop(key, None)
            self.names.pop(key, None)
            return
        older.newer = newer
        newer.older = older
        if self.newest[key] is match:
            self.newest[key] = older
        match.older = match.newer = None  # type: ignore[assignment]
        if self.indices and key in self.indices:
            self.indices[key].remove(match)
            self._drop_if_idle(key)
        if self.names and key in self.names and self.names[key].get(match.identity) is match:
            del self.names[key][match.identity]

    def mend(self) -> List[PartialMatch]:
        """Link anew what waits, whatever an interrupt has left half linked; return it, oldest first."""
        found = []
        for key, last in list(self.newest.items()):
            waiting = sorted((one for one in _linked(last) if one.buffer is self), key=_order)
            if not waiting:
                del self.newest[key]
                continue
            self._link(key, waiting)
            found += waiting
        self.indices = {}
        self.names = {}
        self.on_mend()
        return sorted(found, key=_order)

    def _link(self, key: Hashable, waiting: List[PartialMatch]) -> None:
        """Have matches, the oldest first, be all that wait under a key."""
        for older, newer in zip(waiting, [*waiting[1:], waiting[0]]):
            older.newer, newer.older = newer, older
        self.newest[key] = waiting[-1]

    def put_back(self, waiting: Sequence[PartialMatch]) -> None:
        """Have matches wait, whose `order` is set, in the empty buffer as they did in another one."""
        groups: Dict[Hashable, List[PartialMatch]] = {}
        for match in sorted(waiting, key=_order):
            match.buffer = self
            try:
                match.key = self.key(match.filed_by)
            except ValueError:
                match.key = None
            if self.name is not None:
                match.identity = self.name(match)
            groups.setdefault(match.key, []).append(match)
        for key, group in groups.items():
            self._link(key, group)

    def namesake(self, match: PartialMatch, key: Hashable) -> Optional[PartialMatch]:
        """Return the match that one with a key is to replace; those of one name have the same key."""
        assert self.name is not None
        match.identity = name = self.name(match)
        last = self.newest.get(key)
        if last is None:
            return None
        names = self.names.get(key)
        if names is None:
            one = last
            for _ in range(FEWER):
                if (one.identity or self._named(one)) == name:
                    return one
                one = one.older
                if one is last:
                    return None
            names = self.names[key] = {one.identity or self._named(one): one for one in self.with_key(key)}
        return names.get(name)

    def _named(self, match: PartialMatch) -> Hashable:
        """Give a match its name, which one that is alone under its key may not have yet; return it."""
        assert self.name is not None
        match.identity = name = self.name(match)
        return name

    def _drop_if_idle(self, key: Hashable) -> None:
        if self.indices[key].idle:
            del self.indices[key]

    def with_key(self, key: Hashable) -> List[PartialMatch]:
        """Return those that wait under a key, oldest first."""
        last = self.newest.get(key)
        if last is None:
            return []
        found = [last]
        match = last.older
        while match is not last:
            found.append(match)
            match = match.older
        found.reverse()
        return found

    def all(self) -> List[PartialMatch]:
        """Return all that wait, oldest first."""
        return sorted((match for key in self.newest for match in self.with_key(key)), key=_order)

    def partners(self, key: Hashable, start: int, end: int, newest: bool) -> Iterator[PartialMatch]:
        """Yield those that a match may fit: the newest or the oldest first.

        Matches may come and go meanwhile: what comes is not yielded, nor is what has gone.

        Args:
            key: the shared values of the match; None where they have variables.
            start: where it starts.
            end: where it ends.
            newest: whether the newest comes first, else the oldest.
        """
        if key is None:
            found = self.all()
            return reversed(found) if newest else iter(found)
        limits = _ANY if self.reach is None else self.reach.limits(start, end)
        if self.least_end is not None:
            limits = (*limits[:2], max(limits[2], self.least_end(start)), limits[3])
        if None not in self.newest:
            return self._within(key, limits, newest)
        both = self._within(key, limits, newest), self._within(None, limits, newest)
        return iter(heapq.merge(*both, key=_order, reverse=newest))

    def partners_now(self, key: Hashable, start: int, end: int) -> Sequence[PartialMatch]:
        """Return those that a match may fit, oldest first; see `partners`. After pattern work was stopped: none."""
        if key is not None and None not in self.newest:
            last = self.newest.get(key)
            if last is None:
                return ()
            if last.older is last:
                return (last,)
        meter = self.rule.meter
        if meter is None:
            return list(self.partners(key, start, end, False))
        if meter(0):
            return ()
        found = list(self.partners(key, start, end, False))
        # A nested dispatch makes such a list at each level before it takes the second partner of any.
        meter(len(found) // _LISTED_IN_A_STEP)
        return found

    def _within(self, key: Hashable, limits: TimeBounds, newest: bool) -> Iterator[PartialMatch]:
        """Yield those under a key that start and end within limits."""
        last = self.newest.get(key)
        if last is None:
            return
        least_start, most_start, least_end, most_end = limits
        final = last.order
        match = last if newest else last.newer
        order = MOST if newest else LEAST
        misses = -(FEWER if key in self.indices else FEW)
        while misses <= 0:
            if match.order >= order if newest else not order < match.order <= final:
                return  # all around the ring, or at what has come meanwhile
            order = match.order
            step = match.older if newest else match.newer
            if least_start <= match.start <= most_start and least_end <= match.end <= most_end:
                misses -= 1
                yield match
                if step.buffer is not self:
                    behind = self._behind(key, order, newest)
                    if behind is None:
                        return
                    step = behind
            else:
                misses += 1
            match = step
        for match in self._index(key).search(limits, newest, order):
            if match.order > final:
                return
            if match.buffer is self:
                yield match

    def _index(self, key: Hashable) -> IntervalIndex:
        found = self.indices.get(key)
        if found is None:
            by_end = self.reach is not None and self.reach.by_end
            found = self.indices[key] = IntervalIndex(self.with_key(key), by_end)
        return found

    def _behind(self, key: Hashable, order: int, newest: bool) -> Optional[PartialMatch]:
        """Return the next match under a key after one of an order, which may have gone."""
        for match in reversed(self.with_key(key)) if newest else self.with_key(key):
            if match.order < order if newest else match.order > order:
                return match
        return None

    def identify(self, name: Optional[Callable[[PartialMatch], Hashable]]) -> None:
        """Have a match replace a waiting one of the same ``name``, or none with None.

        Of those that wait already under one name, the newest can be replaced.
        """
        self.name = name
        self.names = {}
        if name is not None:
            for match in self.all():
                match.identity = name(match)


def _linked(match: PartialMatch) -> Set[PartialMatch]:
    """Return a match and all that can be reached from it by either link."""
    found = {match}
    stack = [match]
    while stack:
        one = stack.pop()
        for other in (getattr(one, "older", None), getattr(one, "newer", None)):
            if other is not None and other not in found:
                found.add(other)
                stack.append(other)
    return found


def _order(match: PartialMatch) -> int:
    return match.order


def surely_same(key: Hashable, partner: PartialMatch) -> bool:
    """Tell whether the shared values of one of `MatchBuffer.partners` are those of the key that it was found by."""
    return key is not None and partner.buffer is not None and partner.key is not None


def key_function(positions: Tuple[int, ...]) -> Callable[[Values], Hashable]:
    """Return a function from values to the key of those at ``positions``; it raises ValueError for variables.

    The key is never None.
    """
    if not positions:
        return lambda values: ()
    if len(positions) > 1:
        return lambda values: tuple([freeze(values[at]) for at in positions])
    at = positions[0]

    def key(values: Values) -> Hashable:
        value = values[at]
        return value if value.__class__ in PLAIN else freeze(value)

    return key
