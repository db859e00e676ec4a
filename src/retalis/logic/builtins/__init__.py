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
    ports,
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
from .library import library_index, load_library
from .registry import ENTRIES
from .state import default_flags

__all__ = ["ENTRIES", "default_flags", "library_index", "load_library", "translate_rule"]
