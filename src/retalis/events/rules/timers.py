"""Timers that a program has set: events at instants that the clock reaches, once or again and again."""

from typing import Any, Dict, Hashable, Iterable, Iterator, List, Mapping, Optional, Protocol, Sequence, Tuple

from ...foundation import UsageError, counted
from ...prolog.logic import Logic
from ...prolog.machine import resource_error
from ...prolog.terms import SECOND, Term, WholeSeconds, copy, freeze, may_unify, term_key
from ..dispatch import Dispatcher
from ..language import TIMER, Schedule, schedule_of
from .timing import Timing

MOST = 10_000
"""Timers that may be set at once."""

MOST_AT_ONCE = 10_000
"""How many times one timer rings for a jump of time; of more only the last is made up for."""

BEGIN = 1
"""The instant of the alarm that waits for there to be a time."""

_SPARE = 16

KeptTimer = Tuple[Term, Term, Optional[int], int, int]
"""Event, schedule, the instant at which it rings, and the alarm's in the clock with its order."""


class TimedProgram(Protocol):
    """All rules of a program, as its timers see them."""

    @property
    def logic(self) -> Logic:
        """Whose machine runs what an event starts."""

    @property
    def dispatcher(self) -> Dispatcher:
        """Serves the events."""

    @property
    def clock(self) -> Timing:
        """Rings."""

    @property
    def on_warning(self) -> Any:
        """Called with each warning."""


class ProgramTimer:
    """One timer.

    Attributes:
        key: tells it from others: its event and when it rings.
        name: equal for those of the same event; None for events with variables.
        instant: when it rings next; None where there is no time yet.
        set_for: the instant of its alarm in the clock, which may be earlier; None where it has none.
    """

    __slots__ = ("key", "name", "event", "schedule", "instant", "set_for")

    def __init__(self, event: Term, schedule: Schedule):
        self.key: Hashable = term_key((TIMER, event, schedule.term))
        self.name = _name_of(event)
        self.event = event
        self.schedule = schedule
        self.instant: Optional[int] = None
        self.set_for: Optional[int] = None


def _name_of(event: Term) -> Hashable:
    try:
        return freeze(event)
    except ValueError:
        return None


class TimerTable:
    """Timers by their keys, the oldest first, and by their events.

    Args:
        timers: that are there from the beginning.
    """

    def __init__(self, timers: Iterable[ProgramTimer] = ()):
        self.by_key: Dict[Hashable, ProgramTimer] = {}
        self._by_name: Dict[Hashable, Dict[Hashable, ProgramTimer]] = {}
        for timer in timers:
            self.add(timer)

    def add(self, timer: ProgramTimer) -> None:
        """Have a timer in the place of any with the same key."""
        self.by_key[timer.key] = timer
        self._by_name.setdefault(timer.name, {})[timer.key] = timer

    def remove(self, key: Hashable) -> ProgramTimer:
        """Take a timer out."""
        timer = self.by_key.pop(key)
        same = self._by_name[timer.name]
        del same[key]
        if not same:
            del self._by_name[timer.name]
        return timer

    def unifying(self, event: Term) -> List[ProgramTimer]:
        """Return those whose events unify with a term; of one without variables these are found by it."""
        name = _name_of(event)
        if name is None:
            return [timer for timer in self.by_key.values() if may_unify(timer.event, event)]
        general = self._by_name.get(None, {}).values()
        found = list(self._by_name.get(name, {}).values())
        return found + [timer for timer in general if may_unify(timer.event, event)]


class Timers:
    """All timers of a program.

    A timer has one alarm in the clock that counts. Where it is set again for later, that alarm stays, and sets
    another one when it rings; those of timers that are gone are taken out of the clock when they are the most.

    Attributes:
        left_out: how many events of timers were left out since time had jumped.
    """

    def __init__(self, program: TimedProgram):
        self._program = program
        self._all = TimerTable()
        self._aside: Dict[Hashable, ProgramTimer] = {}
        self._jumps = 0
        self._dead = 0
        self._behind = 0
        self.left_out = 0

    def __len__(self) -> int:
        return len(self._all.by_key)

    def __iter__(self) -> Iterator[ProgramTimer]:
        """Yield those that are set, the oldest first."""
        return iter(list(self._all.by_key.values()))

    # ---- what goals ask for --------------------------------------------------------------------------

    def set(self, event: Term, when: Term) -> None:
        """Have an event happen when its instant has come; one that is set already is counted from now.

        Raises:
            UsageError: what was expected.
            PrologError: where there are too many.
        """
        timer = ProgramTimer(copy(event), schedule_of(copy(when)))
        known = self._all.by_key.get(timer.key) or self._aside.pop(timer.key, None)
        now = self._present()
        if known is None:
            if len(self) >= MOST:
                raise resource_error("timers", reason=f"more than {MOST} timers are set")
            if now > 0 and timer.schedule.next(now) is None:
                self._over(timer)
                return
            known = timer
        elif known.key not in self._all.by_key and known.set_for is not None:  # as the program had it before
            self._all.add(known)
            return
        self._all.add(known)
        self._count(known, now)

    def cancel(self, event: Term) -> int:
        """Take the timers out whose events unify with a term; return how many there were."""
        found = self._all.unifying(event)
        for timer in found:
            self._all.remove(timer.key)
            self._left(timer)
        return len(found)

    def find(self, event: Term, when: Term) -> Optional[ProgramTimer]:
        """Return the timer of an event and a schedule, or None."""
        return self._all.by_key.get(term_key((TIMER, event, when)))

    # ---- ringing -------------------------------------------------------------------------------------

    def _present(self) -> int:
        """Return the instant from which a goal counts: of what rings and has called it, though time may jump further.

        Of goals of one jump only so many count so: one that sets itself again would go on for the whole of it.
        """
        clock = self._program.clock
        reached, ringing = clock.reached(), clock.ringing
        if ringing is None or reached - ringing <= SECOND:
            self._behind = 0
        else:
            self._behind += 1
        return reached if ringing is None or self._behind > MOST_AT_ONCE else ringing

    def _count(self, timer: ProgramTimer, now: int) -> None:
        """Have a timer ring when its schedule says, counted from now or from when there is a time."""
        timer.instant = timer.schedule.next(now) if now > 0 else None
        if now > 0 and timer.instant is None:
            self._all.remove(timer.key)
            self._left(timer)
            self._over(timer)
            return
        self._set_alarm(timer)

    def _set_alarm(self, timer: ProgramTimer) -> None:
        instant = BEGIN if timer.instant is None else timer.instant
        if timer.set_for is not None:
            if timer.set_for <= instant:
                return
            self._dead += 1
        timer.set_for = instant
        self._program.clock.call_at(instant, TimerAlarm(self, timer, instant))

    def _left(self, timer: ProgramTimer) -> None:
        """Forget the alarm of a timer that is gone."""
        if timer.set_for is None:
            return
        timer.set_for = None
        self._dead += 1
        clock = self._program.clock
        if 2 * self._dead > len(clock.alarms) + _SPARE:
            clock.drop(lambda alarm: isinstance(alarm, TimerAlarm) and not self.is_sound(alarm))
            self._dead = 0

    def is_sound(self, alarm: "TimerAlarm") -> bool:
        """Tell whether an alarm is the one of a timer that is set."""
        timer = alarm.timer
        there = self._all.by_key.get(timer.key) is timer or self._aside.get(timer.key) is timer
        return there and timer.set_for == alarm.set_for

    def ring(self, alarm: "TimerAlarm") -> None:
        """Do what is to be done when an alarm of a timer rings."""
        if not self.is_sound(alarm):
            self._dead -= 1
            return
        timer = alarm.timer
        timer.set_for = None
        instant = timer.instant
        if instant is None:
            self._count(timer, self._program.clock.reached())  # that there is a time has rung
        elif instant > alarm.set_for or self._skips(timer, instant):
            self._set_alarm(timer)
        else:
            if timer.schedule.repeats:
                timer.instant = instant + timer.schedule.period
                self._set_alarm(timer)
            else:
                self._all.remove(timer.key)
            self._dispatch(timer.event, WholeSeconds(instant))

    def _skips(self, timer: ProgramTimer, instant: int) -> bool:
        """Have a timer go on at the last of its instants that is over, where too many are; tell whether they are."""
        schedule = timer.schedule
        if not schedule.repeats:
            return False
        behind = (self._program.clock.coming() - instant) // schedule.period
        if behind < MOST_AT_ONCE:
            return False
        timer.instant = instant + behind * schedule.period
        self._jumps += 1
        self.left_out += behind
        if self._jumps & (self._jumps - 1) == 0:
            show = self._program.logic.brief
            seconds = behind * schedule.period // SECOND
            self._program.on_warning(
                UsageError(
                    f"time has gone on by {seconds} s at once: {counted(behind, 'event')} of timer "
                    f"{show(timer.event)}, {show(schedule.term)} left out; {self.left_out} of all timers so far"
                )
            )
        return True

    def _dispatch(self, event: Term, instant: int) -> None:
        dispatcher, machine = self._program.dispatcher, self._program.logic.machine
        dispatcher.apart(
            lambda: machine.run(dispatcher.dispatch(event, instant, instant, machine.done, own=False))
        )

    def _over(self, timer: ProgramTimer) -> None:
        show = self._program.logic.brief
        self._program.on_warning(
            UsageError(f"timer {show(timer.event)}, {show(timer.schedule.term)}: that instant is over")
        )

    # ---- from outside --------------------------------------------------------------------------------

    def clear(self) -> None:
        """Drop all."""
        for timer in self:
            self._all.remove(timer.key)
            self._left(timer)

    def start_anew(self) -> None:
        """Go on from the present: time went back, and the clock has dropped its alarms.

        Those that wait for so many seconds are dropped, as alarms are: nothing of before is waited for.
        """
        self._dead = 0
        for timer in self:
            timer.set_for = None
            if timer.schedule.is_relative:
                self._all.remove(timer.key)
            else:
                self._count(timer, self._program.clock.reached())

    def mend(self) -> None:
        """Have each timer have its alarm, after an interrupt."""
        self._all = TimerTable(self)
        alarms = {
            alarm.timer: alarm
            for _, _, alarm in self._program.clock.alarms
            if isinstance(alarm, TimerAlarm) and self.is_sound(alarm)
        }
        for timer in self:
            if timer not in alarms:
                timer.set_for = None
                self._set_alarm(timer)

    def standing(self) -> Dict[Hashable, ProgramTimer]:
        """Return those that are set, by their keys."""
        return dict(self._all.by_key)

    def set_aside(self, timers: Mapping[Hashable, ProgramTimer]) -> None:
        """Take timers out; those that are set again as they were go on."""
        for key in timers:
            self._aside[key] = self._all.remove(key)

    def forget_aside(self) -> None:
        """Forget what was set aside."""
        gone, self._aside = list(self._aside.values()), {}
        for timer in gone:
            self._left(timer)

    def restore_standing(self, timers: Mapping[Hashable, ProgramTimer]) -> None:
        """Have these timers, which have been set aside meanwhile or not, and no others."""
        gone = [timer for timer in self if timers.get(timer.key) is not timer]
        self._all, self._aside = TimerTable(timers.values()), {}
        for timer in gone:
            self._left(timer)
        self.mend()

    def kept(self) -> List[KeptTimer]:
        """Return all as data; see `restore`."""
        return [
            (alarm.timer.event, alarm.timer.schedule.term, alarm.timer.instant, alarm.set_for, order)
            for _, order, alarm in sorted(self._program.clock.alarms, key=lambda one: one[:2])
            if isinstance(alarm, TimerAlarm) and self.is_sound(alarm)
        ]

    def restore(self, kept: Sequence[KeptTimer], left_out: int) -> None:
        """Have the timers that another one had, with their alarms."""
        self.left_out = left_out
        for event, when, instant, set_for, order in kept:
            timer = ProgramTimer(event, schedule_of(when))
            timer.instant, timer.set_for = instant, set_for
            self._all.add(timer)
            self._program.clock.put_back(set_for, order, TimerAlarm(self, timer, set_for))


class TimerAlarm:
    """The alarm of a timer in the clock.

    Args:
        timers: all of the program.
        timer: whose it is.
        set_for: the instant at which it rings.
    """

    __slots__ = ("timers", "timer", "set_for")

    def __init__(self, timers: Timers, timer: ProgramTimer, set_for: int):
        self.timers = timers
        self.timer = timer
        self.set_for = set_for

    def __call__(self, now: int) -> None:
        """Ring."""
        self.timers.ring(self)
