"""Heads that fire their event later: ``exceptionAlarm/2`` and ``exceptionAlarmAbsoluteDatime/2``."""

from typing import Optional, Tuple

from ..errors import UsageError
from ..terms import Term, deref, functor
from ..timestamps import WholeSeconds, from_any, from_seconds

_AFTER = functor("exceptionAlarm", 2)
_AT = functor("exceptionAlarmAbsoluteDatime", 2)


def alarm_of(head: Term, start: int, end: int) -> Optional[Tuple[Term, int, int]]:
    """Return the event, its start and the instant at which it fires; None for a head that is no alarm.

    An instant before the start is none: as in the original engine, the head is an ordinary event then.

    Raises:
        UsageError: where the duration or instant is wrong.
    """
    if head[0] is _AFTER:
        instant = WholeSeconds(end + duration(head[2]))
    elif head[0] is _AT:
        instant = WholeSeconds(from_any(head[2]))
    else:
        return None
    if instant < start:
        return None
    return deref(head[1]), start, instant


def duration(term: Term) -> int:
    """Return the duration of an alarm in ns.

    Raises:
        UsageError: where it is no positive number.
    """
    seconds = deref(term)
    if seconds.__class__ not in (int, float) or not seconds > 0:
        raise UsageError("exceptionAlarm needs a positive number of seconds")
    return from_seconds(seconds)
