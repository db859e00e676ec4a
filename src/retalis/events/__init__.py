"""Event rules: dispatch, patterns, operators, consumption policies, and the network that runs them."""

from ..prolog.terms import term_key
from .dispatch import AT_ONCE, LEFT_OUT, NOBODY, RESTORE, Dispatcher, Listener, Stage, compile_builder
from .matches import Policy
from .network import Leaf
from .rules import Rules

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
