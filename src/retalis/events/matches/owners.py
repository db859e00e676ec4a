"""The rule that matches wait for and what is around it, as far as matches look at them."""

from typing import Optional, Protocol

from ...prolog.machine import Meter
from .matches import Match
from .modes import NetworkOptions


class Noting(Protocol):
    """What keeps what events came from, see `Tracker`.

    Attributes:
        blocker: the negated match that made the last test fail.
    """

    blocker: Optional[Match]

    def present(self) -> int:
        """Return the number of the event that is being served."""


class Bounds(Protocol):
    """What a rule shares with all others.

    Attributes:
        cap: how many partial matches a rule may have.
        mode: what the flags say about how the network runs.
    """

    cap: int
    mode: NetworkOptions

    @property
    def tracker(self) -> Noting:
        """What keeps what events came from."""


class Owner(Protocol):
    """The rule of a place.

    Attributes:
        order: how many matches have begun to wait so far.
        waiting: how many wait.
        meter: counts its pattern work; None if nothing is counted.
    """

    order: int
    waiting: int
    meter: Optional[Meter]

    @property
    def network(self) -> Bounds:
        """What it shares with all other rules."""

    def keep(self, match: Match, span: Optional[int]) -> None:
        """Count a match that begins to wait; with too many the oldest goes."""
