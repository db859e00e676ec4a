"""Findings of the value flow analysis, and their texts."""

from typing import Any, List, Mapping, NamedTuple, Optional

from ...foundation.errors import RuleError
from ...foundation.source_places import Place
from ...prolog.terms.types import CompoundTerm, Term, Var
from ..language.pattern_parser import PlaceLookup
from .program_model import ProgramModel
from .value_kinds import (
    ATOM,
    BOOL,
    DESCRIPTIONS,
    LIST,
    PLAIN_TEXT,
    STRING,
    TEXT,
    Kinds,
    ValueOrigin,
    advise,
    advise_conversion,
    advise_plain_text,
    conversion_to_text,
    describe,
)

NUMBER_ADVICE = {
    TEXT: "compare texts with == or \\==",
    PLAIN_TEXT: "compare texts with == or \\==",
    BOOL: "write == true or == false",
    STRING: "compare strings with == or \\==",
    ATOM: "compare atoms with == or \\==",
    LIST: "take a number of it, as with nth0/3 or array_min/2",
}
"""Advice for values that are no numbers, by their kinds; arithmetic accepts all other kinds."""


class ProgramPart(NamedTuple):
    """Part of a program that is evaluated as a whole.

    Attributes:
        subject: the rule, clause, memory, subscription, state or goal.
        names: names of its variables.
        place_of: returns the places of its terms.
        place: its own place, for terms without one.
        prefix: beginning of findings, which names it if its place is unknown.
    """

    subject: Any
    names: Mapping[Var, str]
    place_of: PlaceLookup
    place: Optional[Place]
    prefix: str = ""


class ConflictReporter:
    """Findings of the analysis.

    Kinds grow while the fixpoint is computed, so a conflict may disappear: nothing is reported before its end.

    Attributes:
        is_enabled: whether conflicts are reported.
        impossible_values: constants in patterns of events that no such event has.
        type_conflicts: comparisons, calls and reads with values that are never equal.
    """

    def __init__(self, program: ProgramModel):
        self._program = program
        self.is_enabled = False
        self.impossible_values: List[RuleError] = []
        self.type_conflicts: List[RuleError] = []

    def enable(self) -> None:
        """Report conflicts from now on."""
        self.is_enabled = True

    def report_constant(
        self, part: ProgramPart, subject: Optional[str], constant: Term, kinds: Kinds, place: Optional[Place]
    ) -> None:
        """Report a constant that an argument or result never has; ``subject`` names that argument."""
        self._report(part, self._constant_text(part, subject or "this", constant, kinds), place)

    def report_pattern_constant(
        self, part: ProgramPart, subject: str, constant: Term, kinds: Kinds, place: Optional[Place]
    ) -> None:
        """Report a constant in a pattern that no event has in this argument."""
        text = self._constant_text(part, subject, constant, kinds)
        self.impossible_values.append(RuleError(f"{part.prefix}{text}", place or part.place))

    def report_compared_constant(
        self, part: ProgramPart, var: Var, constant: Term, kinds: Kinds, place: Optional[Place]
    ) -> None:
        """Report a comparison of a variable with a constant that it never has."""
        self._report(part, self._constant_text(part, self.name_of(part, var), constant, kinds), place)

    def report_clash(
        self,
        part: ProgramPart,
        var: Var,
        kinds: Kinds,
        other_kinds: Kinds,
        other_name: Optional[str],
        place: Optional[Place],
    ) -> None:
        """Report that a variable and another value, which ``other_name`` names, are never equal."""
        name = self.name_of(part, var)
        other = self.describe(part, other_kinds)
        text = f"{name} is {self.describe(part, kinds)}, and {other_name or 'here it'} is {other}"
        advice = advise_conversion(kinds, other_kinds, name)
        self._report(part, f"{text}: these are never equal{f'; {advice}' if advice else ''}", place)

    def report_quoted_text(
        self, part: ProgramPart, subject: str, quoted: ValueOrigin, kinds: Kinds, place: Optional[Place]
    ) -> None:
        """Report one of several values that has double quotes inside, although it meets plain texts only.

        Args:
            part: the part of the program where they meet.
            subject: the plain text, which is a variable or an argument.
            quoted: the value with double quotes.
            kinds: kinds of the plain text.
            place: place where they meet, for a value without a place.
        """
        value = self._program.brief(quoted.constant) if quoted.constant is not None else ""
        plain = {kind: origin for kind, origin in (kinds or {}).items() if kind == PLAIN_TEXT}
        text = f"{subject} is {self.describe(part, plain)}, never {value}: {advise_plain_text(quoted)}"
        self._report(part, text, quoted.place or place)

    def report_operand(self, part: ProgramPart, var: Var, kinds: Kinds, place: Optional[Place]) -> None:
        """Report a variable in arithmetic that is no number."""
        advice = NUMBER_ADVICE[next(iter(kinds or {}))]
        text = f"{self.name_of(part, var)} is {self.describe(part, kinds)}, not a number: {advice}"
        self._report(part, text, place)

    def report_aggregated_value(self, part: ProgramPart, var: Var, kinds: Kinds, function: str) -> None:
        """Report a variable that is no number, although an aggregate collects numbers of it."""
        text = f"{self.name_of(part, var)} is {self.describe(part, kinds)}: {function} collects numbers"
        self._report(part, text, None)

    def report_slot(
        self, part: ProgramPart, var: Var, kinds: Kinds, slot: str, slot_kinds: Kinds, place: Optional[Place]
    ) -> None:
        """Report a variable that is put into a slot or declared argument of other kinds."""
        name = self.name_of(part, var)
        expected = slot_kinds or {}
        if TEXT in expected or (PLAIN_TEXT in expected and TEXT not in (kinds or {})):
            advice = conversion_to_text(name, TEXT in expected)
        else:
            advice = advise_conversion(kinds, slot_kinds, name)
        target = " or ".join(DESCRIPTIONS[kind] for kind in expected)
        text = f"{name} is {self.describe(part, kinds)} and goes into {target} ({slot})"
        self._report(part, f"{text}: {advice or 'send another value'}", place)

    def name_of(self, part: ProgramPart, var: Var) -> str:
        """Return the name of a variable, or other words for one without a name."""
        return part.names.get(var) or self._program.names.get(var) or "this variable"

    def describe(self, part: ProgramPart, kinds: Kinds) -> str:
        """Return kinds in words, with the origins of their values."""
        place = part.place
        return describe(kinds or {}, self._program.brief, None if place is None else place.source)

    def _constant_text(self, part: ProgramPart, subject: str, constant: Term, kinds: Kinds) -> str:
        advice = advise(kinds or {}, constant, self._program.brief)
        text = f"{subject} is {self.describe(part, kinds)}, never {self._program.brief(constant)}"
        return f"{text}: {advice}" if advice else text

    def _report(self, part: ProgramPart, message: str, place: Optional[Place]) -> None:
        self.type_conflicts.append(RuleError(f"{part.prefix}{message}", place or part.place))


def place_in(part: ProgramPart, term: CompoundTerm, position: int) -> Optional[Place]:
    """Return the place of an argument of a term of a part of the program."""
    place: Optional[Place] = part.place_of(term, position)
    return place
