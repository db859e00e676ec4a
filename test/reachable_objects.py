"""Objects reachable from a root: tests check with them that something is bounded or released."""

import gc
from types import CodeType, FunctionType, ModuleType
from typing import Any

SHARED_TYPES = (type, ModuleType, CodeType)
"""Types of objects that the whole process shares. Nearly everything is reachable from them: they are not followed."""


def reachable(root: Any, object_type: Any) -> Any:
    """Return the objects of a type that are reachable from a root, without weak references."""
    visited_ids, instances, pending = set(), [], [root]
    while pending:
        value = pending.pop()
        if id(value) in visited_ids or isinstance(value, SHARED_TYPES):
            continue
        visited_ids.add(id(value))
        if isinstance(value, object_type):
            instances.append(value)
        if isinstance(value, FunctionType):  # its globals are shared, too
            pending += [value.__closure__, value.__defaults__, value.__kwdefaults__, value.__dict__]
        else:
            pending += gc.get_referents(value)
    return instances


def count_entries(root: Any) -> int:
    """Return the number of entries of all dictionaries that are reachable from a root."""
    return sum(map(len, reachable(root, dict)))
