"""Alarms that rules have set: events that fire when an instant has come."""

from typing import Any, Optional

from ...prolog.terms import Term
from ..history import Occurrence
from ..network import RuleOwner


class RuleAlarm:
    """An event of a rule that is to fire, called by the clock when its instant has come.

    Args:
        rules: of the program.
        rule: the one that has set the alarm.
        term: the event.
        start: where its interval starts.
        instant: when it fires, where the interval ends.
        token: of the event, where it is kept what events came from.
    """

    __slots__ = ("rules", "rule", "term", "start", "instant", "token")

    def __init__(
        self,
        rules: Any,
        rule: RuleOwner,
        term: Term,
        start: int,
        instant: int,
        token: Optional[Occurrence],
    ):
        self.rules = rules
        self.rule = rule
        self.term = term
        self.start = start
        self.instant = instant
        self.token = token

    def __call__(self, now: int) -> None:
        """Fire the event, unless what it came from was taken back meanwhile."""
        token = self.token
        if token is not None:
            if token.gone:
                return
            token.term, token.start, token.end = self.term, self.start, self.instant
        machine = self.rules.logic.machine
        fire = self.rule.fire
        self.rules.dispatcher.apart(
            lambda: machine.run(fire(self.term, self.start, self.instant, machine.done, token))
        )
