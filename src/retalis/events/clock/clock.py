"""Clocks: present time, monotonic timestamps, alarms, and detection of time jumps.

A `Clock` reads a source of time, for example the computer's clock or ROS time. A `StreamClock` is event time: it
stands still until it is moved by the timestamps of events or by a bag player. Alarms are stored in a binary heap,
ordered by instant and then by order of setting; the engine asks for those that are due before each event.

Timestamps that a clock assigns increase strictly, so that events which arrive within the resolution of the source are
still ordered. If the source goes back by more than `JUMP`, a new clock epoch begins: alarms are dropped, and the
engine clears all state that depends on time. Smaller steps back, as by NTP corrections, are ignored.
"""

import heapq
import time
from itertools import count
from typing import Callable, List, Optional, Tuple

from ...prolog.terms.timestamps import SECOND
from ...serialization.state_fields import NextNumber, StateFields, StateOwner, field
from ...serialization.stored_field_types import BOOLEAN, CLOCK_INSTANT, COUNT, optional
from .stamp_jumps import MAX_STEP, EventName, JumpDecision, StampJumps

Alarm = Callable[[int], None]

JUMP = SECOND
"""Minimum step back in ns that starts a new clock epoch, for example when a bag is played again."""


class Clock(StateOwner):
    """A clock with alarms over a source of time.

    The clock has no thread: its owner calls `due` whenever time may have passed.

    >>> engine = Engine(Clock(lambda: 5_000_000_000))
    >>> engine.on_event(lambda term, start, end: print(engine.show(term), start))
    >>> engine.event("tick")
    tick 5000000000

    Args:
        source: returns the present time in ns since the epoch; by default the computer's clock.

    Attributes:
        is_set: whether the clock has a time.
        alarms: heap of alarms: instant, order, function.
        ringing: instant of the alarm that is being called; None between alarms.
        behind: whether a step back was detected and `went_back` has not been called since.
    """

    STATE = StateFields(
        field("_last_stamp", CLOCK_INSTANT),
        field("_newest", CLOCK_INSTANT),
        field("behind", BOOLEAN),
        field("next_order", COUNT),
        field("stream_time", optional(CLOCK_INSTANT)),
        field("pinned_time", optional(CLOCK_INSTANT)),
    )

    is_set = True

    def __init__(self, source: Callable[[], int] = time.time_ns):
        self._source = source
        self._last_stamp = -1
        self._newest = 0
        self.behind = False
        self.ringing: Optional[int] = None
        self.alarms: List[Tuple[int, int, Alarm]] = []
        self._order = count()

    def ring(self, instant: int, call_alarm: Callable[[], object]) -> None:
        """Call the alarm of an instant, which is `ringing` meanwhile.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.ring(4_000_000_000, lambda: print(clock.ringing))
        4000000000
        """
        self.ringing = instant
        try:
            call_alarm()
        finally:
            self.ringing = None

    next_order = NextNumber(
        "_order",
        """Order of the next alarm; later alarms come after those that are set again with their old order.

        >>> clock = Clock()
        >>> clock.call_at(2_000_000_000, print)
        >>> clock.next_order
        1
        """,
    )

    @property
    def stream_time(self) -> Optional[int]:
        """None: the time of this clock comes from its source.

        >>> Clock().stream_time is None
        True
        """
        return None

    @stream_time.setter
    def stream_time(self, time: Optional[int]) -> None:
        """Ignore the time of another clock."""

    @property
    def pinned_time(self) -> Optional[int]:
        """None: the time of this clock comes from its source.

        >>> Clock().pinned_time is None
        True
        """
        return None

    @pinned_time.setter
    def pinned_time(self, time: Optional[int]) -> None:
        """Ignore the time of another clock."""

    def now(self) -> int:
        """Return the present time, and detect a step back by more than `JUMP`.

        >>> Clock(lambda: 5_000_000_000).now()
        5000000000
        """
        instant = self._source()
        if instant >= self._newest:
            self._newest = instant
        # A smaller step back is a correction of the clock and no new epoch: the newest time stays.
        elif instant < self._newest - JUMP:
            self._newest = instant
            self.behind = True
        return instant

    def present(self) -> int:
        """Return the present time without detecting steps back; may be called from any thread.

        >>> Clock(lambda: 5_000_000_000).present()
        5000000000
        """
        return self._source()

    def stamp(self, now: Optional[int] = None) -> int:
        """Return the present time as a timestamp, increased if necessary to be later than all earlier timestamps.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.stamp(), clock.stamp()
        (5000000000, 5000000001)
        """
        instant = self.now() if now is None else now
        if instant <= self._last_stamp:
            instant = self._last_stamp + 1
        self._last_stamp = instant
        return instant

    def stamp_at_once(self) -> Optional[int]:
        """Return a timestamp for the present time; None if the clock is not set or must be processed first.

        It must be processed first if an alarm is due or time went back.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.call_at(6_000_000_000, print)
        >>> clock.stamp_at_once()
        5000000000
        >>> clock.call_at(4_000_000_000, print)
        >>> clock.stamp_at_once()
        """
        instant = self._source()
        # The same test as in `is_quiet`, repeated because the call would take 2 % of a short event.
        if (
            instant < self._newest
            or self.behind
            or not self.is_set
            or self.alarms
            and self.alarms[0][0] <= self._due_by(instant)
        ):
            return None
        self._newest = instant
        if instant <= self._last_stamp:
            instant = self._last_stamp + 1
        self._last_stamp = instant
        return instant

    def is_quiet(self) -> bool:
        """Read the source; return whether no alarm is due and time has not gone back.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.is_quiet()
        True
        >>> clock.call_at(4_000_000_000, print)
        >>> clock.is_quiet()
        False
        """
        instant = self._source()
        if (
            instant < self._newest
            or self.behind
            or self.alarms
            and self.alarms[0][0] <= self._due_by(instant)
        ):
            return False
        self._newest = instant
        return True

    def _due_by(self, instant: int) -> int:
        """Return the instant up to which alarms are due; as `reached`, given a reading of the source."""
        return instant

    def call_at(self, instant: int, alarm: Alarm) -> None:
        """Call a function with ``instant`` when the clock reaches it.

        >>> clock = StreamClock()
        >>> clock.call_at(2_000_000_000, lambda instant: print("alarm at", instant))
        >>> clock.move_to(3_000_000_000)
        >>> Engine(clock).advance()
        alarm at 2000000000
        """
        heapq.heappush(self.alarms, (instant, next(self._order), alarm))

    def put_back(self, instant: int, order: int, alarm: Alarm) -> None:
        """Set an alarm of another clock with its order among alarms of the same instant.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.put_back(6_000_000_000, 2, print)
        >>> clock.next_alarm()
        6000000000
        """
        heapq.heappush(self.alarms, (instant, order, alarm))

    def next_alarm(self) -> Optional[int]:
        """Return the instant of the next alarm, or None.

        >>> clock = Clock()
        >>> clock.call_at(2_000_000_000, print)
        >>> clock.next_alarm()
        2000000000
        """
        # Sliced in one step of the interpreter, because the engine's thread may remove the alarm meanwhile.
        first = self.alarms[:1]
        return first[0][0] if first else None

    def due(self, until: Optional[int] = None) -> Optional[Tuple[int, Alarm]]:
        """Remove and return the next alarm that is due now or at ``until``; None if none is due.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.call_at(2_000_000_000, print)
        >>> instant, alarm = clock.due()
        >>> instant, clock.due()
        (2000000000, None)
        """
        if not self.alarms:
            return None
        if self.alarms[0][0] > (self.now() if until is None else until):
            return None
        instant, _, alarm = heapq.heappop(self.alarms)
        return instant, alarm

    def drop(self, is_dead: Callable[[Alarm], bool]) -> None:
        """Remove the alarms for which a function returns true.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.call_at(6_000_000_000, print)
        >>> clock.drop(lambda alarm: alarm is print)
        >>> clock.alarms
        []
        """
        # In place, because `alarms` is public and callers may hold a reference to the list.
        self.alarms[:] = [entry for entry in self.alarms if not is_dead(entry[2])]
        heapq.heapify(self.alarms)

    def reached(self) -> int:
        """Return the instant up to which alarms are due.

        >>> Clock(lambda: 5_000_000_000).reached()
        5000000000
        """
        return self.now()

    def coming(self) -> int:
        """Return the instant to which time is being moved; later than `reached` during a move in several steps.

        >>> Clock(lambda: 5_000_000_000).coming()
        5000000000
        """
        return self.reached()

    def went_back(self) -> bool:
        """Return whether time has gone back by more than `JUMP` since the last call; reset the clock if so.

        >>> times = [5_000_000_000, 1_000_000_000, 1_000_000_000]
        >>> clock = Clock(lambda: times.pop(0))
        >>> clock.now(), clock.went_back()
        (5000000000, True)
        """
        self.now()
        if not self.behind:
            return False
        self.reset()
        return True

    def reset(self) -> None:
        """Drop the alarms and the last timestamp.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.call_at(6_000_000_000, print)
        >>> clock.reset()
        >>> clock.alarms
        []
        """
        self.alarms.clear()
        self._last_stamp = -1
        self.behind = False


class StreamClock(Clock):
    """A clock that stands still until it is moved: the time of a stream of events or of a bag.

    If the clock follows events (`follow`), a timestamp ahead of the others may be an error, after which the clock
    returns; see `stamp_jumps`.

    A pinned clock always returns the same time, but its alarms follow the stream's time. A clock without a start that
    was neither moved nor pinned is not set, and has no time for events without timestamps.

    >>> clock = StreamClock()
    >>> engine = Engine(clock)
    >>> engine.load(rules="exceptionAlarm(late, 5) <- start.")
    >>> engine.on_event(lambda term, start, end: print(engine.show(term), end))
    >>> engine.event("start", 1)
    start 1000000000
    >>> clock.move_to(10_000_000_000)
    >>> engine.advance()
    late 6000000000

    Args:
        start: first time in ns; None if the clock is not set.
        follows_events: whether an engine moves the clock to the timestamps of events; otherwise only its owner moves
            it.

    Attributes:
        follows_events: as the argument.
        jumps: checks of timestamps ahead of the clock.
    """

    def __init__(self, start: Optional[int] = None, follows_events: bool = False):
        self.follows_events = follows_events
        self.jumps = StampJumps()
        self.is_set = start is not None
        self._time = start or 0
        self._heading = self._time
        self._pinned: Optional[int] = None
        self._fast_limit = -1
        """Latest timestamp that `follow` accepts without `StampJumps.check`."""
        self._is_on_trial = True
        """True if a step of the clock may be an error, so that `follow` must not accept all times."""
        super().__init__(self._present)

    def _present(self) -> int:
        return self._time if self._pinned is None else self._pinned

    @property
    def stream_time(self) -> Optional[int]:
        """The time of the stream in ns; None before it is set.

        >>> clock, other = StreamClock(7), StreamClock()
        >>> other.restore(clock.snapshot())
        >>> other.now()
        7
        """
        return self._time if self.is_set else None

    @stream_time.setter
    def stream_time(self, time: Optional[int]) -> None:
        if time is not None:
            self._time, self.is_set = time, True

    @property
    def pinned_time(self) -> Optional[int]:
        """The constant time of the clock in ns, if it is pinned.

        >>> clock = StreamClock(7)
        >>> clock.pin(1_000_000_000)
        >>> clock.pinned_time
        1000000000
        """
        return self._pinned if self.is_set else None

    @pinned_time.setter
    def pinned_time(self, time: Optional[int]) -> None:
        if time is not None:
            self._pinned = time

    def pin(self, instant: int) -> None:
        """Make the clock return a constant time, independent of the stream's time.

        Timestamps that it assigns are later than that time, with steps of 1 ns.

        >>> clock = StreamClock()
        >>> clock.pin(1_000_000_000)
        >>> clock.move_to(2_000_000_000)
        >>> clock.now()
        1000000000
        """
        self.is_set = True
        # `_last_stamp` makes the next timestamp one nanosecond later than the pinned time.
        self._pinned = int(instant)
        self.jumps.forget_time()
        self._last_stamp = max(self._last_stamp, self._pinned)
        self._time = max(self._time, self._pinned)

    def move_to(self, instant: int, back: bool = False) -> None:
        """Move the stream's time forward; with ``back`` also backward.

        >>> clock = StreamClock(1_000_000_000)
        >>> clock.move_to(500_000_000)
        >>> clock.now()
        1000000000
        >>> clock.move_to(500_000_000, back=True)
        >>> clock.now()
        500000000
        """
        self.is_set = True
        if back or instant > self._time:
            self._time = int(instant)
            self._end_trial()

    def follow(self, instant: int) -> bool:
        """Move to the timestamp of an event if no alarm is due and time did not go back; return whether it has moved.

        >>> clock = StreamClock(1)
        >>> clock.follow(1_000_000_000), clock.follow_checked(1_000_000_000, "a"), clock.follow(1_500_000_000)
        (False, <JumpDecision.FOLLOWED: 1>, True)
        >>> clock.call_at(2_000_000_000, print)
        >>> clock.follow(3_000_000_000), clock.now()
        (False, 1500000000)
        """
        # The common case of each event, so the tests of `now`, `move_to` and `due` are combined here.
        time = self._time
        if time < self._newest or self.behind or self._pinned is not None:
            return False
        if instant > self._fast_limit:
            # The limit is a former time of the clock plus the largest step.
            if self._is_on_trial or instant > time + MAX_STEP:
                return False
            self._fast_limit = time + MAX_STEP
        if instant > time:
            time = instant if instant.__class__ is int else int(instant)
        # It may show that the time that is on trial is wrong.
        elif self._is_on_trial and instant < time:
            return False
        if self.alarms and self.alarms[0][0] <= time:
            return False
        self._time = self._newest = time
        self.is_set = True
        return True

    def follow_checked(self, instant: int, source: EventName) -> JumpDecision:
        """Process the timestamp of an event: move the clock to it, leave the clock, or return from an error.

        Args:
            instant: the timestamp in ns.
            source: name of the event; see `StampJumps.check`.

        >>> clock = StreamClock()
        >>> for second in (1, 4000, 2, 3, 4):
        ...     decision = clock.follow_checked(second * 10**9, "a")
        >>> decision, clock.now()
        (<JumpDecision.RETURNED: 3>, 4000000000)
        """
        self.is_set = True
        decision, time = self.jumps.check(int(instant), self._time, source)
        if decision is JumpDecision.RETURNED:
            self._return_to(time)
        elif time > self._time:
            self._time = time
        self._is_on_trial = self.jumps.is_on_trial
        self._fast_limit = self.jumps.unchecked_limit() if self._is_on_trial else self._time + MAX_STEP
        return decision

    def _return_to(self, instant: int) -> None:
        """Set the clock back after an error, which begins no new epoch; alarms that have been called stay called."""
        self._time = instant
        self._heading = min(self._heading, instant)
        # The time of a pinned clock, and the timestamps that it assigns, do not depend on events.
        if self._pinned is None:
            self._newest = instant
            self._last_stamp = min(self._last_stamp, instant)

    def _end_trial(self) -> None:
        """Stop checking the last step of a timestamp, because the owner has moved the clock."""
        if self.jumps.is_on_trial:
            self.jumps.end_trials()
            self._is_on_trial = False

    def move_by(self, nanoseconds: int) -> None:
        """Advance the stream's time by a duration.

        >>> clock = StreamClock(1_000_000_000)
        >>> clock.move_by(500)
        >>> clock.now()
        1000000500
        """
        self.is_set = True
        self._time += nanoseconds
        self._end_trial()

    def head_for(self, instant: int) -> None:
        """Announce the instant to which the stream's time is being moved, for a move in several steps.

        >>> clock = StreamClock(1_000_000_000)
        >>> clock.head_for(2_000_000_000)
        >>> clock.reached(), clock.coming()
        (1000000000, 2000000000)
        """
        self._heading = instant

    def fire_alarms(
        self, limit: int, run_due: Callable[[], object], must_stop: Callable[[], bool] = lambda: False
    ) -> None:
        """Move the stream's time to each alarm up to a limit, so that it fires at its own time.

        >>> clock = StreamClock()
        >>> clock.call_at(1_000_000_000, lambda instant: print(instant))
        >>> engine = Engine(clock)
        >>> clock.fire_alarms(2_000_000_000, engine.advance)
        1000000000
        >>> clock.reached()
        1000000000

        Args:
            limit: time in nanoseconds to which the clock is going to be moved.
            run_due: runs the alarms that are due, as `Engine.advance` does.
            must_stop: returns whether later alarms have to wait; called after each alarm.
        """
        self.head_for(limit)
        alarm = self.next_alarm()
        while alarm is not None and alarm <= limit and not must_stop():
            self.move_to(alarm)
            run_due()
            alarm = self.next_alarm()

    def _due_by(self, instant: int) -> int:
        # The stream's time, also if the clock is pinned.
        return self._time

    def reached(self) -> int:
        """Return the instant up to which alarms are due: the stream's time, also if the clock is pinned.

        >>> StreamClock(1_000_000_000).reached()
        1000000000
        """
        return self._time

    def coming(self) -> int:
        """Return the instant to which time is being moved; see `head_for`.

        >>> StreamClock(1_000_000_000).coming()
        1000000000
        """
        return max(self._time, self._heading)

    def due(self, until: Optional[int] = None) -> Optional[Tuple[int, Alarm]]:
        """Remove and return the next alarm that is due by the stream's time.

        >>> clock = StreamClock()
        >>> clock.call_at(2_000_000_000, print)
        >>> clock.due() is None, clock.due(until=2_000_000_000)[0]
        (True, 2000000000)
        """
        return super().due(self._time if until is None else until)
