"""Ends goals in SWI-Prolog that are past a limit: they cannot look at the limits by themselves."""

import signal
from ctypes import byref, c_int64
from threading import Event, Lock, Thread, get_ident
from time import monotonic, sleep
from typing import Callable, List, Optional, Protocol
from weakref import ref

from ..machine import Left, resident_bytes
from .binding import CATCH, SwiLibrary
from .signalstack import signal_stack_kept

_PAUSE = 0.02
"""Seconds between two looks at what runs."""

_AGAIN = 0.2
"""Seconds after which a goal that goes on all the same is interrupted once more."""

_IDLE = 50
"""Looks without anything that runs, after which it waits to be woken."""

_SLACK = 100_000
"""Inferences past the limit that SWI-Prolog counts by itself, for a program that catches what ends it there."""

_GENTLE = 2
"""Interrupts that programs may catch."""


class Watched:
    """A goal that runs in SWI-Prolog and has limits.

    Args:
        left: what it may use.
        engine: SWI-Prolog's number of the engine.
        done: inferences of that engine when the goal begins, where they are limited.

    Attributes:
        fired: what it has used up, once it has been interrupted for that.
    """

    __slots__ = ("left", "done", "engine", "thread", "fired", "again", "times")

    def __init__(self, left: Left, engine: int, done: int = 0):
        self.left = left
        self.done = done
        self.engine = engine
        self.thread = get_ident()
        self.fired = ""
        self.again = 0.0
        self.times = 0

    def exceeded(self, now: float, inferences: Callable[[int], int]) -> str:
        """Return what it has used up; nothing where it may go on."""
        until, most, memory = self.left
        if most is not None and inferences(self.engine) > self.done + most + _SLACK:
            return "inferences"
        if until is not None and now > until:
            return "seconds"
        if memory is not None and resident_bytes() > memory:
            return "memory"
        return self.fired


class Interruptible(Protocol):
    """Where goals run: the newest is ``watched``."""

    watched: Optional[Watched]


class Interrupter:
    """A thread that looks once in a while at what runs, while anything does.

    Args:
        swi: the library.

    Attributes:
        asleep: whether it has to be woken for a new goal.
    """

    def __init__(self, swi: SwiLibrary):
        self._swi = swi
        self._lock = Lock()
        self._wake = Event()
        self._all: List[ref[Interruptible]] = []
        self._thread: Optional[Thread] = None
        self.asleep = True

    def add(self, one: Interruptible) -> None:
        """Look at it from now on, as long as anybody holds it."""
        self._all = [*(known for known in self._all if known() is not None), ref(one)]

    def wake(self) -> None:
        """Begin to look: there is something new."""
        self.asleep = False
        if self._thread is None:
            self._thread = Thread(target=self._run, name="retalis guard of SWI-Prolog", daemon=True)
            self._thread.start()
        self._wake.set()

    def settle(self) -> None:
        """Wait until an interrupt is under way no more, and forget it; its goal is over."""
        with self._lock:
            self._swi.handle_signals()
            self._swi.clear_exception()

    def _run(self) -> None:
        with signal_stack_kept():
            self._swi.attach_thread(None)
        idle = 0
        while True:
            idle = 0 if self._look(monotonic()) else idle + 1
            if idle > _IDLE:
                self._wake.clear()
                self.asleep = True
                if not self._look(monotonic()):
                    self._wake.wait()
                self.asleep = False
                idle = 0
            sleep(_PAUSE)

    def _look(self, now: float) -> bool:
        """Interrupt what is past its limits; tell whether anything runs."""
        runs = False
        for known in self._all:
            one = known()
            watched = None if one is None else one.watched
            if one is None or watched is None:
                continue
            runs = True
            if now > watched.again:
                what = watched.exceeded(now, self._inferences)
                if what:
                    self._fire(one, watched, what)
        return runs

    def _fire(self, one: Interruptible, watched: Watched, what: str) -> None:
        with self._lock:
            watched.again = monotonic() + _AGAIN
            watched.times += 1
            watched.fired = (
                what  # before it is looked whether it still runs: who has ended it looks here after that
            )
            if one.watched is watched:
                self._interrupt(watched)

    def _inferences(self, engine: int) -> int:
        """Return how many inferences an engine has done."""
        swi = self._swi
        frame = swi.open_frame()
        ref = swi.new_refs(2)
        swi.unify_integer(ref, engine)
        found = c_int64()
        if swi.call_predicate(None, CATCH, swi.predicate(b"inferences", 2, b"retalis_bridge"), ref):
            swi.get_integer(ref + 1, byref(found))
        swi.clear_exception()
        swi.discard_frame(frame)
        return found.value

    def _interrupt(self, watched: Watched) -> None:
        """Have a thread's goal throw something, also where it waits for the system."""
        swi = self._swi
        frame = swi.open_frame()
        ref = swi.new_refs(2)
        swi.unify_integer(ref, watched.engine)
        swi.unify_integer(ref + 1, 0 if watched.times <= _GENTLE else 1)
        swi.call_predicate(None, CATCH, swi.predicate(b"interrupt", 2, b"retalis_bridge"), ref)
        swi.clear_exception()
        swi.discard_frame(frame)
        signal.pthread_kill(watched.thread, signal.SIGUSR2)
