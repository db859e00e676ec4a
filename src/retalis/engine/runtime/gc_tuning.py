"""Tuning of Python's garbage collector: limits of its pauses in processes that run an engine."""

import gc
from typing import TYPE_CHECKING
from weakref import WeakSet

from ...foundation.interpreter_compatibility import YoungCollector

if TYPE_CHECKING:
    from ..engine_status import StatusReader

_holders: "WeakSet[StatusReader]" = WeakSet()


def _records() -> int:
    return sum(holder.held_records() for holder in list(_holders))


_collector = YoungCollector(_records)


def count_records_of(engine: "StatusReader") -> None:
    """Treat the records of an engine as live heap, as long as the engine exists."""
    _holders.add(engine)


def limit_gc_pauses() -> None:
    """Limit pauses by Python's garbage collector to a few milliseconds. Call this after the program is loaded.

    By default CPython walks all live objects again and again, about 100 ns each: with a million partial matches,
    single events wait for some 400 ms. From this call on, only new objects are walked, some 8,000 at a time. An
    object is freed as before when its last reference goes; only objects in a reference cycle need the collector.
    Cycles that become garbage late are collected by `collect_when_idle`, or at the latest when the heap has grown to
    three times its size plus 4,000,000 blocks of memory (of some 60 bytes), without what the records of engines
    explain.

    It changes the settings of the whole process: thresholds, frozen objects, and one callback in `gc.callbacks`. No
    `Engine` does that on its own; the nodes and the commands do. `restore_gc` undoes it.

    >>> limit_gc_pauses()
    >>> restore_gc()
    """
    _collector.start()


def collect_when_idle() -> bool:
    """Collect all garbage if enough may have gathered; call it where nothing waits for the next milliseconds.

    The pause is as long as without `limit_gc_pauses`, which has to be called before. Memory that the records of
    engines explain does not count as garbage, so that most calls only compare two numbers.

    >>> collect_when_idle()
    False

    Returns:
        Whether garbage was collected.
    """
    return _collector.collect_if_due()


def restore_gc() -> None:
    """Undo `limit_gc_pauses` and collect all garbage; for a process that goes on with another program.

    >>> restore_gc()
    """
    _collector.stop()
    gc.collect()
