"""The clock, as rules know it."""

from typing import Callable, Protocol, Sized


class Timing(Protocol):
    """A clock with alarms."""

    @property
    def alarms(self) -> Sized:
        """Those that are set."""

    def now(self) -> int:
        """Return the present instant."""

    def stamp(self) -> int:
        """Return the present instant, later than all that were returned before."""

    def call_at(self, instant: int, alarm: Callable[[int], None], /) -> None:
        """Have a function called when an instant has come."""
