"""Memories: bounded histories of events, and the recorders that fill them.

A `Memory` stores the newest N records ordered by end time, in two parallel lists: records and their ends. Look-ups
for an instant are binary searches in the list of ends. Records nearly always arrive in order and are appended; when
the lists exceed the size by a quarter, they are replaced by shorter copies, so adding costs O(1) amortized. Lists
are never changed in place otherwise: a Prolog goal that enumerates an older list is not disturbed by later records.

A look-up for a term uses a `RecordIndex` if an argument of the term is an atom or integer. The index is created at
the first such look-up and updated at later ones, so recording does not become slower (just-in-time indexing, as in
SWI-Prolog).

A `Recorder` listens to one event pattern and records into all memories with equal definitions of records. After
each record it continues with the queries that wait for that memory, see `pending_queries`.

`compile_recording` compiles the conditions and the template of a memory or subscription to a function from an event
to a record.
"""

from bisect import bisect_left, bisect_right
from functools import partial
from heapq import heapify, heappop, heappush
from itertools import count
from typing import (
    AbstractSet,
    Any,
    Callable,
    Dict,
    Hashable,
    Iterator,
    List,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...foundation.limit_checks import check_limits
from ...prolog.builtins.argument_checks import bound
from ...prolog.machine.errors import PrologError, instantiation_error, type_error
from ...prolog.machine.resource_limits import record_caught_error
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import conjunction, list_items
from ...prolog.terms.term_traversal import freeze, is_ground, term_key, variables
from ...prolog.terms.types import COMMA, EMPTY_BLOCK, TRUE, Atom, Frame, Term, Values, Var, deref, functor
from ...prolog.terms.unification import compare
from ..dispatch.discrimination_tree import NO_LISTENERS
from ..dispatch.dispatcher import Dispatcher
from ..dispatch.listeners import GROUND, ListenerPhase
from ..dispatch.matcher_compiler import compile_builder

Warn = Callable[..., None]
"""Receives a warning as text and its kind; warnings of one kind are repeated at growing intervals only."""

Recording = Callable[[Term, Values, bool], Optional[Term]]
"""Takes an event, the values of the pattern's variables, and whether the event is ground.

Returns the record or None.
"""


def key_of(memory_id: Term) -> Hashable:
    """Return the dictionary key of an id.

    Raises:
        PrologError: an instantiation error if the id contains variables.
    """
    try:
        return freeze(deref(memory_id))
    except ValueError:
        raise instantiation_error() from None


def check_recording_arguments(conditions: Term, recording_id: Term, notation: str) -> None:
    """Check two arguments of a memory or subscription that tell whether its arguments are in the right order.

    Args:
        conditions: the conditions.
        recording_id: the id.
        notation: the goal with names for its arguments, for errors.

    Raises:
        PrologError: if the conditions are no list, or the id has variables.
    """
    if list_items(conditions) is None:
        raise type_error(
            "list", conditions, f"the conditions are a list of goals, as in [V < 11] or []: write {notation}"
        )
    if variables(recording_id):
        raise instantiation_error(f"the id is not a variable: write {notation}")


def is_event_variable(pattern: Term, conditions: Term, template: Term) -> bool:
    """Return whether a template is a variable that occurs nowhere else: it stands for the event."""
    return template.__class__ is Var and template not in variables((COMMA, pattern, conditions))


def unused_variables(
    pattern: Term, conditions: Term, template: Term, other_terms: Sequence[Term] = ()
) -> Set[Var]:
    """Return the variables of a pattern whose values are not used; none if the event itself is stored or sent."""
    if template.__class__ is Var:
        return set()
    return set(variables(pattern)).difference(variables((COMMA, conditions, template, *other_terms)))


def compile_recording(
    logic: PrologSystem,
    dispatcher: Dispatcher,
    pattern: Term,
    conditions: Term,
    template: Term,
    name: str,
    warn: Warn,
) -> Tuple[Recording, bool]:
    """Compile ``conditions`` and ``template``, which share their variables with ``pattern``, to a recording.

    Only the first solution of the conditions is used. A template that is a variable of its own stands for the event.

    Args:
        logic: the system that compiles the conditions.
        dispatcher: dispatcher of the events.
        pattern: the event pattern; values come in the order of its variables.
        conditions: a list of goals.
        template: term of the record.
        name: name of the memory or subscription in reports.
        warn: receives a report about a condition that raised an error.

    Returns:
        The recording, and whether the record of every ground event is ground.

    Raises:
        PrologError: if pattern, conditions or template have the wrong type.
    """
    if pattern.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", pattern)
    body = conjunction(_check_condition_goals(conditions))
    inputs = variables(pattern)
    records_event = is_event_variable(pattern, conditions, template)
    if not records_event and template.__class__ not in (tuple, Atom, Var):
        raise type_error("callable", template)
    pattern_variables = set(inputs)
    condition_vars = set(variables(body)) - pattern_variables
    output_vars = [] if records_event else [var for var in variables(template) if var in condition_vars]
    recording: Recording = record_event
    if not records_event:
        recording = _create_template_recording(
            compile_builder(template, inputs, "form"), compare(template, pattern) == 0
        )
    preserves_ground = records_event or pattern_variables.issuperset(variables(template))
    if body is TRUE:
        return recording, preserves_ground
    find_solution = logic.compile_goal(body, inputs, output_vars, name=name).first_solution
    # The conditions may bind variables of the event itself, so for events with variables the template is the output
    # of the goal.
    find_solution_of_nonground = logic.compile_goal(
        body, inputs, [TRUE if records_event else template], name=name
    ).first_solution
    build_record = compile_builder(template, [*inputs, *output_vars], "form")

    def record(term: Term, values: Values, ground: bool) -> Optional[Term]:
        event = dispatcher.current
        try:
            solution = find_solution(values) if ground else find_solution_of_nonground(values)
        except PrologError as error:
            dispatcher.restore_context(event, dispatcher.cause)
            if record_caught_error(error):
                warn(f"{name}: event {logic.brief(term)}: {error}", name)
            return None
        if solution is None:
            return None
        if records_event or ground and not output_vars:
            return recording(term, values, ground)
        return build_record(values + solution) if ground else solution[0]

    return record, preserves_ground


def record_event(term: Term, values: Values, ground: bool) -> Term:
    """Return the event: the recording of a template that stands for it."""
    return term


def _create_template_recording(build: Callable[[Values], Term], is_same: bool) -> Recording:
    """Return the recording of a template.

    If the template equals the pattern and the event is ground, this is the event itself.
    """
    if not is_same:
        return lambda term, values, ground: build(values)
    return lambda term, values, ground: term if ground else build(values)


def _check_condition_goals(conditions: Term) -> List[Term]:
    items = list_items(conditions)
    if items is None:
        raise type_error("list", conditions)
    goals: List[Term] = []
    for item in items:
        goal = bound(item)
        if goal.__class__ not in (tuple, Atom) or goal is EMPTY_BLOCK:
            raise type_error("callable", goal)
        if goal is not TRUE:
            goals.append(goal)
    return goals


NEVER = 1 << 100
"""Instant that is later than all others."""

NO_POSITION = 1 << 100
"""Larger than the positions of all records."""

WIDE_STEP_FACTOR = 10
"""A step between two records is wide if it is at least this many times the mean of the other steps."""

_EPOCHS = count()

MemoryRecord = Tuple[Term, int, int]
"""The record of an event, and the start and end of the event's interval, as instants."""


RECORDS_PER_CHECK = 1024
"""Records after which cancellation and limits of the goal are checked."""

_NO_POSITIONS: List[int] = []


class RecordIndex:
    """Positions of the records of a memory by one of their arguments.

    Each look-up first adds the records since the last one. The index belongs to the list of records; when the memory
    replaces its lists, once in a quarter of its size, the index is dropped.
    """

    __slots__ = ("_argument_position", "_records", "_indexed_count", "_positions", "_unindexed_positions")

    def __init__(self, records: List[MemoryRecord], argument_position: int):
        self._argument_position = argument_position
        self._records = records
        self._indexed_count = 0
        self._positions: Dict[Any, List[int]] = {}
        self._unindexed_positions: List[int] = []
        """Positions of records whose argument is a variable, a compound term or the like."""

    def positions_of(self, value: Any) -> List[int]:
        """Return the positions of all records that may have this atom or integer as the argument, in order."""
        argument_position, records = self._argument_position, self._records
        for index in range(self._indexed_count, len(records)):
            term: Any = deref(records[index][0])
            argument = (
                deref(term[argument_position])
                if term.__class__ is tuple and argument_position < len(term)
                else None
            )
            if argument.__class__ is Atom or argument.__class__ is int:
                self._positions.setdefault(argument, []).append(index)
            elif argument is not None:
                self._unindexed_positions.append(index)
            # Updated for each record: `check_limits` may raise, and a record must not be added twice.
            self._indexed_count = index + 1
            if not index % RECORDS_PER_CHECK:
                check_limits(RECORDS_PER_CHECK)
        positions = self._positions.get(value, _NO_POSITIONS)
        return sorted(positions + self._unindexed_positions) if self._unindexed_positions else positions


class Memory:
    """A bounded history, ordered by end time; records with equal ends stay in order of arrival.

    Adding at the end and look-ups do not depend on the size, except for the logarithm of a binary search. Only the
    last ``size`` entries of the lists count. Lists are replaced, never shortened or reordered in place, so a reader
    of an older list is not disturbed by later changes.

    Args:
        size: maximum number of records.
        on_wide_gap: called with both ends if a look-up falls between records that may be unusually far apart.

    Attributes:
        size: maximum number of records.
        trim_length: length of the lists at which they are cut.
        late_count: number of events that were rejected because they were older than all records of a full memory.
        ends: ends of the records as plain integers, which compare faster than other forms of instants; read-only
            outside of this package.
        records: the records, at the same positions.
        indices: indexes of the records, by the position of the indexed argument; see `candidate_positions`.
        first_changed_position: position of the first record that an insertion out of order has moved, counted from
            the first record ever; `NO_POSITION` if all records have arrived in order since this was set.
    """

    __slots__ = (
        "size",
        "trim_length",
        "late_count",
        "ends",
        "records",
        "indices",
        "_on_wide_gap",
        "first_changed_position",
        "_epoch",
        "_removed_count",
    )

    def __init__(self, size: int, on_wide_gap: Callable[[int, int], object] = lambda start, end: None):
        self.size = size
        self.trim_length = size + size // 4 + 16
        self.late_count = 0
        self._removed_count = 0
        self._epoch = next(_EPOCHS)
        self.first_changed_position = NO_POSITION
        self.ends: List[int] = []
        self.records: List[MemoryRecord] = []
        self.indices: Dict[int, RecordIndex] = {}
        self._on_wide_gap = on_wide_gap

    def clear(self) -> None:
        """Remove all records; the counters remain."""
        self._epoch = next(_EPOCHS)
        self._replace_records(self._removed_count + len(self.ends), [], [])

    def drop_after(self, instant: int) -> None:
        """Remove the records that end after an instant; they would be the newest ones until then."""
        position = bisect_right(self.ends, instant)
        if position < len(self.ends):
            self._epoch = next(_EPOCHS)
            self.first_changed_position = min(self.first_changed_position, self._removed_count + position)
            self._replace_records(self._removed_count, self.ends[:position], self.records[:position])

    def _replace_records(self, removed_count: int, ends: List[int], records: List[MemoryRecord]) -> None:
        self.indices = {}
        self._removed_count, self.ends, self.records = removed_count, ends, records

    @property
    def oldest_number(self) -> int:
        """Number of records before the first one that counts; the newest record always counts."""
        return self._removed_count + max(0, len(self.ends) - max(self.size, 1))

    def records_since(self, count: int) -> Tuple[int, List[MemoryRecord]]:
        """Return the records after the first ``count`` ones, and the number of records before the first of them."""
        first_position = max(self.oldest_number, min(count, self.added_count))
        return first_position, self.records[first_position - self._removed_count :]

    def restore(self, removed_count: int, late: int, ends: List[int], records: List[MemoryRecord]) -> None:
        """Set the records of another memory."""
        self._epoch = next(_EPOCHS)
        self.late_count = late
        self._replace_records(removed_count, ends, records)

    def __len__(self) -> int:
        return min(len(self.ends), self.size)

    @property
    def added_count(self) -> int:
        """Number of records that were ever added."""
        return self._removed_count + len(self.ends)

    @property
    def version(self) -> Tuple[int, int]:
        """A value that changes with the records and is unique among all memories."""
        return self._epoch, self.added_count

    @property
    def latest_end(self) -> Optional[int]:
        """The largest end of all events so far; None before the first."""
        return self.ends[-1] if self.ends else None

    def add(self, record: MemoryRecord) -> bool:
        """Add a record; return False if it is older than all records of a full memory."""
        ends = self.ends
        end = int(record[2])
        if ends and end < ends[-1]:
            return self._insert(record, end)
        ends.append(end)
        self.records.append(record)
        if len(ends) >= self.trim_length:
            self.trim()
        return True

    def _insert(self, record: MemoryRecord, end: int) -> bool:
        ends, records = self.ends, self.records
        position = bisect_right(ends, end)
        # The record would be older than all that count, and would be cut immediately.
        if self.size and position <= len(ends) - self.size:
            self.late_count += 1
            return False
        self.first_changed_position = min(self.first_changed_position, self._removed_count + position)
        self._replace_records(
            self._removed_count,
            [*ends[:position], end, *ends[position:]],
            [*records[:position], record, *records[position:]],
        )
        self.trim()
        return True

    def trim(self) -> None:
        """Remove the entries beyond the size; the newest one remains even if the size is 0, for `latest_end`."""
        first_position = max(0, len(self.ends) - max(self.size, 1))
        self._replace_records(
            self._removed_count + first_position, self.ends[first_position:], self.records[first_position:]
        )

    def at_or_before(self, instant: int) -> Optional[MemoryRecord]:
        """Return the last record whose end is not after ``instant``."""
        ends = self.ends
        position = bisect_right(ends, instant) - 1
        if position < 0 or position < len(ends) - self.size:
            return None
        return self.records[position]

    def at_or_after(self, instant: int) -> Optional[MemoryRecord]:
        """Return the first record whose end is not before ``instant``."""
        ends = self.ends
        record_count = len(ends)
        first_position = record_count - self.size
        position = (
            bisect_left(ends, instant) if first_position <= 0 else bisect_left(ends, instant, first_position)
        )
        if position >= record_count:
            return None
        # For the first record, `ends[-1]` is the newest end: the difference is not positive, and no gap is noted.
        start, end = ends[position - 1], ends[position]
        if (end - start) * (record_count + WIDE_STEP_FACTOR - 2) >= WIDE_STEP_FACTOR * (
            ends[-1] - ends[0]
        ) and start < end:
            # At least `WIDE_STEP_FACTOR` times the mean of the other steps.
            self._on_wide_gap(start, end)
        return self.records[position]

    def around(self, instant: int) -> Optional[Tuple[MemoryRecord, MemoryRecord]]:
        """Return the results of `at_or_before` and `at_or_after`; None unless both exist."""
        ends = self.ends
        record_count = len(ends)
        position = bisect_right(ends, instant)
        if position < 1 or position <= record_count - self.size:
            return None
        start = ends[position - 1]
        # A record at the instant itself is both the last one before and the first one after it.
        if start == instant:
            return self.records[position - 1], self.records[
                bisect_left(ends, instant, max(0, record_count - self.size), position)
            ]
        if position >= record_count:
            return None
        end = ends[position]
        # As in `at_or_after`.
        if (end - start) * (record_count + WIDE_STEP_FACTOR - 2) >= WIDE_STEP_FACTOR * (ends[-1] - ends[0]):
            self._on_wide_gap(start, end)
        return self.records[position - 1], self.records[position]

    @property
    def first_position(self) -> int:
        """Position of the oldest record that counts."""
        return max(0, len(self.ends) - self.size)

    def position_after(self, instant: int) -> int:
        """Return the position after all records whose ends are not after ``instant``."""
        return bisect_right(self.ends, instant, self.first_position)

    def position_reaching(self, instant: int) -> int:
        """Return the position of the first record whose end is not before ``instant``."""
        return bisect_left(self.ends, instant, self.first_position)

    def newest_first(self) -> Iterator[MemoryRecord]:
        """Yield the present records, newest first."""
        records = self.records
        for position in range(len(records) - 1, max(0, len(records) - self.size) - 1, -1):
            yield records[position]

    def candidate_positions(self, pattern: Term) -> Union[List[int], range]:
        """Return the positions of the records that may unify with a term, in order.

        Positions of records that no longer count are included; the caller selects a range of positions.
        """
        pattern = deref(pattern)
        positions: Union[List[int], range] = range(len(self.records))
        if pattern.__class__ is tuple:
            for argument_position, argument in enumerate(pattern[1:], 1):
                value = deref(argument)
                if value.__class__ is Atom or value.__class__ is int:
                    index = self.indices.get(argument_position)
                    if index is None:
                        index = self.indices[argument_position] = RecordIndex(self.records, argument_position)
                    # Of several indexed arguments, the one with the fewest records is used.
                    indexed_positions = index.positions_of(value)
                    if len(indexed_positions) < len(positions):
                        positions = indexed_positions
        return positions


UPDATED = functor("memory_updated", 2)


QueryEntry = Tuple[Any, ...]
"""A pending query of `PendingQueries`; its first item is its order, which is unique and increases."""

UpdateAction = Callable[["MemoryInstance", int, Frame], Frame]
"""Takes an instance that has recorded an event, the end of the event, and the next frame.

Returns the frame to continue with.
"""


class QueryQueue:
    """Queries that wait until something has reached an instant.

    Attributes:
        next_instant: smallest instant that a query waits for.
        instants: heap of the instants that are waited for; some may have no query any more.
        queries: the queries, by instant and order.
    """

    __slots__ = ("next_instant", "instants", "queries")

    def __init__(self) -> None:
        self.next_instant = NEVER
        self.instants: List[int] = []
        self.queries: Dict[int, Dict[Any, QueryEntry]] = {}

    def add_query(self, instant: int, order: Any, query: QueryEntry) -> None:
        """Store a query under its order until `pop_reached` is called with its instant or a later one."""
        queries_at_instant = self.queries.get(instant)
        if queries_at_instant is not None:
            queries_at_instant[order] = query
            return
        # One heap entry per instant: queries about one instant, the usual case, share it.
        self.queries[instant] = {order: query}
        heappush(self.instants, instant)
        if instant < self.next_instant:
            self.next_instant = instant

    def pop_reached(self, end: int) -> List[QueryEntry]:
        """Remove and return the queries that wait for an instant or an earlier one."""
        instants = self.instants
        queries: List[QueryEntry] = []
        while instants and instants[0] <= end:
            queries += self.queries.pop(heappop(instants), _NO_QUERIES).values()
        self.next_instant = instants[0] if instants else NEVER
        return queries

    def remove_query(self, instant: int, order: Any) -> None:
        """Remove a query."""
        queries_at_instant = self.queries[instant]
        del queries_at_instant[order]
        if not queries_at_instant:
            del self.queries[instant]
            # An instant cannot be removed from the middle of a heap; the heap is rebuilt when most of it is stale.
            if len(self.instants) > 2 * len(self.queries) + _STALE_TOLERANCE:
                self.instants = list(self.queries)
                heapify(self.instants)

    def clear_queries(self) -> None:
        """Remove all queries."""
        self.next_instant = NEVER
        self.instants = []
        self.queries = {}


class MemoryInstance(QueryQueue):
    """A memory with its name, its recorder, and the queries that wait for it.

    Args:
        name: its name, any ground term.
        size: maximum number of records.
        active: see below.
        definition: see below.
        note_gap: called with the instance and both ends if a look-up falls between records that may be unusually far
            apart.

    Attributes:
        id: its name, any ground term.
        active: whether its creation, updates and deletion are reported as events.
        definition: its definition ``(Functor, Pattern, Conditions, Template, Id, Size)``.
        memory: its records.
        recorder: the recorder that fills it.
        has_variables: whether records may contain variables, so that a reader needs a copy.
    """

    __slots__ = ("id", "active", "definition", "memory", "recorder", "has_variables")

    recorder: "Recorder"

    def __init__(
        self,
        name: Term,
        size: int,
        active: bool,
        definition: Term,
        note_gap: "Callable[[MemoryInstance, int, int], object]",
    ):
        super().__init__()
        self.id = name
        self.definition = definition
        self.memory = Memory(size, partial(note_gap, self))
        self.active = active
        self.has_variables = False

    @property
    def key(self) -> Hashable:
        """Key that is equal for memories with identical definitions."""
        return self.active, term_key(self.definition)

    @property
    def latest_end(self) -> Optional[int]:
        """The largest end of all events so far; None before the first."""
        return self.memory.latest_end

    def has_reached(self, instant: int) -> bool:
        """Return whether the watermark has reached an instant: an event that ends then or later was recorded."""
        ends = self.memory.ends
        return bool(ends) and ends[-1] >= instant


_NO_QUERIES: Dict[int, QueryEntry] = {}
_STALE_TOLERANCE = 16


class Recorder:
    """Listener to one event pattern that adds records to memories with equal definitions, in order of their creation.

    As the code of a frame it continues with the remaining memories.

    Args:
        recording: the recording function, and whether it makes a ground record of a ground event.
        on_update: takes instance, end and next frame; returns the frame that processes the update.
        find: returns the memory with an id, or None.
        key: equal for recorders with the same pattern, conditions and template; None if that is not known.
        unused: variables of the pattern whose values are not used.

    Attributes:
        records_all_events: whether the pattern is a variable.
    """

    def __init__(
        self,
        dispatcher: Dispatcher,
        pattern: Term,
        recording: Tuple[Recording, bool],
        on_update: UpdateAction,
        find: Callable[[Term], Optional[MemoryInstance]],
        key: Hashable,
        unused: AbstractSet[Var],
    ):
        self.key = key
        self.instances: Tuple[MemoryInstance, ...] = ()
        self._dispatcher = dispatcher
        self._create_record, self._preserves_ground = recording
        self._on_update = on_update
        self._find = find
        self._updates = dispatcher.event_filter(UPDATED)
        self.records_all_events = pattern.__class__ is Var
        self.listener = dispatcher.listen(
            ListenerPhase.MEMORIES, pattern, self._record_event, unread_variables=unused
        )

    @property
    def pattern(self) -> Term:
        """The event pattern."""
        return self.listener.pattern

    def add(self, instance: MemoryInstance) -> None:
        """Add a memory."""
        instance.recorder = self
        self.instances = (*self.instances, instance)

    def remove(self, instance: MemoryInstance) -> None:
        """Remove a memory; without memories the recorder stops listening."""
        self.retain(lambda other: other is not instance)

    def retain(self, predicate: Callable[[MemoryInstance], bool]) -> None:
        """Retain the memories that satisfy a predicate; without memories the recorder stops listening."""
        self.instances = tuple(filter(predicate, self.instances))
        if not self.instances:
            self._dispatcher.remove(self.listener)

    def _record_event(self, term: Term, values: Values, start: int, end: int, frame: Frame) -> Frame:
        if self.records_all_events and self._is_update_of_all_events(term):
            return frame
        dispatcher = self._dispatcher
        ground = dispatcher.current[GROUND]
        # Computed once per event and cached for all listeners.
        if ground is None:
            ground = dispatcher.ground()
        record_term = self._create_record(term, values, ground)
        if record_term is None:
            return frame
        has_variables = not (self._preserves_ground and ground) and not is_ground(record_term)
        return self._add_to_memories((record_term, start, end), has_variables, iter(self.instances), frame)

    def run(self, frame: Frame) -> Frame:
        """Continue with the remaining memories; the frame holds the arguments of `_add_to_memories`."""
        return self._add_to_memories(*frame[1:])

    def _add_to_memories(
        self, record: MemoryRecord, has_variables: bool, instances: Iterator[MemoryInstance], frame: Frame
    ) -> Frame:
        end = int(record[2])
        has_update_listeners = self._updates.plan is not NO_LISTENERS
        for instance in instances:
            if has_variables:
                instance.has_variables = True
            memory = instance.memory
            ends = memory.ends
            if ends and end < ends[-1]:
                if not memory.add(record):
                    continue
            else:  # `Memory.add` inlined: with a call, 20 memories that record every event take 26 % more time
                ends.append(end)
                memory.records.append(record)
                if len(ends) >= memory.trim_length:
                    memory.trim()
            # The frame contains the iterator, so that the recording continues with the next memory after the queries
            # and reports of this one.
            if instance.next_instant <= end or (has_update_listeners and instance.active):
                resumption = (self, record, has_variables, instances, frame)
                next_frame = self._on_update(instance, record[2], resumption)
                if next_frame is not resumption:
                    return next_frame
        return frame

    def _is_update_of_all_events(self, term: Term) -> bool:
        """Return whether an event reports an update of a memory that records all events, this one or another."""
        # A record of such an event would be an update again, and so on without end: of this memory by itself, or of
        # two memories by each other.
        if term.__class__ is not tuple or term[0] is not UPDATED:
            return False
        instance = self._find(term[1])
        return instance is not None and instance.recorder.records_all_events
