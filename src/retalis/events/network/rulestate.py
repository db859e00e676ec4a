"""What a rule knows beside what it says."""

from typing import Any, List, NamedTuple, Tuple

from ..matches import Match


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
    """

    counts: Tuple[Any, ...]
    times: Tuple[Any, ...]
    nodes: List[Any]
    arrivals: List[Tuple[Match, int, int]]
    later: List[Tuple[int, Match]]
    later_event: object
