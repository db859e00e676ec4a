"""Policies of matching, and further options of a network: consumption, and what is skipped after a match.

Flags set them for all rules, and the properties of a label for the rules with this label.
"""

from enum import Enum
from typing import NamedTuple

from ...foundation.errors import UsageError


class ConsumptionPolicy(Enum):
    """A consumption policy; see the table in the language reference."""

    RECENT = "recent"
    """Chooses the newest partner. A newer occurrence of the same event replaces a stored one."""
    RECENT_2 = "recent_2"
    """Chooses the newest partner. Identical events are stored separately."""
    CHRONOLOGICAL = "chronological"
    """Chooses the oldest partner. Identical events are stored separately."""
    CHRONOLOGICAL_2 = "chronological_2"
    """Synonym of ``chronological``, which ETALIS distinguishes."""
    UNRESTRICTED = "unrestricted"
    """Chooses all partners, oldest first, and consumes none."""

    @property
    def prefers_newest(self) -> bool:
        """True if the newest partner is chosen first."""
        return self in (ConsumptionPolicy.RECENT, ConsumptionPolicy.RECENT_2)

    @property
    def consumes_partners(self) -> bool:
        """True if a partner is consumed."""
        return self is not ConsumptionPolicy.UNRESTRICTED

    @property
    def replaces_identical(self) -> bool:
        """True if a newer occurrence of the same event replaces the stored one."""
        return self is ConsumptionPolicy.RECENT


def check_policy(policy: ConsumptionPolicy) -> None:
    """Reject a policy that the network would silently treat as another one.

    Raises:
        UsageError: for a combination of properties without a join.
    """
    # The joins that choose the newest partner consume it. The other joins do not replace identical events.
    is_supported = policy.consumes_partners if policy.prefers_newest else not policy.replaces_identical
    if not is_supported:
        raise UsageError(
            f"policy {policy.value}: the network has no join for a policy with newest={policy.prefers_newest}, "
            f"consuming={policy.consumes_partners}, replacing={policy.replaces_identical}"
        )


class AfterMatchSkipStrategy(Enum):
    """Partial matches that are skipped after a match; see "After a match" in the language reference."""

    KEEP = "keep"
    """None."""
    SKIP_PAST_LAST = "skip_past_last"
    """Those that start at or before the end of the match: the next match begins after it."""
    SKIP_TO_NEXT = "skip_to_next"
    """Those that start where the match does: one start gives one match."""


class NetworkOptions(NamedTuple):
    """Options of the network: set by flags, and for a rule also by the properties of its label.

    Attributes:
        out_of_order: whether the first operand of a sequence may arrive after the second one.
        tracks_events: whether events are tracked for retraction and explanation.
        emits_revisions: whether the results of a retracted event are retracted, and those that it prevented emitted.
        after_match: partial matches that are skipped after a match.
    """

    policy: ConsumptionPolicy = ConsumptionPolicy.RECENT
    out_of_order: bool = False
    tracks_events: bool = False
    emits_revisions: bool = False
    after_match: AfterMatchSkipStrategy = AfterMatchSkipStrategy.KEEP


def options_with_property(options: NetworkOptions, name: str, value: str) -> NetworkOptions:
    """Return the options changed by a property of a label, for the rules with that label."""
    if name == "policy":
        return options._replace(policy=ConsumptionPolicy(value))
    if name == "after_match":
        return options._replace(after_match=AfterMatchSkipStrategy(value))
    assert name == "out_of_order", name
    return options._replace(out_of_order=value == "on")
