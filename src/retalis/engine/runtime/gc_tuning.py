"""Tuning of Python's garbage collector: limits of its pauses in processes that run an engine."""

import gc
from typing import TYPE_CHECKING
from weakref import WeakSet

from ...foundation.cpython_and_pypy import YoungCollector

if TYPE_CHECKING:
    from ..engine_status import StatusReader

_status_readers: "WeakSet[StatusReader]" = WeakSet()


def _count_records() -> int:
    return sum(reader.count_records() for reader in list(_status_readers))


_collector = YoungCollector(_count_records)


def count_records_of(engine: "StatusReader") -> None:
    """Treat the records of an engine as live heap, as long as the engine exists."""
    _status_readers.add(engine)


def limit_gc_pauses() -> None:
    """Limit pauses by Python's garbage collector to a few milliseconds. Call this after the program is loaded.

    By default CPython walks all live objects again and again, about 100 ns each: with a million partial matches,
    single events wait for some 400 ms. From this call on, only new objects are walked, some 8,000 at a time. An
    object is freed as before when its last reference goes; only objects in a reference cycle need the collector.
    Cycles that become garbage later are collected by `collect_when_idle`. At the latest they are collected when the
    heap has grown to three times its size plus 4,000,000 blocks of memory of about 60 bytes. Memory that the records
    of engines use does not count as growth.

    This function changes settings of the whole process: thresholds, frozen objects, and one callback in
    `gc.callbacks`. The nodes and the commands call it; an `Engine` does not. `restore_gc` undoes it.

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


def restore_gc() -> None:
    """Undo `limit_gc_pauses` and collect all garbage, for a process that continues with another program.

    >>> restore_gc()
    """
    _collector.stop()
    gc.collect()
