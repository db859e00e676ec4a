"""Lineage of events, for retraction and justification; active only while a flag requires it.

`LineageTracker` gives each event an `Occurrence` as its token and links it to its sources. A bounded number of
occurrences is remembered; older ones are unlinked.

Retraction (``rev(E)``) works in two phases. First, the occurrences of E and everything derived from them are marked
as retracted and removed from all buffers, before any consequence is computed: a rule that ran in between could still
use a retracted event. Then a ``rev`` event is dispatched for each derived occurrence, and matches that become valid
are tried again: those that a retracted event had suppressed, and later results of runs from which a repetition was
removed.
"""

from collections import deque
from copy import copy as shallow_copy
from functools import partial
from itertools import count
from operator import attrgetter
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Deque,
    Dict,
    Hashable,
    Iterable,
    Iterator,
    List,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from ...prolog.machine.resource_limits import Budget, Meter
from ...prolog.terms.term_traversal import term_key
from ...prolog.terms.types import Frame, Term, Values, Var, functor
from ...serialization.field_types import COUNT, references
from ...serialization.state_fields import NextNumber, StateFields, StateOwner, field
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import CAUSE, END, PARENT, START, TERM, TOKEN, Context, Listener, ListenerPhase
from ..language.rule_heads import SYNCHRONIZED
from ..matches.consumption_policy import metered
from ..matches.match_types import PartialMatch, RepetitionChain, lineage_sources
from .derivation_graph import (
    LineageNode,
    MatchOrPair,
    Occurrence,
    Suppressed,
    lineage_nodes_of,
    take_unreported_derived,
)

if TYPE_CHECKING:
    from .derivation_graph import SuppressingNode
    from .event_rule import EventRule
    from .kleene_node import KleeneNode
    from .shared_run_buffer import Run
    from .stream_node import StreamNode

    # Nodes that compute results again without repetitions or elements whose events were retracted.
    RecomputingNode = Union[KleeneNode, StreamNode]
    RetryingNode = Union[SuppressingNode, RecomputingNode]

MAX_REMEMBERED_EVENTS = 100_000
"""Maximum number of remembered events.

When it is exceeded, the oldest event is unlinked and can no longer be retracted or explained.
"""

REV = functor("rev", 1)

_MIN_SWEPT_DEPENDENTS = 64
"""Number of dependents of an occurrence from which discarded matches are removed from the list."""

RetractionStep = Callable[[Frame], Frame]
"""Function that dispatches or retries something; it takes and returns the next frame."""


class LineageTracker(StateOwner):
    """Recorder of events and their lineage; executes retractions.

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
        self._budget = budget
        self._report_nothing_retracted = report_nothing_retracted
        self._tracks_events = False
        self._remembered_events: Deque[Occurrence] = deque()
        self._occurrences_by_term: Dict[Hashable, List[Occurrence]] = {}
        self.listeners: List[Listener] = []
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
            self.listeners.append(dispatcher.listen(ListenerPhase.RULES, (REV, Var()), self._retract, (-1,)))

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

    def _retract(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        """Retract the events of ``rev(E)``: all occurrences of E.

        For a ``rev`` event that another retraction dispatched, only the occurrence that it names is retracted.
        """
        token = self._dispatcher.token()
        retracted = token.retracts
        retries: List[Tuple[RetryingNode, MatchOrPair]] = []
        invalidated: List[LineageNode] = []
        if retracted is None:
            retracted = [
                occurrence
                for occurrence in self._occurrences_by_term.get(term_key(values[0]), ())
                if not occurrence.retracted
            ]
            if not retracted:
                self._report_nothing_retracted(values[0], token.rule)
                return frame
            # The work is charged to the rule that sent ``rev``, else to one that derived an event from the retracted
            # ones.
            meter = self._budget.meter(token.rule or _find_deriving_rule(retracted))
            removal = self._remove_derived(retracted, meter)
            if removal is None:
                return frame
            invalidated, retries = removal
        else:
            meter = self._budget.meter(token.rule)
        steps = self._create_steps([*retracted, *invalidated], retries, start, end)
        retraction = _RetractionSteps(metered(steps, meter))
        return retraction.run((retraction, frame))

    def _remove_derived(
        self, retracted: List[Occurrence], meter: Optional[Meter]
    ) -> Optional[Tuple[List[LineageNode], List[Tuple["RetryingNode", MatchOrPair]]]]:
        """Remove events and everything derived from them from all buffers, before consequences are computed.

        Returns:
            None if the work limit is exceeded; nothing is removed then. Otherwise two lists: the results that became
            invalid although they do not contain a removed event; and the matches to try again, each with its node,
            which are suppressed matches and later results of runs that lost a repetition.
        """
        marked = _mark_retracted(retracted, meter)
        if marked is None:
            return None
        self._dispatcher.count_retraction()
        # ``rev(E)`` itself reports the retraction of E, so no further ``rev`` event is dispatched for these.
        for occurrence in retracted:
            occurrence.reported = True
        runs: Dict[Any, RecomputingNode] = {}
        released_matches: List[Suppressed] = []
        invalidated: List[LineageNode] = []
        # Removing events can invalidate results of stream operators that do not contain them, and these can have
        # derived events of their own: repeat until nothing is added.
        while marked:
            affected = self._detach_from_dependents(marked, released_matches)
            runs.update(affected)
            invalid = [
                lost_result
                for node in dict.fromkeys(affected.values())
                for lost_result in node.invalid_results()
                if not lost_result.retracted
            ]
            # If the work limit is exceeded here, the loop ends and the invalid results remain.
            marked = _mark_retracted(invalid, meter)
            invalidated += invalid if marked else ()
        # A match that is tried first may consume events of the others, so the order of the first attempt is kept.
        released_matches.sort(key=attrgetter("number"))
        retries: List[Tuple[RetryingNode, MatchOrPair]] = [
            (node, result) for run, node in runs.items() for result in node.recompute_results(run)
        ]
        return invalidated, retries + [
            (suppressed.node, suppressed.match_or_pair)
            for suppressed in released_matches
            if suppressed.release()
        ]

    @staticmethod
    def _detach_from_dependents(
        marked: Sequence[LineageNode], released_matches: List[Suppressed]
    ) -> Dict[Any, "RecomputingNode"]:
        """Remove events that are marked as retracted from the matches and runs that use them.

        Returns:
            The affected runs with their nodes. Suppressed matches are appended to ``released_matches``.
        """
        runs: Dict[Any, RecomputingNode] = {}
        for node in marked:
            dependents, node.dependents = node.dependents, []
            for dependent in dependents:
                if isinstance(dependent, PartialMatch):
                    dependent.discard()
                    continue
                run_node, run, repetition = dependent
                if run_node.remove_retracted(run, repetition):
                    # A run may have lost several repetitions; its results are computed once, after all are removed.
                    runs[run] = run_node
            released_matches += node.suppressed
            node.suppressed = []
        return runs

    def _create_steps(
        self,
        retracted: Sequence[LineageNode],
        retries: List[Tuple["RetryingNode", MatchOrPair]],
        start: int,
        end: int,
    ) -> Iterator[RetractionStep]:
        """Yield the steps of a retraction: ``rev`` events for derived occurrences, then matches to try again."""
        for occurrence in retracted:
            for derived in take_unreported_derived(occurrence):
                yield self._create_rev_step(derived, start, end)
        for node, match_or_pair in retries:
            yield partial(self._retry, node, match_or_pair)

    def _retry(self, node: "RetryingNode", match_or_pair: Any, frame: Frame) -> Frame:
        """Try a match again, and return the next frame."""
        # Nodes store some matches of an event only when the next event arrives; ``rev`` is such an event.
        node.rule.store_deferred_of_earlier_events(self._dispatcher.token())
        return node.retry(match_or_pair, frame)

    def _create_rev_step(self, occurrence: Occurrence, start: int, end: int) -> RetractionStep:
        """Return the step that dispatches ``rev(E)`` for an occurrence of a derived event E."""
        term = (REV, occurrence.term)
        token = Occurrence(term, start, end, None, None)
        token.retracts = [occurrence]
        return lambda frame: self._dispatcher.dispatch(term, start, end, frame, token)

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


def _mark_retracted(retracted: Sequence[LineageNode], meter: Optional[Meter]) -> Optional[List[LineageNode]]:
    """Mark events and everything derived from them as retracted.

    The work limit must not interrupt the removal from the buffers, because rules would then use retracted events. The
    work of the removal is therefore counted here, in advance.

    Returns:
        All marked nodes, or None if the work limit is exceeded; no node is marked then.
    """
    stack: List[LineageNode] = [*reversed(retracted)]
    marked: List[LineageNode] = []
    while stack:
        node = stack.pop()
        if node.retracted:
            continue
        if meter is not None and meter(1 + len(node.dependents) + len(node.suppressed)):
            for node in marked:
                node.retracted = False
            return None
        node.retracted = True
        marked.append(node)
        stack += reversed(node.derived)
    return marked


def _find_deriving_rule(retracted: Sequence[Occurrence]) -> Optional["EventRule"]:
    """Return a rule that derived an event from one of the retracted events, or None."""
    stack: List[LineageNode] = [*retracted]
    while stack:
        for derived in stack.pop().derived:
            if isinstance(derived, Occurrence):
                return derived.rule
            stack.append(derived)
    return None


def _unlink(oldest: Occurrence) -> None:
    """Remove a dropped occurrence from the ``derived`` lists of its repetitions, which live as long as their run."""
    repetition: Any
    if oldest.match is not None:
        for repetition in lineage_sources(oldest.match):
            if repetition.__class__ is RepetitionChain:
                repetition.derived = [derived for derived in repetition.derived if derived is not oldest]


def _is_synchronized(term: Term) -> bool:
    return term.__class__ is tuple and term[0] in SYNCHRONIZED


class _RetractionSteps:
    """Code of a frame ``(self, next frame)`` that executes the remaining steps of a retraction."""

    __slots__ = ("steps",)

    def __init__(self, steps: Iterator[RetractionStep]):
        self.steps = steps

    def run(self, frame: Frame) -> Frame:
        for step in self.steps:
            next_frame = step(frame)
            # The step has created frames. The machine executes them and then returns to this one, for the next step.
            if next_frame is not frame:
                return next_frame
        return frame[1]  # type: ignore[no-any-return]


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
