"""After-match skip strategies: partial matches that are discarded when a match of their rule fires.

A rule label can state ``after_match``, as AFTER MATCH SKIP does in MATCH_RECOGNIZE and the after-match skip strategy
in Flink CEP:

* ``skip_past_last``: discard the partial matches that start at or before the end of the match.
* ``skip_to_next``: discard the partial matches with the same start as the match.

One event can complete several matches of a rule. All of them are completed before anything is discarded, because the
order of the nodes must not decide which of them fires. Stored matches that are skipped are therefore discarded when
the next event is dispatched. Rules may emit events while an event is dispatched. A stack of events in progress
(`EventInProgress`) distinguishes a nested event, which belongs to the same step, from the next event.
"""

from typing import TYPE_CHECKING, Dict, Hashable, Iterable, List, NamedTuple, Optional, Set

from ...prolog.terms.types import Frame
from ...serialization.state_fields import StateFields, StateOwner, field
from ...serialization.stored_field_types import INSTANT, sequence_of
from ..dispatch.listeners import DEPTH
from ..matches.consumption_policy import Emit
from ..matches.expiration import ExpirationQueue
from ..matches.match_policies import AfterMatchSkipStrategy, NetworkOptions
from ..matches.match_types import PartialMatch
from .pattern_nodes import ActionNode, EarlyTestNode, FilterNode, NetworkNode

if TYPE_CHECKING:
    from .event_rule import EventRule


_BEFORE_ALL_INSTANTS = -(1 << 80)
_STALE_TOLERANCE = 1000
"""Stale entries that are tolerated in addition to twice the number of stored matches."""


class EventInProgress(NamedTuple):
    """An event whose dispatch has not finished; it may be nested in the dispatch of another event.

    Attributes:
        depth: nesting depth of its dispatch, starting with 1; 0 for an alarm.
        token: its identity.
        starts: starts of the matches that it has completed.
    """

    depth: int
    token: Hashable
    starts: Set[int]


class AfterMatchSkip(StateOwner):
    """Skip state of a rule: an index of its partial matches by start, and the starts and ends of recent matches.

    Attributes:
        last_match_end: largest end of the matches that have fired.
        skipped_until: value of ``last_match_end`` when the dispatch of the current event began; events that start at
            or before it cannot be part of a match.
    """

    STATE = StateFields(
        field("last_match_end", INSTANT),
        field("skipped_starts", sequence_of(INSTANT)),
    )

    def __init__(self, rule: "EventRule", strategy: AfterMatchSkipStrategy):
        self._rule = rule
        self.strategy = strategy
        self.last_match_end = self.skipped_until = _BEFORE_ALL_INSTANTS
        self._skipped_starts: Set[int] = set()
        self._events_in_progress: List[EventInProgress] = []
        self._action: Optional[ActionNode] = None
        self.clear_entries()

    def clear_entries(self) -> None:
        """Remove all entries of stored matches."""
        self._expiration_queue = ExpirationQueue()
        self._matches_by_start: Dict[int, List[PartialMatch]] = {}
        self._start_entry_count = 0

    def clear(self) -> None:
        """Reset the state, because the clock went back."""
        self.last_match_end = self.skipped_until = _BEFORE_ALL_INSTANTS
        self._skipped_starts.clear()
        self.clear_entries()

    def return_to(self, instant: int) -> None:
        """Skip no match that is later than an instant; see `EventRule.return_to`."""
        self.last_match_end = min(self.last_match_end, instant)
        self.skipped_until = min(self.skipped_until, instant)

    @property
    def skipped_starts(self) -> List[int]:
        """Starts of matches that are discarded when the next event is dispatched."""
        return sorted(self._skipped_starts)

    @skipped_starts.setter
    def skipped_starts(self, starts: Iterable[int]) -> None:
        self._skipped_starts = set(starts)

    @property
    def entry_count(self) -> int:
        """Number of entries for matches and events, including stale ones."""
        return len(self._expiration_queue) + self._start_entry_count + len(self._events_in_progress)

    def rebuild_entries(self, stored_matches: Iterable[PartialMatch]) -> None:
        """Replace all entries by those of the given matches."""
        self.clear_entries()
        for match in stored_matches:
            self.add_entry(match)

    def add_entry(self, match: PartialMatch) -> None:
        """Add an entry for a match that has been stored."""
        buffer = match.buffer
        # A negated match is not skipped: it must prevent later matches, too.
        if buffer is None or buffer.is_negated:
            return
        stored_count = self._rule.stored_match_count
        if self.strategy is AfterMatchSkipStrategy.SKIP_PAST_LAST:
            self._expiration_queue.add(match.start, match, stored_count)
            return
        self._matches_by_start.setdefault(match.start, []).append(match)
        self._start_entry_count += 1
        if self._start_entry_count > 2 * stored_count + _STALE_TOLERANCE:
            self.rebuild_entries(
                [stored_match for matches in self._matches_by_start.values() for stored_match in matches]
            )

    def begin_event(self, token: Hashable) -> None:
        """Discard the skipped matches if the dispatch of a new event begins."""
        in_progress = self._events_in_progress
        if in_progress and in_progress[-1].token == token:
            return
        depth = self._rule.network.dispatcher.current[DEPTH]
        # Events that are as deep as this one or deeper are complete: dispatch is depth-first.
        while in_progress and in_progress[-1].token != token and in_progress[-1].depth >= depth:
            in_progress.pop()
        if not in_progress or in_progress[-1].token != token:
            in_progress.append(EventInProgress(depth, token, set()))
        self._discard_skipped()

    def _discard_skipped(self) -> None:
        if self.strategy is AfterMatchSkipStrategy.SKIP_PAST_LAST:
            self.skipped_until = self.last_match_end
            self._expiration_queue.expire(self.last_match_end + 1)
        for start in self._skipped_starts:
            for match in self._matches_by_start.pop(start, ()):
                self._start_entry_count -= 1
                match.discard()
        self._skipped_starts.clear()

    def accepts_start(self, start: int) -> bool:
        """Return whether an event with this start may be part of a match."""
        return start > self.skipped_until

    def may_fire(self, start: int) -> bool:
        """Return whether a match with this start may fire."""
        if self.strategy is AfterMatchSkipStrategy.SKIP_PAST_LAST:
            return start > self.last_match_end
        return start not in self._current_event().starts

    def record_match(self, start: int, end: int) -> None:
        """Record a match that fires."""
        if self.strategy is AfterMatchSkipStrategy.SKIP_PAST_LAST:
            # A match may end in the far future because of a wrong time stamp; it must not skip all matches until
            # then.
            self.last_match_end = max(
                self.last_match_end, min(end, self._rule.network.compute_max_timestamp())
            )
        else:
            self._current_event().starts.add(start)
            self._skipped_starts.add(start)

    def begin_alarm(self) -> None:
        """Discard the skipped matches when an alarm of a node is due; all results of the alarm belong to one step."""
        self._events_in_progress = [EventInProgress(0, self, set())]
        self._discard_skipped()

    def _current_event(self) -> EventInProgress:
        """Return the entry of the event, or alarm, that is being processed."""
        dispatcher = self._rule.network.dispatcher
        if dispatcher.current is not None:
            self.begin_event(dispatcher.token())
        else:
            # An alarm is being processed; `begin_alarm` has made it the first entry.
            del self._events_in_progress[1:]
        return self._events_in_progress[-1]

    def connect(self, root: NetworkNode, complete: Emit, options: NetworkOptions) -> None:
        """Connect the nodes of the rule, so that only matches that may fire reach ``complete``.

        The goal of the whole pattern is called only for matches that may fire. All results of ``event_multiply`` for
        a match count as one match.
        """
        self._action = action = find_first_action_node(root)
        may_fire = self.may_fire
        if action is not None:
            action.may_fire = may_fire
        rule = self._rule

        def on_match(match: PartialMatch, frame: Frame) -> Frame:
            if rule.window is not None and match.end - match.start > rule.window:
                return frame
            if action is None and not may_fire(match.start):
                return frame
            self.record_match(match.start, match.end)
            return complete(match, frame)

        root.bind(on_match, options)

    def disconnect(self) -> None:
        """Remove the filter, so that the goal of the whole pattern is called for every match."""
        if self._action is not None:
            self._action.may_fire = None


def find_first_action_node(root: NetworkNode) -> Optional[ActionNode]:
    """Return the node of the goal that is called first when the whole pattern has matched; None if there is none."""
    action, node = None, root
    while isinstance(node, (ActionNode, FilterNode, EarlyTestNode)):
        action = node if isinstance(node, ActionNode) else action
        node = node.child
    return action


def select_skip_state(rule: "EventRule", options: NetworkOptions) -> Optional[AfterMatchSkip]:
    """Return the skip state of a rule for the given options, the previous one if the strategy does not change.

    None if the strategy skips nothing.
    """
    previous: Optional[AfterMatchSkip] = rule.skip_state
    if previous is not None:
        if previous.strategy is options.after_match:
            return previous
        previous.disconnect()
    return (
        None
        if options.after_match is AfterMatchSkipStrategy.KEEP
        else AfterMatchSkip(rule, options.after_match)
    )
