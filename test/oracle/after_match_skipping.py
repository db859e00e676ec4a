"""Events that a fired match skips: `after_match` in the label of a rule.

Comments name the section of the language's definition that the code next to them implements.
"""

from typing import Any, Set, Union

from .matches import Event, Match
from .pattern_classes import Rule


class Skipping:
    """Events that the matches of a rule have skipped."""

    def __init__(self, rule: Rule) -> None:
        self.kind = rule.after_match
        self.end: Any = None
        """The largest end of the matches that have fired."""
        self.previous_end: Any = None
        """The largest end before the current event."""
        self.starts: Set[Any] = set()
        """The starts of the matches that have fired at the current event."""

    def begin_event(self) -> None:
        """Begin the processing of an event."""
        self.starts = set()
        self.previous_end = self.end

    def fired(self, match: Match) -> None:
        """Record a match that has fired."""
        self.end = match.end if self.end is None else max(self.end, match.end)
        self.starts.add(match.start)

    def skips(self, match: Match) -> bool:
        """Return whether a fired match skips a complete or partial match at the current event."""
        if self.kind == "skip_past_last":
            # After match: matches that start at or before the end of a fired match are skipped.
            return self.end is not None and match.start <= self.end
        # After match: matches that start with a fired match are skipped; those of later events are not.
        return self.kind == "skip_to_next" and match.start in self.starts

    def is_past(self, occurrence: Union[Event, Match]) -> bool:
        """Return whether an event or match starts too early to be a part of a match.

        Matches that fire at the current event count from the next event on.
        """
        return (
            self.kind == "skip_past_last"
            and self.previous_end is not None
            and occurrence.start <= self.previous_end
        )
