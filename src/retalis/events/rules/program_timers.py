"""Timers of a program, which goals ``timer/2`` set: once or periodic.

Each timer is an alarm of the engine's clock, as the per-key timers of Flink's timer service are entries of one queue.
A jump of time, as at the start of a bag, would fire a periodic timer millions of times; beyond
`MAX_FIRINGS_PER_JUMP` only the last instant fires, with a warning.
"""

from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    Hashable,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ...foundation.displayed_text import format_count
from ...foundation.errors import UsageError
from ...prolog.builtins.argument_checks import bound, callable_of
from ...prolog.machine.errors import domain_error, resource_error
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import make_list
from ...prolog.terms.term_traversal import copy, freeze, term_key
from ...prolog.terms.timestamps import SECOND, lazy_term
from ...prolog.terms.types import Term, Var, atom, deref, functor, functor_of
from ...prolog.terms.unification import may_unify
from ...serialization.state_fields import StateFields, StateOwner, field, rows_of
from ...serialization.stored_field_types import CALLABLE_TERM, COUNT, INSTANT, TERM, optional
from ..language.timer_schedules import TIMER, Schedule, parse_schedule

if TYPE_CHECKING:
    from .rule_base import RuleBase


MAX_TIMERS = 10_000

MAX_FIRINGS_PER_JUMP = 10_000
"""Maximum number of events of one timer for one jump of time; beyond that only the last one is emitted."""

FIRST_INSTANT = 1
"""Instant of an alarm that waits for the clock's first time."""

_STALE_MARGIN = 16
"""Stale alarms are removed from the clock if they outnumber the others by this number."""


class StoredTimer(NamedTuple):
    """Stored form of a `ProgramTimer`.

    Attributes:
        instant: its next instant in ns; None if it waits for the first time of the clock.
        alarm_instant: instant of its alarm in the clock.
        order: order of the alarm.
    """

    event: Term
    schedule: Term
    instant: Optional[int]
    alarm_instant: int
    order: int


class ProgramTimer:
    """A timer of the program.

    Attributes:
        key: identity of the timer: its event and schedule.
        index_key: functor, first argument and whole event, the last two as keys; None for one with variables, and for
            a missing argument.
        instant: the next instant; None before the clock has a time.
        alarm_instant: instant of the alarm in the clock, at most `instant`; None if there is no alarm.
    """

    __slots__ = ("key", "index_key", "event", "schedule", "instant", "alarm_instant")

    def __init__(self, event: Term, schedule: Schedule):
        self.key: Hashable = term_key((TIMER, event, schedule.term))
        self.index_key = _index_key(event)
        self.event = event
        self.schedule = schedule
        self.instant: Optional[int] = None
        self.alarm_instant: Optional[int] = None


_IndexKey = Tuple[Hashable, Hashable, Hashable]


def _index_key(event: Any) -> _IndexKey:
    """Return the key of an event or of a pattern that is not a variable; see `ProgramTimer`."""
    first_argument_key = _ground_key(event[1]) if event.__class__ is tuple else None
    return functor_of(event), first_argument_key, _ground_key(event)


def _ground_key(term: Term) -> Hashable:
    """Return the key of a ground term, or None for a term with variables."""
    try:
        return freeze(term)
    except ValueError:
        return None


class TimerTable:
    """Timers by key, oldest first, and by event.

    The events are indexed as clauses are, by the functor and the first argument, and ground events as a whole. So a
    program may cancel each of its timers by a pattern such as ``timeout(Id, _)``.
    """

    def __init__(self, timers: Iterable[ProgramTimer] = ()):
        self.by_key: Dict[Hashable, ProgramTimer] = {}
        self._groups: Dict[Tuple[Hashable, ...], Dict[Hashable, ProgramTimer]] = {}
        """Timers by each beginning of their index keys."""
        for timer in timers:
            self.add(timer)

    def add(self, timer: ProgramTimer) -> None:
        """Add a timer, or replace the one with the same key."""
        self.by_key[timer.key] = timer
        for length in (1, 2, 3):
            self._groups.setdefault(timer.index_key[:length], {})[timer.key] = timer

    def remove(self, key: Hashable) -> ProgramTimer:
        """Remove and return a timer."""
        timer = self.by_key.pop(key)
        for length in (1, 2, 3):
            group = self._groups[timer.index_key[:length]]
            del group[key]
            if not group:
                del self._groups[timer.index_key[:length]]
        return timer

    def find_unifying(self, event: Term) -> List[ProgramTimer]:
        """Return the timers whose events unify with a term."""
        if event.__class__ is Var:
            return list(self.by_key.values())
        functor_key, argument_key, event_key = _index_key(event)
        # Timers whose event or first argument has variables may unify with any pattern of the functor.
        if event_key is not None:
            open_groups = dict.fromkeys(((functor_key, argument_key, None), (functor_key, None, None)))
            exact_group = self._groups.get((functor_key, argument_key, event_key), {})
            return [*exact_group.values(), *self._find_in_groups(event, open_groups)]
        if argument_key is not None:
            return self._find_in_groups(event, [(functor_key, argument_key), (functor_key, None)])
        return self._find_in_groups(event, [(functor_key,)])

    def _find_in_groups(self, event: Term, groups: Iterable[Tuple[Hashable, ...]]) -> List[ProgramTimer]:
        return [
            timer
            for group in groups
            for timer in self._groups.get(group, {}).values()
            if may_unify(timer.event, event)
        ]


class Timers(StateOwner):
    """The timers of a program.

    Each timer has at most one valid alarm in the clock. If a timer is set to a later instant, its alarm stays and
    sets the next one when it is called. Alarms of removed timers are deleted from the clock when they are the
    majority.

    Attributes:
        omitted_count: number of events omitted because of jumps of time.
    """

    STATE = StateFields(
        field(
            "stored_timers",
            rows_of(
                StoredTimer,
                event=CALLABLE_TERM,
                schedule=TERM,
                instant=optional(INSTANT),
                alarm_instant=INSTANT,
                order=COUNT,
            ),
        ),
        field("omitted_count", COUNT),
    )

    def __init__(self, rules: "RuleBase"):
        self._rules = rules
        self._active = TimerTable()
        self._inactive: Dict[Hashable, ProgramTimer] = {}
        self._jump_count = 0
        self._stale_alarm_count = 0
        self._delayed_goal_count = 0
        self.omitted_count = 0

    def __len__(self) -> int:
        return len(self._active.by_key)

    def __iter__(self) -> Iterator[ProgramTimer]:
        """Yield the timers, oldest first."""
        return iter(list(self._active.by_key.values()))

    # ---- goals ---------------------------------------------------------------------------------------

    def set(self, event: Term, schedule_term: Term) -> None:
        """Set a timer; an existing timer with the same event and schedule starts again.

        Raises:
            UsageError: if the schedule is invalid.
            PrologError: if there are too many timers.
        """
        timer = ProgramTimer(copy(event), parse_schedule(copy(schedule_term)))
        timer_to_set = self._active.by_key.get(timer.key) or self._inactive.pop(timer.key, None)
        now = self._time_for_goal()
        if timer_to_set is None:
            if len(self) >= MAX_TIMERS:
                raise resource_error("timers", reason=f"more than {MAX_TIMERS} timers are set")
            if now > 0 and timer.schedule.next_instant(now) is None:
                self._warn_past(timer)
                return
            timer_to_set = timer
        # After a reload an unchanged timer continues with its alarm, so its period does not start again.
        elif timer_to_set.key not in self._active.by_key and timer_to_set.alarm_instant is not None:
            self._active.add(timer_to_set)
            return
        self._active.add(timer_to_set)
        self._schedule_next(timer_to_set, now)

    def cancel(self, event: Term) -> int:
        """Remove the timers whose events unify with a term; return their number."""
        timers = self._active.find_unifying(event)
        for timer in timers:
            self._active.remove(timer.key)
            self._invalidate_alarm(timer)
        return len(timers)

    def find(self, event: Term, schedule_term: Term) -> Optional[ProgramTimer]:
        """Return the timer of an event and a schedule, or None."""
        return self._active.by_key.get(term_key((TIMER, event, schedule_term)))

    # ---- alarms --------------------------------------------------------------------------------------

    def _time_for_goal(self) -> int:
        """Return the present time for a goal that sets a timer.

        In a goal of an alarm this is the alarm's instant, even if the clock has jumped further, so that a chain of
        timers runs through all instants of the jump. After `MAX_FIRINGS_PER_JUMP` goals it is the clock's time: a
        timer that sets itself again would otherwise run through the whole jump, step by step.
        """
        clock = self._rules.clock
        reached, alarm_instant = clock.reached(), clock.ringing
        if alarm_instant is None or reached - alarm_instant <= SECOND:
            self._delayed_goal_count = 0
        else:
            self._delayed_goal_count += 1
        if alarm_instant is None or self._delayed_goal_count > MAX_FIRINGS_PER_JUMP:
            return reached
        return alarm_instant

    def _schedule_next(self, timer: ProgramTimer, now: int) -> None:
        """Compute the next instant of a timer, from the given time or from the clock's first time."""
        timer.instant = timer.schedule.next_instant(now) if now > 0 else None
        if now > 0 and timer.instant is None:
            self._active.remove(timer.key)
            self._invalidate_alarm(timer)
            self._warn_past(timer)
            return
        self._set_alarm(timer)

    def _set_alarm(self, timer: ProgramTimer) -> None:
        instant = FIRST_INSTANT if timer.instant is None else timer.instant
        if timer.alarm_instant is not None:
            # An earlier alarm is kept; `on_alarm` sets the alarm for the later instant.
            if timer.alarm_instant <= instant:
                return
            self._stale_alarm_count += 1
        timer.alarm_instant = instant
        self._rules.clock.call_at(instant, TimerAlarm(self, timer, instant))

    def _invalidate_alarm(self, timer: ProgramTimer) -> None:
        if timer.alarm_instant is None:
            return
        timer.alarm_instant = None
        self._stale_alarm_count += 1
        # Lazy deletion as in `NodeTimers`: amortized constant cost per removal.
        clock = self._rules.clock
        if 2 * self._stale_alarm_count > len(clock.alarms) + _STALE_MARGIN:
            clock.drop(lambda alarm: isinstance(alarm, TimerAlarm) and not self.is_valid_alarm(alarm))
            self._stale_alarm_count = 0

    def is_valid_alarm(self, alarm: "TimerAlarm") -> bool:
        """Return whether an alarm is the valid one of an existing timer."""
        timer = alarm.timer
        exists = self._active.by_key.get(timer.key) is timer or self._inactive.get(timer.key) is timer
        return exists and timer.alarm_instant == alarm.alarm_instant

    def on_alarm(self, alarm: "TimerAlarm") -> None:
        """Process an alarm of a timer."""
        if not self.is_valid_alarm(alarm):
            self._stale_alarm_count -= 1
            return
        timer = alarm.timer
        timer.alarm_instant = None
        instant = timer.instant
        if instant is None:
            # The clock has got its first time: now the schedule can be computed.
            self._schedule_next(timer, self._rules.clock.reached())
        elif instant > alarm.alarm_instant or self._skip_missed(timer, instant):
            self._set_alarm(timer)
        else:
            # The next alarm is set before the event is dispatched, so that its goals can cancel or replace the timer.
            if timer.schedule.repeats:
                timer.instant = instant + timer.schedule.period
                self._set_alarm(timer)
            else:
                self._active.remove(timer.key)
            self._dispatch(timer.event, int(instant))

    def _skip_missed(self, timer: ProgramTimer, instant: int) -> bool:
        """If too many instants of a periodic timer have passed, move it to the last one; return whether it moved."""
        schedule = timer.schedule
        if not schedule.repeats:
            return False
        missed_count = (self._rules.clock.coming() - instant) // schedule.period
        if missed_count < MAX_FIRINGS_PER_JUMP:
            return False
        timer.instant = instant + missed_count * schedule.period
        self._jump_count += 1
        self.omitted_count += missed_count
        # Warned at jump 1, 2, 4, 8 and so on.
        if self._jump_count & (self._jump_count - 1) == 0:
            show = self._rules.logic.brief
            seconds = missed_count * schedule.period // SECOND
            self._rules.network.on_warning(
                UsageError(
                    f"time has jumped by {seconds} s: {format_count(missed_count, 'event')} of timer "
                    f"{show(timer.event)}, {show(schedule.term)} left out; {self.omitted_count} of all timers so far"
                )
            )
        return True

    def _dispatch(self, event: Term, instant: int) -> None:
        dispatcher, machine = self._rules.dispatcher, self._rules.logic.machine
        dispatcher.run_without_context(
            lambda: machine.run(dispatcher.dispatch(event, instant, instant, machine.done, is_owned=False))
        )

    def _warn_past(self, timer: ProgramTimer) -> None:
        show = self._rules.logic.brief
        self._rules.network.on_warning(
            UsageError(f"timer {show(timer.event)}, {show(timer.schedule.term)}: that instant has passed")
        )

    # ---- lifecycle -----------------------------------------------------------------------------------

    def clear(self) -> None:
        """Remove all timers."""
        for timer in self:
            self._active.remove(timer.key)
            self._invalidate_alarm(timer)

    def restart(self) -> None:
        """Restart the timers after time went back and the clock dropped its alarms.

        Timers with a relative time are removed, like other alarms, because they belong to the time before.
        """
        self._stale_alarm_count = 0
        for timer in self:
            timer.alarm_instant = None
            if timer.schedule.is_relative:
                self._active.remove(timer.key)
            else:
                self._schedule_next(timer, self._rules.clock.reached())

    def return_to(self, instant: int) -> None:
        """Let periodic timers fire from an instant on again, because the clock had followed a wrong timestamp."""
        for timer in self:
            period = timer.schedule.period
            if timer.schedule.repeats and timer.instant is not None and timer.instant > instant + period:
                timer.instant -= (timer.instant - instant - 1) // period * period
                self._set_alarm(timer)

    def _set_missing_alarms(self) -> None:
        alarms = {
            alarm.timer: alarm
            for _, _, alarm in self._rules.clock.alarms
            if isinstance(alarm, TimerAlarm) and self.is_valid_alarm(alarm)
        }
        for timer in self:
            if timer not in alarms:
                timer.alarm_instant = None
                self._set_alarm(timer)

    def all_by_key(self) -> Dict[Hashable, ProgramTimer]:
        """Return the timers by key."""
        return dict(self._active.by_key)

    def detach(self, timers: Mapping[Hashable, ProgramTimer]) -> None:
        """Deactivate timers; those that are set again unchanged continue."""
        for key in timers:
            self._inactive[key] = self._active.remove(key)

    def discard_detached(self) -> None:
        """Remove the deactivated timers."""
        removed, self._inactive = list(self._inactive.values()), {}
        for timer in removed:
            self._invalidate_alarm(timer)

    def restore_all(self, timers: Mapping[Hashable, ProgramTimer]) -> None:
        """Restore exactly these timers, whether or not they have been deactivated."""
        removed = [timer for timer in self if timers.get(timer.key) is not timer]
        self._active, self._inactive = TimerTable(timers.values()), {}
        for timer in removed:
            self._invalidate_alarm(timer)
        self._set_missing_alarms()

    @property
    def stored_timers(self) -> List[StoredTimer]:
        """All timers, with their alarms."""
        return [
            StoredTimer(
                alarm.timer.event, alarm.timer.schedule.term, alarm.timer.instant, alarm.alarm_instant, order
            )
            for _, order, alarm in sorted(self._rules.clock.alarms, key=lambda entry: entry[:2])
            if isinstance(alarm, TimerAlarm) and self.is_valid_alarm(alarm)
        ]

    @stored_timers.setter
    def stored_timers(self, timers: Sequence[StoredTimer]) -> None:
        for event, schedule_term, instant, alarm_instant, order in timers:
            timer = ProgramTimer(event, parse_schedule(schedule_term))
            timer.instant, timer.alarm_instant = instant, alarm_instant
            self._active.add(timer)
            self._rules.clock.put_back(alarm_instant, order, TimerAlarm(self, timer, alarm_instant))


class TimerAlarm:
    """The alarm of a timer in the clock."""

    __slots__ = ("timers", "timer", "alarm_instant")

    def __init__(self, timers: Timers, timer: ProgramTimer, alarm_instant: int):
        self.timers = timers
        self.timer = timer
        self.alarm_instant = alarm_instant

    def __call__(self, now: int) -> None:
        """Process the alarm."""
        self.timers.on_alarm(self)


_TIMER_ROW = functor("timer", 3)
_WAITING = atom("waits")


def define_timers(logic: PrologSystem, timers: Timers, require_declared: Callable[[Term], None]) -> None:
    """Define the timer goals.

    Args:
        logic: the system in which they are defined.
        timers: the timers of the program.
        require_declared: raises an error for an event that does not match its declaration.
    """
    _TimerPredicates(timers, require_declared).define(logic)


class _TimerPredicates:
    """The goals ``timer/2``, ``cancel_timer/1,2`` and ``timers/1``."""

    def __init__(self, timers: Timers, require_declared: Callable[[Term], None]):
        self.timers = timers
        self.require_declared = require_declared

    def define(self, logic: PrologSystem) -> None:
        logic.define("timer", 2, self.set)
        logic.define("cancel_timer", 1, self.cancel)
        logic.define("cancel_timer", 2, self.cancel_and_count)
        logic.define("timers", 1, self.list_timers)

    def set(self, machine: Machine, event: Term, schedule_term: Term) -> bool:
        event, schedule_term = callable_of(event), bound(schedule_term)
        self.require_declared(event)
        try:
            self.timers.set(event, schedule_term)
        except UsageError as error:
            raise domain_error("timer", schedule_term, error.message) from None
        return True

    def cancel(self, machine: Machine, event: Term) -> bool:
        self.timers.cancel(deref(event))
        return True

    def cancel_and_count(self, machine: Machine, event: Term, number: Term) -> bool:
        return bool(machine.unify(number, self.timers.cancel(deref(event))))

    def list_timers(self, machine: Machine, timer_list: Term) -> bool:
        rows: List[Any] = []
        for timer in self.timers:
            instant = _WAITING if timer.instant is None else lazy_term(int(timer.instant))
            rows.append((_TIMER_ROW, copy(timer.event), copy(timer.schedule.term), instant))
        return bool(machine.unify(timer_list, make_list(rows)))
