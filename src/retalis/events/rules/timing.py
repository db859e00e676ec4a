"""The clock, as rules know it."""

from typing import Any, Callable, List, Optional, Protocol, Tuple


class Timing(Protocol):
    """A clock with alarms.

    Attributes:
        ringing: the instant of the alarm that is being called; None between alarms.
    """

    ringing: Optional[int]

    @property
    def alarms(self) -> List[Tuple[int, int, Any]]:
        """Those that are set: when, in which order, and what is called."""

    def now(self) -> int:
        """Return the present instant."""

    def stamp(self) -> int:
        """Return the present instant, later than all that were returned before."""

    def call_at(self, instant: int, alarm: Callable[[int], None], /) -> None:
        """Have a function called when an instant has come."""

    def put_back(self, instant: int, order: int, alarm: Callable[[int], None], /) -> None:
        """Set an alarm that another clock had."""

    def drop(self, is_dead: Callable[[Any], bool], /) -> None:
        """Take alarms out that are not to be called any more."""

    def reached(self) -> int:
        """Return the instant up to which alarms are due; 0 where there is no time yet."""

    def coming(self) -> int:
        """Return the instant up to which time is being moved, maybe in several steps."""
