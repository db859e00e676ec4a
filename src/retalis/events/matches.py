"""Partial matches and the lists in which they wait for partners."""

from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Tuple

from ..terms import Term, Var, copy, freeze, resolve, undo, unify
from ._keys import term_key

Values = Tuple[Term, ...]


class Match:
    """What a node of a pattern has found.

    Attributes:
        values: the values of the node's variables.
        start: where the interval starts.
        end: where it ends.
        event: the token of the event, where the match is of one single event; else None.
        term: the event, where it is the match of an event pattern.
        parts: what else it was put together from: matches, `Held` and `Found`, and the number of a branch.
        bucket: where it waits; None while it does not wait (any more).
        order: the larger, the later it began to wait.
        used: whether it completed something and was used up by that.
    """

    __slots__ = ("values", "start", "end", "event", "term", "parts", "bucket", "order", "identity", "used")

    order: int
    identity: Any

    def __init__(self, values: Values, start: int, end: int, event: Any, term: Term, parts: Any):
        self.values = values
        self.start = start
        self.end = end
        self.event = event
        self.term = term
        self.parts = parts
        self.bucket: Any = None
        self.used = False

    def leave(self) -> None:
        """Take the match out of where it waits, if it does."""
        if self.bucket is not None:
            self.bucket.remove(self)


class Held(NamedTuple):
    """Matches that one was made of without being told apart by them: the repetitions of a run."""

    matches: Tuple["Match", ...]


class Found(NamedTuple):
    """Values that goals, repetitions and aggregates have given a match: they tell it from others."""

    values: Values


def identity(match: Match) -> Any:
    """Return a key: equal for two matches of a node made of identical event terms."""
    parts = match.parts
    if parts is None:
        return term_key(match.term)
    key = []
    for part in parts:
        if isinstance(part, Match):
            key.append(identity(part))
        elif part.__class__ is Found:
            key.append(tuple([term_key(value) for value in part.values]))
        elif part.__class__ is not Held:
            key.append(part)
    return key[0] if len(key) == 1 else tuple(key)


def leaves(match: Match) -> Iterator[Any]:
    """Yield the tokens of the events that a match was made of, in the order of the pattern."""
    stack = [match]
    while stack:
        part = stack.pop()
        if part.parts is None:
            yield part.event
        else:
            for inner in reversed(part.parts):
                if isinstance(inner, Match):
                    stack.append(inner)
                elif inner.__class__ is Held:
                    stack.extend(reversed(inner.matches))


def taken_back(match: Match) -> bool:
    """Tell whether an event of a match was taken back."""
    return any(getattr(token, "gone", False) for token in leaves(match))


class Bucket:
    """Waiting matches with the same values of the shared variables, oldest first."""

    __slots__ = ("place", "key", "items", "head", "live")

    def __init__(self, place: "Place", key: Any):
        self.place = place
        self.key = key
        self.items: List[Any] = []
        self.head = 0
        self.live = 0

    def remove(self, match: Match) -> None:
        """Take a match out."""
        match.bucket = None
        self.live -= 1
        place = self.place
        place.rule.waiting -= 1
        same = place.same
        if same is not None and same.get(match.identity) is match:
            del same[match.identity]
        if not self.live:
            self.items = []
            self.head = 0
            if self.key is not None:
                del place.buckets[self.key]
            return
        items = self.items
        if items[-1] is match:
            items.pop()
            while items[-1].bucket is not self:
                items.pop()
        elif items[self.head] is match:
            items[self.head] = None
            self.head += 1
            while items[self.head].bucket is not self:
                items[self.head] = None
                self.head += 1
        if len(items) > 2 * self.live + 32:
            self.items = [item for item in items[self.head :] if item.bucket is self]
            self.head = 0

    def oldest_first(self) -> List[Match]:
        """Return all that wait, oldest first."""
        return [item for item in self.items[self.head :] if item.bucket is self]

    def newest_first(self) -> List[Match]:
        """Return all that wait, newest first."""
        found = self.oldest_first()
        found.reverse()
        return found


class Place:
    """Where the matches of one operand wait for partners, found by the values of the variables they share.

    Attributes:
        rule: the rule that owns it; it counts and bounds what waits.
        shared: where the shared variables stand among the values.
        buckets: by key, those whose shared values have no variables.
        loose: the others; they are unified with every partner.
        span: how many nanoseconds a match that waits here can be a part of; None for no bound.
        same: where a match replaces one of the same name: those that wait by name; else None.
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

    def key_of(self, match: Match) -> Any:
        """Return the key of a match; None where a shared value has variables."""
        try:
            return self.key(match.values)
        except ValueError:
            return None

    def add(self, match: Match, key: Any) -> None:
        """Let a match wait."""
        rule = self.rule
        same = self.same
        if same is not None:
            match.identity = name = self.name(match)
            older = same.get(name)
            if older is not None:
                older.bucket.remove(older)
            same[name] = match
        if key is None:
            bucket = self.loose
        else:
            found = self.buckets.get(key)
            if found is None:
                bucket = self.buckets[key] = Bucket(self, key)
            else:
                bucket = found
        match.bucket = bucket
        bucket.items.append(match)
        bucket.live += 1
        rule.keep(match, self.span)

    def all(self) -> List[Match]:
        """Return all that wait, oldest first."""
        found = self.loose.oldest_first()
        for bucket in self.buckets.values():
            found += bucket.oldest_first()
        found.sort(key=_order)
        return found

    def candidates(self, key: Any) -> List[Match]:
        """Return those whose shared values may be those of ``key``, oldest first."""
        if key is None:
            return self.all()
        bucket = self.buckets.get(key)
        if not self.loose.live:
            return bucket.oldest_first() if bucket is not None else []
        found = self.loose.oldest_first()
        if bucket is not None:
            found += bucket.oldest_first()
            found.sort(key=_order)
        return found

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
    return match.order  # type: ignore[no-any-return]


def key_function(positions: Tuple[int, ...]) -> Callable[[Values], Any]:
    """Return a function from values to the key of those at ``positions``; it raises ValueError for variables.

    The key is never None.
    """
    if not positions:
        return lambda values: ()
    if len(positions) == 1:
        at = positions[0]
        return lambda values: freeze(values[at])
    return lambda values: tuple([freeze(values[at]) for at in positions])


def unify_sides(
    left: Match, right: Match, shared: Tuple[Tuple[int, int], ...]
) -> Optional[Tuple[Match, Match]]:
    """Unify shared values that have variables.

    Returns copies of the two sides with the values that follow, or None where they do not unify.
    """
    lefts = list(_renamed(left.values))
    rights = list(_renamed(right.values))
    trail: List[Any] = []
    result = None
    if all(unify(lefts[one], rights[other], trail) for one, other in shared):
        result = (_with(left, lefts), _with(right, rights))
    undo(trail, 0)
    return result


def _renamed(values: Values) -> Values:
    fresh: Dict[Var, Term] = {}
    return tuple([copy(value, fresh) for value in values])


def _with(match: Match, values: List[Term]) -> Match:
    return Match(
        tuple([resolve(value) for value in values]),
        match.start,
        match.end,
        match.event,
        match.term,
        match.parts,
    )
