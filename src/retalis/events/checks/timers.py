"""Timers that are told to ring at what is no time."""

from typing import Iterator

from ...foundation import RuleError
from ..language import TIMER, schedule_fault
from .overview import Overview


def timers(program: Overview) -> Iterator[RuleError]:
    """Yield the goals that set a timer and say when as no timer can be told."""
    if not program.logic.is_of_system(TIMER):
        return
    for inner in program.called():
        fault = schedule_fault(inner.term[2]) if inner.key is TIMER else None
        if fault is not None:
            text = f"timer/2: {fault}, found {program.logic.brief(inner.term[2], program.names)}"
            yield RuleError(text, inner.spot(inner.term, 2))
