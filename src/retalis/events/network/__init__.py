"""The network: nodes for the parts of a rule's pattern, and the rule that they belong to."""

from .nodes import NetworkNode
from .owners import Network, RuleOwner, UnderWay
from .rule import Rule
from .rulestate import RuleState

__all__ = [
    "Network",
    "NetworkNode",
    "RuleOwner",
    "Rule",
    "RuleState",
    "UnderWay",
]
