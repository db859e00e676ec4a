"""For how long what waits can be of use."""

from typing import NamedTuple, Optional


class Retention(NamedTuple):
    """The shortest interval bound above a pattern, in ns: what waits longer than that is of no use; None for none.

    Attributes:
        in_order: where first sides of sequences do not come late.
        late: where they may. What must not happen is kept for them then, and so longer than what takes part.
        part: for a part of the rule's match: the longest interval of it that is of use. None also for what must not
            happen.
    """

    in_order: Optional[int] = None
    late: Optional[int] = None
    part: Optional[int] = None

    def within(self, span: Optional[int]) -> "Retention":
        """Return the limit of what stands below a bound."""
        if span is None:
            return self
        return Retention(least(self.in_order, span), least(self.late, span), least(self.part, span))

    def of_negated(self, span: Optional[int]) -> "Retention":
        """Return the limit of what is negated between sides that are no longer than ``span`` together."""
        return Retention(self.in_order, kept_for_late(span, self.late))


UNLIMITED = Retention()


def least(one: Optional[int], other: Optional[int]) -> Optional[int]:
    """Return the smaller of two bounds, either of which may be None for none."""
    if one is None:
        return other
    return one if other is None else min(one, other)


def kept_for_late(span: Optional[int], limit: Optional[int]) -> Optional[int]:
    """Return for how long what lies between two sides is kept where the first may come late; None forever.

    The second side waits for ``limit``, and the two are no longer than ``span`` together, in ns.
    """
    return None if span is None or limit is None else span + limit
