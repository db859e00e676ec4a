"""By what a network runs: the consumption policy, and what else the flags say."""

from enum import Enum
from typing import NamedTuple


class Policy(Enum):
    """A consumption policy; see the table in the language reference."""

    RECENT = "recent"
    """The newest that fits; a newer occurrence of the same event replaces a waiting one."""
    RECENT_2 = "recent_2"
    """The newest that fits; identical events both wait."""
    CHRONOLOGICAL = "chronological"
    """The oldest that fits."""
    CHRONOLOGICAL_2 = "chronological_2"
    """The oldest that fits."""
    UNRESTRICTED = "unrestricted"
    """All that fit, oldest first; nothing is used up."""

    @property
    def newest(self) -> bool:
        """Whether the newest partner is taken first."""
        return self in (Policy.RECENT, Policy.RECENT_2)

    @property
    def consuming(self) -> bool:
        """Whether a partner is used up."""
        return self is not Policy.UNRESTRICTED

    @property
    def replacing(self) -> bool:
        """Whether a newer occurrence of the same event replaces the one that waits."""
        return self is Policy.RECENT


class NetworkOptions(NamedTuple):
    """How the network runs: set by flags, the same for all rules."""

    policy: Policy = Policy.RECENT
    out_of_order: bool = False
    tracked: bool = False
    revised: bool = False
