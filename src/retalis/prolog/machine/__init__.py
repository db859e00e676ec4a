"""The machine: frames, choice points and budgets, and the errors that goals end with."""

from ..terms import Frame, Runs, Step
from .budget import Budget, BudgetState, Turn, resident_bytes
from .codes import BAIL, DEAD, LAST, RESUME, CatchMark, Code, Guard, Takes
from .describing import CONTEXT, ERROR, describe
from .faults import (
    PrologError,
    domain_error,
    error,
    evaluation_error,
    existence_error,
    from_python,
    indicator,
    instantiation_error,
    no_argument,
    no_matching_rule,
    permission_error,
    representation_error,
    resource_error,
    syntax_error,
    type_error,
    uninstantiation_error,
)
from .limits import LOOP, LimitError, LimitPassed, Limits, keep_back
from .machine import Machine

__all__ = [
    "BAIL",
    "Budget",
    "CatchMark",
    "Code",
    "CONTEXT",
    "DEAD",
    "describe",
    "domain_error",
    "ERROR",
    "error",
    "evaluation_error",
    "existence_error",
    "Frame",
    "from_python",
    "Guard",
    "indicator",
    "instantiation_error",
    "keep_back",
    "LAST",
    "LimitError",
    "LimitPassed",
    "Limits",
    "LOOP",
    "Machine",
    "no_argument",
    "no_matching_rule",
    "permission_error",
    "PrologError",
    "representation_error",
    "resident_bytes",
    "resource_error",
    "RESUME",
    "BudgetState",
    "Runs",
    "Step",
    "syntax_error",
    "Takes",
    "Turn",
    "type_error",
    "uninstantiation_error",
]
