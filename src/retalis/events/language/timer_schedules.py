"""Schedules of timers.

The goal ``timer(Event, Schedule)`` raises events without any input. `Schedule` computes the instants of
``every(Seconds)``, ``at(Hour, Minute, Second)``, ``after(Seconds)`` and the other forms; times of day are UTC.
"""

from typing import Any, NamedTuple, Optional

from ...foundation.errors import UsageError
from ...prolog.terms.term_traversal import is_ground
from ...prolog.terms.timestamps import SECOND, from_any, from_seconds
from ...prolog.terms.types import CompoundTerm, Term, Var, atom, deref, functor

TIMER = functor("timer", 2)
"""Goal that sets a timer: the event, and its schedule."""

SCHEDULE_NOTATIONS = (
    "every(Seconds)",
    "every(Seconds, from_now)",
    "at(Hour, Minute, Second)",
    "at(Datime)",
    "after(Seconds)",
)
MIN_PERIOD_SECONDS = 0.001
"""Minimum period in seconds: with a shorter one, the timer would leave no time for other events."""

MAX_INTERVAL_SECONDS = 10**9
_DAY_NANOSECONDS = 86_400 * SECOND
_FROM_NOW = atom("from_now")
_EVERY, _EVERY_FROM_NOW = functor("every", 1), functor("every", 2)
_TIME_OF_DAY, _TIMER_AT, _TIMER_AFTER = functor("at", 3), functor("at", 1), functor("after", 1)


class Schedule(NamedTuple):
    """Schedule of a timer.

    Attributes:
        term: the schedule as it is written.
        period: ns between two events, or the delay of a single one; 0 for a fixed instant.
        repeats: whether the timer fires repeatedly.
        phase: for a repeating timer an instant at which it fires; None if it counts from the time when it is set.
        instant: the only instant at which it fires, or None.
    """

    term: Term
    period: int
    repeats: bool
    phase: Optional[int] = None
    instant: Optional[int] = None

    @property
    def is_relative(self) -> bool:
        """True if the schedule is a single delay from the time when the timer is set."""
        return self.instant is None and not self.repeats

    def next_instant(self, now: int) -> Optional[int]:
        """Return the first instant after ``now`` for a timer that is set at ``now``; None if it has passed."""
        if self.instant is not None:
            return self.instant if self.instant > now else None
        if self.phase is None:
            return now + self.period
        # The modulus of Python is never negative, so this also holds if ``phase`` lies after ``now``.
        return now + self.period - (now - self.phase) % self.period


def parse_schedule(term: Term) -> Schedule:
    """Return the schedule that a term denotes.

    Raises:
        UsageError: if the term is not a valid schedule.
    """
    schedule: Any = deref(term)
    key = schedule[0] if schedule.__class__ is tuple else None
    if key is _EVERY:
        return Schedule(schedule, _parse_period(schedule, MIN_PERIOD_SECONDS), True, phase=0)
    # Without ``from_now``, periods are aligned to multiples since 1970, so all nodes fire at the same instants.
    if key is _EVERY_FROM_NOW and deref(schedule[2]) is _FROM_NOW:
        return Schedule(schedule, _parse_period(schedule, MIN_PERIOD_SECONDS), True)
    if key is _TIMER_AFTER:
        return Schedule(schedule, _parse_period(schedule), False)
    if key is _TIME_OF_DAY:
        return Schedule(schedule, _DAY_NANOSECONDS, True, phase=_parse_time_of_day(schedule))
    if key is _TIMER_AT:
        return Schedule(schedule, 0, False, instant=int(from_any(schedule[1])))
    raise UsageError(f"expected {', '.join(SCHEDULE_NOTATIONS[:-1])} or {SCHEDULE_NOTATIONS[-1]}")


def schedule_error(term: Term) -> Optional[str]:
    """Return the reason why a schedule is invalid for all values of its variables, or None."""
    schedule: Any = deref(term)
    if schedule.__class__ is Var:
        return None
    # A rule may bind the variables of a schedule to valid numbers; it is checked again when the timer is set.
    if schedule.__class__ is tuple and schedule[0] in _SCHEDULES and not is_ground(schedule):
        return None
    try:
        parse_schedule(schedule)
    except UsageError as error:
        return error.message
    return None


def sets_timer(term: Term) -> bool:
    """Return whether a term is a goal that sets a timer, and not a predicate ``timer/2`` of the program."""
    goal: Any = deref(term)
    if goal.__class__ is not tuple or goal[0] is not TIMER:
        return False
    schedule = deref(goal[2])
    return schedule.__class__ is Var or (schedule.__class__ is tuple and schedule[0] in _SCHEDULES)


_SCHEDULES = frozenset((_EVERY, _EVERY_FROM_NOW, _TIME_OF_DAY, _TIMER_AT, _TIMER_AFTER))


def _parse_period(schedule: CompoundTerm, minimum: float = 0.0) -> int:
    seconds: Any = deref(schedule[1])
    if seconds.__class__ in (int, float) and minimum <= seconds <= MAX_INTERVAL_SECONDS and seconds > 0:
        return from_seconds(seconds)
    bound = f"of at least {minimum}" if minimum else "above 0"
    raise UsageError(f"{schedule[0].name} needs a number of seconds {bound}, {MAX_INTERVAL_SECONDS} at most")


def _parse_time_of_day(schedule: CompoundTerm) -> int:
    hour: Any
    minute: Any
    second: Any
    hour, minute, second = [deref(field) for field in schedule[1:]]
    has_valid_types = hour.__class__ is int and minute.__class__ is int and second.__class__ in (int, float)
    if has_valid_types and 0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 60:
        instant: int = (hour * 60 + minute) * 60 * SECOND + from_seconds(second)
        return instant
    raise UsageError("at needs an hour from 0 to 23, a minute from 0 to 59 and a second below 60")
