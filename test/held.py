"""What an object keeps alive: how tests see that something is bounded or forgotten, wherever it is kept."""

import gc
from types import CodeType, FunctionType, ModuleType

OF_ALL = (type, ModuleType, CodeType)
"""What is there for all, and leads everywhere."""


def held(root, kind):
    """Return the objects of a kind that a root holds, itself or through others, weak references not counted."""
    seen, found, waiting = set(), [], [root]
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, OF_ALL):
            continue
        seen.add(id(one))
        if isinstance(one, kind):
            found.append(one)
        if isinstance(one, FunctionType):  # not its globals
            waiting += [one.__closure__, one.__defaults__, one.__kwdefaults__, one.__dict__]
        else:
            waiting += gc.get_referents(one)
    return found


def entries(root):
    """Return how many entries all the dictionaries have that a root holds."""
    return sum(map(len, held(root, dict)))
