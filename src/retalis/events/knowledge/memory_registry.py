"""Memory instances: creation, deletion, and access by name.

`MemoryInstances` owns the memories of a program. Memories are created and deleted by goals and services, filled by
recorders, and read by the predicates ``prev``, ``next``, ``prev_matching`` and others, which are defined here. Active
memories report creation, updates and deletion as events. If a program is reloaded, memories are detached; those
with an unchanged definition continue with their records.
"""

from bisect import bisect_left
from collections import Counter
from typing import Any, Callable, Dict, Hashable, Iterable, Iterator, List, Optional, Sequence, Tuple

from ...foundation.callbacks import CallbackList
from ...foundation.errors import UsageError
from ...foundation.limit_checks import check_limits
from ...prolog.builtins.tabling import tables_of
from ...prolog.builtins.time_predicates import instant_of
from ...prolog.machine.errors import domain_error, permission_error, type_error
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms import timestamps
from ...prolog.terms.term_traversal import copy, freeze, term_key
from ...prolog.terms.types import MINUS, NIL, Atom, Frame, Functor, Lazy, Term, Var, deref, functor
from ..dispatch.discrimination_tree import NO_LISTENERS
from ..dispatch.dispatcher import Dispatcher
from .memory import (
    RECORDS_PER_CHECK,
    UPDATED,
    MemoryInstance,
    MemoryRecord,
    Recorder,
    UpdateAction,
    Warn,
    check_recording_arguments,
    compile_recording,
    is_event_variable,
    key_of,
    unused_variables,
)

CREATED: Functor = functor("memory_created", 5)
DELETED: Functor = functor("memory_deleted", 1)
_NOTATION = "memorize(Pattern, Conditions, Template, Id, Size)"


class CountedInstances(Dict[Hashable, MemoryInstance]):
    """Memory instances by key that count their look-ups, for the coverage of a program by tests.

    Attributes:
        lookup_counts: number of look-ups by key, of instances that exist or existed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lookup_counts: Counter[Hashable] = Counter()

    def get(self, key: Hashable, default: Any = None) -> Any:
        """Return the instance with a key, or a default, and count the look-up."""
        self.lookup_counts[key] += key in self
        return super().get(key, default)


class MemoryInstances:
    """All memory instances of a program.

    Args:
        logic: the system in which the predicates are defined.
        dispatcher: dispatcher of the events that are recorded.
        stamp: returns the instant for an event of the clock.
        warn: receives reports about conditions that raised an error.
        note_gap: called with an instance and both ends if a look-up falls between records that may be unusually far
            apart.

    Attributes:
        instances: instances by the keys of their names.
        on_update: called when an instance has reached the instant of a pending query, with the instance, the end of
            the recorded event, and the next frame; each returns the frame to continue with.
    """

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        stamp: Callable[[], int],
        warn: Warn,
        note_gap: Callable[[MemoryInstance, int, int], object],
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._stamp = stamp
        self._warn = warn
        self._note_gap = note_gap
        counts_uses = logic.counted_clauses is not None
        self.instances: Dict[Hashable, MemoryInstance] = CountedInstances() if counts_uses else {}
        self._tables = tables_of(logic.machine)
        self._active_tables = self._tables.active
        self._newest_recorder: Optional[Recorder] = None
        self._detached: Dict[Hashable, MemoryInstance] = {}
        self._updates = dispatcher.event_filter(UPDATED)
        self.on_update: CallbackList[UpdateAction] = CallbackList()
        self.on_delete: CallbackList[Callable[[MemoryInstance], None]] = CallbackList()

    def __iter__(self) -> Iterator[MemoryInstance]:
        return iter(list(self.instances.values()))

    def find(self, name: Term) -> Optional[MemoryInstance]:
        """Return the instance with a name, or None.

        An incremental table that is being evaluated depends on the instance from then on.
        """
        # The usual case: an atom is its own key, and no table is being evaluated.
        if name.__class__ is Atom and not self._active_tables:
            return self.instances.get(name)
        try:
            key = freeze(deref(name))
        except ValueError:
            return None
        if self._active_tables:
            self._tables.record_read(self.version, key)
        return self.instances.get(key)

    def read_all(self) -> List[MemoryInstance]:
        """Return all instances.

        An incremental table that is being evaluated depends on the set of instances, and on each of them, from then
        on.
        """
        if self._active_tables:
            for key in (None, *self.instances):
                self._tables.record_read(self.version, key)
        if isinstance(self.instances, CountedInstances):
            self.instances.lookup_counts.update(self.instances.keys())
        return list(self.instances.values())

    def lookup_count(self, name: Term) -> int:
        """Return how often goals have looked up a memory; 0 if the engine does not count uses."""
        counts = self.instances.lookup_counts if isinstance(self.instances, CountedInstances) else {}
        return counts.get(key_of(name), 0)

    def version(self, part: Hashable) -> object:
        """Return a value that changes with the records of the memory with a key, or, for None, with the memories."""
        if part is None:
            return tuple(self.instances)
        instance = self.instances.get(part)
        return None if instance is None else instance.memory.version

    def clear(self) -> None:
        """Remove all records, because the clock went back; the instances remain."""
        for instance in self.instances.values():
            instance.memory.clear()

    def drop_after(self, instant: int) -> None:
        """Remove the records that end after an instant."""
        for instance in self.instances.values():
            instance.memory.drop_after(instant)

    def create(self, definition: Term, active: bool, frame: Frame) -> Frame:
        """Create a memory, and return the frame that reports it; the definition is as in `MemoryInstance`.

        Raises:
            PrologError: if the id is taken, or the arguments do not define a memory.
        """
        # The definition outlives the goal, whose variables are undone on backtracking.
        copied: Any = copy(definition)
        pattern, conditions, template, name, size = (deref(argument) for argument in copied[1:])
        check_recording_arguments(conditions, name, _NOTATION)
        key = key_of(name)
        if key in self.instances:
            raise permission_error("create", "memory", name, "one already exists: write another id")
        if size.__class__ is not int:
            raise type_error("integer", size, f"the size is a number of records: write {_NOTATION}")
        if size < 0:
            raise domain_error("not_less_than_zero", size)
        instance = MemoryInstance(name, size, active, copied, self._note_gap)
        detached_instance = self._detached.get(key)
        # Detached by a reload and unchanged: the memory keeps its records.
        if detached_instance is not None and detached_instance.key == instance.key:
            instance = self._detached.pop(key)
        recorder = self._find_or_create_recorder(pattern, conditions, template, name)
        self.instances[key] = instance
        recorder.add(instance)
        if not active or instance is detached_instance:
            return frame
        reported_record = pattern if is_event_variable(pattern, conditions, template) else template
        instant = self._stamp()
        return self._dispatcher.dispatch(
            (CREATED, pattern, conditions, reported_record, name, size), instant, instant, frame
        )

    def delete(self, name: Term, frame: Frame) -> Frame:
        """Delete a memory with its pending queries; return the frame that reports it.

        Raises:
            UsageError: if there is no such memory.
        """
        instance = self.find(name)
        if instance is None:
            raise UsageError(f"there is no memory {self._logic.brief(name)}")
        # The memory is gone before its deletion is reported: a listener may create a new one with the same name.
        del self.instances[key_of(instance.id)]
        instance.recorder.remove(instance)
        self._report_removal(instance)
        return self.report_deleted(instance, frame)

    def report_deleted(self, instance: MemoryInstance, frame: Frame) -> Frame:
        """Return the frame that reports the deletion of a memory."""
        if not instance.active:
            return frame
        instant = self._stamp()
        return self._dispatcher.dispatch((DELETED, instance.id), instant, instant, frame)

    def detach(self, instances: Iterable[MemoryInstance]) -> None:
        """Remove memories with their records; `create` uses them again for unchanged definitions."""
        for instance in instances:
            key = key_of(instance.id)
            del self.instances[key]
            instance.recorder.remove(instance)
            self._detached[key] = instance

    def discard_detached(self) -> List[MemoryInstance]:
        """Delete the memories that were detached and not created again, with their pending queries; return them."""
        deleted = list(self._detached.values())
        self._detached.clear()
        for instance in deleted:
            self._report_removal(instance)
        return deleted

    def _report_removal(self, instance: MemoryInstance) -> None:
        for callback in self.on_delete:
            callback(instance)

    def restore_all(self, instances: Sequence[MemoryInstance]) -> None:
        """Restore exactly these memories, whether or not they have been detached meanwhile."""
        self.detach(list(self.instances.values()))
        restored = set(instances)
        self._detached = {
            key: instance for key, instance in self._detached.items() if instance not in restored
        }
        self.discard_detached()
        self._detached = {key_of(instance.id): instance for instance in instances}
        done = self._logic.machine.done
        for instance in instances:
            self.create(instance.definition, instance.active, done)

    def create_unreported(self, definition: Any, active: bool) -> MemoryInstance:
        """Create a memory by its definition as `create` does, without reporting it."""
        _, _, _, _, name, size = definition
        instance = MemoryInstance(name, size, active, definition, self._note_gap)
        self._detached[key_of(name)] = instance
        self.create(definition, active, self._logic.machine.done)
        return instance

    def _find_or_create_recorder(
        self, pattern: Term, conditions: Term, template: Term, name: Term
    ) -> Recorder:
        """Return the recorder of the newest memory if it records the same of the same events, else a new one.

        Only the newest one is considered, because memories record an event in the order in which they were created.
        While an event is dispatched, a new recorder is created, because a memory that is created then must not record
        that event.
        """
        # Conditions may have side effects or depend on time, so their memories never share a recorder.
        can_share = conditions is NIL and pattern.__class__ is not Var
        key = term_key((MINUS, pattern, template)) if can_share else None
        newest_recorder = self._newest_recorder
        can_share_now = key is not None and self._dispatcher.current is None
        if (
            can_share_now
            and newest_recorder is not None
            and newest_recorder.instances
            and key == newest_recorder.key
        ):
            return newest_recorder
        title = f"memory {self._logic.brief(name)}"
        recording = compile_recording(
            self._logic, self._dispatcher, pattern, conditions, template, title, self._warn
        )
        unused = unused_variables(pattern, conditions, template)
        self._newest_recorder = Recorder(
            self._dispatcher, pattern, recording, self._process_update, self.find, key, unused
        )
        return self._newest_recorder

    def _process_update(self, instance: MemoryInstance, end: int, frame: Frame) -> Frame:
        """Return the frame that processes an update: first the pending queries, then the report of the update."""
        if instance.active and self._updates.plan is not NO_LISTENERS:
            instant = self._stamp()
            update = (UPDATED, instance.id, timestamps.to_term(end))
            # The report becomes the continuation of the queries, so they are called before its listeners.
            frame = (self, update, instant, frame)
        if instance.next_instant <= end:
            for process_update in self.on_update:
                frame = process_update(instance, end, frame)
        return frame

    def run(self, frame: Frame) -> Frame:
        """Report an update, as the code of the frame ``(self, update, instant, next frame)``."""
        next_frame: Frame
        _, update, instant, next_frame = frame
        try:
            return self._dispatcher.dispatch(update, instant, instant, next_frame)
        except UsageError as error:
            self._warn(
                f"the update of memory {self._logic.brief(update[1])} is not reported: {error}", UPDATED
            )
            return next_frame


def define_read_access(logic: PrologSystem, memories: MemoryInstances) -> None:
    """Define the predicates that look up one record by time: ``prev/5``, ``next/6`` and ``next_inf/5``."""
    get_instance, to_term = memories.instances.get, timestamps.to_term
    active_tables = tables_of(logic.machine).active

    def prev(name: Term, time: Any) -> Optional[MemoryRecord]:
        instance = get_instance(name) if name.__class__ is Atom and not active_tables else memories.find(name)
        if instance is None:
            return None
        # As in `instant_of`, without a call: a time that is not decoded yet has the instant as its source.
        is_unconverted = time.__class__ is Lazy and time.decoder is to_term and time.decoded_term is None
        record = instance.memory.at_or_before(time.source if is_unconverted else instant_of(time))
        return record if not instance.has_variables or record is None else _with_new_variables(record)

    def next_inf(name: Term, time: Any) -> Optional[MemoryRecord]:
        instance = get_instance(name) if name.__class__ is Atom and not active_tables else memories.find(name)
        if instance is None:
            return None
        # As in `prev`.
        is_unconverted = time.__class__ is Lazy and time.decoder is to_term and time.decoded_term is None
        record = instance.memory.at_or_after(time.source if is_unconverted else instant_of(time))
        return record if not instance.has_variables or record is None else _with_new_variables(record)

    def next_record(name: Term, low: Term, high: Term) -> Optional[MemoryRecord]:
        if memories.find(name) is None:
            return None
        record, last_instant = next_inf(name, low), instant_of(high)
        return None if record is None or record[2] > last_instant else record

    record_and_interval = (1, 2, 3)
    converters = (None, timestamps.lazy_term, timestamps.lazy_term)
    for key, function in (
        (functor("prev", 5), prev),
        (functor("prev_binary", 5), prev),
        (functor("next_inf", 5), next_inf),
        (functor("next", 6), next_record),
        (functor("next_binary", 6), next_record),
    ):
        logic.define_function(key.name, key.arity, function, record_and_interval, converters)


def _with_new_variables(record: MemoryRecord) -> MemoryRecord:
    """Return a copy of a record, because its variables must not be bound by the reader."""
    return copy(record[0]), record[1], record[2]


def enumerate_records(memories: MemoryInstances) -> Callable[..., Iterator[bool]]:
    """Return ``access_mem(Id, Record, [T1,T2])``, with a solution for each record, newest first."""

    def access(machine: Machine, name: Term, record: Term, interval: Term) -> Iterator[bool]:
        instance = memories.find(name)
        if instance is None:
            return
        for term, start, end in instance.memory.newest_first():
            returned_term = copy(term) if instance.has_variables else term
            record_interval = timestamps.interval_term(start, end)
            if machine.unify(record, returned_term) and machine.unify(interval, record_interval):
                yield True

    return access


def define_pattern_access(logic: PrologSystem, memories: MemoryInstances) -> None:
    """Define the deterministic predicates that search for the newest or next record that unifies with a term.

    ``prev/5`` and ``next_inf/5`` return the record nearest to an instant, whatever it contains. These predicates
    continue to the first record that unifies.
    """

    def unify_newest(machine: Machine, name: Term, record: Term, start: Term, end: Term) -> bool:
        instance = memories.find(name)
        if instance is None:
            return False
        memory = instance.memory
        return _unify_first(
            machine, instance, (record, start, end), memory.first_position, len(memory.ends), -1
        )

    def unify_prev(machine: Machine, name: Term, record: Term, start: Term, end: Term, time: Term) -> bool:
        instant, instance = instant_of(time), memories.find(name)
        if instance is None:
            return False
        memory = instance.memory
        return _unify_first(
            machine, instance, (record, start, end), memory.first_position, memory.position_after(instant), -1
        )

    def unify_next_inf(
        machine: Machine, name: Term, record: Term, start: Term, end: Term, time: Term
    ) -> bool:
        instant, instance = instant_of(time), memories.find(name)
        if instance is None:
            return False
        memory = instance.memory
        return _unify_first(
            machine, instance, (record, start, end), memory.position_reaching(instant), len(memory.ends), 1
        )

    def unify_next(
        machine: Machine, name: Term, record: Term, start: Term, end: Term, low: Term, high: Term
    ) -> bool:
        first_instant, last_instant, instance = instant_of(low), instant_of(high), memories.find(name)
        if instance is None:
            return False
        memory = instance.memory
        return _unify_first(
            machine,
            instance,
            (record, start, end),
            memory.position_reaching(first_instant),
            memory.position_after(last_instant),
            1,
        )

    logic.define("newest_matching", 4, unify_newest)
    logic.define("prev_matching", 5, unify_prev)
    logic.define("next_inf_matching", 5, unify_next_inf)
    logic.define("next_matching", 6, unify_next)


def _unify_first(
    machine: Machine,
    instance: MemoryInstance,
    target: Tuple[Term, Term, Term],
    start_position: int,
    end_position: int,
    step: int,
) -> bool:
    """Unify with the first matching record between two positions.

    Args:
        machine: the machine.
        instance: the memory.
        target: record, start and end to unify with.
        start_position: first position.
        end_position: position after the last one.
        step: 1 to search forwards, -1 to search backwards.
    """
    memory, (record, start, end) = instance.memory, target
    positions: Sequence[int] = memory.candidate_positions(record)
    low, high = bisect_left(positions, start_position), bisect_left(positions, end_position)
    order = range(low, high) if step > 0 else range(high - 1, low - 1, -1)
    for count, index in enumerate(order, 1):
        if not count % RECORDS_PER_CHECK:
            check_limits(RECORDS_PER_CHECK)
        term, start_instant, end_instant = memory.records[positions[index]]
        # Variables in a stored record belong to the memory; the reader gets new ones.
        record_term = copy(term) if instance.has_variables else term
        to_time_term = timestamps.lazy_term
        if machine.unify_all(
            (record, record_term), (start, to_time_term(start_instant)), (end, to_time_term(end_instant))
        ):
            return True
    return False
