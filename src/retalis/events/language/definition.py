"""What a rule says, read and checked."""

from types import MappingProxyType
from typing import FrozenSet, Hashable, Mapping, NamedTuple, Optional

from ...foundation import Place
from ...prolog.terms import Term, Var
from .occurrences import occurrences
from .pattern import Aggregate, Pattern, Repeated, Star, Windowed, same_rule_key, walk


class RuleDefinition(NamedTuple):
    """What a rule says.

    Attributes:
        term: the rule as it was written, without its label.
        head: the event that it fires; None for a pattern that only calls a goal.
        pattern: its pattern, the goals of the head included.
        label: its label, or None.
        place: where it stands.
        names: of its variables.
    """

    term: Term
    head: Optional[Term]
    pattern: Pattern
    label: Optional[Term]
    place: Optional[Place]
    names: Mapping[Var, str] = MappingProxyType({})

    @property
    def key(self) -> Hashable:
        """Equal for rules that are the same but for the names of variables, spellings and labels."""
        return same_rule_key(self.head, self.pattern)

    @property
    def unused(self) -> FrozenSet[Var]:
        """The variables that stand in one place of the rule only, where each place is matched once."""
        if any(
            isinstance(part, (Repeated, Star, Aggregate, Windowed))
            for part in walk(self.pattern, negated=True)
        ):
            return frozenset()
        counts = occurrences([self.term], None)
        return frozenset(var for var, number in counts.items() if number == 1)
