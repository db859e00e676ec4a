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
from typing import Callable, Container, Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple

from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS
from ...prolog.terms.types import Term, Values
from ...serialization.state_fields import StateFields, constraint, field, rows_of
from ...serialization.stored_field_types import (
    COUNT,
    INSTANT,
    FieldType,
    integer,
    optional,
    sequence_of,
    tuple_of,
)
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
from .row_pattern_states import (
    CompletedMatch,
    ComputationState,
    PartitionState,
    SharedBufferNode,
    StepAssignments,
    StoredMatch,
    StoredNode,
    StoredPartition,
    StoredState,
    are_paths,
    list_assignments,
    stored_partition,
)
from .stream_operators import ELEMENT, StreamElement, StreamOperator, StreamOutput, have_distinct_orders
from .windows import MAX_TRACKED_ELEMENTS, have_distinct_keys, results_or_error


def passes_tests(tests: Sequence[StepTest], state: ComputationState, element: StreamElement) -> bool:
    """Return whether an element satisfies all tests whose navigations and aggregates have values."""
    # Called for each state and element, for which a generator takes longer than a loop.
    for test in tests:
        result = passes_test(test, state, element)
        if result is False:
            return False
    return True


def ends_step(tests: Sequence[StepTest], state: ComputationState, element: StreamElement) -> bool:
    """Return whether an element ends a step: at least one test is applicable, and all applicable ones hold."""
    is_applicable = False
    for test in tests:
        result = passes_test(test, state, element)
        if result is False:
            return False
        is_applicable = is_applicable or result is not None
    return is_applicable


def passes_test(test: StepTest, state: ComputationState, element: StreamElement) -> Optional[bool]:
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

    __slots__ = (
        "states",
        "largest_counts",
        "completed",
        "settled_starts",
        "start_order",
        "same_start_count",
        "_nodes",
    )

    def __init__(self) -> None:
        self.states: List[ComputationState] = []
        self.largest_counts: Dict[Hashable, int] = {}
        self.completed: List[CompletedMatch] = []
        self.settled_starts: List[int] = []
        self.start_order = 0
        self.same_start_count = 0
        # Nodes of the element by step and previous node; with None, the newest node of the step.
        self._nodes: Dict[Tuple[int, Optional[SharedBufferNode]], SharedBufferNode] = {}

    def node_of(
        self, element: StreamElement, step: int, previous: Optional[SharedBufferNode]
    ) -> SharedBufferNode:
        """Return the node of the element after another node, or as the first one of a match.

        A new match shares the node of an earlier one: the nodes before its start are not part of it. If both assign
        the same steps to later elements, they have all nodes in common.
        """
        node = self._nodes.get((step, previous))
        if node is None:
            node = SharedBufferNode(element, step, previous)
            self._nodes[step, previous] = self._nodes[step, None] = node
        return node

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
        partition.release_nodes()
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
        remaining_states = [
            state for state in partition.states if state.start_time >= min_start or state.matched is None
        ]
        if len(remaining_states) == len(partition.states):
            return partition.states
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
        assignments = list_assignments(match.matched, match.start_order)
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
        oldest_order = partition.first_start()
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
            self._element_count -= partition.drop_elements_before(oldest_order)
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
            elif skipping:
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
        """Return the steps that accept an element; if there are none, also those that remain if it is skipped."""
        steps = self.nfa.steps
        transitions = self.nfa.transitions_after(state.step, state.count)
        candidates = transitions.steps if state.remaining_steps is None else state.remaining_steps
        continuing_steps = [
            step
            for step in candidates
            if not (steps[step].until and ends_step(steps[step].until, state, element))
        ]
        accepting = [step for step in continuing_steps if passes_tests(steps[step].tests, state, element)]
        if accepting:
            return accepting, ()
        skipping = tuple([step for step in continuing_steps if steps[step].skips_rows])
        if skipping:
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
        matched = successors.node_of(element, number, state.matched)
        start_order, start_time = (
            (element.order, element.start) if state.matched is None else (state.start_order, state.start_time)
        )
        next_steps, may_end, steps_after_skip, _ = nfa.transitions_after(step, count)
        # `steps_after_skip` is set if all steps skip elements: the state then equals the one after a skip.
        if next_steps:
            targets = nfa.advance_navigations(state.targets, number, element) if nfa.navigations else ()
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
        return self._make_output(completed.matched, completed.start_order, self._end)

    def _make_output(
        self, matched: SharedBufferNode, start_order: int, earliest_end: int
    ) -> Optional[StreamOutput]:
        """Return the output of a match, or None if a measure has no result.

        Args:
            matched: node of its last element.
            start_order: order of its first element.
            earliest_end: its end in ns, unless one of the elements ends later.
        """
        assignments = list_assignments(matched, start_order)
        meter = self.meter
        if meter is not None and meter(len(assignments)):
            return None
        elements = [element for element, _ in assignments]
        start = min(element.start for element in elements)
        end = max(earliest_end, *(element.end for element in elements))
        contributors = tuple(elements[-MAX_TRACKED_ELEMENTS:]) if self.tracks_elements else (elements[-1],)
        results, error = results_or_error(lambda: self._results(assignments))
        if results is None:
            return None
        omitted_count = len(elements) - len(contributors) if self.tracks_elements else 0
        return StreamOutput(contributors, start, end, results, error, omitted_count)

    def _results(self, assignments: StepAssignments) -> Optional[Values]:
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

    def partial_match_steps(self) -> List[List[int]]:
        """Return the numbers of the steps of the elements of each partial match."""
        return [
            [step for _, step in list_assignments(state.matched, state.start_order)]
            for partition in self.states.values()
            for state in partition.states
            if state.matched is not None
        ]

    @property
    def partitions(self) -> List[StoredPartition]:
        """The partitions, the least recently used one first; states and matches refer to elements by their order."""
        return list(map(stored_partition, self.states.values()))

    @partitions.setter
    def partitions(self, partitions: Sequence[StoredPartition]) -> None:
        # If elements are missing, the remaining ones are processed again.
        self.states.clear()
        self._element_count = self._state_count = 0
        for partition in partitions:
            if partition.elements:
                self._restore_partition(partition)

    def partitions_type(self) -> FieldType[List[StoredPartition]]:
        """Return the type of `partitions`, which depends on the number of steps."""
        nfa = self.nfa
        state_types = [aggregate.function.make_fold(None).state_type for aggregate in nfa.aggregates]
        nodes = rows_of(
            StoredNode,
            element=COUNT,
            step=integer(0, len(nfa.variables) - 1),
            previous=optional(COUNT),
        )
        states = rows_of(
            StoredState,
            step=integer(SCANNING, len(nfa.steps) - 1),
            element_count=COUNT,
            remaining_steps=optional(sequence_of(integer(0, len(nfa.steps) - 1), tuple, min_count=1)),
            targets=sequence_of(optional(COUNT), tuple),
            totals=tuple_of(*state_types),
            last_node=optional(COUNT),
            start_order=COUNT,
        )
        completed = rows_of(
            StoredMatch,
            last_node=COUNT,
            start_order=COUNT,
        )
        return rows_of(
            StoredPartition,
            reference_time=INSTANT,
            elements=sequence_of(ELEMENT, min_count=1),
            nodes=nodes,
            states=states,
            completed=completed,
        )

    def can_continue(self, partition: StoredPartition) -> bool:
        """Return whether the computation states of a partition are consistent.

        The operator relies on these invariants: computation states and completed matches refer to elements of their
        partition, in order, and each state has an element for each navigation.
        """
        _, elements, nodes, states, completed = partition
        orders = [element.order for element in elements]
        targets = [order for state in states for order in state.targets if order is not None]
        matches = [(match.last_node, match.start_order) for match in completed]
        matches += [(state.last_node, state.start_order) for state in states if state.last_node is not None]
        starts = [state.start_order for state in states if state.last_node is not None]
        completed_starts = [match.start_order for match in completed]
        return (
            bool(states)
            and orders == sorted(orders)
            and {*targets, *(node.element for node in nodes)} <= set(orders)
            and all(len(state.targets) == len(self.nfa.navigations) for state in states)
            and all((state.last_node is None) == (state.step == SCANNING) for state in states)
            and are_paths(nodes, matches)
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

    def _restore_partition(self, stored: StoredPartition) -> None:
        element_by_order = {element.order: element for element in stored.elements}
        partition = PartitionState([self._scanning_state()])
        partition.reference_time = stored.reference_time
        partition.elements.extend(stored.elements)
        self._element_count += len(stored.elements)
        try:
            nodes: List[SharedBufferNode] = []
            for order, step, previous in stored.nodes:
                previous_node = None if previous is None else nodes[previous]
                nodes.append(SharedBufferNode(element_by_order[order], step, previous_node))
            states = [self._state_of(state, nodes, element_by_order) for state in stored.states]
        except KeyError:
            # Elements are missing.
            for element in stored.elements:
                self._replace_states(partition, self._successors(partition.states, element))
        else:
            partition.states = states
            partition.completed.extend(
                CompletedMatch(nodes[last_node], start_order) for last_node, start_order in stored.completed
            )
        self._store_partition(partition, stored.elements[0].key)

    def _state_of(
        self,
        stored: StoredState,
        nodes: Sequence[SharedBufferNode],
        element_by_order: Dict[int, StreamElement],
    ) -> ComputationState:
        """Return the state whose stored form `stored_partition` has returned."""
        if stored.last_node is None:
            return self._scanning_state()
        return ComputationState(
            stored.step,
            stored.element_count,
            stored.remaining_steps,
            tuple([None if order is None else element_by_order[order] for order in stored.targets]),
            stored.totals,
            nodes[stored.last_node],
            stored.start_order,
            element_by_order[stored.start_order].start,
        )
