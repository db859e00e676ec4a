"""The façade: a machine with its predicates, flags, operators and library."""

from .keeping import (
    KeptLogic,
    KeptValues,
    keep_logic,
    keep_values,
    program_predicates,
    restore_logic,
    restore_values,
)
from .logic import Logic
from .predicates import is_replaceable
from .recovery import go_back, mend, state_of
from .tracing import Tracer

__all__ = [
    "go_back",
    "is_replaceable",
    "keep_logic",
    "keep_values",
    "KeptLogic",
    "KeptValues",
    "Logic",
    "program_predicates",
    "restore_logic",
    "restore_values",
    "mend",
    "state_of",
    "Tracer",
]
