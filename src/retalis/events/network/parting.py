"""What is read off the parts of a pattern before and after their nodes are made."""

from typing import FrozenSet, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

from ...prolog.terms import Term, Var, variables
from ..language import (
    Absent,
    Aggregate,
    Awaited,
    Condition,
    Pattern,
    Shaped,
    Star,
    Windowed,
    Within,
    occurrences,
    walk,
)
from .deferred import Built, Deferred
from .nodes import Leaf

VarSet = FrozenSet[Var]
TestedCondition = Union[Condition, Deferred]


class Wrapping(NamedTuple):
    """The conditions that belong to one operator, inner ones first."""

    core: Pattern
    span: Optional[int]
    conditions: List[Condition]
    absent: Optional[Absent]


def may_be_revived(pattern: Pattern) -> bool:
    """Tell whether taking an event back may make a match of a pattern, instead of only unmaking some."""
    kinds = (Absent, Star, Aggregate, Windowed, Shaped, Awaited)
    return any(isinstance(part, kinds) for part in walk(pattern))


def in_goals(conditions: List[Condition]) -> VarSet:
    """Return the variables of conditions."""
    return frozenset(var for condition in conditions for var in variables(condition.goal))


def those_about_a_result_last(
    conditions: Sequence[TestedCondition], known: Sequence[Var], result: Sequence[Var]
) -> List[Tuple[bool, TestedCondition]]:
    """Return the conditions of an aggregate, and whether each looks at the result or at what follows from it."""
    shown = set(result)
    early, late = [], []
    for condition in conditions:
        mentioned = set() if condition.goal is None else set(variables(condition.goal))
        if mentioned & shown:
            shown |= mentioned.difference(known)
            late.append((True, condition))
        else:
            early.append((False, condition))
    return [*early, *late]


def served(either: bool, left: Built, right: Built) -> List[Leaf]:
    """Return the leaves of a pair in the order in which they take an event that fits several of them.

    Of a sequence the right side comes first: it completes before the left one waits. Else what is made of several
    events comes before a single event, and of two such the left one; of two single events the right one.
    """
    if not either:
        return [*right.leaves, *left.leaves]
    return [*left.joined, *right.joined, *right.single, *left.single]


def meet(left: Built, right: Built) -> bool:
    """Tell whether one event may be in both sides of a pair."""

    def kinds(built: Built) -> Set[Term]:
        found = set()
        for leaf in built.leaves:
            term = leaf.term
            found.add(term[0] if term.__class__ is tuple else term)
        return found

    ours, theirs = kinds(left), kinds(right)
    return bool(ours & theirs) or any(kind.__class__ is Var for kind in ours | theirs)


def unwrap(pattern: Pattern) -> Wrapping:
    """Take the conditions off a pattern until the operator that they belong to."""
    span: Optional[int] = None
    conditions: List[Condition] = []
    absent: Optional[Absent] = None
    while True:
        if isinstance(pattern, Condition):
            conditions.append(pattern)
        elif isinstance(pattern, Within):
            span = pattern.span if span is None else min(span, pattern.span)
        elif isinstance(pattern, Absent) and pattern.inside:
            absent = pattern
        else:
            return Wrapping(pattern, span, conditions[::-1], absent)
        pattern = pattern.pattern


def used_twice(terms: List[Term], pattern: Pattern) -> Set[Var]:
    """Return the variables that stand more than once in terms and a pattern."""
    return {var for var, number in occurrences(terms, pattern).items() if number > 1}
