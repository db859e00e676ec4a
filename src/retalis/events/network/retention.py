"""Retention times: how long a partial match can still contribute to a result.

A rule such as ``(a seq b) within 10`` can discard an ``a`` ten seconds after its start, because no later ``b``
completes the pattern in time. The compiler derives one retention time per operand from the ``within`` bounds above
it. Drools Fusion calls this inferred event expiration.

Two cases differ. If events arrive in order, a bound on the whole pattern is also a bound on the time for which an
operand is stored. If ``out_of_order`` is on, the first operand of a sequence may arrive after the second one.
Negated matches (``cnot``, ``fnot``) must then be stored longer than positive ones: they may still rule out a pair
whose first operand is late.
"""

from typing import NamedTuple, Optional


class Retention(NamedTuple):
    """Retention times of one operand, in ns: the smallest interval bounds above it; None for no bound.

    Attributes:
        in_order: if the first operands of sequences never arrive late.
        late: if they may arrive late.
        part: the longest interval of a useful match, for a pattern that is a part of the rule's match. None also for
            a negated pattern.
    """

    in_order: Optional[int] = None
    late: Optional[int] = None
    part: Optional[int] = None

    def within(self, span: Optional[int]) -> "Retention":
        """Return the retention below a ``within`` of ``span`` nanoseconds, or this one if there is no bound."""
        if span is None:
            return self
        return Retention(
            smaller_bound(self.in_order, span), smaller_bound(self.late, span), smaller_bound(self.part, span)
        )

    def of_negated(self, span: Optional[int]) -> "Retention":
        """Return the retention of a pattern that is negated between two operands.

        Args:
            span: the longest time in ns that the two operands can span together; None if unbounded.
        """
        return Retention(self.in_order, retention_for_late(span, self.late))


UNLIMITED = Retention()


def smaller_bound(first: Optional[int], second: Optional[int]) -> Optional[int]:
    """Return the smaller of two bounds; None counts as infinity."""
    if first is None:
        return second
    return first if second is None else min(first, second)


def retention_for_late(span: Optional[int], retention: Optional[int]) -> Optional[int]:
    """Return the retention of a negated match if the first operand may arrive late; None means forever.

    Args:
        span: the longest time in ns that the two operands can span together; None if unbounded.
        retention: retention time of the second operand in ns; None if unbounded.
    """
    # The second operand may be stored for `retention` until the late first operand arrives and opens the gap. The gap
    # then reaches back up to `span` from the end of the second operand.
    return None if span is None or retention is None else span + retention
