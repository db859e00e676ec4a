"""Signals that Python handles in a process that uses SWI-Prolog."""

import ctypes
import gc
import signal
import threading
from typing import Any, Iterator, List, Tuple

import pytest

from retalis.foundation.interrupts import Interrupt, deferred_interrupts


class Stack(ctypes.Structure):
    """Linux's ``stack_t``."""

    _fields_ = [("place", ctypes.c_void_p), ("flags", ctypes.c_int), ("size", ctypes.c_size_t)]


def signal_stack() -> Tuple[Any, ...]:
    """Return the alternate signal stack of this thread."""
    stack = Stack()
    ctypes.CDLL(None).sigaltstack(None, ctypes.byref(stack))
    return stack.place, stack.flags, stack.size


@pytest.fixture
def alarms() -> Iterator[None]:
    """Have the signal of alarms interrupt at safe points."""
    with deferred_interrupts(signal.SIGALRM):
        yield


@pytest.mark.parametrize("goal", ["upto(3, X)", "engines(X)"])
def test_signal_stack_of_thread_is_kept(program: Any, goal: str) -> None:
    """A stack inside an engine of SWI-Prolog would be freed with the engine."""
    before = signal_stack()
    engine = program()
    assert engine.query(goal)
    assert signal_stack() == before
    stacks: List[Any] = []

    def query() -> None:
        stacks.append(signal_stack())
        assert engine.query(goal)
        stacks.append(signal_stack())

    thread = threading.Thread(target=query)
    thread.start()
    thread.join()
    assert stacks[0] == stacks[1]
    engine = None
    gc.collect()
    assert signal_stack() == before


def test_signal_before_callback_is_handled(
    engine: Any, alarms: None, capfd: pytest.CaptureFixture[str]
) -> None:
    """The handler runs when the callback enters Python."""
    for _ in range(5):
        with pytest.raises(Interrupt):
            engine.query("pokes(X)")
        assert [answer["X"] for answer in engine.query("upto(2, A), inc(A, X)")] == [2, 3]
        assert len(engine.query("asks(near(a, _), X)")) == 1
    assert capfd.readouterr().err == ""


def test_signal_after_callback_ends_goal(engine: Any, alarms: None) -> None:
    with pytest.raises(Interrupt):
        engine.query("pokes_later(X)")
    assert len(engine.query("upto(2, A), inc(A, X)")) == 2
