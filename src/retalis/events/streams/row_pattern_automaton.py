"""Automaton of a row pattern: its steps, their transitions, and what conditions refer to.

`RowPatternNFA` has the transitions of each step in a table, and the navigations and aggregates of all conditions.
`row_pattern` runs it over the elements of a partition.
"""

from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

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
    """Transitions of a computation state, to positions of steps.

    Attributes:
        steps: positions that may accept the next element, in order of preference.
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
        includes_current: whether the element that is tested counts.
    """

    number: int
    aggregate: StepAggregate
    includes_current: bool


SEQUENCE, ALTERNATIVES, PERMUTATION = "sequence", "alternatives", "permutation"


class StepGroup(NamedTuple):
    """Group of steps.

    Attributes:
        kind: `SEQUENCE` for parts one after the other, `ALTERNATIVES` for one of the parts, `PERMUTATION` for all of
            them in any order.
        parts: numbers of steps, and groups.
        min_count: minimum number of repetitions.
        max_count: maximum number of repetitions; None for no limit.
        reluctant: whether fewer repetitions are preferred.
    """

    kind: str
    parts: "Tuple[Union[int, StepGroup], ...]"
    min_count: int = 1
    max_count: Optional[int] = 1
    reluctant: bool = False


PatternPart = Union[int, StepGroup]
MAX_POSITIONS = 1000
"""Maximum number of positions of an automaton."""

_END = -2
"""Choice of the end of the match, in place of a position."""
_Choices = Tuple[int, ...]
"""Positions that may accept the next element, and the end, in order of preference."""


def count_positions(part: PatternPart) -> int:
    """Return the number of positions of a part of a pattern: its steps, once for each place that they may have."""
    if isinstance(part, int):
        return 1
    count = sum(map(count_positions, part.parts))
    if part.kind == PERMUTATION:
        # Each part has a position for each set of parts that may precede it.
        count <<= len(part.parts) - 1
    # A loop has two copies, see `_PositionCompiler`.
    return count * (part.min_count + 2 if part.max_count is None else part.max_count)


def may_be_empty(part: PatternPart, steps: Sequence[Any]) -> bool:
    """Return whether a part of a pattern matches without elements, given the steps, which have a ``min_count``."""
    if isinstance(part, int):
        return bool(steps[part].min_count == 0)
    may_parts_be_empty = [may_be_empty(inner_part, steps) for inner_part in part.parts]
    is_any_enough = part.kind == ALTERNATIVES
    return part.min_count == 0 or (any(may_parts_be_empty) if is_any_enough else all(may_parts_be_empty))


class _LazyChoices:
    """Choices at one place of a pattern, computed when they are needed: those in a loop refer to each other."""

    def __init__(self, compute: Callable[[], _Choices]):
        self._compute = compute
        self._choices: Optional[_Choices] = None

    def choices(self) -> _Choices:
        """Return the choices."""
        if self._choices is None:
            # A position that is reachable in several ways is tried once, in the most preferred one.
            self._choices = tuple(dict.fromkeys(self._compute()))
        return self._choices


class _PositionCompiler:
    """Compiler of a pattern to positions, as in the construction by Glushkov, with ordered choices.

    A position is a step at one place of the pattern: a step in a bounded repetition has one for each repetition, and
    a step in a permutation one for each set of steps that may precede it. An unbounded repetition is a loop of two
    copies: a step that follows itself is then another position, so that its count begins again.

    Attributes:
        step_numbers: step of each position, from the right end of the pattern to the left.
        following: choices after each position.
    """

    def __init__(self, steps: Sequence[RowPatternVariable]):
        self._steps = steps
        self.step_numbers: List[int] = []
        self.following: List[_LazyChoices] = []

    def enter(self, part: PatternPart, following: _LazyChoices) -> _LazyChoices:
        """Return the choices before a part, given those after it."""
        if isinstance(part, int):
            return self._enter_step(part, following)
        if part.max_count is None:
            entry = self._enter_loop(part, following)
        else:
            entry = following
            for _ in range(part.max_count - part.min_count):
                entry = self._join(self._enter_parts(part, entry), following, part.reluctant)
        for _ in range(part.min_count):
            entry = self._enter_parts(part, entry)
        return entry

    def _enter_step(self, number: int, following: _LazyChoices) -> _LazyChoices:
        position = len(self.step_numbers)
        self.step_numbers.append(number)
        self.following.append(following)
        step, entry = self._steps[number], _LazyChoices(lambda: (position,))
        return entry if step.min_count else self._join(entry, following, step.reluctant)

    def _enter_loop(self, part: StepGroup, following: _LazyChoices) -> _LazyChoices:
        copies: List[_LazyChoices] = []
        second = self._enter_parts(part, _LazyChoices(lambda: copies[0].choices()))
        first = self._enter_parts(part, _LazyChoices(lambda: copies[1].choices()))
        copies += [self._join(entry, following, part.reluctant) for entry in (first, second)]
        return copies[0]

    def _enter_parts(self, part: StepGroup, following: _LazyChoices) -> _LazyChoices:
        """Return the choices before one repetition of a group."""
        if part.kind == SEQUENCE:
            for inner_part in reversed(part.parts):
                following = self.enter(inner_part, following)
            return following
        if part.kind == ALTERNATIVES:
            entries = [self.enter(inner_part, following) for inner_part in reversed(part.parts)]
            return _concatenate(entries[::-1])
        return self._enter_permutation(part.parts, following, {})

    def _enter_permutation(
        self,
        parts: Tuple[PatternPart, ...],
        following: _LazyChoices,
        known: Dict[Tuple[PatternPart, ...], _LazyChoices],
    ) -> _LazyChoices:
        """Return the choices before parts that follow in any order."""
        if not parts:
            return following
        if parts not in known:
            entries = [
                self.enter(
                    part, self._enter_permutation((*parts[:index], *parts[index + 1 :]), following, known)
                )
                for index, part in enumerate(parts)
            ]
            known[parts] = _concatenate(entries)
        return known[parts]

    @staticmethod
    def _join(inside: _LazyChoices, following: _LazyChoices, reluctant: bool) -> _LazyChoices:
        """Return the choices before an optional part: to enter it, or not."""
        return _concatenate([following, inside] if reluctant else [inside, following])


def _concatenate(entries: Sequence[_LazyChoices]) -> _LazyChoices:
    return _LazyChoices(lambda: tuple([choice for entry in entries for choice in entry.choices()]))


class RowPatternNFA:
    """Nondeterministic automaton of a row pattern, with its transitions in a table.

    Its states are positions of steps in the pattern. In a pattern without groups, positions are numbers of steps.

    Args:
        variables: the steps.
        navigations: the navigations of all conditions; one to an earlier element follows those to nearer ones.
        aggregates: the aggregates of all conditions.
        structure: the order of the steps, which cannot match without elements; None if they follow each other.

    Attributes:
        variables: the steps.
        steps: step of each position.
        step_numbers: number of the step of each position.
        initial_totals: states of the aggregates before the first element.
    """

    def __init__(
        self,
        variables: Sequence[RowPatternVariable],
        navigations: Sequence[StepNavigation],
        aggregates: Sequence[StepAggregate] = (),
        structure: Optional[StepGroup] = None,
    ):
        self.variables = tuple(variables)
        self.navigations = tuple(navigations)
        self.aggregates = tuple(aggregates)
        self.initial_totals = tuple(
            [aggregate.function.make_fold(None).initial_state for aggregate in aggregates]
        )
        compiler = _PositionCompiler(self.variables)
        entry = compiler.enter(
            structure or StepGroup(SEQUENCE, tuple(range(len(self.variables)))),
            _LazyChoices(lambda: (_END,)),
        )
        # The compiler numbers positions from the right end.
        last = len(compiler.step_numbers) - 1
        self.step_numbers = tuple(reversed(compiler.step_numbers))
        self.steps = tuple([self.variables[number] for number in self.step_numbers])

        def from_left(choices: _Choices) -> _Choices:
            return tuple([choice if choice == _END else last - choice for choice in choices])

        # From the right end, so that the choices of each position are known when those before it are computed.
        self._following = [from_left(following.choices()) for following in compiler.following][::-1]
        self._initial_transitions = self._make_transitions(from_left(entry.choices()))
        self._table = [
            [
                [self._transitions(position, has_reached_min, may_repeat) for may_repeat in (False, True)]
                for has_reached_min in (False, True)
            ]
            for position in range(len(self.steps))
        ]
        self._may_end_after = [_END in choices for choices in self._following]
        self._is_certain = self._find_certain_positions()

    def transitions_after(self, step_number: int, count: int) -> StepTransitions:
        """Return the transitions after a step has accepted ``count`` elements."""
        if step_number == SCANNING:
            return self._initial_transitions
        step = self.steps[step_number]
        may_repeat = step.max_count is None or count < step.max_count
        return self._table[step_number][count >= step.min_count][may_repeat]

    @property
    def first_steps(self) -> Set[int]:
        """Numbers of the steps that may accept the first element of a match."""
        return {self.step_numbers[position] for position in self._initial_transitions.steps}

    def find_endless_step(self) -> Optional[int]:
        """Return the number of a step that may always accept a further element after the end of a match; or None."""
        reachable = [self._initial_transitions]
        for position, step in enumerate(self.steps):
            counts = (max(step.min_count, 1), step.max_count)
            reachable += [self.transitions_after(position, count) for count in counts if count is not None]
        for transitions in reachable:
            for position in transitions.steps if transitions.may_end else ():
                step = self.steps[position]
                if step.skips_rows and not step.until:
                    return self.step_numbers[position]
        return None

    def capped_count(self, step_number: int, count: int) -> int:
        """Return the count of a step, capped where larger counts make no difference to the transitions."""
        step = self.steps[step_number]
        return min(count, step.min_count) if step.max_count is None else count

    def can_never_fail(self, steps: Tuple[int, ...]) -> bool:
        """Return whether a match in these steps can only complete or wait, never fail."""
        return all(self._is_certain[step] for step in steps)

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

    def _find_certain_positions(self) -> List[bool]:
        """Return for each position whether no step from it on can fail."""
        preceding: List[List[int]] = [[] for _ in self.steps]
        for position in range(len(self.steps)):
            for next_position in self._following[position]:
                if next_position != _END:
                    preceding[next_position].append(position)
        is_certain = [step.skips_rows and not step.until for step in self.steps]
        uncertain = [position for position, certain in enumerate(is_certain) if not certain]
        while uncertain:
            for position in preceding[uncertain.pop()]:
                if is_certain[position]:
                    is_certain[position] = False
                    uncertain.append(position)
        return is_certain

    def _transitions(self, position: int, has_reached_min: bool, may_repeat: bool) -> StepTransitions:
        """Return the transitions after a step: has it its minimum of elements, and may it accept another one?"""
        following = self._following[position] if has_reached_min else ()
        repeated = (position,) if may_repeat else ()
        is_reluctant = self.steps[position].reluctant
        return self._make_transitions((*following, *repeated) if is_reluctant else (*repeated, *following))

    def _make_transitions(self, choices: _Choices) -> StepTransitions:
        # The end is preferred to the steps after it, so these only block the skipping of elements.
        may_end = _END in choices
        end = choices.index(_END) if may_end else len(choices)
        steps, blocking = choices[:end], choices[end + 1 :]
        # Skipping an element removes the steps that are not `skips_rows`. If there are none, nothing changes, and the
        # state after a skipped element equals the one before it.
        all_skip = all(self.steps[step].skips_rows for step in (*steps, *blocking))
        return StepTransitions(steps, may_end, steps if all_skip else None, blocking)
