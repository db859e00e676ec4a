"""Synchronized queries: goals that are called when the memories they read have the data."""

import heapq
from collections import OrderedDict
from itertools import count
from typing import Any, Dict, Iterable, List, Tuple

from .. import timestamps
from ..errors import UsageError
from ..events import Dispatcher, Stage
from ..logic import Logic, PrologError
from ..terms import CONS, Term, Var, deref, functor, list_items
from ._recording import Warn
from .memories import Instance, Memories

LIMIT = 200_000
"""How many queries may wait at once; past that the oldest is dropped with a warning."""


NAMED = 20
"""How many dropped queries one warning names."""


class Waiting:
    """A query that waits: the event to trigger, the goal, the interval, and how many memories it waits for."""

    __slots__ = ("order", "event", "query", "start", "end", "missing")

    def __init__(self, order: int, event: Term, query: Term, start: int, end: int, missing: int):
        self.order = order
        self.event = event
        self.query = query
        self.start = start
        self.end = end
        self.missing = missing


class WaitingQueries:
    """All synchronized queries of a program.

    ``syncronized(Event, Query, [[Id, Time], ...])`` (also spelt ``synchronized``) calls Query as soon as each
    memory named has taken an event that ends at or after its time, and triggers Event with the interval of
    the synchronized event, once, for the first solution.

    Each memory has a heap of those who wait for it, by time, so an event costs one comparison however many wait.
    """

    def __init__(
        self,
        logic: Logic,
        dispatcher: Dispatcher,
        memories: Memories,
        warn: Warn,
        limit: int = LIMIT,
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._memories = memories
        self._warn = warn
        self._limit = limit
        self._order = count()
        self._all: OrderedDict[int, Waiting] = OrderedDict()
        event, query = Var(), Var()
        call = (functor("call", 1), query)
        self._goal = logic.compile_goal(call, [event, query], [event], name="synchronized query")
        memories.on_update = self._release
        memories.on_delete = self._drop_waiting_for
        for name in ("syncronized", "synchronized"):
            pattern = functor(name, 3)(Var(), Var(), Var())
            dispatcher.listen(Stage.QUERIES, pattern, self._arrive)

    def __len__(self) -> int:
        return len(self._all)

    def clear(self) -> None:
        """Drop all that wait (the clock went back)."""
        self._all.clear()
        for instance in self._memories:
            instance.waiting.clear()

    def _arrive(self, term: Term, values: Tuple[Term, ...], start: int, end: int, after: Any) -> Any:
        event, query, conditions = values
        try:
            behind = [
                (instance, instant)
                for instance, instant in self._conditions(conditions)
                if not instance.memory.ends or instance.memory.ends[-1] < instant
            ]
        except UsageError as error:
            self._warn(f"{self._logic.show(event)} is dropped: {error}", ("dropped", _kind(event)))
            return after
        if not behind:
            return self._ask(event, query, start, end, after)
        waiting = Waiting(next(self._order), event, query, start, end, len(behind))
        if len(self._all) >= self._limit:
            self._drop_oldest()
        self._all[waiting.order] = waiting
        for instance, instant in behind:
            heapq.heappush(instance.waiting, (instant, waiting.order, waiting))
            if len(instance.waiting) > 2 * self._limit:
                self._forget_dropped(instance)
        return after

    def _conditions(self, conditions: Term) -> Iterable[Tuple[Instance, int]]:
        """Return the memories and the instants they have to reach.

        Raises:
            UsageError: for an unknown memory or something that is no ``[Id, Time]``.
        """
        pairs = list_items(conditions)
        if pairs is None:
            raise UsageError("expected a list of [MemoryId, Time]")
        found: Dict[Instance, int] = {}
        time, instant = None, 0  # most often all wait for one time
        for pair in pairs:
            parts = list_items(pair)
            if parts is None or len(parts) != 2:
                raise UsageError(f"expected [MemoryId, Time], found {self._logic.show(pair)}")
            instance = self._memories.find(parts[0])
            if instance is None:
                raise UsageError(f"there is no memory {self._logic.show(parts[0])}")
            if parts[1] is not time:
                time, instant = parts[1], _reach(parts[1])
            found[instance] = max(instant, found.get(instance, instant))
        return found.items()

    def _ask(self, event: Term, query: Term, start: int, end: int, after: Any) -> Any:
        """Return the frame that calls the query and triggers the event where it has a solution."""
        dispatch = self._dispatcher.dispatch

        def solved(outputs: Tuple[Term, ...]) -> Any:
            try:
                return dispatch(outputs[0], start, end, after)
            except UsageError as error:
                self._warn(f"{self._logic.show(outputs[0])} is dropped: {error}", ("dropped", _kind(event)))
                return after

        def failed(error: PrologError) -> None:
            self._warn(
                f"{self._logic.show(event)} is dropped, its query raised: {error}", ("raised", _kind(event))
            )

        return self._dispatcher.call(self._goal, (event, query), solved, after, failed)

    def _release(self, instance: Instance, end: int, after: Any) -> Any:
        """Return the frame that asks what has waited for this memory alone, in order of registration."""
        heap = instance.waiting
        ready: List[Waiting] = []
        while heap and heap[0][0] <= end:
            waiting = heapq.heappop(heap)[2]
            waiting.missing -= 1
            if waiting.missing == 0 and self._all.pop(waiting.order, None) is not None:
                ready.append(waiting)
        if len(ready) > 1:
            ready.sort(key=lambda waiting: waiting.order, reverse=True)
        for waiting in ready:
            after = (self, waiting, after)
        return after

    def run(self, frame: Any) -> Any:
        """Ask a query that has all its data, as code of a frame: one is done with before the next is asked."""
        _, waiting, after = frame
        return self._ask(waiting.event, waiting.query, waiting.start, waiting.end, after)

    def _drop_oldest(self) -> None:
        waiting = self._all.popitem(last=False)[1]
        self._warn(
            f"more than {self._limit} queries wait; the oldest is dropped: {self._logic.show(waiting.event)}",
            "waiting",
        )

    def _forget_dropped(self, instance: Instance) -> None:
        """Take out of a memory's heap what no longer waits: a memory that gets no event never does."""
        instance.waiting[:] = [entry for entry in instance.waiting if entry[1] in self._all]
        heapq.heapify(instance.waiting)

    def _drop_waiting_for(self, instance: Instance) -> None:
        """Drop the queries that wait for a memory that is deleted, with one warning that names them."""
        show = self._logic.show
        dropped = [
            waiting.event
            for _, order, waiting in sorted(instance.waiting, key=lambda entry: entry[1])
            if self._all.pop(order, None) is not None
        ]
        instance.waiting.clear()
        if dropped:
            named = ", ".join(show(event) for event in dropped[:NAMED])
            more = f" and {len(dropped) - NAMED} more" if len(dropped) > NAMED else ""
            self._warn(
                f"the memory {show(instance.id)} is deleted; dropped is what waits for it: {named}{more}",
                ("deleted", instance),
            )


def _kind(event: Term) -> Any:
    """Return what events of one kind share: the functor, or the atom."""
    event = deref(event)
    return event[0] if event.__class__ is tuple else event


def _reach(time: Term) -> int:
    """Return the instant that a memory has to reach for a time condition."""
    time = deref(time)
    if time.__class__ is float:
        return timestamps.first_reaching(time)
    if time.__class__ is tuple and time[0] is CONS:
        return timestamps.from_any(time)
    return timestamps.from_term(time)
