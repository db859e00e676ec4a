"""Waiting sequences of repetitions that go on together: the next repetition is the next one of all of them."""

from collections import deque
from typing import Deque, Dict, Hashable, Iterator, List, Optional, Protocol, Tuple

from ...prolog.terms import Values
from .chains import Chain, Log, Piece, pieces_of
from .matches import Match
from .owners import Owner

_NEVER = -(1 << 80)


class Carrier(Protocol):
    """The node of sequences that go on together.

    Attributes:
        trains: the sequences, by their values.
        limit: for how many nanoseconds what waits is of use; None for no bound.
        forbids: whether they are about what must not happen.
    """

    trains: Dict[Hashable, "Train"]
    limit: Optional[int]
    forbids: bool

    @property
    def rule(self) -> Owner:
        """The rule it belongs to."""

    def values_of(self, token: "Token") -> Values:
        """Return the values of a sequence."""


class Token(Match):
    """A sequence that has not all of its repetitions yet, in a train.

    Attributes:
        first: what it began with in the train: its first repetition, or a match of some that waited apart.
        apart: of how many repetitions that is; 0 for its first one, which the train has too.
        log, at: where the repetitions stand that it took in the train.
        since: the number of the first of those.
    """

    __slots__ = ("first", "apart", "log", "at", "since")

    buffer: "Optional[Train]"

    def __init__(self, first: Match, apart: int, train: "Train"):
        super().__init__(first.values, first.start, first.end, None, None, (first,))
        self.first = first
        self.apart = apart
        self.log = train.log
        self.at = len(train.log.items)
        self.since = train.taken

    @property
    def latest(self) -> int:
        """Where it ends by now; see `Match.latest`."""
        return self.end if self.buffer is None else self.buffer.end


class Train:
    """Sequences with the same values of which each has another number of repetitions, all ending with the same one.

    Attributes:
        node: whose they are.
        key: their values.
        tokens: at ``number - 1`` the one with that number of repetitions; what has left, and None, are gaps.
        end: where they end.
        order: that of the shortest, if it were a match that began to wait; longer ones have one less each.
        log: the newest repetitions; the one before it is known by those that began with it.
        taken: how many repetitions there were.
    """

    __slots__ = ("node", "key", "tokens", "end", "order", "log", "taken", "alive")

    def __init__(self, node: Carrier, key: Hashable):
        self.node = node
        self.key = key
        self.tokens: Deque[Optional[Token]] = deque()
        self.end = _NEVER
        self.order = 0
        self.log = Log([])
        self.taken = 0
        self.alive = 0

    def begin_again(self) -> None:
        """Have the sequences that somebody else has put in go on."""
        self.tokens = deque(self.tokens)

    @property
    def span(self) -> Optional[int]:
        """For how many nanoseconds what waits is of use; None for no bound."""
        return self.node.limit

    @property
    def forbids(self) -> bool:
        """Whether they are about what must not happen."""
        return self.node.forbids

    def at(self, number: int) -> Optional[Token]:
        """Return the sequence with so many repetitions, if there is one."""
        if number > len(self.tokens):
            return None
        token = self.tokens[number - 1]
        return None if token is None or token.buffer is None else token

    def present(self) -> Iterator[Tuple[int, Token]]:
        """Yield all of them with their numbers of repetitions, the longest first."""
        for number in range(len(self.tokens), 0, -1):
            token = self.at(number)
            if token is not None:
                yield number, token

    def put(self, number: int, token: Token) -> None:
        """Have a sequence with so many repetitions go on in the train."""
        tokens = self.tokens
        while len(tokens) < number:
            tokens.append(None)
        tokens[number - 1] = token
        self._begin(token)

    def advance(self, match: Match, longest: int) -> Optional[Token]:
        """Have all take a repetition, and a sequence begin with it; return the one that has ``longest`` now."""
        tokens = self.tokens
        while tokens and (tokens[-1] is None or tokens[-1].buffer is None):
            tokens.pop()
        token = Token(match, 0, self)
        self.log.items.append(match)
        self.taken += 1
        self.end = match.end
        oldest = tokens.pop() if len(tokens) == longest - 1 else None
        tokens.appendleft(token)
        rule = self.node.rule
        rule.order += longest  # one for each that would have begun to wait, the longest first
        self.order = rule.order
        self._begin(token)
        return oldest

    def _begin(self, token: Token) -> None:
        token.buffer = self
        self.alive += 1
        rule = self.node.rule
        token.order = rule.order = rule.order + 1

    def renew(self, size: int) -> None:
        """Begin a new log where the old one has so many repetitions; no sequence reaches further back than it."""
        if len(self.log.items) >= size:
            self.log = Log([])

    def remove(self, token: Match) -> None:
        """Take a sequence out."""
        token.end = self.end
        token.buffer = None
        self.alive -= 1
        self.node.rule.waiting -= 1
        if not self.alive:
            self.node.trains.pop(self.key, None)

    def match_of(self, token: Token, number: int) -> Match:
        """Return a sequence with so many repetitions as a match of its own."""
        if number == 1:
            return token.first
        return Match(self.node.values_of(token), token.start, self.end, None, None, (self._chain(token),))

    def _chain(self, token: Token) -> Chain:
        before: Tuple[Piece, ...] = pieces_of(token.first, token.apart) if token.apart else ()
        log, last = token.log, self.log
        if log is last:
            return Chain((*before, (log, token.at, len(log.items))))
        return Chain((*before, (log, token.at, len(log.items)), (last, 0, len(last.items))))


class Moving:
    """Where the sequences of all trains of a node wait, as its rule sees it.

    Attributes:
        forbids: whether they are about what must not happen.
    """

    forbids = False

    def __init__(self, node: Carrier):
        self._node = node

    @property
    def span(self) -> Optional[int]:
        """For how many nanoseconds what waits is of use; None for no bound."""
        return self._node.limit

    def mend(self) -> List[Match]:
        """Return what waits, oldest first, whatever an interrupt has left half done."""
        found = []
        for key, train in list(self._node.trains.items()):
            here = [token for _, token in train.present()]
            train.alive = len(here)
            if not here:
                del self._node.trains[key]
            found += here
        return sorted(found, key=lambda token: token.order)
