"""Heads of rules: the events that a rule raises, and the wrappers that raise them later.

A head is an event that the rule raises, or one of these wrappers around it: ``exceptionAlarm/2`` and
``exceptionAlarmAbsoluteDatime/2`` raise it later (after a delay or at an instant), ``synchronized/3`` raises it when
a query has a solution, ``do`` calls a goal in addition. `check_head` rejects heads that can never raise an event.
"""

from typing import Any, Callable, Optional, Tuple

from ...foundation.errors import RuleError, UsageError
from ...foundation.source_places import Place
from ...prolog.terms.list_terms import list_items, list_parts, make_list
from ...prolog.terms.timestamps import DATIME6, DATIME7, from_any, from_seconds
from ...prolog.terms.types import COLON, CONS, NIL, Atom, CompoundTerm, Term, Var, deref, functor
from .called_predicates import calls
from .event_operators import OPERATOR_NAMES
from .likely_mistakes import head_error, head_warning
from .pattern_parser import PlaceLookup
from .timer_schedules import sets_timer

_ALARM_AFTER = functor("exceptionAlarm", 2)
_ALARM_AT = functor("exceptionAlarmAbsoluteDatime", 2)
ALARMS = frozenset((_ALARM_AFTER, _ALARM_AT))
_DEFAULT_YEAR = 2000


def resolve_alarm(head: CompoundTerm, start: int, end: int) -> Optional[Tuple[Term, int, int]]:
    """Return the event of an alarm, its start and the instant at which it fires; None for any other head.

    If the instant lies before the start, the result is None too: as in the original engine, the head then is an
    ordinary event.

    Raises:
        UsageError: if the delay or instant is invalid.
    """
    if head[0] is _ALARM_AFTER:
        instant = int(end + alarm_delay(head[2]))
    elif head[0] is _ALARM_AT:
        instant = int(from_any(head[2]))
    else:
        return None
    if instant < start:
        return None
    return deref(head[1]), start, instant


def is_absolute_alarm(head: Term) -> bool:
    """Return whether the head of an alarm contains its instant."""
    return head.__class__ is tuple and head[0] is _ALARM_AT


def alarm_delay(term: Term) -> int:
    """Return the delay of an alarm in ns.

    Raises:
        UsageError: if the delay is not a positive number.
    """
    seconds = deref(term)
    if seconds.__class__ not in (int, float) or not seconds > 0:
        raise UsageError("exceptionAlarm needs a positive number of seconds")
    return from_seconds(seconds)


def check_alarm_time(head: CompoundTerm) -> None:
    """Check the time in the head of an alarm as far as it is known before its variables are bound.

    Raises:
        UsageError: if no values of the variables make it valid.
    """
    instant = deref(head[2])
    if instant.__class__ is Var:
        return
    if head[0] is _ALARM_AFTER:
        alarm_delay(instant)
    elif head[0] is _ALARM_AT:
        with_defaults = _fill_unbound_fields(instant)
        try:
            from_any(with_defaults)
        except UsageError as error:
            prefix = "no such date and time exists; " if _is_datime(with_defaults) else ""
            raise UsageError(f"{prefix}{error.message}") from None


def _is_datime(term: Term) -> bool:
    return term.__class__ is tuple and (term[0] is DATIME6 or term[0] is DATIME7)


def _fill_unbound_fields(instant: Term) -> Term:
    """Return an instant with values for its variables that are valid if any values are."""
    if instant.__class__ is not tuple:
        return instant
    # Month, day, hour and second 1 are always valid, and 2000 is a leap year: if the bound fields are invalid with
    # these values, they are invalid with all.
    if instant[0] is CONS:
        items = list_items(instant)
        return 1 if items is None else make_list([_default_if_unbound(item, 1) for item in items])
    if _is_datime(instant):
        return (
            instant[0],
            _default_if_unbound(instant[1], _DEFAULT_YEAR),
            *(_default_if_unbound(field, 1) for field in instant[2:]),
        )
    return instant


def _default_if_unbound(term: Term, value: int) -> Term:
    term = deref(term)
    return value if term.__class__ is Var else term


SYNCHRONIZED = frozenset(functor(name, arity) for name in ("syncronized", "synchronized") for arity in (3, 4))
"""Heads and events of synchronized queries; the original Retalis has the first spelling."""

_TIMEOUT = functor("timeout", 1)


def has_timeout(head: Optional[Term]) -> bool:
    """Return whether the head of a rule is a synchronized query with options, which bound its time."""
    return head.__class__ is tuple and head[0] in SYNCHRONIZED and head[0].arity == 4


def check_head(
    head: Term, place_of: PlaceLookup, place: Optional[Place], warn: Callable[[RuleError], None]
) -> None:
    """Check the head of a rule.

    Args:
        head: the head, without its ``do`` goal.
        place_of: returns the places of its parts.
        place: the place of the head.
        warn: receives probable mistakes that are not errors.

    Raises:
        RuleError: if the head can never raise an event.
    """
    if head.__class__ not in (tuple, Atom, Var):
        raise RuleError("the head of a rule is an event: an atom or a compound term", place)
    if head.__class__ is not tuple:
        return
    operator = OPERATOR_NAMES.get(head[0])
    error_text = head_error(head, operator)
    if error_text is not None:
        raise RuleError(error_text, place)
    warning = head_warning(head, operator)
    if warning is not None:
        warn(RuleError(warning, place))
    if head[0] is COLON:
        warn(RuleError("this is an event that contains a colon: a rule has one label", place))
    if head[0] in ALARMS:
        try:
            check_alarm_time(head)
        except UsageError as error:
            raise RuleError(error.message, place_of(head, 2)) from None
    if head[0] in ALARMS or head[0] in SYNCHRONIZED:
        # The event inside a wrapper is a head as well, with the same rules.
        event = deref(head[1])
        check_head(event, place_of, place_of(event) if event.__class__ is tuple else place_of(head, 1), warn)
    if head[0] in SYNCHRONIZED:
        _check_query(head, place_of)


def _check_query(head: Any, place_of: PlaceLookup) -> None:
    """Check the query of a ``synchronized`` head, and the memories that it waits for."""
    for call in calls(head, 2):
        if call.term.__class__ not in (tuple, Atom, Var):
            raise RuleError(f"{head[0].name} needs a goal", place_of(call.parent, call.position))
    items, tail = list_parts(head[3])
    if not (tail is NIL or tail.__class__ is Var) or not all(_may_be_pair(item) for item in items):
        raise RuleError(f"{head[0].name} takes a list of [Memory, Time]", place_of(head, 3))
    if len(head) > 4 and not _may_be_options(deref(head[4])):
        raise RuleError(f"{head[0].name} takes [timeout(Seconds)] as its options", place_of(head, 4))


def _may_be_pair(term: Term) -> bool:
    items, tail = list_parts(term)
    # An open list may still become a pair when the rule is run.
    return len(items) <= 2 if tail.__class__ is Var else tail is NIL and len(items) == 2


def _may_be_options(term: Term) -> bool:
    items, tail = list_parts(term)
    if tail is not NIL or len(items) != 1:
        return tail.__class__ is Var and not items
    option: Any = deref(items[0])
    if option.__class__ is not tuple:
        return option.__class__ is Var
    seconds = deref(option[1])
    return option[0] is _TIMEOUT and (
        seconds.__class__ is Var or (seconds.__class__ in (int, float) and seconds >= 0)
    )


HEAD_READINGS: Tuple[Tuple[str, str], ...] = (
    ("exceptionAlarm(E, N)", "E is emitted N seconds after the end of this match:"),
    ("exceptionAlarmAbsoluteDatime(E, T)", "E is emitted at T, after this match:"),
    *(
        (notation.format(name), words)
        for name in ("synchronized", "syncronized")
        for notation, words in (
            (
                "{}(E, Q, M)",
                "E is emitted if goal Q has a solution when the data of M have arrived, after this match:",
            ),
            (
                "{}(E, Q, M, [timeout(N)])",
                "E is emitted if goal Q has a solution when the data of M have arrived, within N seconds after this "
                "match:",
            ),
            (
                "{}(E, Q, M, O)",
                "E is emitted if goal Q has a solution when the data of M have arrived, with options O, after this "
                "match:",
            ),
        )
    ),
)
"""Notations of the heads that raise an event later, with their words in readings of rules."""

NEW_EVENT = frozenset(
    (*(functor("new_event", arity) for arity in (2, 3, 5)), functor("event", 1), functor("event", 2))
)
"""Goals that immediately raise the event in their first argument."""


def makes_event(term: Term) -> bool:
    """Return whether a term is a goal that raises the event in its first argument, immediately or by a timer."""
    return term.__class__ is tuple and (term[0] in NEW_EVENT or sets_timer(term))


def event_raised_by(head: Optional[Term]) -> Optional[Term]:
    """Return the event that a rule with a head raises, immediately or later; None without a head."""
    if head is None:
        return None
    term: Any = deref(head)
    while term.__class__ is tuple and (term[0] in ALARMS or term[0] in SYNCHRONIZED):
        term = deref(term[1])
    event: Term = term
    return event
