"""The operators between two patterns: one line each says when a pair fits and which interval it has.

``s1, e1`` is the interval of the left operand, ``s2, e2`` that of the right one. The expressions are put into
the code that is compiled for each node, and into that which says where in time partners are to be looked for.
"""

from typing import Dict, NamedTuple, Tuple


class PatternOperator(NamedTuple):
    """A two-sided operator.

    Attributes:
        name: how rules spell it.
        comparisons: when the intervals of a pair fit; all of them have to hold.
        start: where the result starts.
        end: where the result ends.
        either: whether the sides may arrive in either order; else only the right side completes a pair (a
            late left side does so under ``out_of_order``).
        alone: whether one single event could be both sides if nothing forbade it.
        everything: whether a right side takes all left sides that fit, under every policy.
    """

    name: str
    comparisons: Tuple[str, ...]
    start: str
    end: str
    either: bool = True
    alone: bool = True
    everything: bool = False

    @property
    def fits(self) -> str:
        """When the intervals of a pair fit, as an expression."""
        return " and ".join(self.comparisons) or "True"


_LOW, _HIGH = "s1 if s1 <= s2 else s2", "e1 if e1 >= e2 else e2"

OPERATORS: Dict[str, PatternOperator] = {
    operator.name: operator
    for operator in (
        PatternOperator("seq", ("e1 < s2",), "s1", "e2", either=False, alone=False),
        PatternOperator("forall_seq", ("e1 < s2",), "s1", "e2", either=False, alone=False, everything=True),
        PatternOperator("and", (), _LOW, _HIGH),
        PatternOperator("par", ("s1 < e2", "s2 < e1", "s1 < e1", "s2 < e2"), _LOW, _HIGH),
        PatternOperator("equals", ("s1 == s2", "e1 == e2"), "s1", "e1"),
        PatternOperator("meets", ("e1 == s2",), "s1", "e2"),
        PatternOperator("during", ("s2 <= s1", "e1 <= e2"), "s2", "e2"),
        PatternOperator("starts", ("s1 == s2", "e1 < e2"), "s2", "e2", alone=False),
        PatternOperator("finishes", ("e1 == e2", "s2 < s1"), "s2", "e2", alone=False),
    )
}
