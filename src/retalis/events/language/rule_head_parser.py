"""Parser of rule labels, rule heads and timer schedules.

A label names a rule and sets its properties: ``L : R`` or ``L([property(Name, Value), ...]) : R``.

A head is an event that the rule raises, or one of these wrappers around it: ``exceptionAlarm/2`` and
``exceptionAlarmAbsoluteDatime/2`` raise it later (after a delay or at an instant), ``synchronized/3`` raises it when
a query has a solution, ``do`` calls a goal in addition. `check_head` rejects heads that can never raise an event.

The goal ``timer(Event, Schedule)`` raises events without any input. `Schedule` computes the instants of
``every(Seconds)``, ``at(Hour, Minute, Second)``, ``after(Seconds)`` and the other forms; times of day are UTC.
"""

from math import isfinite
from typing import Any, Callable, Dict, NamedTuple, Optional, Tuple

from ...foundation.errors import Place, RuleError, UsageError
from ...foundation.similar_names import did_you_mean
from ...prolog.terms.list_terms import list_items, list_parts, make_list
from ...prolog.terms.term_traversal import is_ground
from ...prolog.terms.timestamps import DATIME6, DATIME7, SECOND, from_any, from_seconds
from ...prolog.terms.types import COLON, CONS, NIL, Atom, CompoundTerm, Term, Var, atom, deref, functor
from .called_predicates import calls
from .event_operators import ARROWS, OPERATOR_NAMES
from .likely_mistakes import head_error, head_warning
from .pattern_parser import PlaceLookup

RULE = functor("rule:", 2)
_PROPERTY = functor("property", 2)
WORD_PROPERTIES: Dict[str, Tuple[str, ...]] = {
    "policy": ("recent", "recent_2", "chronological", "chronological_2", "unrestricted"),
    "out_of_order": ("off", "on"),
    "after_match": ("keep", "skip_past_last", "skip_to_next"),
}
"""Properties whose value is one of several words. If a property is set twice, the last value holds."""

WATERMARK_DELAY = "watermark_delay"
"""Name of the property, and of the flag, whose value is ``auto`` or a number of seconds."""

KNOWN_PROPERTIES = ("event_rule_window", "window", "window_step", "ttl", WATERMARK_DELAY, *WORD_PROPERTIES)
_LABEL_FORM = "a label is an atom, or Label([property(Name, Value), ...])"


class Property(NamedTuple):
    """Property of a label."""

    label: Term
    name: str
    value: Term

    @property
    def is_known(self) -> bool:
        """True if a property with this name exists."""
        return self.name in KNOWN_PROPERTIES

    @property
    def numeric_value(self) -> float:
        """The value of a valid numeric property."""
        value = self.value
        assert isinstance(value, (int, float))
        return value

    @property
    def word_value(self) -> Optional[str]:
        """The value of a valid property of `WORD_PROPERTIES`; None for a number."""
        return self.value.name if self.name in WORD_PROPERTIES and isinstance(self.value, Atom) else None

    @property
    def error_text(self) -> Optional[str]:
        """Error in the property, or None."""
        if not self.is_known:
            names = ", ".join(KNOWN_PROPERTIES)
            hint = did_you_mean(self.name, KNOWN_PROPERTIES)
            return f"there is no property {self.name}; the properties are {names}{hint}"
        words = WORD_PROPERTIES.get(self.name)
        if words is not None:
            value = self.value.name if isinstance(self.value, Atom) else ""
            return (
                None
                if value in words
                else f"property {self.name} is {_join_alternatives(words)}{did_you_mean(value, words)}"
            )
        if self.name == WATERMARK_DELAY and isinstance(self.value, Atom):
            is_auto = self.value.name == "auto"
            return None if is_auto else f"property {self.name} is auto or a number of seconds, 0 or more"
        if self.value.__class__ not in (int, float) or not (self.value >= 0 and isfinite(self.value)):
            return f"property {self.name} needs a number of seconds, 0 or more"
        return None


def _join_alternatives(words: Tuple[str, ...]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"


def is_rule(term: Term) -> bool:
    """Return whether a term is an event rule, with or without a label."""
    if term.__class__ is not tuple:
        return False
    if term[0] is RULE or term[0] is COLON:
        label, unlabelled = split_label(term)
        return label is not None and is_unlabelled_rule(unlabelled)
    return is_unlabelled_rule(term)


def is_unlabelled_rule(term: Term) -> bool:
    """Return whether a term is an event rule without a label."""
    return term.__class__ is tuple and (term[0] in ARROWS or OPERATOR_NAMES.get(term[0]) == "do")


def split_label(term: CompoundTerm) -> Tuple[Optional[Term], Term]:
    """Return label and rule; the label is None if it is missing or malformed."""
    if term[0] is not RULE and term[0] is not COLON:
        return None, term
    label = deref(term[1])
    if label.__class__ is tuple:
        items = list_items(label[1]) if len(label) == 2 else None
        if items is None or not all(_is_property(deref(item)) for item in items):
            return None, term
    elif label.__class__ is not Atom:
        return None, term
    return label, deref(term[2])


def label_error(term: CompoundTerm, place_of: PlaceLookup) -> Optional[RuleError]:
    """Return the error in the label of a rule, or None."""
    if not is_unlabelled_rule(deref(term[2])) or split_label(term)[0] is not None:
        return None
    label = deref(term[1])
    # A variable is a plausible mistake: a label in upper case.
    if label.__class__ is Var:
        return RuleError(f"{_LABEL_FORM}, not a variable", place_of(term, 1))
    if label.__class__ is tuple and len(label) == 2:
        for item in list_items(label[1]) or ():
            part = deref(item)
            if not _is_property(part):
                place = place_of(part) if part.__class__ is tuple else place_of(label)
                return RuleError(f"expected {_guess_property(part)}; {_LABEL_FORM}", place)
    return RuleError(_LABEL_FORM, place_of(term, 1))


def _guess_property(part: Term) -> str:
    """Return the property that was probably intended by an invalid item in the list of a label."""
    name: Any = None
    value: Any = None
    if part.__class__ is tuple and len(part) == 2:
        name, value = part[0].name, deref(part[1])
    # The infix forms that other configuration languages use.
    elif part.__class__ is tuple and len(part) == 3:  # window = 3, window-3
        name, value = getattr(deref(part[1]), "name", None), deref(part[2])
    if name in WORD_PROPERTIES and value.__class__ is Atom:
        value = value.name
    elif name not in KNOWN_PROPERTIES or value.__class__ not in (int, float):
        return "property(Name, Value)"
    return f"property({name}, {value})"


def _is_property(term: Term) -> bool:
    return term.__class__ is tuple and term[0] is _PROPERTY and deref(term[1]).__class__ is Atom


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
