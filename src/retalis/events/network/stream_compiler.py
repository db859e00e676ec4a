"""Stream compiler: nodes of windows, rate operators, timeouts and row patterns.

This part of the rule compiler builds the nodes of operators that evaluate a stream of matches instead of joining
pairs. For each it creates a `StreamNodeSpec`: functions that make stream elements from the values of matches, the
operator itself (`streams`), and a function that makes values from its results.

* ``aggregate(K, Q, R, W)``: an accumulator over a window (sliding, tumbling, hopping, by time or count). Variables
  that are used outside of the pattern are the key of the stream (PARTITION BY).
* a window with steps: row pattern recognition (MATCH_RECOGNIZE); `compile_row_pattern` compiles the conditions
  (DEFINE) of the row pattern variables to an NFA.
* ``P with S``: rate operators such as throttle and debounce.
* ``P seq absent(Q, N)``: a timeout that a match of Q cancels.
* ``P with not_preceded(Q, N)``: a filter that a match of Q closes for some time.
"""

from fractions import Fraction
from functools import partial
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Container,
    Dict,
    Hashable,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...foundation.displayed_text import shorten
from ...foundation.errors import RuleError
from ...prolog.syntax.term_writer import write_term
from ...prolog.terms.list_terms import make_list
from ...prolog.terms.term_traversal import positions, resolve, variables
from ...prolog.terms.timestamps import MAX_TIMESTAMP, SECOND
from ...prolog.terms.types import Atom, Term, Values, Var, atom
from ...prolog.terms.unification import undo, unify
from ..dispatch.matcher_compiler import compile_builder
from ..fused.fused_window import FusedWindow, has_fused_measures
from ..language.pattern_tree import (
    DURATION,
    AbsencePattern,
    ConditionPattern,
    NegationScope,
    NotPattern,
    NotPrecededPattern,
    Pattern,
    RatePattern,
    RowPatternStep,
    WindowPattern,
    WindowSpec,
    WithinPattern,
    always_bound_by,
    bound_by,
)
from ..language.row_pattern_parser import (
    ROW_END,
    ROW_START,
    RowNavigation,
    insert_stamps,
    is_step_name,
    split_condition,
    uses_stamps,
)
from ..language.stream_parser import NOT_PRECEDED, positive_nanoseconds
from ..matches.expiration import UNLIMITED, Retention
from ..matches.match_buffer import key_function
from ..matches.match_policies import NetworkOptions
from ..matches.match_types import PartialMatch, unify_sides
from ..streams.absence_timeout import AbsenceTimeout, ComputedAbsenceTimeout, Correlation, NotPrecededFilter
from ..streams.aggregates import AGGREGATES
from ..streams.held_value_windows import HELD_AGGREGATES, HeldHoppingWindow, HeldSlidingWindow
from ..streams.rate_operators import RATE_OPERATORS
from ..streams.row_pattern import RowPatternWindow, StepClassifier
from ..streams.row_pattern_automaton import (
    SKIP_PAST_LAST,
    WHOLE_MATCH,
    RowPatternNFA,
    RowPatternSkip,
    RowPatternVariable,
    StepAggregate,
    StepNavigation,
    StepTest,
    TestedAggregate,
)
from ..streams.row_pattern_timeouts import RowPatternTimeouts
from ..streams.session_window import SessionWindow
from ..streams.stream_operators import StreamElement, StreamOperator
from ..streams.windows import (
    AlignedTumblingWindow,
    AnchoredTumblingWindow,
    HoppingWindow,
    SlidingCountWindow,
    SlidingTimeWindow,
    TumblingCountWindow,
)
from .condition_placement import BuiltPattern, NegatedPattern, VarSet, create_negation_buffer
from .goal_evaluation import Evaluate, Evaluators, FoldFunction, GoalTest
from .pattern_nodes import MatchKeys
from .stream_node import MatchValuesBuilder, StreamNode, StreamNodeSpec

if TYPE_CHECKING:
    from .event_rule import EventRule


GoalTestFactory = Callable[[Term, Sequence[Var], str], GoalTest]
"""Returns a function that calls a goal, given the goal, its variables, and its name in reports."""


class AggregatedExpression(NamedTuple):
    """Expression of an aggregate in a condition of a row pattern.

    Attributes:
        kind: name of the aggregate.
    """

    kind: str
    term: Term


def compile_row_pattern(
    window: WindowSpec, element_vars: Sequence[Optional[Var]], compile_test: GoalTestFactory
) -> Tuple[RowPatternNFA, List[AggregatedExpression]]:
    """Return the NFA of the row pattern of a window, and the expressions whose values it needs.

    Args:
        window: the window.
        element_vars: variables of the values of an element; None for a measured value. The values of the expressions
            follow them.
        compile_test: returns a function that calls a goal.
    """
    position_of = {var: position for position, var in enumerate(element_vars) if var is not None}
    expressions: List[AggregatedExpression] = []
    step_names = [step_form.name for step_form in window.steps]
    navigation_numbers: Dict[StepNavigation, int] = {}
    aggregate_numbers: Dict[StepAggregate, int] = {}
    # The navigations to earlier elements stand in the order of their distances, see `advance_navigations`.
    for distance in range(1, _find_max_distance(window, step_names, position_of) + 1):
        navigation_numbers[StepNavigation("prev", distance)] = distance - 1

    def test_aggregate(navigation: RowNavigation, position: int) -> TestedAggregate:
        value: Any = navigation.value
        if value is None:
            value_position = None
        elif value.__class__ is Var and value not in (ROW_START, ROW_END):
            value_position = position_of[value]
        else:
            value_position = len(element_vars) + len(expressions)
            expressions.append(AggregatedExpression(navigation.kind, value))
        aggregate = StepAggregate(AGGREGATES[navigation.kind], navigation.step, value_position)
        index = aggregate_numbers.setdefault(aggregate, len(aggregate_numbers))
        return TestedAggregate(index, aggregate, navigation.step in (position, WHOLE_MATCH))

    def compile_tests(goal: Term, position: int, title: str) -> Tuple[StepTest, ...]:
        tests = []
        for condition in split_condition(goal, step_names, position, position_of):
            own_vars = [var for var in variables(condition.goal) if var in position_of]
            navigated = [navigation for navigation in condition.navigations if not navigation.is_aggregate]
            aggregated = [navigation for navigation in condition.navigations if navigation.is_aggregate]
            is_satisfied = compile_test(
                condition.goal,
                [*own_vars, *(navigation.placeholder for navigation in (*navigated, *aggregated))],
                title,
            )
            # Each navigation (PREV, LAST of a step) is registered once for the whole pattern; conditions refer to it
            # by its number.
            navigations = [
                navigation_numbers.setdefault(
                    StepNavigation(navigation.kind, navigation.step), len(navigation_numbers)
                )
                for navigation in navigated
            ]
            value_positions = (
                [position_of[var] for var in own_vars],
                [position_of[var] for navigation in navigated for var in navigation.vars],
            )
            tests.append(
                StepTest(
                    tuple(navigations),
                    tuple([test_aggregate(navigation, position) for navigation in aggregated]),
                    partial(_holds_for, is_satisfied, *value_positions),
                )
            )
        return tuple(tests)

    def compile_step(position: int, step_form: RowPatternStep) -> RowPatternVariable:
        tests, until = [
            () if goal is None else compile_tests(goal, position, f"{title} of the step {step_form.name}")
            for goal, title in ((step_form.goal, "the condition"), (step_form.until, "until"))
        ]
        return RowPatternVariable(
            step_form.min_count, step_form.max_count, step_form.reluctant, step_form.skips_rows, tests, until
        )

    steps = [compile_step(position, step_form) for position, step_form in enumerate(window.steps)]
    nfa = RowPatternNFA(steps, list(navigation_numbers), list(aggregate_numbers), window.structure)
    return nfa, expressions


def _find_max_distance(window: WindowSpec, step_names: Sequence[str], own_vars: Container[Var]) -> int:
    """Return the largest distance of ``prev`` in the conditions of a row pattern; 0 if there is none."""
    return max(
        [
            navigation.step
            for position, step in enumerate(window.steps)
            for goal in step.goals
            for condition in split_condition(goal, step_names, position, own_vars)
            for navigation in condition.navigations
            if navigation.kind == "prev"
        ],
        default=0,
    )


def _holds_for(
    is_satisfied: GoalTest,
    own_positions: Sequence[int],
    navigation_positions: Sequence[int],
    element: StreamElement,
    targets: Sequence[StreamElement],
    results: Values,
) -> bool:
    """Return whether a goal has a solution for values of an element, of its navigations, and of its aggregates."""
    values = [element.values[position] for position in own_positions]
    if navigation_positions:
        values += [target.values[position] for target, position in zip(targets, navigation_positions)]
    return is_satisfied((*values, *results))


_WINDOWS: Dict[str, Callable[[Any, Any], StreamOperator]] = {
    "last": lambda make_accumulators, window: SlidingTimeWindow(make_accumulators, window.span),
    "newest": lambda make_accumulators, window: SlidingCountWindow(make_accumulators, window.max_count),
    "batch": lambda make_accumulators, window: TumblingCountWindow(
        make_accumulators, window.max_count, window.running
    ),
    "first": lambda make_accumulators, window: AnchoredTumblingWindow(
        make_accumulators, window.span, window.running
    ),
    "every": lambda make_accumulators, window: (
        AlignedTumblingWindow(make_accumulators, window.span)
        if window.running
        else HoppingWindow(make_accumulators, window.span, window.step)
    ),
    "session": lambda make_accumulators, window: SessionWindow(
        make_accumulators, window.gap, window.max_length
    ),
    "held": lambda make_measures, window: (
        HeldHoppingWindow(make_measures, window.span, window.step, window.max_length)
        if window.step
        else HeldSlidingWindow(make_measures, window.span, window.max_length)
    ),
}
# Reports of events that arrive too late.
_LATE_FOR_WINDOW = "an event is too late and is not measured: its window has ended"
_LATE_FOR_HELD_WINDOW = (
    "an event is too late for a window that has ended: its value counts if it lasts longer"
)
_LATE_FOR_DELAYED_MATCH = (
    "an event is too late and is ignored: the time in which a newer one could follow has passed"
)
_LATE_FOR_ABSENCE = "an event is too late and is ignored: the time in which nothing may follow it has passed"


def create_rate_operator(rate_pattern: RatePattern) -> StreamOperator:
    """Return the operator of ``P with S``."""
    return RATE_OPERATORS[rate_pattern.operator].create(rate_pattern.span)


def compile_rate_spec(rate_pattern: RatePattern, value_vars: Sequence[Var]) -> StreamNodeSpec:
    """Return the specification of a node of ``P with S``, given the variables of P's matches."""
    build_key = _compile_values_builder(rate_pattern.keys, value_vars)
    build_values = _compile_values_builder(
        () if rate_pattern.value is None else (rate_pattern.value,), value_vars
    )

    def key_and_values(values: Values) -> Tuple[Values, Values]:
        return build_key(values), build_values(values)

    return StreamNodeSpec(
        create_operator=lambda options: create_rate_operator(rate_pattern),
        key_and_values=key_and_values,
        build_match_values=None,
        uses_clock=RATE_OPERATORS[rate_pattern.operator].is_delayed,
        late_report=_LATE_FOR_DELAYED_MATCH,
    )


def compile_window_spec(
    window_pattern: WindowPattern,
    value_vars: Sequence[Var],
    key_vars: Sequence[Var],
    build_match_values: MatchValuesBuilder,
    evaluators: Evaluators,
) -> StreamNodeSpec:
    """Return the specification of a node of ``aggregate(K, Q, R, W)``, given the variables of Q's matches.

    Args:
        window_pattern: the pattern.
        value_vars: variables of Q's matches.
        key_vars: those that are used elsewhere in the rule; they are the key.
        build_match_values: builds the values of its matches.
        evaluators: compiles the goals.
    """
    window = window_pattern.window
    if window.kind == "steps":
        return _compile_steps_spec(window_pattern, value_vars, key_vars, build_match_values, evaluators)
    measures = _compile_measures(window_pattern, _list_measured_terms(window_pattern), value_vars, evaluators)
    make_accumulators = _accumulator_factory(window_pattern, evaluators.compile_fold)
    create_operator = partial(_WINDOWS[window.kind], make_accumulators, window)
    return StreamNodeSpec(
        create_operator=lambda options: create_operator(),
        key_and_values=_compile_key_and_values(value_vars, key_vars, measures),
        build_match_values=build_match_values,
        uses_clock=_uses_clock(window),
        late_report=_LATE_FOR_HELD_WINDOW if window.kind == "held" else _LATE_FOR_WINDOW,
        calls_goals="fold" in window_pattern.kinds or DURATION in window_pattern.kinds,
        fusible_window=_find_fusible_window(window_pattern, positions(value_vars), key_vars),
    )


def _uses_clock(window: WindowSpec) -> bool:
    """Return whether the results of a window without steps depend on the time of the clock."""
    return (
        window.kind in ("first", "session")
        or (window.kind == "every" and not window.running)
        or (window.kind == "held" and window.step > 0)
    )


def _compile_steps_spec(
    window_pattern: WindowPattern,
    value_vars: Sequence[Var],
    key_vars: Sequence[Var],
    build_match_values: MatchValuesBuilder,
    evaluators: Evaluators,
) -> StreamNodeSpec:
    """Return the specification of a node of a row pattern; see `compile_window_spec`."""
    window = window_pattern.window
    measured_terms = _list_measured_terms(window_pattern)
    navigated_vars: Sequence[Var] = window.navigated_vars
    has_stamps = uses_stamps(window_pattern)
    if has_stamps:
        # The stamps of a match follow its values.
        value_vars = [*value_vars, ROW_START, ROW_END]
        navigated_vars = [*navigated_vars, ROW_START, ROW_END]
        measured_terms = [insert_stamps(term) for term in measured_terms]
    measures = _compile_measures(window_pattern, measured_terms, value_vars, evaluators)
    element_vars = [*(None for _ in measured_terms), *navigated_vars]
    nfa, expressions = compile_row_pattern(window, element_vars, evaluators.compile_test)
    # Conditions of the step that needs the value reject one that is no number.
    tested_values = _compile_values(
        [_ValueTerm(expression.kind, expression.term, scope=0) for expression in expressions],
        value_vars,
        evaluators,
    )
    make_accumulators = _accumulator_factory(window_pattern, evaluators.compile_fold)
    skip = window.skip or RowPatternSkip(SKIP_PAST_LAST)
    classifier = StepClassifier(
        [atom(step.name) for step in window.steps],
        [position for position, term in enumerate(measured_terms) if is_step_name(term)],
    )
    arguments = (make_accumulators, window_pattern.scopes, nfa, skip, classifier)
    return StreamNodeSpec(
        create_operator=lambda options: (
            RowPatternTimeouts(*arguments, window.span) if window.span else RowPatternWindow(*arguments)
        ),
        key_and_values=_compile_key_and_values(value_vars, key_vars, measures, navigated_vars, tested_values),
        build_match_values=build_match_values,
        uses_clock=bool(window.span),
        late_report=_LATE_FOR_WINDOW,
        calls_goals=any(variable.tests or variable.until for variable in nfa.steps),
        uses_stamps=has_stamps,
    )


class _ValueTerm(NamedTuple):
    """A term whose value an element needs.

    Attributes:
        kind: name of the measure or aggregate.
        scope: number of the step that it is restricted to, or None.
    """

    kind: str
    term: Term
    scope: Optional[int]


class _CompiledValues(NamedTuple):
    """Functions that compute values of an element.

    Attributes:
        build: makes the terms from the values of a match.
        evaluate: computes the value of each term; None for a term that is its own value.
    """

    build: Callable[[Values], Values]
    evaluate: List[Optional[Evaluate]]


_NO_VALUES = _CompiledValues(lambda values: (), [])


def _list_measured_terms(window_pattern: WindowPattern) -> List[Term]:
    return [value for value in window_pattern.values if value is not None]


def _compile_measures(
    window_pattern: WindowPattern,
    measured_terms: Sequence[Term],
    value_vars: Sequence[Var],
    evaluators: Evaluators,
) -> _CompiledValues:
    """Return the functions that compute the values of the measures that have one, given the terms of these."""
    kinds_and_scopes = [
        (kind, scope)
        for kind, value, scope in zip(window_pattern.kinds, window_pattern.values, window_pattern.scopes)
        if value is not None
    ]
    value_terms = [
        _ValueTerm(kind, term, scope) for (kind, scope), term in zip(kinds_and_scopes, measured_terms)
    ]
    return _compile_values(value_terms, value_vars, evaluators, window_pattern.window.kind == "held")


def _compile_values(
    value_terms: Sequence[_ValueTerm],
    value_vars: Sequence[Var],
    evaluators: Evaluators,
    is_held: bool = False,
) -> _CompiledValues:
    return _CompiledValues(
        build=_compile_values_builder([value.term for value in value_terms], value_vars),
        evaluate=[
            _compile_measured_value(evaluators, value.kind, value.term, value_vars, value.scope, is_held)
            for value in value_terms
        ],
    )


def _compile_key_and_values(
    value_vars: Sequence[Var],
    key_vars: Sequence[Var],
    measures: _CompiledValues,
    navigated_vars: Sequence[Var] = (),
    tested_values: _CompiledValues = _NO_VALUES,
) -> Callable[[Values], Tuple[Values, Values]]:
    """Return the function that makes key and values of an element from the values of a match.

    Args:
        value_vars: variables of the match.
        key_vars: those of the key.
        measures: values of the measures; they are the first values of an element.
        navigated_vars: variables whose values follow.
        tested_values: values of aggregates in conditions, which follow these.
    """
    position_of = positions(value_vars)
    key_positions = [position_of[var] for var in key_vars]
    single_position = key_positions[0] if len(key_positions) == 1 else None
    navigated_positions = [position_of[var] for var in navigated_vars]
    build_measured, evaluate_measured = measures
    has_numeric_values = any(evaluate_measured)
    build_tested, evaluate_tested = tested_values

    # Called for each event, so it contains what further functions could do.
    def key_and_values(values: Values) -> Tuple[Values, Values]:
        measured = build_measured(values)
        # Values are nearly always numbers, so expressions are evaluated only if one is not.
        if has_numeric_values:
            for value in measured:
                if value.__class__ not in (int, float):
                    measured = _evaluate_all(measured, evaluate_measured, values)
                    break
        if navigated_positions:
            measured = (*measured, *(values[position] for position in navigated_positions))
        if evaluate_tested:
            measured += _evaluate_all(build_tested(values), evaluate_tested, values)
        return (
            (values[single_position],)
            if single_position is not None
            else tuple([values[position] for position in key_positions])
        ), measured

    return key_and_values


def _find_fusible_window(
    window_pattern: WindowPattern, position_of: Dict[Var, int], key_vars: Sequence[Var]
) -> Optional[FusedWindow]:
    """Return a window for `compile_fused_window`, or None if it cannot be fused: only variables may be measured."""
    if (
        window_pattern.window.kind != "last"
        or window_pattern.is_listed
        or not has_fused_measures(window_pattern.kinds)
        or _find_distinct_new_vars(window_pattern, key_vars) is None
    ):
        return None
    values: List[Optional[int]] = []
    for value in window_pattern.values:
        # Expressions need Prolog evaluation, which the fused code does not contain.
        if value is not None and (value.__class__ is not Var or value not in position_of):
            return None
        values.append(None if value is None else position_of[value])
    return FusedWindow(
        window_pattern.window.span, [position_of[var] for var in key_vars], window_pattern.kinds, values
    )


def _find_distinct_new_vars(window_pattern: WindowPattern, key_vars: Sequence[Var]) -> Optional[List[Var]]:
    """Return the terms of the results if these are different new variables, else None."""
    new_vars = [term for term in window_pattern.results if term.__class__ is Var and term not in key_vars]
    return new_vars if len(set(new_vars)) == len(window_pattern.results) else None


def _compile_measured_value(
    evaluators: Evaluators,
    kind: str,
    value: Term,
    value_vars: Sequence[Var],
    scope: Optional[int],
    is_held: bool,
) -> Optional[Evaluate]:
    """Return the function that computes the value of a measure; None if the term itself is measured."""
    if kind == DURATION:
        goal_vars = [var for var in variables(value) if var in set(value_vars)]
        goal_positions = [positions(value_vars)[var] for var in goal_vars]
        is_satisfied = evaluators.compile_test(value, goal_vars, "the goal of duration")
        return lambda term, values: int(
            is_satisfied(tuple([values[position] for position in goal_positions]))
        )
    if not AGGREGATES[kind].is_numeric:
        return None
    accepts_arrays = AGGREGATES[kind].accepts_arrays and not is_held
    return _make_lenient(evaluators.compile_expression(kind, value, value_vars, accepts_arrays), scope)


def _make_lenient(evaluate: Evaluate, scope: Optional[int]) -> Evaluate:
    """Return the evaluation of an expression.

    For a measure of one step, an expression without a value is returned as it is.
    """
    if scope is None:
        return evaluate

    def evaluate_or_return(term: Term, values: Values) -> Term:
        try:
            return evaluate(term, values)
        except RuleError:
            # The elements of other steps need no value; if the step accepts this one, its measure rejects the term.
            return term

    return evaluate_or_return


def _evaluate_all(terms: Values, evaluate: Sequence[Optional[Evaluate]], values: Values) -> Values:
    """Return the values of terms; numbers and terms without a function are their own values."""
    return tuple(
        [_evaluate_unless_number(term, evaluate_term, values) for term, evaluate_term in zip(terms, evaluate)]
    )


def _evaluate_unless_number(value: Term, evaluate: Optional[Evaluate], values: Values) -> Term:
    return value if evaluate is None or value.__class__ in (int, float) else evaluate(value, values)


def _accumulator_factory(
    window_pattern: WindowPattern, compile_fold: Callable[[Any], FoldFunction]
) -> Callable[[], List[Any]]:
    """Return a function that creates the accumulators of one key."""
    accumulator_factories: List[Callable[[], Any]] = []
    position = 0
    for kind, setting, value in zip(window_pattern.kinds, window_pattern.settings, window_pattern.values):
        if window_pattern.window.kind == "held":
            accumulator_factories.append(partial(HELD_AGGREGATES[kind].measure, position, kind, None))
            position += 1
            continue
        if kind == "rate":
            setting = Fraction(window_pattern.window.span, SECOND) if window_pattern.window.span else None
        elif kind == "fold":
            setting = compile_fold(setting)
        accumulator_factories.append(partial(AGGREGATES[kind].make_accumulator, position, setting))
        position += value is not None
    return lambda: [make_accumulator() for make_accumulator in accumulator_factories]


def _timeout_of(position: int, match: PartialMatch) -> int:
    """Return the time in ns of a match whose value at a position is a number of seconds.

    Raises:
        RuleError: if it is not a positive number, or too large.
    """
    seconds = match.values[position]
    nanoseconds = positive_nanoseconds(seconds)
    if nanoseconds is None:
        text = f"{'the atom ' if seconds.__class__ is Atom else ''}'{shorten(write_term(seconds, quoted=False))}'"
        raise RuleError(f"absent: the time is {text}: expected a positive number of seconds")
    if nanoseconds > MAX_TIMESTAMP:
        raise RuleError(f"absent: the time is longer than {MAX_TIMESTAMP // SECOND:.1e} seconds")
    return nanoseconds


def compile_absence_spec(
    pattern: Union[AbsencePattern, NotPrecededPattern],
    value_vars: Sequence[Var],
    negated_vars: Sequence[Var],
    condition: Optional[Callable[[Values, PartialMatch], bool]],
    identity_of: Callable[[PartialMatch], Hashable],
) -> StreamNodeSpec:
    """Return the specification of a node of ``P seq absent(Q, N)`` or ``P with not_preceded(Q, N)``.

    Args:
        pattern: the pattern.
        value_vars: variables of P's matches.
        negated_vars: variables of Q's matches.
        condition: tests the values of P and a match of Q, if Q has conditions on P; else None.
        identity_of: returns the identity of a match of P.
    """
    position_of = positions(value_vars)
    shared = [(position, position_of[var]) for position, var in enumerate(negated_vars) if var in position_of]
    key_functions = [
        key_function(tuple(match_position for _, match_position in shared)),
        key_function(tuple(absent_position for absent_position, _ in shared)),
    ]

    def key_of(match: PartialMatch, channel: int) -> Hashable:
        try:
            return key_functions[channel](match.values)
        except ValueError:
            return None

    def cancels(match: PartialMatch, absent_match: PartialMatch) -> bool:
        sides = unify_sides(absent_match, match, tuple(shared))
        if sides is None:
            return False
        return condition is None or condition(sides[1].values, sides[0])

    def create_operator(options: NetworkOptions) -> StreamOperator:
        correlation = Correlation(
            key_of, cancels, condition is None, identity_of if options.policy.replaces_identical else None
        )
        span = pattern.span
        if isinstance(pattern, NotPrecededPattern):
            return NotPrecededFilter(pattern.span, max_length(pattern.pattern), correlation)
        if isinstance(span, Var):
            return ComputedAbsenceTimeout(correlation, partial(_timeout_of, position_of[span]))
        return AbsenceTimeout(span, correlation)

    return StreamNodeSpec(
        create_operator=create_operator,
        key_and_values=lambda values: ((), ()),
        build_match_values=None,
        uses_clock=isinstance(pattern, AbsencePattern),
        late_report=_LATE_FOR_ABSENCE,
        calls_goals=condition is not None,
    )


def max_length(pattern: Pattern) -> int:
    """Return the longest interval of a match in ns, as far as a ``within`` states it; 0 if it is unknown."""
    while isinstance(pattern, (ConditionPattern, NotPattern)):
        pattern = pattern.pattern
    return pattern.span if isinstance(pattern, WithinPattern) else 0


def _compile_values_builder(terms: Sequence[Term], value_vars: Sequence[Var]) -> Callable[[Values], Values]:
    """Return a function that makes the values of terms from those of variables."""
    builders = [compile_builder(term, list(value_vars), "operator on a stream") for term in terms]
    if not builders:
        return lambda values: ()
    if len(builders) == 1:
        single_builder = builders[0]
        return lambda values: (single_builder(values),)
    return lambda values: tuple([build(values) for build in builders])


def compile_window_result(
    window_pattern: WindowPattern, key_vars: Sequence[Var]
) -> Tuple[List[Var], MatchValuesBuilder]:
    """Return the variables of a window's matches, and the function that makes their values.

    The function takes the values of the key and the results. It returns None if the term of a result does not unify
    with it.
    """
    is_listed, terms, known_vars = window_pattern.is_listed, window_pattern.results, set(key_vars)
    new_vars = _find_distinct_new_vars(window_pattern, key_vars)
    if new_vars is not None:
        if is_listed:
            return [*key_vars, *new_vars], lambda key_values, output: (*key_values, make_list(list(output)))
        return [*key_vars, *new_vars], lambda key_values, output: (*key_values, *output)
    unknown_vars = [
        var
        for var in dict.fromkeys(element for term in terms for element in variables(term))
        if var not in known_vars
    ]
    value_vars = [*key_vars, *unknown_vars]
    builders = [compile_builder(term, value_vars, "result of an aggregate") for term in terms]

    def unify_results(key_values: Values, output: Values) -> Optional[Values]:
        result_values = (*key_values, *(Var() for _ in unknown_vars))
        results = (make_list(list(output)),) if is_listed else output
        trail: List[Any] = []
        try:
            if all(unify(build(result_values), value, trail) for build, value in zip(builders, results)):
                return tuple([resolve(element) for element in result_values])
            return None
        finally:
            undo(trail, 0)

    return value_vars, unify_results


class StreamCompiler:
    """Base of the rule compiler that builds the nodes of operators on streams."""

    _match_keys: MatchKeys

    def __init__(self, rule: "EventRule"):
        self.rule = rule

    def _build(self, pattern: Pattern, context: VarSet, retention: Retention) -> BuiltPattern:
        raise NotImplementedError

    def _add(self, node: StreamNode, span: Optional[int], retention: Retention) -> StreamNode:
        raise NotImplementedError

    def _find_outside_vars(self, pattern: Pattern, values: Sequence[Term]) -> Set[Var]:
        raise NotImplementedError

    def _make_negated(
        self, pattern: Union[AbsencePattern, NotPrecededPattern], context: VarSet, retention: Retention
    ) -> NegatedPattern:
        raise NotImplementedError

    def _build_stream(
        self,
        pattern: Union[WindowPattern, RatePattern, AbsencePattern, NotPrecededPattern],
        context: VarSet,
        max_interval: Optional[int],
    ) -> BuiltPattern:
        """Build the pattern of an operator on streams.

        Args:
            pattern: the pattern.
            context: variables of the patterns to its left.
            max_interval: longest interval of a useful match, in ns; None for no bound.
        """
        if isinstance(pattern, (AbsencePattern, NotPrecededPattern)):
            return self._build_absence(pattern, context, max_interval)
        input_pattern = pattern.collected if isinstance(pattern, WindowPattern) else pattern.pattern
        below = self._build(input_pattern, context, UNLIMITED)
        # A window has no partner further left at the time when its elements are measured, so such conditions cannot
        # be deferred.
        if below.deferred:
            subject = (
                "what is measured"
                if isinstance(pattern, WindowPattern)
                else f"the pattern of {pattern.operator}"
            )
            raise RuleError(f"a condition in {subject} uses a pattern to the left of it", self.rule.place)
        value_vars = below.node.vars
        if isinstance(pattern, RatePattern):
            node = StreamNode(
                self.rule, [below.node], value_vars, compile_rate_spec(pattern, value_vars), pattern
            )
            is_delayed = RATE_OPERATORS[pattern.operator].is_delayed
            built = BuiltPattern(node, [], below.leaves, []) if is_delayed else below
            return built._replace(node=self._add(node, None, Retention(max_interval, max_interval)))
        if any(var in context and var not in value_vars for goal in pattern.goals for var in variables(goal)):
            place_of_goal = "duration" if pattern.window.kind == "held" else "a condition of a step"
            raise RuleError(
                f"{place_of_goal} uses a pattern to the left of what is measured", self.rule.place
            )
        values = [value for value in pattern.values if value is not None]
        outside_vars = self._find_outside_vars(input_pattern, [*values, *pattern.window.navigated_vars])
        key_vars = [var for var in value_vars if var in outside_vars]
        own_vars, build_match_values = compile_window_result(pattern, key_vars)
        evaluators = Evaluators(self.rule)
        spec = compile_window_spec(pattern, value_vars, key_vars, build_match_values, evaluators)
        node = self._add(
            StreamNode(self.rule, [below.node], own_vars, spec, pattern),
            None,
            Retention(max_interval, max_interval),
        )
        return BuiltPattern(node, [], below.leaves, [])

    def _build_absence(
        self,
        pattern: Union[AbsencePattern, NotPrecededPattern],
        context: VarSet,
        max_interval: Optional[int],
    ) -> BuiltPattern:
        """Build a pattern after which, or before which, another one must not happen for some time."""
        name = "absent" if isinstance(pattern, AbsencePattern) else NOT_PRECEDED.name
        below = self._build(pattern.pattern, context, UNLIMITED)
        inner_context = context | frozenset(bound_by(pattern.pattern))
        negated = self._make_negated(pattern, inner_context, UNLIMITED)
        always_bound = always_bound_by(pattern.pattern, False, True)
        value_vars = below.node.vars
        deferred_goals = [condition.goal for condition in below.deferred if condition.goal is not None]
        if isinstance(pattern.span, Var) and (
            pattern.span not in value_vars
            or (
                pattern.span not in always_bound
                and any(pattern.span in variables(goal) for goal in deferred_goals)
            )
        ):
            message = "the time of absent depends on a condition that uses a pattern to the left of it"
            raise RuleError(message, self.rule.place)
        # The timeout has no left operand whose variables could become known later.
        if negated.find_missing_vars(inner_context, set(value_vars)) | negated.find_missing_vars(
            context, always_bound
        ):
            message = f"the pattern of {name} uses a variable that the pattern before it does not bind"
            raise RuleError(message, self.rule.place)
        built = negated.next_copy()
        negation = create_negation_buffer(self.rule, built, value_vars, NegationScope.BETWEEN)
        identity_of = self._match_keys.identity_function(value_vars, pattern.pattern)
        spec = compile_absence_spec(pattern, value_vars, built.node.vars, negation.condition, identity_of)
        node = StreamNode(self.rule, [below.node, built.node], value_vars, spec, pattern)
        node.deferred_negations = negation.deferred_negations
        if isinstance(pattern, NotPrecededPattern):
            self._add(node, None, Retention(max_interval, max_interval))
            return below._replace(node=node)
        self._add(node, None, UNLIMITED)
        return BuiltPattern(node, below.deferred, below.leaves, [])
