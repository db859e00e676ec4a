"""The rule that nodes belong to and what it is part of, as far as nodes look at them.

Goals of rules: conditions that are part of a match, and actions.

The goals of a program that aggregates ask: numbers of expressions, conditions of steps, folds of its own.
"""

from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Protocol, Sequence, Tuple

from ...foundation.errors import RuleError
from ...prolog.database.compiled_goal import CompiledGoal
from ...prolog.machine.errors import PrologError, resource_error
from ...prolog.machine.resource_limits import keep_back
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import are_ground, positions, variables
from ...prolog.terms.types import Atom, EventAction, Frame, Term, Values, Var, functor
from ..fused.fused_actions import Continuation, goal_action
from ..matches.consumption_policy import counted, emit_each
from ..matches.partial_matches import PartialMatch
from ..streams.accumulators import ADDING, is_number, is_number_expression, unfit

if TYPE_CHECKING:
    from .event_rule import EventRule


class Buffer(Protocol):
    """Where matches wait.

    Attributes:
        forbids: whether what waits is about what must not happen.
    """

    forbids: bool

    @property
    def span(self) -> Optional[int]:
        """For how many nanoseconds what waits is of use; None for no bound."""

    def mend(self) -> List[PartialMatch]:
        """Put right what an interrupt may have left half done; return what waits, oldest first."""


class Wakeful(Protocol):
    """What nodes that the clock wakes belong to: a rule, or what stands beside rules.

    Attributes:
        serial: its place among them: lower ones are served first.
    """

    serial: int

    @property
    def active(self) -> bool:
        """Whether it takes events."""


class Woken(Protocol):
    """A node that the clock wakes.

    Attributes:
        woken: the instant at which it is to be woken.
        place: its place among the nodes of the same.
    """

    woken: Optional[int]
    place: int

    @property
    def rule(self) -> "Wakeful":
        """What it belongs to."""

    def ring(self, instant: int, after: Frame, /) -> Frame:
        """Return the frame that does what is due, and goes on with ``after``."""


class UnderWay:
    """What the conditions of all rules share while they are tested.

    Attributes:
        nested: how many of them are being tested, one within the other.
        checked: the interval that ``t1/1`` and ``t2/1`` give, of the innermost that has one.
    """

    nested: int = 0
    checked: Optional[Tuple[int, int]] = None


Test = Callable[[Values, int, int], Optional[Values]]
"""Takes values and interval of a match; gives the values with what was found, or None where it fails."""


_MAX_CONDITION_DEPTH = 30
"""How often a condition may make an event whose rules have a condition that makes an event, and so on."""
_FINDALL = functor("findall", 3)


class RuleGoal:
    """A goal of a rule, compiled for the variables that are known where it stands.

    Args:
        rule: whose goal it is.
        goal: the goal.
        known: whose values a match carries.

    Attributes:
        result_vars: ``known``, then the other variables of the goal.
    """

    def __init__(self, rule: "EventRule", goal: Term, known: Sequence[Var]):
        self.rule = rule
        self.goal = goal
        self.known = list(known)
        mentioned = positions(variables(goal))
        places = positions(self.known)
        inputs = [var for var in self.known if var in mentioned]
        self.positions = tuple(places[var] for var in inputs)
        self._takes_all = inputs == self.known
        self.outputs = [var for var in mentioned if var not in places]
        self.result_vars = [*self.known, *self.outputs]
        self._from_outside = (
            rule.network.logic.from_outside
        )  # other ways to call it are compiled when they are needed
        self._compiled: Dict[Tuple[object, ...], CompiledGoal] = {}
        self._inputs = inputs
        self._plain = self._compile(inputs, self.outputs, False)
        self._dispatcher = rule.network.dispatcher
        self._under_way = rule.network.under_way

    def test(self, values: Values) -> Optional[Values]:
        """Return the values with those of the first solution, or None; an error counts as failure and is reported."""
        current = self._dispatcher.current
        under_way = self._under_way
        under_way.nested += 1
        try:
            if under_way.nested > _MAX_CONDITION_DEPTH:
                raise resource_error("conditions_that_make_events")
            given = tuple([values[at] for at in self.positions])
            if are_ground(given):
                found = self._plain.test(given)
                if found is None:
                    return None
                return values + found if found else values
            return self._open().test(values)
        except PrologError as error:
            self._dispatcher.restore(current, self._dispatcher.cause)
            self.failed(error)
            return None
        finally:
            under_way.nested -= 1

    def act(
        self,
        term: Term,
        values: Values,
        start: int,
        end: int,
        ground: bool,
        solved: EventAction,
        after: Frame,
    ) -> Frame:
        """Return the frame that calls the goal once and goes on with ``solved``; with ``after`` if it fails.

        Args:
            term: the event, where the match is of one; handed on.
            values: those of the match that it is called for.
            start: where the match starts; handed on.
            end: where it ends; handed on.
            ground: whether it is known that no value has variables.
            solved: takes what was handed on, with the values that were found after the others.
            after: the frame to go on with.
        """
        given = values if self._takes_all else tuple([values[at] for at in self.positions])
        if ground or are_ground(given):
            goal, kept = self._plain, values
        else:
            goal, given, kept = self._open(), values, ()
        return self._dispatcher.call(goal, given, self._reported, solved, term, kept, start, end, after)

    @property
    def plain(self) -> CompiledGoal:
        """The goal for inputs without variables."""
        return self._plain

    def alone(self, completion: Continuation) -> Continuation:
        """Return what calls the goal for an event alone and goes on with a completion.

        Most often the event has no variables, and the goal is a call that is done in one step.
        """
        act, solved = self.act, completion.action
        dispatcher = self._dispatcher

        def plain(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            return act(term, values, start, end, dispatcher.ground(), solved, after)

        if self.outputs or not self._takes_all or not self.known:
            return Continuation(plain)
        return Continuation(
            goal_action(self._plain, len(self.known), self.rule, self.failed, plain, completion), True
        )

    def act_on_all(
        self,
        term: Term,
        values: Values,
        start: int,
        end: int,
        ground: bool,
        solved: EventAction,
        after: Frame,
    ) -> Frame:
        """Return the frame that goes on with ``solved`` for every solution of the goal, in order; see `act`."""
        given = tuple([values[at] for at in self.positions])
        ground = ground or are_ground(given)
        goal = self._compile(self._inputs, self.outputs, True) if ground else self._open(True)

        def each(term: Term, found: Values, start: int, end: int, after: Frame) -> Frame:
            solutions = [tuple(list_items(item) or ()) for item in list_items(found[0]) or ()]
            if ground:
                solutions = [values + solution for solution in solutions]
            return emit_each(
                counted(solutions, self.rule.meter),
                lambda solution, then: solved(term, solution, start, end, then),
                after,
            )

        given = given if ground else values
        return self._dispatcher.call(goal, given, self._reported, each, term, (), start, end, after)

    def noting_cause(
        self, match: PartialMatch, solved: EventAction, after: Frame
    ) -> Tuple[EventAction, Frame]:
        """Have events that the goal makes know what it was called for, until it is over.

        Returns:
            What to hand to `act` instead of ``solved`` and ``after``.
        """
        return self._dispatcher.caused_by((self.rule, match), solved, after)

    def _open(self, every: bool = False) -> CompiledGoal:
        """Return the goal for values with variables: it gives all values anew, as its solution leaves them."""
        return self._compile(self.known, self.result_vars, every)

    def _compile(self, inputs: Sequence[Var], outputs: Sequence[Var], every: bool) -> CompiledGoal:
        key = (tuple(inputs), tuple(outputs), every)
        found = self._compiled.get(key)
        if found is None:
            goal, wanted = self.goal, list(outputs)
            if every:
                all_solutions = Var()
                goal = (_FINDALL, make_list(outputs), goal, all_solutions)
                wanted = [all_solutions]
            rule = self.rule
            found = self._compiled[key] = rule.network.logic.compile_goal(
                goal, list(inputs), wanted, rule.place, rule.name, self._from_outside
            )
        return found

    def _reported(self, values: Values, error: PrologError) -> None:
        self.failed(error)

    def failed(self, error: PrologError) -> None:
        """Report an error that the goal raised."""
        self.rule.network.goal_failed(self.rule, self.goal, error)


def goal_test(call: RuleGoal, timed: bool, captured: Optional[Tuple[int, int]]) -> Test:
    """Return the test of a condition.

    Args:
        call: the goal.
        timed: whether ``t1/1`` and ``t2/1`` hold in it.
        captured: where the interval of the condition's pattern stands among the values, if it is tested
            further up; a variable there means that the pattern is in a branch that was not taken.
    """
    goal = call.test
    under_way = call.rule.network.under_way
    missing = [Var for _ in call.outputs]

    def plain(values: Values, start: int, end: int) -> Optional[Values]:
        return goal(values)

    def with_interval(values: Values, start: Any, end: Any) -> Optional[Values]:
        if captured is not None:
            start, end = values[captured[0]], values[captured[1]]
            if start.__class__ is Var:
                return values + tuple([make() for make in missing])
        if not timed:
            return goal(values)
        before = under_way.checked
        under_way.checked = (start, end)
        try:
            return goal(values)
        finally:
            under_way.checked = before

    return with_interval if timed or captured is not None else plain


_IS = functor("is", 2)

Evaluate = Callable[[Term, Values], Term]
"""Gives the number of an expression, from the expression and the values of the match that it was made of."""
Folding = Callable[[Sequence[Term]], Optional[Term]]
"""Gives the result of a program's own aggregate for values, oldest first."""
Holding = Callable[[Values], bool]
"""Tells whether a goal holds for values."""


class Evaluators:
    """Makes the goals that windows and aggregates ask.

    Args:
        rule: the rule to which they belong.
    """

    def __init__(self, rule: "EventRule"):
        self._rule = rule

    def evaluating(self, kind: str, measured: Term, names: Sequence[Var]) -> Evaluate:
        """Return a function that evaluates what an aggregate measures, by `is`.

        The expression that stands in the rule is evaluated. The values of its variables have to be numbers: `is`
        would evaluate an atom such as `e` and a text of one character, too.

        Args:
            kind: the name of the aggregate.
            measured: the expression, as it stands in the rule.
            names: the variables of the matches.
        """
        number, expression = Var(), Var()
        goal: List[CompiledGoal] = []
        places = positions(names)
        at = [places[var] for var in variables(measured) if var in places]
        fits = is_number_expression if kind in ADDING else is_number

        def evaluate(term: Term, values: Values) -> Term:
            for place in at:
                if not fits(values[place]):
                    raise unfit(kind, values[place])
            if not goal:
                logic = self._rule.network.logic
                goal.append(logic.compile_goal((_IS, number, expression), [expression], [number]))
            try:
                found = goal[0].test((term,))
            except PrologError as error:
                keep_back(error)
                raise RuleError(f"{unfit(kind, term).message}: {error.message}") from error
            if found is None:
                raise unfit(kind, term)
            return found[0]

        return evaluate

    def holding(self, goal: Term, names: Sequence[Var], called: str) -> Holding:
        """Return what asks a goal, given the values of some variables."""
        compiled = self._rule.network.logic.compile_goal(goal, list(names), [])

        def holds(values: Values) -> bool:
            try:
                return compiled.test(values) is not None
            except PrologError as error:
                keep_back(error)
                raise RuleError(f"{called}: {error.message}") from error

        return holds

    def folded(self, names: Tuple[Atom, Atom, Atom]) -> Folding:
        """Return what calls the predicates of a program's own aggregate; None where one of them fails.

        The first gives a state, the second takes a value and a state and gives the next one, the third takes a state
        and gives the result.
        """
        logic = self._rule.network.logic
        value, state, found = Var(), Var(), Var()
        begin = logic.compile_goal((functor(names[0].name, 1), found), [], [found])
        step = logic.compile_goal((functor(names[1].name, 3), value, state, found), [value, state], [found])
        show = logic.compile_goal((functor(names[2].name, 2), state, found), [state], [found])

        def fold(values: Sequence[Term]) -> Optional[Term]:
            try:
                reached = begin.test(())
                for one in values:
                    reached = None if reached is None else step.test((one, reached[0]))
                shown = None if reached is None else show.test((reached[0],))
            except PrologError as error:
                keep_back(error)
                raise RuleError(f"aggregate fold: {error.message}") from error
            return None if shown is None else shown[0]

        return fold
