"""Python's garbage collector in a process that runs an engine."""

import gc

from ...foundation import collect_as_usual, collect_rarely


def relax() -> None:
    """Have the collector look rarely, and never at what is there by now; call it when all is loaded.

    Events leave no cycles behind. What they do leave, the records of memories and what waits, is found alive
    each time it is looked at: with CPython's own settings a full memory of 16,384 records makes a look-up in
    it cost more than twice as much.
    """
    gc.collect()
    collect_rarely()


def tighten() -> None:
    """Undo `relax` and free the program that has ended; for a process that goes on with another one."""
    collect_as_usual()
    gc.collect()
