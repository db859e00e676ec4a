"""The network: nodes for the parts of a rule's pattern, and the rule that they belong to."""

from .conditions import UnderWay
from .owners import RuleOwner
from .rule import Rule

__all__ = [
    "RuleOwner",
    "Rule",
    "UnderWay",
]
