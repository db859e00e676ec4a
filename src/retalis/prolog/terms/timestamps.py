"""Instants as integer nanoseconds since the Unix epoch (UTC), and their terms.

Inside the engine an instant is an ``int`` of nanoseconds, so comparisons are exact. Programs see a term:
``datime(Year,Month,Day,Hour,Minute,Second,Nanosecond)``, the same without the last field, or a number of seconds. An
instant keeps the form in which it was given:

* a plain ``int`` is shown as ``datime/7`` with integer seconds, as the clock and messages have them;
* a `FloatSeconds` is shown as ``datime/7`` with float seconds, as ``new_event/3`` creates them;
* a `Stamp` is shown as the term that it was read from.

All three are integers. They compare and subtract by the instant that they denote, in whatever form they are shown.

Terms of instants are lazy (`lazy_term`): most of them are only converted back by `from_term`, which then returns the
instant without building the term.
"""

from calendar import isleap
from datetime import date
from functools import lru_cache
from math import frexp, ldexp
from typing import Any, List, Optional, Tuple

from ...foundation.errors import UsageError
from .types import CONS, NIL, CompoundTerm, Functor, Lazy, Term, Var, deref, functor

SECOND = 1_000_000_000
"""Nanoseconds in a second."""

BEFORE_ALL_INSTANTS = -(1 << 63)
"""Instant in ns before the times of all events."""

DATIME7: Functor = functor("datime", 7)
DATIME6: Functor = functor("datime", 6)

_DAY_SECONDS = 86_400
_EPOCH_DAY = date(1970, 1, 1).toordinal()
FIRST_INSTANT, END_INSTANT = (
    (1 - _EPOCH_DAY) * _DAY_SECONDS * SECOND,
    (date.max.toordinal() + 1 - _EPOCH_DAY) * _DAY_SECONDS * SECOND,
)
"""Range of instants that have a datime, in ns: the first one (year 1), and the end, the first one after the range
(year 10000)."""

MAX_TIMESTAMP = 1 << 79
"""Largest timestamp in ns that is accepted, before or after the epoch: about 19 million years.

The state format stores instants up to twice that, so deadlines and clocks that follow the largest one fit, too.
"""

_FIELD_LIMITS = ((1, 9999), (1, 12), (1, 31), (0, 23), (0, 59))
"""Lowest and highest value of year, month, day, hour and minute."""


class FloatSeconds(int):
    """An instant whose term has float seconds."""

    __slots__ = ()


class Stamp(int):
    """An instant that keeps the term from which it was read."""

    term: Term

    @classmethod
    def of(cls, nanoseconds: int, term: Term) -> "Stamp":
        """Return the stamp of an instant in ns that is shown as ``term``."""
        stamp = cls(nanoseconds)
        stamp.term = term
        return stamp


def from_parts(seconds: int, nanoseconds: int) -> int:
    """Return the instant of a ROS time (s, ns), in the form that ``new_event/3`` uses."""
    return FloatSeconds(seconds * SECOND + nanoseconds)


def to_parts(instant: int) -> Tuple[int, int]:
    """Return an instant as a ROS time: seconds and nanoseconds."""
    return divmod(int(instant), SECOND)


def from_seconds(seconds: float) -> int:
    """Return a number of seconds as nanoseconds, rounded to the nearest.

    Raises:
        UsageError: for ``nan`` and the infinities.
    """
    if seconds.__class__ is int:
        return int(seconds) * SECOND
    try:
        full_seconds = int(seconds)
    except (ValueError, OverflowError):
        raise UsageError(f"{seconds} is not a number of seconds") from None
    # Whole seconds are split off first: `seconds * 1e9` has more than 53 significant bits for a present-day time.
    return full_seconds * SECOND + round((seconds - full_seconds) * 1e9)


def to_seconds(nanoseconds: int) -> float:
    """Return nanoseconds as float seconds, rounded as ``Sec + NSec * 1e-9`` is."""
    full_seconds, rest = divmod(int(nanoseconds), SECOND)
    return full_seconds + rest * 1e-9


def to_shortest_seconds(nanoseconds: int) -> float:
    """Return nanoseconds as seconds: an int if they are whole, otherwise a float."""
    return to_seconds(nanoseconds) if nanoseconds % SECOND else int(nanoseconds) // SECOND


def format_distance(nanoseconds: int) -> str:
    """Return a length of time as text for messages: in seconds, or in hours or days if it is long.

    >>> format_distance(12_500_000_000), format_distance(3600 * SECOND), format_distance(365 * 86_400 * SECOND)
    ('12.5 s', '1.0 hours', '365.0 days')
    """
    seconds = nanoseconds / SECOND
    if seconds < 3600:
        return f"{seconds:.1f} s"
    return f"{seconds / 3600:.1f} hours" if seconds < 2 * 86_400 else f"{seconds / 86_400:.1f} days"


@lru_cache(maxsize=64)
def first_reaching(seconds: float) -> int:
    """Return the first instant (ns) whose `to_seconds` is at least ``seconds``.

    The spacing of doubles near the present is 2.4e-7 s, so an instant and its float seconds do not denote the same
    nanosecond. With this bound, a comparison with ``Z is Sec + NSec * 1e-9`` gives the same result as one of
    instants.
    """
    # The instants that round to `seconds` begin half a unit in the last place below it. The estimate may be off by
    # the rounding of `to_seconds` itself, so a galloping and then a binary search find the exact bound.
    guess = from_seconds(seconds) - int(ldexp(SECOND, frexp(seconds)[1] - 54))
    low, high, step = guess - 1, guess + 1, 1
    while to_seconds(low) >= seconds:
        low -= step
        step *= 2
    while to_seconds(high) < seconds:
        high += step
        step *= 2
    while high - low > 1:
        middle = (low + high) // 2
        if to_seconds(middle) >= seconds:
            high = middle
        else:
            low = middle
    return high


@lru_cache(maxsize=64)
def _day_fields(day: int) -> Tuple[int, int, int]:
    """Return year, month and day of a number of days since the epoch."""
    calendar_day = date.fromordinal(day + _EPOCH_DAY)
    return calendar_day.year, calendar_day.month, calendar_day.day


@lru_cache(maxsize=64)
def _day_number(year: int, month: int, day: int) -> int:
    """Return the number of days since the epoch.

    Raises:
        ValueError: if there is no such day.
    """
    return date(year, month, day).toordinal() - _EPOCH_DAY


def datime_fields(instant: int) -> Tuple[int, int, int, int, int, int, int]:
    """Return year, month, day, hour, minute, second and nanosecond of an instant (UTC).

    Raises:
        UsageError: outside the years 1 to 9999.
    """
    instant = int(instant)
    if not has_datime(instant):
        raise UsageError(f"{instant} ns since the epoch is outside the years 1 to 9999")
    seconds, nanoseconds = divmod(instant, SECOND)
    day, rest = divmod(seconds, _DAY_SECONDS)
    # `datetime` would not do: it has no nanoseconds.
    minutes, second = divmod(rest, 60)
    hour, minute = divmod(minutes, 60)
    return (*_day_fields(day), hour, minute, second, nanoseconds)


def has_datime(instant: int) -> bool:
    """Return whether an instant lies in the years 1 to 9999, for which a datime exists."""
    return FIRST_INSTANT <= instant < END_INSTANT


def datime(instant: int) -> Term:
    """Return an instant as ``datime/7`` with integer seconds."""
    return (DATIME7, *datime_fields(instant))


def datime6(instant: int) -> Term:
    """Return an instant as ``datime/6``; fractions of a second are truncated."""
    return (DATIME6, *datime_fields(instant)[:6])


def to_term(instant: int) -> Term:
    """Return the term of an instant, in the form in which it was given."""
    instant_class = instant.__class__
    if instant_class is int:
        return datime(instant)
    if instant_class is FloatSeconds:
        year, month, day, hour, minute, second, nanosecond = datime_fields(instant)
        return (DATIME7, year, month, day, hour, minute, float(second), nanosecond)
    return instant.term  # type: ignore[attr-defined, no-any-return]


def lazy_term(instant: int) -> Term:
    """Return the term of an instant, lazily: most such terms are only passed to `from_term` and never built."""
    if instant.__class__ is Stamp:
        return instant.term  # type: ignore[attr-defined, unused-ignore]  # on Python 3.8 only
    return Lazy(DATIME7, to_term, instant)


def interval_term(start: int, end: int) -> Term:
    """Return an interval as the list ``[T1,T2]``."""
    return (CONS, lazy_term(start), (CONS, lazy_term(end), NIL))


class ClockForm:
    """Form in which instants of the clock are shown beside stamps: as seconds, if the first stamp is a number."""

    def __init__(self) -> None:
        # None before the first stamp.
        self._shows_seconds: Optional[bool] = None

    def convert(self, instant: int) -> int:
        """Return an instant of the clock in the form of the first stamp; a stamp keeps its own form."""
        if isinstance(instant, Stamp):
            if self._shows_seconds is None:
                self._shows_seconds = instant.term.__class__ in (int, float)
        elif self._shows_seconds and instant.__class__ is int:
            return Stamp.of(instant, to_shortest_seconds(instant))
        return instant


def _require_accepted(instant: int) -> int:
    """Return a timestamp in ns.

    Raises:
        UsageError: if its distance from the epoch exceeds `MAX_TIMESTAMP`.
    """
    if -MAX_TIMESTAMP <= instant <= MAX_TIMESTAMP:
        return instant
    raise UsageError(f"a timestamp lies at most {MAX_TIMESTAMP // SECOND:.1e} s from the epoch")


def from_term(term: Term) -> int:
    """Return the instant that a term denotes, keeping its form.

    Accepted are ``datime/7`` (integer or float seconds), ``datime/6``, and numbers, which are seconds.

    Raises:
        UsageError: if the term denotes no instant.
    """
    while term.__class__ is Var and term.ref is not None:
        term = term.ref
    # A term from `lazy_term` that has not been built still holds its instant. `deref` would build it here.
    if term.__class__ is Lazy and term.decoder is to_term and term.decoded_term is None:
        return term.source  # type: ignore[no-any-return]
    value: Any = deref(term)
    value_class = value.__class__
    if value_class is int or value_class is float:
        return Stamp.of(_require_accepted(from_seconds(value)), value)
    if value_class is tuple:
        if value[0] is DATIME7:
            instant, seconds_class = _from_fields(value)
            if seconds_class is not None:
                return FloatSeconds(instant) if seconds_class is float else instant
        elif value[0] is DATIME6:
            instant, seconds_class = _from_fields(value)
            if seconds_class is not None:
                return Stamp.of(instant, value)
    raise UsageError("expected datime(Year,Month,Day,Hour,Minute,Second,Nanosecond), datime/6 or a number")


def is_instant(term: Term) -> bool:
    """Return whether `from_term` accepts a term."""
    try:
        from_term(term)
    except UsageError:
        return False
    return True


def _from_fields(term: CompoundTerm) -> Tuple[int, Optional[type]]:
    """Return the instant of a datime term and the class for its form, which is None if a field is invalid.

    The class is int or float for integral seconds, by the class of their term, and `Stamp` for other seconds.
    """
    values: List[Any] = [deref(value) for value in term[1:]]
    second = values[5]
    nanosecond = values[6] if len(values) == 7 else 0
    for value, (low, high) in zip(values, _FIELD_LIMITS):
        if value.__class__ is not int or not low <= value <= high:
            return 0, None
    # Seconds from 60 up to 61 are valid: a leap second has no other notation.
    if second.__class__ not in (int, float) or not 0 <= second < 61 or nanosecond.__class__ is not int:
        return 0, None
    try:
        day = _day_number(*values[:3])
    except ValueError:
        return 0, None
    full_seconds = ((day * 24 + values[3]) * 60 + values[4]) * 60
    instant = full_seconds * SECOND + from_seconds(second) + nanosecond
    # `FloatSeconds` has whole seconds only; with a fraction, the term has to be kept.
    if second.__class__ is float and second != int(second):
        return Stamp.of(instant, (term[0], *values)), Stamp
    return instant, second.__class__


def from_any(term: Term) -> int:
    """Return the instant of a timestamp term or of a ROS time ``[Sec,NSec]``.

    Raises:
        UsageError: if the term is neither.
    """
    # A lazy term that has not been built still holds its instant, as in `from_term`.
    if term.__class__ is Lazy and term.decoder is to_term and term.decoded_term is None:
        return term.source  # type: ignore[no-any-return]
    term = deref(term)
    if term.__class__ is tuple and term[0] is CONS:
        rest = deref(term[2])
        if rest.__class__ is tuple and rest[0] is CONS and deref(rest[2]) is NIL:
            seconds, nanoseconds = deref(term[1]), deref(rest[1])
            if seconds.__class__ is int and nanoseconds.__class__ is int:
                return _require_accepted(from_parts(seconds, nanoseconds))
        raise UsageError("expected [Sec,NSec] with two integers")
    return from_term(term)


def month_days(year: int, month: int) -> int:
    """Return the number of days of a month in the proleptic Gregorian calendar."""
    if month == 2:
        return 29 if isleap(year) else 28
    return 30 if month in (4, 6, 9, 11) else 31
