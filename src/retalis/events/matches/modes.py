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


class AfterMatch(Enum):
    """What a match that has fired skips; see "After a match" in the language reference."""

    KEEP = "keep"
    """Nothing."""
    SKIP_PAST_LAST = "skip_past_last"
    """What starts at or before its end: the next match begins after it."""
    SKIP_TO_NEXT = "skip_to_next"
    """What starts where it does: one start gives one match."""


class NetworkOptions(NamedTuple):
    """How the network runs: set by flags, and for a rule also by the properties of its label."""

    policy: Policy = Policy.RECENT
    out_of_order: bool = False
    tracked: bool = False
    revised: bool = False
    after_match: AfterMatch = AfterMatch.KEEP


def with_property(mode: NetworkOptions, name: str, word: str) -> NetworkOptions:
    """Return a mode as a property of a label changes it, for the rules of that label."""
    if name == "policy":
        return mode._replace(policy=Policy(word))
    if name == "after_match":
        return mode._replace(after_match=AfterMatch(word))
    assert name == "out_of_order", name
    return mode._replace(out_of_order=word == "on")
