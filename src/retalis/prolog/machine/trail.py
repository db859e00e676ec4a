"""The trail of a long run: what of it need not be remembered."""

from ...foundation import seen_elsewhere
from ..terms import Trail, Var


def compact(trail: Trail, low: int) -> None:
    """Drop entries above the newest choice point, which is at ``low``, that nothing else can see any more.

    A deterministic loop leaves nothing but such entries behind: variables that only the trail still
    holds. Their unbinding could not be noticed, so they need not be remembered.
    """
    entries = trail[low:]
    del trail[low:]
    trail += seen_elsewhere(entries, Var)
