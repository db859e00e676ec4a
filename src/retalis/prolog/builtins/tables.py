"""What tabling keeps: the answers to a variant of a call, and the calls that wait for more of them."""

from typing import Any, Dict, Hashable, List, NamedTuple, Optional, Tuple

from ..machine import Frame
from ..terms import Term, Var


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
        state: "new", "active", "waiting" (for the oldest table that it depends on) or "complete".
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
        "state",
        "index",
        "low",
        "parent",
        "mark",
        "height",
        "first",
        "followers",
    )

    def __init__(self) -> None:
        self.state = "new"
        self.parent: Optional[Table] = None
        self.empty()

    def empty(self) -> None:
        """Forget the answers."""
        self.answers: List[Any] = []
        self.known: Dict[Hashable, int] = {}
        self.ground = True
        self.followers: List[Follower] = []

    def complete(self) -> None:
        """Note that there will be no other answers."""
        self.state = "complete"
        if len(self.known) < len(self.answers):
            self.answers = [answer for answer in self.answers if answer is not None]
        self.known.clear()
        self.followers.clear()
