"""Data of the oracle: events, matches of patterns, and the tables of times.

Times are any exact numbers, in seconds.
"""

from dataclasses import dataclass, field
from typing import Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional, Tuple

from retalis import Term, make_list

from .goals import Bindings, quotient, show

POLICIES = ("recent", "recent_2", "chronological", "chronological_2", "unrestricted")


class Event(NamedTuple):
    """An occurrence: ``number`` counts arrivals."""

    term: Term
    start: Any
    end: Any
    number: int = 0


@dataclass(frozen=True, eq=False)
class Pending:
    """A condition that waits for variables of patterns to its left, with what t1 and t2 are for it."""

    goal: Term
    facts: Dict[str, Term]


@dataclass(frozen=True, eq=False)
class Gap:
    """Events that cnot or fnot forbids, with variables that patterns to the left have not bound yet."""

    node: Any
    """The cnot or fnot."""
    after: Any
    """When the gap begins; None where any time before counts."""
    before: Any
    fresh: Optional[Bindings] = None
    """In a repetition: the values of the variables that each repetition has of its own."""


@dataclass(frozen=True, eq=False)
class Match:
    """An occurrence of a pattern: its interval, what its variables stand for, the events that make it up."""

    start: Any
    end: Any
    bindings: Bindings
    terms: Tuple[Tuple[int, str], ...]
    """For each leaf that took part: its place in the rule and the text of its event; no repetitions."""
    numbers: FrozenSet[int]
    """The numbers of all events that make up this match."""
    pending: Tuple[Any, ...] = ()
    """What is still to be tested: `Pending` and `Gap`."""
    composed: bool = False
    """Whether it is no single event though it was made of one: a window that has one, or what a time has ended."""
    along: bool = False
    """Whether it was made of a late start of a run, a single event, and what came before: it is served with that."""

    def variant(self) -> Any:
        """Return a key that two matches share when they are the very same event term.

        The term of a composed event is its pattern with all variables replaced, those of goals included.
        """
        values = sorted((id(var), show(var, self.bindings)) for var in self.bindings)
        return self.terms, tuple(values)

    def is_one_event(self) -> bool:
        """Tell whether this is a single event, not a composed one."""
        return len(self.numbers) == 1 and not self.composed

    def is_last(self) -> bool:
        """Tell whether it is served after what is composed: the event itself, and what is made along with it."""
        return self.along or self.is_one_event()


@dataclass(eq=False)
class Run:
    """A running star_times or aggregate: its start, where it stands, and what it has collected."""

    start: Match
    now: Match
    values: List[Any] = field(default_factory=list)
    repetitions: List[Match] = field(default_factory=list)
    """The repetitions that extended it."""


# The table of patterns: aggregates. Count, sum and list have a value from the start, the others with the
# first repetition.
AGGREGATES: Dict[str, Callable[[List[Any]], Any]] = {
    "count": len,
    "sum": sum,
    "list": make_list,
    "min": lambda values: min(values) if values else None,
    "max": lambda values: max(values) if values else None,
    "avg": lambda values: quotient(sum(values), len(values)) if values else None,
}
