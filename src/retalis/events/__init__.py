"""Event rules: dispatch, patterns, operators, consumption policies, and the network that runs them."""

from ..prolog.terms import term_key
from ._plans import NOBODY
from .building import compile_builder
from .dispatch import Dispatcher
from .nodes import Leaf
from .policy import Policy
from .rules import Rules
from .serving import AT_ONCE, LEFT_OUT, RESTORE, Listener, Stage

__all__ = [
    "AT_ONCE",
    "LEFT_OUT",
    "RESTORE",
    "Dispatcher",
    "Leaf",
    "NOBODY",
    "Listener",
    "Policy",
    "Rules",
    "Stage",
    "compile_builder",
    "term_key",
]
