"""The clause store: predicates, their clauses, and how goals call them."""

from .clause import NEVER, Clause, may_match
from .control import Control, add_arguments, check_body, control_predicates, functor_of, split_clause
from .database import Database
from .functional import functional
from .goal import CompiledGoal
from .metas import declared_kinds
from .modulenames import GRAMMAR_NAME, indicated
from .predicate import COMPILE_AFTER, Predicate
from .standard import STANDARD

__all__ = [
    "add_arguments",
    "check_body",
    "Clause",
    "COMPILE_AFTER",
    "Control",
    "control_predicates",
    "Database",
    "declared_kinds",
    "functional",
    "functor_of",
    "CompiledGoal",
    "GRAMMAR_NAME",
    "indicated",
    "may_match",
    "NEVER",
    "Predicate",
    "split_clause",
    "STANDARD",
]
