"""What a match that has fired skips, in rules whose label says ``after_match``.

All that an event completes is completed first. What has been skipped and waits goes when the next event comes.
"""

from typing import TYPE_CHECKING, Any, Dict, Hashable, Iterable, List, NamedTuple, Optional, Set, Tuple

from ...prolog.terms.types import Frame
from ..dispatch.listeners import DEPTH
from ..matches.consumption_policy import Emit
from ..matches.expiration import ExpirationQueue
from ..matches.partial_matches import AfterMatchSkipStrategy, NetworkOptions, PartialMatch
from .pattern_nodes import ActionNode, FilterNode, NetworkNode

if TYPE_CHECKING:
    from .event_rule import EventRule


_NEVER = -(1 << 80)
_SPARE = 1000


class Served(NamedTuple):
    """An event that is being served, maybe with one that it has led to.

    Attributes:
        depth: how many events it was derived from, and itself.
        token: what tells it from others.
        starts: where matches start that have fired at it.
    """

    depth: int
    token: Hashable
    starts: Set[int]


class AfterMatchSkip:
    """What the matches of a rule have skipped.

    Args:
        rule: the rule.
        kind: what a match skips.

    Attributes:
        past: the largest end of those that have fired.
        swept: the same as the event that is served found it: what starts later is no part of a match any more.
    """

    def __init__(self, rule: "EventRule", kind: AfterMatchSkipStrategy):
        self._rule = rule
        self.kind = kind
        self.past = self.swept = _NEVER
        self._due: Set[int] = set()
        self._served: List[Served] = []
        self._action: Optional[ActionNode] = None
        self.forget()

    def forget(self) -> None:
        """Know nothing of what waits."""
        self._early = ExpirationQueue()
        self._by_start: Dict[int, List[PartialMatch]] = {}
        self._filed = 0

    def clear(self) -> None:
        """Begin anew: time went back."""
        self.past = self.swept = _NEVER
        self._due.clear()
        self.forget()

    def kept(self) -> Tuple[Any, ...]:
        """Return what it knows beside what waits; see `restore`."""
        return self.past, tuple(sorted(self._due))

    def restore(self, kept: Tuple[Any, ...]) -> None:
        """Know that; what is skipped goes when the next event comes."""
        self.past, due = kept
        self._due = set(due)

    @property
    def filed(self) -> int:
        """How many matches and events it knows, those included that have left."""
        return len(self._early) + self._filed + len(self._served)

    def refile(self, waiting: Iterable[PartialMatch]) -> None:
        """Know what waits."""
        self.forget()
        for match in waiting:
            self.note(match)

    def note(self, match: PartialMatch) -> None:
        """Take note of a match that has begun to wait."""
        where = match.buffer
        if where is None or where.forbids:
            return
        waiting = self._rule.waiting
        if self.kind is AfterMatchSkipStrategy.SKIP_PAST_LAST:
            self._early.add(match.start, match, waiting)
            return
        self._by_start.setdefault(match.start, []).append(match)
        self._filed += 1
        if self._filed > 2 * waiting + _SPARE:
            self.refile([one for found in self._by_start.values() for one in found])

    def begin(self, event: Hashable) -> None:
        """Have what is skipped go, if it is another event that comes."""
        served = self._served
        if served and served[-1].token == event:
            return
        depth = self._rule.network.dispatcher.current[DEPTH]
        while served and served[-1].token != event and served[-1].depth >= depth:
            served.pop()
        if not served or served[-1].token != event:
            served.append(Served(depth, event, set()))
        self._sweep()

    def _sweep(self) -> None:
        if self.kind is AfterMatchSkipStrategy.SKIP_PAST_LAST:
            self.swept = self.past
            self._early.expire(self.past + 1)
        for start in self._due:
            for match in self._by_start.pop(start, ()):
                self._filed -= 1
                match.leave()
        self._due.clear()

    def takes(self, start: int) -> bool:
        """Tell whether what starts then may be a part of a match."""
        return start > self.swept

    def lets(self, start: int) -> bool:
        """Tell whether a match that starts then may fire."""
        if self.kind is AfterMatchSkipStrategy.SKIP_PAST_LAST:
            return start > self.past
        return start not in self._now().starts

    def fired(self, start: int, end: int) -> None:
        """Take note of a match that fires; one that ends in the far future skips no more than there may be by now."""
        if self.kind is AfterMatchSkipStrategy.SKIP_PAST_LAST:
            self.past = max(self.past, min(end, self._rule.network.newest_allowed()))
        else:
            self._now().starts.add(start)
            self._due.add(start)

    def wakes(self) -> None:
        """Have what is skipped go as the clock wakes a node: what that gives on is as of one event."""
        self._served = [Served(0, self, set())]
        self._sweep()

    def _now(self) -> Served:
        dispatcher = self._rule.network.dispatcher
        if dispatcher.current is not None:
            self.begin(dispatcher.token())
        else:
            del self._served[1:]
        return self._served[-1]

    def connect(self, root: NetworkNode, complete: Emit, mode: NetworkOptions) -> None:
        """Have the nodes of the rule send those matches to ``complete`` that may fire.

        A goal that is called for the whole match is called only for those, and what an event_multiply makes of one is
        one match.
        """
        self._action = action = first_action(root)
        lets = self.lets
        if action is not None:
            action.lets = lets
        rule = self._rule

        def arrive(match: PartialMatch, after: Frame) -> Frame:
            if rule.window is not None and match.end - match.start > rule.window:
                return after
            if action is None and not lets(match.start):
                return after
            self.fired(match.start, match.end)
            return complete(match, after)

        root.bind(arrive, mode)

    def disconnect(self) -> None:
        """Have the goal that is called for the whole match called for all matches."""
        if self._action is not None:
            self._action.lets = None


def first_action(root: NetworkNode) -> Optional[ActionNode]:
    """Return the node of the goal that is called first when all of a pattern is matched; None without one."""
    found, node = None, root
    while isinstance(node, (ActionNode, FilterNode)):
        found = node if isinstance(node, ActionNode) else found
        node = node.child
    return found


def skipping_by(rule: "EventRule", mode: NetworkOptions) -> Optional[AfterMatchSkip]:
    """Return what a rule skips in a mode, with what it knows where that is as before; None where it skips nothing."""
    before: Optional[AfterMatchSkip] = rule.skipping
    if before is not None:
        if before.kind is mode.after_match:
            return before
        before.disconnect()
    return None if mode.after_match is AfterMatchSkipStrategy.KEEP else AfterMatchSkip(rule, mode.after_match)
