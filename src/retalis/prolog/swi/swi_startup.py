"""Start of SWI-Prolog in this process, and its callbacks into Python.

SWI-Prolog is started once for all programs, and loads ``bridge.pl``. Its clauses call predicates of a program through
the callback ``$retalis_ask/1``.

An exception must not leave a Python function that C has called: ctypes would discard it, and C would continue with an
undefined result. Python handles a signal that has arrived in the meantime at the first instruction of such a
function, before any ``try`` statement could be entered, and the signal handler may raise an exception. A suspended
generator, however, is resumed inside its ``try`` statement. Therefore callbacks are executed by suspended generators
that have been prepared in advance, and the object that C calls (`Callbacks`) obtains one and resumes it without
executing any Python code.
"""

from contextlib import suppress
from functools import lru_cache, partial
from operator import methodcaller
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Callable, Generator, List, Mapping, MutableMapping, NamedTuple, Tuple
from weakref import WeakValueDictionary

from ...foundation.errors import UsageError
from ..terms.types import SLASH, Var, atom, functor
from .libswipl import Interrupter, SwiLibrary, UnaryCallback, find_library, signal_stack_predicates
from .swi_terms import SwiTerms

if TYPE_CHECKING:
    from .swi_session import SwiEngine

_PREPARED_GENERATORS = 64
"""Number of suspended generators, which limits the callbacks that may begin before a callback prepares more."""

_CallbackGenerator = Generator[int, int, None]


class Callbacks(List[Callable[[int], int]]):
    """List of prepared callback functions, which C calls like a function with a term reference.

    ``__call__`` is a property whose getter is ``pop``: a call removes an item and calls it, all in C code of Python.

    Args:
        engines: engines by their numbers in SWI-Prolog.
        current_engine_number: returns the number of the calling engine.
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


BRIDGE = "retalis_bridge"
"""Module of the bridge in SWI-Prolog."""

_BRIDGE_FILE = Path(__file__).resolve().parent / "bridge.pl"
"""Prolog file that is loaded into SWI-Prolog at its start."""

# `lru_cache` alone would let two threads start SWI-Prolog at once.
_LOCK = Lock()


class SwiRuntime(NamedTuple):
    """The running SWI-Prolog of this process.

    Attributes:
        swi: functions of the library.
        interrupter: thread that interrupts goals that exceed a limit.
        engines: engines by their numbers in SWI-Prolog.
        callbacks: functions that C calls, which must not be freed.
    """

    swi: SwiLibrary
    interrupter: Interrupter
    engines: "MutableMapping[int, Any]"
    callbacks: object


def start() -> SwiRuntime:
    """Start SWI-Prolog at the first call, and return it.

    Raises:
        UsageError: if it is not installed or does not start.
    """
    with _LOCK:
        return _start_runtime()


@lru_cache(maxsize=1)
def _start_runtime() -> SwiRuntime:
    swi = find_library()
    swi.start()
    engines: MutableMapping[int, SwiEngine] = WeakValueDictionary()

    callback_list: Any = Callbacks(engines, swi.thread_self, partial(_raise_unknown_engine, swi))
    callbacks: List[Tuple[str, int, Any]] = [("$retalis_ask", 1, UnaryCallback(callback_list))]
    callbacks += [(name, 0, function) for name, function in signal_stack_predicates()]
    for name, arity, callback in callbacks:
        # Registered before the bridge is loaded, which refers to these predicates.
        swi.register(BRIDGE.encode(), name.encode(), arity, callback, 0)
    ref = swi.new_refs(1)
    SwiTerms(swi).put(ref, atom(str(_BRIDGE_FILE)), {})
    if not swi.call_predicate(None, 0, swi.predicate(b"consult", 1, b"user"), ref):
        raise UsageError(f"SWI-Prolog does not load {_BRIDGE_FILE}")
    swi.detach_thread()
    return SwiRuntime(swi, Interrupter(swi), engines, callbacks)


def _raise_unknown_engine(swi: SwiLibrary) -> None:
    """Raise the error for a callback from a thread of SWI-Prolog, which belongs to no program."""
    ref = swi.new_refs(1)
    error_term = (functor("existence_error", 2), atom("retalis_engine"), (SLASH, atom("retalis"), 1))
    SwiTerms(swi).put(ref, (functor("error", 2), error_term, Var()), {})
    swi.raise_exception(ref)
