"""Keeps the stack on which a thread's signals are handled: SWI-Prolog puts one of each new engine's in its place.

That one is given back with the engine, and Python goes on to handle the thread's signals there: in memory that is
somebody else's by then. So the thread has its own back as soon as the engine is made.
"""

from contextlib import contextmanager
from ctypes import CDLL, CFUNCTYPE, Structure, byref, c_int, c_size_t, c_void_p
from functools import partial
from typing import Iterator, List, Tuple

_C = CDLL(None)

Doing = CFUNCTYPE(c_int)
"""The kind of a predicate without arguments that is a function of ours."""


class _SignalStack(Structure):
    """Linux's ``stack_t``; one that says "none" can be set like others."""

    _fields_ = [("place", c_void_p), ("flags", c_int), ("size", c_size_t)]


@contextmanager
def signal_stack_kept() -> Iterator[None]:
    """Have this thread handle its signals afterwards where it has handled them before."""
    before = _SignalStack()
    _C.sigaltstack(None, byref(before))
    try:
        yield
    finally:
        _C.sigaltstack(byref(before), None)


def steps_of_keeping() -> List[Tuple[str, object]]:
    """Return the same for engines that goals make, as two predicates: one goal at a time may be between them.

    They fail, as 0 is what C says where all is well. No code in Python runs in them: a signal that comes meanwhile
    would have its handler raise something here, where nobody can take it.
    """
    before = _SignalStack()
    return [
        ("$retalis_note_stack", Doing(partial(_C.sigaltstack, None, byref(before)))),
        ("$retalis_put_stack_back", Doing(partial(_C.sigaltstack, byref(before), None))),
    ]
