"""What tells the matches of a node apart, beside the events that they are made of.

A value that a goal, a repetition or an aggregate has given may still be open when it is found, and get its value
from an event further up: two matches are of the same term only if it is the same in the end.
"""

from operator import itemgetter
from typing import AbstractSet, Callable, Dict, FrozenSet, Hashable, List, Sequence, Set

from ...prolog.terms import Values, Var, term_key, variables
from ..language import Aggregate, Either, Pattern, Star, Windowed, children, own_terms
from ..matches import Match, Named, identity

Name = Callable[[Match], Hashable]


class Telling:
    """Names the matches of the patterns of one rule.

    Args:
        shared: the variables that stand in the rule more than once.

    Attributes:
        carried: the variables of the rule that are carried on from node to node.
    """

    def __init__(self, shared: AbstractSet[Var]):
        self.carried: Set[Var] = set(shared)
        self._given: Dict[int, FrozenSet[Var]] = {}

    def name(self, names: Sequence[Var], pattern: Pattern) -> Name:
        """Return what names the matches of a pattern, given the variables whose values they carry."""
        carried = [(at, var) for at, var in enumerate(names) if var in self.carried]
        return naming([at for at, var in carried if var not in self._by_events(pattern)])

    def _by_events(self, pattern: Pattern) -> FrozenSet[Var]:
        """Return the variables that the events of a match always give values to; those of a part are kept."""
        found = self._given.get(id(pattern))
        if found is None:
            found = self._given[id(pattern)] = self._given_by(pattern)
        return found

    def _given_by(self, pattern: Pattern) -> FrozenSet[Var]:
        if isinstance(pattern, (Star, Aggregate)):
            return self._by_events(pattern.first)
        if isinstance(pattern, Windowed):
            return frozenset()
        below = [self._by_events(child) for child in children(pattern, False)]
        if isinstance(pattern, Either):
            return frozenset.intersection(*below)
        if not below:
            return frozenset(var for term in own_terms(pattern) for var in variables(term))
        return frozenset().union(*below)


def naming(positions: List[int]) -> Name:
    """Return what names matches by their events and by their values at some positions."""
    if not positions:
        return identity
    return lambda match: Named(identity(match), tuple([term_key(match.values[at]) for at in positions]))


def found_here(names: Sequence[Var], known: int, carried: AbstractSet[Var]) -> Callable[[Values], Values]:
    """Return what takes the values that a node has found itself and does not carry on; see `Found`.

    Args:
        names: the variables of its values.
        known: how many of them it was given.
        carried: the variables that are carried on, and named where a match waits.
    """
    at = [place for place in range(known, len(names)) if names[place] not in carried]
    if len(at) == len(names) - known:
        return itemgetter(slice(known, None))
    return lambda values: tuple([values[place] for place in at])
