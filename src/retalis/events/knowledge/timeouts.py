"""When queries have waited, and states have lasted, long enough: instants, with one alarm of the clock at a time."""

from heapq import heapify, heappop, heappush
from typing import Callable, Container, List, Protocol, Set, Tuple

from ...foundation.errors import UsageError
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.timestamps import from_seconds
from ...prolog.terms.types import Term, deref, functor

TIMEOUT = functor("timeout", 1)
_SPARE = 16


class AlarmClock(Protocol):
    """A clock with alarms."""

    def now(self) -> int:
        """Return the present instant."""

    def stamp(self) -> int:
        """Return the present instant, later than all that were returned before."""

    def call_at(self, instant: int, alarm: Callable[[int], None], /) -> None:
        """Have a function called when an instant has come."""


def timeout_of(options: Term, brief: Callable[[Term], str]) -> int:
    """Return the nanoseconds of ``[timeout(Seconds)]``.

    Raises:
        UsageError: for anything else.
    """
    items = list_items(options)
    if items is not None and len(items) == 1:
        option = deref(items[0])
        if option.__class__ is tuple and option[0] is TIMEOUT:
            seconds = deref(option[1])
            if seconds.__class__ in (int, float) and 0 <= seconds < float("inf"):
                return from_seconds(seconds)
    raise UsageError(f"expected [timeout(Seconds)], found {brief(options)}")


class Timeouts:
    """Which queries are to be given up when.

    An alarm for each query would stay in the clock for as long as it might have waited; here those of queries that
    were asked go with the next ones.

    Args:
        clock: tells the time and rings.
        waiting: the orders of the queries that wait.
        give_up: takes the order of a query and the instant at which it was due.
    """

    def __init__(self, clock: AlarmClock, waiting: Container[int], give_up: Callable[[int, int], None]):
        self._clock = clock
        self._waiting = waiting
        self._give_up = give_up
        self._due: List[Tuple[int, int]] = []
        self._room = _SPARE
        """How many there may be before those of queries that wait no more are looked for."""
        self._set: Set[int] = set()
        """The instants for which an alarm is set: as a rule one."""

    def __len__(self) -> int:
        return len(self._due)

    def add(self, order: int, end: int, wait: int) -> None:
        """Have a query given up when it has waited so long, from the end of its event or from now on."""
        self.add_at(order, max(self._clock.now(), end) + wait)

    def add_at(self, order: int, instant: int) -> None:
        """Have one given up at an instant."""
        if len(self._due) > self._room:
            self._due = [one for one in self._due if one[1] in self._waiting]
            heapify(self._due)
            self._room = 2 * len(self._due) + _SPARE
        heappush(self._due, (instant, order))
        self._set_alarm()

    def clear(self) -> None:
        """Forget all (the clock went back, and its alarms are gone)."""
        self._due = []
        self._set = set()

    def _set_alarm(self) -> None:
        while self._due and self._due[0][1] not in self._waiting:
            heappop(self._due)
        if self._due and not any(instant <= self._due[0][0] for instant in self._set):
            instant = self._due[0][0]
            self._set.add(instant)
            self._clock.call_at(instant, TimeoutAlarm(self, instant))

    def ring(self, set_for: int, now: int) -> None:
        """Give up what has waited long enough when an alarm rings that was set for an instant."""
        self._set.discard(set_for)
        try:
            while self._due and self._due[0][0] <= max(now, set_for):
                instant, order = heappop(self._due)
                if order in self._waiting:
                    self._give_up(order, instant)
        finally:  # what one has started may have failed
            self._set_alarm()

    def kept(self) -> Tuple[List[Tuple[int, int]], List[int]]:
        """Return when which queries are due, and the instants for which alarms are set; see `restore`."""
        return [one for one in self._due if one[1] in self._waiting], sorted(self._set)

    def restore(self, due: List[Tuple[int, int]], alarms: List[int]) -> None:
        """Have queries be due as they were; the alarms are set in the clock already."""
        self._due = list(due)
        heapify(self._due)
        self._set = set(alarms)


class TimeoutAlarm:
    """The alarm of the queries that are due first.

    Args:
        timeouts: of all queries.
        set_for: the instant at which it is to ring.
    """

    __slots__ = ("set_for", "timeouts")

    def __init__(self, timeouts: Timeouts, set_for: int):
        self.timeouts = timeouts
        self.set_for = set_for

    def __call__(self, now: int) -> None:
        """Ring."""
        self.timeouts.ring(self.set_for, now)
