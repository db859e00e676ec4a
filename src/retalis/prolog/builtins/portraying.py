"""What a goal writes, caught; and ``portray/1``, by which a program says how terms of its own are printed."""

from typing import Callable, Optional, Tuple

from ..compiler import NOT
from ..syntax import write_term
from ..terms import Term, functor
from .program import Machine
from .streams import OutputCapture
from .text import joined

_PORTRAY = functor("portray", 1)


def caught(machine: Machine, goal: Term) -> Tuple[bool, str]:
    """Return whether a goal succeeds, and what it writes."""
    logic = machine.logic
    capture = OutputCapture(logic)
    try:
        succeeded = logic.once(goal)
    finally:
        capture.end()
    return succeeded, joined(capture.texts)


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
