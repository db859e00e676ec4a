"""Goals that are one: built-ins in a row whose values go from one to the next and nowhere else.

They are written as one call. What they hand on does not become terms.
"""

from typing import Any, List, Mapping, Sequence

from ..terms import conjunction
from .known import JoinedGoals, KnownDatabase
from .nodes import CallNode, GoalNode

_MOST = 4
"""Goals in a row that are looked at."""


class JoinedNode(CallNode):
    """Goals in a row that one function does.

    Attributes:
        function: takes the inputs, which are all arguments but the last; returns the output, or None where one fails.
    """

    __slots__ = ("function",)

    def __init__(self, goals: Sequence[CallNode], made: JoinedGoals):
        super().__init__("joined", goals[0].key, (*made.inputs, made.output), True)
        self.function = made.function
        self.source = conjunction([goal.source for goal in goals if goal.source is not None])


def join(database: KnownDatabase, counts: Mapping[Any, int], nodes: Sequence[GoalNode]) -> Sequence[GoalNode]:
    """Return goals with those in a row as one that go together.

    Args:
        database: knows predicates; what the first of them computes has `joins`.
        counts: how often each variable occurs in the clause.
        nodes: the goals.
    """
    found: List[GoalNode] = []
    left = list(nodes)
    while left:
        goals = _row(database, left)
        functional = database.predicate(goals[0].key).functional if goals else None
        joins = None if functional is None else functional.joins
        made = None if joins is None else joins([(goal.key, *goal.args) for goal in goals], counts)
        if made is None:
            found.append(left.pop(0))
        else:
            found.append(JoinedNode(goals[: made.length], made))
            del left[: made.length]
    return found


def _row(database: KnownDatabase, nodes: Sequence[GoalNode]) -> List[CallNode]:
    """Return the goals at the beginning that are built-in functions."""
    found: List[CallNode] = []
    for node in nodes[:_MOST]:
        if not isinstance(node, CallNode) or node.form != "builtin":
            break
        if database.predicate(node.key).functional is None:
            break
        found.append(node)
    return found
