"""The goals that set timers, cancel and list them: ``timer/2``, ``cancel_timer/1,2``, ``timers/1``."""

from typing import Any, Callable, List

from ...foundation import UsageError
from ...prolog.builtins import callable_of
from ...prolog.logic import Logic
from ...prolog.machine import Machine, domain_error, instantiation_error
from ...prolog.terms import Term, Var, WholeSeconds, atom, copy, deref, functor, make_list, shown
from .timers import Timers

_LISTED = functor("timer", 3)
_WAITS = atom("waits")


def define_timers(logic: Logic, timers: Timers, require: Callable[[Term], None]) -> None:
    """Define the goals of timers; ``require`` raises an error for an event that is declared otherwise."""
    _TimerGoals(timers, require).define(logic)


class _TimerGoals:
    """Goals of timers."""

    def __init__(self, timers: Timers, require: Callable[[Term], None]):
        self.timers = timers
        self.require = require

    def define(self, logic: Logic) -> None:
        logic.define("timer", 2, self.set)
        logic.define("cancel_timer", 1, self.cancel)
        logic.define("cancel_timer", 2, self.cancel_counting)
        logic.define("timers", 1, self.list)

    def set(self, machine: Machine, event: Term, when: Term) -> bool:
        event, when = callable_of(event), deref(when)
        if when.__class__ is Var:
            raise instantiation_error()
        self.require(event)
        try:
            self.timers.set(event, when)
        except UsageError as error:
            raise domain_error("timer", when, error.message) from None
        return True

    def cancel(self, machine: Machine, event: Term) -> bool:
        self.timers.cancel(deref(event))
        return True

    def cancel_counting(self, machine: Machine, event: Term, number: Term) -> bool:
        return bool(machine.unify(number, self.timers.cancel(deref(event))))

    def list(self, machine: Machine, found: Term) -> bool:
        rows: List[Any] = []
        for timer in self.timers:
            instant = _WAITS if timer.instant is None else shown(WholeSeconds(timer.instant))
            rows.append((_LISTED, copy(timer.event), copy(timer.schedule.term), instant))
        return bool(machine.unify(found, make_list(rows)))
