"""Row patterns over the elements of a partition: MATCH_RECOGNIZE with ``AFTER MATCH SKIP PAST LAST ROW``.

A pattern is a sequence of variables with quantifiers, compiled into a `RowPatternNFA`. Rules call the variables
*steps*. For each partition (key), a
list of `ComputationState` is advanced by each element, ordered by preference: a state that started earlier comes
first, then greedy or reluctant quantifiers decide, as backtracking would. A match is emitted when no preferred state
can complete any more; all less preferred states are dropped with it, so matches do not overlap.

Nothing is tried twice: two states that react alike to every future element are merged into the preferred one, as in
the simulation of regular expressions by Thompson. The cost of an element is proportional to the number of states. Two
limits bound it: at most `MAX_STATES_PER_START` states per start, and the maximum length of the window, which counts
states.

If the interval of a match is bounded, states that started too long ago are dropped at the next element of their
partition; a partition without elements for that time is dropped as a whole.
"""

from collections import OrderedDict, deque
from operator import itemgetter
from typing import Callable, Deque, Dict, Hashable, List, NamedTuple, Optional, Sequence, Tuple, Union

from ...prolog.terms.timestamps import BEFORE_ALL_INSTANTS
from ...prolog.terms.types import Values
from ...serialization.field_types import COUNT, INSTANT, FieldType, integer, optional, sequence_of, tuple_of
from ...serialization.state_fields import StateFields, constraint, field, rows_of
from .aggregates import Accumulator
from .stream_operators import ELEMENT, StreamElement, StreamOperator, StreamOutput, have_distinct_orders
from .windows import MAX_TRACKED_ELEMENTS, have_distinct_keys, results_or_error

NavigatedElements = Sequence[StreamElement]
"""Elements that the navigations of a condition refer to."""
NavigationTargets = Tuple[Optional[StreamElement], ...]
"""Element of each navigation of a match, or None if there is none yet."""
SCANNING = -1
"""Step of a state in which no match has started."""


class StepTest(NamedTuple):
    """Condition of a step, or a part of it that uses other navigations.

    Attributes:
        navigations: indices of the navigations that it uses; it is skipped while a navigation has no element.
        is_satisfied: returns whether the condition holds for an element and these navigations.
    """

    navigations: Tuple[int, ...]
    is_satisfied: Callable[[StreamElement, NavigatedElements], bool]


class RowPatternVariable(NamedTuple):
    """Pattern variable with its quantifier and conditions.

    Attributes:
        min_count: minimum number of elements.
        max_count: maximum number of elements; None for no limit.
        reluctant: whether fewer elements are preferred.
        skips_rows: whether elements that no step accepts may lie before each of its own (skip till next match).
        tests: conditions for its elements.
        until: end condition: an element that satisfies it is not accepted and ends the variable.
    """

    min_count: int
    max_count: Optional[int]
    reluctant: bool
    skips_rows: bool
    tests: Tuple[StepTest, ...]
    until: Tuple[StepTest, ...]


class StepTransitions(NamedTuple):
    """Transitions of a computation state.

    Attributes:
        steps: steps that may accept the next element, in order of preference.
        may_end: whether the match may end instead.
        steps_after_skip: the same steps if all of them and of ``blocking`` skip elements that do not fit, else None.
        blocking: steps that are less preferred than the end. They never accept an element, because the match ends
            first, but an element that such a step would accept is not skipped.
    """

    steps: Tuple[int, ...]
    may_end: bool
    steps_after_skip: Optional[Tuple[int, ...]]
    blocking: Tuple[int, ...]


class StepNavigation(NamedTuple):
    """Navigation of conditions: to the last element of a match, or to the first or last one of a step."""

    kind: str
    step: int


_NO_TRANSITIONS = StepTransitions((), False, (), ())


class RowPatternNFA:
    """Nondeterministic automaton of a row pattern, with its transitions in a table.

    Args:
        steps: the pattern variables; at least one must accept an element.
        navigations: the navigations of all conditions.
    """

    def __init__(self, steps: Sequence[RowPatternVariable], navigations: Sequence[StepNavigation]):
        self.steps = tuple(steps)
        self.navigations = tuple(navigations)
        self._table = [
            [
                [self._transitions(step, has_reached_min, may_repeat) for may_repeat in (False, True)]
                for has_reached_min in (False, True)
            ]
            for step in range(len(steps))
        ]
        self._initial_transitions = self._transitions_into(0)
        self._may_end_after = [self._transitions_into(step + 1).may_end for step in range(len(steps))]
        self._is_certain_from = [
            all(variable.skips_rows and not variable.until for variable in self.steps[step:])
            for step in range(len(steps))
        ]

    def transitions_after(self, step_number: int, count: int) -> StepTransitions:
        """Return the transitions after a step has accepted ``count`` elements."""
        if step_number == SCANNING:
            return self._initial_transitions
        step = self.steps[step_number]
        may_repeat = step.max_count is None or count < step.max_count
        return self._table[step_number][count >= step.min_count][may_repeat]

    def capped_count(self, step_number: int, count: int) -> int:
        """Return the count of a step, capped where larger counts make no difference to the transitions."""
        step = self.steps[step_number]
        return min(count, step.min_count) if step.max_count is None else count

    def can_never_fail(self, steps: Tuple[int, ...]) -> bool:
        """Return whether a match in these steps can only complete or wait, never fail."""
        return self._is_certain_from[min(steps)]

    def count_class(self, step: int, count: int) -> Union[int, StepTransitions]:
        """Return the equivalence class of a count: how a state with it reacts to future elements.

        If the match may end after this step, a state with a larger count completes no later than one with a smaller
        count and the same transitions. The transitions then represent the count.
        """
        return self.transitions_after(step, count) if self._may_end_after[step] else count

    def advance_navigations(
        self, targets: NavigationTargets, step: int, element: StreamElement
    ) -> NavigationTargets:
        """Return the navigations of a match after a step has accepted an element."""
        targets_after = []
        for navigation, target in zip(self.navigations, targets):
            is_reached = navigation.kind == "prev" or (
                navigation.step == step and (navigation.kind == "last" or target is None)
            )
            targets_after.append(element if is_reached else target)
        return tuple(targets_after)

    def _transitions(self, step: int, has_reached_min: bool, may_repeat: bool) -> StepTransitions:
        """Return the transitions after a step: has it its minimum of elements, and may it accept another one?"""
        next_transitions = self._transitions_into(step + 1) if has_reached_min else _NO_TRANSITIONS
        steps, blocking = next_transitions.steps, next_transitions.blocking
        if may_repeat and not self.steps[step].reluctant:
            steps = (step, *steps)
        # Reluctant and able to end: the end is preferred, so this step only blocks the skipping of elements.
        elif may_repeat and next_transitions.may_end:
            blocking = (*blocking, step)
        elif may_repeat:
            steps = (*steps, step)
        return self._make_transitions(steps, next_transitions.may_end, blocking)

    def _transitions_into(self, step: int) -> StepTransitions:
        """Return the transitions before a step has accepted an element."""
        if step == len(self.steps):
            return self._make_transitions((), True, ())
        return self._transitions(step, self.steps[step].min_count == 0, True)

    def _make_transitions(
        self, steps: Tuple[int, ...], may_end: bool, blocking: Tuple[int, ...]
    ) -> StepTransitions:
        # Skipping an element removes the steps that are not `skips_rows`. If there are none, nothing changes, and the
        # state after a skipped element equals the one before it.
        all_skip = all(self.steps[step].skips_rows for step in (*steps, *blocking))
        return StepTransitions(steps, may_end, steps if all_skip else None, blocking)


def passes_tests(tests: Sequence[StepTest], targets: NavigationTargets, element: StreamElement) -> bool:
    """Return whether an element satisfies all tests whose navigations have elements."""
    for navigations, is_satisfied in tests:
        elements = [
            element for element in (targets[position] for position in navigations) if element is not None
        ]
        if len(elements) == len(navigations) and not is_satisfied(element, elements):
            return False
    return True


def ends_step(tests: Sequence[StepTest], targets: NavigationTargets, element: StreamElement) -> bool:
    """Return whether an element ends a step: at least one test is applicable, and all applicable ones hold."""
    applicable = [
        test for test in tests if all(targets[position] is not None for position in test.navigations)
    ]
    return bool(applicable) and passes_tests(applicable, targets, element)


MAX_STATES_PER_START = 100
"""Maximum number of states with the same start; the preferred ones are kept."""

_ValueCheck = Callable[[StreamElement], Optional[bool]]
"""Rejects an element whose value a measure cannot process."""
_StepAssignments = Tuple[Tuple[StreamElement, int], ...]
"""Elements with the steps that accepted them."""


class _MatchedElements(NamedTuple):
    """Elements of a match as a linked list, the newest first; states with a common prefix share it."""

    element: StreamElement
    step: int
    previous: "Optional[_MatchedElements]"


class _CompletedMatch(NamedTuple):
    """Completed match that waits until no preferred state is left: its elements, and the order of the first one."""

    matched: _MatchedElements
    start_order: int


class ComputationState:
    """Computation state: one assignment of the elements so far to steps.

    Attributes:
        step: step of the last element.
        count: number of elements of that step, capped by `RowPatternNFA.capped_count`.
        remaining_steps: after a skipped element, the steps that can still accept one; otherwise None.
        targets: elements of the navigations.
        matched: elements of the match.
        start_order: order of its first element.
        start_time: start of the first element in ns.
        preceding_matches: number of completed matches of the partition that are preferred to this state, counted
            since one had to wait.
    """

    __slots__ = (
        "step",
        "count",
        "remaining_steps",
        "targets",
        "matched",
        "start_order",
        "start_time",
        "preceding_matches",
    )

    def __init__(
        self,
        step: int,
        count: int,
        remaining_steps: Optional[Tuple[int, ...]],
        targets: NavigationTargets,
        matched: Optional[_MatchedElements],
        start_order: int,
        start_time: int,
        preceding_matches: int,
    ):
        self.step = step
        self.count = count
        self.remaining_steps = remaining_steps
        self.targets = targets
        self.matched = matched
        self.start_order = start_order
        self.start_time = start_time
        self.preceding_matches = preceding_matches

    def key(self, count_class: Hashable) -> Hashable:
        """Return a key that is equal for states with the same future; ``count_class`` is the class of its count."""
        return (
            self.step,
            count_class,
            self.remaining_steps,
            tuple([id(element) for element in self.targets]),
        )


_Assignments = Tuple[Tuple[int, int], ...]
"""Order and step of each element of a match."""


class StoredState(NamedTuple):
    """Stored form of a `ComputationState`, which refers to elements by their order.

    Attributes:
        step, element_count, remaining_steps, preceding_matches: as in `ComputationState`; `element_count` is
            ``count`` there.
        targets: order of the element of each navigation, or None if there is none yet.
        assignments: order and step of each element of the match.
    """

    step: int
    element_count: int
    remaining_steps: Optional[Tuple[int, ...]]
    targets: Tuple[Optional[int], ...]
    assignments: _Assignments
    preceding_matches: int


class StoredPartition(NamedTuple):
    """Stored form of a `PartitionState`.

    Attributes:
        reference_time: the clock at its last element.
        elements: its elements.
        states: its computation states in order of preference.
        completed: assignments of the waiting matches, the oldest first.
    """

    reference_time: int
    elements: List[StreamElement]
    states: List[StoredState]
    completed: List[_Assignments]


class PartitionState:
    """State of one partition: its computation states, waiting matches, and the elements that they use.

    A completed match drops all less preferred states. The matches that are preferred to a state are therefore also
    preferred to all states after it, and one queue contains the waiting matches of all states.

    Attributes:
        elements: elements that a state or match uses, and all elements since the oldest of them.
        states: the computation states in order of preference.
        completed: waiting matches, the oldest first: those that are preferred to the last state, but not to the first
            one.
        counted_state_count: number of states that the window has counted for this partition.
        reference_time: the clock at its last element.
    """

    __slots__ = ("elements", "states", "completed", "counted_state_count", "reference_time")

    def __init__(self, states: List[ComputationState]):
        self.elements: Deque[StreamElement] = deque()
        self.states = states
        self.counted_state_count = 0
        self.reference_time = BEFORE_ALL_INSTANTS
        self.completed: Deque[_CompletedMatch] = deque()

    def advance(
        self, states: List[ComputationState], completed: Optional[_CompletedMatch] = None
    ) -> List[_CompletedMatch]:
        """Replace the computation states, and return the matches that are now decided.

        Args:
            states: the new states.
            completed: a match that was completed by the same element; it is preferred to the last state only.
        """
        # Matches are popped from the new end if the states that preferred them were dropped, and emitted from the old
        # end if no state precedes them.
        preceding_matches = states[-1].preceding_matches - (completed is not None)
        for _ in range(self.states[-1].preceding_matches - preceding_matches):
            self.completed.pop()
        if completed is not None:
            self.completed.append(completed)
        self.states = states
        return [self.completed.popleft() for _ in range(len(self.completed) - self.waiting_count())]

    def waiting_count(self) -> int:
        """Return the number of completed matches that wait for a preferred state."""
        return self.states[-1].preceding_matches - self.states[0].preceding_matches

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
        completed: the match that the element completes; it is preferred to the last state only.
        start_order: order of the first element of the newest state.
        same_start_count: number of states with that start. Earlier starts are preferred, so equal starts are
            adjacent.
    """

    __slots__ = ("states", "largest_counts", "completed", "start_order", "same_start_count")

    def __init__(self) -> None:
        self.states: List[ComputationState] = []
        self.largest_counts: Dict[Hashable, int] = {}
        self.completed: Optional[_CompletedMatch] = None
        self.start_order = 0
        self.same_start_count = 0

    def uses(self, element: StreamElement) -> bool:
        """Return whether a state or match uses the element."""
        return self.completed is not None or any(
            state.matched is not None and state.matched.element is element for state in self.states
        )


class RowPatternWindow(StreamOperator):
    """Window of a row pattern; emits matches that do not overlap. See `StreamOperator`.

    Args:
        make_accumulators: creates the measures of a match.
        scopes: for each measure the step that it is restricted to, or None.
        nfa: the automaton.
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
    ):
        super().__init__()
        self.make_accumulators = make_accumulators
        self.scopes = scopes
        self.nfa = nfa
        self._checks: List[_ValueCheck] = []
        self._checks_of: List[List[_ValueCheck]] = [[] for _ in nfa.steps]
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

    def _scanning_state(self, preceding_matches: int = 0) -> ComputationState:
        return ComputationState(
            SCANNING, 0, None, (None,) * len(self.nfa.navigations), None, 0, 0, preceding_matches
        )

    def process(self, element: StreamElement, now: int, channel: int) -> List[StreamOutput]:
        """See `StreamOperator.process`."""
        for check in self._checks:
            check(element)
        clock, end, span, idle = self.clock, element.end, self._max_span, self._max_idle_time
        if clock < end and (end <= self.max_timestamp or not self._is_too_far_ahead(end)):
            clock = end
        partition = self.states.get(element.key)
        if partition is None or (idle is not None and partition.reference_time < clock - idle):
            partition = PartitionState([self._scanning_state()])
        states = partition.states if span is None else self._states_started_since(partition, clock - span)
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
        decided_matches = partition.advance(successors.states, successors.completed)
        self._store_partition(partition, element.key)
        return self._outputs(decided_matches)

    def return_to(self, instant: int) -> None:
        """See `StreamOperator.return_to`."""
        super().return_to(instant)
        self._limit_reference_times()

    def _states_started_since(self, partition: PartitionState, min_start: int) -> List[ComputationState]:
        """Return the states of a partition, without those that started before an instant."""
        if all(state.start_time >= min_start or state.matched is None for state in partition.states):
            return partition.states
        remaining_states = [
            state for state in partition.states if state.start_time >= min_start or state.matched is None
        ]
        return self._with_scanning(remaining_states, partition)

    def _with_scanning(
        self, states: List[ComputationState], partition: PartitionState
    ) -> List[ComputationState]:
        """Return the remaining states of a partition, with the scanning state at the end."""
        if not states or states[-1].step != SCANNING:
            states.append(self._scanning_state(partition.states[-1].preceding_matches))
        return states

    def drop_oldest(self) -> List[StreamOutput]:
        """See `StreamOperator.drop_oldest`; drops states of the least recently used partition.

        The states that use its oldest element are dropped, and matches that have waited for them are emitted.
        """
        key, partition = next(iter(self.states.items()))
        oldest_order = partition.elements[0].order
        remaining_states = [
            state for state in partition.states if state.matched is None or state.start_order != oldest_order
        ]
        decided_matches = partition.advance(self._with_scanning(remaining_states, partition))
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
            if key in self.states:
                self.states.move_to_end(key)
            else:
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
        """Return the successor states for an element."""
        successors = _Successors()
        for state in states:
            accepting, skipping = self._accepting_steps(state, element)
            for step in accepting:
                # A completed match, or one that is certain to complete, makes all less preferred states obsolete.
                if self._accept(state, step, element, successors):
                    return successors
            if state.step == SCANNING:
                successors.states.append(state)
            # An element is skipped only if no step accepts it: skipping is not an alternative to accepting.
            elif not accepting and skipping:
                successor = ComputationState(
                    state.step,
                    state.count,
                    skipping,
                    state.targets,
                    state.matched,
                    state.start_order,
                    state.start_time,
                    state.preceding_matches,
                )
                if self._add(successor, successors) and self.nfa.can_never_fail(skipping):
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
            if not (steps[step].until and ends_step(steps[step].until, state.targets, element))
        ]
        accepting = [
            step for step in continuing_steps if passes_tests(steps[step].tests, state.targets, element)
        ]
        skipping = tuple([step for step in continuing_steps if steps[step].skips_rows])
        if not accepting and skipping:
            for step in transitions.blocking:
                # A reluctant step has no `until`. After a skipped element, only `skips_rows` steps can follow.
                if (state.remaining_steps is None or steps[step].skips_rows) and passes_tests(
                    steps[step].tests, state.targets, element
                ):
                    return accepting, ()
        return accepting, skipping

    def _accept(
        self, state: ComputationState, step: int, element: StreamElement, successors: _Successors
    ) -> bool:
        """Add the state after a step has accepted an element; return whether less preferred states are obsolete."""
        for check in self._checks_of[step]:
            check(element)
        nfa = self.nfa
        count = nfa.capped_count(step, state.count + 1 if state.step == step else 1)
        matched = _MatchedElements(element, step, state.matched)
        start_order, start_time = (
            (element.order, element.start) if state.matched is None else (state.start_order, state.start_time)
        )
        next_steps, may_end, steps_after_skip, _ = nfa.transitions_after(step, count)
        # `steps_after_skip` is set if all steps skip elements: the state then equals the one after a skip.
        if next_steps:
            targets = nfa.advance_navigations(state.targets, step, element)
            is_present = self._add(
                ComputationState(
                    step,
                    count,
                    steps_after_skip,
                    targets,
                    matched,
                    start_order,
                    start_time,
                    state.preceding_matches,
                ),
                successors,
            )
            if is_present and not may_end and nfa.can_never_fail(next_steps):
                return True
        if may_end:
            successors.completed = _CompletedMatch(matched, start_order)
            # The search for the next match starts after this one: matches do not share elements.
            successors.states.append(self._scanning_state(state.preceding_matches + 1))
        return may_end

    def _add(self, state: ComputationState, successors: _Successors) -> bool:
        """Add a state unless a preferred one subsumes it; return whether either of them is present."""
        # Two states with equal keys accept the same future elements with the same navigations.
        key = state.key(self.nfa.count_class(state.step, state.count))
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

    def _outputs(self, decided_matches: Sequence[_CompletedMatch]) -> List[StreamOutput]:
        outputs = [self._output(match) for match in decided_matches]
        return [output for output in outputs if output is not None]

    def _output(self, completed: _CompletedMatch) -> Optional[StreamOutput]:
        """Return the output of a match, or None if a measure has no result."""
        assignments = _list_assignments(completed.matched)
        meter = self.meter
        if meter is not None and meter(len(assignments)):
            return None
        elements = [element for element, _ in assignments]
        start = min(element.start for element in elements)
        end = max(self._end, *(element.end for element in elements))
        contributors = tuple(elements[-MAX_TRACKED_ELEMENTS:]) if self.tracks_elements else (elements[-1],)
        results, error = results_or_error(lambda: self._results(assignments))
        return None if results is None else StreamOutput(contributors, start, end, results, error)

    def _results(self, assignments: _StepAssignments) -> Optional[Values]:
        """Return the results of the measures of a match, or None if one has no result."""
        results = []
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
        step = integer(0, len(self.nfa.steps) - 1)
        assignments = sequence_of(tuple_of(COUNT, step), tuple)
        states = rows_of(
            StoredState,
            step=integer(SCANNING, len(self.nfa.steps) - 1),
            element_count=COUNT,
            remaining_steps=optional(sequence_of(step, tuple, min_count=1)),
            targets=sequence_of(optional(COUNT), tuple),
            assignments=assignments,
            preceding_matches=COUNT,
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
        preceding_matches = [state.preceding_matches for state in states]
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
            and preceding_matches == sorted(preceding_matches)
            and len(completed) == preceding_matches[-1] - preceding_matches[0]
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
                _CompletedMatch(_matched_elements(match, element_by_order), match[0][0])
                for match in completed
            )
            partition.states = [self._state_of(state, element_by_order) for state in states]
            is_consistent = len(partition.completed) == partition.waiting_count()
        except KeyError:
            is_consistent = False
        # Elements are missing.
        if not is_consistent:
            partition.completed.clear()
            partition.states = [self._scanning_state()]
            for element in elements:
                successors = self._successors(partition.states, element)
                partition.advance(successors.states, successors.completed)
        self._store_partition(partition, elements[0].key)

    def _state_of(self, stored: StoredState, element_by_order: Dict[int, StreamElement]) -> ComputationState:
        """Return the state whose stored form `_stored_state` has returned."""
        step, count, remaining_steps, target_orders, assignments, preceding_matches = stored
        targets = tuple([None if order is None else element_by_order[order] for order in target_orders])
        if not assignments:
            return ComputationState(step, count, remaining_steps, targets, None, 0, 0, preceding_matches)
        start_order = assignments[0][0]
        return ComputationState(
            step,
            count,
            remaining_steps,
            targets,
            _matched_elements(assignments, element_by_order),
            start_order,
            element_by_order[start_order].start,
            preceding_matches,
        )


def _matched_elements(
    assignments: Sequence[Tuple[int, int]], element_by_order: Dict[int, StreamElement]
) -> _MatchedElements:
    """Return the elements of a match, given their orders and steps."""
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
    """Return the stored form of a state."""
    return StoredState(
        state.step,
        state.count,
        state.remaining_steps,
        tuple([None if element is None else element.order for element in state.targets]),
        _to_orders(_list_assignments(state.matched)),
        state.preceding_matches,
    )


def _to_orders(assignments: _StepAssignments) -> _Assignments:
    return tuple([(element.order, step) for element, step in assignments])
