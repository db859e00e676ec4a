"""Events that a fired match skips: `after_match` in the label of a rule.

Comments name the sentence of the language's definition that the code next to them realises.
"""

from typing import Any, Set, Union

from .matches import Event, Match
from .patterns import Rule


class Skipping:
    """Events that the matches of a rule have skipped."""

    def __init__(self, rule: Rule) -> None:
        self.kind = rule.after_match
        self.end: Any = None
        """The largest end of those that have fired."""
        self.served: Any = None
        """The same when the event came that is served."""
        self.starts: Set[Any] = set()
        """The starts of those that have fired at the event that is served."""

    def begin_event(self) -> None:
        """Take note that another event has come."""
        self.starts = set()
        self.served = self.end

    def fired(self, match: Match) -> None:
        """Note a match that has fired."""
        self.end = match.end if self.end is None else max(self.end, match.end)
        self.starts.add(match.start)

    def skips(self, match: Match) -> bool:
        """Tell whether one that has fired skips a match, whole or partial, at the event that is served."""
        if self.kind == "skip_past_last":
            # After match: what starts at or before the end of a match that has fired.
            return self.end is not None and match.start <= self.end
        # After match: what starts with one that has fired. What comes later may start there again.
        return self.kind == "skip_to_next" and match.start in self.starts

    def is_past(self, occurrence: Union[Event, Match]) -> bool:
        """Tell whether something comes too late to be a part of a match: also an event that is late itself.

        What the event that is served makes is settled when it has been served.
        """
        return self.kind == "skip_past_last" and self.served is not None and occurrence.start <= self.served
