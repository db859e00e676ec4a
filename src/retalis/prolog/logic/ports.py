"""Goals traced by their ports."""

from typing import Optional

from ..builtins import control
from ..machine import Code, Frame, Guard, Machine
from ..terms import Values
from .tracing import Tracer


@control("trace/1")
def trace(machine: Machine, args: Values, after: Frame) -> Optional[Frame]:
    """Call a goal and write a line for each port that it passes to the error output."""
    logic = machine.logic
    tracer = Tracer(logic, lambda line: logic.error_output(f"{line}\n"))
    tracer.start()
    height = len(machine.choices)
    machine.choices.append((_TRACED, tracer, len(machine.trail)))
    return tracer.solve(args[0], height + 1, (_LEFT, machine, tracer, height, after))


def _left(frame: Frame) -> Frame:
    machine: Machine
    tracer: Tracer
    after: Frame
    _, machine, tracer, height, after = frame
    tracer.stop()
    if len(machine.choices) == height + 1:
        machine.choices.pop()
    else:
        machine.choices.append((_AGAIN, tracer, len(machine.trail)))
    return after


_TRACED = Guard("trace", lambda entry: entry[1].stop())
_LEFT = Code("trace", _left)
_AGAIN = Code("trace", lambda entry: entry[1].start())
