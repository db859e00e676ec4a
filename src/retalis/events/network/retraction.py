"""Retraction of events: ``rev(E)``.

A retraction works in two phases. First, the occurrences of E and everything derived from them are marked as retracted
and removed from all buffers, before any consequence is computed: a rule that ran in between could still use a
retracted event. Then a ``rev`` event is dispatched for each derived occurrence, and matches that become valid are
tried again: those that a retracted event had suppressed, and later results of runs from which a repetition was
removed.
"""

from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterator, List, Optional, Sequence, Tuple, Union

from ...prolog.machine.resource_limits import Budget, Meter
from ...prolog.terms.types import Frame, Term, Values, functor
from ..dispatch.dispatcher import Dispatcher
from ..matches.consumption_policy import metered
from ..matches.match_types import PartialMatch
from .lineage_graph import LineageNode, MatchOrPair, Occurrence, Suppressed, take_unreported_derived

if TYPE_CHECKING:
    from .event_rule import EventRule
    from .kleene_node import KleeneNode
    from .lineage_graph import SuppressingNode
    from .stream_node import StreamNode

    # Nodes that compute results again without repetitions or elements whose events were retracted.
    RecomputingNode = Union[KleeneNode, StreamNode]
    RetryingNode = Union[SuppressingNode, RecomputingNode]

REV = functor("rev", 1)

RetractionStep = Callable[[Frame], Frame]
"""Function that dispatches or retries something; it takes and returns the next frame."""


class RetractionExecutor:
    """Executor of the events ``rev(E)``.

    Args:
        dispatcher: dispatches the ``rev`` events of derived events.
        budget: limits the work of retractions.
        report_nothing_retracted: called with an event that ``rev`` does not find, and the rule that retracts it.
        find_occurrences: returns the remembered events with a term that are not retracted, the oldest first.
    """

    def __init__(
        self,
        dispatcher: Dispatcher,
        budget: Budget,
        report_nothing_retracted: "Callable[[Term, Optional[EventRule]], None]",
        find_occurrences: Callable[[Term], List[Occurrence]],
    ):
        self._dispatcher = dispatcher
        self._budget = budget
        self._report_nothing_retracted = report_nothing_retracted
        self._find_occurrences = find_occurrences

    def retract(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        """Retract the events of ``rev(E)``: all occurrences of E.

        For a ``rev`` event that another retraction dispatched, only the occurrence that it names is retracted.
        """
        token = self._dispatcher.token()
        retracted = token.retracts
        retries: List[Tuple[RetryingNode, MatchOrPair]] = []
        invalidated: List[LineageNode] = []
        if retracted is None:
            retracted = self._find_occurrences(values[0])
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
        retries += [
            (suppressed.node, suppressed.match_or_pair)
            for suppressed in released_matches
            if suppressed.release()
        ]
        # A negated match that becomes valid excludes others, which must not be tried before it is stored.
        retries.sort(key=lambda retry: not retry[0].is_negated)
        return invalidated, retries

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
