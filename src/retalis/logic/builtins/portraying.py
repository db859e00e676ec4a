"""What a goal writes, caught; and ``portray/1``, by which a program says how terms of its own are printed."""

from typing import Any, Callable, List, Optional, Tuple

from ...syntax import write_term
from ...terms import Term, functor
from ..compiler.nodes import NOT

_PORTRAY = functor("portray", 1)


def caught(machine: Any, goal: Term) -> Tuple[bool, str]:
    """Return whether a goal succeeds, and what it writes."""
    logic = machine.logic
    output, column = logic.output, logic.column
    written: List[str] = []
    logic.output = written.append
    try:
        succeeded = logic.once(goal)
    finally:
        logic.output, logic.column = output, column
    return succeeded, "".join(written)


def portray_of(machine: Any) -> Optional[Callable[[Term], Optional[str]]]:
    """Return what gives the text of a term by the program's ``portray/1``; None where it has none."""
    if not machine.logic.defines(_PORTRAY):
        return None

    def portray(term: Term) -> Optional[str]:
        succeeded, text = caught(machine, (NOT, (NOT, (_PORTRAY, term))))  # without its bindings
        return text if succeeded else None

    return portray


def printed(machine: Any, term: Term) -> str:
    """Return the text of a term as ``print/1`` writes it."""
    return write_term(term, machine.logic.operators, numbervars=True, portray=portray_of(machine))
