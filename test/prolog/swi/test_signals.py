"""Signals that Python handles in a process that uses SWI-Prolog."""

import contextlib
import ctypes
import gc
import signal
import threading

import pytest
from interrupts.idle_engine_checks import faults
from interrupts.injection import AtBytecode, Interrupt


class Stack(ctypes.Structure):
    """Linux's ``stack_t``."""

    _fields_ = [("place", ctypes.c_void_p), ("flags", ctypes.c_int), ("size", ctypes.c_size_t)]


def signal_stack():
    """Return where this thread handles its signals."""
    found = Stack()
    ctypes.CDLL(None).sigaltstack(None, ctypes.byref(found))
    return found.place, found.flags, found.size


@pytest.fixture
def alarms():
    """Have the signal of alarms raise an `Interrupt`."""

    def take(number, frame):
        raise Interrupt

    before = signal.signal(signal.SIGALRM, take)
    yield
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("goal", ["upto(3, X)", "engines(X)"])
def test_a_thread_handles_its_signals_where_it_did_before(program, goal):
    """Else it is on memory that goes with an engine, and what is there by then is written over."""
    before = signal_stack()
    engine = program()
    assert engine.query(goal)
    assert signal_stack() == before
    found = []

    def ask():
        found.append(signal_stack())
        assert engine.query(goal)
        found.append(signal_stack())

    other = threading.Thread(target=ask)
    other.start()
    other.join()
    assert found[0] == found[1]
    engine = None
    gc.collect()
    assert signal_stack() == before


def test_a_signal_that_comes_before_it_asks_back_is_not_lost(engine, alarms, capfd):
    """Its handler runs where Python code begins, which SWI-Prolog has called."""
    for _ in range(5):
        with pytest.raises(Interrupt):
            engine.query("pokes(X)")
        assert [one["X"] for one in engine.query("upto(2, A), inc(A, X)")] == [2, 3]
        assert len(engine.query("asks(near(a, _), X)")) == 1
    assert capfd.readouterr().err == ""


def test_a_signal_that_comes_while_it_answers_ends_the_goal(engine, alarms):
    with pytest.raises(Interrupt):
        engine.query("pokes_later(X)")
    assert len(engine.query("upto(2, A), inc(A, X)")) == 2


class AtSession(AtBytecode):
    """Raises an interrupt before the n-th bytecode of what has goals open in SWI-Prolog."""

    def _call(self, frame, event, argument):
        if not frame.f_code.co_filename.endswith(("swi/swi_session.py", "swi/swi_terms.py")):
            return None
        return super()._call(frame, event, argument)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # as solutions are let go
@pytest.mark.parametrize("goal", ["upto(2, X), inc(X, Y)", "asks(upto(1, _), X)", "catch(bad(X), _, true)"])
def test_an_interrupt_anywhere_leaves_nothing_open(engine, goal):
    expected = len(engine.query(goal))
    at = 0
    where = True
    while where is not None:
        at += 3
        with contextlib.suppress(Interrupt), AtSession(at) as injected:
            engine.query(goal)
        where = injected.where
        assert len(engine.query(goal)) == expected, where
        assert faults(engine) == [], where
    assert at > 300
