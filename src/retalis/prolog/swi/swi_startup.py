"""What SWI-Prolog calls to ask back, in a way that a signal's handler may raise what it likes meanwhile.

An exception must not get out of a function that C has called: it would be forgotten, and C go on with an answer that
nobody has given. A signal that has come while SWI-Prolog ran is handled where code in Python begins, which is before
any ``try`` of a function. In a generator that goes on it is inside one. So generators that wait are kept ready, and
C calls what gets one of them without any code in Python.

The start of SWI-Prolog in this process, once for all programs.
"""

from contextlib import suppress
from functools import lru_cache, partial
from operator import methodcaller
from pathlib import Path
from threading import Lock
from typing import Any, Callable, Generator, List, Mapping, MutableMapping, NamedTuple, Protocol, Tuple
from weakref import WeakValueDictionary

from ...foundation.errors import UsageError
from ..terms.types import SLASH, Var, atom, functor
from .libswipl import Answering, Interrupter, SwiLibrary, find_library, steps_of_keeping
from .swi_terms import SwiTerms

_READY = 64
"""Generators that wait: as many threads may ask before one of them goes on."""

_Waiting = Generator[int, int, None]


class AskedBack(Protocol):
    """Whose program SWI-Prolog's clauses may ask."""

    def answer(self, ref: int) -> bool:
        """Have a variable be the list of a goal's solutions; tell whether it is."""

    def fail(self, error: BaseException) -> None:
        """Have the goal that asks end with an error."""


class Callbacks(List[Callable[[int], int]]):
    """Called with a reference, it has one of its items answer.

    Args:
        asked: by the numbers of SWI-Prolog's engines.
        number: returns that of the engine that asks.
        refuse: has a goal end that belongs to no program.
    """

    __call__ = property(methodcaller("pop"))  # what it returns is called then

    def __init__(
        self, asked: Mapping[int, AskedBack], number: Callable[[], int], refuse: Callable[[], object]
    ):
        super().__init__()
        self._asked = asked
        self._number = number
        self._refuse = refuse
        self._over: List[_Waiting] = []
        self.fill()

    def fill(self) -> None:
        """Have enough ready."""
        with suppress(IndexError):  # no more, or taken by another thread
            while True:
                one: Any = self._over.pop()
                if one.gi_running:  # in another thread, for a moment
                    self._over.append(one)
                    break
                one.close()
        while len(self) < _READY:
            found: List[_Waiting] = []
            found.append(self._answering(found))
            next(found[0])
            self.append(found[0].send)

    def _answering(self, found: List[_Waiting]) -> _Waiting:
        """Wait for a reference, answer, and wait to be closed: else that would be done in Python as C goes on.

        Args:
            found: this generator.
        """
        asked: Any = None
        told, over = 0, False
        try:
            ref = yield 0
            self.fill()
            asked = self._asked.get(self._number())
            if asked is None:
                self._refuse()
            else:
                told = int(asked.answer(ref))
            self._over += found
            over = True  # nothing is called from here on: Python looks for signals behind calls
            yield told
        except GeneratorExit:
            return
        except BaseException as error:  # whatever it is: C waits
            if over:  # it does not: who closes this waits
                raise
            self._over += found
            asked = self._asked.get(self._number())
            if asked is not None:
                asked.fail(error)
            yield 0
        finally:
            del found[:]


BRIDGE = "retalis_bridge"
_FILE = Path(__file__).resolve().parent / "bridge.pl"
"""What is loaded into SWI-Prolog at its start."""

_LOCK = Lock()


class Started(NamedTuple):
    """SWI-Prolog as it runs in this process.

    Attributes:
        swi: its functions.
        interrupter: ends goals that are past a limit.
        engines: by their numbers.
        callbacks: what it calls of ours; they must not be forgotten.
    """

    swi: SwiLibrary
    interrupter: Interrupter
    engines: "MutableMapping[int, Any]"
    callbacks: object


def start() -> Started:
    """Return SWI-Prolog, started if need be.

    Raises:
        UsageError: where it is not installed, or does not start.
    """
    with _LOCK:
        return _started()


@lru_cache(maxsize=1)
def _started() -> Started:
    swi = find_library()
    swi.start()
    engines: MutableMapping[int, AskedBack] = WeakValueDictionary()

    answerers: Any = Callbacks(engines, swi.thread_self, partial(_refuse, swi))
    callbacks: List[Tuple[str, int, Any]] = [("$retalis_ask", 1, Answering(answerers))]
    callbacks += [(name, 0, step) for name, step in steps_of_keeping()]
    for name, arity, callback in callbacks:
        swi.register(BRIDGE.encode(), name.encode(), arity, callback, 0)
    ref = swi.new_refs(1)
    SwiTerms(swi).put(ref, atom(str(_FILE)), {})
    if not swi.call_predicate(None, 0, swi.predicate(b"consult", 1, b"user"), ref):
        raise UsageError(f"SWI-Prolog does not load {_FILE}")
    swi.leave()
    return Started(swi, Interrupter(swi), engines, callbacks)


def _refuse(swi: SwiLibrary) -> None:
    """Throw the error for a thread of SWI-Prolog's own, which belongs to no program."""
    ref = swi.new_refs(1)
    what = (functor("existence_error", 2), atom("retalis_engine"), (SLASH, atom("retalis"), 1))
    SwiTerms(swi).put(ref, (functor("error", 2), what, Var()), {})
    swi.raise_exception(ref)
