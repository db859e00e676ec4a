"""Objects reachable from a root: tests check with them that something is bounded or released."""

import gc
from types import CodeType, FunctionType, ModuleType

SHARED_TYPES = (type, ModuleType, CodeType)
"""Objects that the whole process shares; they lead to everything, so they are not followed."""


def reachable(root, kind):
    """Return the objects of a type that are reachable from a root, without weak references."""
    seen, instances, pending = set(), [], [root]
    while pending:
        value = pending.pop()
        if id(value) in seen or isinstance(value, SHARED_TYPES):
            continue
        seen.add(id(value))
        if isinstance(value, kind):
            instances.append(value)
        if isinstance(value, FunctionType):  # its globals are shared, too
            pending += [value.__closure__, value.__defaults__, value.__kwdefaults__, value.__dict__]
        else:
            pending += gc.get_referents(value)
    return instances


def count_entries(root):
    """Return the number of entries of all dictionaries that are reachable from a root."""
    return sum(map(len, reachable(root, dict)))
