"""The network: nodes for the parts of a rule's pattern, and the rule that they belong to."""

from .owners import Network, RuleOwner, UnderWay
from .rule import Rule

__all__ = [
    "Network",
    "RuleOwner",
    "Rule",
    "UnderWay",
]
