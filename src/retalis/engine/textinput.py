"""Events that come as text, as other nodes send them."""

from typing import Callable, Optional

from ..events.rules import DeclaredEvents, InputReader
from ..foundation import RetalisError, beginning
from ..prolog.syntax import Operators
from ..prolog.terms import Term
from .runtime import Reports

LONGEST_INPUT = 10_000_000
"""Characters of an event as text. Reading is not under the limits of what the event starts, so it has its own."""

Take = Callable[[Term, Optional[int], Optional[int], Optional[bool]], None]


class TextInput:
    """Reads events from text and refuses what is none; not for use by two threads at once.

    Args:
        operators: those that hold in the texts.
        take: takes an event, its interval, and whether it is ground, where somebody has looked.
        call: calls a goal once; None where only events are accepted.
        reports: takes a warning of what is refused.
        declared: the events that have been declared, which the others have to fit.
    """

    def __init__(
        self,
        operators: Operators,
        take: Take,
        call: Optional[Callable[[Term], bool]],
        reports: Reports,
        declared: DeclaredEvents,
    ):
        self._reader = InputReader(operators)
        self._take = take
        self._call = call
        self._reports = reports
        self._declared = declared

    def take(self, text: str) -> None:
        """Take a text: ``event/1,2`` and ``new_event/2,3,5``, and any goal where goals are accepted."""
        if len(text) > LONGEST_INPUT:
            self._refuse(
                f"{beginning(text)}: it has {len(text)} characters, at most {LONGEST_INPUT} are allowed"
            )
            return
        try:
            made = self._reader.event(text)
        except RetalisError as error:
            self._refuse(error if error.place else f"{beginning(text)}: {error}")
            return
        if made is not None:
            wrong = self._declared.refusal(made.term) if self._declared.in_use else ""
            if wrong:
                self._refuse(f"{beginning(text)}: {wrong}")
            else:
                self._take(*made)
        elif self._call is not None:
            self._take_goal(text, self._call)
        else:
            self._refuse(f"{beginning(text)}: only event/1,2 and new_event/2,3,5 are accepted")

    def _take_goal(self, text: str, call: Callable[[Term], bool]) -> None:
        goal = self._reader.goal(text)
        try:
            if not call(goal):
                self._reports.warning(f"the goal {beginning(text)} fails")
        except RetalisError as error:
            self._reports.warning(f"the goal {beginning(text)} ends with an error: {error}")

    def _refuse(self, reason: object) -> None:
        self._reports.warning(f"event refused: {reason}", "refused", texts=20)
