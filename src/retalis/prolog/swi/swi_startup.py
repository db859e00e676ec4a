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

_AnswerGenerator = Generator[int, int, None]


class Callbacks(List[Callable[[int], int]]):
    """List of prepared answer functions that is called by C with a term reference.

    ``__call__`` is a property whose getter is ``pop``: a call removes an item and calls it, all in C code of Python.

    Args:
        targets: engines by their numbers in SWI-Prolog.
        number: returns the number of the calling engine.
        refuse: raises an error in a goal that belongs to no program.
    """

    __call__ = property(methodcaller("pop"))

    def __init__(
        self, targets: Mapping[int, "SwiEngine"], number: Callable[[], int], refuse: Callable[[], object]
    ):
        super().__init__()
        self._targets = targets
        self._number = number
        self._refuse = refuse
        self._finished: List[_AnswerGenerator] = []
        self.fill()

    def fill(self) -> None:
        """Prepare generators up to the required number, and close those that have answered."""
        with suppress(IndexError):  # the list is empty, or another thread has taken the last one
            while True:
                generator: Any = self._finished.pop()
                # Another thread may still be between the last two instructions of its callback.
                if generator.gi_running:
                    self._finished.append(generator)
                    break
                generator.close()
        while len(self) < _PREPARED_GENERATORS:
            generators: List[_AnswerGenerator] = []
            generators.append(self._answering(generators))
            next(generators[0])
            self.append(generators[0].send)

    def _answering(self, generators: List[_AnswerGenerator]) -> _AnswerGenerator:
        """Wait for a reference, answer it, and wait to be closed.

        The generator does not return after the answer, because its end would execute Python code when C has
        continued.

        Args:
            generators: a list with this generator.
        """
        target: Any = None
        result, has_answered = 0, False
        try:
            ref = yield 0
            self.fill()
            target = self._targets.get(self._number())
            if target is None:
                self._refuse()
            else:
                result = int(target.answer(ref))
            self._finished += generators
            # No call follows before the answer is returned: Python handles signals after calls.
            has_answered = True
            yield result
        except GeneratorExit:
            return
        except BaseException as error:  # also an exception of a signal handler, since C needs an answer
            if has_answered:  # the exception belongs to the code that closes the generator
                raise
            self._finished += generators
            target = self._targets.get(self._number())
            if target is not None:
                target.fail(error)
            yield 0
        finally:
            del generators[:]


BRIDGE = "retalis_bridge"
_FILE = Path(__file__).resolve().parent / "bridge.pl"
"""Prolog file that is loaded into SWI-Prolog at its start."""

_LOCK = Lock()


class Started(NamedTuple):
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


def start() -> Started:
    """Return SWI-Prolog, which is started by the first call.

    Raises:
        UsageError: if it is not installed or does not start.
    """
    with _LOCK:
        return _started()


@lru_cache(maxsize=1)
def _started() -> Started:
    swi = find_library()
    swi.start()
    engines: MutableMapping[int, SwiEngine] = WeakValueDictionary()

    answerers: Any = Callbacks(engines, swi.thread_self, partial(_refuse, swi))
    callbacks: List[Tuple[str, int, Any]] = [("$retalis_ask", 1, UnaryCallback(answerers))]
    callbacks += [(name, 0, step) for name, step in signal_stack_predicates()]
    for name, arity, callback in callbacks:
        # Registered before the bridge is loaded, which refers to these predicates.
        swi.register(BRIDGE.encode(), name.encode(), arity, callback, 0)
    ref = swi.new_refs(1)
    SwiTerms(swi).put(ref, atom(str(_FILE)), {})
    if not swi.call_predicate(None, 0, swi.predicate(b"consult", 1, b"user"), ref):
        raise UsageError(f"SWI-Prolog does not load {_FILE}")
    swi.leave()
    return Started(swi, Interrupter(swi), engines, callbacks)


def _refuse(swi: SwiLibrary) -> None:
    """Raise the error for a callback from a thread of SWI-Prolog, which belongs to no program."""
    ref = swi.new_refs(1)
    error_term = (functor("existence_error", 2), atom("retalis_engine"), (SLASH, atom("retalis"), 1))
    SwiTerms(swi).put(ref, (functor("error", 2), error_term, Var()), {})
    swi.raise_exception(ref)
