"""Event input: timestamps, due alarms, and dispatch."""

import logging
from typing import Callable, Optional

from ..events.dispatch import Dispatcher
from ..foundation import UsageError
from ..prolog.logic import Logic
from ..prolog.terms import Term, WholeSeconds
from .runtime import Clock, StreamClock

log = logging.getLogger("retalis")


class Intake:
    """Takes the events of an engine, one at a time.

    Args:
        logic: whose machine runs what events start.
        dispatcher: serves them.
        clock: what time it is.
        followed: the same clock where stamped events move it; None if only its owner moves it.
        start_anew: called where time went back.

    Attributes:
        taken: how many events came in.
        followed: the clock, where stamped events move it.
    """

    def __init__(
        self,
        logic: Logic,
        dispatcher: Dispatcher,
        clock: Clock,
        followed: Optional[StreamClock],
        start_anew: Callable[[], None],
    ):
        self._logic = logic
        self._clock = clock
        self.followed = followed
        self._start_anew = start_anew
        self._serve = dispatcher.serve
        self.taken = 0

    def take(
        self, term: Term, start: Optional[int], end: Optional[int], ground: Optional[bool] = None
    ) -> None:
        """Dispatch an event; without a start it is stamped by the clock.

        Raises:
            UsageError: if it ends before it starts, or has no start and the clock is not set.
        """
        if start is None or end is None:
            start = self._clock.stamp_at_once()
            if start is None:
                start = self._stamp_after_alarms(term)
            end = start
        elif end < start:
            raise UsageError(f"{self._logic.brief(term)} ends before it starts")
        else:
            followed = self.followed
            if not (self._clock.is_quiet() if followed is None else followed.follow(end)):
                self._move_clock(end)
        self.taken += 1
        self._serve(term, start, end, ground)

    def take_message(self, term: Term, instant: Optional[int] = None) -> None:
        """Dispatch a message, now or of an instant: as `take`."""
        if instant is None:
            stamp = self._clock.stamp_at_once()
            if stamp is None:
                stamp = self._stamp_after_alarms(term)
        else:
            stamp = WholeSeconds(instant)  # the form in which the converter writes it
            followed = self.followed
            if not (self._clock.is_quiet() if followed is None else followed.follow(instant)):
                self._move_clock(instant)
        self.taken += 1
        self._serve(term, stamp, stamp, True)

    def _stamp_after_alarms(self, term: Term) -> int:
        """Return the time of an event that has none, after the alarms that are due.

        Raises:
            UsageError: if the clock is not set.
        """
        clock = self._clock
        if not clock.is_set:
            raise UsageError(
                f"event '{self._logic.brief(term)}': it has no time, "
                "and the clock of the engine was never set: "
                "give the event a time, or the engine the computer's clock with Engine(clock=Clock())"
            )
        return clock.stamp(self._look_at_clock())

    def _move_clock(self, instant: int) -> None:
        """Move the clock to the instant of an event, and let alarms ring that are due."""
        followed = self.followed
        if followed is not None:
            followed.now()  # a clock that was set back is noticed first
            followed.move_to(instant)
        self._look_at_clock()

    def _look_at_clock(self) -> int:
        """Look what time it is, let alarms ring that are due, and return the time."""
        clock = self._clock
        now = clock.now()
        if clock.behind or clock.alarms:
            self.watch_clock()
        return now

    def watch_clock(self, move: Optional[Callable[[], object]] = None) -> None:
        """Start anew where time went back, and let alarms ring that are due; ``move`` moves the clock first."""
        if move is not None:
            move()
        clock = self._clock
        if clock.went_back():
            log.warning("time went back: memories, waiting queries and partial matches are cleared")
            self._start_anew()
        until = clock.reached()  # what comes due while alarms ring waits: events come in between
        while True:
            due = clock.due(until)
            if due is None:
                return
            instant, alarm = due
            clock.ringing = instant
            try:
                self._logic.machine.budget.apart(("an alarm", instant), lambda: alarm(instant))  # noqa: B023
            finally:
                clock.ringing = None
