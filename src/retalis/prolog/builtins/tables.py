"""What tabling keeps: the answers to a variant of a call, and the calls that wait for more of them."""

from typing import Any, Dict, Hashable, List, NamedTuple, Optional, Protocol, Tuple

from ..machine import Frame
from ..terms import Term, Var


class VersionedSource(Protocol):
    """Data outside of tables that an incremental table may read: a predicate, the memories or the states."""

    def version(self, part: Hashable, /) -> object:
        """Return a value that is another one after each change of a part of the data."""


Reads = Dict[Tuple[VersionedSource, Hashable], object]
"""The parts of sources that an evaluation has read, with their versions when it first did."""

_CHANGED = object()
"""The version of what has changed between two reads of an evaluation: equal to no other."""


class Follower(NamedTuple):
    """A call that has been given the first ``at`` answers of a table and waits for more.

    Attributes:
        bound: variables bound since its evaluation began, with their values; None where it cannot go on later.
        height: of the stack of choice points, which cuts in what follows count on.
    """

    at: int
    free: List[Var]
    after: Frame
    bound: Optional[List[Tuple[Any, Term]]]
    height: int


class Table:
    """Answers to one variant of a call.

    Attributes:
        answers: values of the call's variables, in the order found; None in the place of one that there is a
            better one for.
        known: the answers' keys, with their positions.
        ground: whether no answer has a variable.
        reads: of an incremental table what its answers were made of; None for another one.
        state: "new", "active", "waiting" (for the oldest table that it depends on), "complete", or of an incremental
            table "checked": complete, as long as nothing that it has read changes.
        index: position on the stack of active tables.
        low: position there of the oldest table that it is known to depend on.
        parent: of a waiting table the one below it on that stack, which depends on it.
        mark: length of the trail when what runs for it now began.
        height: of the stack of choice points then.
        first: how many tables waited, and how many followers were ready, when it became active.
        followers: calls that have seen all answers so far.
    """

    index: int
    low: int
    mark: int
    height: int
    first: Tuple[int, int]

    __slots__ = (
        "answers",
        "known",
        "ground",
        "reads",
        "state",
        "index",
        "low",
        "parent",
        "mark",
        "height",
        "first",
        "followers",
    )

    def __init__(self, incremental: bool = False) -> None:
        self.state = "new"
        self.reads: Optional[Reads] = {} if incremental else None
        self.parent: Optional[Table] = None
        self.empty()

    def empty(self) -> None:
        """Forget the answers."""
        self.answers: List[Any] = []
        self.known: Dict[Hashable, int] = {}
        self.ground = True
        self.followers: List[Follower] = []

    def renew(self) -> None:
        """Be a table that has not been evaluated."""
        self.state = "new"
        self.empty()
        if self.reads is not None:
            self.reads = {}  # not cleared: tables that were completed together share one

    def complete(self) -> None:
        """Note that there will be no other answers."""
        self.state = "complete" if self.reads is None else "checked"
        if len(self.known) < len(self.answers):
            self.answers = [answer for answer in self.answers if answer is not None]
        self.known.clear()
        self.followers.clear()

    @property
    def is_outdated(self) -> bool:
        """True if something has changed that an incremental table has read."""
        reads = self.reads or {}
        return any(source.version(part) != version for (source, part), version in reads.items())

    def depend(self, reads: Reads) -> None:
        """Note that an incremental table depends on what another one has read."""
        own = self.reads
        if own is not None and own is not reads:
            for read, version in reads.items():
                if own.setdefault(read, version) != version:
                    own[read] = _CHANGED
