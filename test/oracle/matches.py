"""Data of the oracle: events, matches of patterns, and the tables of times.

Times are any exact numbers, in seconds.
"""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional, Tuple

from retalis import Term, make_list
from retalis.prolog.terms.types import NIL

from .goal_evaluator import Bindings, quotient, show

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
    """Interval in which cnot, fnot or without forbids events, with variables that are not bound yet."""

    node: Any
    """The cnot, fnot or without."""
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
    allowed_gaps: Tuple[Gap, ...] = ()
    """Gaps that were tested since it was joined; a retraction tests a suppressed match by them again."""
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


def quantile(part: Fraction, values: List[Any]) -> Any:
    """Return a quantile, linear between two numbers."""
    ordered = sorted(values)
    place = part * (len(ordered) - 1)
    low = ordered[int(place)]
    if place == int(place):
        return low
    return low + (ordered[int(place) + 1] - low) * float(place - int(place))


def deviation(values: List[Any]) -> Any:
    """Return the standard deviation of a sample."""
    if len(values) < 2:
        return None
    mean = Fraction(sum(map(Fraction, values))) / len(values)
    spread = sum((Fraction(value) - mean) ** 2 for value in values) / (len(values) - 1)
    return float(spread) ** 0.5


def distinct_terms(values: List[Any]) -> List[Any]:
    """Return the values without repeated terms, in their order."""
    terms: Dict[str, Any] = {}
    for value in values:
        terms.setdefault(show(value), value)
    return list(terms.values())


NUMERIC = ("sum", "min", "max", "avg", "stddev", "median", "quantile")
RESULTS: Dict[str, Callable[[List[Any]], Any]] = {
    "count": len,
    "sum": sum,
    "min": min,
    "max": max,
    "avg": lambda values: quotient(sum(values), len(values)),
    "stddev": deviation,
    "median": lambda values: quantile(Fraction(1, 2), values),
    "quantile": lambda values: quantile(Fraction(1, 4), values),
    "first": lambda values: values[0],
    "last": lambda values: values[-1],
    "list": make_list,
    "distinct": lambda values: make_list(distinct_terms(values)),
    "count_distinct": lambda values: len(distinct_terms(values)),
    "changes": lambda values: sum(show(one) != show(other) for one, other in zip(values, values[1:])),
}
"""Results of values in order: of a window that is not empty, or of at least one repetition."""
EMPTY_RESULTS: Dict[str, Any] = {
    "count": 0,
    "sum": 0,
    "count_distinct": 0,
    "changes": 0,
    "list": NIL,
    "distinct": NIL,
}
"""Results without values; the others have none."""
