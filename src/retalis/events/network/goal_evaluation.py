"""Goals of rules: conditions, actions, and expressions of aggregates.

The nodes of a rule call Prolog goals. `RuleGoal` compiles a goal for the variables that are bound where it stands:

* a condition is called with `RuleGoal.extend_values`; its first solution counts and extends the values of the match;
* an action is called with `RuleGoal.call_once` or `RuleGoal.call_for_all`. It runs as a part of the event's dispatch,
  so the machine can be interrupted in it, and continues with the head of the rule.

Values without variables are the usual case. The goal is compiled with them as inputs and returns only the values of
its other variables. If a value contains variables, a second form of the goal takes and returns all values, because
the solution may bind any of them.

An error in a goal is reported and counts as failure; the engine continues. A condition may make events, whose rules
may have conditions that make events; this nesting is limited. `Evaluators` compiles the expressions and goals of
aggregates and windows.

`TimedNode` is the protocol of nodes with alarms, which rules and subscriptions have.
"""

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterator, List, Optional, Protocol, Sequence, Tuple

from ...foundation.errors import RetalisError, RuleError
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.errors import PrologError, resource_error
from ...prolog.machine.resource_limits import record_caught_error
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import are_ground, positions, variables
from ...prolog.terms.types import Atom, EventAction, Frame, Term, Values, Var, deref, functor
from ..fused.fused_single_event import Continuation, compile_goal_action
from ..language.pattern_tree import ConditionPattern
from ..matches.consumption_policy import emit_each, metered
from ..matches.match_types import PartialMatch
from ..streams.aggregates import (
    AGGREGATES,
    Setting,
    array_length,
    is_number,
    is_number_expression,
    value_error,
)

if TYPE_CHECKING:
    from ..matches.watermarks import PatternWatermark
    from .event_rule import EventRule

ExtendValues = Callable[[Values], Optional[Values]]
"""Returns the values of a match with those of a condition's solution, or None if it has none."""


class TimedNode(Protocol):
    """A node with an alarm of the clock.

    Attributes:
        alarm_instant: the instant of its next alarm; None without one.
        position: position among the nodes of the same rule, or among the subscriptions.
        watermark: the watermark that has to reach the instant.
    """

    alarm_instant: Optional[int]
    position: int
    watermark: "PatternWatermark"

    @property
    def serial(self) -> int:
        """Number of its rule: alarms of lower numbers run first; 0 for a subscription."""

    @property
    def active(self) -> bool:
        """True while the clock may call it."""

    def on_alarm(self, instant: int, frame: Frame, /) -> Frame:
        """Return the frame that processes everything that is due, and continues with ``frame``."""

    def report_alarm_error(self, error: RetalisError, /) -> None:
        """Report an error that `on_alarm` or the frame has raised."""


class ConditionState:
    """State of condition tests, shared by all rules.

    Attributes:
        condition_depth: number of conditions being tested, one within the other.
        condition_interval: interval that ``t1/1`` and ``t2/1`` return: that of the innermost condition that has one.
    """

    condition_depth: int = 0
    condition_interval: Optional[Tuple[int, int]] = None

    @contextmanager
    def interval(self, interval: Optional[Tuple[int, int]]) -> Iterator[None]:
        """Set `condition_interval` in a block; None leaves that of an outer condition."""
        outer_interval = self.condition_interval
        self.condition_interval = interval or outer_interval
        try:
            yield
        finally:
            self.condition_interval = outer_interval


Test = Callable[[Values, int, int], Optional[Values]]
"""Takes values and interval of a match; returns the values with those that the test binds, or None if it fails."""


_MAX_CONDITION_DEPTH = 30
"""Maximum nesting of conditions that make events whose rules have conditions that make events."""
_FINDALL = functor("findall", 3)


class RuleGoal:
    """A goal of a rule, compiled for the variables that are bound where it stands.

    Attributes:
        result_vars: ``match_vars``, then the other variables of the goal.
    """

    def __init__(self, rule: "EventRule", goal: Term, match_vars: Sequence[Var]):
        self.rule = rule
        self.goal = goal
        self.match_vars = list(match_vars)
        goal_vars = positions(variables(goal))
        position_of = positions(self.match_vars)
        inputs = [var for var in self.match_vars if var in goal_vars]
        self._input_positions = tuple(position_of[var] for var in inputs)
        self._takes_all_values = inputs == self.match_vars
        self.outputs = [var for var in goal_vars if var not in position_of]
        self.result_vars = [*self.match_vars, *self.outputs]
        # Read here, because the other forms of the goal are compiled later, outside of the client's request.
        self._comes_from_client = rule.network.logic.is_serving_client
        self._compiled: Dict[Tuple[object, ...], CompiledGoal] = {}
        self._inputs = inputs
        self._ground_goal = self._compile(inputs, self.outputs, False)
        self._dispatcher = rule.network.dispatcher
        self._condition_state = rule.network.condition_state

    def extend_values(self, values: Values) -> Optional[Values]:
        """Return the values extended by those of the first solution; None if there is none.

        An error counts as failure and is reported.
        """
        current = self._dispatcher.current
        condition_state = self._condition_state
        condition_state.condition_depth += 1
        try:
            if condition_state.condition_depth > _MAX_CONDITION_DEPTH:
                raise resource_error("conditions_that_make_events")
            inputs = tuple([values[position] for position in self._input_positions])
            if are_ground(inputs):
                solution = self._ground_goal.first_solution(inputs)
                if solution is None:
                    return None
                return values + solution if solution else values
            return self._open_goal().first_solution(values)
        except PrologError as error:
            # An error may leave a nested dispatch unfinished; the event that was served before the condition is
            # current again.
            self._dispatcher.restore_context(current, self._dispatcher.cause)
            self.report_error(error)
            return None
        finally:
            condition_state.condition_depth -= 1

    def call_once(
        self,
        term: Term,
        values: Values,
        start: int,
        end: int,
        ground: bool,
        on_solution: EventAction,
        frame: Frame,
    ) -> Frame:
        """Return the frame that calls the goal once and continues with ``on_solution``, or ``frame`` if it fails.

        Args:
            term: the event, if the match consists of one; passed to ``on_solution``.
            values: values of the match.
            start: start of the match; passed to ``on_solution``.
            end: end of the match; passed to ``on_solution``.
            ground: whether the values are known to be without variables.
            on_solution: receives the match with the values of the solution appended to the others.
            frame: the frame to continue with.
        """
        inputs = (
            values
            if self._takes_all_values
            else tuple([values[position] for position in self._input_positions])
        )
        # With ground inputs, the goal returns only its other variables; the values of the match are passed beside
        # it.
        if ground or are_ground(inputs):
            goal, passed_values = self._ground_goal, values
        else:
            goal, inputs, passed_values = self._open_goal(), values, ()
        return self._dispatcher.call(
            goal, inputs, self._report_error_of_call, on_solution, term, passed_values, start, end, frame
        )

    def continuation_for_event(self, completion: Continuation) -> Continuation:
        """Return the continuation that calls the goal for a single event and continues with a completion.

        Usually the event has no variables, and the goal is a call that is executed in one step; that case is fused.
        """
        act, on_solution = self.call_once, completion.action
        dispatcher = self._dispatcher

        def act_on_event(term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
            return act(term, values, start, end, dispatcher.ground(), on_solution, frame)

        if self.outputs or not self._takes_all_values or not self.match_vars:
            return Continuation(act_on_event)
        return Continuation(
            compile_goal_action(
                self._ground_goal,
                len(self.match_vars),
                self.rule,
                self.report_error,
                act_on_event,
                completion,
            ),
            True,
        )

    def call_for_all(
        self,
        term: Term,
        values: Values,
        start: int,
        end: int,
        ground: bool,
        on_solution: EventAction,
        frame: Frame,
    ) -> Frame:
        """Return the frame that continues with ``on_solution`` for each solution, in order; see `call_once`."""
        inputs = tuple([values[position] for position in self._input_positions])
        ground = ground or are_ground(inputs)
        # All solutions are computed first: events that follow from the first solution must not change the later
        # ones.
        goal = self._compile(self._inputs, self.outputs, True) if ground else self._open_goal(True)

        def emit_solutions(term: Term, collected: Values, start: int, end: int, frame: Frame) -> Frame:
            solutions = [tuple(list_items(item) or ()) for item in list_items(collected[0]) or ()]
            if ground:
                solutions = [values + solution for solution in solutions]
            return emit_each(
                metered(solutions, self.rule.meter),
                lambda solution, next_frame: on_solution(term, solution, start, end, next_frame),
                frame,
            )

        inputs = inputs if ground else values
        return self._dispatcher.call(
            goal, inputs, self._report_error_of_call, emit_solutions, term, (), start, end, frame
        )

    def with_cause(
        self, match: PartialMatch, on_solution: EventAction, frame: Frame
    ) -> Tuple[EventAction, Frame]:
        """Record the match as the cause of the events that the goal makes, until it ends.

        Returns:
            The arguments for `call_once` in place of ``on_solution`` and ``frame``.
        """
        return self._dispatcher.caused_by((self.rule, match), on_solution, frame)

    def _open_goal(self, collects_all: bool = False) -> CompiledGoal:
        """Return the goal for values with variables; it returns all values, because a solution may bind any."""
        return self._compile(self.match_vars, self.result_vars, collects_all)

    def _compile(self, inputs: Sequence[Var], outputs: Sequence[Var], collects_all: bool) -> CompiledGoal:
        """Return the goal for some inputs and outputs; with ``collects_all`` its output is a list of solutions."""
        key = (tuple(inputs), tuple(outputs), collects_all)
        compiled = self._compiled.get(key)
        if compiled is None:
            goal, requested_outputs = self.goal, list(outputs)
            if collects_all:
                all_solutions = Var()
                goal = (_FINDALL, make_list(outputs), goal, all_solutions)
                requested_outputs = [all_solutions]
            rule = self.rule
            compiled = self._compiled[key] = rule.network.logic.compile_goal(
                goal,
                list(inputs),
                requested_outputs,
                rule.place,
                f"rule {rule.name}",
                self._comes_from_client,
            )
        return compiled

    def _report_error_of_call(self, values: Values, error: PrologError) -> None:
        self.report_error(error)

    def report_error(self, error: PrologError) -> None:
        """Report an error that the goal raised."""
        self.rule.network.report_goal_error(self.rule, self.goal, error)


def compile_condition_test(
    rule_goal: RuleGoal, condition: ConditionPattern, interval_positions: Optional[Tuple[int, int]]
) -> Test:
    """Return the test of a condition.

    Args:
        rule_goal: the goal.
        condition: the condition.
        interval_positions: positions of the interval of the condition's pattern among the values, if it is tested
            further up; a variable there means that the pattern is in a branch that was not taken.
    """
    extend_values: ExtendValues = rule_goal.extend_values
    use_counts = rule_goal.rule.use_counts
    if use_counts is not None:
        extend_values = use_counts.count_outcomes(condition, extend_values)
    condition_state = rule_goal.rule.network.condition_state
    uses_interval = condition.timed
    new_var_count = len(rule_goal.outputs)

    def without_interval(values: Values, start: int, end: int) -> Optional[Values]:
        return extend_values(values)

    def with_interval(values: Values, start: Any, end: Any) -> Optional[Values]:
        if interval_positions is not None:
            start, end = values[interval_positions[0]], values[interval_positions[1]]
            if start.__class__ is Var:
                return values + tuple([Var() for _ in range(new_var_count)])
        if not uses_interval:
            return extend_values(values)
        # Conditions nest: the event that a condition makes may cause another timed condition.
        previous_interval = condition_state.condition_interval
        condition_state.condition_interval = (start, end)
        try:
            return extend_values(values)
        finally:
            condition_state.condition_interval = previous_interval

    return with_interval if uses_interval or interval_positions is not None else without_interval


_IS = functor("is", 2)

Evaluate = Callable[[Term, Values], Term]
"""Returns the value of an expression, given the expression and the values of the match that it was made from."""
FoldFunction = Callable[[Sequence[Term]], Optional[Term]]
"""Returns the result of a user-defined aggregate for values, oldest first."""
GoalTest = Callable[[Values], bool]
"""Returns whether a goal has a solution for values."""


class Evaluators:
    """Compiles the goals of windows and aggregates.

    Args:
        rule: the rule that contains them.
    """

    def __init__(self, rule: "EventRule"):
        self._rule = rule

    def compile_expression(
        self, aggregate: str, expression: Term, value_vars: Sequence[Var], may_be_array: bool = False
    ) -> Evaluate:
        """Return a function that evaluates the expression of an aggregate by `is`.

        The values of its variables must be numbers: `is` would also evaluate an atom such as `e` and a text of one
        character.

        Args:
            aggregate: name of the aggregate.
            expression: the expression in the rule.
            value_vars: variables of the matches.
            may_be_array: whether a variable may have an array as its value, which is returned unchanged.
        """
        # `is` evaluates a list of one item to the value of that item, so only a plain variable may be an array.
        may_be_array = may_be_array and deref(expression).__class__ is Var
        result_var, expression_var = Var(), Var()
        compiled_goal: List[CompiledGoal] = []
        position_of = positions(value_vars)
        input_positions = [position_of[var] for var in variables(expression) if var in position_of]
        is_valid_input = (
            is_number_expression if AGGREGATES[aggregate].value_rule.accepts_expressions else is_number
        )

        def evaluate(term: Term, values: Values) -> Term:
            if may_be_array and array_length(term) is not None:
                return term
            for position in input_positions:
                if not is_valid_input(values[position]):
                    raise value_error(aggregate, values[position])
            # Compiled at the first use: most expressions are variables whose values are numbers already.
            if not compiled_goal:
                logic = self._rule.network.logic
                compiled_goal.append(
                    logic.compile_goal((_IS, result_var, expression_var), [expression_var], [result_var])
                )
            try:
                solution = compiled_goal[0].first_solution((term,))
            except PrologError as error:
                record_caught_error(error)
                raise RuleError(f"{value_error(aggregate, term).message}: {error.message}") from error
            if solution is None:
                raise value_error(aggregate, term)
            return solution[0]

        return evaluate

    def compile_test(self, goal: Term, value_vars: Sequence[Var], title: str) -> GoalTest:
        """Return a function that calls a goal, given the values of some variables; errors begin with ``title``."""
        compiled = self._rule.network.logic.compile_goal(goal, list(value_vars), [])

        def is_satisfied(values: Values) -> bool:
            try:
                return compiled.first_solution(values) is not None
            except PrologError as error:
                record_caught_error(error)
                raise RuleError(f"{title}: {error.message}") from error

        return is_satisfied

    def compile_setting(self, aggregate: str, setting: Any) -> Setting:
        """Return the setting of an aggregate; the predicates of a user-defined one become a function."""
        return self.compile_fold(setting) if aggregate == "fold" else setting

    def compile_fold(self, predicate_names: Tuple[Atom, Atom, Atom]) -> FoldFunction:
        """Return a function that calls the predicates of a user-defined aggregate; it returns None if one fails.

        Args:
            predicate_names: names of three predicates. The first returns the initial state, the second takes a value
                and a state and returns the next state, and the third takes a state and returns the result.
        """
        logic = self._rule.network.logic
        value, state, output = Var(), Var(), Var()
        initial_goal = logic.compile_goal((functor(predicate_names[0].name, 1), output), [], [output])
        step_goal = logic.compile_goal(
            (functor(predicate_names[1].name, 3), value, state, output), [value, state], [output]
        )
        result_goal = logic.compile_goal(
            (functor(predicate_names[2].name, 2), state, output), [state], [output]
        )

        def fold(values: Sequence[Term]) -> Optional[Term]:
            try:
                current = initial_goal.first_solution(())
                for element in values:
                    # A failing step makes the whole aggregate fail.
                    current = None if current is None else step_goal.first_solution((element, current[0]))
                result = None if current is None else result_goal.first_solution((current[0],))
            except PrologError as error:
                record_caught_error(error)
                raise RuleError(f"aggregate fold: {error.message}") from error
            return None if result is None else result[0]

        return fold
