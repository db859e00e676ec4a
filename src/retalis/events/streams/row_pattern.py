"""Row patterns over the elements of a partition: MATCH_RECOGNIZE.

A pattern is a sequence of variables with quantifiers, compiled into a `RowPatternNFA`. Rules call the variables
*steps*. For each partition (key), a
list of `ComputationState` is advanced by each element, ordered by preference: a state that started earlier comes
first, then greedy or reluctant quantifiers decide, as backtracking would. A match is emitted when no preferred state
can complete any more.

`RowPatternSkip` states where the search continues after a match (AFTER MATCH SKIP). By default, that is after its
last element: when a match completes, all less preferred states are dropped, those of later starts too. Otherwise,
only those of the same start are dropped, and matches may overlap: each start has a search of its own, and the match
that is emitted decides which starts are dropped.

Nothing is tried twice: two states that react alike to every future element are merged into the preferred one, as in
the simulation of regular expressions by Thompson; if matches may overlap, only states of the same start are. The cost
of an element is proportional to the number of states. Two limits bound it: at most `MAX_STATES_PER_START` states per
start, and the maximum length of the window, which counts states.

If the interval of a match is bounded, states that started too long ago are dropped at the next element of their
partition; a partition without elements for that time is dropped as a whole.
"""

from collections import OrderedDict, deque
from operator import attrgetter, itemgetter
from typing import Callable, Container, Deque, Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.errors import RuleError
from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS
from ...prolog.terms.types import Term, Values
from ...serialization.field_types import (
    COUNT,
    INSTANT,
    FieldType,
    integer,
    invalid_value,
    optional,
    sequence_of,
    tuple_of,
)
from ...serialization.state_fields import StateFields, constraint, field, rows_of
from .aggregates import Accumulator
from .row_pattern_automaton import (
    SCANNING,
    SKIP_PAST_LAST,
    SKIP_TO_FIRST,
    SKIP_TO_NEXT,
    NavigationTargets,
    RowPatternNFA,
    RowPatternSkip,
    StepTest,
)
from .stream_operators import ELEMENT, StreamElement, StreamOperator, StreamOutput, have_distinct_orders
from .windows import MAX_TRACKED_ELEMENTS, have_distinct_keys, results_or_error


def passes_tests(tests: Sequence[StepTest], state: "ComputationState", element: StreamElement) -> bool:
    """Return whether an element satisfies all tests whose navigations and aggregates have values."""
    # Called for each state and element, for which a generator takes longer than a loop.
    for test in tests:
        result = passes_test(test, state, element)
        if result is False:
            return False
    return True


def ends_step(tests: Sequence[StepTest], state: "ComputationState", element: StreamElement) -> bool:
    """Return whether an element ends a step: at least one test is applicable, and all applicable ones hold."""
    is_applicable = False
    for test in tests:
        result = passes_test(test, state, element)
        if result is False:
            return False
        is_applicable = is_applicable or result is not None
    return is_applicable


def passes_test(test: StepTest, state: "ComputationState", element: StreamElement) -> Optional[bool]:
    """Return whether an element satisfies a test; None if a navigation or an aggregate has no value."""
    elements = []
    for position in test.navigations:
        target = state.targets[position]
        if target is None:
            return None
        elements.append(target)
    if not test.aggregates:
        return test.is_satisfied(element, elements, ())
    results = []
    for number, aggregate, includes_current in test.aggregates:
        total = state.totals[number]
        result = aggregate.result(aggregate.add(total, element) if includes_current else total)
        if result is None:
            return None
        results.append(result)
    return test.is_satisfied(element, elements, tuple(results))


MAX_STATES_PER_START = 100
"""Maximum number of states with the same start; the preferred ones are kept."""

_ValueCheck = Callable[[StreamElement], Optional[bool]]
"""Rejects an element whose value a measure cannot process."""
_StepAssignments = Tuple[Tuple[StreamElement, int], ...]
"""Elements with the steps that accepted them."""


class StepClassifier(NamedTuple):
    """Names of steps as measured values (CLASSIFIER).

    Attributes:
        positions: indices in `StreamElement.values` of the values that are names.
    """

    names: Sequence[Term]
    positions: Container[int]

    def classify(self, element: StreamElement, step: int) -> StreamElement:
        """Return a copy of an element with the name of its step."""
        values = [
            self.names[step] if position in self.positions else value
            for position, value in enumerate(element.values)
        ]
        copy = StreamElement(element.match, element.start, element.end, element.key_values, tuple(values))
        copy.order = element.order
        return copy


class _MatchedElements(NamedTuple):
    """Elements of a match as a linked list, the newest first; states with a common prefix share it."""

    element: StreamElement
    step: int
    previous: "Optional[_MatchedElements]"


class CompletedMatch(NamedTuple):
    """Completed match that waits until no preferred state is left: its elements, and the order of the first one."""

    matched: _MatchedElements
    start_order: int


class ComputationState:
    """Computation state: one assignment of the elements so far to steps.

    Attributes:
        step: position of the step of the last element.
        count: number of elements of that step, capped by `RowPatternNFA.capped_count`.
        remaining_steps: after a skipped element, the positions that can still accept one; otherwise None.
        totals: states of the aggregates.
        start_order: order of its first element.
        start_time: start of the first element in ns.
    """

    __slots__ = (
        "step",
        "count",
        "remaining_steps",
        "targets",
        "totals",
        "matched",
        "start_order",
        "start_time",
    )

    def __init__(
        self,
        step: int,
        count: int,
        remaining_steps: Optional[Tuple[int, ...]],
        targets: NavigationTargets,
        totals: Values,
        matched: Optional[_MatchedElements],
        start_order: int,
        start_time: int,
    ):
        self.step = step
        self.count = count
        self.remaining_steps = remaining_steps
        self.targets = targets
        self.totals = totals
        self.matched = matched
        self.start_order = start_order
        self.start_time = start_time

    def key(self, count_class: Hashable) -> Hashable:
        """Return a key that is equal for states with the same future; ``count_class`` is the class of its count."""
        return (
            self.step,
            count_class,
            self.remaining_steps,
            tuple([id(element) for element in self.targets]),
            self.totals,
        )


_Assignments = Tuple[Tuple[int, int], ...]
"""Order and step of each element of a match."""


class StoredState(NamedTuple):
    """Stored form of a `ComputationState`, which refers to elements by their order.

    Attributes:
        step, element_count, remaining_steps: as in `ComputationState`; `element_count` is ``count`` there.
        targets: order of the element of each navigation, or None if there is none yet.
        assignments: order and step of each element of the match.
    """

    step: int
    element_count: int
    remaining_steps: Optional[Tuple[int, ...]]
    targets: Tuple[Optional[int], ...]
    assignments: _Assignments


class StoredPartition(NamedTuple):
    """Stored form of a `PartitionState`.

    Attributes:
        reference_time: the clock at its last element.
        states: its computation states in order of preference.
        completed: assignments of the waiting matches in the order of their starts.
    """

    reference_time: int
    elements: List[StreamElement]
    states: List[StoredState]
    completed: List[_Assignments]


class PartitionState:
    """State of one partition: its computation states, waiting matches, and the elements that they use.

    A completed match drops all less preferred states of its start, so all states of its start are preferred to it.

    Attributes:
        elements: elements that a state or match uses, and all elements since the oldest of them.
        states: the computation states in order of preference.
        completed: waiting matches in the order of their starts, at most one for each start.
        counted_state_count: number of states that the window has counted for this partition.
        reference_time: the clock at its last element.
    """

    __slots__ = ("elements", "states", "completed", "counted_state_count", "reference_time")

    def __init__(self, states: List[ComputationState]):
        self.elements: Deque[StreamElement] = deque()
        self.states = states
        self.counted_state_count = 0
        self.reference_time = BEFORE_ALL_INSTANTS
        self.completed: Deque[CompletedMatch] = deque()

    def first_start(self) -> Optional[int]:
        """Return the order of the first element of the most preferred state; None if no match has begun."""
        state = self.states[0]
        return None if state.matched is None else state.start_order

    def replace_completed(
        self, settled_starts: Sequence[int], matches: Sequence[CompletedMatch], drops_later: bool
    ) -> None:
        """Drop the waiting matches of some starts, and add matches of the same starts.

        Args:
            settled_starts: the starts; at most one if ``drops_later``.
            matches: the matches to add, at most one for each start.
            drops_later: whether the waiting matches of later starts are dropped, too.
        """
        if not settled_starts:
            return
        if drops_later:
            while self.completed and self.completed[-1].start_order >= settled_starts[0]:
                self.completed.pop()
            self.completed.extend(matches)
            return
        # One pass for all starts, because each element may replace the matches of many starts.
        settled = set(settled_starts)
        remaining = [match for match in self.completed if match.start_order not in settled]
        self.completed = deque(sorted([*remaining, *matches], key=attrgetter("start_order")))

    def drop_before(self, order: int) -> None:
        """Drop the states and waiting matches that began before the element with an order."""
        self.states = [state for state in self.states if state.matched is None or state.start_order >= order]
        while self.completed and self.completed[0].start_order < order:
            self.completed.popleft()

    def oldest_order(self) -> Optional[int]:
        """Return the order of the oldest element in use, or None."""
        orders = [state.start_order for state in self.states if state.matched is not None]
        if self.completed:
            orders.append(self.completed[0].start_order)
        return min(orders, default=None)


class _Successors:
    """Successor states of a partition for one element, while they are computed.

    Attributes:
        states: the states in order of preference.
        largest_counts: largest count for each key of a state.
        completed: the matches that the element completes, one for a start at most.
        settled_starts: starts that have such a match, or a state that is certain to complete. An earlier match of
            such a start is less preferred, and obsolete.
        start_order: order of the first element of the newest state.
        same_start_count: number of states with that start. Earlier starts are preferred, so equal starts are
            adjacent.
    """

    __slots__ = ("states", "largest_counts", "completed", "settled_starts", "start_order", "same_start_count")

    def __init__(self) -> None:
        self.states: List[ComputationState] = []
        self.largest_counts: Dict[Hashable, int] = {}
        self.completed: List[CompletedMatch] = []
        self.settled_starts: List[int] = []
        self.start_order = 0
        self.same_start_count = 0

    def uses(self, element: StreamElement) -> bool:
        """Return whether a state or match uses the element."""
        return bool(self.completed) or any(
            state.matched is not None and state.matched.element is element for state in self.states
        )


class RowPatternWindow(StreamOperator):
    """Window of a row pattern. See `StreamOperator`.

    Args:
        make_accumulators: creates the measures of a match.
        scopes: for each measure the step that it is restricted to, or None.
        nfa: the automaton.
        skip: where the search for the next match begins.
        classifier: names of steps as measured values.
    """

    STATE = StateFields(
        field("late_count", COUNT),
        field("_order", COUNT),
        field("clock", INSTANT),
        field("partitions", lambda window: window.partitions_type()),
        constraint(
            "elements with distinct orders",
            lambda window, state: have_distinct_orders(
                [element for partition in state["partitions"] for element in partition.elements],
                state["order"],
            ),
        ),
        constraint(
            "distinct partitions, each with one key",
            lambda window, state: have_distinct_keys(
                [partition.elements for partition in state["partitions"]]
            ),
        ),
        constraint(
            "valid computation states of a row pattern",
            lambda window, state: all(map(window.can_continue, state["partitions"])),
        ),
    )

    KEY_BYTES, ELEMENT_BYTES = 1600, 1100

    def __init__(
        self,
        make_accumulators: Callable[[], Sequence[Accumulator]],
        scopes: Sequence[Optional[int]],
        nfa: RowPatternNFA,
        skip: RowPatternSkip,
        classifier: "StepClassifier",
    ):
        super().__init__()
        self.make_accumulators = make_accumulators
        self.scopes = scopes
        self.nfa = nfa
        self.skip = skip
        self._classifier = classifier
        self._overlaps = skip.strategy != SKIP_PAST_LAST
        self._checks: List[_ValueCheck] = []
        self._checks_of: List[List[_ValueCheck]] = [[] for _ in nfa.variables]
        for measure, scope in zip(make_accumulators(), scopes):
            if measure.checks_values:
                (self._checks if scope is None else self._checks_of[scope]).append(measure.check)
        self.states: OrderedDict[Hashable, PartitionState] = OrderedDict()
        self._element_count = 0
        self._state_count = 0
        self._order = 0
        self._end = BEFORE_ALL_INSTANTS

    def __len__(self) -> int:
        """Return the number of elements or of states, whichever is larger."""
        return max(self._element_count, self._state_count)

    def _scanning_state(self) -> ComputationState:
        nfa = self.nfa
        targets: NavigationTargets = (None,) * len(nfa.navigations)
        return ComputationState(SCANNING, 0, None, targets, nfa.initial_totals, None, 0, 0)

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        for check in self._checks:
            check(element)
        clock, end, idle = self.clock, element.end, self._max_idle_time
        if clock < end and (end <= self.max_timestamp or not self._is_too_far_ahead(end)):
            clock = end
        partition = self.states.get(element.key)
        if partition is None or (idle is not None and partition.reference_time < clock - idle):
            partition = PartitionState([self._scanning_state()])
        states = self._active_states(partition, clock)
        meter = self.meter
        if meter is not None and meter(len(states)):
            return []
        element.order = self._order + 1
        # A condition or check may raise an error. The element, the clock and the partition are changed only after
        # this call, so a rejected element leaves no trace.
        successors = self._successors(states, element)
        self._order += 1
        self.clock, self._end = clock, end
        if idle is not None:
            self._drop_idle_keys()
        partition.reference_time = clock
        if successors.uses(element):
            self._element_count += 1
            partition.elements.append(element)
        decided_matches = self._replace_states(partition, successors)
        if element.key in self.states:
            self.states.move_to_end(element.key)
        self._store_partition(partition, element.key)
        return self._outputs(decided_matches)

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._limit_reference_times()

    def _active_states(self, partition: PartitionState, clock: int) -> List[ComputationState]:
        """Return the states of a partition that may still complete."""
        span = self._max_span
        return partition.states if span is None else self._states_started_since(partition, clock - span)

    def _states_started_since(self, partition: PartitionState, min_start: int) -> List[ComputationState]:
        """Return the states of a partition, without those that started before an instant."""
        if all(state.start_time >= min_start or state.matched is None for state in partition.states):
            return partition.states
        remaining_states = [
            state for state in partition.states if state.start_time >= min_start or state.matched is None
        ]
        return self._with_scanning(remaining_states)

    def _with_scanning(self, states: List[ComputationState]) -> List[ComputationState]:
        """Return the remaining states of a partition, with the scanning state at the end."""
        if not states or states[-1].step != SCANNING:
            states.append(self._scanning_state())
        return states

    def _replace_states(self, partition: PartitionState, successors: _Successors) -> List[CompletedMatch]:
        """Replace the computation states of a partition, and return the matches that are now decided."""
        partition.replace_completed(
            successors.settled_starts, successors.completed, drops_later=not self._overlaps
        )
        partition.states = successors.states
        return self._pop_decided(partition)

    def _pop_decided(self, partition: PartitionState) -> List[CompletedMatch]:
        """Remove and return the completed matches to which no state is preferred any more."""
        if not partition.completed:
            return []
        if self.skip.strategy == SKIP_TO_NEXT:
            # No match depends on one of another start.
            open_starts = {state.start_order for state in partition.states if state.matched is not None}
            decided = [match for match in partition.completed if match.start_order not in open_starts]
            partition.completed = deque(
                [match for match in partition.completed if match.start_order in open_starts]
            )
            return decided
        decided = []
        while partition.completed:
            first_start = partition.first_start()
            if first_start is not None and first_start <= partition.completed[0].start_order:
                break
            match = partition.completed.popleft()
            decided.append(match)
            if self._overlaps:
                partition.drop_before(self._next_start(match))
        return decided

    def _next_start(self, match: CompletedMatch) -> int:
        """Return the order of the first element at which a match may begin after another one."""
        assignments = _list_assignments(match.matched)
        orders = [element.order for element, step in assignments if step == self.skip.step]
        if not orders:
            return assignments[-1][0].order + 1
        order = orders[0] if self.skip.strategy == SKIP_TO_FIRST else orders[-1]
        if order == match.start_order:
            # The same match would be found again and again.
            self.endless_skip_count += 1
            return order + 1
        return order

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`; drops states of the least recently used partition.

        The states that use its oldest element are dropped, and matches that have waited for them are emitted.
        """
        key, partition = next(iter(self.states.items()))
        oldest_order = partition.elements[0].order
        remaining_states = [
            state for state in partition.states if state.matched is None or state.start_order != oldest_order
        ]
        partition.states = self._with_scanning(remaining_states)
        decided_matches = self._pop_decided(partition)
        self._store_partition(partition, key)
        return self._outputs(decided_matches)

    def _drop_key(self, key: Hashable) -> None:
        """Drop a partition; matches that wait in it are lost."""
        partition = self.states.pop(key)
        self._element_count -= len(partition.elements)
        self._state_count -= partition.counted_state_count

    def _store_partition(self, partition: PartitionState, key: Hashable) -> None:
        """Store a partition, count its states, and drop elements that are not used by any state."""
        oldest_order = partition.oldest_order()
        state_count = (
            0 if oldest_order is None else len(partition.states) - (partition.states[-1].step == SCANNING)
        )
        self._state_count += state_count - partition.counted_state_count
        partition.counted_state_count = state_count
        if oldest_order is not None:
            # The place of a known key does not change: only an element is a use of its key.
            self.states[key] = partition
            if len(self.states) > self._max_keys:
                self._evict_keys()
            # Elements are dropped in order of arrival; those between used ones stay until the oldest use ends.
            while partition.elements[0].order < oldest_order:
                partition.elements.popleft()
                self._element_count -= 1
        else:
            self._element_count -= len(partition.elements)
            self.states.pop(key, None)

    def _successors(self, states: Sequence[ComputationState], element: StreamElement) -> _Successors:
        """Return the successor states for an element.

        A completed match, or one that is certain to complete, makes all less preferred states of its start obsolete
        and, unless matches may overlap, those of later starts, too.
        """
        successors = _Successors()
        for state in states:
            settled = successors.settled_starts
            if settled and state.matched is not None and state.start_order == settled[-1]:
                continue
            accepting, skipping = self._accepting_steps(state, element)
            for step in accepting:
                if self._accept(state, step, element, successors):
                    if not self._overlaps:
                        return successors
                    break
            if state.step == SCANNING:
                successors.states.append(state)
            # An element is skipped only if no step accepts it: skipping is not an alternative to accepting.
            elif not accepting and skipping:
                successor = ComputationState(
                    state.step,
                    state.count,
                    skipping,
                    state.targets,
                    state.totals,
                    state.matched,
                    state.start_order,
                    state.start_time,
                )
                if self._add(successor, successors) and self.nfa.can_never_fail(skipping):
                    successors.settled_starts.append(state.start_order)
                    if not self._overlaps:
                        return successors
        return successors

    def _accepting_steps(
        self, state: ComputationState, element: StreamElement
    ) -> Tuple[List[int], Tuple[int, ...]]:
        """Return the steps that accept an element, and the steps that remain if the element is skipped."""
        steps = self.nfa.steps
        transitions = self.nfa.transitions_after(state.step, state.count)
        candidates = transitions.steps if state.remaining_steps is None else state.remaining_steps
        continuing_steps = [
            step
            for step in candidates
            if not (steps[step].until and ends_step(steps[step].until, state, element))
        ]
        accepting = [step for step in continuing_steps if passes_tests(steps[step].tests, state, element)]
        skipping = tuple([step for step in continuing_steps if steps[step].skips_rows])
        if not accepting and skipping:
            for step in transitions.blocking:
                # A reluctant step has no `until`. After a skipped element, only `skips_rows` steps can follow.
                if (state.remaining_steps is None or steps[step].skips_rows) and passes_tests(
                    steps[step].tests, state, element
                ):
                    return accepting, ()
        return accepting, skipping

    def _accept(
        self, state: ComputationState, step: int, element: StreamElement, successors: _Successors
    ) -> bool:
        """Add the state after a step has accepted an element; return whether less preferred states are obsolete."""
        nfa = self.nfa
        number = nfa.step_numbers[step]
        for check in self._checks_of[number]:
            check(element)
        count = nfa.capped_count(step, state.count + 1 if state.step == step else 1)
        matched = _MatchedElements(element, number, state.matched)
        start_order, start_time = (
            (element.order, element.start) if state.matched is None else (state.start_order, state.start_time)
        )
        next_steps, may_end, steps_after_skip, _ = nfa.transitions_after(step, count)
        # `steps_after_skip` is set if all steps skip elements: the state then equals the one after a skip.
        if next_steps:
            targets = nfa.advance_navigations(state.targets, number, element)
            totals = nfa.advance_totals(state.totals, number, element) if nfa.aggregates else ()
            is_present = self._add(
                ComputationState(
                    step,
                    count,
                    steps_after_skip,
                    targets,
                    totals,
                    matched,
                    start_order,
                    start_time,
                ),
                successors,
            )
            if is_present and not may_end and nfa.can_never_fail(next_steps):
                successors.settled_starts.append(start_order)
                return True
        if may_end:
            successors.settled_starts.append(start_order)
            successors.completed.append(CompletedMatch(matched, start_order))
            # The search for the next match starts after this one. If matches may overlap, it has not been stopped.
            if not self._overlaps:
                successors.states.append(self._scanning_state())
        return may_end

    def _add(self, state: ComputationState, successors: _Successors) -> bool:
        """Add a state unless a preferred one subsumes it; return whether either of them is present."""
        # Two states with equal keys accept the same future elements with the same navigations.
        key = state.key(self.nfa.count_class(state.step, state.count))
        if self._overlaps:
            # A later start has a match of its own.
            key = (state.start_order, key)
        # States are added in order of preference, so one with the same key and at least this count is preferred and
        # completes no later: the new one can never win.
        if successors.largest_counts.get(key, -1) >= state.count:
            return True
        if state.start_order != successors.start_order:
            successors.start_order, successors.same_start_count = state.start_order, 0
        if successors.same_start_count >= MAX_STATES_PER_START:
            # The least preferred states are lost; the count is reported.
            self.pruned_count += 1
            return False
        successors.same_start_count += 1
        successors.largest_counts[key] = state.count
        successors.states.append(state)
        return True

    def _outputs(self, decided_matches: Sequence[CompletedMatch]) -> List[StreamOutput]:
        outputs = [self._output(match) for match in decided_matches]
        return [output for output in outputs if output is not None]

    def _output(self, completed: CompletedMatch) -> Optional[StreamOutput]:
        """Return the output of a match, or None if a measure has no result."""
        return self._make_output(completed.matched, self._end)

    def _make_output(self, matched: _MatchedElements, earliest_end: int) -> Optional[StreamOutput]:
        """Return the output of elements, or None if a measure has no result.

        Args:
            matched: the elements.
            earliest_end: its end in ns, unless one of the elements ends later.
        """
        assignments = _list_assignments(matched)
        meter = self.meter
        if meter is not None and meter(len(assignments)):
            return None
        elements = [element for element, _ in assignments]
        start = min(element.start for element in elements)
        end = max(earliest_end, *(element.end for element in elements))
        contributors = tuple(elements[-MAX_TRACKED_ELEMENTS:]) if self.tracks_elements else (elements[-1],)
        results, error = results_or_error(lambda: self._results(assignments))
        return None if results is None else StreamOutput(contributors, start, end, results, error)

    def _results(self, assignments: _StepAssignments) -> Optional[Values]:
        """Return the results of the measures of a match, or None if one has no result."""
        results = []
        if self._classifier.positions:
            assignments = tuple(
                [(self._classifier.classify(*assigned), assigned[1]) for assigned in assignments]
            )
        for measure, scope in zip(self.make_accumulators(), self.scopes):
            # Accumulators are created for each match, because matches are not known before they end.
            elements = deque([element for element, step in assignments if scope is None or step == scope])
            for element in elements:
                measure.add(element)
            result = measure.result(elements, len(elements)) if elements or measure.accepts_empty else None
            if result is None:
                return None
            results.append(result)
        return tuple(results)

    @property
    def partitions(self) -> List[StoredPartition]:
        """The partitions, the least recently used one first; states and matches refer to elements by their order."""
        return [
            StoredPartition(
                partition.reference_time,
                list(partition.elements),
                [_stored_state(state) for state in partition.states],
                [_to_orders(_list_assignments(match.matched)) for match in partition.completed],
            )
            for partition in self.states.values()
        ]

    @partitions.setter
    def partitions(self, partitions: Sequence[StoredPartition]) -> None:
        # If elements are missing, the remaining ones are processed again.
        self.states.clear()
        self._element_count = self._state_count = 0
        for reference_time, elements, states, completed in partitions:
            if elements:
                self._restore_partition(reference_time, elements, states, completed)

    def partitions_type(self) -> FieldType[List[StoredPartition]]:
        """Return the type of `partitions`, which depends on the number of steps."""
        position = integer(0, len(self.nfa.steps) - 1)
        assignments = sequence_of(tuple_of(COUNT, integer(0, len(self.nfa.variables) - 1)), tuple)
        states = rows_of(
            StoredState,
            step=integer(SCANNING, len(self.nfa.steps) - 1),
            element_count=COUNT,
            remaining_steps=optional(sequence_of(position, tuple, min_count=1)),
            targets=sequence_of(optional(COUNT), tuple),
            assignments=assignments,
        )
        return rows_of(
            StoredPartition,
            reference_time=INSTANT,
            elements=sequence_of(ELEMENT, min_count=1),
            states=states,
            completed=sequence_of(assignments),
        )

    def can_continue(self, partition: StoredPartition) -> bool:
        """Return whether the computation states of a partition are consistent.

        The operator relies on these invariants: computation states and completed matches refer to elements of their
        partition, in order, and each state has an element for each navigation.
        """
        _, elements, states, completed = partition
        orders = [element.order for element in elements]
        targets = [order for state in states for order in state.targets if order is not None]
        assigned = [
            order for pairs in (*(state.assignments for state in states), *completed) for order, _ in pairs
        ]
        starts = [state.assignments[0][0] for state in states if state.assignments]
        completed_starts = [pairs[0][0] for pairs in completed if pairs]
        return (
            bool(states)
            and all(completed)
            and orders == sorted(orders)
            and {*targets, *assigned} <= set(orders)
            and all(len(state.targets) == len(self.nfa.navigations) for state in states)
            and all(bool(state.assignments) == (state.step != SCANNING) for state in states)
            and all(
                list(state.assignments) == sorted(state.assignments, key=itemgetter(0)) for state in states
            )
            and starts == sorted(starts)
            and all(state.step != SCANNING for state in states[:-1])
            # A match waits for a state that is preferred to it.
            and completed_starts == sorted(set(completed_starts))
            and (not completed_starts or (bool(starts) and starts[0] <= completed_starts[0]))
            # Otherwise all states of the partition could fail, and no state would remain to process the next element.
            and any(state.step == SCANNING or self._is_certain(state) for state in states)
        )

    def _is_certain(self, state: StoredState) -> bool:
        """Return whether a computation state is certain to complete."""
        steps = state.remaining_steps
        if steps is None:
            steps = self.nfa.transitions_after(state.step, state.element_count).steps
        return bool(steps) and self.nfa.can_never_fail(steps)

    def _restore_partition(
        self,
        reference_time: int,
        elements: List[StreamElement],
        states: Sequence[StoredState],
        completed: Sequence[_Assignments],
    ) -> None:
        element_by_order = {element.order: element for element in elements}
        partition = PartitionState([self._scanning_state()])
        partition.reference_time = reference_time
        partition.elements.extend(elements)
        self._element_count += len(elements)
        try:
            partition.completed.extend(
                CompletedMatch(_matched_elements(match, element_by_order), match[0][0]) for match in completed
            )
            partition.states = [self._state_of(state, element_by_order) for state in states]
        except RuleError as error:
            raise invalid_value(
                elements[0].key_values, f"a row pattern with valid values: {error.message}"
            ) from None
        except KeyError:
            # Elements are missing.
            partition.completed.clear()
            partition.states = [self._scanning_state()]
            for element in elements:
                self._replace_states(partition, self._successors(partition.states, element))
        self._store_partition(partition, elements[0].key)

    def _state_of(self, stored: StoredState, element_by_order: Dict[int, StreamElement]) -> ComputationState:
        """Return the state whose stored form `_stored_state` has returned."""
        step, count, remaining_steps, target_orders, assignments = stored
        targets = tuple([None if order is None else element_by_order[order] for order in target_orders])
        if not assignments:
            return ComputationState(
                step, count, remaining_steps, targets, self.nfa.initial_totals, None, 0, 0
            )
        totals = self.nfa.initial_totals
        for order, assigned_step in assignments:
            totals = self.nfa.advance_totals(totals, assigned_step, element_by_order[order])
        start_order = assignments[0][0]
        return ComputationState(
            step,
            count,
            remaining_steps,
            targets,
            totals,
            _matched_elements(assignments, element_by_order),
            start_order,
            element_by_order[start_order].start,
        )


def _matched_elements(
    assignments: Sequence[Tuple[int, int]], element_by_order: Dict[int, StreamElement]
) -> _MatchedElements:
    matched: Optional[_MatchedElements] = None
    for order, step in assignments:
        matched = _MatchedElements(element_by_order[order], step, matched)
    # A match has at least one element.
    assert matched is not None
    return matched


def _list_assignments(matched: Optional[_MatchedElements]) -> _StepAssignments:
    """Return the elements of a match with their steps, the oldest first."""
    assignments = []
    while matched is not None:
        assignments.append((matched.element, matched.step))
        matched = matched.previous
    return tuple(reversed(assignments))


def _stored_state(state: ComputationState) -> StoredState:
    return StoredState(
        state.step,
        state.count,
        state.remaining_steps,
        tuple([None if element is None else element.order for element in state.targets]),
        _to_orders(_list_assignments(state.matched)),
    )


def _to_orders(assignments: _StepAssignments) -> _Assignments:
    return tuple([(element.order, step) for element, step in assignments])
