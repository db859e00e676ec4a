"""The network: nodes for the parts of a rule's pattern, and the rule that they belong to."""

from .conditions import UnderWay
from .rule import Rule

__all__ = [
    "Rule",
    "UnderWay",
]
