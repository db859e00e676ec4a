"""What memories and subscriptions share: from an event that matches to what is kept or sent of it.

One memory instance: the newest N records of a kind of event, in order of their end times.

Recording: from an event to the memories that take it.
"""

from bisect import bisect_left, bisect_right
from heapq import heapify, heappop, heappush
from itertools import count
from typing import AbstractSet, Any, Callable, Dict, Hashable, Iterator, List, Optional, Sequence, Set, Tuple

from ...prolog.machine.errors import PrologError, instantiation_error, type_error
from ...prolog.machine.resource_limits import keep_back
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import conjunction, list_items
from ...prolog.terms.term_traversal import freeze, is_ground, term_key, variables
from ...prolog.terms.types import COMMA, EMPTY_BLOCK, TRUE, Atom, Frame, Term, Values, Var, deref, functor
from ...prolog.terms.unification import compare
from ..dispatch.discrimination_tree import NOBODY
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import GROUND, ListenerPhase
from ..dispatch.matcher_compiler import compile_builder

Warn = Callable[..., None]
"""Takes a warning as text and what kind it is: those of one kind are shown at growing intervals."""

Recording = Callable[[Term, Values, bool], Optional[Term]]
"""Takes an event, the values of the pattern's variables, and whether it has none; gives the record or None."""


def key_of(name: Term) -> Hashable:
    """Return the dictionary key of an id.

    Raises:
        PrologError: an instantiation error where it has variables.
    """
    try:
        return freeze(deref(name))
    except ValueError:
        raise instantiation_error() from None


def is_whole(pattern: Term, conditions: Term, form: Term) -> bool:
    """Tell whether a form is a variable of its own, which stands for the event."""
    return form.__class__ is Var and form not in variables((COMMA, pattern, conditions))


def unused_variables(pattern: Term, conditions: Term, form: Term, others: Sequence[Term] = ()) -> Set[Var]:
    """Return the variables of a pattern whose values go nowhere: none where the event itself is kept or sent."""
    if form.__class__ is Var:
        return set()
    return set(variables(pattern)).difference(variables((COMMA, conditions, form, *others)))


def recording(
    logic: PrologSystem,
    dispatcher: Dispatcher,
    pattern: Term,
    conditions: Term,
    form: Term,
    name: str,
    problem: Warn,
) -> Tuple[Recording, bool]:
    """Compile ``conditions`` and ``form``, which share their variables with ``pattern``.

    The first solution of the conditions counts. A ``form`` that is a variable of its own stands for the event.

    Args:
        logic: where the conditions are compiled.
        dispatcher: whose events come.
        pattern: the event pattern; values come in the order of its variables.
        conditions: a list of goals.
        form: what to make of the event.
        name: who asks, for reports.
        problem: takes a report about a condition that raised an error.

    Returns:
        The function, and whether it makes a ground record of every ground event.

    Raises:
        PrologError: where pattern, conditions or form are not what they have to be.
    """
    if pattern.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", pattern)
    body = conjunction(_goals(conditions))
    inputs = variables(pattern)
    whole = is_whole(pattern, conditions, form)
    if not whole and form.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", form)
    given = set(inputs)
    made = set(variables(body)) - given
    found = [] if whole else [var for var in variables(form) if var in made]
    keep: Recording = itself
    if not whole:
        keep = _same_or_built(compile_builder(form, inputs, "form"), compare(form, pattern) == 0)
    closed = whole or given.issuperset(variables(form))
    if body is TRUE:
        return keep, closed
    test = logic.compile_goal(body, inputs, found, name=name).test
    test_open = logic.compile_goal(body, inputs, [TRUE if whole else form], name=name).test
    build = compile_builder(form, [*inputs, *found], "form")

    def record(term: Term, values: Values, ground: bool) -> Optional[Term]:
        event = dispatcher.current
        try:
            solution = test(values) if ground else test_open(values)
        except PrologError as error:
            dispatcher.restore(event, dispatcher.cause)
            if keep_back(error):
                problem(f"{name}: event {logic.brief(term)}: {error}", name)
            return None
        if solution is None:
            return None
        if whole or ground and not found:
            return keep(term, values, ground)
        return build(values + solution) if ground else solution[0]

    return record, closed


def itself(term: Term, values: Values, ground: bool) -> Term:
    """Return the event, as the recording of a form that stands for it."""
    return term


def _same_or_built(build: Callable[[Values], Term], same: bool) -> Recording:
    """Return the recording of a form: one that is the same as the pattern is the event itself, if that is ground."""
    if not same:
        return lambda term, values, ground: build(values)
    return lambda term, values, ground: term if ground else build(values)


def _goals(conditions: Term) -> List[Term]:
    items = list_items(conditions)
    if items is None:
        raise type_error("list", conditions)
    goals: List[Term] = []
    for item in items:
        goal = deref(item)
        if goal.__class__ is Var:
            raise instantiation_error()
        if goal.__class__ not in (tuple, Atom) or goal is EMPTY_BLOCK:
            raise type_error("callable", goal)
        if goal is not TRUE:
            goals.append(goal)
    return goals


NEVER = 1 << 100
"""More records than there will be, and later than all instants."""

WIDE = 10
"""By which factor a step between two records is wider than the others for it to be told of."""

_EPOCHS = count()

MemoryRecord = Tuple[Term, int, int]
"""What a memory keeps of an event: the record and the event's interval, start and end as instants."""


class Memory:
    """A bounded history, ordered by end time; records with equal ends stay in order of arrival.

    Adding at the end and every look-up cost the same whatever the size: the records lie in a list of which
    only the last ``size`` count, cut back when it has grown by a quarter of that; look-ups are binary searches.
    Lists are replaced, never shortened or reordered in place, so that a reader who walks an older list is
    not disturbed by what is added meanwhile.

    Attributes:
        size: how many records are kept at most.
        room: how long the lists may become.
        late: how many events were refused because they were older than all records of a full memory.
        ends: the ends of the records, as plain integers, which compare faster than other forms of instants;
            read-only outside of this package.
        records: the records, at the same places.
        indices: where values of an argument stand among the records, by the argument's place; see `matching`.
        changed: how many records there were before the first whose place is another one than it was; `NEVER` where
            all came in order since somebody has set that.
        on_wide: called with the two ends where a look-up falls between records that may be unusually far apart.
    """

    __slots__ = (
        "size",
        "room",
        "late",
        "ends",
        "records",
        "indices",
        "on_wide",
        "changed",
        "_epoch",
        "_gone",
        "_next",
    )

    def __init__(self, size: int):
        self.size = size
        self.room = size + size // 4 + 16
        self.late = 0
        self._gone = 0
        self._epoch = next(_EPOCHS)
        self.changed = NEVER
        self._next: Optional[Tuple[int, List[int], List[MemoryRecord]]] = None
        """What it is becoming, where that takes several steps: an interrupt may come between them."""
        self.ends: List[int] = []
        self.records: List[MemoryRecord] = []
        self.indices: Dict[int, Any] = {}
        self.on_wide: Callable[[int, int], object] = lambda start, end: None

    def clear(self) -> None:
        """Forget all records; the counts stay."""
        self._epoch = next(_EPOCHS)
        self._become(self._gone + len(self.ends), [], [])

    def _become(self, gone: int, ends: List[int], records: List[MemoryRecord]) -> None:
        self._next = gone, ends, records
        self.indices = {}
        self._gone, self.ends, self.records = gone, ends, records
        self._next = None

    @property
    def oldest(self) -> int:
        """How many records were taken before the first that stays: the newest does, whatever the size."""
        return self._gone + max(0, len(self.ends) - max(self.size, 1))

    def since(self, taken: int) -> Tuple[int, List[MemoryRecord]]:
        """Return the records that were taken after so many, and how many came before the first of them."""
        first = max(self.oldest, min(taken, self.added))
        return first, self.records[first - self._gone :]

    def restore(self, gone: int, late: int, ends: List[int], records: List[MemoryRecord]) -> None:
        """Have records as another memory had them."""
        self._epoch = next(_EPOCHS)
        self.late = late
        self._become(gone, ends, records)

    def mend(self) -> None:
        """Put right what an interrupt may have left half done."""
        if self._next is not None:
            self._become(*self._next)
        del self.ends[len(self.records) :]

    def __len__(self) -> int:
        return min(len(self.ends), self.size)

    @property
    def added(self) -> int:
        """How many records were ever taken."""
        return self._gone + len(self.ends)

    @property
    def version(self) -> Tuple[int, int]:
        """Another value after each change of the records; no other memory has it."""
        return self._epoch, self.added

    @property
    def latest(self) -> Optional[int]:
        """The newest end of all events taken, None before the first."""
        return self.ends[-1] if self.ends else None

    def add(self, record: MemoryRecord) -> bool:
        """Take a record; returns False where it is older than all records of a full memory."""
        ends = self.ends
        end = int(record[2])
        if ends and end < ends[-1]:
            return self._insert(record, end)
        ends.append(end)
        self.records.append(record)
        if len(ends) >= self.room:
            self.cut()
        return True

    def _insert(self, record: MemoryRecord, end: int) -> bool:
        ends, records = self.ends, self.records
        at = bisect_right(ends, end)
        if self.size and at <= len(ends) - self.size:
            self.late += 1
            return False
        self.changed = min(self.changed, self._gone + at)
        self._become(self._gone, [*ends[:at], end, *ends[at:]], [*records[:at], record, *records[at:]])
        self.cut()
        return True

    def cut(self) -> None:
        """Drop what is over the size; the newest stays, whatever the size, for what is `latest`."""
        first = max(0, len(self.ends) - max(self.size, 1))
        self._become(self._gone + first, self.ends[first:], self.records[first:])

    def at_or_before(self, instant: int) -> Optional[MemoryRecord]:
        """Return the last record whose end is not after ``instant``."""
        ends = self.ends
        at = bisect_right(ends, instant) - 1
        if at < 0 or at < len(ends) - self.size:
            return None
        return self.records[at]

    def at_or_after(self, instant: int) -> Optional[MemoryRecord]:
        """Return the first record whose end is not before ``instant``."""
        ends = self.ends
        held = len(ends)
        first = held - self.size
        at = bisect_left(ends, instant) if first <= 0 else bisect_left(ends, instant, first)
        if at >= held:
            return None
        start, end = ends[at - 1], ends[at]  # the last one before the first: no gap then
        if (end - start) * (held + WIDE - 2) >= WIDE * (ends[-1] - ends[0]) and start < end:
            self.on_wide(start, end)  # at least ten times the mean of the other steps
        return self.records[at]

    def around(self, instant: int) -> Optional[Tuple[MemoryRecord, MemoryRecord]]:
        """Return what `at_or_before` and `at_or_after` do; None without both."""
        ends = self.ends
        held = len(ends)
        at = bisect_right(ends, instant)
        if at < 1 or at <= held - self.size:
            return None
        start = ends[at - 1]
        if start == instant:
            return self.records[at - 1], self.records[
                bisect_left(ends, instant, max(0, held - self.size), at)
            ]
        if at >= held:
            return None
        end = ends[at]
        if (end - start) * (held + WIDE - 2) >= WIDE * (ends[-1] - ends[0]):  # as in `at_or_after`
            self.on_wide(start, end)
        return self.records[at - 1], self.records[at]

    @property
    def first(self) -> int:
        """The place of the oldest record that counts."""
        return max(0, len(self.ends) - self.size)

    def after(self, instant: int) -> int:
        """Return the place behind all records whose ends are not after ``instant``."""
        return bisect_right(self.ends, instant, self.first)

    def reaching(self, instant: int) -> int:
        """Return the place of the first record whose end is not before ``instant``."""
        return bisect_left(self.ends, instant, self.first)

    def newest_first(self) -> Iterator[MemoryRecord]:
        """Yield the records there are at this moment, newest first."""
        records = self.records
        for at in range(len(records) - 1, max(0, len(records) - self.size) - 1, -1):
            yield records[at]


UPDATED = functor("memory_updated", 2)


Waiting = Tuple[Any, ...]
"""A query that waits, of `WaitingQueries`, whose order is its first item."""

Follow = Callable[["MemoryInstance", int, Frame], Frame]
"""Takes an instance that has taken an event, the end of that, and the next frame; gives the frame to go on with."""


class MemoryInstance:
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
        self.instances: Tuple[MemoryInstance, ...] = ()
        self._dispatcher = dispatcher
        self._take, self._closed = take
        self._follow = follow
        self._updates = dispatcher.gate(UPDATED)
        self._everything = pattern.__class__ is Var
        self.listener = dispatcher.listen(ListenerPhase.MEMORIES, pattern, self._arrive, unused=unused)

    @property
    def pattern(self) -> Term:
        """Which events it takes."""
        return self.listener.pattern

    def add(self, instance: MemoryInstance) -> None:
        """Record into one more memory."""
        instance.recorder = self
        self.instances = (*self.instances, instance)

    def remove(self, instance: MemoryInstance) -> None:
        """Record into a memory no more; without any the recorder is done."""
        self.keep_only(lambda one: one is not instance)

    def keep_only(self, chosen: Callable[[MemoryInstance], bool]) -> None:
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
        self, record: MemoryRecord, opens: bool, instances: Iterator[MemoryInstance], after: Frame
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
