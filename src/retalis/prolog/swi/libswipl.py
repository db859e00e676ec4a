"""Keeps the stack on which a thread's signals are handled: SWI-Prolog puts one of each new engine's in its place.

That one is given back with the engine, and Python goes on to handle the thread's signals there: in memory that is
somebody else's by then. So the thread has its own back as soon as the engine is made.

The functions of SWI-Prolog's library that are called here, and the start of it in this process.

Ends goals in SWI-Prolog that are past a limit: they cannot look at the limits by themselves.
"""

import ctypes
import signal
from contextlib import contextmanager
from ctypes import (
    CDLL,
    CFUNCTYPE,
    POINTER,
    Structure,
    byref,
    c_char_p,
    c_double,
    c_int,
    c_int64,
    c_size_t,
    c_void_p,
)
from functools import lru_cache, partial
from glob import glob
from threading import Event, Lock, Thread, get_ident
from time import monotonic, sleep
from typing import Any, Callable, Dict, Iterator, List, Optional, Protocol, Tuple
from weakref import ref

from ...foundation.errors import UsageError
from ...foundation.python_interpreter import PYPY
from ..machine.resource_limits import Left, resident_bytes

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


NAMES = ("libswipl.so.9", "libswipl.so.10", "libswipl.so.8", "libswipl.so.7", "libswipl.so")
"""Of the library, as the loader of the system finds it."""

PLACES = (
    "/usr/lib/swi-prolog/lib/*/libswipl.so*",
    "/usr/lib/swipl/lib/*/libswipl.so*",
    "/usr/local/lib/swipl/lib/*/libswipl.so*",
)
"""Where the loader does not look: SWI-Prolog's own folders."""

MISSING = (
    "use_swi needs SWI-Prolog, which is not installed here: ./install.py --with-swi installs it, "
    "as apt install swi-prolog-nox does"
)

OLDEST = "7.6.4"
"""All that is called here is in it."""

ON_PYPY = "use_swi needs CPython: PyPy lets go of its lock in each call of a library"

# As its argument vector: no handlers of signals but the one that interrupts a system call, no file of the user's.
_ARGUMENTS = (b"swipl", b"--nosignals", b"-q", b"-f", b"none", b"-F", b"none", b"--nodebug")

NODEBUG, CATCH, STATUS = 0x4, 0x8, 0x40
ASK = NODEBUG | CATCH | STATUS
"""How queries are opened: exceptions are ours, and the last solution is told as such."""

RAISED, FAILED, SOLVED, LAST_SOLVED = -1, 0, 1, 2
"""What a query says when it is asked for a solution."""

ATOM_TEXT, STRING_TEXT, INTEGER_TEXT = 0x1, 0x2, 0x8
_FLAGS = ((0x100000, 0x80), (0x1000, 0x40))
"""The flags for texts in UTF-8 and for terms as text: of SWI-Prolog 8.5 and later, and of those before."""

Called = Callable[..., Any]

Answering = ctypes.CFUNCTYPE(c_size_t, c_size_t)
"""The kind of a predicate of arity 1 that is a function of ours."""


class SwiLibrary:
    """SWI-Prolog's functions: those that are short keep Python's lock, those that run goals let it go.

    To let it go costs a thread that wants it back up to 5 ms where others are busy: once for each goal is enough.

    Args:
        library: the path or name of the library.

    Attributes:
        kinds: what ``term_type`` says of a variable, an atom, and so on; it differs between versions.
        utf8: the flag for texts in UTF-8.
        written: the flag for any term as text.
        atom: the flag for a text that is to be an atom.
    """

    def __init__(self, library: str):
        short = ctypes.PyDLL(library, mode=ctypes.RTLD_GLOBAL)
        long = ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)

        def known(name: str, result: Any, *arguments: Any, of: ctypes.CDLL = short) -> Called:
            function = of["PL_" + name]
            function.restype, function.argtypes = result, arguments
            return function

        term, handle, text = c_size_t, c_size_t, c_char_p
        self.initialise = known("initialise", c_int, c_int, POINTER(c_char_p), of=long)
        # Engines
        self.create_engine = known("create_engine", c_void_p, c_void_p)
        self.destroy_engine = known("destroy_engine", c_int, c_void_p, of=long)
        self.set_engine = known("set_engine", c_int, c_void_p, POINTER(c_void_p))
        self.attach_thread = known("thread_attach_engine", c_int, c_void_p)
        self.thread_self = known("thread_self", c_int)
        # Queries
        self.predicate = known("predicate", c_void_p, text, c_int, text)
        self.predicate_of = known("pred", c_void_p, handle, c_void_p)
        self.new_module = known("new_module", c_void_p, handle)
        self.open_query = known("open_query", c_size_t, c_void_p, c_int, c_void_p, term)
        self.next_solution = known("next_solution", c_int, c_size_t, of=long)
        self.close_query = known("close_query", c_int, c_size_t, of=long)
        self.close_done = known("close_query", c_int, c_size_t)  # of a query that has nothing left to run
        self.current_query = known("current_query", c_size_t)
        self.exception = known("exception", term, c_size_t)
        self.raise_exception = known("raise_exception", c_int, term)
        self.clear_exception = known("clear_exception", None)
        self.handle_signals = known("handle_signals", c_int, of=long)
        self.call_predicate = known("call_predicate", c_int, c_void_p, c_int, c_void_p, term, of=long)
        self.register = known("register_foreign_in_module", c_int, text, text, c_int, c_void_p, c_int)
        # Terms
        self.open_frame = known("open_foreign_frame", c_size_t)
        self.discard_frame = known("discard_foreign_frame", None, c_size_t)
        self.new_refs = known("new_term_refs", term, c_int)
        self.copy_ref = known("put_term", c_int, term, term)
        self.read_text = known("chars_to_term", c_int, text, term)
        self.new_functor = known("new_functor", handle, handle, c_int)
        self.register_atom = known("register_atom", None, handle)
        self.unregister_atom = known("unregister_atom", None, handle)
        self.unify = known("unify", c_int, term, term)
        self.unify_integer = known("unify_int64", c_int, term, c_int64)
        self.unify_float = known("unify_float", c_int, term, c_double)
        self.unify_atom = known("unify_atom", c_int, term, handle)
        self.unify_nil = known("unify_nil", c_int, term)
        self.unify_text = known("unify_chars", c_int, term, c_int, c_size_t, c_char_p)
        self.unify_functor = known("unify_functor", c_int, term, handle)
        self.unify_list = known("unify_list", c_int, term, term, term)
        self.put_text = known("put_string_chars", c_int, term, text)
        self.term_type = known("term_type", c_int, term)
        self.is_attributed = known("is_attvar", c_int, term)
        self.is_acyclic = known("is_acyclic", c_int, term)
        self.get_atom = known("get_atom", c_int, term, POINTER(c_size_t))
        self.get_integer = known("get_int64", c_int, term, POINTER(c_int64))
        self.get_float = known("get_float", c_int, term, POINTER(c_double))
        self.get_text = known("get_nchars", c_int, term, POINTER(c_size_t), POINTER(c_void_p), c_int)
        self.get_name = known("get_name_arity", c_int, term, POINTER(c_size_t), POINTER(c_int))
        self.get_functor = known("get_functor", c_int, term, POINTER(c_size_t))
        self.get_argument = known("get_arg", c_int, c_int, term, term)
        self.get_list = known("get_list", c_int, term, term, term)
        self.kinds: Dict[str, int] = {}
        self.utf8 = self.written = 0
        self.atom = 2

    def start(self) -> None:
        """Start SWI-Prolog, and leave it for engines to be used.

        Raises:
            UsageError: where it does not start.
        """
        given = (c_char_p * (len(_ARGUMENTS) + 1))(*_ARGUMENTS)
        with signal_stack_kept():
            started = self.initialise(len(_ARGUMENTS), given)
        if not started:
            raise UsageError("SWI-Prolog does not start: its library is there, its own files are not")
        self._look_at_terms()

    def leave(self) -> None:
        """Have this thread use no engine."""
        self.set_engine(None, None)

    def _look_at_terms(self) -> None:
        """Find out how this version names the kinds of terms: by asking for the kind of one of each."""
        frame = self.open_frame()
        ref = self.new_refs(2)
        self.kinds["variable"] = self.term_type(ref)
        samples = {"atom": b"a", "integer": b"1", "float": b"1.5", "nil": b"[]", "pair": b"[a]"}
        for name, text in {**samples, "compound": b"f(x)", "rational": b"1r3", "dict": b"_{a: 1}"}.items():
            read = self.read_text(text, ref)
            kind = self.term_type(ref) if read else 0
            self.kinds[name] = kind if kind not in self.kinds.values() else 0
        self.clear_exception()
        self.put_text(ref, b"text")
        self.kinds["string"] = self.term_type(ref)
        sample = "\u0430".encode()
        for flag, written in _FLAGS:
            self.read_text(b"'\\u0430'", ref)
            length, place = c_size_t(), c_void_p()
            got = self.get_text(ref, ctypes.byref(length), ctypes.byref(place), ATOM_TEXT | flag)
            if got and ctypes.string_at(place.value or 0, length.value) == sample:
                self.utf8, self.written = flag, written
                break
        self.discard_frame(frame)


@lru_cache(maxsize=1)
def find_library() -> SwiLibrary:
    """Return the library's functions, without starting it.

    Raises:
        UsageError: where SWI-Prolog is not installed, or is too old, or this is PyPy.
    """
    if PYPY:
        raise UsageError(ON_PYPY)
    too_old = ""
    for name in (*NAMES, *(path for place in PLACES for path in sorted(glob(place)))):
        try:
            return SwiLibrary(name)
        except OSError:  # not there: the next one
            continue
        except AttributeError as error:  # there may be a newer one
            too_old = f"{name} is older, or another library: {error}"
    raise UsageError(f"use_swi needs SWI-Prolog {OLDEST} or later: {too_old}" if too_old else MISSING)


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
