"""Predicates on timestamps and dates, and statistics.

Timestamps of events have four forms: ``datime/7`` (with nanoseconds), ``datime/6``, a number of seconds since the
epoch, and a ROS time ``[Sec,NSec]``. They are compared by the instant that they denote, an integer of nanoseconds
since the epoch, so forms may be mixed.

The predicates of SWI-Prolog use a float of seconds since the epoch (here: *stamp*) and dates
``date(Y,M,D,H,Mn,S,Offset,TimeZone,DST)`` or ``date(Y,M,D)``. The time zone is always UTC. The present time is that
of the program's clock: ROS time, or the time of a bag during playback.
"""

import re
import time
from datetime import date, datetime, timedelta, timezone
from typing import Any, Callable, Dict, List, Match, Tuple

from ...foundation.errors import UsageError
from ..machine.arithmetic import Number, check_result
from ..machine.errors import (
    domain_error,
    evaluation_error,
    instantiation_error,
    instantiation_or_type_error,
    type_error,
)
from ..machine.machine import LAST
from ..terms import timestamps
from ..terms.list_terms import make_list
from ..terms.timestamps import DATIME6, DATIME7, SECOND
from ..terms.types import CONS, NIL, Atom, CompoundTerm, Lazy, Term, Var, atom, deref, functor
from ..terms.unification import unify
from .argument_checks import bound, integer, number
from .builtin_registry import ProgramMachine, Solutions, deterministic, function, nondeterministic
from .output_predicates import write_to
from .text_arguments import fill_sink, is_sink, text_of


def instant_of(term: Term) -> int:
    """Return the instant of a timestamp, in nanoseconds since the epoch.

    Raises:
        PrologError: an instantiation or type error for a term that is not a timestamp.
    """
    while term.__class__ is Var and term.ref is not None:
        term = term.ref
    # Most timestamps come from a memory or a conversion, and hold the instant until the term is needed.
    if term.__class__ is Lazy and term.decoder is timestamps.to_term and term.decoded_term is None:
        return term.source  # type: ignore[no-any-return]
    try:
        return timestamps.from_any(term)
    except UsageError:
        raise instantiation_error() if term.__class__ is Var else type_error("datime", term) from None


def _timestamp_arity(term: Term) -> int:
    """Return the number of arguments of a timestamp: 7 or 6 for a datime, 2 for a ROS time, 0 for a number."""
    term = deref(term) if term.__class__ is not Lazy else term
    if term.__class__ is Lazy:
        return term.functor.arity
    return len(term) - 1 if term.__class__ is tuple else 0


@function("convert_to_datime/2")
def convert_to_datime(time: Term) -> Term:
    """Return the timestamp of a ROS time ``[Sec,NSec]``."""
    time = deref(time)
    if time.__class__ is tuple and time[0] is CONS:
        tail = deref(time[2])
        if tail.__class__ is tuple and tail[0] is CONS and deref(tail[2]) is NIL:
            instant = timestamps.from_parts(integer(time[1]), integer(tail[1]))
            return timestamps.lazy_term(instant)
    raise instantiation_or_type_error("[Sec,NSec]", time)


@function("datime_interpolate/4")
def datime_interpolate(first: Term, second: Term, time: Term) -> Term:
    """Return the weight of the first of two timestamps at a time between them: 1 at the first, 0 at the second."""
    return weight_of_first(instant_of(first), instant_of(second), instant_of(time))


def weight_of_first(start: int, end: int, middle: int) -> Number:
    """Return the weight of the instant ``start`` at the instant ``middle``, for a linear interpolation."""
    return 1 if start == end else (end - middle) / (end - start)


@deterministic("less_datime/2")
def less_datime(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Test that a timestamp is earlier than another."""
    return instant_of(left) < instant_of(right)


@deterministic("less_equal_datime/2")
def less_equal_datime(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Test that a timestamp is not later than another."""
    return instant_of(left) <= instant_of(right)


@deterministic("equal_datime/2", "equal_datime_retalis/2")
def equal_datime(machine: ProgramMachine, left: Term, right: Term) -> bool:
    """Test that two timestamps denote the same instant."""
    return instant_of(left) == instant_of(right)


@deterministic("between_datime/3")
def between_datime(machine: ProgramMachine, middle: Term, low: Term, high: Term) -> bool:
    """Test that a timestamp is between two others: exclusively for datimes, inclusively for numbers."""
    instant, first, last = instant_of(middle), instant_of(low), instant_of(high)
    if _timestamp_arity(middle) or _timestamp_arity(low) or _timestamp_arity(high):
        return first < instant < last
    return first <= instant <= last


def _select_timestamp(selects_earlier: bool) -> Callable[[ProgramMachine, Term, Term, Term], bool]:
    """Return a predicate that selects the earlier, or the later, of two timestamps."""

    def run(machine: ProgramMachine, left: Term, right: Term, result: Term) -> bool:
        left, right = deref(left), deref(right)
        # Numbers are compared as they are: the conversion to nanoseconds would round them.
        if isinstance(left, (int, float)) and isinstance(right, (int, float)):
            is_left_earlier = left <= right
        else:
            is_left_earlier = instant_of(left) <= instant_of(right)
        return unify(result, left if is_left_earlier is selects_earlier else right, machine.trail)

    return run


deterministic("min/3", is_protected=False)(_select_timestamp(True))
deterministic("max/3", is_protected=False)(_select_timestamp(False))


@deterministic("is_datime/1")
def is_datime(machine: ProgramMachine, term: Term) -> bool:
    """Test for a valid datime."""
    term = deref(term)
    return term.__class__ is tuple and term[0] in (DATIME6, DATIME7) and timestamps.is_instant(term)


@deterministic("datime_minus_datime/3")
def datime_minus_datime(machine: ProgramMachine, later: Term, earlier: Term, seconds: Term) -> bool:
    """Unify with the seconds between two timestamps.

    The difference of two numbers is a number of their type; that of two ``datime/6`` is an integer if it has no
    fraction; otherwise it is a float.
    """
    later, earlier = deref(later), deref(earlier)
    distance = int(instant_of(later)) - int(instant_of(earlier))
    # Numbers are subtracted as they are, so the difference of integers is an integer.
    if isinstance(later, (int, float)) and isinstance(earlier, (int, float)):
        return unify(seconds, later - earlier, machine.trail)
    whole, nanoseconds = divmod(distance, SECOND)
    is_integer = _timestamp_arity(later) == _timestamp_arity(earlier) == 6 and not nanoseconds
    return unify(seconds, whole if is_integer else distance / SECOND, machine.trail)


def _add_seconds(stamp: Term, seconds: Term, sign: int) -> Term:
    """Return a timestamp moved by seconds, in the same form."""
    timestamp: Any = deref(stamp)
    seconds = deref(seconds)
    instant = instant_of(timestamp)
    if not isinstance(seconds, (int, float)):
        raise instantiation_error() if seconds.__class__ is Var else type_error("number", seconds)
    if isinstance(timestamp, (int, float)):
        return check_result(timestamp + sign * seconds)
    try:
        result_instant = int(instant) + sign * timestamps.from_seconds(seconds)
        fields = timestamps.datime_fields(result_instant)
    except UsageError:
        raise evaluation_error("undefined") from None
    # The result has the form of the argument, also in the type of the seconds of a `datime/6`.
    arity = _timestamp_arity(timestamp)
    if arity == 2:
        return make_list(timestamps.to_parts(result_instant))
    if arity == 6:
        return _datime6_term(fields, deref(timestamp[6]).__class__ is float or seconds.__class__ is float)
    return (
        timestamps.datime(result_instant)
        if deref(timestamp[6]).__class__ is int
        else timestamps.to_term(timestamps.FloatSeconds(result_instant))
    )


def _datime6_term(fields: Tuple[int, ...], is_float: bool) -> Term:
    *date_fields, second, nanoseconds = fields
    exact: Number = second + nanoseconds / SECOND if nanoseconds else second
    return (DATIME6, *date_fields, float(exact) if is_float else exact)


@deterministic("datime_plus_sec/3")
def datime_plus_sec(machine: ProgramMachine, stamp: Term, seconds: Term, result: Term) -> bool:
    """Add seconds to a timestamp; the result has the same form."""
    return unify(result, _add_seconds(stamp, seconds, 1), machine.trail)


@deterministic("addSec_Datime/3")
def add_sec_datime(machine: ProgramMachine, seconds: Term, stamp: Term, result: Term) -> bool:
    """Add seconds to a timestamp, see ``datime_plus_sec/3``."""
    return datime_plus_sec(machine, stamp, seconds, result)


@deterministic("datime_minus_sec/3")
def datime_minus_sec(machine: ProgramMachine, stamp: Term, seconds: Term, result: Term) -> bool:
    """Subtract seconds from a timestamp; the result has the same form."""
    return unify(result, _add_seconds(stamp, seconds, -1), machine.trail)


@deterministic("current_datime/1")
def current_datime(machine: ProgramMachine, result: Term) -> bool:
    """Unify with the present time as ``datime/6``."""
    return unify(result, timestamps.datime6(machine.logic.now()), machine.trail)


@deterministic("month_days/3")
def month_days(machine: ProgramMachine, month: Term, year: Term, days: Term) -> bool:
    """Unify with the number of days of a month; year and month may be given in either order."""
    first, second = integer(month), integer(year)
    # A number above 12 can only be the year.
    if first > 12:
        first, second = second, first
    if not 1 <= first <= 12:
        raise domain_error("month", first)
    return unify(days, timestamps.month_days(second, first), machine.trail)


@function("absoluteTime/2")
def absolute_time(stamp: Term) -> Term:
    """Return the seconds since midnight (UTC) of a timestamp."""
    *_, hour, minute, second, nanoseconds = timestamps.datime_fields(instant_of(stamp))
    value = (hour * 60 + minute) * 60 + second
    return value + nanoseconds / SECOND if nanoseconds else value


_DATE9, _DATE3 = functor("date", 9), functor("date", 3)
_UTC, _NO_VALUE = atom("UTC"), atom("-")
_EPOCH = datetime(1970, 1, 1)


def _split_stamp(stamp: float) -> Tuple[datetime, float]:
    """Return the date and time of a stamp, and its second with the fraction."""
    try:
        full_seconds = int(stamp // 1)
        moment = _EPOCH + timedelta(seconds=full_seconds)
    except (OverflowError, ValueError):  # also an infinite stamp
        raise domain_error("time_stamp", stamp) from None
    return moment, moment.second + (stamp - full_seconds)


def _split_date(term: CompoundTerm) -> Tuple[datetime, float]:
    """Return the date and time (UTC) of a date term, and its second with the fraction."""
    fields = [deref(field) for field in term[1:]]
    values: List[Number] = [0 if field.__class__ is Var else number(field) for field in fields[:6]]
    zone = fields[6] if len(fields) == 9 else 0
    offset = zone if zone.__class__ is int else 0
    given_year, given_month, day, hour, minute, second = (values + [0, 0, 0])[:6]
    year, month = integer(given_year), integer(given_month)
    # As in SWI-Prolog, fields may exceed their ranges and are normalised: month 13 is January of the next year.
    year += (month - 1) // 12
    try:
        month_start = datetime(year, (month - 1) % 12 + 1, 1)
        moment = month_start + timedelta(
            days=day - 1, hours=hour, minutes=minute, seconds=offset + int(second // 1)
        )
    except (OverflowError, ValueError):
        raise domain_error("date", term) from None
    return moment, moment.second + second - second // 1


def _read_time(term: Term) -> Tuple[datetime, float]:
    """Return the date and time of a date term or a stamp, and its second with the fraction."""
    term = deref(term)
    if term.__class__ is tuple and term[0] in (_DATE9, _DATE3):
        return _split_date(term)
    if term.__class__ not in (Var, int, float):
        raise type_error("time", term)
    return _split_stamp(number(term))


def _to_stamp(moment: datetime, second: float) -> float:
    """Return the seconds since the epoch of a minute and a second with its fraction."""
    days = (moment - _EPOCH).days
    return float(days * 86400 + moment.hour * 3600 + moment.minute * 60) + second


@deterministic("get_time/1")
def get_time(machine: ProgramMachine, stamp: Term) -> bool:
    """Unify with the present time as a stamp."""
    return unify(stamp, machine.logic.now() / 1e9, machine.trail)


@deterministic("stamp_date_time/3")
def stamp_date_time(machine: ProgramMachine, stamp: Term, result: Term, zone: Term) -> bool:
    """Unify with the date term of a stamp; local time is UTC."""
    moment, second = _split_stamp(number(stamp))
    zone = deref(zone)
    offset = 0
    name, dst = _UTC, _NO_VALUE
    if zone.__class__ is Var:
        unify(zone, atom("local"), machine.trail)
    elif zone.__class__ is int:
        offset, name = zone, _NO_VALUE
        moment -= timedelta(seconds=offset)
    elif zone.__class__ is not Atom or zone.name not in ("local", "UTC"):
        raise domain_error("timezone", zone)
    parts = (
        moment.year,
        moment.month,
        moment.day,
        moment.hour,
        moment.minute,
        float(second),
        offset,
        name,
        dst,
    )
    return unify(result, (_DATE9, *parts), machine.trail)


@deterministic("date_time_stamp/2")
def date_time_stamp(machine: ProgramMachine, date: Term, stamp: Term) -> bool:
    """Unify with the stamp of a date term."""
    date = deref(date)
    if date.__class__ is not tuple or date[0] not in (_DATE9, _DATE3):
        raise instantiation_or_type_error("time", date)
    return unify(stamp, _to_stamp(*_split_date(date)), machine.trail)


_DATE_FIELDS = (
    "year",
    "month",
    "day",
    "hour",
    "minute",
    "second",
    "utc_offset",
    "time_zone",
    "daylight_saving",
)


@nondeterministic("date_time_value/3")
def date_time_value(machine: ProgramMachine, name: Term, date: Term, value: Term) -> Solutions:
    """Enumerate the fields of a date term."""
    date = deref(date)
    if date.__class__ is not tuple or date[0] is not _DATE9:
        return
    for field, part in zip(_DATE_FIELDS, date[1:]):
        if deref(part) is not _NO_VALUE and machine.unify_all((name, atom(field)), (value, part)):
            yield None
    if machine.unify_all((name, atom("date")), (value, (_DATE3, *date[1:4]))):
        yield LAST


@deterministic("day_of_the_week/2")
def day_of_the_week(machine: ProgramMachine, date_term: Term, number: Term) -> bool:
    """Unify with the day of the week of ``date(Y,M,D)``; Monday is 1."""
    date_term = bound(date_term)
    if date_term.__class__ is not tuple or date_term[0] is not _DATE3:
        return False
    year, month, day = (integer(part) for part in date_term[1:])
    try:
        return unify(number, date(year, month, day).isoweekday(), machine.trail)
    except ValueError:
        raise domain_error("date", date_term) from None


_ISO_8601 = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d(?:\.\d+)?))?(Z|[+-]\d\d:?\d\d)?)?$"
)


@deterministic("parse_time/2")
def parse_time(machine: ProgramMachine, text: Term, stamp: Term) -> bool:
    """Unify with the stamp of an ISO 8601 text; fail for another text."""
    match = _ISO_8601.match(text_of(text))
    if match is None:
        return False
    year, month, day, hour, minute, second, zone = match.groups()
    try:
        moment = datetime(int(year), int(month), int(day), int(hour or 0), int(minute or 0))
    except ValueError:
        return False
    # The stamp is in UTC, so the offset of the zone is subtracted.
    if zone and zone != "Z":
        sign = -1 if zone[0] == "-" else 1
        moment -= sign * timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
    return unify(stamp, _to_stamp(moment, float(second or 0)), machine.trail)


def _format(format_string: str, moment: datetime, second: float) -> str:
    """Return a time formatted as by C's ``strftime``; ``%3f`` is the fraction of the second with three digits."""
    fraction = second - int(second)

    def fraction_text(match: "Match[str]") -> str:
        digits = int(match.group(1) or 6)
        # Rounding up to 1 would need a carry into the seconds, so the largest fraction is used instead.
        return f"{fraction:.{digits}f}"[2:] if fraction < 1 - 0.5 * 10**-digits else "9" * digits

    text = re.sub(r"%(\d{0,2})f", fraction_text, format_string)
    text = (
        text.replace("%FT%T%:z", "%Y-%m-%dT%H:%M:%S%:z")
        .replace("%:z", "+00:00")
        .replace("%+", "%a %b %e %T %Y")
    )
    return moment.replace(tzinfo=timezone.utc).strftime(text)


@deterministic("format_time/3")
def format_time(machine: ProgramMachine, sink: Term, format_term: Term, time_term: Term) -> bool:
    """Write a formatted stamp or date to a stream, or unify it with an output specification such as ``atom(A)``."""
    text = _format(text_of(format_term), *_read_time(time_term))
    sink = deref(sink)
    if is_sink(sink):
        return fill_sink(machine, sink, text)
    if sink.__class__ is tuple:
        raise type_error("output", sink)
    write_to(machine, sink, text)
    return True


# Statistics

_START_SECONDS = time.monotonic()


def _milliseconds(seconds: float) -> int:
    return int(seconds * 1000)


_STATISTICS: Dict[str, Callable[[ProgramMachine], Term]] = {
    "cputime": lambda machine: time.process_time(),
    "process_cputime": lambda machine: time.process_time(),
    "inferences": lambda machine: machine.budget.inferences,
    "epoch": lambda machine: time.time() - (time.monotonic() - _START_SECONDS),
    "real_time": lambda machine: _value_and_difference(machine, "real_time", int(time.time())),
    "runtime": lambda machine: _value_and_difference(machine, "runtime", _milliseconds(time.process_time())),
    "process_runtime": lambda machine: _value_and_difference(
        machine, "runtime", _milliseconds(time.process_time())
    ),
    "walltime": lambda machine: _value_and_difference(
        machine, "walltime", _milliseconds(time.monotonic() - _START_SECONDS)
    ),
    "trail": lambda machine: len(machine.trail),
    "trailused": lambda machine: len(machine.trail),
}


def _value_and_difference(machine: ProgramMachine, name: str, value: int) -> Term:
    """Return ``[Value, Difference]`` with the difference since the last call for the same key."""
    # The previous values belong to the program, so programs in one process do not affect each other.
    previous_values = machine.logic.state.setdefault("statistics", {})
    difference = value - previous_values.get(name, 0)
    previous_values[name] = value
    return make_list([value, difference])


@deterministic("statistics/2")
def statistics(machine: ProgramMachine, key: Term, value: Term) -> bool:
    """Unify with a statistic of the process or the machine."""
    key = bound(key)
    if key.__class__ is not Atom or key.name not in _STATISTICS:
        raise domain_error("statistics_key", key)
    return unify(value, _STATISTICS[key.name](machine), machine.trail)
