"""The Prolog: clauses compiled to Python, an iterative machine, clauses and built-ins.

`Logic` is the façade. `Machine` runs frames; `Goal` is a goal compiled for Python code.
"""

from .budget import Budget
from .builtins.arguments import callable_of, integer
from .builtins.datimes import instant_of
from .codes import LAST, Code
from .faults import (
    PrologError,
    domain_error,
    existence_error,
    instantiation_error,
    permission_error,
    representation_error,
    resource_error,
    type_error,
)
from .goal import Goal
from .limits import Limits, keep_back
from .logic import Logic
from .machine import Machine
from .predicate import Predicate
from .recovery import go_back, mend, state_of

__all__ = [
    "LAST",
    "Code",
    "Goal",
    "Budget",
    "Limits",
    "Logic",
    "Machine",
    "Predicate",
    "PrologError",
    "callable_of",
    "domain_error",
    "existence_error",
    "go_back",
    "instant_of",
    "instantiation_error",
    "integer",
    "keep_back",
    "mend",
    "permission_error",
    "representation_error",
    "resource_error",
    "state_of",
    "type_error",
]
