"""The goals of a program that aggregates ask: numbers of expressions, conditions of steps, folds of its own."""

from typing import Callable, List, Optional, Sequence, Tuple

from ...foundation import RuleError
from ...prolog.database import CompiledGoal
from ...prolog.machine import PrologError, keep_back
from ...prolog.terms import Atom, Term, Values, Var, functor, positions, variables
from ..streams import ADDING, is_number, is_number_expression, unfit
from .owners import RuleOwner

_IS = functor("is", 2)

Evaluate = Callable[[Term, Values], Term]
"""Gives the number of an expression, from the expression and the values of the match that it was made of."""
Folding = Callable[[Sequence[Term]], Optional[Term]]
"""Gives the result of a program's own aggregate for values, oldest first."""
Holding = Callable[[Values], bool]
"""Tells whether a goal holds for values."""


class Asking:
    """Makes the goals that windows and aggregates ask.

    Args:
        rule: the rule to which they belong.
    """

    def __init__(self, rule: RuleOwner):
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
