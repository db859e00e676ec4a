"""Python's cyclic garbage collector in a process that runs an engine."""

import gc

_YOUNG, _MIDDLE, _OLD = 50_000, 20, 100
"""How many new objects, and then how many collections, it takes to look at a generation."""

_USUAL = gc.get_threshold()


def relax() -> None:
    """Have the collector look rarely, and never at what is there by now; call it when all is loaded.

    Events leave no cycles behind. What they do leave, the records of memories and what waits, is found alive
    each time it is looked at: with Python's own settings a full memory of 16,384 records makes a look-up in
    it cost more than twice as much.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(_YOUNG, _MIDDLE, _OLD)


def tighten() -> None:
    """Undo `relax` and free the program that has ended; for a process that goes on with another one."""
    gc.unfreeze()
    gc.set_threshold(*_USUAL)
    gc.collect()
