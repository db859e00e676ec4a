"""Timeouts of pending queries and states: a queue of deadlines with one alarm at a time.

An alarm in the clock for each query would remain there until the deadline, although most queries are answered long
before. `Timeouts` keeps the deadlines in a heap and sets an alarm for the earliest one only. Deadlines of answered
queries are removed when they reach the top of the heap, or all together when the heap has doubled in size. A deadline
is due when the watermark reaches it, that is when the clock has passed it by the delay of the watermark.
"""

from heapq import heapify, heappop, heappush
from typing import (
    Callable,
    Container,
    Iterable,
    List,
    NamedTuple,
    Sequence,
    Set,
    Tuple,
)

from ...foundation.errors import UsageError
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.timestamps import from_seconds
from ...prolog.terms.types import Term, deref, functor
from ...serialization.state_fields import StateFields, StateOwner, field, rows_of
from ...serialization.stored_field_types import COUNT, INSTANT, sequence_of
from ..clock.clock import Clock
from ..matches.watermarks import PatternWatermark, Watermarks


class Deadline(NamedTuple):
    """Deadline of a query or state.

    Attributes:
        instant: the deadline in ns.
        order: order of the query or state.
    """

    instant: int
    order: int


TIMEOUT = functor("timeout", 1)
_STALE_TOLERANCE = 16


def timeout_of(options: Term, brief: Callable[[Term], str]) -> int:
    """Return the nanoseconds of ``[timeout(Seconds)]``.

    Raises:
        UsageError: for other terms.
    """
    items = list_items(options)
    if items is not None and len(items) == 1:
        option = deref(items[0])
        if option.__class__ is tuple and option[0] is TIMEOUT:
            seconds = deref(option[1])
            if seconds.__class__ in (int, float) and 0 <= seconds < float("inf"):
                return from_seconds(seconds)
    raise UsageError(f"expected [timeout(Seconds)], found {brief(options)}")


def are_increasing_orders(orders: Sequence[int], next_order: int) -> bool:
    """Return whether orders increase, and are below the next one."""
    return orders == sorted(set(orders)) and all(order < next_order for order in orders)


class Timeouts(StateOwner):
    """Deadlines of queries or states; an *order* is the number that identifies one.

    Args:
        clock: clock that calls the alarms.
        pending_orders: orders of the queries and states that are still pending; others have no deadline any more.
        on_timeout: called with the order of a query and its deadline.
        watermarks: the watermarks of the program.
        watermark: the watermark that has to reach a deadline.
    """

    STATE = StateFields(
        field(
            "pending_deadlines",
            rows_of(
                Deadline,
                instant=INSTANT,
                order=COUNT,
            ),
        ),
        field("alarm_instants", sequence_of(INSTANT)),
    )

    def __init__(
        self,
        clock: Clock,
        pending_orders: Container[int],
        on_timeout: Callable[[int, int], None],
        watermarks: Watermarks,
        watermark: PatternWatermark,
    ):
        self._clock = clock
        self._pending_orders = pending_orders
        self._on_timeout = on_timeout
        self.watermark = watermark
        watermarks.on_shorter_delay(self._set_alarm)
        self._deadlines: List[Tuple[int, int]] = []
        self._rebuild_size = _STALE_TOLERANCE
        """Size of the heap at which deadlines of answered queries are removed."""
        self._alarm_instants: Set[int] = set()
        """Instants for which an alarm is set; usually one."""

    def __len__(self) -> int:
        return len(self._deadlines)

    def add(self, order: int, end: int, wait: int) -> None:
        """Add a deadline, ``wait`` ns after ``end`` or the present instant, whichever is later.

        Args:
            order: order of the query.
            end: end of the query's event.
            wait: the timeout in ns.
        """
        self.add_at(order, max(self._clock.now(), end) + wait)

    def add_at(self, order: int, instant: int) -> None:
        """Add a deadline at an instant."""
        if len(self._deadlines) > self._rebuild_size:
            # Twice the remaining size as the next threshold makes the rebuild O(1) per deadline, amortized.
            self._deadlines = [entry for entry in self._deadlines if entry[1] in self._pending_orders]
            heapify(self._deadlines)
            self._rebuild_size = 2 * len(self._deadlines) + _STALE_TOLERANCE
        heappush(self._deadlines, (instant, order))
        self._set_alarm()

    def clear(self) -> None:
        """Remove all deadlines, because the clock went back and has dropped its alarms."""
        self._deadlines = []
        self._alarm_instants = set()

    def _set_alarm(self) -> None:
        while self._deadlines and self._deadlines[0][1] not in self._pending_orders:
            heappop(self._deadlines)
        # An alarm cannot be removed from the clock. An earlier alarm sets the next one when it is called, so none is
        # set now.
        if self._deadlines:
            due_time = self._deadlines[0][0] + self.watermark.delay
            if not any(instant <= due_time for instant in self._alarm_instants):
                self._alarm_instants.add(due_time)
                self._clock.call_at(due_time, TimeoutAlarm(self, due_time))

    def on_alarm(self, alarm_instant: int, now: int) -> None:
        """Report the queries whose deadline has passed; called by the alarm that was set for an instant."""
        self._alarm_instants.discard(alarm_instant)
        try:
            # The delay is read again for each deadline: it may have become longer since the alarm was set.
            while self._deadlines and self._deadlines[0][0] + self.watermark.delay <= max(now, alarm_instant):
                instant, order = heappop(self._deadlines)
                if order in self._pending_orders:
                    self._on_timeout(order, instant)
        finally:  # `on_timeout` may raise
            self._set_alarm()

    @property
    def pending_deadlines(self) -> List[Deadline]:
        """The deadlines of pending queries or states."""
        return [Deadline(*entry) for entry in self._deadlines if entry[1] in self._pending_orders]

    @pending_deadlines.setter
    def pending_deadlines(self, deadlines: Sequence[Deadline]) -> None:
        self._deadlines = [(deadline.instant, deadline.order) for deadline in deadlines]
        heapify(self._deadlines)

    @property
    def alarm_instants(self) -> List[int]:
        """The instants of alarms; a snapshot has the alarms of the clock themselves, too."""
        return sorted(self._alarm_instants)

    @alarm_instants.setter
    def alarm_instants(self, instants: Iterable[int]) -> None:
        self._alarm_instants = set(instants)


class StoredTimeoutAlarm(NamedTuple):
    """Stored form of a `TimeoutAlarm` in the clock.

    Attributes:
        due_at: instant of the alarm in ns.
        order: order of the alarm among those of the same instant.
        owner_number: number of its `Timeouts`: 0 for those of pending queries, then those of each declared state.
        alarm_instant: as in `TimeoutAlarm`.
    """

    due_at: int
    order: int
    owner_number: int
    alarm_instant: int


TIMEOUT_ALARMS = rows_of(
    StoredTimeoutAlarm,
    due_at=INSTANT,
    order=COUNT,
    owner_number=COUNT,
    alarm_instant=INSTANT,
)


class TimeoutAlarm:
    """The alarm of the earliest deadline."""

    __slots__ = ("alarm_instant", "timeouts")

    def __init__(self, timeouts: Timeouts, alarm_instant: int):
        self.timeouts = timeouts
        self.alarm_instant = alarm_instant

    def __call__(self, now: int) -> None:
        """Process the alarm."""
        self.timeouts.on_alarm(self.alarm_instant, now)
