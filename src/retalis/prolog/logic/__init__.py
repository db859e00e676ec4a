"""The façade: a machine with its predicates, flags, operators and library."""

from .keeping import KeptLogic, keep_logic, program_predicates, restore_logic
from .logic import Logic
from .recovery import go_back, mend, state_of
from .tracing import Tracer

__all__ = [
    "go_back",
    "keep_logic",
    "KeptLogic",
    "Logic",
    "program_predicates",
    "restore_logic",
    "mend",
    "state_of",
    "Tracer",
]
