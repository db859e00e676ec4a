"""What a sequence of repetitions is made of: pieces of lists that many sequences have in common.

Waiting sequences of repetitions that go on together: the next repetition is the next one of all of them.

A run of a repetition or aggregate: a first match, and what has extended it so far.
"""

from collections import deque
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Deque,
    Hashable,
    Iterator,
    List,
    Optional,
    Tuple,
)

from ...prolog.terms.types import NIL, Term, Values, Var
from .partial_matches import NOTHING_HELD, PartialMatch, Parts, Repetitions, identity

if TYPE_CHECKING:
    from ..network.repeat_node import RepeatNode


_MASK = (1 << 61) - 1


class SharedLog:
    """Repetitions in their order; it only grows, so that pieces of it stay what they are."""

    __slots__ = ("items", "_sums")

    def __init__(self, items: List[PartialMatch]):
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


Piece = Tuple[SharedLog, int, int]
"""A log, and from where to where."""


class BufferSlice(Repetitions):
    """The repetitions that a match is made of, oldest first.

    Two are equal if they are made of identical event terms; to make or hash one takes no longer where it is long.
    """

    __slots__ = ("pieces", "length")

    def __init__(self, pieces: Tuple[Piece, ...]):
        self.pieces = pieces
        self.length = sum(end - begin for _, begin, end in pieces)

    @property
    def matches(self) -> List[PartialMatch]:
        """The repetitions."""
        return [one for log, begin, end in self.pieces for one in log.items[begin:end]]

    def __hash__(self) -> int:
        total = sum(log.sum_to(end) - log.sum_to(begin) for log, begin, end in self.pieces)
        return hash((self.length, total & _MASK))

    def __eq__(self, other: Any) -> bool:
        if self is other:
            return True
        if other.__class__ is not BufferSlice or self.length != other.length or hash(self) != hash(other):
            return False
        pairs = zip(self.matches, other.matches)
        return all(one is two or identity(one) == identity(two) for one, two in pairs)


def repetitions(match: PartialMatch, times: int) -> List[PartialMatch]:
    """Return the repetitions that a match of so many of them is made of, oldest first."""
    found: List[PartialMatch] = []
    while times > 1:
        parts: Any = match.parts
        if parts[0].__class__ is BufferSlice:
            return [*parts[0].matches, *reversed(found)]
        match, last = parts
        found.append(last)
        times -= 1
    return [match, *reversed(found)]


def joined_one_by_one(match: PartialMatch, times: int) -> None:
    """Give a match of so many repetitions the parts that nodes of `seq` give it."""
    first, *others, last = repetitions(match, times)
    for one in others:
        first = PartialMatch((), first.start, one.end, None, None, (first, one))
    _set_parts(match, (first, last))


def joined_at_once(match: PartialMatch, times: int) -> None:
    """Give a match of so many repetitions the parts that it has where sequences go on together."""
    _set_parts(match, (BufferSlice(pieces_of(match, times)),))


def _set_parts(match: PartialMatch, parts: Parts) -> None:
    match.parts = parts
    match.identity = None


def pieces_of(match: PartialMatch, times: int) -> Tuple[Piece, ...]:
    """Return what a match of so many repetitions is made of."""
    parts: Any = match.parts
    if times > 1 and parts[0].__class__ is BufferSlice:
        return parts[0].pieces
    return ((SharedLog(repetitions(match, times)), 0, times),)


_NEVER = -(1 << 80)


class RunCursor(PartialMatch):
    """A sequence that has not all of its repetitions yet, in a train.

    Attributes:
        first: what it began with in the train: its first repetition, or a match of some that waited apart.
        apart: of how many repetitions that is; 0 for its first one, which the train has too.
        log, at: where the repetitions stand that it took in the train.
        since: the number of the first of those.
    """

    __slots__ = ("first", "apart", "log", "at", "since")

    buffer: "Optional[RunGroup]"

    def __init__(self, first: PartialMatch, apart: int, train: "RunGroup"):
        super().__init__(first.values, first.start, first.end, None, None, (first,))
        self.first = first
        self.apart = apart
        self.log = train.log
        self.at = len(train.log.items)
        self.since = train.taken

    @property
    def latest(self) -> int:
        """Where it ends by now; see `PartialMatch.latest`."""
        return self.end if self.buffer is None else self.buffer.end


class RunGroup:
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

    def __init__(self, node: "RepeatNode", key: Hashable):
        self.node = node
        self.key = key
        self.tokens: Deque[Optional[RunCursor]] = deque()
        self.end = _NEVER
        self.order = 0
        self.log = SharedLog([])
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

    def at(self, number: int) -> Optional[RunCursor]:
        """Return the sequence with so many repetitions, if there is one."""
        if number > len(self.tokens):
            return None
        token = self.tokens[number - 1]
        return None if token is None or token.buffer is None else token

    def present(self) -> Iterator[Tuple[int, RunCursor]]:
        """Yield all of them with their numbers of repetitions, the longest first."""
        for number in range(len(self.tokens), 0, -1):
            token = self.at(number)
            if token is not None:
                yield number, token

    def put(self, number: int, token: RunCursor) -> None:
        """Have a sequence with so many repetitions go on in the train."""
        tokens = self.tokens
        while len(tokens) < number:
            tokens.append(None)
        tokens[number - 1] = token
        self._begin(token)

    def advance(self, match: PartialMatch, longest: int) -> Optional[RunCursor]:
        """Have all take a repetition, and a sequence begin with it; return the one that has ``longest`` now."""
        tokens = self.tokens
        while tokens and (tokens[-1] is None or tokens[-1].buffer is None):
            tokens.pop()
        token = RunCursor(match, 0, self)
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

    def _begin(self, token: RunCursor) -> None:
        token.buffer = self
        self.alive += 1
        rule = self.node.rule
        token.order = rule.order = rule.order + 1

    def renew(self, size: int) -> None:
        """Begin a new log where the old one has so many repetitions; no sequence reaches further back than it."""
        if len(self.log.items) >= size:
            self.log = SharedLog([])

    def remove(self, token: PartialMatch) -> None:
        """Take a sequence out."""
        token.end = self.end
        token.buffer = None
        self.alive -= 1
        self.node.rule.waiting -= 1
        if not self.alive:
            self.node.trains.pop(self.key, None)

    def match_of(self, token: RunCursor, number: int) -> PartialMatch:
        """Return a sequence with so many repetitions as a match of its own."""
        if number == 1:
            return token.first
        return PartialMatch(
            self.node.values_of(token), token.start, self.end, None, None, (self._chain(token),)
        )

    def _chain(self, token: RunCursor) -> BufferSlice:
        before: Tuple[Piece, ...] = pieces_of(token.first, token.apart) if token.apart else ()
        log, last = token.log, self.log
        if log is last:
            return BufferSlice((*before, (log, token.at, len(log.items))))
        return BufferSlice((*before, (log, token.at, len(log.items)), (last, 0, len(last.items))))


class Moving:
    """Where the sequences of all trains of a node wait, as its rule sees it.

    Attributes:
        forbids: whether they are about what must not happen.
    """

    forbids = False

    def __init__(self, node: "RepeatNode"):
        self._node = node

    @property
    def span(self) -> Optional[int]:
        """For how many nanoseconds what waits is of use; None for no bound."""
        return self._node.limit

    def mend(self) -> List[PartialMatch]:
        """Return what waits, oldest first, whatever an interrupt has left half done."""
        found = []
        for key, train in list(self._node.trains.items()):
            here = [token for _, token in train.present()]
            train.alive = len(here)
            if not here:
                del self._node.trains[key]
            found += here
        return sorted(found, key=lambda token: token.order)


NO_ITEMS = NIL


class Run(PartialMatch):
    """A first match with what extended it.

    Attributes:
        last: the largest end so far.
        fixed: the values, set by the first repetition, of variables that stand elsewhere in the rule; or None.
        state: what an aggregate has collected.
        items: what conditions further up look at in each repetition.
        taken: the matches that extended it, where they are tracked.
        held: the same for its results.
        steps: the values of the start and of the repetition, for each of them.
        sound: how many of them are still those that its results were made of.
        open: variables that its repetitions have in common and that none of them gives a value.
    """

    __slots__ = (
        "last",
        "fixed",
        "state",
        "items",
        "taken",
        "held",
        "steps",
        "sound",
        "first",
        "open",
        "_next",
    )

    def __init__(self, first: PartialMatch, state: object, free: int):
        super().__init__(first.values, first.start, first.end, first.event, None, (first,))
        self.first = first
        self.open = tuple([Var() for _ in range(free)])
        self._next: Optional[Tuple[int, Optional[Values], Term, Values, object]] = None
        self.fixed: Optional[Values] = None
        self.items: Term = NO_ITEMS
        self.restart(state)

    @property
    def latest(self) -> int:
        """The largest end so far; see `PartialMatch.latest`."""
        return self.last

    @property
    def filed_by(self) -> Values:
        """The values by which it waits; see `PartialMatch.filed_by`."""
        return self.first.values

    def begin_again(self) -> None:
        """Be as somebody else has set all that is to be seen."""
        self._next = None

    def become(self, last: int, fixed: Optional[Values], items: Term, values: Values, state: object) -> None:
        """Be extended, all of it or nothing, also where an interrupt comes."""
        self._next = last, fixed, items, values, state
        self.last, self.fixed, self.items, self.values, self.state = self._next
        self._next = None

    def mend(self) -> None:
        """Put right what an interrupt may have left half done."""
        if self._next is not None:
            self.become(*self._next)
        for var in self.open:
            var.ref = None

    def restart(self, state: object) -> None:
        """Have no repetitions, with the state of an aggregate that has no values."""
        self.values = self.first.values
        self.last = self.first.end
        self.fixed = None
        self.state = state
        self.items = NO_ITEMS
        self.taken: List[PartialMatch] = []
        self.held = NOTHING_HELD
        self.steps: List[Tuple[Values, Values]] = []
        self.sound = 0


def by_term(name: Callable[[PartialMatch], Hashable]) -> Callable[[Any], Hashable]:
    """Return what tells runs apart by what names their starts: their terms."""
    return lambda run: name(run.first)


def by_occurrence(name: Callable[[PartialMatch], Hashable]) -> Callable[[Any], Hashable]:
    """Return what tells runs apart by what names their starts, and by the stamps of those."""

    def named(run: Run) -> Hashable:
        first = run.first
        return (name(first), int(first.start), int(first.end))

    return named
