"""Recording: from an event to the memories that take it."""

from heapq import heapify, heappop, heappush
from typing import AbstractSet, Any, Callable, Dict, Hashable, Iterator, List, Tuple

from ...prolog.machine import Frame
from ...prolog.terms import Term, Values, Var, deref, functor, is_ground, term_key
from ..dispatch import GROUND, NOBODY, Dispatcher, Stage
from .memory import NEVER, Memory, MemoryRecord
from .recording import Recording

UPDATED = functor("memory_updated", 2)


Waiting = Tuple[Any, ...]
"""A query that waits, of `WaitingQueries`, whose order is its first item."""

Follow = Callable[["Instance", int, Frame], Frame]
"""Takes an instance that has taken an event, the end of that, and the next frame; gives the frame to go on with."""


class Instance:
    """A memory with its name, its recorder, and the queries that wait for it.

    Attributes:
        definition: what it was made of: ``(Functor, Pattern, Conditions, Record, Id, Size)``.
        due: the least instant that a query waits for.
        open: whether a record may have variables, so that a reader needs a copy.
        times: a heap of the instants waited for; some may have no query any more.
        waiting: the queries that wait for it, by instant and order.
    """

    __slots__ = ("id", "active", "definition", "memory", "recorder", "open", "due", "times", "waiting")

    recorder: "Recorder"

    def __init__(self, name: Term, size: int, active: bool, definition: Term):
        self.id = name
        self.definition = definition
        self.memory = Memory(size)
        self.active = active
        self.open = False
        self.due = NEVER
        self.times: List[int] = []
        self.waiting: Dict[int, Dict[int, Waiting]] = {}

    @property
    def key(self) -> Hashable:
        """Equal for memories that keep the same of the same events, under the same name."""
        return self.active, term_key(self.definition)

    def has(self, instant: int) -> bool:
        """Tell whether it has taken an event that ends at an instant or later."""
        ends = self.memory.ends
        return bool(ends) and ends[-1] >= instant

    def wait(self, instant: int, order: int, query: Waiting) -> None:
        """Keep a query, known by its order, until `reached` is called with its instant or a later one."""
        group = self.waiting.get(instant)
        if group is not None:
            group[order] = query
            return
        self.waiting[instant] = {order: query}
        heappush(self.times, instant)
        if instant < self.due:
            self.due = instant

    def reached(self, end: int) -> List[Waiting]:
        """Return the queries that wait for nothing later than an instant; they are kept no more."""
        times = self.times
        found: List[Waiting] = []
        while times and times[0] <= end:
            found += self.waiting.pop(heappop(times), _NOBODY).values()
        self.due = times[0] if times else NEVER
        return found

    def forget(self, instant: int, order: int) -> None:
        """Keep a query no more."""
        group = self.waiting[instant]
        del group[order]
        if not group:
            del self.waiting[instant]
            if len(self.times) > 2 * len(self.waiting) + _SPARE:
                self.times = list(self.waiting)
                heapify(self.times)

    def mend(self) -> None:
        """Put right what an interrupt may have left half done; what waits is put back by who keeps it."""
        self.memory.mend()
        self.forget_waiting()
        if self not in self.recorder.instances:
            self.recorder.add(self)

    def forget_waiting(self) -> None:
        """Keep none of the queries any more."""
        self.due = NEVER
        self.times = []
        self.waiting = {}


_NOBODY: Dict[int, Waiting] = {}
_SPARE = 16


class Recorder:
    """Takes the events of one pattern into the memories that record them alike, in the order of these.

    As code of a frame it goes on with the memories that are left.

    Args:
        dispatcher: whose events come.
        pattern: which events.
        take: what is kept of one, and whether that of a ground event is ground.
        follow: returns the frame for what a memory's update leads to: takes instance, end and next frame.
        key: equal for recorders that keep the same of the same events; None where that cannot be known.
        unused: variables of the pattern whose values are neither kept nor looked at.
    """

    def __init__(
        self,
        dispatcher: Dispatcher,
        pattern: Term,
        take: Tuple[Recording, bool],
        follow: Follow,
        key: Hashable,
        unused: AbstractSet[Var],
    ):
        self.key = key
        self.instances: Tuple[Instance, ...] = ()
        self._dispatcher = dispatcher
        self._take, self._closed = take
        self._follow = follow
        self._updates = dispatcher.gate(UPDATED)
        self._everything = pattern.__class__ is Var
        self.listener = dispatcher.listen(Stage.MEMORIES, pattern, self._arrive, unused=unused)

    @property
    def pattern(self) -> Term:
        """Which events it takes."""
        return self.listener.pattern

    def add(self, instance: Instance) -> None:
        """Record into one more memory."""
        instance.recorder = self
        self.instances = (*self.instances, instance)

    def remove(self, instance: Instance) -> None:
        """Record into a memory no more; without any the recorder is done."""
        self.keep_only(lambda one: one is not instance)

    def keep_only(self, chosen: Callable[[Instance], bool]) -> None:
        """Record into some of the memories; without any the recorder is done."""
        self.instances = tuple(filter(chosen, self.instances))
        if not self.instances:
            self._dispatcher.remove(self.listener)

    def _arrive(self, term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
        if self._everything and self._is_own_update(term):
            return after
        dispatcher = self._dispatcher
        ground = dispatcher.current[GROUND]
        if ground is None:
            ground = dispatcher.ground()
        kept = self._take(term, values, ground)
        if kept is None:
            return after
        opens = not (self._closed and ground) and not is_ground(kept)
        return self._record((kept, start, end), opens, iter(self.instances), after)

    def run(self, frame: Frame) -> Frame:
        """Go on with the memories that are left."""
        return self._record(*frame[1:])

    def _record(
        self, record: MemoryRecord, opens: bool, instances: Iterator[Instance], after: Frame
    ) -> Frame:
        end = int(record[2])
        telling = self._updates.plan is not NOBODY
        for instance in instances:
            if opens:
                instance.open = True
            memory = instance.memory
            ends = memory.ends
            if ends and end < ends[-1]:
                if not memory.add(record):
                    continue
            else:  # `Memory.add` written out: 20 memories that take every event cost 26 % more with a call
                ends.append(end)
                memory.records.append(record)
                if len(ends) >= memory.room:
                    memory.cut()
            if instance.due <= end or (telling and instance.active):
                frame = (self, record, opens, instances, after)
                result = self._follow(instance, record[2], frame)
                if result is not frame:
                    return result
        return after

    def _is_own_update(self, term: Term) -> bool:
        """Tell whether an event is the update of a memory that takes all events."""
        if term.__class__ is not tuple or term[0] is not UPDATED:
            return False
        name = deref(term[1])
        return any(name is instance.id for instance in self.instances)
