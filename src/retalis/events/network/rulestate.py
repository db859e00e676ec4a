"""What a rule knows beside what it says."""

from typing import Any, List, NamedTuple, Optional, Tuple

from ..matches import Match


class Firings:
    """What a rule counts; apart from it, as most events that come in fire one.

    Attributes:
        number: how many whole matches it had, whether or not anybody wanted the event.
        last: the end of the last one, None before the first.
        errors: how many errors it had.
    """

    __slots__ = ("errors", "last", "number")

    def __init__(self) -> None:
        self.number = self.errors = 0
        self.last: Optional[int] = None


class RuleState(NamedTuple):
    """What a rule knows beside what it says.

    Attributes:
        counts: how often it has fired, when last, how many errors it had, how many matches and alarms were dropped,
            and how many alarms were set for the past.
        times: its clock, how many matches have begun to wait, and when it last collected what is too old.
        nodes: what each of its nodes is, and what it knows.
        arrivals: what waits, as it came: the match, its place among the buffers (-1: in a train), its order.
        later: what is to wait when another event comes: the place of its buffer and the match.
        later_event: the event that is meant by that.
        skipped: what its matches have skipped; None where they skip nothing.
    """

    counts: Tuple[Any, ...]
    times: Tuple[Any, ...]
    nodes: List[Any]
    arrivals: List[Tuple[Match, int, int]]
    later: List[Tuple[int, Match]]
    later_event: object
    skipped: Any
