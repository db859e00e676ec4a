"""Row patterns whose matches do not complete in time: the side output of timed-out partial matches of Flink CEP.

`RowPatternTimeouts` runs a row pattern as `RowPatternWindow` does, and emits the opposite: complete matches have no
output, and each start that is neither complete nor failed a given time after its first element has one. The measures
are those of its most preferred state.
"""

import heapq
from operator import attrgetter
from typing import Callable, Dict, Hashable, List, Optional, Sequence, Tuple

from ...serialization.stored_field_types import State
from .aggregates import Accumulator
from .row_pattern import RowPatternWindow, StepClassifier
from .row_pattern_automaton import RowPatternNFA, RowPatternSkip
from .row_pattern_states import CompletedMatch, ComputationState, PartitionState
from .stream_operators import KeyBounds, StreamElement, StreamOutput


class RowPatternTimeouts(RowPatternWindow):
    """Window of the matches of a row pattern that are not complete in time. See `StreamOperator`.

    Args:
        make_accumulators: creates the measures of a match.
        scopes: for each measure the step that it is restricted to, or None.
        nfa: the automaton.
        skip: where the search for the next match begins.
        classifier: names of steps as measured values.
        timeout: time in ns from the start of the first element of a match to its output.
    """

    def __init__(
        self,
        make_accumulators: Callable[[], Sequence[Accumulator]],
        scopes: Sequence[Optional[int]],
        nfa: RowPatternNFA,
        skip: RowPatternSkip,
        classifier: StepClassifier,
        timeout: int,
    ):
        super().__init__(make_accumulators, scopes, nfa, skip, classifier)
        self._timeout = timeout
        # Deadlines with the orders of the first elements and the keys; those of failed matches remain for a while.
        self._deadlines: List[Tuple[int, int, Hashable]] = []

    def set_bounds(self, bounds: KeyBounds) -> None:
        """See `StreamOperator.set_bounds`."""
        super().set_bounds(bounds)
        # The deadlines end the states of each key. Without new elements, too, its matches have to time out.
        self._max_idle_time = None

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        last_order, previous = self._order, self.states.get(element.key)
        waiting_states = [] if previous is None else self._waiting_states(previous)
        super().process(element, now, channel)
        # The budget for pattern work is exhausted.
        if self._order == last_order:
            return []
        partition = self.states.get(element.key)
        if partition is not None and any(state.start_order == element.order for state in partition.states):
            heapq.heappush(self._deadlines, (element.start + self._timeout, element.order, element.key))
        self._update_deadline()
        # Its end has reached deadlines that no alarm has served yet.
        return self._timeout_outputs([state for state in waiting_states if self._is_due(state, self.clock)])

    def advance_to(self, instant: int) -> List[StreamOutput]:
        """See `StreamOperator.advance_to`."""
        due_states: List[ComputationState] = []
        while self._deadlines and self._deadlines[0][0] <= instant:
            _, _, key = heapq.heappop(self._deadlines)
            partition = self.states.get(key)
            if partition is None:
                continue
            due_states += [state for state in self._waiting_states(partition) if self._is_due(state, instant)]
            partition.states = self._with_scanning(
                [state for state in partition.states if not self._is_due(state, instant)]
            )
            self._pop_decided(partition)
            self._store_partition(partition, key)
        self._update_deadline()
        # The deadline of a match that has failed leads to the other matches of its key. A restored operator has no
        # such deadlines, so their order must not decide that of the outputs.
        due_states.sort(key=attrgetter("start_time", "start_order"))
        return sorted(self._timeout_outputs(due_states), key=attrgetter("end"))

    def restore(self, saved: State) -> None:
        """See `StateOwner.restore`."""
        super().restore(saved)
        self._collect_deadlines()
        self._update_deadline()

    def _is_due(self, state: ComputationState, instant: int) -> bool:
        return state.matched is not None and state.start_time + self._timeout <= instant

    def _active_states(self, partition: PartitionState, clock: int) -> List[ComputationState]:
        min_start = clock - self._timeout + 1
        if self._max_span is not None:
            min_start = max(min_start, clock - self._max_span)
        return self._states_started_since(partition, min_start)

    @staticmethod
    def _waiting_states(partition: PartitionState) -> List[ComputationState]:
        """Return the most preferred state of each start that has no complete match."""
        completed_starts = {match.start_order for match in partition.completed}
        states: Dict[int, ComputationState] = {}
        for state in partition.states:
            if state.matched is not None and state.start_order not in completed_starts:
                states.setdefault(state.start_order, state)
        return list(states.values())

    def _timeout_outputs(self, states: Sequence[ComputationState]) -> List[StreamOutput]:
        outputs = [
            self._make_output(state.matched, state.start_order, state.start_time + self._timeout)
            for state in states
            if state.matched is not None
        ]
        return [output for output in outputs if output is not None]

    def _outputs(self, decided_matches: Sequence[CompletedMatch]) -> List[StreamOutput]:
        """Return no outputs: a match that completes in time has none."""
        return []

    def _update_deadline(self) -> None:
        """Set the next deadline; remove entries of matches that have ended if they are the majority."""
        if len(self._deadlines) > 2 * self._state_count + 64:
            self._collect_deadlines()
        while self._deadlines and self._deadlines[0][2] not in self.states:
            heapq.heappop(self._deadlines)
        self.next_deadline = self._deadlines[0][0] if self._deadlines else None

    def _collect_deadlines(self) -> None:
        self._deadlines = list(
            {
                (state.start_time + self._timeout, state.start_order, key)
                for key, partition in self.states.items()
                for state in partition.states
                if state.matched is not None
            }
        )
        heapq.heapify(self._deadlines)
