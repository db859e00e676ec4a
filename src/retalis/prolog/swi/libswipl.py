"""Interface to SWI-Prolog's C library: its functions, callbacks, signal stacks, and interruption of goals.

*Library.* `SwiLibrary` declares the functions of ``libswipl`` for ctypes, and detects constants that differ between
versions (7.6.4 and later are supported). See the manual, "Foreign Language Interface".

*Callbacks.* An exception must not leave a Python function that C has called: ctypes would discard it, and C would
continue with an undefined result. Python handles a signal that has arrived in the meantime at the first instruction
of such a function, before any ``try`` statement could be entered, and the signal handler may raise an exception. A
suspended generator, however, is resumed inside its ``try`` statement. Therefore callbacks are executed by suspended
generators that have been prepared in advance, and the object that C calls (`Callbacks`) obtains one and resumes it
without executing any Python code.

*Signal stacks.* SWI-Prolog replaces the alternate signal stack (``sigaltstack(2)``) of a thread when an engine is
created, and frees the new stack together with the engine. Python would go on to handle the thread's signals in the
freed memory. Therefore the previous stack is restored as soon as the engine exists.

*Limits.* A goal in SWI-Prolog does not check the limits of the program. A thread (`Interrupter`) checks the goals
that run, and interrupts those that exceed a limit: it raises an exception in their engine, and sends a signal to
their thread, which ends a blocking system call.
"""

import ctypes
import signal
from contextlib import contextmanager, suppress
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
from operator import methodcaller
from threading import Event, Lock, Thread, get_ident
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Callable, Dict, Generator, Iterator, List, Mapping, Optional, Tuple
from weakref import ref

from ...foundation.errors import UsageError
from ..machine.resource_limits import RemainingLimits, resident_bytes

if TYPE_CHECKING:
    from .swi_session import SwiEngine

_C = CDLL(None)

NullaryCallback = CFUNCTYPE(c_int)
"""Type of a C callback that implements a predicate without arguments."""


class _SignalStack(Structure):
    """``stack_t`` of Linux. A value that was read can be set again, also one with the flag ``SS_DISABLE``."""

    _fields_ = [("place", c_void_p), ("flags", c_int), ("size", c_size_t)]


@contextmanager
def preserved_signal_stack() -> Iterator[None]:
    """Restore the signal stack of this thread at the end of the context."""
    saved_stack = _SignalStack()
    _C.sigaltstack(None, byref(saved_stack))
    try:
        yield
    finally:
        _C.sigaltstack(byref(saved_stack), None)


def signal_stack_predicates() -> List[Tuple[str, object]]:
    """Return two predicates that save and restore the signal stack, for engines that are created by goals.

    Only one goal at a time may be between the two calls, which the bridge ensures with a mutex. The predicates fail,
    because ``sigaltstack`` returns 0 on success. They call C directly: Python code would be a point where Python
    handles pending signals, and an exception of a signal handler could not be propagated through C.
    """
    saved_stack = _SignalStack()
    return [
        ("$retalis_note_stack", NullaryCallback(partial(_C.sigaltstack, None, byref(saved_stack)))),
        ("$retalis_put_stack_back", NullaryCallback(partial(_C.sigaltstack, byref(saved_stack), None))),
    ]


LIBRARY_NAMES = ("libswipl.so.9", "libswipl.so.10", "libswipl.so.8", "libswipl.so.7", "libswipl.so")
"""File names of the library in the search path of the dynamic linker."""

LIBRARY_PATTERNS = (
    "/usr/lib/swi-prolog/lib/*/libswipl.so*",
    "/usr/lib/swipl/lib/*/libswipl.so*",
    "/usr/local/lib/swipl/lib/*/libswipl.so*",
)
"""Paths of the library in the folders of SWI-Prolog, which the dynamic linker does not search."""

NOT_INSTALLED_MESSAGE = (
    "use_swi needs SWI-Prolog, which is not installed here: ./install.py --with-swi installs it, "
    "as apt install swi-prolog-nox does"
)

MIN_VERSION = "7.6.4"
"""Oldest version that has all functions used here."""

_ARGUMENTS = (b"swipl", b"--nosignals", b"-q", b"-f", b"none", b"-F", b"none", b"--nodebug")
"""Argument vector of SWI-Prolog: no signal handlers except the one that interrupts system calls, no user files."""

# The numbers are those of SWI-Prolog.h.
NODEBUG, CATCH, STATUS = 0x4, 0x8, 0x40
QUERY_FLAGS = NODEBUG | CATCH | STATUS
"""Flags of queries: exceptions are returned to the caller, and the last solution is marked."""

RAISED, FAILED, SOLVED, LAST_SOLVED = -1, 0, 1, 2
"""Status of a query after a request for a solution."""

ATOM_TEXT, STRING_TEXT, INTEGER_TEXT = 0x1, 0x2, 0x8
_TEXT_FLAGS = ((0x100000, 0x80), (0x1000, 0x40))
"""Flags for UTF-8 text and for any term as text, in SWI-Prolog 8.5 and later, and in earlier versions."""

BRIDGE_MODULE = "retalis_bridge"
"""Module of ``bridge.pl`` in SWI-Prolog."""

ForeignFunction = Callable[..., Any]

UnaryCallback = ctypes.CFUNCTYPE(c_size_t, c_size_t)
"""Type of a C callback that implements a predicate of arity 1."""


class SwiLibrary:
    """Functions of SWI-Prolog's library.

    Short functions keep Python's global interpreter lock, and those that run goals release it. Reacquiring the lock
    takes up to 5 ms if other threads are busy, so it is released only once per goal.

    Attributes:
        term_types: results of ``term_type`` by the name of a type. They differ between versions.
        utf8_flag: flag of `get_text` and `unify_text` for UTF-8 text.
        any_term_as_text: flag of `get_text` for any term, as it is written.
        atom_flag: flag of `unify_text` for an atom.
    """

    def __init__(self, path: str):
        locking_library = ctypes.PyDLL(path, mode=ctypes.RTLD_GLOBAL)
        releasing_library = ctypes.CDLL(path, mode=ctypes.RTLD_GLOBAL)

        def declare(
            name: str, result: Any, *arguments: Any, library: ctypes.CDLL = locking_library
        ) -> ForeignFunction:
            function = library["PL_" + name]
            function.restype, function.argtypes = result, arguments
            return function

        term, handle, text = c_size_t, c_size_t, c_char_p
        self.initialise = declare("initialise", c_int, c_int, POINTER(c_char_p), library=releasing_library)
        # Engines
        self.create_engine = declare("create_engine", c_void_p, c_void_p)
        self.destroy_engine = declare("destroy_engine", c_int, c_void_p, library=releasing_library)
        self.set_engine = declare("set_engine", c_int, c_void_p, POINTER(c_void_p))
        self.attach_thread = declare("thread_attach_engine", c_int, c_void_p)
        self.thread_self = declare("thread_self", c_int)
        # Queries
        self.predicate = declare("predicate", c_void_p, text, c_int, text)
        self.predicate_of = declare("pred", c_void_p, handle, c_void_p)
        self.new_module = declare("new_module", c_void_p, handle)
        self.open_query = declare("open_query", c_size_t, c_void_p, c_int, c_void_p, term)
        self.next_solution = declare("next_solution", c_int, c_size_t, library=releasing_library)
        self.close_query = declare("close_query", c_int, c_size_t, library=releasing_library)
        # Keeps the interpreter lock, for a query that has no cleanup goals left to run.
        self.close_finished_query = declare("close_query", c_int, c_size_t)
        self.current_query = declare("current_query", c_size_t)
        self.exception = declare("exception", term, c_size_t)
        self.raise_exception = declare("raise_exception", c_int, term)
        self.clear_exception = declare("clear_exception", None)
        self.handle_signals = declare("handle_signals", c_int, library=releasing_library)
        self.call_predicate = declare(
            "call_predicate", c_int, c_void_p, c_int, c_void_p, term, library=releasing_library
        )
        self.register = declare("register_foreign_in_module", c_int, text, text, c_int, c_void_p, c_int)
        # Terms
        self.open_frame = declare("open_foreign_frame", c_size_t)
        self.discard_frame = declare("discard_foreign_frame", None, c_size_t)
        self.new_refs = declare("new_term_refs", term, c_int)
        self.copy_ref = declare("put_term", c_int, term, term)
        self.parse_term = declare("chars_to_term", c_int, text, term)
        self.new_functor = declare("new_functor", handle, handle, c_int)
        self.register_atom = declare("register_atom", None, handle)
        self.unregister_atom = declare("unregister_atom", None, handle)
        self.unify = declare("unify", c_int, term, term)
        self.unify_integer = declare("unify_int64", c_int, term, c_int64)
        self.unify_float = declare("unify_float", c_int, term, c_double)
        self.unify_atom = declare("unify_atom", c_int, term, handle)
        self.unify_nil = declare("unify_nil", c_int, term)
        self.unify_text = declare("unify_chars", c_int, term, c_int, c_size_t, c_char_p)
        self.unify_functor = declare("unify_functor", c_int, term, handle)
        self.unify_list = declare("unify_list", c_int, term, term, term)
        self.put_text = declare("put_string_chars", c_int, term, text)
        self.term_type = declare("term_type", c_int, term)
        self.is_attributed = declare("is_attvar", c_int, term)
        self.is_acyclic = declare("is_acyclic", c_int, term)
        self.get_atom = declare("get_atom", c_int, term, POINTER(c_size_t))
        self.get_integer = declare("get_int64", c_int, term, POINTER(c_int64))
        self.get_float = declare("get_float", c_int, term, POINTER(c_double))
        self.get_text = declare("get_nchars", c_int, term, POINTER(c_size_t), POINTER(c_void_p), c_int)
        self.get_name = declare("get_name_arity", c_int, term, POINTER(c_size_t), POINTER(c_int))
        self.get_functor = declare("get_functor", c_int, term, POINTER(c_size_t))
        self.get_argument = declare("get_arg", c_int, c_int, term, term)
        self.get_list = declare("get_list", c_int, term, term, term)
        # Values that differ between versions; see `_detect_constants`. 2 is PL_ATOM in all of them.
        self.term_types: Dict[str, int] = {}
        self.utf8_flag = self.any_term_as_text = 0
        self.atom_flag = 2

    def start(self) -> None:
        """Start SWI-Prolog, and prepare it for the use of engines.

        Raises:
            UsageError: if it does not start.
        """
        arguments = (c_char_p * (len(_ARGUMENTS) + 1))(*_ARGUMENTS)
        with preserved_signal_stack():
            started = self.initialise(len(_ARGUMENTS), arguments)
        if not started:
            raise UsageError(
                "SWI-Prolog does not start: its library was found, but not its own files: install it again"
            )
        self._detect_constants()

    def detach_thread(self) -> None:
        """Detach this thread from its engine."""
        self.set_engine(None, None)

    def _detect_constants(self) -> None:
        """Detect the constants of this version for term types and text flags, from samples."""
        foreign_frame = self.open_frame()
        ref = self.new_refs(2)
        self.term_types["variable"] = self.term_type(ref)
        samples = {"atom": b"a", "integer": b"1", "float": b"1.5", "nil": b"[]", "pair": b"[a]"}
        for name, text in {**samples, "compound": b"f(x)", "rational": b"1r3", "dict": b"_{a: 1}"}.items():
            was_parsed = self.parse_term(text, ref)
            term_type = self.term_type(ref) if was_parsed else 0
            # Versions without a type read its sample as a term of another type, such as a rational as an integer.
            self.term_types[name] = term_type if term_type not in self.term_types.values() else 0
        self.clear_exception()
        self.put_text(ref, b"text")
        self.term_types["string"] = self.term_type(ref)
        sample = "\u0430".encode()
        for flag, flag_text in _TEXT_FLAGS:
            self.parse_term(b"'\\u0430'", ref)
            length, address = c_size_t(), c_void_p()
            was_read = self.get_text(ref, ctypes.byref(length), ctypes.byref(address), ATOM_TEXT | flag)
            if was_read and ctypes.string_at(address.value or 0, length.value) == sample:
                self.utf8_flag, self.any_term_as_text = flag, flag_text
                break
        self.discard_frame(foreign_frame)


@lru_cache(maxsize=1)
def find_library() -> SwiLibrary:
    """Return the library's functions, without starting SWI-Prolog.

    Raises:
        UsageError: if SWI-Prolog is not installed or too old.
    """
    too_old = ""
    for name in (*LIBRARY_NAMES, *(path for pattern in LIBRARY_PATTERNS for path in sorted(glob(pattern)))):
        try:
            return SwiLibrary(name)
        except OSError:  # not installed under this name
            continue
        except AttributeError as error:  # a later name may be that of a newer version
            too_old = f"'{name}' is older, or another library: {error}"
    raise UsageError(
        f"use_swi needs SWI-Prolog {MIN_VERSION} or later: {too_old}" if too_old else NOT_INSTALLED_MESSAGE
    )


_PREPARED_GENERATORS = 64
"""Number of suspended generators, which limits the callbacks that may begin before a callback prepares more."""

_CallbackGenerator = Generator[int, int, None]


class Callbacks(List[Callable[[int], int]]):
    """List of prepared callback functions, which C calls like a function with a term reference.

    ``__call__`` is a property whose getter is ``pop``: a call removes an item and calls it, all in C code of Python.

    Args:
        engines: engines by their numbers in SWI-Prolog.
        raise_unknown_engine: raises an error in a goal that belongs to no program.
    """

    __call__ = property(methodcaller("pop"))

    def __init__(
        self,
        engines: Mapping[int, "SwiEngine"],
        current_engine_number: Callable[[], int],
        raise_unknown_engine: Callable[[], object],
    ):
        super().__init__()
        self._engines = engines
        self._current_engine_number = current_engine_number
        self._raise_unknown_engine = raise_unknown_engine
        self._finished: List[_CallbackGenerator] = []
        self.prepare_generators()

    def prepare_generators(self) -> None:
        """Prepare generators up to the required number, and close those that have returned a result."""
        with suppress(IndexError):  # the list is empty, or another thread has taken the last one
            while True:
                generator: Any = self._finished.pop()
                # Another thread may still be between the last two instructions of its callback.
                if generator.gi_running:
                    self._finished.append(generator)
                    break
                generator.close()
        while len(self) < _PREPARED_GENERATORS:
            generators: List[_CallbackGenerator] = []
            generators.append(self._run_callback(generators))
            next(generators[0])
            self.append(generators[0].send)

    def _run_callback(self, generators: List[_CallbackGenerator]) -> _CallbackGenerator:
        """Wait for a term reference, run its callback, yield the result, and wait to be closed.

        The generator stays suspended after it has yielded the result, because the code after the last ``yield`` could
        run, and raise, while the result is passed to C.

        Args:
            generators: list that receives this generator after it has been created. A generator has no reference to
                itself, and needs one to enter `_finished`.
        """
        engine: Any = None
        result, has_returned = 0, False
        try:
            ref = yield 0
            self.prepare_generators()
            engine = self._engines.get(self._current_engine_number())
            if engine is None:
                self._raise_unknown_engine()
            else:
                result = int(engine.run_callback(ref))
            self._finished += generators
            # No call may follow before the result is returned, because Python handles signals after calls.
            has_returned = True
            yield result
        except GeneratorExit:
            return
        except BaseException as error:  # also an exception of a signal handler, because C needs a result
            if has_returned:  # the exception belongs to the code that closes the generator
                raise
            self._finished += generators
            engine = self._engines.get(self._current_engine_number())
            if engine is not None:
                engine.raise_in_swi(error)
            yield 0
        finally:
            del generators[:]


_CHECK_INTERVAL_SECONDS = 0.02
"""Time between two checks of the running goals."""

_REPEAT_INTERVAL_SECONDS = 0.2
"""Time after which a goal that has not ended is interrupted again."""

_MAX_IDLE_CHECKS = 50
"""Number of checks without a running goal after which the thread sleeps."""

_EXTRA_INFERENCES = 100_000
"""Inferences beyond the limit before an interrupt.

SWI-Prolog checks the limit itself; the interrupt is for a program that catches that exception.
"""

_MAX_CATCHABLE_INTERRUPTS = 2
"""Number of interrupts by an exception that a program may catch; later ones abort the goal."""


class LimitedGoal:
    """A goal with limits that runs in SWI-Prolog.

    Args:
        remaining: resources that it may still use.
        engine: number of its engine in SWI-Prolog.
        initial_inferences: inferences of that engine at the start of the goal, if they are limited.

    Attributes:
        exceeded_resource: name of the resource for which it has been interrupted; empty before.
    """

    __slots__ = (
        "remaining",
        "initial_inferences",
        "engine",
        "thread_id",
        "exceeded_resource",
        "next_interrupt",
        "interrupt_count",
    )

    def __init__(self, remaining: RemainingLimits, engine: int, initial_inferences: int = 0):
        self.remaining = remaining
        self.initial_inferences = initial_inferences
        self.engine = engine
        self.thread_id = get_ident()
        self.exceeded_resource = ""
        self.next_interrupt = 0.0
        self.interrupt_count = 0

    def find_exceeded(self, now: float, inferences: Callable[[int], int]) -> str:
        """Return the name of the exceeded resource, or an empty string."""
        deadline, max_inferences, max_memory = self.remaining
        if (
            max_inferences is not None
            and inferences(self.engine) > self.initial_inferences + max_inferences + _EXTRA_INFERENCES
        ):
            return "inferences"
        if deadline is not None and now > deadline:
            return "seconds"
        # The memory of SWI-Prolog is that of the process, as its stacks are not counted by Python.
        if max_memory is not None and resident_bytes() > max_memory:
            return "memory"
        return self.exceeded_resource


class Interrupter:
    """A thread that checks the limits of running goals, and sleeps while no goal runs.

    Attributes:
        is_idle: whether `start` has to be called for a new goal.
    """

    def __init__(self, swi: SwiLibrary):
        self._swi = swi
        self._lock = Lock()
        self._wake_event = Event()
        self._engines: List[ref[SwiEngine]] = []
        self._thread: Optional[Thread] = None
        self.is_idle = True

    def add(self, engine: "SwiEngine") -> None:
        """Add an engine whose goals are checked; only a weak reference to it is held."""
        self._engines = [*(reference for reference in self._engines if reference() is not None), ref(engine)]

    def start(self) -> None:
        """Start the thread, or end its sleep."""
        self.is_idle = False
        # The thread is started with the first limited goal, as most programs have none.
        if self._thread is None:
            self._thread = Thread(target=self._run, name="retalis guard of SWI-Prolog", daemon=True)
            self._thread.start()
        self._wake_event.set()

    def wait_for_interrupt(self) -> None:
        """Wait for the end of an interrupt in progress, and discard its effect, since its goal has ended."""
        # An interrupt that arrives after its goal has ended would hit the next goal of the same engine.
        with self._lock:
            self._swi.handle_signals()
            self._swi.clear_exception()

    def _run(self) -> None:
        with preserved_signal_stack():
            # An attached thread has an engine of its own, which it needs to call predicates of the bridge.
            self._swi.attach_thread(None)
        idle_checks = 0
        while True:
            idle_checks = 0 if self._check_goals(monotonic()) else idle_checks + 1
            if idle_checks > _MAX_IDLE_CHECKS:
                self._wake_event.clear()
                self.is_idle = True
                # A goal that started before `is_idle` was set did not call `start`, so the goals are checked once
                # more.
                if not self._check_goals(monotonic()):
                    self._wake_event.wait()
                self.is_idle = False
                idle_checks = 0
            sleep(_CHECK_INTERVAL_SECONDS)

    def _check_goals(self, now: float) -> bool:
        """Interrupt the goals that exceed a limit; return whether any goal runs."""
        has_running_goal = False
        for reference in self._engines:
            engine = reference()
            limited_goal = None if engine is None else engine.limited_goal
            if engine is None or limited_goal is None:
                continue
            has_running_goal = True
            if now > limited_goal.next_interrupt:
                resource = limited_goal.find_exceeded(now, self._count_inferences)
                if resource:
                    self._interrupt_exceeded(engine, limited_goal, resource)
        return has_running_goal

    def _interrupt_exceeded(self, engine: "SwiEngine", limited_goal: LimitedGoal, resource: str) -> None:
        with self._lock:
            limited_goal.next_interrupt = monotonic() + _REPEAT_INTERVAL_SECONDS
            limited_goal.interrupt_count += 1
            # Set before the check whether the goal still runs: the engine resets `limited_goal` when the goal ends
            # and reads `exceeded_resource` after that, so one of the two sees the other's change.
            limited_goal.exceeded_resource = resource
            if engine.limited_goal is limited_goal:
                self._interrupt(limited_goal)

    def _count_inferences(self, engine: int) -> int:
        swi = self._swi
        foreign_frame = swi.open_frame()
        ref = swi.new_refs(2)
        swi.unify_integer(ref, engine)
        count = c_int64()
        if swi.call_predicate(None, CATCH, swi.predicate(b"inferences", 2, BRIDGE_MODULE.encode()), ref):
            swi.get_integer(ref + 1, byref(count))
        swi.clear_exception()
        swi.discard_frame(foreign_frame)
        return count.value

    def _interrupt(self, limited_goal: LimitedGoal) -> None:
        """Raise an exception in a thread's goal, and end a system call in which it blocks."""
        swi = self._swi
        foreign_frame = swi.open_frame()
        ref = swi.new_refs(2)
        swi.unify_integer(ref, limited_goal.engine)
        swi.unify_integer(ref + 1, 0 if limited_goal.interrupt_count <= _MAX_CATCHABLE_INTERRUPTS else 1)
        swi.call_predicate(None, CATCH, swi.predicate(b"interrupt", 2, BRIDGE_MODULE.encode()), ref)
        swi.clear_exception()
        swi.discard_frame(foreign_frame)
        # Ends a blocking system call with EINTR, after which SWI-Prolog handles the exception.
        signal.pthread_kill(limited_goal.thread_id, signal.SIGUSR2)
