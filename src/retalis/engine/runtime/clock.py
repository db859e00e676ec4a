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
from typing import Callable, List, Optional, Sequence, Tuple

from ...prolog.terms.timestamps import SECOND

Alarm = Callable[[int], None]

JUMP = SECOND
"""Minimum step back in ns that starts a new clock epoch, for example when a bag is played again."""


MAX_STEP = 30 * 86_400 * SECOND
"""Step in ns beyond which the timestamp of a single event does not advance a `StreamClock`: thirty days."""

MAX_OFFSET_CHANGE = 60 * SECOND
"""Largest change in ns of the distance between two timestamps far ahead and the clock at which they agree."""

MIN_AGREEING_STAMPS = 3
"""Number of agreeing timestamps far ahead that advance the clock although other events follow the present time."""


class Clock:
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

    is_set = True

    def __init__(self, source: Callable[[], int] = time.time_ns):
        self._source = source
        self._last_stamp = -1
        self._newest = 0
        self.behind = False
        self.ringing: Optional[int] = None
        self.alarms: List[Tuple[int, int, Alarm]] = []
        self._order = count()

    def snapshot(self) -> List[int]:
        """Return the state of the clock without its source and its alarms; see `restore`.

        >>> Clock(lambda: 5_000_000_000).snapshot()
        [-1, 0, 0, 0]
        """
        # `count` has no way to read its next value without taking it.
        order = next(self._order)
        self._order = count(order)
        return [self._last_stamp, self._newest, int(self.behind), order]

    def restore(self, saved: Sequence[int]) -> None:
        """Restore the state of another clock; later alarms come after those that are set again with their old order.

        >>> clock, other = StreamClock(7), StreamClock()
        >>> other.restore(clock.snapshot())
        >>> other.now()
        7
        """
        self._last_stamp, self._newest, behind, order = saved[:4]
        self.behind = bool(behind)
        self._order = count(order)

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

    If the clock follows events (`follow`), a single timestamp far ahead (`MAX_STEP`) does not advance it: it may be
    an error. Another event near it confirms it, if it is the next one, or if several of them have a constant distance
    from the clock, as those of a computer with another date. A first timestamp that is far ahead of the second one
    is given up.

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
    """

    def __init__(self, start: Optional[int] = None):
        self.is_set = start is not None
        self._time = start or 0
        self._heading = self._time
        self._pinned: Optional[int] = None
        # A time that the owner has given is not given up as a first timestamp may be.
        self._followed_count = 0 if start is None else 2
        self._far_stamp: Optional[int] = None
        self._far_offset = 0
        self._agreeing_count = 0
        self._fast_limit = -1 if start is None else start + MAX_STEP
        """Latest timestamp that `follow` accepts; -1 if each one must be checked."""
        super().__init__(self._present)

    def _present(self) -> int:
        return self._time if self._pinned is None else self._pinned

    def snapshot(self) -> List[int]:
        """Return the state of the clock; see `Clock.snapshot`.

        >>> StreamClock(7).snapshot()
        [-1, 0, 0, 0, 7]
        """
        if not self.is_set:
            return super().snapshot()
        return [*super().snapshot(), self._time, *([] if self._pinned is None else [self._pinned])]

    def restore(self, saved: Sequence[int]) -> None:
        """Restore the state of another clock; see `Clock.restore`.

        >>> clock, other = StreamClock(7), StreamClock()
        >>> other.restore(clock.snapshot())
        >>> other.now()
        7
        """
        super().restore(saved)
        if len(saved) > 4:
            self._time, self.is_set = saved[4], True
            # Several events may have moved the other clock, so its time is not given up.
            self._followed_count = 2
        if len(saved) > 5:
            self._pinned = saved[5]

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

    def follow(self, instant: int) -> bool:
        """Move to the timestamp of an event if no alarm is due and time did not go back; return whether it has moved.

        >>> clock = StreamClock()
        >>> clock.follow_checked(500_000_000), clock.follow_checked(500_000_000)
        (True, True)
        >>> clock.follow(1_000_000_000), clock.now()
        (True, 1000000000)
        >>> clock.call_at(2_000_000_000, print)
        >>> clock.follow(3_000_000_000), clock.now()
        (False, 1000000000)
        """
        # The common case of each event, so the tests of `now`, `move_to` and `due` are combined here.
        time = self._time
        if time < self._newest or self.behind or self._pinned is not None or instant > self._fast_limit:
            return False
        if instant > time:
            time = instant if instant.__class__ is int else int(instant)
        if self.alarms and self.alarms[0][0] <= time:
            return False
        self._time = self._newest = time
        self.is_set = True
        return True

    def follow_checked(self, instant: int) -> bool:
        """Move to the timestamp of an event unless it is far ahead and not confirmed; return whether it is not.

        Time goes back if the first timestamp is given up; see `went_back`.

        >>> clock = StreamClock(0)
        >>> clock.follow_checked(10**18), clock.now(), clock.follow_checked(10**18), clock.now()
        (False, 0, True, 1000000000000000000)
        """
        step = instant - self._time
        if step > MAX_STEP and self._followed_count and not self._confirms(instant, step):
            # The next event decides whether this one was alone.
            self._fast_limit = -1
            return False
        self._followed_count += 1
        # The second event shows that the first one, which has set the clock, was far ahead.
        self.move_to(instant, back=self._followed_count == 2 and step < -MAX_STEP)
        if step > MAX_STEP:
            self._agreeing_count = 0
        self._far_stamp = None
        if self._followed_count > 1:
            self._fast_limit = self._time + MAX_STEP
        return True

    def _confirms(self, instant: int, step: int) -> bool:
        """Record a timestamp far ahead; return whether earlier ones confirm it."""
        is_next = self._far_stamp is not None and abs(instant - self._far_stamp) <= MAX_STEP
        is_constant = abs(step - self._far_offset) <= MAX_OFFSET_CHANGE
        self._agreeing_count = self._agreeing_count + 1 if is_constant else 1
        self._far_stamp, self._far_offset = instant, step
        return is_next or self._agreeing_count >= MIN_AGREEING_STAMPS

    def move_by(self, nanoseconds: int) -> None:
        """Advance the stream's time by a duration.

        >>> clock = StreamClock(1_000_000_000)
        >>> clock.move_by(500)
        >>> clock.now()
        1000000500
        """
        self.is_set = True
        self._time += nanoseconds

    def head_for(self, instant: int) -> None:
        """Announce the instant to which the stream's time is being moved, for a move in several steps.

        >>> clock = StreamClock(1_000_000_000)
        >>> clock.head_for(2_000_000_000)
        >>> clock.reached(), clock.coming()
        (1000000000, 2000000000)
        """
        self._heading = instant

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
