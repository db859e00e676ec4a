"""Timers that are told to ring at what is no time."""

from typing import Any, Iterator, Tuple

from ...foundation import RuleError
from ...prolog.terms import CompoundTerm
from ..language import TIMER, Occurs, Spot, calls, own_terms, schedule_fault, walk
from .overview import Overview
from .written import held


def timers(program: Overview) -> Iterator[RuleError]:
    """Yield the goals that set a timer and say when as no timer can be told."""
    if not program.logic.is_of_system(TIMER):
        return
    for parent, number, spot in _goals(program):
        for call in calls(parent, number):
            term: Any = call.term
            fault = schedule_fault(term[2]) if term.__class__ is tuple and term[0] is TIMER else None
            if fault is not None:
                text = f"timer/2: {fault}, found {program.logic.brief(term[2], program.names)}"
                yield RuleError(text, spot(term, 2))


def _goals(program: Overview) -> Iterator[Tuple[CompoundTerm, int, Spot]]:
    """Yield what is called: goals, bodies of clauses, goals of rules."""
    for one in (*program.goals, *program.clauses):
        yield one.parent, one.number, one.spot
    for rule in program.rules:
        for part in walk(rule.definition.pattern, negated=True):
            if not isinstance(part, Occurs):
                for goal in own_terms(part):
                    yield held(goal), 1, rule.spot
