"""The declarations of events in a file: each holds from where it stands, and what follows has to fit."""

from typing import Iterable, Mapping, Optional

from ...foundation import Errors, Place, RuleError, UsageError
from ...prolog.syntax import DECLARE_EVENT
from ...prolog.terms import CompoundTerm, Var, deref, functor
from ..language import (
    STRICTLY,
    UNDECLARED,
    Declarations,
    EventTerm,
    Spot,
    VariableKinds,
    declared_in,
    has_branches,
)
from .directives import Goals

_SET_FLAG = functor("set_etalis_flag", 2)


class FileDeclarations:
    """What holds at a place of a file that is being read.

    Args:
        declared: what holds where it begins; None where nothing is looked at.
        errors: take what does not fit.
    """

    def __init__(self, declared: Optional[Declarations], errors: Errors):
        self._declared = declared
        self._errors = errors

    def take(self, goals: Goals, spot: Spot) -> None:
        """Have what the goals of a directive declare hold for the rest of the file.

        Raises:
            RuleError: where one is no declaration, or not that of before.
        """
        declared = self._declared
        for goal, _ in () if declared is None else goals:
            if declared is None or goal.__class__ is not tuple:
                continue
            if goal[0] is DECLARE_EVENT:
                for one, place in declared_in(goal, spot):
                    try:
                        declared.add(one)
                    except UsageError as error:
                        raise RuleError(error.message, place) from error
            elif goal[0] is _SET_FLAG and deref(goal[1]) is UNDECLARED:
                declared.strict = deref(goal[2]) is STRICTLY

    def fit(
        self,
        events: Iterable[EventTerm],
        term: CompoundTerm,
        names: Mapping[Var, str],
        spot: Spot,
        place: Optional[Place],
    ) -> None:
        """Look whether events fit that stand in a rule, clause or directive, whose variables are its own."""
        if self._declared:
            kinds = VariableKinds(names, told=not has_branches(term))
            for error in self._declared.misfits(
                events, lambda part, number=0: spot(part, number) or place, kinds
            ):
                self._errors.append(error)
