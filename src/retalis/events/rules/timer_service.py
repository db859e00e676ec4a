"""The clock, as rules know it.

When nodes are to be woken: one alarm of the clock for all of them, at the earliest of their instants.

Alarms that rules have set: events that fire when an instant has come.

Timers that a program has set: events at instants that the clock reaches, once or again and again.

The goals that set timers, cancel and list them: ``timer/2``, ``cancel_timer/1,2``, ``timers/1``.
"""

import heapq
from itertools import count
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
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

from ...foundation.errors import UsageError, counted
from ...prolog.builtins.argument_checks import callable_of
from ...prolog.machine.errors import domain_error, instantiation_error, resource_error
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import make_list
from ...prolog.terms.term_traversal import copy, freeze, term_key
from ...prolog.terms.timestamps import SECOND, WholeSeconds, shown
from ...prolog.terms.types import Term, Var, atom, deref, functor
from ...prolog.terms.unification import may_unify
from ..dispatch.dispatcher import Dispatcher
from ..language.rule_parser import TIMER, Schedule, schedule_of
from ..network.goal_evaluation import TimedNode
from ..provenance.event_log import Occurrence

if TYPE_CHECKING:
    from ..network.event_rule import EventRule


class Timing(Protocol):
    """A clock with alarms.

    Attributes:
        ringing: the instant of the alarm that is being called; None between alarms.
    """

    ringing: Optional[int]

    @property
    def alarms(self) -> List[Tuple[int, int, Any]]:
        """Those that are set: when, in which order, and what is called."""

    def now(self) -> int:
        """Return the present instant."""

    def stamp(self) -> int:
        """Return the present instant, later than all that were returned before."""

    def call_at(self, instant: int, alarm: Callable[[int], None], /) -> None:
        """Have a function called when an instant has come."""

    def put_back(self, instant: int, order: int, alarm: Callable[[int], None], /) -> None:
        """Set an alarm that another clock had."""

    def drop(self, is_dead: Callable[[Any], bool], /) -> None:
        """Take alarms out that are not to be called any more."""

    def reached(self) -> int:
        """Return the instant up to which alarms are due; 0 where there is no time yet."""

    def coming(self) -> int:
        """Return the instant up to which time is being moved, maybe in several steps."""


_SMALL_QUEUE = 64
_BEFORE_ALL = -1
"""The order of its alarm among those of the same instant."""

_Deadline = Tuple[int, int, int, int, TimedNode]
"""An instant, which rule and which of its nodes, the order in which it was asked for, and the node."""


class NodeTimers:
    """The instants for which nodes have asked.

    At one instant the nodes of older rules ring first, and of one rule those that stand further right or below. Each
    rings by itself: where the limits of one are met, or its goals raise an error, the others ring all the same.

    Args:
        rules: of the program.
    """

    def __init__(self, rules: Any):
        self._rules = rules
        self._heap: List[_Deadline] = []
        self._numbers = count()
        self._most = _SMALL_QUEUE
        self._armed: List[int] = []

    def clear(self) -> None:
        """Forget all: the clock has begun anew, without the alarm that was set."""
        self._heap = []
        self._armed = []

    def __len__(self) -> int:
        """Return how many instants are remembered, those that nobody asks for any more included.

        They are never more than twice as many as nodes wait, and some.
        """
        return len(self._heap)

    def add(self, node: TimedNode, instant: int) -> None:
        """Have a node ring at an instant."""
        heapq.heappush(self._heap, (instant, node.rule.serial, node.place, next(self._numbers), node))
        if len(self._heap) > self._most:
            self._drop_all_not_wanted()
        self._arm()

    def _arm(self) -> None:
        """Have the clock call at the earliest instant, before all alarms that are set for it.

        An alarm that was set for a later one stays and is not set again.
        """
        self._drop_those_not_wanted()
        heap, armed = self._heap, self._armed
        if heap and (not armed or heap[0][0] < armed[0]):
            heapq.heappush(armed, heap[0][0])
            self._rules.clock.put_back(heap[0][0], _BEFORE_ALL, self._ring)

    def _drop_those_not_wanted(self) -> None:
        """Drop from the top what its node, or nobody any more, asks for: it wants to be woken earlier by now."""
        heap = self._heap
        while heap and not _is_wanted(heap[0]):
            heapq.heappop(heap)

    def _drop_all_not_wanted(self) -> None:
        """Drop all that no node asks for, or asks for once more."""
        wanted = {id(entry[-1]): entry for entry in self._heap if _is_wanted(entry)}
        self._heap = list(wanted.values())
        heapq.heapify(self._heap)
        self._most = 2 * len(self._heap) + _SMALL_QUEUE

    def _ring(self, instant: int) -> None:
        """Have the first node ring that is due, and set the next alarm."""
        while self._armed and self._armed[0] <= instant:
            heapq.heappop(self._armed)
        self._drop_those_not_wanted()
        heap = self._heap
        try:
            if heap and heap[0][0] <= instant:
                at, *_, node = heapq.heappop(heap)
                node.woken = None
                if node.rule.active:  # else it is woken anew where its rule is connected again
                    machine = self._rules.logic.machine
                    self._rules.dispatcher.apart(lambda: machine.run(node.ring(at, machine.done)))
        finally:
            self._arm()


def _is_wanted(entry: _Deadline) -> bool:
    return entry[-1].woken == entry[0]


class RuleAlarm:
    """An event of a rule that is to fire, called by the clock when its instant has come.

    Args:
        rules: of the program.
        rule: the one that has set the alarm.
        term: the event.
        start: where its interval starts.
        instant: when it fires, where the interval ends.
        token: of the event, where it is kept what events came from.
    """

    __slots__ = ("rules", "rule", "term", "start", "instant", "token")

    def __init__(
        self,
        rules: Any,
        rule: "EventRule",
        term: Term,
        start: int,
        instant: int,
        token: Optional[Occurrence],
    ):
        self.rules = rules
        self.rule = rule
        self.term = term
        self.start = start
        self.instant = instant
        self.token = token

    def __call__(self, now: int) -> None:
        """Fire the event, unless what it came from was taken back meanwhile."""
        token = self.token
        if token is not None:
            if token.gone:
                return
            token.term, token.start, token.end = self.term, self.start, self.instant
        machine = self.rules.logic.machine
        fire = self.rule.fire
        self.rules.dispatcher.apart(
            lambda: machine.run(fire(self.term, self.start, self.instant, machine.done, token))
        )


MAX_TIMERS = 10_000
"""Timers that may be set at once."""

MAX_RINGS_PER_JUMP = 10_000
"""How many times one timer rings for a jump of time; of more only the last is made up for."""

BEGIN = 1
"""The instant of the alarm that waits for there to be a time."""

_SPARE = 16

KeptTimer = Tuple[Term, Term, Optional[int], int, int]
"""Event, schedule, the instant at which it rings, and the alarm's in the clock with its order."""


class TimedProgram(Protocol):
    """All rules of a program, as its timers see them."""

    @property
    def logic(self) -> PrologSystem:
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
            if len(self) >= MAX_TIMERS:
                raise resource_error("timers", reason=f"more than {MAX_TIMERS} timers are set")
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
        return reached if ringing is None or self._behind > MAX_RINGS_PER_JUMP else ringing

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
        if behind < MAX_RINGS_PER_JUMP:
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


_LISTED = functor("timer", 3)
_WAITS = atom("waits")


def define_timers(logic: PrologSystem, timers: Timers, require: Callable[[Term], None]) -> None:
    """Define the goals of timers; ``require`` raises an error for an event that is declared otherwise."""
    _TimerGoals(timers, require).define(logic)


class _TimerGoals:
    """Goals of timers."""

    def __init__(self, timers: Timers, require: Callable[[Term], None]):
        self.timers = timers
        self.require = require

    def define(self, logic: PrologSystem) -> None:
        logic.define("timer", 2, self.set)
        logic.define("cancel_timer", 1, self.cancel)
        logic.define("cancel_timer", 2, self.cancel_counting)
        logic.define("timers", 1, self.list)

    def set(self, machine: Machine, event: Term, when: Term) -> bool:
        event, when = callable_of(event), deref(when)
        if when.__class__ is Var:
            raise instantiation_error()
        self.require(event)
        try:
            self.timers.set(event, when)
        except UsageError as error:
            raise domain_error("timer", when, error.message) from None
        return True

    def cancel(self, machine: Machine, event: Term) -> bool:
        self.timers.cancel(deref(event))
        return True

    def cancel_counting(self, machine: Machine, event: Term, number: Term) -> bool:
        return bool(machine.unify(number, self.timers.cancel(deref(event))))

    def list(self, machine: Machine, found: Term) -> bool:
        rows: List[Any] = []
        for timer in self.timers:
            instant = _WAITS if timer.instant is None else shown(WholeSeconds(timer.instant))
            rows.append((_LISTED, copy(timer.event), copy(timer.schedule.term), instant))
        return bool(machine.unify(found, make_list(rows)))
