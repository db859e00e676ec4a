"""Heads that fire their event later: ``exceptionAlarm/2`` and ``exceptionAlarmAbsoluteDatime/2``."""

from typing import Optional, Tuple

from ...foundation import UsageError
from ...prolog.terms import (
    CONS,
    DATIME6,
    DATIME7,
    CompoundTerm,
    Term,
    Var,
    WholeSeconds,
    deref,
    from_any,
    from_seconds,
    functor,
    list_items,
    make_list,
)

_AFTER = functor("exceptionAlarm", 2)
_AT = functor("exceptionAlarmAbsoluteDatime", 2)
ALARMS = frozenset((_AFTER, _AT))
_LEAP_YEAR = 2000


def alarm_of(head: CompoundTerm, start: int, end: int) -> Optional[Tuple[Term, int, int]]:
    """Return the event, its start and the instant at which it fires; None for a head that is not an alarm.

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


def is_absolute(head: Term) -> bool:
    """Tell whether the head of an alarm names its instant."""
    return head.__class__ is tuple and head[0] is _AT


def duration(term: Term) -> int:
    """Return the duration of an alarm in ns.

    Raises:
        UsageError: where it is not a positive number.
    """
    seconds = deref(term)
    if seconds.__class__ not in (int, float) or not seconds > 0:
        raise UsageError("exceptionAlarm needs a positive number of seconds")
    return from_seconds(seconds)


def require_alarm(head: CompoundTerm) -> None:
    """Check what an alarm's head says of its instant before it has its values.

    Raises:
        UsageError: where no values make it right.
    """
    when = deref(head[2])
    if when.__class__ is Var:
        return
    if head[0] is _AFTER:
        duration(when)
    elif head[0] is _AT:
        filled = _filled(when)
        try:
            from_any(filled)
        except UsageError as error:
            unknown = "no such date and time exists; " if _is_datime(filled) else ""
            raise UsageError(f"{unknown}{error.message}") from None


def _is_datime(term: Term) -> bool:
    return term.__class__ is tuple and (term[0] is DATIME6 or term[0] is DATIME7)


def _filled(when: Term) -> Term:
    """Return an instant with values for its variables that are right if any are."""
    if when.__class__ is not tuple:
        return when
    if when[0] is CONS:
        items = list_items(when)
        return 1 if items is None else make_list([_or(item, 1) for item in items])
    if _is_datime(when):
        return (when[0], _or(when[1], _LEAP_YEAR), *(_or(field, 1) for field in when[2:]))
    return when


def _or(term: Term, value: int) -> Term:
    term = deref(term)
    return value if term.__class__ is Var else term
