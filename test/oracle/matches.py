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
    """A condition that needs variables of patterns to its left, with its values of t1 and t2."""

    goal: Term
    facts: Dict[str, Term]


@dataclass(frozen=True, eq=False)
class Gap:
    """Interval in which cnot or fnot forbids events, with variables that patterns to the left have not bound yet."""

    node: Any
    """The cnot or fnot."""
    after: Any
    """Start of the gap; None if it has no start."""
    before: Any
    fresh: Optional[Bindings] = None
    """In a repetition: the values of the variables that are fresh in each repetition."""


@dataclass(frozen=True, eq=False)
class Match:
    """An occurrence of a pattern: its interval, the values of its variables, and its events."""

    start: Any
    end: Any
    bindings: Bindings
    terms: Tuple[Tuple[int, str], ...]
    """For each matched leaf: its place in the rule and the text of its event, without repetitions."""
    numbers: FrozenSet[int]
    """The numbers of all events of this match."""
    pending: Tuple[Any, ...] = ()
    """Tests that are not decided yet: `Pending` and `Gap`."""
    composed: bool = False
    """Whether it counts as composed although it has one event: a window of one element, or one with a deadline."""
    along: bool = False
    """Whether it consists of a late start of a run and earlier events; it is processed together with the start."""

    def variant(self) -> Any:
        """Return a key that two matches share if their event terms are variants of each other.

        The term of a composed event is its pattern with all variables replaced, those of goals included.
        """
        values = sorted((id(var), show(var, self.bindings)) for var in self.bindings)
        return self.terms, tuple(values)

    def is_one_event(self) -> bool:
        """Return whether this is a single event, not a composed one."""
        return len(self.numbers) == 1 and not self.composed

    def is_last(self) -> bool:
        """Return whether it is processed after composed matches: the event itself, and matches of a late start."""
        return self.along or self.is_one_event()


@dataclass(eq=False)
class Run:
    """A running star_times or aggregate: its start, its last repetition, and the collected values."""

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
