"""Where matches wait for partners: by the values they share, in order of arrival and, where that helps, by time."""

import heapq
from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple

from ..terms import Atom, String, freeze
from .matches import Match, Values, identity
from .reach import Reach
from .timeindex import LEAST, MOST, Limits, TimeIndex

_FEW, _FEWER = 32, 4
"""How many matches at the wrong time are passed over before an index is made; before one that there is is used."""
_ANY: Limits = (LEAST, MOST, LEAST, MOST)
_PLAIN = frozenset((Atom, int, String))


class Bucket:
    """Waiting matches with the same values of the shared variables: a chain in order of arrival."""

    __slots__ = ("place", "key", "first", "last", "index")

    def __init__(self, place: "Place", key: Any):
        self.place = place
        self.key = key
        self.first: Optional[Match] = None
        self.last: Optional[Match] = None
        self.index: Optional[TimeIndex] = None

    def append(self, match: Match) -> None:
        """Let a match wait; it is the newest of all."""
        match.bucket = self
        match.newer = None
        last = match.older = self.last
        self.last = match
        if last is None:
            self.first = match
            return
        last.newer = match
        if self.index is not None:
            self.index.add(match)
            if self.index.idle:
                self.index = None

    def remove(self, match: Match) -> None:
        """Take a match out."""
        match.bucket = None
        older, newer = match.older, match.newer
        match.older = match.newer = None
        if older is None:
            self.first = newer
        else:
            older.newer = newer
        if newer is None:
            self.last = older
        else:
            newer.older = older
        place = self.place
        place.rule.waiting -= 1
        same = place.same
        if same is not None and same.get(match.identity) is match:
            del same[match.identity]
        if self.first is None:
            self.index = None
            if self.key is not None:
                del place.buckets[self.key]
        elif self.index is not None:
            self.index.remove(match)
            if self.index.idle:
                self.index = None

    def oldest_first(self) -> List[Match]:
        """Return all that wait, oldest first."""
        found = []
        match = self.first
        while match is not None:
            found.append(match)
            match = match.newer
        return found

    def within(self, limits: Limits, newest: bool) -> Iterator[Match]:
        """Yield those that start and end within limits, newest or oldest first.

        Matches may come and go meanwhile: what comes is not yielded, nor is what has gone.
        """
        least_start, most_start, least_end, most_end = limits
        match = self.last if newest else self.first
        misses = -(_FEW if self.index is None else _FEWER)
        final = MOST if self.last is None else self.last.order
        while match is not None and match.order <= final:
            order = match.order
            step = match.older if newest else match.newer
            if least_start <= match.start <= most_start and least_end <= match.end <= most_end:
                misses -= 1
                yield match
                if step is not None and step.bucket is not self:
                    step = self._behind(order, newest)
            else:
                misses += 1
                if misses > 0:
                    break
            match = step
        else:
            return
        index = self.index
        if index is None:
            index = self.index = TimeIndex(self.oldest_first(), self.place.by_end)
        for match in index.search(limits, newest, order):
            if match.bucket is self and match.order <= final:
                yield match

    def _behind(self, order: int, newest: bool) -> Optional[Match]:
        """Return the next match behind the one of an order, which may have gone."""
        match = self.last if newest else self.first
        while match is not None and (match.order >= order if newest else match.order <= order):
            match = match.older if newest else match.newer
        return match


class Place:
    """Where the matches of one operand wait for partners, found by the values of the variables they share.

    Attributes:
        rule: the rule that owns it; it counts and bounds what waits.
        shared: where the shared variables stand among the values.
        buckets: by key, those whose shared values have no variables.
        loose: the others; they are unified with every partner.
        span: how many nanoseconds a match that waits here can be a part of; None for no bound.
        same: where a match replaces one of the same name: those that wait by name; else None.
        reach: where in time those lie that a partner looks for here; None for anywhere.
    """

    def __init__(self, rule: Any, shared: Tuple[int, ...]):
        self.rule = rule
        self.shared = shared
        self.key = key_function(shared)
        self.buckets: Dict[Any, Bucket] = {}
        self.loose = Bucket(self, None)
        self.span: Optional[int] = None
        self.same: Optional[Dict[Any, Match]] = None
        self.name: Callable[[Match], Any] = identity
        self.reach: Optional[Reach] = None

    @property
    def by_end(self) -> bool:
        """Whether it is the end by which those that wait are looked up first."""
        return self.reach is not None and self.reach.by_end

    def key_of(self, match: Match) -> Any:
        """Return the key of a match; None where a shared value has variables."""
        try:
            return self.key(match.values)
        except ValueError:
            return None

    def add(self, match: Match, key: Any) -> None:
        """Let a match wait."""
        rule = self.rule
        match.order = rule.order = rule.order + 1
        same = self.same
        if same is not None:
            match.identity = name = self.name(match)
            older = same.get(name)
            if older is not None:
                older.bucket.remove(older)
            same[name] = match
        bucket = self.loose if key is None else self.buckets.get(key)
        if bucket is None:
            bucket = self.buckets[key] = Bucket(self, key)
        bucket.append(match)
        rule.keep(match, self.span)

    def all(self) -> List[Match]:
        """Return all that wait, oldest first."""
        found = self.loose.oldest_first()
        for bucket in self.buckets.values():
            found += bucket.oldest_first()
        found.sort(key=_order)
        return found

    def partners(self, key: Any, start: int, end: int, newest: bool) -> Iterator[Match]:
        """Yield those that a match may fit: the newest or the oldest first.

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
        bucket = self.buckets.get(key)
        loose = self.loose
        if loose.first is None:
            return iter(()) if bucket is None else bucket.within(limits, newest)
        unbound = loose.within(limits, newest)
        if bucket is None:
            return unbound
        return heapq.merge(unbound, bucket.within(limits, newest), key=_order, reverse=newest)

    def identify(self, name: Optional[Callable[[Match], Any]]) -> None:
        """Have a match replace a waiting one of the same ``name``, or none with None.

        Of those that wait already under one name, the newest can be replaced.
        """
        if name is None:
            self.same = None
            return
        self.same = {}
        self.name = name
        for match in self.all():
            match.identity = name(match)
            self.same[match.identity] = match


def _order(match: Match) -> int:
    return match.order


def surely_same(key: Any, partner: Match) -> bool:
    """Tell whether the shared values of one of `Place.partners` are those of the key that it was found by."""
    return key is not None and partner.bucket is not None and partner.bucket.key is not None


def key_function(positions: Tuple[int, ...]) -> Callable[[Values], Any]:
    """Return a function from values to the key of those at ``positions``; it raises ValueError for variables.

    The key is never None.
    """
    if not positions:
        return lambda values: ()
    if len(positions) > 1:
        return lambda values: tuple([freeze(values[at]) for at in positions])
    at = positions[0]

    def key(values: Values) -> Any:
        value = values[at]
        return value if value.__class__ in _PLAIN else freeze(value)

    return key
