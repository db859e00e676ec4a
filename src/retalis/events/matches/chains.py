"""What a sequence of repetitions is made of: pieces of lists that many sequences have in common."""

from typing import Any, List, Tuple

from .matches import Match, Parts, Repetitions, identity

_MASK = (1 << 61) - 1


class Log:
    """Repetitions in their order; it only grows, so that pieces of it stay what they are."""

    __slots__ = ("items", "_sums")

    def __init__(self, items: List[Match]):
        self.items = items
        self._sums = [0]

    def begin_again(self) -> None:
        """Know no sums, of repetitions that were put in by somebody else."""
        self._sums = [0]

    def sum_to(self, end: int) -> int:
        """Return a number that depends on the first ``end`` repetitions; looked for once for each."""
        sums = self._sums
        while len(sums) <= end:
            sums.append((sums[-1] + hash(identity(self.items[len(sums) - 1]))) & _MASK)
        return sums[end]


Piece = Tuple[Log, int, int]
"""A log, and from where to where."""


class Chain(Repetitions):
    """The repetitions that a match is made of, oldest first.

    Two are equal if they are made of identical event terms; to make or hash one takes no longer where it is long.
    """

    __slots__ = ("pieces", "length")

    def __init__(self, pieces: Tuple[Piece, ...]):
        self.pieces = pieces
        self.length = sum(end - begin for _, begin, end in pieces)

    @property
    def matches(self) -> List[Match]:
        """The repetitions."""
        return [one for log, begin, end in self.pieces for one in log.items[begin:end]]

    def __hash__(self) -> int:
        total = sum(log.sum_to(end) - log.sum_to(begin) for log, begin, end in self.pieces)
        return hash((self.length, total & _MASK))

    def __eq__(self, other: Any) -> bool:
        if self is other:
            return True
        if other.__class__ is not Chain or self.length != other.length or hash(self) != hash(other):
            return False
        pairs = zip(self.matches, other.matches)
        return all(one is two or identity(one) == identity(two) for one, two in pairs)


def repetitions(match: Match, times: int) -> List[Match]:
    """Return the repetitions that a match of so many of them is made of, oldest first."""
    found: List[Match] = []
    while times > 1:
        parts: Any = match.parts
        if parts[0].__class__ is Chain:
            return [*parts[0].matches, *reversed(found)]
        match, last = parts
        found.append(last)
        times -= 1
    return [match, *reversed(found)]


def joined_one_by_one(match: Match, times: int) -> None:
    """Give a match of so many repetitions the parts that nodes of `seq` give it."""
    first, *others, last = repetitions(match, times)
    for one in others:
        first = Match((), first.start, one.end, None, None, (first, one))
    _set_parts(match, (first, last))


def joined_at_once(match: Match, times: int) -> None:
    """Give a match of so many repetitions the parts that it has where sequences go on together."""
    _set_parts(match, (Chain(pieces_of(match, times)),))


def _set_parts(match: Match, parts: Parts) -> None:
    match.parts = parts
    match.identity = None


def pieces_of(match: Match, times: int) -> Tuple[Piece, ...]:
    """Return what a match of so many repetitions is made of."""
    parts: Any = match.parts
    if times > 1 and parts[0].__class__ is Chain:
        return parts[0].pieces
    return ((Log(repetitions(match, times)), 0, times),)
