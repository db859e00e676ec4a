"""From the steps of a window as they are read to such as its operator runs."""

from functools import partial
from typing import Callable, Dict, Sequence, Tuple

from ...prolog.terms import Term, Var, variables
from ..language import StepForm, WindowForm, conditions
from ..streams import StepMark, StepPlan, StepTest, StreamItem, WindowStep
from .asking import Holding

GivenGoal = Callable[[Term, Sequence[Var], str], Holding]
"""Gives what asks a goal, given the values of some variables and what reports call it."""


def planned(form: WindowForm, before: int, holding: GivenGoal) -> StepPlan:
    """Return the plan of the steps of a window.

    Args:
        form: the window.
        before: how many values of an item come before those that conditions look at.
        holding: gives what asks a goal.
    """
    places = {var: at for at, var in enumerate(form.looked_at, before)}
    names = [one.name for one in form.steps]
    marks: Dict[StepMark, int] = {}

    def test(goal: Term, at: int, called: str) -> Tuple[StepTest, ...]:
        made = []
        for one in conditions(goal, names, at, places):
            own = [var for var in variables(one.goal) if var in places]
            holds = holding(one.goal, [*own, *(back.stands for back in one.back)], called)
            back = [
                marks.setdefault(StepMark(back.kind, -1 if back.kind == "prev" else back.step), len(marks))
                for back in one.back
            ]
            values = [places[var] for var in own], [places[back.var] for back in one.back]
            made.append(StepTest(tuple(back), partial(_holds, holds, *values)))
        return tuple(made)

    def step(at: int, one: StepForm) -> WindowStep:
        tests, until = [
            () if goal is None else test(goal, at, f"{called} of the step {one.name}")
            for goal, called in ((one.goal, "the condition"), (one.until, "until"))
        ]
        return WindowStep(one.least, one.most, one.reluctant, one.later, tests, until)

    steps = [step(at, one) for at, one in enumerate(form.steps)]
    return StepPlan(steps, list(marks))


def _holds(
    holds: Holding, own: Sequence[int], backs: Sequence[int], item: StreamItem, asked: Sequence[StreamItem]
) -> bool:
    """Tell whether a goal holds for values of an item and of those that it looks back at."""
    values = [item.values[at] for at in own]
    if backs:
        values += [one.values[at] for one, at in zip(asked, backs)]
    return holds(tuple(values))
