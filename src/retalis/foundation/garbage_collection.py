"""Limits on the pauses of CPython's garbage collector in processes that run an engine.

After `limit_gc_pauses` CPython collects only young objects. Nodes, commands and long goals call `collect_if_grown`
regularly, and nodes `collect_when_idle`, which run the full collections that become due.
"""

import gc
import sys
from typing import Callable, Set
from weakref import WeakMethod


class YoungCollector:
    """Generational garbage collection whose pauses do not grow with the heap.

    CPython visits all objects of a generation in one pause, about 100 ns per object. With many live objects, a
    collection of the oldest generation takes 100 ms and more. This class sets thresholds with which CPython never
    starts one. Objects of that generation are still freed when their reference count drops to zero. Only reference
    cycles that become garbage later remain. They are found by a full collection, which runs when the heap has grown
    by more than the live records explain.

    The class has no callback in `gc.callbacks`. CPython ignores the errors of such callbacks, and may call one at the
    recursion limit. Python 3.8 then aborts the process ("Cannot recover from stack overflow") if the recursion
    continues, as that of the JSON decoder does; later versions print a traceback.

    Args:
        count_live_records: returns the number of live records that the owner knows.
    """

    YOUNG_THRESHOLD = 2000
    """Number of new objects that triggers a collection of the youngest generation."""
    MIDDLE_THRESHOLD = 2
    """Number of such collections that triggers one of the second generation, of some 8,000 objects."""
    OLD_THRESHOLD = 2**31 - 1
    """Number of those that would trigger a collection of the oldest generation: the maximum, so that none does."""
    COLLECTIONS_PER_CHECK = 50
    """Collections of the second generation between two checks of the heap: growth by some 300,000 objects.

    On Python 3.11, a check takes 5 ms in a process of 1 GB.
    """
    MAX_GARBAGE_BLOCKS = 4_000_000
    """Memory blocks of about 60 bytes that may be garbage before a full collection while events are processed."""
    MAX_GARBAGE_BLOCKS_IDLE = 250_000
    """Memory blocks that may be garbage before a full collection at idle times."""
    BLOCKS_PER_RECORD = 16
    """Memory blocks that a live record explains: a partial match with its event has ten."""

    def __init__(self, count_live_records: Callable[[], int]):
        self._count_live_records = count_live_records
        self._default_thresholds = gc.get_threshold()
        self._checked_count = 0
        """Number of collections of the second generation at the last check, counted since the last full one."""
        self._blocks = 0
        self._records = 0
        """Number of memory blocks and of live records after the last full collection, or when there were fewest."""

    @property
    def _is_active(self) -> bool:
        return gc.get_threshold()[2] == self.OLD_THRESHOLD

    def start(self) -> None:
        """Collect all garbage, and start to visit only young objects."""
        if not self._is_active:
            self._default_thresholds = gc.get_threshold()
        gc.set_threshold(self.YOUNG_THRESHOLD, self.MIDDLE_THRESHOLD, self.OLD_THRESHOLD)
        self._collect()

    def stop(self) -> None:
        """Restore the thresholds from before `start`."""
        if self._is_active:
            gc.set_threshold(*self._default_thresholds)

    def collect_if_grown(self) -> None:
        """Run a full collection if the heap has grown to a multiple of its size; call this regularly.

        A call takes less than 1 µs, except after `COLLECTIONS_PER_CHECK` collections.
        """
        count = gc.get_count()[2]
        # The count is lower than at the last check if another part of the process has run a full collection.
        if abs(count - self._checked_count) >= self.COLLECTIONS_PER_CHECK and self._is_active:
            self._checked_count = count
            if self._has_grown(3, self.MAX_GARBAGE_BLOCKS):
                self._collect()

    def collect_if_due(self) -> bool:
        """Run a full collection if garbage may have accumulated since the last one; call this at idle times.

        It takes about 100 ns per live object.

        Returns:
            True if a collection was run.
        """
        is_due = self._is_active and self._has_grown(1.25, self.MAX_GARBAGE_BLOCKS_IDLE)
        if is_due:
            self._collect()
        return is_due

    def _collect(self) -> None:
        gc.collect()
        self._checked_count = 0
        self._blocks = sys.getallocatedblocks()
        self._records = self._count_live_records()

    def _has_grown(self, factor: float, blocks: int) -> bool:
        """Return whether the heap has grown beyond a limit, apart from the growth that live records explain."""
        now = sys.getallocatedblocks()
        # Blocks that were freed since then must not hide new garbage: measure growth from the smaller heap.
        if now < self._blocks:
            self._blocks, self._records = now, self._count_live_records()
        # Proportional to the heap, so that the total cost of full collections stays linear in what is allocated.
        limit = factor * self._blocks + blocks
        if now <= limit:
            return False
        added_records = max(0, self._count_live_records() - self._records)
        return now - self.BLOCKS_PER_RECORD * added_records > limit


CountRecords = Callable[[], int]
"""Returns the number of records of an engine, which are live heap."""

_record_counters: "Set[WeakMethod[CountRecords]]" = set()


def _count_records() -> int:
    methods = [reference() for reference in list(_record_counters)]
    return sum(count_records() for count_records in methods if count_records is not None)


_collector = YoungCollector(_count_records)


def add_live_records(count_records: CountRecords) -> None:
    """Treat the records that a method counts as live heap, as long as its object exists."""
    _record_counters.add(WeakMethod(count_records, _record_counters.discard))


def limit_gc_pauses() -> None:
    """Limit pauses by Python's garbage collector to a few milliseconds. Call this after the program is loaded.

    By default CPython walks all live objects again and again, about 100 ns each: with a million partial matches,
    single events wait for some 400 ms. From this call on, only new objects are walked, some 8,000 at a time. An
    object is freed as before when its last reference goes; only objects in a reference cycle need the collector.
    Cycles that become garbage later are collected by `collect_when_idle`. Nodes, commands and long goals also collect
    them when the heap has grown to three times its size plus 4,000,000 blocks of memory of about 60 bytes. Memory
    that the records of engines use does not count as growth.

    This function changes a setting of the whole process, the thresholds of the collector. The nodes and the commands
    call it; an `Engine` does not. `restore_gc` undoes it.

    >>> limit_gc_pauses()
    >>> restore_gc()
    """
    _collector.start()


def collect_when_idle() -> bool:
    """Collect all garbage if enough may have accumulated; call this when a pause does not delay any event.

    The pause is as long as without `limit_gc_pauses`, which must be called before. Memory that the records of engines
    use does not count as garbage, so most calls only compare two numbers.

    >>> collect_when_idle()
    False

    Returns:
        Whether garbage was collected.
    """
    return _collector.collect_if_due()


def collect_if_grown() -> None:
    """Collect all garbage if the heap has grown to a multiple of its size; call this regularly.

    Most calls only compare two numbers.
    """
    _collector.collect_if_grown()


def restore_gc() -> None:
    """Undo `limit_gc_pauses` and collect all garbage, for a process that continues with another program.

    >>> restore_gc()
    """
    stop_limiting_gc_pauses()
    gc.collect()


def stop_limiting_gc_pauses() -> None:
    """Undo `limit_gc_pauses` without a collection, which takes about 100 ns per live object."""
    _collector.stop()


def stop_collecting() -> None:
    """Disable garbage collection for all objects; call this immediately before the process exits.

    CPython runs several full collections at exit. Each visits every object, only to free memory that the operating
    system reclaims anyway.
    """
    gc.disable()
    gc.freeze()
