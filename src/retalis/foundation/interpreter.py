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
    _USUAL = gc.get_threshold()
    _YOUNG, _MIDDLE, _OLD = 50_000, 20, 100
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

    def collect_rarely() -> None:
        """Have the garbage collector look after many new objects only, and never at what is there by now."""
        gc.freeze()
        gc.set_threshold(_YOUNG, _MIDDLE, _OLD)

    def collect_as_usual() -> None:
        """Undo `collect_rarely`."""
        gc.unfreeze()
        gc.set_threshold(*_USUAL)

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

    def collect_rarely() -> None:
        """Leave the garbage collector alone: it looks as often as the heap has grown by most of its size."""

    def collect_as_usual() -> None:
        """Leave it alone, too."""
