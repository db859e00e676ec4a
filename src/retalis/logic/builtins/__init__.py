"""Built-in predicates by theme; importing this package registers all of them."""

from .. import bits, functions  # noqa: F401  (registers evaluable functions)
from . import (  # noqa: F401  (imported for what they register)
    atoms,
    calling,
    chance,
    checking,
    clauses,
    cleanup,
    comparing,
    coroutines,
    datimes,
    input,
    lambdas,
    lists,
    numbering,
    output,
    poses,
    reading,
    recorded,
    reports,
    sets,
    solutions,
    state,
    strings,
    tabling,
    taking_apart,
    timing,
)
from .dcg import translate_rule
from .registry import ENTRIES
from .state import default_flags

__all__ = ["ENTRIES", "default_flags", "translate_rule"]
