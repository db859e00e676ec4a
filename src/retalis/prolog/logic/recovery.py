"""Going back to where a machine was before an interrupt, wherever that has come."""

from typing import Any, NamedTuple, Optional

from ..builtins import end_captures
from ..machine import BudgetState, Guard, Machine
from ..terms import undo


class MachineState(NamedTuple):
    """Where a machine is: what a run that begins now leaves as it is."""

    height: int
    mark: int
    budget: BudgetState


def state_of(machine: Machine) -> MachineState:
    """Return where a machine is."""
    return MachineState(len(machine.choices), len(machine.trail), machine.budget.state())


def go_back(machine: Machine, state: Optional[MachineState]) -> None:
    """Go back to a state, or with None to where the machine is while nothing runs; guards are told."""
    height, mark = machine.idle if state is None else state[:2]
    budget, choices = machine.budget, machine.choices
    while len(choices) > height:
        entry = choices[-1]
        if entry[0].__class__ is Guard:
            entry[0].unwind(entry)
        del choices[-1:]
    undo(machine.trail, mark)
    budget.restore(None if state is None else state.budget)


def mend(logic: Any) -> None:
    """Put right what may have been left half done among what outlives a goal; nothing runs."""
    end_captures(logic)
    logic.new_goals = None
    logic.database.modules.mend()
    vars(logic.control).pop("solve", None)  # a tracer's
    logic.database.solve = logic.control.solve
    for predicate in list(logic.database.predicates.values()):
        predicate.mend()
    for part in list(logic.state.values()):
        if hasattr(part, "mend"):
            part.mend()
