"""The network: nodes for the parts of a rule's pattern, and the rule that they belong to."""

from .asking import Asking
from .deferred import ITEM
from .joining import Joining
from .nodes import NetworkNode, Never
from .owners import Network, RuleOwner, UnderWay, Woken
from .repeating import Repeating
from .rule import Rule
from .rulestate import RuleState
from .runs import Running
from .streambuilding import shaping, stream_of_shape
from .streaming import Streaming

__all__ = [
    "Asking",
    "ITEM",
    "Joining",
    "Network",
    "NetworkNode",
    "Never",
    "Repeating",
    "RuleOwner",
    "Rule",
    "RuleState",
    "Running",
    "shaping",
    "Streaming",
    "stream_of_shape",
    "UnderWay",
    "Woken",
]
