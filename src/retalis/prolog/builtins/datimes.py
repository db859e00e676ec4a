"""Time stamps in programs: ``datime/7``, ``datime/6``, numbers of seconds, and ROS times ``[Sec,NSec]``.

Comparisons are by the instant that a stamp names, whatever its form.
"""

from typing import Any, Callable, Tuple

from ...foundation import UsageError
from ..arithmetic import Number, checked
from ..machine import domain_error, evaluation_error, instantiation_error, type_error
from ..terms import (
    CONS,
    DATIME6,
    DATIME7,
    NIL,
    SECOND,
    Lazy,
    Term,
    Var,
    deref,
    make_list,
    timestamps,
    unify,
)
from .arguments import integer
from .program import Machine
from .registry import deterministic, function


def instant_of(term: Term) -> int:
    """Return the instant that an argument names.

    Raises:
        PrologError: an instantiation or type error where it names none.
    """
    while term.__class__ is Var and term.ref is not None:
        term = term.ref
    if term.__class__ is Lazy and term.make is timestamps.to_term and term.made is None:
        return term.source  # type: ignore[no-any-return]  # most come from a look-up or a conversion
    try:
        return timestamps.from_any(term)
    except UsageError:
        raise instantiation_error() if term.__class__ is Var else type_error("datime", term) from None


def _arity(term: Term) -> int:
    """Return 7 or 6 for a datime, 2 for a ROS time, 0 for a number."""
    term = deref(term) if term.__class__ is not Lazy else term
    if term.__class__ is Lazy:
        return term.functor.arity
    return len(term) - 1 if term.__class__ is tuple else 0


@function("convert_to_datime/2")
def convert_to_datime(time: Term) -> Term:
    """Give the stamp of a ROS time ``[Sec,NSec]``."""
    time = deref(time)
    if time.__class__ is tuple and time[0] is CONS:
        rest = deref(time[2])
        if rest.__class__ is tuple and rest[0] is CONS and deref(rest[2]) is NIL:
            instant = timestamps.from_parts(integer(time[1]), integer(rest[1]))
            return timestamps.shown(instant)
    if time.__class__ is Var:
        raise instantiation_error()
    raise type_error("[Sec,NSec]", time)


@function("datime_interpolate/4")
def datime_interpolate(first: Term, second: Term, at: Term) -> Term:
    """Give the weight of the first of two stamps at an instant: 1 at the first, 0 at the second."""
    return weight_of_first(instant_of(first), instant_of(second), instant_of(at))


def weight_of_first(start: int, end: int, middle: int) -> Number:
    """Return the weight of the first of two instants."""
    return 1 if start == end else (end - middle) / (end - start)


@deterministic("less_datime/2")
def less_datime(machine: Machine, left: Term, right: Term) -> bool:
    """Compare."""
    return instant_of(left) < instant_of(right)


@deterministic("less_equal_datime/2")
def less_equal_datime(machine: Machine, left: Term, right: Term) -> bool:
    """Compare."""
    return instant_of(left) <= instant_of(right)


@deterministic("equal_datime/2", "equal_datime_retalis/2")
def equal_datime(machine: Machine, left: Term, right: Term) -> bool:
    """Compare."""
    return instant_of(left) == instant_of(right)


@deterministic("between_datime/3")
def between_datime(machine: Machine, at: Term, low: Term, high: Term) -> bool:
    """Test for a stamp between two others: strictly for datimes, limits included for numbers."""
    instant, first, last = instant_of(at), instant_of(low), instant_of(high)
    if _arity(at) or _arity(low) or _arity(high):
        return first < instant < last
    return first <= instant <= last


def _one_of(earlier: bool) -> Callable[[Machine, Term, Term, Term], bool]:
    def run(machine: Machine, left: Term, right: Term, result: Term) -> bool:
        left, right = deref(left), deref(right)
        if isinstance(left, (int, float)) and isinstance(right, (int, float)):
            first = left <= right
        else:
            first = instant_of(left) <= instant_of(right)
        return unify(result, left if first is earlier else right, machine.trail)

    return run


deterministic("min/3", locked=False)(_one_of(True))
deterministic("max/3", locked=False)(_one_of(False))


@deterministic("is_datime/1")
def is_datime(machine: Machine, term: Term) -> bool:
    """Test for a datime."""
    term = deref(term)
    return term.__class__ is tuple and term[0] in (DATIME6, DATIME7) and timestamps.is_instant(term)


@deterministic("datime_minus_datime/3")
def datime_minus_datime(machine: Machine, later: Term, earlier: Term, seconds: Term) -> bool:
    """Give the seconds between two stamps: for two numbers or two whole ``datime/6`` as these are, else a float."""
    later, earlier = deref(later), deref(earlier)
    distance = int(instant_of(later)) - int(instant_of(earlier))
    if isinstance(later, (int, float)) and isinstance(earlier, (int, float)):
        return unify(seconds, later - earlier, machine.trail)
    whole, rest = divmod(distance, SECOND)
    is_integer = _arity(later) == _arity(earlier) == 6 and not rest
    return unify(seconds, whole if is_integer else distance / SECOND, machine.trail)


def _moved(stamp: Term, seconds: Term, sign: int) -> Term:
    """Return a stamp some seconds later, in its own form."""
    found: Any = deref(stamp)
    seconds = deref(seconds)
    instant = instant_of(found)
    if not isinstance(seconds, (int, float)):
        raise instantiation_error() if seconds.__class__ is Var else type_error("number", seconds)
    if isinstance(found, (int, float)):
        return checked(found + sign * seconds)
    try:
        moved = int(instant) + sign * timestamps.from_seconds(seconds)
        fields = timestamps.fields(moved)
    except UsageError:
        raise evaluation_error("undefined") from None
    arity = _arity(found)
    if arity == 2:
        return make_list(timestamps.to_parts(moved))
    if arity == 6:
        return _as_datime6(fields, deref(found[6]).__class__ is float or seconds.__class__ is float)
    return timestamps.datime(moved) if deref(found[6]).__class__ is int else timestamps.to_term(moved)


def _as_datime6(fields: Tuple[int, ...], is_float: bool) -> Term:
    *whole, second, rest = fields
    exact: Number = second + rest / SECOND if rest else second
    return (DATIME6, *whole, float(exact) if is_float else exact)


@deterministic("datime_plus_sec/3")
def datime_plus_sec(machine: Machine, stamp: Term, seconds: Term, result: Term) -> bool:
    """Add seconds to a stamp of any form, and give one of the same form."""
    return unify(result, _moved(stamp, seconds, 1), machine.trail)


@deterministic("addSec_Datime/3")
def add_sec_datime(machine: Machine, seconds: Term, stamp: Term, result: Term) -> bool:
    """Do what ``datime_plus_sec/3`` does."""
    return datime_plus_sec(machine, stamp, seconds, result)


@deterministic("datime_minus_sec/3")
def datime_minus_sec(machine: Machine, stamp: Term, seconds: Term, result: Term) -> bool:
    """Take seconds from a stamp of any form, and give one of the same form."""
    return unify(result, _moved(stamp, seconds, -1), machine.trail)


@deterministic("current_datime/1")
def current_datime(machine: Machine, result: Term) -> bool:
    """Give the present as ``datime/6``."""
    return unify(result, timestamps.datime6(machine.logic.now()), machine.trail)


@deterministic("month_days/3")
def month_days(machine: Machine, month: Term, year: Term, days: Term) -> bool:
    """Give the number of days of a month; year and month may stand in either order."""
    first, second = integer(month), integer(year)
    if first > 12:
        first, second = second, first
    if not 1 <= first <= 12:
        raise domain_error("month", first)
    return unify(days, timestamps.month_days(second, first), machine.trail)


@function("absoluteTime/2")
def absolute_time(stamp: Term) -> Term:
    """Give the seconds since midnight."""
    *_, hour, minute, second, rest = timestamps.fields(instant_of(stamp))
    value = (hour * 60 + minute) * 60 + second
    return value + rest / SECOND if rest else value
