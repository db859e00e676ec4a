"""The network: nodes for the parts of a rule's pattern, and the rule that they belong to."""

from .nodes import Leaf
from .rule import Rule

__all__ = [
    "Leaf",
    "Rule",
]
