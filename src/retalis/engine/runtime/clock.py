"""What time it is for a program: rising stamps, alarms, and noticing that time went back."""

import heapq
import time
from itertools import count
from typing import Callable, List, Optional, Sequence, Tuple

from ...prolog.terms.timestamps import SECOND, WholeSeconds

Alarm = Callable[[int], None]

JUMP = SECOND
"""A clock that goes back by more than this (a looped bag) starts a new run."""


class Clock:
    """A clock over some source of time, with alarms.

    Nothing here waits: whoever owns the clock asks `due` for alarms when time may have passed.

    >>> engine = Engine(Clock(lambda: 5_000_000_000))
    >>> engine.on_event(lambda term, start, end: print(engine.show(term), start))
    >>> engine.event("tick")
    tick 5000000000

    Args:
        source: returns the present instant (ns since the epoch); the system's clock by default.

    Attributes:
        is_set: whether it has a time.
        alarms: a heap of those that are set.
        ringing: the instant of the alarm that is being called; None between alarms.
        behind: whether time was seen to go back, and nobody has asked `went_back` since.
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

    def kept(self) -> List[int]:
        """Return what it knows beside its source and its alarms; see `restore`.

        >>> Clock(lambda: 5_000_000_000).kept()
        [-1, 0, 0, 0]
        """
        order = next(self._order)
        self._order = count(order)
        return [self._last_stamp, self._newest, int(self.behind), order]

    def restore(self, kept: Sequence[int]) -> None:
        """Know what another clock knew; an order given to alarms again is none of those before.

        >>> clock, other = StreamClock(7), StreamClock()
        >>> other.restore(clock.kept())
        >>> other.now()
        7
        """
        self._last_stamp, self._newest, behind, order = kept[:4]
        self.behind = bool(behind)
        self._order = count(order)

    def now(self) -> int:
        """Return the present instant, and notice where time went back by more than `JUMP`.

        >>> Clock(lambda: 5_000_000_000).now()
        5000000000
        """
        instant = self._source()
        if instant >= self._newest:
            self._newest = instant
        elif instant < self._newest - JUMP:
            self._newest = instant
            self.behind = True
        return instant

    def present(self) -> int:
        """Return the present instant and notice nothing: for those who look from another thread.

        >>> Clock(lambda: 5_000_000_000).present()
        5000000000
        """
        return self._source()

    def stamp(self, now: Optional[int] = None) -> int:
        """Return an instant for an event: now, but always after the last one given out.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.stamp(), clock.stamp()
        (5000000000, 5000000001)
        """
        instant = self.now() if now is None else now
        if instant <= self._last_stamp:
            instant = self._last_stamp + 1
        self._last_stamp = instant
        return WholeSeconds(instant)

    def stamp_at_once(self) -> Optional[int]:
        """Return `stamp` of now; None if the clock is not set, or alarms or time that went back come first.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.call_at(6_000_000_000, print)
        >>> clock.stamp_at_once()
        5000000000
        >>> clock.call_at(4_000_000_000, print)
        >>> clock.stamp_at_once()
        """
        instant = self._source()
        if (  # as `is_quiet`, whose call would be 2 % of a short event
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
        return WholeSeconds(instant)

    def is_quiet(self) -> bool:
        """Look what time it is; tell whether neither alarms nor time that went back have to be looked at.

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
        """Return up to where alarms are due, at an instant of the source: `reached`, without asking it again."""
        return instant

    def call_at(self, instant: int, alarm: Alarm) -> None:
        """Have ``alarm`` called with the instant when that has come.

        >>> clock = StreamClock()
        >>> clock.call_at(2_000_000_000, lambda instant: print("alarm at", instant))
        >>> clock.move_to(3_000_000_000)
        >>> Engine(clock).advance()
        alarm at 2000000000
        """
        heapq.heappush(self.alarms, (instant, next(self._order), alarm))

    def put_back(self, instant: int, order: int, alarm: Alarm) -> None:
        """Set an alarm that another clock had, in its place among those of the same instant.

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
        first = self.alarms[:1]  # in one step: another thread may be taking it
        return first[0][0] if first else None

    def due(self, until: Optional[int] = None) -> Optional[Tuple[int, Alarm]]:
        """Take and return the next alarm that is due now (or at ``until``); None where there is none.

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
        """Take the alarms out that are not to be called any more.

        >>> clock = Clock(lambda: 5_000_000_000)
        >>> clock.call_at(6_000_000_000, print)
        >>> clock.drop(lambda alarm: alarm is print)
        >>> clock.alarms
        []
        """
        self.alarms[:] = [one for one in self.alarms if not is_dead(one[2])]
        heapq.heapify(self.alarms)

    def reached(self) -> int:
        """Return the instant up to which alarms are due.

        >>> Clock(lambda: 5_000_000_000).reached()
        5000000000
        """
        return self.now()

    def coming(self) -> int:
        """Return the instant to which time is being moved: later than `reached` where that takes several steps.

        >>> Clock(lambda: 5_000_000_000).coming()
        5000000000
        """
        return self.reached()

    def went_back(self) -> bool:
        """Tell whether time has gone back by more than `JUMP` since the last call; the clock starts anew then.

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
        """Drop the alarms and the memory of the last stamp.

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

    A clock that is pinned says the same time for ever; alarms go by the stream's time all the same. A clock that has
    neither a start nor been moved or pinned is not set: it has no time for an event that comes without one.

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
        super().__init__(self._present)

    def _present(self) -> int:
        return self._time if self._pinned is None else self._pinned

    def kept(self) -> List[int]:
        """Return what it knows; see `Clock.kept`.

        >>> StreamClock(7).kept()
        [-1, 0, 0, 0, 7]
        """
        if not self.is_set:
            return super().kept()
        return [*super().kept(), self._time, *([] if self._pinned is None else [self._pinned])]

    def restore(self, kept: Sequence[int]) -> None:
        """Know what another clock knew; see `Clock.restore`.

        >>> clock, other = StreamClock(7), StreamClock()
        >>> other.restore(clock.kept())
        >>> other.now()
        7
        """
        super().restore(kept)
        if len(kept) > 4:
            self._time, self.is_set = kept[4], True
        if len(kept) > 5:
            self._pinned = kept[5]

    def pin(self, instant: int) -> None:
        """Have the clock say an instant from now on, whatever moves the stream's time.

        Events that it stamps come after that instant, 1 ns apart.

        >>> clock = StreamClock()
        >>> clock.pin(1_000_000_000)
        >>> clock.move_to(2_000_000_000)
        >>> clock.now()
        1000000000
        """
        self.is_set = True
        self._pinned = int(instant)
        self._last_stamp = max(self._last_stamp, self._pinned)
        self._time = max(self._time, self._pinned)

    def move_to(self, instant: int, back: bool = False) -> None:
        """Move the stream's time forward; with ``back`` also backwards.

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
        """Move to the instant of an event, where nothing has to be looked at before and after that; else do nothing.

        >>> clock = StreamClock()
        >>> clock.follow(1_000_000_000), clock.now()
        (True, 1000000000)
        >>> clock.call_at(2_000_000_000, print)
        >>> clock.follow(3_000_000_000), clock.now()
        (False, 1000000000)
        """
        time = self._time
        if time < self._newest or self.behind or self._pinned is not None:
            return False
        if instant > time:
            time = instant if instant.__class__ is int else int(instant)
        if self.alarms and self.alarms[0][0] <= time:
            return False
        self._time = self._newest = time
        self.is_set = True
        return True

    def move_by(self, nanoseconds: int) -> None:
        """Let some of the stream's time pass.

        >>> clock = StreamClock(1_000_000_000)
        >>> clock.move_by(500)
        >>> clock.now()
        1000000500
        """
        self.is_set = True
        self._time += nanoseconds

    def head_for(self, instant: int) -> None:
        """Say where the stream's time is being moved, by who moves it from one alarm to the next.

        >>> clock = StreamClock(1_000_000_000)
        >>> clock.head_for(2_000_000_000)
        >>> clock.reached(), clock.coming()
        (1000000000, 2000000000)
        """
        self._heading = instant

    def _due_by(self, instant: int) -> int:
        return self._time  # also where the clock is pinned

    def reached(self) -> int:
        """Return the instant up to which alarms are due: the stream's time, also where the clock is pinned.

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
        """Take and return the next alarm that is due by the stream's time.

        >>> clock = StreamClock()
        >>> clock.call_at(2_000_000_000, print)
        >>> clock.due() is None, clock.due(until=2_000_000_000)[0]
        (True, 2000000000)
        """
        return super().due(self._time if until is None else until)
