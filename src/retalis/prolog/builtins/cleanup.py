"""Cleanup: what runs when a goal is over, however it ends."""

from typing import Optional

from ...foundation import PYPY
from ..compiler import ARROW, CALL, SEMICOLON
from ..machine import Code, Frame, Guard, PrologError, instantiation_error, keep_back
from ..terms import TRUE, Term, Values, Var, atom, deref, undo
from .program import Machine
from .registry import control


class _Cleanup:
    """The cleanup of a goal; held by the goal's guard among the choice points and by nothing else.

    So it is told of a cut, too, without costing other cuts anything: a guard that is cut off is freed, and this
    with it. Where Python does not free it at once, the guard is told, see `Code.dropped`.
    """

    __slots__ = ("machine", "goal", "done")

    def __init__(self, machine: Machine, goal: Term):
        self.machine = machine
        self.goal = goal
        self.done = False

    def run(self) -> None:
        """Run the cleanup at once; its failure and its bindings do not count, its error is reported."""
        if self.done:
            return
        self.done = True
        machine = self.machine
        mark = len(machine.trail)
        try:
            machine.logic.once(self.goal)
        except PrologError as error:
            if keep_back(error):
                try:
                    machine.logic.error_output(f"Warning: cleanup: {error.message}\n")
                except PrologError as passed:  # the limit of output: nobody could catch it here
                    keep_back(passed)
        undo(machine.trail, mark)

    if not PYPY:  # there it would come at any time

        def __del__(self) -> None:
            self.run()


@control("setup_call_cleanup/3")
def setup_call_cleanup(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Run a goal, and a cleanup once it has failed, thrown, exited without choice points, or been cut."""
    setup, goal, cleanup = args
    return machine.logic.control.once(setup, (_GUARDED, machine, goal, cleanup, after))


@control("call_cleanup/2")
def call_cleanup(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Run a goal, and a cleanup once it has failed, thrown, exited without choice points, or been cut."""
    return setup_call_cleanup(machine, (atom("true"), *args), after)


def _guarded(frame: Frame) -> Optional[Frame]:
    machine: Machine
    after: Frame
    _, machine, goal, cleanup, after = frame
    if deref(cleanup).__class__ is Var:  # not before: the setup may give it
        raise instantiation_error()
    height = len(machine.choices)
    machine.choices.append((_CLEANUP, _Cleanup(machine, cleanup), len(machine.trail)))
    return machine.logic.control.call(goal, (_LEFT, machine, height, after))


def _left(frame: Frame) -> Optional[Frame]:
    machine: Machine
    after: Frame
    _, machine, height, after = frame
    if len(machine.choices) > height + 1:
        return after
    cleanup: _Cleanup = machine.choices.pop()[1]
    cleanup.done = True
    goal = (SEMICOLON, (ARROW, (CALL, cleanup.goal), TRUE), TRUE)
    return machine.logic.control.once(goal, after)


_GUARDED = Code("setup_call_cleanup", _guarded)
_LEFT = Code("setup_call_cleanup", _left)
_CLEANUP = Guard("setup_call_cleanup", lambda entry: entry[1].run())
_CLEANUP.dropped = _CLEANUP.unwind
