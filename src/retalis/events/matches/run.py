"""A run of a repetition or aggregate: a first match, and what has extended it so far."""

from typing import Any, Callable, Hashable, List, Optional, Tuple

from ...prolog.terms import NIL, Term, Values, Var
from .matches import NOTHING_HELD, Match

NO_ITEMS = NIL


class Run(Match):
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

    def __init__(self, first: Match, state: object, free: int):
        super().__init__(first.values, first.start, first.end, first.event, None, (first,))
        self.first = first
        self.open = tuple([Var() for _ in range(free)])
        self._next: Optional[Tuple[int, Optional[Values], Term, Values, object]] = None
        self.fixed: Optional[Values] = None
        self.items: Term = NO_ITEMS
        self.restart(state)

    @property
    def latest(self) -> int:
        """The largest end so far; see `Match.latest`."""
        return self.last

    @property
    def filed_by(self) -> Values:
        """The values by which it waits; see `Match.filed_by`."""
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
        self.taken: List[Match] = []
        self.held = NOTHING_HELD
        self.steps: List[Tuple[Values, Values]] = []
        self.sound = 0


def by_term(name: Callable[[Match], Hashable]) -> Callable[[Any], Hashable]:
    """Return what tells runs apart by what names their starts: their terms."""
    return lambda run: name(run.first)


def by_occurrence(name: Callable[[Match], Hashable]) -> Callable[[Any], Hashable]:
    """Return what tells runs apart by what names their starts, and by the stamps of those."""

    def named(run: Run) -> Hashable:
        first = run.first
        return (name(first), int(first.start), int(first.end))

    return named
