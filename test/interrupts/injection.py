"""Interrupts: raised at the n-th bytecode of the engine's code, by a real signal, or by a limit that runs out."""

import contextlib
import signal
import sys
from itertools import count
from pathlib import Path

import retalis
from retalis import Limits
from retalis.prolog.machine import machine, resource_limits

_SOURCE = str(Path(retalis.__file__).parent)


class Interrupt(KeyboardInterrupt):
    """What an injected interrupt raises."""


def _is_engine(code):
    name = code.co_filename
    return (
        name.startswith((_SOURCE, "<", "retalis, "))
        and not name.startswith("<frozen")
        or name.endswith("contextlib.py")
    )


class Traced:
    """What watches each call while it is entered, by a method ``_call``."""

    def __enter__(self):
        self._before = sys.gettrace()
        sys.settrace(self._call)
        return self

    def __exit__(self, *exception):
        sys.settrace(self._before)

    def interrupt(self):
        """Raise an interrupt, and watch no more."""
        sys.settrace(None)
        raise Interrupt


class AtBytecode(Traced):
    """Raises an interrupt before the n-th bytecode; with none it counts them."""

    def __init__(self, at=None):
        self.at = at
        self.number = 0
        self.where = None

    def _call(self, frame, event, argument):
        if self.where is not None or not _is_engine(frame.f_code):
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        return self._step

    def _step(self, frame, event, argument):
        if event == "opcode":
            self.number += 1
            if self.number == self.at:
                self.where = (
                    f"{frame.f_code.co_filename}:{frame.f_lineno} ({frame.f_code.co_name}, {frame.f_lasti})"
                )
                self.interrupt()
        return self._step


@contextlib.contextmanager
def by_signal(seconds):
    """Have a timer's signal raise an interrupt once, as Ctrl-C does."""

    def take(number, frame):
        if armed:
            armed.pop()
            raise Interrupt

    armed = [True]
    before = signal.signal(signal.SIGALRM, take)
    try:
        signal.setitimer(signal.ITIMER_REAL, max(seconds, 1e-6))
        yield
    finally:
        try:
            armed.clear()
        finally:  # the interrupt may come between the two statements before, too
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def looking_often():
    """Have the limits be looked at after each step of the machine."""
    before = machine.SLICE
    machine.SLICE = (None,)
    try:
        yield
    finally:
        machine.SLICE = before


@contextlib.contextmanager
def time_runs_out(engine, at):
    """Have the time of a goal be up at the n-th look at the clock; yields what counts the looks."""
    looks = count(1)
    used = [0]

    def fake():
        used[0] = next(looks)
        return 0.0 if at is None or used[0] < at else 1e9 + used[0]

    clock, allowed = resource_limits.monotonic, engine.logic.limits
    resource_limits.monotonic = fake
    engine.logic.limits = Limits(seconds=100.0)
    try:
        yield used
    finally:
        resource_limits.monotonic = clock
        engine.logic.limits = allowed
