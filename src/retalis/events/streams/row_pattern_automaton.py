"""Automaton of a row pattern: its steps, their transitions, and what conditions refer to.

`RowPatternNFA` has the transitions of each step in a table, and the navigations and aggregates of all conditions.
`row_pattern` runs it over the elements of a partition.
"""

from typing import Any, Callable, NamedTuple, Optional, Sequence, Tuple, Union

from ...foundation.errors import RuleError
from ...prolog.terms.types import Term, Values
from .aggregates import AggregateFunction
from .stream_operators import StreamElement

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
        aggregates: the aggregates that it uses; it is skipped while one has no result.
        is_satisfied: returns whether the condition holds for an element, these navigations, and the results of the
            aggregates.
    """

    navigations: Tuple[int, ...]
    aggregates: "Tuple[TestedAggregate, ...]"
    is_satisfied: Callable[[StreamElement, NavigatedElements, Values], bool]


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


SKIP_PAST_LAST, SKIP_TO_NEXT = "skip_past_last", "skip_to_next"
SKIP_TO_FIRST, SKIP_TO_LAST = "skip_to_first", "skip_to_last"


class RowPatternSkip(NamedTuple):
    """Begin of the search for the next match (AFTER MATCH SKIP).

    Attributes:
        strategy: `SKIP_PAST_LAST`, after the last element of the match; `SKIP_TO_NEXT`, at the element after its
            first one; `SKIP_TO_FIRST` or `SKIP_TO_LAST`, at the first or the last element of a step.
        step: number of that step; 0 for the other strategies.
    """

    strategy: str
    step: int = 0


class StepNavigation(NamedTuple):
    """Navigation of conditions: to an earlier element of a match, or to the first or last one of a step.

    Attributes:
        kind: ``prev``, ``first`` or ``last``.
        number: for ``prev`` the distance, 1 for the last element; else the number of the step, or `WHOLE_MATCH`.
    """

    kind: str
    number: int


WHOLE_MATCH = -1
"""Number in place of a step, for all elements of a match."""


class StepAggregate(NamedTuple):
    """Aggregate of conditions, over the elements of a step or of the match so far.

    Attributes:
        function: the aggregate function.
        step: number of the step, or `WHOLE_MATCH`.
        position: index of the aggregated value in `StreamElement.values`; None if it has none.
    """

    function: AggregateFunction
    step: int
    position: Optional[int]

    def add(self, total: Any, element: StreamElement) -> Any:
        """Return the state of the aggregate with an element added.

        Raises:
            RuleError: if its value cannot be aggregated.
        """
        value = None if self.position is None else element.values[self.position]
        check = self.function.value_rule.check
        if check is not None:
            check(value, self.function.name)
        try:
            return self.function.make_fold(None).add(total, value)
        except OverflowError:
            raise RuleError(f"aggregate {self.function.name}: the result is too large for a float") from None

    def result(self, total: Any) -> Optional[Term]:
        """Return the result of a state, or None if it has none."""
        fold = self.function.make_fold(None)
        return fold.empty_result if total == fold.initial_state else fold.result(total)


class TestedAggregate(NamedTuple):
    """Use of an aggregate by a condition.

    Attributes:
        number: number of the aggregate.
        aggregate: the aggregate.
        includes_current: whether the element that is tested counts.
    """

    number: int
    aggregate: StepAggregate
    includes_current: bool


_NO_TRANSITIONS = StepTransitions((), False, (), ())


class RowPatternNFA:
    """Nondeterministic automaton of a row pattern, with its transitions in a table.

    Args:
        steps: the pattern variables; at least one must accept an element.
        navigations: the navigations of all conditions; one to an earlier element follows those to nearer ones.
        aggregates: the aggregates of all conditions.
    """

    def __init__(
        self,
        steps: Sequence[RowPatternVariable],
        navigations: Sequence[StepNavigation],
        aggregates: Sequence[StepAggregate] = (),
    ):
        self.steps = tuple(steps)
        self.navigations = tuple(navigations)
        self.aggregates = tuple(aggregates)
        self.initial_totals = tuple(
            [aggregate.function.make_fold(None).initial_state for aggregate in aggregates]
        )
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
        nearer: Optional[StreamElement] = element
        for navigation, target in zip(self.navigations, targets):
            if navigation.kind == "prev":
                # The element at distance N is then at distance N + 1, whose navigation comes next.
                targets_after.append(nearer)
                nearer = target
                continue
            is_reached = navigation.number in (step, WHOLE_MATCH) and (
                navigation.kind == "last" or target is None
            )
            targets_after.append(element if is_reached else target)
        return tuple(targets_after)

    def advance_totals(self, totals: Values, step: int, element: StreamElement) -> Values:
        """Return the states of the aggregates of a match after a step has accepted an element.

        Raises:
            RuleError: if a value cannot be aggregated.
        """
        return tuple(
            [
                aggregate.add(total, element) if aggregate.step in (step, WHOLE_MATCH) else total
                for aggregate, total in zip(self.aggregates, totals)
            ]
        )

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
