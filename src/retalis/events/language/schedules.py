"""When timers ring: ``every(Seconds)``, ``at(Hour, Minute, Second)``, ``after(Seconds)`` and their like."""

from typing import Any, NamedTuple, Optional

from ...foundation import UsageError
from ...prolog.terms import (
    SECOND,
    CompoundTerm,
    Term,
    Var,
    atom,
    deref,
    from_any,
    from_seconds,
    functor,
    is_ground,
)

TIMER = functor("timer", 2)
"""The goal that sets a timer: the event, and when."""

FORMS = (
    "every(Seconds)",
    "every(Seconds, from_now)",
    "at(Hour, Minute, Second)",
    "at(Datime)",
    "after(Seconds)",
)
SHORTEST = 0.001
"""Seconds; the events of a shorter period would leave no time for others."""

LONGEST = 10**9
_DAY = 86_400 * SECOND
_FROM_NOW = atom("from_now")
_EVERY, _EVERY_FROM = functor("every", 1), functor("every", 2)
_TIME_OF_DAY, _AT, _AFTER = functor("at", 3), functor("at", 1), functor("after", 1)


class Schedule(NamedTuple):
    """When a timer rings.

    Attributes:
        term: as it was written.
        period: from one time to the next in ns, or how long to wait where it rings once; 0 for one instant.
        repeats: whether it rings again and again.
        phase: an instant at which it rings, of those that repeat; None where they are counted from when it is set.
        instant: the only one at which it rings, or None.
    """

    term: Term
    period: int
    repeats: bool
    phase: Optional[int] = None
    instant: Optional[int] = None

    @property
    def is_relative(self) -> bool:
        """Whether it is a time to wait from when it was set, once."""
        return self.instant is None and not self.repeats

    def next(self, now: int) -> Optional[int]:
        """Return the first instant after now, for a timer that is set now; None where it is over."""
        if self.instant is not None:
            return self.instant if self.instant > now else None
        if self.phase is None:
            return now + self.period
        return now + self.period - (now - self.phase) % self.period


def schedule_of(term: Term) -> Schedule:
    """Return when a timer is to ring.

    Raises:
        UsageError: what was expected.
    """
    when: Any = deref(term)
    kind = when[0] if when.__class__ is tuple else None
    if kind is _EVERY:
        return Schedule(when, _seconds(when, SHORTEST), True, phase=0)
    if kind is _EVERY_FROM and deref(when[2]) is _FROM_NOW:
        return Schedule(when, _seconds(when, SHORTEST), True)
    if kind is _AFTER:
        return Schedule(when, _seconds(when), False)
    if kind is _TIME_OF_DAY:
        return Schedule(when, _DAY, True, phase=_time_of_day(when))
    if kind is _AT:
        return Schedule(when, 0, False, instant=int(from_any(when[1])))
    raise UsageError(f"expected {', '.join(FORMS[:-1])} or {FORMS[-1]}")


def schedule_fault(term: Term) -> Optional[str]:
    """Return why a timer cannot be set so, whatever the values of variables; None where it may be."""
    when: Any = deref(term)
    if when.__class__ is Var:
        return None
    if when.__class__ is tuple and when[0] in _KINDS and not is_ground(when):
        return None
    try:
        schedule_of(when)
    except UsageError as error:
        return error.message
    return None


def sets_timer(term: Term) -> bool:
    """Tell whether a term is a goal that sets a timer, and not a program's own ``timer(X, Y)``."""
    goal: Any = deref(term)
    if goal.__class__ is not tuple or goal[0] is not TIMER:
        return False
    when = deref(goal[2])
    return when.__class__ is Var or (when.__class__ is tuple and when[0] in _KINDS)


_KINDS = frozenset((_EVERY, _EVERY_FROM, _TIME_OF_DAY, _AT, _AFTER))


def _seconds(when: CompoundTerm, least: float = 0.0) -> int:
    seconds: Any = deref(when[1])
    if seconds.__class__ in (int, float) and least <= seconds <= LONGEST and seconds > 0:
        return from_seconds(seconds)
    wanted = f"of at least {least}" if least else "above 0"
    raise UsageError(f"{when[0].name} needs a number of seconds {wanted}, {LONGEST} at most")


def _time_of_day(when: CompoundTerm) -> int:
    hour: Any
    minute: Any
    second: Any
    hour, minute, second = [deref(one) for one in when[1:]]
    whole = hour.__class__ is int and minute.__class__ is int and second.__class__ in (int, float)
    if whole and 0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 60:
        instant: int = (hour * 60 + minute) * 60 * SECOND + from_seconds(second)
        return instant
    raise UsageError("at needs an hour from 0 to 23, a minute from 0 to 59 and a second below 60")
