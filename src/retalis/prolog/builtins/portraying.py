"""What a goal writes, caught; and ``portray/1``, by which a program says how terms of its own are printed."""

from typing import Callable, List, Optional, Tuple

from ..compiler import NOT
from ..syntax import write_term
from ..terms import Term, functor
from .program import Machine, MachineProgram
from .text import long_text

_PORTRAY = functor("portray", 1)


class OutputCapture:
    """Output that is kept.

    Attributes:
        texts: what was written.
        before: where output went before, and where that stood in its line.
    """

    def __init__(self, logic: MachineProgram):
        self.texts: List[str] = []
        self.before = logic.output, logic.column
        self._size = 0

    def __call__(self, text: str) -> None:
        """Keep a text."""
        self._size += len(text)
        long_text(self._size)
        self.texts.append(text)


def caught(machine: Machine, goal: Term) -> Tuple[bool, str]:
    """Return whether a goal succeeds, and what it writes."""
    logic = machine.logic
    capture = logic.output = OutputCapture(logic)
    try:
        succeeded = logic.once(goal)
    finally:
        logic.output, logic.column = capture.before
    return succeeded, "".join(capture.texts)


def portray_of(machine: Machine) -> Optional[Callable[[Term], Optional[str]]]:
    """Return what gives the text of a term by the program's ``portray/1``; None where it has none."""
    if not machine.logic.defines(_PORTRAY):
        return None

    def portray(term: Term) -> Optional[str]:
        succeeded, text = caught(machine, (NOT, (NOT, (_PORTRAY, term))))  # without its bindings
        return text if succeeded else None

    return portray


def printed(machine: Machine, term: Term) -> str:
    """Return the text of a term as ``print/1`` writes it."""
    return write_term(term, machine.logic.operators, numbervars=True, portray=portray_of(machine))
