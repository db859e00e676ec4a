"""Goals of rules: conditions that are part of a match, and actions."""

from typing import Any, Callable, Dict, Optional, Sequence, Tuple

from ...prolog.database import CompiledGoal
from ...prolog.machine import Frame, PrologError, resource_error
from ...prolog.terms import (
    EventAction,
    Term,
    Values,
    Var,
    are_ground,
    functor,
    list_items,
    make_list,
    positions,
    variables,
)
from ..fused import Completion, goal_action
from ..matches import Match, counted, emit_each
from .owners import RuleOwner

Test = Callable[[Values, int, int], Optional[Values]]
"""Takes values and interval of a match; gives the values with what was found, or None where it fails."""


_DEEPEST = 30
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

    def __init__(self, rule: RuleOwner, goal: Term, known: Sequence[Var]):
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
            if under_way.nested > _DEEPEST:
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

    def alone(self, completion: Completion) -> Completion:
        """Return what calls the goal for an event alone and goes on with a completion.

        Most often the event has no variables, and the goal is a call that is done in one step.
        """
        act, solved = self.act, completion.action
        dispatcher = self._dispatcher

        def plain(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            return act(term, values, start, end, dispatcher.ground(), solved, after)

        if self.outputs or not self._takes_all or not self.known:
            return Completion(plain)
        return Completion(
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

    def noting_cause(self, match: Match, solved: EventAction, after: Frame) -> Tuple[EventAction, Frame]:
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
