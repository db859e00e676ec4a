"""What Python interpreters differ in: CPython counts who holds an object, PyPy looks for it now and then.

Whatever holds for one of them only stands here, in two versions of the same; no other module names it.
"""

import gc
import os
import sys
from importlib.util import find_spec
from types import CodeType
from typing import Any, Callable, Dict, List
from weakref import ref

PYPY = sys.implementation.name == "pypy"

LONG_DECIMALS = find_spec("_decimal") is not None
"""Whether numbers of `decimal` are fast: where a PyPy has them in Python only, long ones take minutes."""

O_PATH = getattr(os, "O_PATH", 0)
"""Opens a folder without reading what is in it; a Python that has no name for it opens it to be read."""

remove_dead: Callable[[Dict[Any, Any], Any], None]
"""Takes a weak reference whose object is gone out of a table, by its key and in one step; leaves any other."""

SEEN_AT: int
"""How many objects make it worth asking `seen_elsewhere`; PyPy walks all that there is for it."""

if not PYPY:
    from _weakref import _remove_dead_weakref  # type: ignore[attr-defined]
    from sys import getrefcount, getsizeof

    remove_dead = _remove_dead_weakref
    SEEN_AT = 20_000
    _alone = 1

    def seen_elsewhere(objects: List[Any], kind: type) -> List[Any]:
        """Empty a list of objects; return those that something else holds, and all that are of another class."""
        seen = []
        objects.reverse()
        while objects:  # first to last: what goes may have been the last to hold a later one
            one = objects.pop()
            if getrefcount(one) > _alone or one.__class__ is not kind:
                seen.append(one)
        return seen

    def confine(code: CodeType, names: Dict[str, Any], allowed: Dict[str, Any]) -> None:
        """Have code that is run with these names find no other built-in functions than those allowed."""
        names["__builtins__"] = allowed

    def releasing(release: Callable[[Any], None]) -> List[Any]:
        """Return a new list. What ``del`` takes off its end ends there, the last first, if nothing else holds it.

        Args:
            release: what it takes to end an item where the interpreter does not do so by itself.
        """
        return []

    if seen_elsewhere([object()], object):
        _alone = 2  # the argument counts as well, up to Python 3.13

    def text_size(text: str) -> int:
        """Return how many bytes a text takes."""
        return getsizeof(text)

else:
    import builtins
    from dis import get_instructions

    from __pypy__ import delitem_if_value_is  # type: ignore[import-not-found,unused-ignore]

    SEEN_AT = 500_000

    def _remove_dead(table: Dict[Any, Any], key: Any) -> None:
        reference = table.get(key)
        if reference is not None and reference() is None:
            delitem_if_value_is(table, key, reference)

    remove_dead = _remove_dead

    def seen_elsewhere(objects: List[Any], kind: type) -> List[Any]:
        """Empty a list of objects; return those that something else holds, and all that are of another class."""
        found = [ref(one) if one.__class__ is kind else one for one in objects]
        objects.clear()
        gc.collect()
        seen = [one() if one.__class__ is ref else one for one in found]
        return [one for one in seen if one is not None]

    class _Releasing(list):  # type: ignore[type-arg]
        """A list that tells of what is taken off its end."""

        __slots__ = ("release",)

        release: Callable[[Any], None]

        def __delitem__(self, where: Any) -> None:
            gone = self[where]
            super().__delitem__(where)
            while gone:
                self.release(gone.pop())

    def releasing(release: Callable[[Any], None]) -> List[Any]:
        """Return a new list. What ``del`` takes off its end is released then, the last first."""
        made = _Releasing()
        made.release = release
        return made

    def confine(code: CodeType, names: Dict[str, Any], allowed: Dict[str, Any]) -> None:
        """Refuse code that looks for other built-in functions than those allowed: it would find all of them.

        Raises:
            NameError: where it does.
        """
        for one in get_instructions(code):
            if one.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                name = one.argval
                if name not in names and name not in allowed and hasattr(builtins, name):
                    raise NameError(f"name {name!r} is not defined")
        for inner in code.co_consts:
            if inner.__class__ is CodeType:
                confine(inner, names, allowed)

    def text_size(text: str) -> int:
        """Return how many bytes a text takes at most."""
        return 64 + 4 * len(text)


class YoungCollector:
    """Garbage collection that walks new objects only, so that its pauses do not grow with the heap.

    CPython walks all objects of a generation in one go, about 100 ns for each. With many live objects, a
    collection of the second generation takes as long as one of the oldest. Here, what has survived a collection
    of the second generation is frozen: no later collection walks it. It is still freed when its last reference
    goes. Only objects in a reference cycle that becomes garbage after it was frozen remain; they are found by
    a collection of everything, which is due when the heap has grown more than can be explained.

    PyPy collects in small steps by itself; it is left alone.

    Args:
        explained: returns how many live records are known to the owner; called during a collection.
    """

    YOUNG = 2000
    """Number of new objects after which the youngest generation is collected."""
    MIDDLE = 2
    """Number of such collections after which the second generation is collected, of some 8,000 objects."""
    RARELY = 1_000_000
    """Number of those after which CPython would collect the oldest generation, most of which is frozen."""
    SPARE_BLOCKS = 4_000_000
    """Blocks of memory, of some 60 bytes, that may be garbage before everything is collected at work."""
    SPARE_BLOCKS_IDLE = 250_000
    """Blocks that may be garbage before everything is collected at a moment without work."""
    BLOCKS_OF_RECORD = 16
    """Blocks of memory that a record explains: a partial match with its event has ten."""

    def __init__(self, explained: Callable[[], int]):
        self._explained = explained
        self._usual = gc.get_threshold()
        self._full_due = False
        self._blocks = 0
        self._records = 0

    @property
    def _active(self) -> bool:
        return not PYPY and self._collected in gc.callbacks

    def start(self) -> None:
        """Collect and freeze what is not frozen yet, and walk only newer objects from now on."""
        gc.collect()
        if PYPY:
            return
        if not self._active:
            self._usual = gc.get_threshold()
            gc.callbacks.append(self._collected)
        self._begin_anew()
        # CPython delays a full collection until the survivors since the last one are a quarter of what that one left.
        # After a collection of nothing, this condition always holds.
        gc.collect()

    def stop(self) -> None:
        """Restore the thresholds from before `start`, and unfreeze everything."""
        if self._active:
            gc.callbacks.remove(self._collected)
            gc.set_threshold(*self._usual)
            gc.unfreeze()

    def collect_if_due(self) -> bool:
        """Collect everything if garbage may have gathered since the last time; for moments without work.

        It takes about 100 ns for each live object.

        Returns:
            Whether it did.
        """
        due = self._active and self._has_grown(1.25, self.SPARE_BLOCKS_IDLE)
        if due:
            gc.unfreeze()
            gc.collect()
            self._begin_anew()
        return due

    def _begin_anew(self) -> None:
        gc.freeze()
        self._full_due = False
        self._blocks = sys.getallocatedblocks()
        self._records = self._explained()
        if self._active:
            gc.set_threshold(self.YOUNG, self.MIDDLE, self.RARELY)

    def _has_grown(self, factor: float, blocks: int) -> bool:
        """Return whether the heap has grown past a limit, without what live records explain."""
        now = sys.getallocatedblocks()
        if now < self._blocks:  # what has gone must not hide what gathers
            self._blocks, self._records = now, self._explained()
        limit = factor * self._blocks + blocks
        if now <= limit:
            return False
        more = max(0, self._explained() - self._records)
        return now - self.BLOCKS_OF_RECORD * more > limit

    def _collected(self, phase: str, info: Dict[str, int]) -> None:
        """React to the end of a collection: freeze what is left, or have the next collection walk everything.

        A collection cannot be started from here, as one is running. With a threshold of 0, CPython makes the next
        one a full one, if what has survived since the last one is at least a quarter of what survived that one.
        """
        if phase == "start" or info["generation"] == 0:
            return
        if self._full_due:
            if info["generation"] == 2:
                self._begin_anew()
        elif self._has_grown(3, self.SPARE_BLOCKS):
            self._full_due = True
            gc.unfreeze()
            gc.set_threshold(self.YOUNG, self.MIDDLE, 0)
        else:
            gc.freeze()


def stop_collecting() -> None:
    """Exempt all objects from garbage collection; call it right before the process exits.

    CPython runs several full collections while it exits. Each one visits every object, to free memory that the system
    frees at once afterwards.
    """
    if not PYPY:
        gc.disable()
        gc.freeze()
