"""What an engine does when an interrupt or an error of its own has ended the work on an event or a goal.

An interrupt may come between any two steps, also between two that only together leave all in order. So each part
that outlives an event can be mended: from what it is made of first it makes anew what follows from that.
"""

from typing import Any

from ...events.dispatch import Dispatcher
from ...events.knowledge import Knowledge
from ...events.rules import Rules
from ...prolog.logic import Logic, go_back, mend, state_of
from .runner import Recovery


class EngineRecovery(Recovery):
    """Goes back to a state of an engine, or to that in which nothing is worked on."""

    def __init__(self, logic: Logic, dispatcher: Dispatcher, rules: Rules, knowledge: Knowledge):
        self._logic = logic
        self._dispatcher = dispatcher
        self._rules = rules
        self._knowledge = knowledge

    def state(self) -> Any:
        """Return what is being worked on."""
        return (
            state_of(self._logic.machine),
            self._rules.files.state(),
            self._dispatcher.state(),
            self._logic.new_goals,
        )

    def restore(self, state: Any, mend_all: bool) -> None:
        """Go back to a state, to the idle one with None; that one is made sound where ``mend_all`` says so."""
        if state is not None and not mend_all:
            return  # an error of a program has left all in order
        dispatcher = self._dispatcher
        machine, files, served, goals = (None, None, (None, None), None) if state is None else state
        go_back(self._logic.machine, machine)
        if mend_all:
            self._rules.files.restore(files)
        dispatcher.restore(*served)
        self._logic.new_goals = goals
        if mend_all and state is None:
            mend(self._logic)
            self._logic.from_outside = False
            dispatcher.mend()
            self._rules.mend()
            self._knowledge.mend()
