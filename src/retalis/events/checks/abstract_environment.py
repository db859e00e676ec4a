"""Abstract environments: the kinds of the variables of a rule or clause while its parts are evaluated in order."""

from typing import Any, Dict, List, NamedTuple, Optional

from ...foundation.source_places import Place
from ...prolog.terms.types import CompoundTerm, Term, Var, deref
from .value_conflict_reports import ConflictReporter, ProgramPart, place_in
from .value_kinds import (
    PLAIN_TEXT,
    Kinds,
    ValueOrigin,
    are_disjoint,
    find_quoted_text,
    join,
    kind_of,
    meet,
    overlaps,
)


class AbstractValue(NamedTuple):
    """Kinds of a variable, and whether the slots or declared arguments of its own rule give them as well."""

    kinds: Kinds
    is_direct: bool


class Environment:
    """Kinds of the variables of a part of the program.

    Args:
        conflicts: receives values that have nothing in common.
        values: the variables with known kinds; all others can have any value.

    Attributes:
        values: what is known of the variables.
    """

    def __init__(
        self,
        part: ProgramPart,
        conflicts: ConflictReporter,
        values: Optional[Dict[Var, AbstractValue]] = None,
    ):
        self.part = part
        self._conflicts = conflicts
        self.values: Dict[Var, AbstractValue] = {} if values is None else values

    def copy(self) -> "Environment":
        """Return a copy, for a branch whose bindings are not known afterwards."""
        return Environment(self.part, self._conflicts, dict(self.values))

    def value_of(self, term: Term) -> Optional[AbstractValue]:
        """Return what is known of a variable; None for other terms, and for variables with unknown values."""
        value: Any = deref(term)
        return self.values.get(value) if value.__class__ is Var else None

    def kinds_of(self, term: CompoundTerm, position: int) -> Kinds:
        """Return the kinds of an argument of a term."""
        value: Any = deref(term[position])
        if value.__class__ is Var:
            known = self.values.get(value)
            return None if known is None else known.kinds
        kind = kind_of(value)
        return None if kind is None else {kind: ValueOrigin("", value, place_in(self.part, term, position))}

    def set_value(self, var: Var, value: AbstractValue) -> None:
        """Replace what is known of a variable."""
        self.values[var] = value

    def constrain(self, var: Var, kinds: Kinds) -> None:
        """Keep the kinds of a variable that are also among others."""
        known = self.values.get(var)
        if known is None:
            self.values[var] = AbstractValue(kinds, False)
        else:
            self.values[var] = AbstractValue(meet(known.kinds, kinds), known.is_direct)

    def bind_slot(self, term: CompoundTerm, position: int, kinds: Kinds) -> None:
        """Bind the variable in a message slot or declared argument; constants there have checks of their own."""
        value: Any = deref(term[position])
        if value.__class__ is Var and kinds is not None:
            self._bind_variable(term, position, kinds, None, is_direct=True)

    def bind_argument(self, term: CompoundTerm, position: int, kinds: Kinds, subject: Optional[str]) -> None:
        """Bind the variable in an argument or result of a goal, or check the constant there.

        Args:
            term: the term.
            position: the position of the argument.
            kinds: kinds of the values of the argument.
            subject: the argument in words, for findings; None for the result of an aggregate.
        """
        if self._bind_or_conflicts(term, position, kinds, subject):
            place = place_in(self.part, term, position)
            self._conflicts.report_constant(self.part, subject, deref(term[position]), kinds, place)

    def bind_event_argument(self, term: CompoundTerm, position: int, kinds: Kinds, subject: str) -> None:
        """Bind the variable in an argument of a pattern, or check the constant there; see `bind_argument`."""
        if self._bind_or_conflicts(term, position, kinds, subject):
            place = place_in(self.part, term, position)
            self._conflicts.report_pattern_constant(self.part, subject, deref(term[position]), kinds, place)

    def bind_common(self, branches: List["Environment"]) -> None:
        """Bind the variables that each of several alternative branches binds, to the kinds of all of them."""
        for var, first in branches[0].values.items():
            values = [branch.values[var] for branch in branches if var in branch.values]
            if len(values) == len(branches):
                kinds = first.kinds
                for value in values:
                    kinds = join(kinds, value.kinds)
                self.values[var] = AbstractValue(kinds, any(value.is_direct for value in values))

    def _bind_or_conflicts(
        self, term: CompoundTerm, position: int, kinds: Kinds, subject: Optional[str]
    ) -> bool:
        """Bind a variable; return whether there is a constant that conflicts with the kinds, and is reported."""
        if kinds is None:
            return False
        value: Any = deref(term[position])
        if value.__class__ is Var:
            self._bind_variable(term, position, kinds, subject, is_direct=False)
            return False
        kind = kind_of(value)
        return self._conflicts.is_enabled and kind is not None and bool(kinds) and not overlaps(kind, kinds)

    def _bind_variable(
        self, term: CompoundTerm, position: int, kinds: Kinds, subject: Optional[str], is_direct: bool
    ) -> None:
        var: Any = deref(term[position])
        known = self.values.get(var)
        if known is None or known.kinds is None:
            self.values[var] = AbstractValue(kinds, is_direct)
            return
        # Two slots of one rule are compared by `find_type_conflicts`.
        is_own_conflict = not (known.is_direct and is_direct)
        if self._conflicts.is_enabled and is_own_conflict:
            place = place_in(self.part, term, position)
            if are_disjoint(known.kinds, kinds):
                self._conflicts.report_clash(self.part, var, known.kinds, kinds, subject, place)
            else:
                self._report_quoted_text(var, known.kinds, kinds, place)
        self.values[var] = AbstractValue(meet(known.kinds, kinds), known.is_direct or is_direct)

    def _report_quoted_text(self, var: Var, kinds: Kinds, other_kinds: Kinds, place: Optional[Place]) -> None:
        """Report the value with double quotes inside among those of a plain text, if there is one."""
        quoted = find_quoted_text(kinds, other_kinds)
        if quoted is not None:
            plain = kinds if kinds and PLAIN_TEXT in kinds else other_kinds
            name = self._conflicts.name_of(self.part, var)
            self._conflicts.report_quoted_text(self.part, name, quoted, plain, place)
