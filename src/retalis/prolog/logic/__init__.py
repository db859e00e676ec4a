"""The façade: a machine with its predicates, flags, operators and library."""

from .logic import Logic
from .recovery import go_back, mend, state_of
from .tracing import Tracer

__all__ = [
    "go_back",
    "Logic",
    "mend",
    "state_of",
    "Tracer",
]
