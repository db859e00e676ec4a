"""The network: nodes for the parts of a rule's pattern, and the rule that they belong to."""

from .asking import Asking
from .nodes import NetworkNode
from .owners import Network, RuleOwner, UnderWay, Woken
from .rule import Rule
from .rulestate import RuleState
from .streambuilding import shaping, stream_of_shape
from .streaming import Streaming

__all__ = [
    "Asking",
    "Network",
    "NetworkNode",
    "RuleOwner",
    "Rule",
    "RuleState",
    "shaping",
    "Streaming",
    "stream_of_shape",
    "UnderWay",
    "Woken",
]
