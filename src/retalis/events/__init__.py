"""Event rules: dispatch, patterns, operators, consumption policies, and the network that runs them."""

from ..terms.keys import term_key
from .building import compile_builder
from .dispatch import Dispatcher, Listener, Stage
from .network import Rules
from .policy import Policy

__all__ = ["Dispatcher", "Listener", "Policy", "Rules", "Stage", "compile_builder", "term_key"]
