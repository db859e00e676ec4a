"""Counts of the parts of a rule, for the coverage of a program by tests.

A rule has these counts only if the engine was created with `Settings.counts_uses`. The compiler of the rule then
wraps the tests of conditions and the actions of branches in functions that count, so that other rules have no cost.

The nodes of a pattern are identified by their objects. A repetition that is written out as a sequence consists of
copies of its pattern, whose counts are those of the pattern (`RuleUseCounts.add_repetitions`).
"""

from typing import Callable, Dict, List, Optional

from ...prolog.terms.types import Values
from ..language.pattern_tree import ConditionPattern, OrPattern, Pattern, RepeatedPattern, walk

ExtendValues = Callable[[Values], Optional[Values]]
"""Returns the values of a match with those of a condition's solution, or None if it has none."""


class RuleUseCounts:
    """Outcomes of the conditions of a rule, and matches of the branches of its ``or`` patterns.

    Args:
        pattern: the pattern of the rule.

    Attributes:
        outcomes: for each condition from left to right, how often it was false and true.
        branch_matches: for each ``or`` from left to right, the number of matches of each branch.
    """

    def __init__(self, pattern: Pattern):
        nodes = walk(pattern, negated=True)
        conditions = [node for node in nodes if isinstance(node, ConditionPattern)]
        alternatives = [node for node in nodes if isinstance(node, OrPattern)]
        self.outcomes = [(node, [0, 0]) for node in conditions]
        self.branch_matches = [(node, [0] * len(node.branches)) for node in alternatives]
        self._counts: Dict[int, List[int]] = {
            id(node): counts for node, counts in (*self.outcomes, *self.branch_matches)
        }
        # An id is unique only while its object exists.
        self._copies: List[Pattern] = []

    def add_repetitions(self, repeated: RepeatedPattern, sequence: Pattern) -> None:
        """Count the parts of a sequence as those of the repeated pattern that was written out."""
        originals = walk(repeated.pattern, negated=True)
        # The pairs of the sequence precede its repetitions.
        copies = walk(sequence, negated=True)[repeated.times - 1 :]
        for position, copy in enumerate(copies):
            counts = self._counts.get(id(originals[position % len(originals)]))
            if counts is not None:
                self._counts[id(copy)] = counts
        self._copies.append(sequence)

    def count_outcomes(self, condition: ConditionPattern, extend_values: ExtendValues) -> ExtendValues:
        """Return the test of a condition, extended by the counting of its outcomes."""
        counts = self._counts[id(condition)]

        def extend_and_count(values: Values) -> Optional[Values]:
            result = extend_values(values)
            counts[result is not None] += 1
            return result

        return extend_and_count

    def branch_counts(self, alternatives: OrPattern) -> List[int]:
        """Return the numbers of matches of the branches, which the node of the ``or`` increments."""
        return self._counts[id(alternatives)]
