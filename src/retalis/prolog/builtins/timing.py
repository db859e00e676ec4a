"""Calendar time as SWI-Prolog has it (everything is UTC), and statistics.

A stamp is a float of seconds since the epoch; a date is ``date(Y,M,D,H,Mn,S,Offset,TimeZone,DST)`` or
``date(Y,M,D)``. ``get_time/1`` asks the program's clock: ROS time, or the time of a bag.
"""

import re
import time
from datetime import date, datetime, timedelta, timezone
from typing import Callable, Dict, List, Match, Tuple

from ..arithmetic import Number
from ..machine import LAST, domain_error, instantiation_error, type_error
from ..terms import Atom, CompoundTerm, Term, Var, atom, deref, functor, make_list, unify
from .arguments import integer, number
from .output import write_to
from .program import Machine, Solutions
from .registry import deterministic, nondeterministic
from .text import fill_sink, is_sink, text_of

_DATE9, _DATE3 = functor("date", 9), functor("date", 3)
_UTC, _NONE = atom("UTC"), atom("-")
_EPOCH = datetime(1970, 1, 1)


def _of_stamp(stamp: float) -> Tuple[datetime, float]:
    """Return date and time of a stamp, and the second with its fraction."""
    try:
        whole = int(stamp // 1)
        found = _EPOCH + timedelta(seconds=whole)
    except (OverflowError, ValueError):  # what is infinite is not a number of seconds
        raise domain_error("time_stamp", stamp) from None
    return found, found.second + (stamp - whole)


def _of_date(term: CompoundTerm) -> Tuple[datetime, float]:
    """Return date and time (UTC) that a date term names."""
    parts = [deref(part) for part in term[1:]]
    values: List[Number] = [0 if part.__class__ is Var else number(part) for part in parts[:6]]
    zone = parts[6] if len(parts) == 9 else 0
    offset = zone if zone.__class__ is int else 0
    given_year, given_month, day, hour, minute, second = (values + [0, 0, 0])[:6]
    year, month = integer(given_year), integer(given_month)
    year += (month - 1) // 12
    try:
        start = datetime(year, (month - 1) % 12 + 1, 1)
        moved = start + timedelta(days=day - 1, hours=hour, minutes=minute, seconds=offset + int(second // 1))
    except (OverflowError, ValueError):
        raise domain_error("date", term) from None
    return moved, moved.second + second - second // 1


def _moment(term: Term) -> Tuple[datetime, float]:
    term = deref(term)
    if term.__class__ is tuple and term[0] in (_DATE9, _DATE3):
        return _of_date(term)
    if term.__class__ not in (Var, int, float):
        raise type_error("time", term)
    return _of_stamp(number(term))


def _stamp(moment: datetime, second: float) -> float:
    days = (moment - _EPOCH).days
    return float(days * 86400 + moment.hour * 3600 + moment.minute * 60) + second


@deterministic("get_time/1")
def get_time(machine: Machine, stamp: Term) -> bool:
    """Give the present."""
    return unify(stamp, machine.logic.now() / 1e9, machine.trail)


@deterministic("stamp_date_time/3")
def stamp_date_time(machine: Machine, stamp: Term, result: Term, zone: Term) -> bool:
    """Give the date of a stamp; local time is UTC."""
    moment, second = _of_stamp(number(stamp))
    zone = deref(zone)
    offset = 0
    name, dst = _UTC, _NONE
    if zone.__class__ is Var:
        unify(zone, atom("local"), machine.trail)
    elif zone.__class__ is int:
        offset, name = zone, _NONE
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
def date_time_stamp(machine: Machine, given: Term, stamp: Term) -> bool:
    """Give the stamp of a date."""
    given = deref(given)
    if given.__class__ is Var:
        raise instantiation_error()
    if given.__class__ is not tuple or given[0] not in (_DATE9, _DATE3):
        raise type_error("time", given)
    return unify(stamp, _stamp(*_of_date(given)), machine.trail)


_FIELDS = ("year", "month", "day", "hour", "minute", "second", "utc_offset", "time_zone", "daylight_saving")


@nondeterministic("date_time_value/3")
def date_time_value(machine: Machine, name: Term, given: Term, value: Term) -> Solutions:
    """Enumerate the fields of a date."""
    given = deref(given)
    if given.__class__ is not tuple or given[0] is not _DATE9:
        return
    for field, part in zip(_FIELDS, given[1:]):
        if deref(part) is not _NONE and machine.unify_all((name, atom(field)), (value, part)):
            yield None
    if machine.unify_all((name, atom("date")), (value, (_DATE3, *given[1:4]))):
        yield LAST


@deterministic("day_of_the_week/2")
def day_of_the_week(machine: Machine, given: Term, number: Term) -> bool:
    """Give the day of the week of ``date(Y,M,D)``: Monday is 1."""
    given = deref(given)
    if given.__class__ is Var:
        raise instantiation_error()
    if given.__class__ is not tuple or given[0] is not _DATE3:
        return False
    year, month, day = (integer(part) for part in given[1:])
    try:
        return unify(number, date(year, month, day).isoweekday(), machine.trail)
    except ValueError:
        raise domain_error("date", given) from None


_ISO = re.compile(r"(\d{4})-(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d(?:\.\d+)?))?(Z|[+-]\d\d:?\d\d)?)?$")


@deterministic("parse_time/2")
def parse_time(machine: Machine, text: Term, stamp: Term) -> bool:
    """Give the stamp of an ISO 8601 text; fails for others."""
    found = _ISO.match(text_of(text))
    if found is None:
        return False
    year, month, day, hour, minute, second, zone = found.groups()
    try:
        moment = datetime(int(year), int(month), int(day), int(hour or 0), int(minute or 0))
    except ValueError:
        return False
    if zone and zone != "Z":
        sign = -1 if zone[0] == "-" else 1
        moment -= sign * timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
    return unify(stamp, _stamp(moment, float(second or 0)), machine.trail)


def _formatted(form: str, moment: datetime, second: float) -> str:
    """Return the text of a C time format; ``%f`` is the fraction of the second, ``%3f`` its first digits."""
    fraction = second - int(second)

    def fraction_text(match: "Match[str]") -> str:
        digits = int(match.group(1) or 6)
        return f"{fraction:.{digits}f}"[2:] if fraction < 1 - 0.5 * 10**-digits else "9" * digits

    text = re.sub(r"%(\d{0,2})f", fraction_text, form)
    text = (
        text.replace("%FT%T%:z", "%Y-%m-%dT%H:%M:%S%:z")
        .replace("%:z", "+00:00")
        .replace("%+", "%a %b %e %T %Y")
    )
    return moment.replace(tzinfo=timezone.utc).strftime(text)


@deterministic("format_time/3")
def format_time(machine: Machine, sink: Term, form: Term, given: Term) -> bool:
    """Write a stamp or date by a format, or unify it as ``format/3`` does."""
    text = _formatted(text_of(form), *_moment(given))
    sink = deref(sink)
    if is_sink(sink):
        return fill_sink(machine, sink, text)
    if sink.__class__ is tuple:
        raise type_error("output", sink)
    write_to(machine, sink, text)
    return True


# Statistics

_START = time.monotonic()


def _milliseconds(seconds: float) -> int:
    return int(seconds * 1000)


_STATISTICS: Dict[str, Callable[[Machine], Term]] = {
    "cputime": lambda machine: time.process_time(),
    "process_cputime": lambda machine: time.process_time(),
    "inferences": lambda machine: machine.budget.inferences,
    "epoch": lambda machine: time.time() - (time.monotonic() - _START),
    "real_time": lambda machine: _pair(machine, "real_time", int(time.time())),
    "runtime": lambda machine: _pair(machine, "runtime", _milliseconds(time.process_time())),
    "process_runtime": lambda machine: _pair(machine, "runtime", _milliseconds(time.process_time())),
    "walltime": lambda machine: _pair(machine, "walltime", _milliseconds(time.monotonic() - _START)),
    "trail": lambda machine: len(machine.trail),
    "trailused": lambda machine: len(machine.trail),
}


def _pair(machine: Machine, name: str, value: int) -> Term:
    """Return ``[Value,SinceTheLastCall]``."""
    last = machine.logic.state.setdefault("statistics", {})
    since = value - last.get(name, 0)
    last[name] = value
    return make_list([value, since])


@deterministic("statistics/2")
def statistics(machine: Machine, key: Term, value: Term) -> bool:
    """Give a figure about the process and the machine."""
    key = deref(key)
    if key.__class__ is Var:
        raise instantiation_error()
    if key.__class__ is not Atom or key.name not in _STATISTICS:
        raise domain_error("statistics_key", key)
    return unify(value, _STATISTICS[key.name](machine), machine.trail)
