"""What events came from, kept for revision and justification."""

from typing import Any

from ..terms import Term
from .matches import Match
from .policy import Frame


class Tracker:
    """Keeps where derived events came from, while a flag asks for it."""

    def __init__(self, rules: Any):
        self._rules = rules

    def configure(self) -> None:
        """Follow the flags."""

    def clear(self) -> None:
        """Forget all."""

    def fire(self, rule: Any, match: Match, head: Term, after: Frame) -> Frame:
        """Fire a rule and keep what its event came from."""
        return rule.fire(head, match.start, match.end, after)
