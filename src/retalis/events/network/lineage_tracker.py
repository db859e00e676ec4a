"""Lineage of events, for retraction and justification; active only while a flag requires it.

`LineageTracker` gives each event an `Occurrence` as its token and links it to its sources. A bounded number of
occurrences is remembered; older ones are unlinked.
"""

from collections import deque
from copy import copy as shallow_copy
from itertools import count
from typing import TYPE_CHECKING, Any, Callable, Deque, Dict, Hashable, Iterable, List, Optional

from ...prolog.machine.resource_limits import Budget
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.types import Frame, Term, Values, Var
from ...serialization.state_fields import NextNumber, StateFields, StateOwner, field
from ...serialization.stored_field_types import COUNT, references
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import CAUSE, END, PARENT, START, TERM, TOKEN, Context, Listener, ListenerPhase
from ..language.rule_heads import SYNCHRONIZED
from ..matches.match_types import PartialMatch, RepetitionChain, lineage_sources
from .lineage_graph import MatchOrPair, Occurrence, Suppressed, lineage_nodes_of
from .retraction import REV, RetractionExecutor

if TYPE_CHECKING:
    from .event_rule import EventRule
    from .kleene_node import KleeneNode
    from .lineage_graph import SuppressingNode
    from .repetition_runs import Run

MAX_REMEMBERED_EVENTS = 100_000
"""Maximum number of remembered events.

When it is exceeded, the oldest event is unlinked and can no longer be retracted or explained.
"""

_MIN_SWEPT_DEPENDENTS = 64
"""Number of dependents of an occurrence from which discarded matches are removed from the list."""


class LineageTracker(StateOwner):
    """Recorder of events and their lineage.

    Args:
        dispatcher: dispatches the events.
        budget: limits the work of retractions.
        report_nothing_retracted: called with an event that ``rev`` does not find, and the rule that retracts it.

    Attributes:
        listeners: the listeners of the tracker; none if events are not tracked.
    """

    STATE = StateFields(
        field("stored_events", references("event")),
        field("next_suppressed_number", COUNT),
        field("next_event_number", COUNT),
    )

    def __init__(
        self,
        dispatcher: Dispatcher,
        budget: Budget,
        report_nothing_retracted: "Callable[[Term, Optional[EventRule]], None]",
    ):
        self._dispatcher = dispatcher
        self._tracks_events = False
        self._remembered_events: Deque[Occurrence] = deque()
        self._occurrences_by_term: Dict[Hashable, List[Occurrence]] = {}
        self.listeners: List[Listener] = []
        self._retractions = RetractionExecutor(
            dispatcher, budget, report_nothing_retracted, self.occurrences_of
        )
        self._next_suppressed_number = count()
        self._next_event_number = count(1)
        self._alarm_number = 0

    def configure(self, tracks_events: bool, executes_retractions: bool) -> None:
        """Start or stop tracking, and executing events ``rev(E)``."""
        self._tracks_events = tracks_events
        dispatcher = self._dispatcher
        for listener in self.listeners:
            dispatcher.remove(listener)
        self.listeners = []
        if not tracks_events:
            dispatcher.track_lineage(None)
            self.clear()
            return
        dispatcher.track_lineage(self._create_token)
        self.listeners.append(dispatcher.listen(ListenerPhase.TRACE, Var(), self._remember))
        if executes_retractions:
            self.listeners.append(
                dispatcher.listen(ListenerPhase.RULES, (REV, Var()), self._retractions.retract, (-1,))
            )

    next_suppressed_number = NextNumber("_next_suppressed_number", "Number of the next suppressed match.")

    next_event_number = NextNumber("_next_event_number", "Number of the next event.")

    @property
    def stored_events(self) -> List[Occurrence]:
        """The events that are remembered for retractions and explanations."""
        return list(self._remembered_events)

    @stored_events.setter
    def stored_events(self, events: Iterable[Occurrence]) -> None:
        self._remembered_events = deque(events if self._tracks_events else ())
        self._occurrences_by_term.clear()
        for occurrence in self._remembered_events:
            self._occurrences_by_term.setdefault(term_key(occurrence.term), []).append(occurrence)

    def clear(self) -> None:
        """Drop all remembered events."""
        self._remembered_events.clear()
        self._occurrences_by_term.clear()

    def current_number(self) -> int:
        """Return the number of the current event, or of the current deadline if the clock has activated a node."""
        dispatcher = self._dispatcher
        number: int = self._alarm_number if dispatcher.current is None else dispatcher.token().number
        return number

    def next_alarm_number(self) -> int:
        """Return a number for a deadline of the clock: after all events so far, before those that follow."""
        self._alarm_number = next(self._next_event_number)
        return self._alarm_number

    def _create_token(self, context: Context) -> Occurrence:
        """Return the token of an event without one: an input event, or one that a goal created."""
        term, start, end, cause = context[TERM], context[START], context[END], context[CAUSE]
        # A query in ``synchronized(...)`` may be answered later. The cause of its event is then the occurrence that
        # was dispatched when the query was registered, not a rule.
        if cause.__class__ is Occurrence:
            released_event = Occurrence(term, start, end, None, None)
            released_event.derive_from([cause])
            return released_event
        rule, match = cause or (None, None)
        occurrence = Occurrence(term, start, end, rule, match)
        origins = [] if match is None else lineage_nodes_of(match)
        parent = context[PARENT]
        # The events that a query raises follow from the event ``synchronized(...)`` that holds the query.
        if (
            not origins
            and parent is not None
            and _is_synchronized(parent[TERM])
            and parent[TOKEN] is not None
        ):
            origins = [parent[TOKEN]]
        occurrence.derive_from(origins)
        return occurrence

    def _remember(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        occurrence: Occurrence = self._dispatcher.token()
        occurrence.number = next(self._next_event_number)
        self._remembered_events.append(occurrence)
        self._occurrences_by_term.setdefault(term_key(term), []).append(occurrence)
        if len(self._remembered_events) > MAX_REMEMBERED_EVENTS:
            oldest = self._remembered_events.popleft()
            # The links are cut in both directions; otherwise old occurrences would be kept alive by newer ones.
            oldest.derived = []
            oldest.forgotten = True
            _unlink(oldest)
            # Partial matches may still use it. Through its match they would keep the events that it was derived from,
            # and these the events that they were derived from, and so on.
            oldest.match = None
            oldest.dependents, oldest.suppressed = [], []
            key = term_key(oldest.term)
            occurrences = self._occurrences_by_term[key]
            occurrences.remove(oldest)
            if not occurrences:
                del self._occurrences_by_term[key]
        return frame

    def fire(self, rule: "EventRule", match: PartialMatch, head: Term, frame: Frame) -> Frame:
        """Fire a rule, and record the lineage of its event."""
        occurrence = Occurrence(head, match.start, match.end, rule, match)
        occurrence.derive_from(lineage_nodes_of(match))
        return rule.fire(head, match.start, match.end, frame, occurrence)

    def register_match(self, match: PartialMatch) -> None:
        """Record that a partial match uses its events."""
        for occurrence in lineage_nodes_of(match):
            if occurrence.retracted:
                match.discard()
                return
            if occurrence.forgotten:
                continue
            dependents = occurrence.dependents
            dependents.append(match)
            # Matches that have left their buffer are swept at each doubling, so the cost per match is constant.
            if len(dependents) > _MIN_SWEPT_DEPENDENTS and len(dependents) & (len(dependents) - 1) == 0:
                occurrence.dependents = [
                    match_or_run
                    for match_or_run in dependents
                    if not isinstance(match_or_run, PartialMatch) or match_or_run.buffer is not None
                ]

    def register_repetition(self, run: "Run", match: PartialMatch, node: "KleeneNode") -> None:
        """Record that a run was extended by a match."""
        for occurrence in lineage_nodes_of(match):
            if not occurrence.forgotten:
                occurrence.dependents.append((node, run, match))

    def record_suppressed(self, node: "SuppressingNode", match_or_pair: MatchOrPair) -> None:
        """Record a match that was not emitted, if `MatchStore.blocking_match` has suppressed it.

        Args:
            node: the node that tries the match again if the blocking match is retracted.
            match_or_pair: the suppressed match, or the two matches that were not joined.
        """
        blocking_match = node.rule.blocking_match
        if blocking_match is not None:
            entry = Suppressed(node, match_or_pair, next(self._next_suppressed_number))
            for occurrence in lineage_nodes_of(blocking_match):
                if not occurrence.forgotten:
                    occurrence.suppressed.append(entry)

    def occurrences_of(self, term: Term) -> List[Occurrence]:
        """Return the remembered events with a term that are not retracted, the oldest first."""
        return [
            occurrence
            for occurrence in self._occurrences_by_term.get(term_key(term), ())
            if not occurrence.retracted
        ]

    def remembered_events(self) -> List[Occurrence]:
        """Return the remembered events that are not retracted, the oldest first."""
        return [occurrence for occurrence in self._remembered_events if not occurrence.retracted]


def _unlink(oldest: Occurrence) -> None:
    """Remove a dropped occurrence from the ``derived`` lists of its repetitions, which live as long as their run."""
    repetition: Any
    if oldest.match is not None:
        for repetition in lineage_sources(oldest.match):
            if repetition.__class__ is RepetitionChain:
                repetition.derived = [derived for derived in repetition.derived if derived is not oldest]


def _is_synchronized(term: Term) -> bool:
    return term.__class__ is tuple and term[0] in SYNCHRONIZED


class LineageCut:
    """Removal of the links to old events from what is written to a checkpoint.

    Without it, the links would lead from one event to all that are remembered.

    Args:
        first_number: number of the first event whose lineage is written. Older events that partial matches use are
            written without what they were derived from and without what was derived from them.
    """

    def __init__(self, first_number: int):
        self._first_number = first_number

    def _is_old(self, item: object) -> bool:
        # The number of an event that was not dispatched, such as a pending alarm, is 0.
        return isinstance(item, Occurrence) and 0 < item.number < self._first_number

    def __call__(self, item: object) -> object:
        """Return an object, or its copy without links to events that are too old."""
        if isinstance(item, RepetitionChain) and any(map(self._is_old, item.derived)):
            chain = shallow_copy(item)
            chain.derived = [derived for derived in item.derived if not self._is_old(derived)]
            return chain
        if not isinstance(item, Occurrence) or not self._is_old(item):
            return item
        event = Occurrence(item.term, item.start, item.end, item.rule, None)
        event.number, event.retracted, event.reported = item.number, item.retracted, item.reported
        event.forgotten = True
        return event
