"""What an engine of SWI-Prolog's has open."""

from typing import NamedTuple, Optional

from .interrupter import Watched
from .values import Refs


class OpenGoal:
    """A goal that may have more solutions.

    Attributes:
        query: what SWI-Prolog calls it.
        frame: what is given up with it.
        refs: of its variables.
        over: whether nobody wants the others.
        closed: whether it is given up.
    """

    __slots__ = ("query", "frame", "refs", "over", "closed")

    def __init__(self, query: int, frame: int, refs: Refs):
        self.query = query
        self.frame = frame
        self.refs = refs
        self.over = self.closed = False


class GoalLevel(NamedTuple):
    """Where goals begin that may be given up together: an engine's first ones, or those of what is asked back.

    Attributes:
        base: how many goals were open before.
        query: the one that asks back, 0 where none does.
        depth: how often the engine has been taken up.
        watched: the goal that runs.
    """

    base: int
    query: int
    depth: int
    watched: Optional[Watched]
